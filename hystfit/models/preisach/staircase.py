"""The memory of relays as a staircase: an input compiled once, on the host, into the states that it visits.

A Preisach state is the sequence of its dominant extrema e_0, e_1, ..., ending at the present input, in which every interval
(e_{k-1}, e_k) lies inside the one before it. A new input keeps those extrema whose interval contains it and replaces the rest
(wiping-out). States with the same last extremum share their history, so that they form a tree, and a record visits few of its nodes.

A turning point's parent is the extremum that remained before it: the last one whose interval contains it. Going through the reversals one
by one finds it with a stack. Many at a time: a pair of reversals B, C between A and D closes a loop when C lies within A to B and
B within C to D. D wipes both out, so that later states do not depend on them. Pairs are taken out in passes until few are left
(noise leaves a third after each), a stack serves those, and the pairs come back in reverse order, each on the way from A to D.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from hystfit.params.host_arrays import NUMBERS

Rest = Literal["demagnetized", "negative", "positive"]
_WORTH = 1 / 16  # part of the reversals that a pass must take out to be worth another
_FEW = 64  # reversals left to the stack


@dataclasses.dataclass(frozen=True)
class Staircase:
    """The tree of states that an input visits."""

    node_value: np.ndarray  # input at each dominant extremum, shape (K,), those that remember least first
    node_parent: np.ndarray  # the extremum before it, shape (K,); -1 where it is the first after the rest state
    state_value: np.ndarray  # input of each distinct state, shape (S,), sorted by parent
    state_parent: np.ndarray  # the last dominant extremum before it, shape (S,), -1 as above
    index: np.ndarray  # state of every sample, shape (T,)
    depth: int  # most extrema that any state remembers

    def layers(self) -> list[slice]:
        """The nodes that remember 1, 2, ... extrema (themselves included): each layer's parents are in the layer before."""
        edges = np.searchsorted(levels(self.node_parent), np.arange(1, self.depth + 2))
        return [slice(int(lo), int(hi)) for lo, hi in itertools.pairwise(edges) if hi > lo]


def compile_input(v: np.ndarray, rest: Rest, center: float = 0.0) -> Staircase:
    """Compile an input, or a rising code of it (numbers of thresholds passed), shape (T,), into its states, from the rest before it."""
    v = np.asarray(v)
    fresh = np.append(True, v[1:] != v[:-1])
    run, v = np.cumsum(fresh) - 1, v[fresh]
    whole = np.issubdtype(v.dtype, np.integer)
    values, code = (np.arange(v.max() + 1), v) if whole else np.unique(v, return_inverse=True)
    turns = turning_points(v)
    tree = build_tree(v[turns], code[turns], values.size, rest, center)
    # A sample starts from the last turning point before it; the first one from the rest.
    passed = np.zeros(v.size, dtype=int)
    passed[turns[turns + 1 < v.size] + 1] = 1
    start = np.append(-1, tree.of_turn)[np.cumsum(passed)]
    parent = enclosing_nodes(v.astype(float), start, tree.parent, tree.low, tree.high)
    keys, state = distinct((parent + 1) * values.size + code, (tree.value.size + 1) * values.size)
    state_parent = keys // values.size - 1
    return Staircase(tree.value, tree.parent, values[keys % values.size], state_parent, state[run], tree.depth)


def together(stairs: Sequence[Staircase]) -> tuple[Staircase, list[np.ndarray]]:
    """The states of several inputs as those of one, which are computed in one pass; and where those of each input are."""
    ends = [
        np.cumsum([0, *sizes]) for sizes in zip(*((s.node_value.size, s.state_value.size) for s in stairs), strict=True)
    ]
    parent, state_parent = (
        np.concatenate([np.where(own < 0, -1, own + first) for own, first in zip(parents, ends[0], strict=False)])
        for parents in ([s.node_parent for s in stairs], [s.state_parent for s in stairs])
    )
    order = np.argsort(levels(parent), kind="stable")
    place = np.append(np.argsort(order), -1)
    state_parent = place[state_parent]
    by_parent = np.argsort(state_parent, kind="stable")
    parts = np.split(np.argsort(by_parent), ends[1][1:-1])
    whole = Staircase(
        np.concatenate([s.node_value for s in stairs])[order],
        place[parent][order],
        np.concatenate([s.state_value for s in stairs])[by_parent],
        state_parent[by_parent],
        np.concatenate([part[s.index] for part, s in zip(parts, stairs, strict=True)]),
        max(s.depth for s in stairs),
    )
    return whole, parts


def turning_points(v: np.ndarray) -> np.ndarray:
    """Positions of the first sample, the reversals and the last sample of an input without repeats."""
    if v.size < 3:
        return np.arange(v.size)
    rising = v[1:] > v[:-1]
    return np.concatenate([[0], np.flatnonzero(rising[1:] != rising[:-1]) + 1, [v.size - 1]])


# -- the tree of dominant extrema ------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Tree:
    """Extrema, those that remember least first."""

    value: np.ndarray  # shape (K,)
    parent: np.ndarray  # the extremum before it, shape (K,); -1 where there is none
    low: np.ndarray  # low, high: interval of the inputs that leave it in the memory, open, shapes (K,)
    high: np.ndarray
    of_turn: np.ndarray  # extremum at every turning point, shape (m,)
    depth: int  # most extrema on a way to the root


