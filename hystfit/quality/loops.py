"""Geometry of loops: turning points of the input, closed loops, cycles, area, width and circulation."""

from __future__ import annotations

import dataclasses
import itertools
import weakref
from collections.abc import Iterable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from hystfit.data.record import Record

SEVERAL = 3  # branches, cycles, records, levels or samples of a branch, from which they show a trend or a repetition
SAME_LEVEL = 0.02  # of the input's range: smaller reversals are noise, and turning levels closer than this are one
APART = 0.05  # of the largest amplitude, by which amplitudes that count as different differ; smaller reversals end no branch
SPEEDS_APART = 0.5  # decimal logarithm of the ratio of two speeds that differ
LARGEST = 0.9  # of the input's range, which a branch of the largest loops covers
_CROWDED = 0.25  # of the samples in one bin; even steps have 0.02, and ten a decade over four decades 0.3


def reversals(u: np.ndarray, threshold: float = 0.0) -> np.ndarray:
    """Turning points of u, without those of noise.

    A turning point counts once u has moved back from it by more than `threshold`.

    Args:
        u: input, shape (T,).

    Returns:
        Sample numbers in rising order, shape (R,), the ends of the record excluded; on a flat top the first sample.
    """
    found = _corners(np.asarray(u, dtype=float))
    if threshold not in found.turns:
        found.turns[threshold] = _turns(found.at, threshold)
        found.turns[threshold].flags.writeable = False
    return found.turns[threshold]


def _turns(at: Mapping[int, float], threshold: float) -> np.ndarray:
    """`reversals` among the samples that alone can be turning points, with their values."""
    turns: list[int] = []
    extreme, rising = 0, 0  # rising: +1, -1, or 0 while the direction is unknown
    low = high = 0
    for corner, value in at.items():
        if rising == 0:
            low = corner if value < at[low] else low
            high = corner if value > at[high] else high
            if at[high] - at[low] > threshold:
                rising, extreme = (1, high) if high > low else (-1, low)
        elif rising * (value - at[extreme]) > 0:
            extreme = corner
        elif rising * (at[extreme] - value) > threshold:
            turns.append(extreme)
            rising, extreme = -rising, corner
    return np.array(turns, dtype=int)


class _Corners(NamedTuple):
    """Of an input: the samples that alone can be turning points with their values, its range, and its turning points by threshold."""

    at: dict[int, float]
    span: float
    turns: dict[float, np.ndarray]


# Of arrays that cannot change, by `id`: those of a record are asked for a dozen times.
_known: dict[int, tuple[weakref.ref[np.ndarray], _Corners]] = {}


def _corners(u: np.ndarray) -> _Corners:
    """The ends, and local extremes, each the first of its flat run."""
    whole = u.base
    if isinstance(whole, np.ndarray) and (whole.shape, whole.strides, whole.dtype) == (u.shape, u.strides, u.dtype):
        u = whole  # a view of all samples
    known = _known.get(id(u))
    if known is not None and known[0]() is u:
        return known[1]
    steps = np.diff(u)
    moves, rises = np.arange(steps.size), steps > 0
    if not steps.all():  # these take twice the time of all other steps
        moves = np.flatnonzero(steps)
        rises = rises[moves]
    if moves.size == 0:
        return _Corners({}, 0.0, {})
    change = np.flatnonzero(rises[1:] != rises[:-1])
    corners = np.concatenate([[0], moves[change] + 1, [moves[-1] + 1]])
    values = u[corners].tolist()  # a number of Python takes a tenth of the time of one in an array
    found = _Corners(dict(zip(corners.tolist(), values, strict=True)), max(values) - min(values), {})
    if u.base is None and not u.flags.writeable:
        forget = partial(_known.pop, id(u), None)
        _known[id(u)] = weakref.ref(u, lambda _: forget()), found
    return found


