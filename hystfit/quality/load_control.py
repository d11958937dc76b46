"""Tests that control the output: a load that turns at the same levels again and again, while the displacement under it wanders."""

from __future__ import annotations

import numpy as np

from hystfit.data.circulation import SLACK
from hystfit.quality.loops import SAME_LEVEL

_FEWEST = 5  # turns at each end
_BEFORE = 0.1  # part of a branch, at its end, that shows the slope there
# Spread of the levels of the output over the one that the slope makes of the spread of the input. Where the input is controlled the two are
# equal, and an output that saturates has no slope; a controller of the load leaves 0.004 to 0.04, and 0.002 to 0.003 of the range.
_REPEATS = 0.2


def controls_output(u: np.ndarray, y: np.ndarray, turns: np.ndarray) -> bool:
    """Whether the output turns at levels that repeat more closely than those of the input allow, at both ends.

    An input of which each end is the mirror image of the other one more closely than the output repeats was commanded, however it grows.

    Args:
        u: input, shape (T,).
        y: output, shape (T,).
        turns: turning points of u, see `loops.reversals`.
    """
    return all(_repeats(u, y, turns[first:]) for first in (0, 1)) and not _is_mirrored(u, y, turns)


def _is_mirrored(u: np.ndarray, y: np.ndarray, turns: np.ndarray) -> bool:
    """Whether the middle between neighboring ends of the input wanders less than the levels of the output, each of its own range."""
    ends = turns[2:-1] if turns.size % 2 else turns[2:]
    pairs = (ends[: ends.size // 2 * 2], ends[1 : 1 + (ends.size - 1) // 2 * 2])
    middle = min(np.std(0.5 * (u[some[::2]] + u[some[1::2]])) for some in pairs)
    repeat = max(np.std(y[turns[first::2]]) for first in (2, 3))
    return bool(middle / np.ptp(u) < repeat / np.ptp(y[np.isfinite(y)]))


def _repeats(u: np.ndarray, y: np.ndarray, turns: np.ndarray) -> bool:
    """The same for every second turn, those at one end, from the first of them on."""
    ends, starts = turns[2::2], turns[1:-1:2]
    before = ends - np.maximum(1, (_BEFORE * (ends - starts)).astype(int))
    moved = u[ends] - u[before]
    if ends.size < _FEWEST or not np.isfinite(y[ends]).all() or not moved.all():
        return False
    slope = abs(float(np.median((y[ends] - y[before]) / moved)))
    wander, repeat = (float(np.std(values[ends])) for values in (u, y))
    allowed = min(SLACK * float(np.ptp(y[np.isfinite(y)])), _REPEATS * slope * wander)
    return wander > SAME_LEVEL * float(np.ptp(u)) and repeat < allowed
