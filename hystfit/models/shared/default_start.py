"""Starting values for a model that estimates none itself: the best point of a Latin hypercube within the scales of the data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.models.shared.starting import scales_of, thinned
from hystfit.params.hypercube import spread_points
from hystfit.params.space import ParameterSpace

_POINTS = 128  # of the spread design over the parameters that move
_SPREAD = 2.0  # in z: a factor of 7 either way of the natural size for a positive parameter
_TESTED = 40  # points tested for the influence of every parameter
_NUDGE, _LEAST = 0.3, 1e-3  # change of z in that test, and the least change of the output as a part of its range


def hypercube_start(model: Any, records: Sequence[Record]) -> Any:
    """The model with the values that simulate the records best, among its own and those of a hypercube within its bounds.

    Linear parameters are solved for at every point, and are not part of the hypercube. Points at which one of the others has no
    influence on the output (a play wider than the input's range) come last: no solver finds a way from there.
    """
    few = np.unique(np.linspace(0, len(records) - 1, 4).astype(int))
    chosen = [records[k] for k in few]
    short = thinned(chosen, 200) if model.allows_thinning else chosen
    space = ParameterSpace.of(model, scales=scales_of(Dataset(tuple(records))))
    free = {space.leaves[number].index for number, _, _ in space.sources}
    moved = np.flatnonzero(~space.linear)
    solve = lambda z: _solved(space.tree(z), short, free)
    found = [(z, point) for z in _points(space, model, moved) if np.isfinite((point := solve(z)).cost)]
    found.sort(key=lambda item: item[1].cost)
    for z, point in found[:_TESTED]:
        nearby = (solve(z + _NUDGE * np.eye(z.size)[k]) for k in moved)
        if all(np.max(np.abs(other.output - point.output)) > _LEAST * np.ptp(point.output) for other in nearby):
            return point.model
    return found[0][1].model if found else model


class _Point(NamedTuple):
    """A model with its linear parameters solved for, its squared error, and its output on the records, shape (n,)."""

    model: Any
    cost: float
    output: np.ndarray


def _points(space: ParameterSpace, model: Any, moved: np.ndarray) -> np.ndarray:
    """The model's own values, and the hypercube in which those numbered in `moved` move, unconstrained, shape (count, p)."""
    own = space.unconstrained(space.vector(model))
    if not moved.size:
        return own[None]
    spread = spread_points(space.coordinates, np.zeros(own.size), _POINTS, 0, spread=_SPREAD)
    points = np.tile(own, (_POINTS + 1, 1))
    points[1:, moved] = spread[:, moved]
    return points


def _solved(model: Any, records: Sequence[Record], free: set[int]) -> _Point:
    """The point of a model, with an infinite error where its output is not finite; `free` are the leaves that are not fixed."""
    leaves, treedef = jax.tree_util.tree_flatten(model)
    values = lambda block: np.ravel(np.asarray(leaves[block.leaf]))
    rows, targets, solved = [], [], []
    for record in records:
        design = model.design_matrix(record.u, None if record.t is None else record.dt).rows()
        held = sum((b.columns @ values(b) for b in design.blocks if b.leaf not in free), start=design.rest)
        solved = [block for block in design.blocks if block.leaf in free]
        columns = np.concatenate([np.zeros((held.size, 0)), *(block.columns for block in solved)], axis=1)
        rows.append(columns[record.used])
        targets.append((record.y - held)[record.used])
    columns, target = np.concatenate(rows), np.concatenate(targets)
    measured = np.concatenate([record.y[record.used] for record in records])
    if not (np.isfinite(columns).all() and np.isfinite(target).all()):
        return _Point(model, np.inf, target)
    weights = np.linalg.lstsq(columns, target, rcond=1e-10)[0]
    start = 0
    for block in solved:
        part = slice(start, start := start + block.columns.shape[1])
        weights[part] = np.maximum(weights[part], block.info.bounds[0])
        leaves[block.leaf] = jnp.asarray(weights[part].reshape(np.shape(leaves[block.leaf])), jnp.result_type(float))
    rest = target - columns @ weights
    return _Point(treedef.unflatten(leaves), float(rest @ rest), measured - rest)
