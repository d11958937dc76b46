"""The design matrix of a Preisach model: what its weights are multiplied by, on the distinct states that an input visits."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import scipy  # loads its subpackages when they are first used
from jaxtyping import Float
from numpy.polynomial.legendre import legval, legvander

from hystfit.models.preisach.everett import cells, first_rise_masses, fold, mirror
from hystfit.models.preisach.plane import AbstractPlane, ramps
from hystfit.models.preisach.staircase import Staircase, compile_input, together
from hystfit.models.shared.design import Factored


class Code:
    """Whole numbers that tell apart, for a grid of relays, the inputs that matter: 2 k between marks k - 1 and k, 2 k + 1 on mark k.

    The marks are the levels and, for a demagnetized start, their mirror images, so that comparing a code with a mirrored code is exact.
    """

    def __init__(self, levels: np.ndarray, center: float | None):
        self.levels = levels
        self.marks = levels
        if center is not None:
            images = 2 * center - levels
            gap = np.abs(images[:, None] - levels).min(axis=1)
            # Rounding must not part a level from its image: codes would not be symmetric.
            self.marks = np.sort(np.append(levels, images[gap > 1e-12 * (np.ptp(levels) + abs(center))]))
        self.top = 2 * self.marks.size

    def of(self, u: np.ndarray) -> np.ndarray:
        """Codes of inputs."""
        below = np.searchsorted(self.marks, u, side="left")
        on = self.marks[np.minimum(below, self.marks.size - 1)] == u
        return 2 * below + on

    def passed(self) -> tuple[np.ndarray, np.ndarray]:
        """For every code, the number of levels <= and < its inputs."""
        code = np.arange(self.top + 1)
        reached = np.append(np.searchsorted(self.levels, self.marks, side="right"), self.levels.size)
        before = np.append(np.searchsorted(self.levels, self.marks, side="left"), self.levels.size)
        # An odd code lies on its mark; an even one lies below the mark and above the one before it.
        at_most = np.where(code % 2 == 1, reached[code // 2], before[code // 2])
        return at_most, before[code // 2]


def staircase_of(model: AbstractPlane, u: np.ndarray) -> tuple[Code | None, Staircase]:
    """The states that an input visits: of the input itself for cells, of its codes for relays."""
    center = float(model.center)
    if model.elements == "cells":
        return None, compile_input(u, model.initial, center)
    code = Code(np.asarray(model.levels), center if model.initial == "demagnetized" else None)
    return code, compile_input(code.of(u), model.initial, 0.5 * code.top)


def rises_first(model: AbstractPlane, code: Code, first: np.ndarray) -> np.ndarray:
    """Whether a first excursion, given by its code, switches relays up."""
    if model.initial == "demagnetized":
        return 2 * first >= code.top
    return np.full(first.shape, model.initial == "negative")


def ties(model: AbstractPlane, code: Code, stairs: Staircase) -> np.ndarray:
    """States in which the input fell just onto a level, and the number of that level, shape (2, ties)."""
    at_most, below = code.passed()
    value, parent = stairs.state_value, stairs.state_parent
    falls = value < np.where(parent < 0, 0, stairs.node_value[parent])
    falls[parent < 0] = ~rises_first(model, code, value[parent < 0])
    at = np.flatnonzero(falls & (at_most[value] > below[value]))
    return np.stack([at, below[value[at]]])


_GRIDS = 16  # whose first excursions are kept: 10 MB of 60 levels
# Samples of several inputs whose columns are computed in one pass: 30 MB of rows where these have 150 entries.
_TOGETHER = 2**14


@dataclasses.dataclass(frozen=True)
class Triangles:
    """The basis of the columns: the cells in the triangle of each, from its beta to its alpha; mirror images may share a weight."""

    n: int
    symmetric: bool

    @property
    def shape(self) -> tuple[int, int]:
        """(triangles, weights)."""
        count = self.n * (self.n + 1) // 2
        return count, mirror(self.n)[1].shape[1] if self.symmetric else count

    def spread(self, values: Float[np.ndarray, "q k"]) -> Float[np.ndarray, "p k"]:
        """Sums over the triangles in which each cell lies."""
        columns = np.array(values, order="C")
        begin = np.arange(self.n + 1) * np.arange(1, self.n + 2) // 2  # of each row of cells
        for row in range(self.n - 2, -1, -1):
            columns[begin[row] : begin[row + 1]] += columns[begin[row + 1] : begin[row + 2] - 1]
        for first, end in itertools.pairwise(begin.tolist()):
            for cell in range(first + 1, end):
                columns[cell] += columns[cell - 1]
        return fold(columns.T, self.n).T if self.symmetric else columns

    def collected(self, weights: Float[np.ndarray, " p"]) -> Float[np.ndarray, " q"]:
        """Sums over the cells of each triangle."""
        at, square = cells(self.n), np.zeros((self.n, self.n))
        square[at] = weights[mirror(self.n)[0]] if self.symmetric else weights
        return np.cumsum(np.cumsum(square, axis=0)[:, ::-1], axis=1)[:, ::-1][at]


def features(model: AbstractPlane, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrix A on distinct states, (S, p), and the row of each sample: the output is `A @ concatenate([w, slopes, b]) + offset`."""
    columns, single_valued, index = states(model, u)
    return np.column_stack([columns, *single_valued]), index


