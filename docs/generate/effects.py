"""What each parameter does to the loop of a model, or to its step response: one small plot per parameter, three values each."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import hystfit as hf
from generate.model_facts import Facts
from generate.style import LINES, save_both
from hystfit.models.base import AbstractHysteresis

COLUMNS = 3
WIDTHS = {1: 4.0, 2: 6.6, 3: 7.5}  # of a figure with this many columns [in]; a page has room for 6.7
DT = 0.01  # sampling interval of the pictures [s]

Curve = tuple[np.ndarray, np.ndarray]


def varied(entry: Facts) -> dict[str, list[AbstractHysteresis]]:
    """The models to draw by varied parameter, none where its entry varies no parameter; a value outside the bounds is refused."""
    model = entry.model()
    return {name: [model.replace(**{name: value}) for value in values] for name, values in entry.vary.items()}


def draw_effects(entry: Facts, models: dict[str, list[AbstractHysteresis]], target: Path) -> None:
    """Write the pictures of a model.

    Args:
        entry: facts of the model.
        models: from `varied`.
        target: path of the pictures without a suffix.
    """
    curves = {name: [_curve(model, entry.view) for model in each] for name, each in models.items()}
    save_both(lambda: _figure(entry, curves), target)


def _curve(model: AbstractHysteresis, view: str) -> Curve:
    """Abscissa and output: the input of a major and a minor loop, or the time after a step."""
    if view == "step":
        t = np.arange(-0.2, 2.0, DT)
        u = (t >= 0).astype(float)
        return t, np.asarray(hf.simulate(model, u, DT)[0])
    t = np.arange(0, 3.255, DT)
    wave = np.sin(2 * np.pi * t)
    u = np.where(t < 2.25, wave, 0.5 + 0.5 * wave)
    settled = t >= 1.245
    return u[settled], np.asarray(hf.simulate(model, u, DT)[0])[settled]


def _figure(entry: Facts, curves: dict[str, list[Curve]]) -> Figure:
    columns = COLUMNS if len(curves) in (3, 5, 6) else min(2, len(curves))
    rows = -(-len(curves) // columns)
    size = (WIDTHS[columns], 2.4 * rows)
    figure, grid = plt.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained")
    for ax in grid.flat[len(curves) :]:
        ax.remove()
    for ax, (name, drawn) in zip(grid.flat, curves.items(), strict=False):
        _panel(ax, name, entry.vary[name], drawn)
        ax.set(xlabel="input" if entry.view == "loop" else "time [s]", ylabel="output")
    return figure


def _panel(ax: Axes, name: str, values: list[float], drawn: list[Curve]) -> None:
    """The curves of one parameter."""
    for (x, y), value, color in zip(drawn, values, LINES, strict=True):
        ax.plot(x, y, color=color, lw=1.1, label=f"{value:g}")
    ax.set_title(name)
    ax.locator_params(nbins=5)
    ax.legend(fontsize="small", handlelength=1.0, borderaxespad=0.1, labelspacing=0.2)