def build_tree(v: np.ndarray, code: np.ndarray, codes: int, rest: str, center: float) -> Tree:
    """The tree of turning points v, (m,), neighbors different; whole numbers `code` below `codes` tell their values apart."""
    given, v = v, np.asarray(v, dtype=float)
    parent, level = np.full(v.size, -1), np.ones(v.size, dtype=np.int32)
    low, high = np.empty(v.size), np.empty(v.size)
    kept, passes = closed_pairs(v)
    parent[kept], level[kept], low[kept], high[kept] = _stack(v[kept], rest, center, kept)
    for a, b, c in reversed(passes):
        for start, now in ((a, b), (b, c)):
            x = v[now]
            parent[now] = above = enclosing_nodes(x, start, parent, low, high)
            other = np.where(above < 0, opposite(x, rest, center), v[above])
            low[now], high[now] = np.minimum(x, other), np.maximum(x, other)
            level[now] = np.where(above < 0, 1, level[above] + 1)
    return _merge(given, code, codes, parent, level, low, high)


def closed_pairs(v: np.ndarray) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """Take out pairs B, C that close a loop, pass after pass: positions left, and of each pass (A, B, C), A the last left before each B."""
    kept, passes = np.arange(v.size), []
    while kept.size > _FEW:
        x = v[kept]
        a, b, c, d = x[:-3], x[1:-2], x[2:-1], x[3:]
        closes = np.where(b > a, (c >= a) & (d >= b), (c <= a) & (d <= b))
        # Pairs that share a point are taken out in turn: every other one of a run now.
        at = np.arange(closes.size)
        run = np.maximum.accumulate(np.where(closes, -1, at))
        first = np.flatnonzero(closes & ((at - run) % 2 == 1)) + 1
        if first.size < _WORTH * kept.size:
            break
        left = np.ones(kept.size, dtype=bool)
        left[first] = left[first + 1] = False
        before = np.maximum.accumulate(np.where(left, np.arange(kept.size), 0))[first]
        passes.append((kept[before], kept[first], kept[first + 1]))
        kept = kept[left]
    return kept, passes


def _stack(v: np.ndarray, rest: str, center: float, names: np.ndarray) -> tuple[np.ndarray, ...]:
    """Parents (by name), levels and intervals of a few turning points, one after the other."""
    values = v.tolist()
    above: list[int] = []
    level: list[int] = []
    low: list[float] = []
    high: list[float] = []
    top = -1
    for number, x in enumerate(values):
        while top >= 0 and not low[top] < x < high[top]:
            top = above[top]
        other = opposite(x, rest, center) if top < 0 else values[top]
        above.append(top)
        level.append(1 if top < 0 else level[top] + 1)
        low.append(x if x < other else other)
        high.append(other if x < other else x)
        top = number
    return np.append(names, -1)[above], np.array(level), np.array(low), np.array(high)


def opposite(v: Any, rest: str, center: float) -> Any:
    """The other end of the interval that a first extremum v spans; numbers or arrays."""
    return 2 * center - v if rest == "demagnetized" else -np.inf if rest == "negative" else np.inf


def enclosing_nodes(
    v: np.ndarray, node: np.ndarray, parent: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Walk up the tree from nodes (-1: none) to those whose interval (low, high) contains the inputs v, shape (K,); -1 where none does."""
    node = node.copy()
    active = np.flatnonzero(node >= 0)
    while active.size:
        at, x = node[active], v[active]
        active = active[~((low[at] < x) & (x < high[at]))]
        node[active] = parent[node[active]]
        active = active[node[active] >= 0]
    return node


def _merge(
    v: np.ndarray,
    code: np.ndarray,
    codes: int,
    parent: np.ndarray,
    level: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> Tree:
    """One node for all turning points with the same value and history, layer by layer from the root."""
    depth = int(level.max())
    order = np.argsort(level.astype(np.uint16) if depth < 2**16 else level, kind="stable")
    edges = np.append(0, np.cumsum(np.bincount(level)[1:]))
    of_turn = np.full(v.size + 1, -1)  # the last stands for parent -1
    chosen, count, root = [], 0, -1
    for start, stop in itertools.pairwise(edges.tolist()):
        mine = order[start:stop]
        keys = (of_turn[parent[mine]] - root) * codes + code[mine]
        found, place = distinct(keys, max(count - root, 1) * codes)
        one = np.empty(found.size, dtype=int)
        one[place] = mine
        chosen.append(one)
        of_turn[mine] = count + place
        root, count = count, count + found.size
    at = np.concatenate(chosen)
    return Tree(v[at], of_turn[parent[at]], low[at], high[at], of_turn[:-1], depth)


def levels(parent: np.ndarray) -> np.ndarray:
    """How many extrema lie on the way from each to the root, itself included: by jumps that double."""
    level, up = np.ones(parent.size, dtype=int), parent
    while (up >= 0).any():
        level += np.where(up >= 0, level[up], 0)
        up = np.where(up >= 0, up[up], -1)
    return level


def distinct(keys: np.ndarray, bound: int) -> tuple[np.ndarray, np.ndarray]:
    """As np.unique with inverse, for whole numbers below a bound: by counting where the range is small and well filled."""
    if bound > min(NUMBERS, 256 * keys.size):
        return np.unique(keys, return_inverse=True)
    seen = np.zeros(bound, dtype=bool)
    seen[keys] = True
    found = np.flatnonzero(seen)
    place = np.empty(bound, dtype=np.int32)
    place[found] = np.arange(found.size)
    return found, place[keys]
