"""Corrections of measured reversal curves: drift between calibration points, and first points at which the field had not settled."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.outcome import Code, Note
from hystfit.quality.faults import SIGNIFICANCE

_FIT = 5  # points after a point from which a parabola is continued to it
_MOST = 3  # first points that are left out of each curve at most
_FEWEST = 8  # calibration points, or curves, from which a correction is estimated
_WIDTHS = (3, 5, 9, 17, 33)  # calibration points in the running mean of the drift, chosen by points left out


def corrected_curves(data: Dataset) -> tuple[Dataset, tuple[Note, ...]]:
    """Curves without drift and without first points that had not settled, and what was done.

    Args:
        data: one record for each curve, in the order of measurement; a sample of weight 0 at its start is its calibration point.

    Returns:
        The data set, and one note for each correction; the data set itself where there is none.
    """
    data, drift = _without_drift(data)
    data, unsettled = _without_unsettled_points(data)
    return data, (*drift, *unsettled)


def _without_drift(data: Dataset) -> tuple[Dataset, list[Note]]:
    """Outputs times mean over local calibration output, where calibration outputs of neighbors are more alike than of others."""
    calibrated = [not r.used[0] and bool(np.isfinite(r.y[0])) for r in data]
    levels = np.array([r.y[0] for r, has_one in zip(data, calibrated, strict=True) if has_one])
    if levels.size < _FEWEST or not all(calibrated) or drift_probability(levels) > SIGNIFICANCE:
        return data, []
    slow = _running_mean(levels)
    factors = levels.mean() / slow
    scaled = [dataclasses.replace(r, y=r.y * factor) for r, factor in zip(data, factors, strict=True)]
    spread = 100 * float(np.ptp(slow) / abs(levels.mean()))
    text = (
        f"drift: outputs scaled so that the calibration points agree, which differed by {spread:.2g} % from slow drift"
    )
    return Dataset(tuple(scaled)), [Note(Code.CURVES, text)]


def drift_probability(levels: np.ndarray) -> float:
    """Probability of differences between neighbors as small as these if the order did not matter (von Neumann's ratio, 1941)."""
    from scipy.stats import norm

    n, variance = levels.size, float(levels.var())
    if variance == 0:
        return 1.0
    ratio = float(np.mean(np.diff(levels) ** 2)) / variance
    deviation = np.sqrt(4 * (n - 2) / (n**2 - 1))
    return float(norm.cdf((ratio - 2 * n / (n - 1)) / deviation))


def _running_mean(levels: np.ndarray) -> np.ndarray:
    """The slow part of a sequence: its running mean over the width that best predicts each value from the others."""

    def means(width: int, *, own: bool) -> np.ndarray:
        window = np.ones(width)
        window[width // 2] = own
        return np.convolve(levels, window, "same") / np.convolve(np.ones(levels.size), window, "same")

    widths = [w for w in _WIDTHS if w <= levels.size]
    best = min(widths, key=lambda w: float(np.mean((levels - means(w, own=False)) ** 2)))
    return means(best, own=True)


def _without_unsettled_points(data: Dataset) -> tuple[Dataset, list[Note]]:
    """First outputs are continued from the curve after them, where they lie further from it than the next points do from theirs."""
    from scipy.stats import wilcoxon

    count = 0
    while count < _MOST:
        first, second = (np.array([_distance(r, count + k) for r in data]) for k in range(2))
        both = np.isfinite(first) & np.isfinite(second) & (first != second)
        if both.sum() < _FEWEST:
            break
        if wilcoxon(first[both] - second[both], alternative="greater").pvalue > SIGNIFICANCE:
            break
        count += 1
    if not count:
        return data, []
    which = "first point" if count == 1 else f"first {count} points"
    text = f"{which} of every curve: replaced by the parabola through the {_FIT} points after, from which later points lie less far"
    return data.map(lambda record: _continued(record, count)), [Note(Code.CURVES, text)]


def _distance(record: Record, place: int) -> float:
    """Distance of a used sample from the parabola through the next ones, over its factor of error; NaN near the end of a curve."""
    part = np.flatnonzero(record.used)[place : place + 1 + _FIT]
    if part.size <= _FIT or np.ptp(record.u[part]) == 0:
        return np.nan
    weights = _parabola(record.u[part[1:]], record.u[part[:1]])[0]
    return float(abs(record.y[part[0]] - weights @ record.y[part[1:]]) / np.sqrt(1 + weights @ weights))


def _parabola(known: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Weights of outputs at known inputs (N,) in the best parabola at wanted ones (M,), shape (M, N)."""
    scale = float(np.ptp(known)) or 1.0
    columns = lambda u: np.vander((u - known[0]) / scale, 3)
    return columns(wanted) @ np.linalg.pinv(columns(known))


def _continued(record: Record, count: int) -> Record:
    """The record with its first used outputs from the parabola after them; unchanged where it is too short."""
    used = np.flatnonzero(record.used)
    if used.size < count + _FIT:
        return record
    first, after = used[:count], used[count : count + _FIT]
    y = record.y.copy()
    y[first] = _parabola(record.u[after], record.u[first]) @ record.y[after]
    return dataclasses.replace(record, y=y)
