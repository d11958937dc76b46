"""Starting values for a model that estimates none itself: the best point of a Latin hypercube within the scales of the data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from hystfit.data.record import Dataset, Record
from hystfit.models.starting import scales_of, thinned
from hystfit.params.coordinates import BOTH
from hystfit.params.space import ParameterSpace

_POINTS = 128
_SPREAD = 2.5  # in z: a factor of 12 either way of the natural size for a positive parameter
_RECORDS = 4  # of several records, the ones simulated


def searched_start(model: Any, records: Sequence[Record]) -> Any:
    """The model with the values, of its own and of a hypercube within its bounds, that simulate the records best.

    Linear parameters are solved for at every point, and are not part of the hypercube.

    Args:
        model: any model.
        records: measured, with time where the model needs it.
    """
    chosen = [records[k] for k in np.unique(np.linspace(0, len(records) - 1, _RECORDS).astype(int))]
    short = thinned(chosen, 200)
    space = ParameterSpace.of(model, scales=scales_of(Dataset(tuple(records))))
    free = {space.leaves[number].index for number, _, _ in space.sources}
    best, least = model, np.inf
    for z in _points(space, model):
        candidate, cost = _solved(space.tree(z), short, free)
        if cost < least:
            best, least = candidate, cost
    return best


def _points(space: ParameterSpace, model: Any) -> np.ndarray:
    """The model's own values, and the hypercube in which those that are not linear move, unconstrained, shape (count, p)."""
    own = space.unconstrained(space.vector(model))
    moved = np.array([not info.linear for info in space.infos])
    if not moved.any():
        return own[None]
    unit = qmc.LatinHypercube(own.size, rng=np.random.default_rng(0)).random(_POINTS)
    inside = 0.05 + 0.9 * unit
    over_range = np.log(inside) - np.log1p(-inside)
    both = np.array([kind == BOTH for kind in space.coordinates.kinds])
    spread = np.where(both, over_range, _SPREAD * (2 * unit - 1))
    return np.concatenate([own[None], np.where(moved, spread, own)])


def _solved(model: Any, records: Sequence[Record], free: set[int]) -> tuple[Any, float]:
    """The model with its free linear parameters solved for, and its squared error; infinite where the output is not finite."""
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
    if not (np.isfinite(columns).all() and np.isfinite(target).all()):
        return model, np.inf
    weights = np.linalg.lstsq(columns, target, rcond=1e-10)[0]
    start = 0
    for block in solved:
        part = slice(start, start := start + block.columns.shape[1])
        weights[part] = np.maximum(weights[part], block.info.bounds[0])
        leaves[block.leaf] = jnp.asarray(weights[part].reshape(np.shape(leaves[block.leaf])), jnp.result_type(float))
    return treedef.unflatten(leaves), float(np.sum((target - columns @ weights) ** 2))
