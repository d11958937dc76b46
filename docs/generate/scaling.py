"""Cost against size, from the numbers of `benchmarks/scaling.py`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from generate.style import both, save_both

NUMBERS = Path(__file__).resolve().parents[2] / "benchmarks" / "scaling.json"
_PANELS = {
    "samples": ("Simulation, from and to NumPy", "samples", "ns a sample"),
    "parameters": ("Output and Jacobian", "free parameters", "times the output alone"),
    "grid": ("Preisach", "cells along an axis", "ms"),
    "batch": ("Many parameter vectors", "parameter vectors", "ns a sample and vector"),
    "chains": ("Posterior draws", "chains or walkers", "ms of one core a draw and chain"),
}


def scaling(folder: Path) -> str:
    """Draw the curves into a folder, and return the part of the page on speed that shows them."""
    found = json.loads(NUMBERS.read_text(encoding="utf-8"))
    save_both(lambda: _draw(found), folder / "scaling")
    machine = found["machine"]
    about = f"{machine['cpu']}, one core of {machine['cores']}, float64, jax {machine['jax']}, numba {machine['numba']}"
    alt = "Cost against the number of samples, parameters, cells, parameter vectors and chains"
    return f"{both('scaling', alt)}\n\nMeasured on {about}, by `python benchmarks/scaling.py`."


def _draw(found: dict[str, Any]) -> Figure:
    figure, axes = plt.subplots(3, 2, figsize=(7.5, 8.4), layout="constrained")
    for ax, (panel, (title, across, up)) in zip(axes.flat, _PANELS.items(), strict=False):
        for name, curve in found[panel].items():
            ax.loglog([int(count) for count in curve], list(curve.values()), "o-", markersize=3, label=name)
        ax.set(title=title, xlabel=across, ylabel=up)
        if panel != "samples":
            counts = sorted({int(count) for curve in found[panel].values() for count in curve})
            ax.set_xticks(counts, [str(count) for count in counts])
        lowest, highest = (
            round_to(np.log10(v)) for round_to, v in zip((np.floor, np.ceil), ax.get_ylim(), strict=True)
        )
        ax.set_ylim(10.0**lowest, 10.0**highest)
        ax.minorticks_off()
        ax.grid(visible=True, which="major", alpha=0.3)
        ax.legend(fontsize="small")
    for ax in axes.flat[len(_PANELS) :]:
        ax.remove()
    return figure