States = tuple[Factored, list[np.ndarray], np.ndarray]


def states(model: AbstractPlane, u: np.ndarray) -> States:
    """The parts of `features`: columns of w, those of slopes and b where the model has them, and the row of each sample."""
    code, stairs = staircase_of(model, np.asarray(u, dtype=float))
    return _states(model, np.asarray(u, dtype=float), code, stairs, weight_columns(model, code, stairs))


def states_of_several(model: AbstractPlane, inputs: Sequence[np.ndarray]) -> Iterator[States]:
    """`states` of each input, in a quarter of the time for 150 reversal curves, because those of many are computed in one pass."""
    ends = np.cumsum([u.size for u in inputs])
    for part in np.split(np.arange(len(inputs)), np.flatnonzero(np.diff(ends // _TOGETHER)) + 1):
        several = [np.asarray(inputs[k], dtype=float) for k in part]
        stairs = [staircase_of(model, u) for u in several]
        if len(several) == 1 or stairs[0][0] is not None:
            yield from (states(model, u) for u in several)
            continue
        whole, places = together([one for _, one in stairs])
        columns = weight_columns(model, None, whole)
        for u, (code, one), at in zip(several, stairs, places, strict=True):
            yield _states(model, u, code, one, columns[at])


def _states(model: AbstractPlane, u: np.ndarray, code: Code | None, stairs: Staircase, columns: Factored) -> States:
    index, inputs = stairs.index, stairs.state_value
    if code is not None:  # one state serves many inputs, on which the single-valued part depends
        if not (model.slopes.size or model.b.size):
            return columns, [], index
        values, number = np.unique(u, return_inverse=True)
        keys, index = np.unique(index * values.size + number, return_inverse=True)
        columns, inputs = columns[keys // values.size], values[keys % values.size]
    return columns, _single_valued_columns(model, inputs), index


def _single_valued_columns(model: AbstractPlane, u: np.ndarray) -> list[np.ndarray]:
    """Columns of slopes and b at inputs u, shapes (len(u), intervals) and (len(u), degree)."""
    levels, center = np.asarray(model.levels), float(model.center)
    out = [np.asarray(ramps(levels, np.asarray(center), u, model.symmetric, np))] if model.slopes.size else []
    if model.b.size:
        out.append(legvander((u - center) / float(model.half), model.b.size)[:, 1:])
    return out


def output(model: AbstractPlane, u: np.ndarray) -> np.ndarray:
    """Output over an input, shape (T,): every extremum adds to the output at the one before it, and every state to that at its last one."""
    u = np.asarray(u, dtype=float)
    code, stairs = staircase_of(model, u)
    sums = Triangles(model.n, model.symmetric).collected(np.asarray(model.w))
    rest, first, pair = _host_tables(model, code, lambda rows: rows @ sums)
    added = lambda value, parent: np.concatenate(_moves(value, parent, stairs.node_value, first, pair))
    chain = added(stairs.node_value, stairs.node_parent)
    for layer in stairs.layers()[1:]:
        chain[layer] += chain[stairs.node_parent[layer]]
    y = rest + np.append(chain, 0.0)[stairs.state_parent] + added(stairs.state_value, stairs.state_parent)
    if code is None:
        return (y + _single_valued(model, stairs.state_value))[stairs.index]
    at, level = ties(model, code, stairs)
    y[at] += 2.0 * sums[level * (level + 1) // 2 + level]
    return y[stairs.index] + _single_valued(model, u)


def _single_valued(model: AbstractPlane, u: np.ndarray) -> np.ndarray:
    """`AbstractPlane.single_valued` on the host: the ramps add up to straight lines between levels and beyond them."""
    center = float(model.center)
    y = legval((u - center) / float(model.half), np.append(float(model.offset), model.b))
    if not model.slopes.size:
        return y
    levels = np.asarray(model.levels)
    knots = np.unique(np.concatenate([levels, [min(u.min(), levels[0]) - 1.0, center, max(u.max(), levels[-1]) + 1.0]]))
    return y + np.interp(
        u, knots, ramps(levels, np.asarray(center), knots, model.symmetric, np) @ np.asarray(model.slopes)
    )


def weight_columns(model: AbstractPlane, code: Code | None, stairs: Staircase) -> Factored:
    """Mean relay of every cell, or state of every relay, in each distinct state: shape (S, weights).

    A move between two extrema switches a triangle of relays. The basis has the triangles with their corners on the grid; any other one
    is a sum of six of them: E is bilinear between the corners, but for the squares of the diagonal cells (`everett`).
    """
    rest, first, pair = _host_tables(model, code, lambda rows: rows)
    own = _moves(stairs.node_value, stairs.node_parent, stairs.node_value, first, pair)
    rows = scipy.sparse.vstack(_moves(stairs.state_value, stairs.state_parent, stairs.node_value, first, pair))
    rows = rows + _ancestors(stairs) @ scipy.sparse.vstack([*own, rest], format="csr")
    if code is not None:
        at, level = ties(model, code, stairs)
        extra = (np.full(at.size, 2.0), (at, level * (level + 1) // 2 + level))
        rows = rows + scipy.sparse.coo_array(extra, shape=rows.shape).tocsr()
    rows.eliminate_zeros()
    return Factored(rows, Triangles(model.n, model.symmetric))


def _ancestors(stairs: Staircase) -> scipy.sparse.csr_array:
    """Which extrema each state remembers, shape (S, K + 1); the last column, of the rest state, is one everywhere."""
    state, node = np.arange(stairs.state_parent.size), stairs.state_parent
    pairs = [(state, np.full(state.size, stairs.node_value.size))]
    while (known := node >= 0).any():
        state, node = state[known], node[known]
        pairs.append((state, node))
        node = stairs.node_parent[node]
    rows, columns = (np.concatenate(part) for part in zip(*pairs, strict=True))
    shape = (stairs.state_parent.size, stairs.node_value.size + 1)
    return scipy.sparse.coo_array((np.ones(rows.size), (rows, columns)), shape=shape).tocsr()


Moves = Callable[[np.ndarray], Any]
Pairs = Callable[[np.ndarray, np.ndarray], Any]


def _moves(value: np.ndarray, parent: np.ndarray, nodes: np.ndarray, first: Moves, pair: Pairs) -> tuple[Any, Any]:
    """What each extremum or state adds to the one before it: those without one, and the others."""
    count = int(np.count_nonzero(parent < 0))
    now, before = value[count:], nodes[parent[count:]]
    sign, moved = np.where(now > before, 2.0, -2.0), pair(np.maximum(now, before), np.minimum(now, before))
    if scipy.sparse.issparse(moved):  # a product with a diagonal matrix takes as long as all the rest for short records
        moved.data *= np.repeat(sign, np.diff(moved.indptr))
    else:
        moved = sign * moved
    return first(value[:count]), moved


def _host_tables(model: AbstractPlane, code: Code | None, read: Moves) -> tuple[Any, Moves, Pairs]:
    """The rest state, first excursions and moves between extrema, as `read` takes sums of the triangles of the basis."""
    levels, n = np.asarray(model.levels), model.n
    if code is None:
        pair: Pairs = lambda high, low: read(_triangle_parts(levels, high, low))
        top, bottom = levels[-1], levels[0]
    else:
        at_most, below = code.passed()
        pair = lambda high, low: read(_entries(n, at_most[high, None] - 1, below[low, None], np.ones((high.size, 1))))
        top, bottom = code.top, 0
    everything = read(_entries(n, np.array([[n - 1]]), np.array([[0]]), np.ones((1, 1))))
    if model.initial == "negative":
        return -everything, lambda x: 2 * pair(x, np.full_like(x, bottom)), pair
    if model.initial == "positive":
        return everything, lambda x: -2 * pair(np.full_like(x, top), x), pair
    if code is None:  # quadratic in the input between levels and their mirror images
        knots, excursions = _excursions_of_cells(levels.tobytes(), float(model.center))
        at_knots = read(excursions)
        first: Moves = lambda x: _quadratic(knots, x) @ at_knots
    else:
        first = lambda x: read(_differences(n, _first_relays(model, x, code=code)))
    return everything - first(np.array([top])), first, pair


@functools.lru_cache(maxsize=_GRIDS)
def _excursions_of_cells(levels: bytes, center: float) -> tuple[np.ndarray, scipy.sparse.csr_array]:
    """First excursions from a demagnetized start, as sums of the triangles of the basis, at the knots and half-way between them; and these.

    They are the same for every input and all weights, and took a third of the time of a search over a relaxation of the output.
    """
    grid = np.frombuffer(levels)
    knots = np.unique(np.concatenate([grid, 2 * center - grid, [center]]))
    at = np.sort(np.append(knots, 0.5 * (knots[1:] + knots[:-1])))
    return knots, _differences(grid.size - 1, _first_cells(grid, center, at))


def _quadratic(knots: np.ndarray, x: np.ndarray) -> scipy.sparse.csr_array:
    """From values at knots and half-way between them to those at x of a function that is quadratic between knots, shape (K, 2 k - 1)."""
    at = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, knots.size - 2)
    t = np.clip((x - knots[at]) / (knots[at + 1] - knots[at]), 0.0, 1.0)
    parts = np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)], axis=1)
    places, ends = 2 * at[:, None] + np.arange(3), 3 * np.arange(x.size + 1)
    return scipy.sparse.csr_array((parts.ravel(), places.ravel(), ends), shape=(x.size, 2 * knots.size - 1))


def _entries(n: int, i: np.ndarray, j: np.ndarray, value: np.ndarray) -> scipy.sparse.csr_array:
    """Rows with the given values, shape (K, m), at the triangles of cells (i, j); those with i < j are empty."""
    inside = i >= j
    at, ends = np.where(inside, i * (i + 1) // 2 + j, 0), value.shape[1] * np.arange(len(value) + 1)
    shape = (len(value), n * (n + 1) // 2)
    return scipy.sparse.csr_array((np.where(inside, value, 0.0).ravel(), at.ravel(), ends), shape=shape)


def _triangle_parts(levels: np.ndarray, high: np.ndarray, low: np.ndarray) -> scipy.sparse.csr_array:
    """Part of each cell's area in the triangle high >= alpha >= beta >= low, as sums of the triangles of the basis, shape (K, cells).

    The triangles have upper and lower corners `high` and `low` [u], shapes (K,).
    """
    n, d = levels.size - 1, np.diff(levels)
    above, below = (np.clip(np.searchsorted(levels, u, side="right") - 1, 0, n - 1) for u in (high, low))
    f = np.clip((high - levels[above]) / d[above], 0.0, 1.0)
    g = np.clip((levels[below + 1] - low) / d[below], 0.0, 1.0)
    # Bilinear between four corners, and what the cells on the diagonal deviate from that.
    same = above == below
    bent = np.where(same, np.maximum(f + g - 1.0, 0.0) ** 2 - f * g, f**2 - f)
    i = np.stack([above, above - 1, above, above - 1, above, below], axis=1)
    j = np.stack([below, below, below + 1, below + 1, above, below], axis=1)
    four = (f * g, (1 - f) * g, f * (1 - g), (1 - f) * (1 - g))
    return _entries(n, i, j, np.stack([*four, bent, np.where(same, 0.0, g**2 - g)], axis=1))


def _differences(n: int, columns: np.ndarray) -> scipy.sparse.csr_array:
    """Columns of cells, shape (K, cells), as sums of the triangles of the basis."""
    i, j = cells(n)
    square = np.zeros((len(columns), n + 1, n + 1))
    square[:, i, j + 1] = columns
    return scipy.sparse.csr_array(np.diff(square[:, :-1], axis=2)[:, i, j] - np.diff(square[:, 1:], axis=2)[:, i, j])


def _first_cells(levels: np.ndarray, center: float, u: np.ndarray) -> np.ndarray:
    n = levels.size - 1
    i, j = cells(n)
    rows = np.arange(n)

    def rise(levels: np.ndarray, u: np.ndarray) -> np.ndarray:
        row, x = np.broadcast_arrays(rows, u[:, None])
        return np.asarray(first_rise_masses(levels, np.asarray(center), row, x, np))

    up, down = rise(levels, np.maximum(u, center)), rise(2 * center - levels[::-1], 2 * center - np.minimum(u, center))
    return 2 * (up[:, i, j] - down[:, n - 1 - j, n - 1 - i])


def _first_relays(model: AbstractPlane, x: np.ndarray, *, code: Code) -> np.ndarray:
    i, j = cells(model.n)
    alpha, beta = (np.asarray(t) for t in model.thresholds())
    above = alpha + beta > 2.0 * float(model.center)
    at_most, below = code.passed()
    rises = rises_first(model, code, x)[:, None]
    up, down = above & (i < at_most[x][:, None]), ~above & (j >= below[x][:, None])
    return 2.0 * (rises & up) - 2.0 * (~rises & down)
