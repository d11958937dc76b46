"""Saturation polarization by the law of approach to saturation, over several windows of the field and several laws."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.data.circulation import FEWEST
from hystfit.results.measured.loop_branches import Branch

# Of the largest field, from which the law is fitted, and least samples of a half-branch from there on: where fields are set in equal
# ratios, as of a superconducting magnet, a window begins at a smaller field, but at no smaller part of the largest one than the last.
_WINDOWS, _SAMPLES, _LOWEST = (0.3, 0.5, 0.7), (FEWEST + 4, FEWEST + 2, FEWEST), 0.05
# Of the value: half range over the windows from which the field does not reach the approach to saturation.
_UNSETTLED = 0.1
_SUBSTRATE = 0.1  # of Js, by which the output falls over the field, from which the slope of a substrate is named
_BEYOND = 1.3  # ratio to the largest output, from which the value is an extrapolation without a measurement near it

# Columns beside the constant, of the field over its largest value: the law J = Js - a/H + chi H, and those that lack one of its terms.
_LAW = "a/H + chi H"
_LAWS = {
    _LAW: (lambda h: 1 / h, lambda h: h),
    "chi H": (lambda h: h,),
    "a/H": (lambda h: 1 / h,),
    "a/H2": (lambda h: h**-2.0,),
}


@dataclasses.dataclass(frozen=True)
class Saturation:
    """Js and the high-field susceptibility.

    Attributes:
        value: Js by J = Js - a/H + chi H, median over windows and half-branches.
        stderr: half the range over these.
        spread: half the range over the laws; chi H, a/H and a/H2 alone are the others, and chi H where the output falls at large fields.
        slope, slope_stderr: chi in output over input, and half its range over windows and half-branches.
        settled: whether the field reaches the approach to saturation.
        on_substrate: whether the output falls at the largest fields by a visible part of Js, as on a diamagnetic substrate.
    """

    value: float
    stderr: float
    spread: float
    slope: float
    slope_stderr: float
    settled: bool
    on_substrate: bool


def saturation(branches: list[Branch]) -> Saturation | None:
    """Js of a loop; None where a window has too few samples."""
    largest = min(max(float(b.u.max()), -float(b.u.min())) for b in branches) if branches else 0.0
    top = max(float(np.abs(b.y).max()) for b in branches) if branches else 0.0
    if not largest > 0 or not top > 0:
        return None
    found = {name: _of_law(branches, largest, name) for name in _LAWS}
    if found[_LAW] is None or not found[_LAW].size:
        return None
    fitted = found[_LAW]
    value, slope = (float(np.median(column)) for column in fitted.T)
    half = lambda values: 0.5 * float(np.ptp(values))
    error = half(fitted[:, 0])
    falls = bool((found["chi H"][-2:, 1] < 0).all())  # on a substrate, of whose slope the other laws have no term
    compared = [of_law for name, of_law in found.items() if "chi H" in name or not falls]
    medians = [float(np.median(of_law[:, 0])) for of_law in compared if of_law.size]
    settled = 0 < value <= _BEYOND * top and error <= _UNSETTLED * value
    beside = settled and falls and -slope > _SUBSTRATE * value
    return Saturation(value, error, half(medians), slope / largest, half(fitted[:, 1]) / largest, settled, beside)


def _of_law(branches: list[Branch], largest: float, name: str) -> np.ndarray:
    """Constant and last coefficient for each window and each direction of the field, means over both signs of it, shape (n, 2)."""
    rows = []
    for window, samples in zip(_WINDOWS, _SAMPLES, strict=True):
        sides: dict[tuple[bool, float], list[np.ndarray]] = {}
        for branch in branches:
            for sign in (1.0, -1.0):
                field = sign * branch.u / largest
                start = max(min(window, float(np.sort(field)[-samples:][0])), _LOWEST)
                kept = field >= start
                if kept.sum() >= FEWEST and np.ptp(field[kept]) > 0.5 * (1 - start):
                    columns = np.column_stack([np.ones(kept.sum()), *(column(field[kept]) for column in _LAWS[name])])
                    theta = np.linalg.lstsq(columns, sign * branch.y[kept], rcond=None)[0]
                    sides.setdefault((branch.rises == (sign > 0), sign), []).append(theta[[0, -1]])
        for approaching in (True, False):
            both = [np.mean(sides[approaching, sign], axis=0) for sign in (1.0, -1.0) if (approaching, sign) in sides]
            if len(both) == 2:
                rows.append(np.mean(both, axis=0))
    return np.reshape(rows, (-1, 2))
