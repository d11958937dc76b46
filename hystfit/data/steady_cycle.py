"""Records of one period of a steady loop: their device was on a branch before the first sample, not at rest."""

from __future__ import annotations

import numpy as np

from hystfit.data.record import Record

_FEWEST = 8  # samples of a period
_GAP = 0.03  # of the input's range: between first and last input
_INSIDE = 0.1  # of the input's range: least distance of the first input from the turning points, where the state is known anyway
_BACK = 0.01  # of the input's range: a step back against the branch, by noise
_LOCAL = 0.05  # of the input's range, over which the slope at the first sample is measured
_CLOSED = (
    0.25  # of the local width: largest change of the output over the period; a virgin branch begins half a width away
)
_OPEN = 0.02  # of the output's range: least local width


def is_steady_cycle(record: Record) -> bool:
    """Whether a record is one period of a closed loop that begins between its turning points and ends where it began.

    A device that rested before the first sample starts inside the loop, half its width away from the branch on which the period
    ends. Where both outputs agree to a quarter of the width, the motion was steady.
    """
    return _is_steady(record.u, record.y)


def from_turning_point(record: Record) -> Record:
    """The measured samples of a steady cycle from its first turning point to the same one a period later; others unchanged."""
    first = int(np.argmax(record.used))
    u, y = record.u[first:], record.y[first:]
    if not _is_steady(u, y):
        return record
    turn = min(int(np.argmin(u)), int(np.argmax(u)))
    order = np.concatenate([np.arange(turn, u.size), np.arange(turn + 1)])
    return record.replace(u=u[order], y=y[order], t=None, weight=np.ones(order.size))


def _is_steady(u: np.ndarray, y: np.ndarray) -> bool:
    if u.size < _FEWEST or not np.isfinite(y).all():
        return False
    low, high = float(u.min()), float(u.max())
    span = high - low
    if not min(u[0] - low, high - u[0]) > _INSIDE * span or abs(u[-1] - u[0]) > _GAP * span:
        return False
    first, second = sorted((int(np.argmin(u)), int(np.argmax(u))))
    rising = 1.0 if u[first] > u[0] else -1.0
    pieces = (rising * u[: first + 1], -rising * u[first : second + 1], rising * u[second:])
    if any(np.max(np.maximum.accumulate(piece) - piece) > _BACK * span for piece in pieces):
        return False
    away = int(np.argmax(np.abs(u - u[0]) > _LOCAL * span))
    end = y[-1] + (y[away] - y[0]) / (u[away] - u[0]) * (u[0] - u[-1])
    width = abs(np.interp(-rising * u[0], pieces[1], y[first : second + 1]) - 0.5 * (y[0] + end))
    return bool(abs(end - y[0]) <= _CLOSED * width and width > _OPEN * np.ptp(y))
