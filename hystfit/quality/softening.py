"""Softening by the largest stroke so far (Mullins effect of rubber): unlike hysteresis, it outlasts a return to the outermost level."""

from __future__ import annotations

import itertools

import numpy as np

from hystfit.quality.loops import APART, SAME_LEVEL

_LARGER = 1.1  # ratio of the largest strokes so far between which branches are compared
_GRID = np.linspace(0.3, 0.9, 25)  # part of the common range that is compared


def softening_left(u: np.ndarray, y: np.ndarray, turns: np.ndarray) -> float | None:
    """Output on branches from the outermost level after the largest strokes, over that on such branches after the smallest stroke.

    Hysteresis with wiping-out begins anew at the outermost level: branches from there coincide, whatever came before. The first
    branch of the record is omitted.

    Args:
        u: input, shape (T,).
        y: output, shape (T,).
        turns: turning points of u, see `loops.reversals`.

    Returns:
        The smaller of the ratios at the two ends of the range; None where branches after strokes of different size are too few.
    """
    found = [left for sign in (1.0, -1.0) if (left := _from_lowest(sign * u, sign * y, turns)) is not None]
    return min(found, default=None)


def _from_lowest(u: np.ndarray, y: np.ndarray, turns: np.ndarray) -> float | None:
    """The ratio for branches that begin at the lowest level."""
    span, lowest = float(np.ptp(u)), float(u.min())
    ends = [*turns.tolist(), u.size - 1]
    begin = [(a, b) for a, b in itertools.pairwise(ends) if u[a] - lowest <= SAME_LEVEL * span and u[b] > u[a]]
    branches = [(a, b, float(u[:a].max()) - lowest) for a, b in begin if a > 0 and np.isfinite(y[a : b + 1]).all()]
    if not branches:
        return None
    least = min(stroke for _, _, stroke in branches)
    common = min(least, min(float(u[b]) - lowest for _, b, _ in branches))
    if common <= APART * span:
        return None
    first = [_rise(u, y, a, b, lowest, common) for a, b, stroke in branches if stroke < _LARGER * least]
    largest = max(stroke for _, _, stroke in branches)
    late = [
        _rise(u, y, a, b, lowest, common)
        for a, b, stroke in branches
        if stroke > max(_LARGER * least, largest / _LARGER)
    ]
    if min(len(first), len(late)) < 2 or abs(np.median(first)) < SAME_LEVEL * np.ptp(y[np.isfinite(y)]):
        return None
    return float(np.median(late) / np.median(first))


def _rise(u: np.ndarray, y: np.ndarray, start: int, stop: int, lowest: float, common: float) -> float:
    """Mean rise of the output along a branch over the common range."""
    way = np.maximum.accumulate(u[start : stop + 1])
    return float(np.mean(np.interp(lowest + _GRID * common, way, y[start : stop + 1]) - y[start]))