def largest_step(u: np.ndarray) -> float:
    """Largest change of u, shape (T,), between two samples."""
    return float(np.abs(np.diff(u)).max(initial=0.0))


def clear_reversals(u: np.ndarray) -> np.ndarray:
    """Turning points from which the input moves back by more than 2 % of its range, as by `reversals`."""
    return reversals(u, SAME_LEVEL * _corners(np.asarray(u, dtype=float)).span)


def turns_back(data: Iterable[Record]) -> bool:
    """Whether any record's input reverses by more than 2 % of its range while samples count: without it no loop shows."""
    return any(clear_reversals(record.u[record.first : record.last + 1]).size for record in data)


def branches(u: np.ndarray, threshold: float = 0.0) -> np.ndarray:
    """First and last sample of every stretch between turning points, shape (R + 1, 2); neighbors share a sample."""
    knots = np.concatenate([[0], reversals(u, threshold), [len(u) - 1]])
    return np.stack([knots[:-1], knots[1:]], axis=1)


def strokes(u: np.ndarray, threshold: float = 0.0) -> np.ndarray:
    """Change of u over each branch between two turning points, and over the ends of a record where it is larger, shape (K,)."""
    first, last = branches(u, threshold).T
    change = np.abs(u[last] - u[first])
    between = np.arange(change.size) % (change.size - 1 or 1) > 0
    return change[between | (change > change[between].max(initial=0.0))]


