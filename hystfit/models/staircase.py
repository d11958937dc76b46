"""The memory of relays as a staircase: an input compiled once, on the host, into the states that it visits.

A Preisach state is the sequence of its dominant extrema e_0, e_1, ..., ending at the present input, in which every interval
(e_{k-1}, e_k) lies inside the one before it. A new input keeps those extrema whose interval contains it and replaces the rest
(wiping-out). States with the same last extremum share their history, so that they form a tree, and a record visits few of its nodes.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any, Literal

import numpy as np

Rest = Literal["demagnetized", "negative", "positive"]
_TABLE = 4_000_000  # largest range of keys for which counting replaces sorting


@dataclasses.dataclass(frozen=True)
class Staircase:
    """The tree of states that an input visits.

    Attributes:
        node_value: input at each dominant extremum, shape (K,), those that remember least first.
        node_parent: the extremum before it, shape (K,); -1 where it is the first after the rest state.
        state_value: input of each distinct state, shape (S,), sorted by parent.
        state_parent: the last dominant extremum before it, shape (S,), -1 as above.
        index: state of every sample, shape (T,).
        depth: most extrema that any state remembers.
    """

    node_value: np.ndarray
    node_parent: np.ndarray
    state_value: np.ndarray
    state_parent: np.ndarray
    index: np.ndarray
    depth: int

    def jumps(self) -> np.ndarray:
        """Ancestors at distance 1, 2, 4, ... of every node, shape (levels, K); K stands for none."""
        count = self.node_parent.size
        up = np.append(np.where(self.node_parent < 0, count, self.node_parent), count)
        rows = []
        while (up[:-1] < count).any():
            rows.append(up[:-1])
            up = up[up]
        return np.stack(rows) if rows else np.zeros((0, count), dtype=int)

    def layers(self) -> list[slice]:
        """The nodes that remember 1, 2, ... extrema (themselves included): each layer's parents are in the layer before."""
        edges = np.searchsorted(_levels(self.node_parent), np.arange(1, self.depth + 2))
        return [slice(int(lo), int(hi)) for lo, hi in itertools.pairwise(edges) if hi > lo]


def compile_input(v: np.ndarray, rest: Rest, center: float = 0.0) -> Staircase:
    """Compile an input into its staircase states.

    Args:
        v: input, or any rising code of it (numbers of thresholds passed), shape (T,).
        rest: state before the first sample.
        center: of the demagnetized state, in the units of v.

    Returns:
        The states; O(T + reversals), in NumPy apart from one plain loop over the reversals.
    """
    v = np.asarray(v)
    fresh = np.append(True, v[1:] != v[:-1])
    run, v = np.cumsum(fresh) - 1, v[fresh]
    turns = turning_points(v)
    nodes, parents, low, high, at_turn = _grow(v[turns].tolist(), rest, center)
    passed = np.zeros(v.size, dtype=int)
    passed[turns[turns + 1 < v.size] + 1] = 1
    start = np.append(-1, at_turn)[np.cumsum(passed)]
    parent = _settle(v, start, parents, low, high)
    level = _levels(parents)
    order = np.argsort(level, kind="stable")
    number = np.append(np.argsort(order), -1)  # the last stands for parent -1
    values, code = _codes(v)
    keys, state = _distinct((number[parent] + 1) * values.size + code, (nodes.size + 1) * values.size)
    state_parent = keys // values.size - 1
    return Staircase(
        nodes[order], number[parents[order]], values[keys % values.size], state_parent, state[run], int(level.max())
    )


def turning_points(v: np.ndarray) -> np.ndarray:
    """Positions of the first sample, the reversals and the last sample of an input without repeats."""
    if v.size < 3:
        return np.arange(v.size)
    rising = v[1:] > v[:-1]
    return np.concatenate([[0], np.flatnonzero(rising[1:] != rising[:-1]) + 1, [v.size - 1]])


def _grow(
    turns: list[Any], rest: Rest, center: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of the tree and, for every turning point, its node."""
    value: list[float] = []
    parent: list[int] = []
    low: list[float] = []
    high: list[float] = []
    known: dict[tuple[int, float], int] = {}
    visited, top = [], -1
    for v in turns:
        while top >= 0 and not low[top] < v < high[top]:
            top = parent[top]
        key = (top, v)
        node = known.get(key)
        if node is None:
            node = known[key] = len(value)
            other = _opposite(v, rest, center) if top < 0 else value[top]
            value.append(v)
            parent.append(top)
            low.append(min(v, other))
            high.append(max(v, other))
        visited.append(node)
        top = node
    return np.array(value), np.array(parent, dtype=int), np.array(low), np.array(high), np.array(visited, dtype=int)


def _opposite(v: Any, rest: Rest, center: float) -> Any:
    """The other end of the interval that the first extremum v spans."""
    return 2 * center - v if rest == "demagnetized" else -np.inf if rest == "negative" else np.inf


def _settle(v: np.ndarray, node: np.ndarray, parents: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Walk every sample up the tree from its last turning point to the extremum whose interval contains it."""
    node = node.copy()
    active = np.flatnonzero(node >= 0)
    while active.size:
        at, x = node[active], v[active]
        active = active[~((low[at] < x) & (x < high[at]))]
        node[active] = parents[node[active]]
        active = active[node[active] >= 0]
    return node


def _codes(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct values and the number of each sample's."""
    if np.issubdtype(v.dtype, np.integer):
        return np.arange(v.max() + 1), v
    return np.unique(v, return_inverse=True)


def _distinct(keys: np.ndarray, bound: int) -> tuple[np.ndarray, np.ndarray]:
    """As np.unique with inverse, by counting where the keys are few enough."""
    if bound > _TABLE:
        return np.unique(keys, return_inverse=True)
    seen = np.zeros(bound, dtype=bool)
    seen[keys] = True
    distinct = np.flatnonzero(seen)
    place = np.empty(bound, dtype=np.int32)
    place[distinct] = np.arange(distinct.size)
    return distinct, place[keys]


def _levels(parents: np.ndarray) -> np.ndarray:
    """How many extrema each node remembers, itself included."""
    level, up = np.ones(parents.size, dtype=int), parents
    while (up >= 0).any():
        level += up >= 0
        up = np.where(up >= 0, parents[up], -1)
    return level
