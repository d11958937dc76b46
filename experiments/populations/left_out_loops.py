"""Bands of 90 % of Preisach weights over measured loops that were not fitted, see run.py.

Of three soft magnetic materials each loop but the largest is left out in turn and predicted from the others. Weights that may be negative
describe minor loops that the classical model does not; levels are denser where the branches are steep. The second form, and that errors
grow with the logarithm of the amplitude, were chosen with these loops in view; how fast they grow, with those of `simulated_loops.py`.
"""

from __future__ import annotations

import numpy as np
from common import Results, table

import hystfit as hf

MATERIALS = ("MnZn_ferrite", "MnZn_HP_ferrite", "M130_27s")
FORMS = ("preisach:n=16:spacing=steep", "preisach-signed:n=12:spacing=steep")
BAND, DRAWS, COUNT = 0.9, 400, 400  # level; least number of draws of each of two chains; draws of a band
HEAD = ["material", "form", "amplitudes of the loops", "each loop but the largest left out, %", "mean, %"]


def left_out_loops(results: Results) -> str:
    """A table of the materials whose data are found."""
    rows, all_covered = [], {form: [] for form in FORMS}
    for material in MATERIALS:
        loaded = results.load("left-out loops", f"mag_ja_bh/{material}")
        if loaded is None:
            continue
        loops = list(hf.Dataset.of(loaded[0]))
        amplitudes = ", ".join(f"{np.ptp(loop.u) / 2:.3g}" for loop in loops)
        for form in FORMS:
            covered = [100 * _covered(form, loops, k) for k in range(len(loops) - 1)]
            all_covered[form] += covered
            rows.append([material, form, amplitudes, ", ".join(f"{value:.0f}" for value in covered), np.mean(covered)])
    for form, covered in all_covered.items():
        if covered:
            results.add(f"left-out loops, {form.partition(':')[0]}: bands of 90 % cover, %", float(np.mean(covered)))
    return table(HEAD, rows)


def _covered(form: str, loops: list[hf.Record], k: int) -> float:
    """Part of the samples of loop k inside their band, fitted to the others."""
    fit = hf.fit(form, loops[:k] + loops[k + 1 :])
    posterior = hf.sample(fit, "weights", chains=2, draws=DRAWS, extend=2)
    low, _, high = posterior.bands(loops[k], BAND, COUNT)
    on = loops[k].used
    return float(np.mean(((loops[k].y >= low) & (loops[k].y <= high))[on]))
