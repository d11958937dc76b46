"""The memory of relays as a staircase: an input compiled once, on the host, into the states that it visits.

A Preisach state is the sequence of its dominant extrema e_0, e_1, ..., ending at the present input, in which every interval
(e_{k-1}, e_k) lies inside the one before it. A new input keeps those extrema whose interval contains it and replaces the rest
(wiping-out). States with the same last extremum share their history, so that they form a tree, and a record visits few of its nodes.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Literal

import numpy as np

from hystfit.models.preisach.nesting import distinct, grow, levels, settle

Rest = Literal["demagnetized", "negative", "positive"]


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
        edges = np.searchsorted(levels(self.node_parent), np.arange(1, self.depth + 2))
        return [slice(int(lo), int(hi)) for lo, hi in itertools.pairwise(edges) if hi > lo]


def compile_input(v: np.ndarray, rest: Rest, center: float = 0.0) -> Staircase:
    """Compile an input into its staircase states.

    Args:
        v: input, or any rising code of it (numbers of thresholds passed), shape (T,).
        rest: state before the first sample.
        center: of the demagnetized state, in the units of v.

    Returns:
        The states, in NumPy.
    """
    v = np.asarray(v)
    fresh = np.append(True, v[1:] != v[:-1])
    run, v = np.cumsum(fresh) - 1, v[fresh]
    values, code = _codes(v)
    turns = turning_points(v)
    tree = grow(v[turns], code[turns], values.size, rest, center)
    # A sample starts from the last turning point before it; the first one from the rest.
    passed = np.zeros(v.size, dtype=int)
    passed[turns[turns + 1 < v.size] + 1] = 1
    start = np.append(-1, tree.of_turn)[np.cumsum(passed)]
    parent = settle(v.astype(float), start, tree.parent, tree.low, tree.high)
    keys, state = distinct((parent + 1) * values.size + code, (tree.value.size + 1) * values.size)
    state_parent = keys // values.size - 1
    return Staircase(tree.value, tree.parent, values[keys % values.size], state_parent, state[run], tree.depth)


def turning_points(v: np.ndarray) -> np.ndarray:
    """Positions of the first sample, the reversals and the last sample of an input without repeats."""
    if v.size < 3:
        return np.arange(v.size)
    rising = v[1:] > v[:-1]
    return np.concatenate([[0], np.flatnonzero(rising[1:] != rising[:-1]) + 1, [v.size - 1]])


def _codes(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct values and the number of each sample's."""
    if np.issubdtype(v.dtype, np.integer):
        return np.arange(v.max() + 1), v
    return np.unique(v, return_inverse=True)
