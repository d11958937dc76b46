"""Records that begin with a period of a steady loop: their device was on a branch before the first sample, not at rest."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hystfit.data.circulation import FEWEST, GAP, OPEN, SLACK
from hystfit.data.record import Record

_INSIDE = 0.1  # of the input's range: least distance from the turning points of a first input that is at none of them
_PLACES = 10  # parts of the range between which two branches in the same direction are compared
_LOCAL = 0.05  # of the input's range, over which the slope at the first sample is measured
# Of the local width: largest change of the output over the period, without and with noise. A virgin branch begins half a width away.
_CLOSED, _LOOSE = 0.1, 0.25
_CURVE = 5  # coefficients of a branch there: four put a kink of 0.14 into that of a strain of 600 samples
_STANDS_OUT = 8.0  # times the noise: least local width


def steady_period(record: Record) -> int | None:
    """Number of samples of the first period, where it spans the record and closes; else None.

    A device that rested before the first sample starts inside the loop, half its width away from the branch on which the period
    ends. Where both outputs agree to a small part of the width, the motion was steady before. A period that begins at a turning point
    must be followed by another one that repeats it, and lie nearer to zero input than half the range: on the way from rest at zero to a
    turning point further out the device reaches the loop.
    """
    period, steady = steady_rows(record.u, record.y[None])
    return period if steady[0] else None


def steady_rows(u: Float[np.ndarray, " T"], y: Float[np.ndarray, "N T"]) -> tuple[int, np.ndarray]:
    """`steady_period` of many outputs over one input: the period of those that have one, and which these are, shape (N,), bool."""
    low, high, none = float(u.min()), float(u.max()), np.zeros(len(y), bool)
    span, room = high - low, min(u[0] - low, high - u[0])
    inside = room > _INSIDE * span
    at_turn = room <= GAP * span and abs(u[0]) < (0.5 - GAP) * span
    if u.size < FEWEST or span == 0 or not (inside or at_turn):
        return 0, none
    away = int(np.argmax(np.abs(u - u[0]) > _LOCAL * span))
    rising = 1.0 if u[away] > u[0] else -1.0
    v = rising * u
    # A noisy input, or one of few digits, turns back within a branch as far as its noise does.
    slack = float(np.clip(_STANDS_OUT * _noise(u[None])[0], SLACK * span, GAP * span))
    first = _turn(v, slack)
    second = first + _turn(-v[first:], slack)
    beyond = np.flatnonzero(v[second:] >= v[0]) if inside else np.zeros(1, int)
    last = second + int(beyond[0]) if beyond.size else u.size - 1
    last -= int(inside and v[0] - v[last - 1] < v[last] - v[0])  # the nearer of both neighbors
    low, high = (low, high) if rising > 0 else (-high, -low)
    covers = v[first] > high - GAP * span and v[second] < low + GAP * span
    covers &= inside or v[second:].max() > high - GAP * span
    if not covers or abs(u[last] - u[0]) > GAP * span:
        return 0, none
    rows = y if at_turn else y[:, : last + 1]
    finite = np.isfinite(rows).all(axis=1)
    rows = np.where(finite[:, None], rows, 0.0)
    part = rows[:, : last + 1]
    begin = part[:, 0]
    end = part[:, last] + (part[:, away] - begin) / (u[away] - u[0]) * (u[0] - u[last])
    if inside:
        width = np.abs(_between(-v[0], -v[first : second + 1], part[:, first : second + 1]) - 0.5 * (begin + end))
        off = np.abs(end - begin)
    else:  # the next branch in the same direction must be the same too
        third = second + _turn(v[second:], slack)
        at = low + np.arange(1, _PLACES) / _PLACES * span
        one, other = (
            np.stack([_between(x, v[a:b], rows[:, a:b]) for x in at]) for a, b in ((0, first + 1), (second, third + 1))
        )
        middle, half = at[at.size // 2], slice(first, second + 1)
        width = np.abs(_between(-middle, -v[half], part[:, half]) - one[at.size // 2])
        off = np.maximum(np.abs(end - begin), np.sqrt(np.mean((one - other) ** 2, axis=0)))
    noise = _noise(part)
    least = np.maximum(OPEN * np.ptp(part, axis=1), _STANDS_OUT * noise)
    closes = (off <= np.minimum(_CLOSED * width + 2 * noise, _LOOSE * width)) & (width > least)
    if inside and not closes.all():  # the first sample may be where the branches of a butterfly cross
        width, off = _at_crossing((v[: last + 1] - v[0]) / (_LOCAL * span), part, (first, second))
        closes |= (off <= np.minimum(_CLOSED * width + 2 * noise, _LOOSE * width)) & (width > least)
    return last + (last == u.size - 1), finite & closes


def _at_crossing(
    x: Float[np.ndarray, " T"], rows: Float[np.ndarray, "N T"], turns: tuple[int, int]
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Difference of the slopes of both branches at the first sample, and the kink or step there from the end of the period to its start.

    `x` is the input from that of the first sample, in parts of the range; the other branch lies between `turns`.
    """
    rises = np.ones(x.size, bool)
    rises[turns[0] + 1 : turns[1]] = False
    near = np.flatnonzero(rises & (np.abs(x) <= 1))
    falls = slice(turns[0], turns[1] + 1)
    smooth = np.vander(x[near], _CURVE, increasing=True)
    joint = np.column_stack([smooth, np.maximum(x[near], 0), near < turns[0]])
    if near.size <= joint.shape[1]:
        return np.zeros(len(rows)), np.full(len(rows), np.inf)
    fit = lambda basis, y: np.linalg.lstsq(basis, y.T, rcond=None)[0]
    curve = fit(joint, rows[:, near])
    other = fit(smooth, np.stack([_between(-at, -x[falls], rows[:, falls]) for at in x[near]], axis=1))
    return np.abs(other[1] - curve[1] - 0.5 * curve[_CURVE]), np.abs(curve[_CURVE:]).max(axis=0)


def _between(x: float, places: Float[np.ndarray, " T"], rows: Float[np.ndarray, "N T"]) -> Float[np.ndarray, " N"]:
    """`np.interp` of each row."""
    if x <= places[0] or x >= places[-1]:
        return rows[:, 0 if x <= places[0] else -1]
    k = int(np.searchsorted(places, x, side="right"))
    share = (x - places[k - 1]) / (places[k] - places[k - 1])
    return (1 - share) * rows[:, k - 1] + share * rows[:, k]


def _noise(rows: Float[np.ndarray, "N T"]) -> Float[np.ndarray, " N"]:
    """Standard deviation of white noise on each row, of which second differences have sqrt(6) times that."""
    return np.std(np.diff(rows, 2), axis=1) / np.sqrt(6.0)


def _turn(v: np.ndarray, slack: float) -> int:
    """Where a rise ends: the largest value before the first step back by more than `slack`; the last sample where there is none."""
    for stop in (v.size // 16, v.size):  # most rises end soon
        back = np.flatnonzero(np.maximum.accumulate(v[:stop]) - v[:stop] > slack)
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
