"""Records that begin with a period of a steady loop: their device was on a branch before the first sample, not at rest."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hystfit.data.circulation import FEWEST, GAP, OPEN, SLACK
from hystfit.data.record import Record

_INSIDE = 0.1  # of the input's range: least distance of the first input from the turning points, where the state is known anyway
_LOCAL = 0.05  # of the input's range, over which the slope at the first sample is measured
# Of the local width: largest change of the output over the period, without and with noise. A virgin branch begins half a width away.
_CLOSED, _LOOSE = 0.1, 0.25
_STANDS_OUT = 8.0  # times the noise: least local width


def steady_period(record: Record) -> int | None:
    """Number of samples of the first period, where it spans the record, begins between its turning points and closes; else None.

    A device that rested before the first sample starts inside the loop, half its width away from the branch on which the period
    ends. Where both outputs agree to a small part of the width, the motion was steady before.
    """
    period, steady = steady_rows(record.u, record.y[None])
    return period if steady[0] else None


def steady_rows(u: Float[np.ndarray, " T"], y: Float[np.ndarray, "N T"]) -> tuple[int, np.ndarray]:
    """`steady_period` of many outputs over one input: the period of those that have one, and which these are, shape (N,), bool."""
    span, none = float(np.ptp(u)), np.zeros(len(y), bool)
    middle = min(u[0] - u.min(), u.max() - u[0]) > _INSIDE * span
    if u.size < FEWEST or not middle:
        return 0, none
    away = int(np.argmax(np.abs(u - u[0]) > _LOCAL * span))
    rising = 1.0 if u[away] > u[0] else -1.0
    v = rising * u
    first = _turn(v, span)
    second = first + _turn(-v[first:], span)
    beyond = np.flatnonzero(v[second:] >= v[0])
    last = second + int(beyond[0]) if beyond.size else u.size - 1
    last -= int(v[0] - v[last - 1] < v[last] - v[0])  # the nearer of both neighbors
    covers = v[first] > v.max() - GAP * span and v[second] < v.min() + GAP * span
    if not covers or abs(u[last] - u[0]) > GAP * span:
        return 0, none
    part = y[:, : last + 1]
    finite = np.isfinite(part).all(axis=1)
    part = np.where(finite[:, None], part, 0.0)
    begin = part[:, 0]
    end = part[:, last] + (part[:, away] - begin) / (u[away] - u[0]) * (u[0] - u[last])
    width = np.abs(_between(-v[0], -v[first : second + 1], part[:, first : second + 1]) - 0.5 * (begin + end))
    noise = np.std(np.diff(part, 2), axis=1) / np.sqrt(6.0)  # second differences have sqrt(6) times white noise
    closes = np.abs(end - begin) <= np.minimum(_CLOSED * width + 2 * noise, _LOOSE * width)
    stands_out = width > np.maximum(OPEN * np.ptp(part, axis=1), _STANDS_OUT * noise)
    return last + (last == u.size - 1), finite & closes & stands_out


def _between(x: float, places: Float[np.ndarray, " T"], rows: Float[np.ndarray, "N T"]) -> Float[np.ndarray, " N"]:
    """`np.interp` of each row."""
    if x <= places[0] or x >= places[-1]:
        return rows[:, 0 if x <= places[0] else -1]
    k = int(np.searchsorted(places, x, side="right"))
    share = (x - places[k - 1]) / (places[k] - places[k - 1])
    return (1 - share) * rows[:, k - 1] + share * rows[:, k]


def _turn(v: np.ndarray, span: float) -> int:
    """Where a rise ends: the largest value before the first step back; the last sample where there is none."""
    for stop in (v.size // 16, v.size):  # most rises end soon
        back = np.flatnonzero(np.maximum.accumulate(v[:stop]) - v[:stop] > SLACK * span)
        if back.size:
            return int(np.argmax(v[: back[0]]))
    return v.size - 1


def with_steady_start(record: Record) -> Record:
    """The record behind its own first period, without weight, where that is steady; else unchanged."""
    period = steady_period(record)
    return record if period is None else record.repeating(period=period)


def from_turning_point(record: Record) -> Record:
    """The measured samples of a single steady period from its first turning point to the same one a period later; others unchanged."""
    start = record.first
    measured = record.replace(u=record.u[start:], y=record.y[start:], t=None, weight=record.weight[start:])
    if steady_period(measured) != len(measured):
        return record
    turn = min(int(np.argmin(measured.u)), int(np.argmax(measured.u)))
    order = np.concatenate([np.arange(turn, len(measured)), np.arange(turn + 1)])
    return measured.replace(u=measured.u[order], y=measured.y[order], weight=measured.weight[order])
