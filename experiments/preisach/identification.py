"""Models from records: the paper's static one from reversal curves, and one with relaxation."""

from __future__ import annotations

import numpy as np
from plant import legs, measure
from scipy.optimize import least_squares

import hystfit as hf
from hystfit.fitting.solvers.smooth_weights import SmoothWeights
from hystfit.models import AbstractHysteresis

TOP, CURVES = 180.0, 12
SMOOTHNESS = 1e-6  # strength of the penalty on the cells


def reversal_record(plant: AbstractHysteresis, frequency: float, rate: float, seed: int | None) -> hf.Record:
    """0 -> alpha -> 0 for alpha = 15 .. 180 V, as in the paper."""
    extrema = [0.0]
    for alpha in np.linspace(TOP / CURVES, TOP, CURVES):
        extrema += [float(alpha), 0.0]
    t, u = legs(extrema, frequency, rate)
    return measure(plant, t, u, seed=seed, name=f"reversal curves at {frequency:g} Hz")


def blank() -> hf.Preisach:
    """A Preisach model with cells of 15 V and a piecewise linear reversible part, empty at 0 V."""
    model = hf.Preisach.of(CURVES, initial="negative", spacing="given")
    levels = np.linspace(0.0, TOP, CURVES + 1)
    return hf.Preisach(
        w=model.w,
        levels=levels,
        slopes=model.slopes,
        center=0.5 * TOP,
        half=0.5 * TOP,
        initial="negative",
        spacing="given",
    )


def cells(data: hf.Record | list[hf.Record]) -> hf.FitResult:
    """The fit of non-negative cells."""
    return hf.fit(blank(), data, method=SmoothWeights(smoothness=(SMOOTHNESS,)))


def static_model(record: hf.Record) -> AbstractHysteresis:
    """Non-negative cells from reversal curves."""
    return cells(record).model


def table_model(record: hf.Record) -> AbstractHysteresis:
    """The paper's table on levels of 15 V, eqs. (2) to (5)."""
    return hf.fit(hf.TabulatedPreisach.of(CURVES), record).model


def with_relaxation(records: list[hf.Record], tau: tuple[float, ...] = (0.1, 1.0, 10.0)) -> hf.Series:
    """Preisach followed by relaxation: for given weights the relaxation is inverted in the output and the cells follow from a convex
    solve; an outer least squares finds the weights.
    """
    inner: dict[str, AbstractHysteresis] = {}

    def left(a: np.ndarray) -> np.ndarray:
        slow = hf.Relaxation(a=a, tau=tau)
        still = [r.replace(y=hf.invert(slow, r.y, r.dt).u) for r in records]
        found = cells(still)
        inner["model"] = found.model
        return np.concatenate([found.predict(r) - r.y for r in still])

    best = least_squares(left, np.full(len(tau), 0.03), bounds=(0.0, 0.3), diff_step=0.02, max_nfev=6)
    left(best.x)
    return hf.Series(inner["model"], hf.Relaxation(a=best.x, tau=tau))