def extents(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Range of values over each stretch from one edge to the next, both samples included, shape (K,); 0 where all are missing.

    Args:
        values: shape (T,); NaN where one is missing.
        edges: first sample of each stretch, and the end, shape (K + 1,).
    """
    parts = (values[first : last + 1] for first, last in itertools.pairwise(edges))
    return np.array([np.nanmax(part) - np.nanmin(part) if np.isfinite(part).any() else 0.0 for part in parts])


def distinct(values: Iterable[float], apart: float = APART) -> tuple[float, ...]:
    """Values that differ by more than `apart`, largest first."""
    kept: list[float] = []
    for value in sorted(values, reverse=True):
        if not kept or kept[-1] - value > apart:
            kept.append(float(value))
    return tuple(kept)


@dataclasses.dataclass(frozen=True)
class Loop:
    """Samples start..stop after which the input is back at its initial level, with one far turning point.

    Attributes:
        start: sample of the turning point (or start of the record) where it begins.
        turn: sample of its far turning point.
        stop: first sample at which the input is back at the level of `start`.
        low, high: extent of the input [unit of u].
        depth: number of loops that enclose it in time.
    """

    start: int
    turn: int
    stop: int
    low: float
    high: float
    depth: int = 0

    @property
    def stroke(self) -> float:
        """Extent of the input [unit of u]."""
        return self.high - self.low


def closed_loops(u: np.ndarray, threshold: float = 0.0) -> list[Loop]:
    """All loops that the input closes, nested ones included, in the order in which they begin.

    Turning points are paired as in rainflow counting (ASTM E1049): a pair is a loop as soon as the input passes
    the level where it began; it is then wiped out. A repeated cycle counts once.

    Args:
        u: input, shape (T,).
        threshold: see `reversals`; also the largest gap between the ends of a closed loop [unit of u].
    """
    u = np.asarray(u, dtype=float)
    turns = reversals(u, threshold)
    stack: list[int] = []
    loops: list[Loop] = []
    for knot in itertools.chain([0], turns, [len(u) - 1]):
        stack.append(int(knot))
        while len(stack) >= 3:
            start, turn, now = stack[-3:]
            stroke = abs(u[turn] - u[start])
            if abs(u[now] - u[turn]) < stroke - threshold or stroke <= threshold:
                break
            back = np.sign(u[start] - u[turn]) * (u[turn:] - u[start])[: now - turn + 1] >= 0
            stop = turn + int(np.argmax(back)) if back.any() else now
            low, high = sorted((u[start], u[turn]))
            loops.append(Loop(start, turn, stop, float(low), float(high)))
            # The first curve ends on the loop that contains it, unless that goes further to the other side of the first sample.
            contained = stroke + threshold < abs(u[now] - u[turn]) <= 2 * stroke + threshold
            del stack[-3 : -2 if len(stack) == 3 and contained else -1]
    return _with_depth(sorted(loops, key=lambda loop: (loop.start, -loop.stop)))


def _with_depth(loops: list[Loop]) -> list[Loop]:
    open_until: list[int] = []
    placed = []
    for loop in loops:
        while open_until and open_until[-1] < loop.stop:
            open_until.pop()
        placed.append(dataclasses.replace(loop, depth=len(open_until)))
        open_until.append(loop.stop)
    return placed


def cycles(u: np.ndarray, threshold: float = 0.0) -> np.ndarray:
    """Whole cycles from one turning point to the next but one.

    Args:
        u: input, shape (T,).
        threshold: see `reversals`.

    Returns:
        Shape (C, 3): sample of the first turning point, of the one between, and of the third, which begins the next
        cycle. All cycles begin on the same side (at minima or at maxima).
    """
    turns = reversals(u, threshold)
    count = max((turns.size - 1) // 2, 0)
    return np.array([turns[2 * k : 2 * k + 3] for k in range(count)], dtype=int).reshape(-1, 3)


def loop_area(u: np.ndarray, y: np.ndarray) -> float:
    """Signed area of one loop [unit of u times unit of y], positive counter-clockwise.

    u and y of shape (T,); the last point is joined to the first.
    """
    x, z = np.asarray(u, dtype=float) - u[0], np.asarray(y, dtype=float) - y[0]
    return float(0.5 * np.sum(x * np.roll(z, -1) - np.roll(x, -1) * z))


def branch_means(u: np.ndarray, y: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Mean of y in bins of u, shape (B,); empty bins by interpolation between their neighbors.

    Args:
        u: input, shape (T,).
        y: output, shape (T,).
        edges: of the bins, rising [unit of u], shape (B + 1,).
    """
    where = np.clip(np.digitize(u, edges) - 1, 0, edges.size - 2)
    count = np.bincount(where, minlength=edges.size - 1)
    filled = count > 0
    mean_y = np.bincount(where, y, minlength=edges.size - 1)[filled] / count[filled]
    mean_u = np.bincount(where, u, minlength=edges.size - 1)[filled] / count[filled]
    return np.interp(0.5 * (edges[1:] + edges[:-1]), mean_u, mean_y)


def loop_branches(u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Output on the rising and on the falling branch of one loop at common inputs.

    Args:
        u: input over one loop that begins at a turning point, shape (T,).
        y: output, shape (T,).

    Returns:
        (centers [unit of u], rising [unit of y], falling [unit of y]), each of shape (B,). There are fifty bins, or fewer where a
        branch has fewer samples; they are even where the samples are nearly so, and else have equally many.
    """
    u, y = np.asarray(u, dtype=float), np.asarray(y, dtype=float)
    begins_low = u[0] < 0.5 * (u.min() + u.max())
    turn = int(np.argmax(u)) if begins_low else int(np.argmin(u))
    parts = slice(0, turn + 1), slice(turn, None)
    rising, falling = parts if begins_low else parts[::-1]
    count = int(np.clip(min(turn, u.size - turn), 4, 50))
    edges = np.linspace(u.min(), u.max(), count + 1)
    inside = np.histogram(u, edges)[0][1:-1].max()
    if inside > max(_CROWDED, 3.0 / count) * u.size:  # logarithmic steps, or a last point far in saturation
        edges = np.unique(np.quantile(u, np.linspace(0.0, 1.0, count + 1)))
    centers = 0.5 * (edges[1:] + edges[:-1])
    return centers, branch_means(u[rising], y[rising], edges), branch_means(u[falling], y[falling], edges)
