"""Records that begin with a period of a steady loop: their device was on a branch before the first sample, not at rest."""

from __future__ import annotations

import numpy as np

from hystfit.data.record import Record

_FEWEST = 8  # samples of a period
_GAP = 0.03  # of the input's range: between the ends of a period, and between its turning points and the range
_INSIDE = 0.1  # of the input's range: least distance of the first input from the turning points, where the state is known anyway
_BACK = 0.01  # of the input's range: a step back against the branch, by noise
_LOCAL = 0.05  # of the input's range, over which the slope at the first sample is measured
# Of the local width: largest change of the output over the period, without and with noise. A virgin branch begins half a width away.
_CLOSED, _LOOSE = 0.1, 0.25
_STANDS_OUT = 8.0  # times the noise: least local width
_OPEN = 0.02  # of the output's range: least local width


def steady_period(record: Record) -> int | None:
    """Number of samples of the first period, where it spans the record, begins between its turning points and closes; else None.

    A device that rested before the first sample starts inside the loop, half its width away from the branch on which the period
    ends. Where both outputs agree to a small part of the width, the motion was steady before.
    """
    u, y = record.u, record.y
    span = float(np.ptp(u))
    middle = min(u[0] - u.min(), u.max() - u[0]) > _INSIDE * span
    if u.size < _FEWEST or not middle or not np.isfinite(y[0]):
        return None
    away = int(np.argmax(np.abs(u - u[0]) > _LOCAL * span))
    rising = 1.0 if u[away] > u[0] else -1.0
    v = rising * u
    first = _turn(v, span)
    second = first + _turn(-v[first:], span)
    beyond = np.flatnonzero(v[second:] >= v[0])
    last = second + int(beyond[0]) if beyond.size else u.size - 1
    covers = v[first] > v.max() - _GAP * span and v[second] < v.min() + _GAP * span
    if not covers or abs(u[last] - u[0]) > _GAP * span or not np.isfinite(y[: last + 1]).all():
        return None
    end = y[last] + (y[away] - y[0]) / (u[away] - u[0]) * (u[0] - u[last])
    width = abs(np.interp(-v[0], -v[first : second + 1], y[first : second + 1]) - 0.5 * (y[0] + end))
    noise = float(np.std(np.diff(y[: last + 1], 2)) / np.sqrt(6.0))  # second differences have sqrt(6) times white noise
    closes = abs(end - y[0]) <= min(_CLOSED * width + 2 * noise, _LOOSE * width)
    stands_out = width > max(_OPEN * np.ptp(y[: last + 1]), _STANDS_OUT * noise)
    return last + (last == u.size - 1) if closes and stands_out else None


def _turn(v: np.ndarray, span: float) -> int:
    """Where a rise ends: the largest value before the first step back; the last sample where there is none."""
    back = np.flatnonzero(np.maximum.accumulate(v) - v > _BACK * span)
    return int(np.argmax(v[: back[0]])) if back.size else v.size - 1


def with_steady_start(record: Record) -> Record:
    """The record behind its own first period, without weight, where that is steady; else unchanged."""
    period = steady_period(record)
    return record if period is None else record.repeating(period=period)


def from_turning_point(record: Record) -> Record:
    """The measured samples of a single steady period from its first turning point to the same one a period later; others unchanged."""
    start = int(np.argmax(record.used))
    measured = record.replace(u=record.u[start:], y=record.y[start:], t=None, weight=record.weight[start:])
    if steady_period(measured) != len(measured):
        return record
    turn = min(int(np.argmin(measured.u)), int(np.argmax(measured.u)))
    order = np.concatenate([np.arange(turn, len(measured)), np.arange(turn + 1)])
    return measured.replace(u=measured.u[order], y=measured.y[order], weight=measured.weight[order])
