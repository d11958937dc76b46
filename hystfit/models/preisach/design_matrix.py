"""The design matrix of a Preisach model: what its weights are multiplied by, on the distinct states that an input visits."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from numpy.polynomial.legendre import legvander

from hystfit.models.preisach.compiled import Code, rises_first, staircase_of, ties
from hystfit.models.preisach.everett import cells, first_rise_masses, fold
from hystfit.models.preisach.plane import AbstractPlane, ramps
from hystfit.models.preisach.staircase import Staircase


def features(model: AbstractPlane, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Design matrix on distinct states: the output is `A @ concatenate([w, slopes, b]) + offset`, A one row per state.

    The weights of the model do not matter.

    Returns:
        A of shape (S, p), and the row of each sample, shape (T,).
    """
    u = np.asarray(u, dtype=float)
    code, stairs = staircase_of(model, u)
    columns = weight_columns(model, code, stairs)
    index, inputs = stairs.index, stairs.state_value
    if code is not None:  # one state serves many inputs, on which the single-valued part depends
        if not (model.slopes.size or model.b.size):
            return columns, index
        values, number = np.unique(u, return_inverse=True)
        keys, index = np.unique(index * values.size + number, return_inverse=True)
        columns, inputs = columns[keys // values.size], values[keys % values.size]
    return np.column_stack([columns, *_single_valued_columns(model, inputs)]), index


def _single_valued_columns(model: AbstractPlane, u: np.ndarray) -> list[np.ndarray]:
    """Columns of slopes and b at inputs u, shapes (len(u), intervals) and (len(u), degree)."""
    levels, center = np.asarray(model.levels), float(model.center)
    out = [np.asarray(ramps(levels, np.asarray(center), u, model.symmetric, np))] if model.slopes.size else []
    if model.b.size:
        out.append(legvander((u - center) / float(model.half), model.b.size)[:, 1:])
    return out


def weight_columns(model: AbstractPlane, code: Code | None, stairs: Staircase) -> np.ndarray:
    """Mean relay of every cell, or state of every relay, in each distinct state: shape (S, weights)."""
    rest, first, pair = _host_tables(model, code)
    own = _own_columns(stairs.node_value, stairs.node_parent, stairs.node_value, first, pair)
    for layer in stairs.layers()[1:]:
        own[layer] += own[stairs.node_parent[layer]]
    before = np.concatenate([own, np.zeros((1, own.shape[1]))])[stairs.state_parent]
    columns = before + rest + _own_columns(stairs.state_value, stairs.state_parent, stairs.node_value, first, pair)
    if code is not None:
        at, level = ties(model, code, stairs)
        columns[at] += 2 * _fold(model, np.eye(model.n * (model.n + 1) // 2)[level * (level + 1) // 2 + level])
    return columns


Columns = Callable[[np.ndarray], np.ndarray]
Pairs = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _own_columns(value: np.ndarray, parent: np.ndarray, nodes: np.ndarray, first: Columns, pair: Pairs) -> np.ndarray:
    count = int(np.count_nonzero(parent < 0))
    now, before = value[count:], nodes[parent[count:]]
    sign = np.where(now > before, 2.0, -2.0)[:, None]
    return np.concatenate([first(value[:count]), sign * pair(np.maximum(now, before), np.minimum(now, before))])


def _fold(model: AbstractPlane, columns: np.ndarray) -> np.ndarray:
    return fold(columns, model.n) if model.symmetric else columns


def _host_tables(model: AbstractPlane, code: Code | None) -> tuple[np.ndarray, Columns, Pairs]:
    """Columns of the rest state, of first excursions and of moves between extrema."""
    levels = np.asarray(model.levels)
    if code is None:
        pair = lambda high, low: _fold(model, triangle_parts(levels, high, low))
        top, bottom = levels[-1], levels[0]
    else:
        i, j = cells(model.n)
        at_most, below = code.passed()
        pair = lambda high, low: _fold(model, 1.0 * ((i < at_most[high][:, None]) & (j >= below[low][:, None])))
        top, bottom = code.top, 0
    everything = _fold(model, np.ones(model.n * (model.n + 1) // 2))
    if model.initial == "negative":
        return -everything, lambda x: 2 * pair(x, np.full_like(x, bottom)), pair
    if model.initial == "positive":
        return everything, lambda x: -2 * pair(np.full_like(x, top), x), pair
    parts = _first_cells if code is None else functools.partial(_first_relays, code=code)
    first = lambda x: _fold(model, parts(model, x))
    return everything - first(np.array([top]))[0], first, pair


def triangle_parts(levels: np.ndarray, high: np.ndarray, low: np.ndarray) -> np.ndarray:
    """Part of each cell's area in the triangle high >= alpha >= beta >= low, shape (K, n (n + 1) / 2).

    The triangles have upper and lower corners `high` and `low` [u], shapes (K,).
    """
    n = levels.size - 1
    i, j = cells(n)
    d = np.diff(levels)
    below = np.clip((high[:, None] - levels[:-1]) / d, 0.0, 1.0)
    above = np.clip((levels[1:] - low[:, None]) / d, 0.0, 1.0)
    parts = below[:, i] * above[:, j]
    side = np.minimum(high[:, None], levels[1:]) - np.maximum(low[:, None], levels[:-1])
    parts[:, i == j] = (np.maximum(side, 0.0) / d) ** 2
    return parts


def _first_cells(model: AbstractPlane, u: np.ndarray) -> np.ndarray:
    levels, center, n = np.asarray(model.levels), np.asarray(model.center), model.n
    i, j = cells(n)
    rows = np.arange(n)

    def rise(levels: np.ndarray, u: np.ndarray) -> np.ndarray:
        row, x = np.broadcast_arrays(rows, u[:, None])
        return np.asarray(first_rise_masses(levels, center, row, x, np))

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
