"""The linear weights of a problem: their design matrices, and derivatives without a pass for each of hundreds of weights."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import jax
import numpy as np
from jaxtyping import Float

from hystfit.data.record import Record
from hystfit.models.design import DesignMatrix
from hystfit.models.preisach.smooth import LeftOut, Offsets, SmoothSystem
from hystfit.params.space import ParameterSpace

_STEP = 1e-6  # of a central difference, relative to a parameter's size


@dataclasses.dataclass(frozen=True)
class Split:
    """The free parameters of a problem, split into the weights of its design matrices and the others.

    Attributes:
        designs: one for each record.
        system: equations of all weights, the held ones included.
        place: position of each free parameter among the weights, shape (p,); -1 for parameters that are not weights.
        record: number of the record that a per-record parameter belongs to, -1 for shared ones, shape (p,).
        held: values of the weights that are not free, NaN for the free ones.
    """

    designs: list[DesignMatrix]
    system: SmoothSystem
    place: np.ndarray
    record: np.ndarray
    held: np.ndarray

    @classmethod
    def of(
        cls,
        space: ParameterSpace,
        records: Sequence[Record],
        x: np.ndarray,
        *,
        left_out: LeftOut = "auto",
        offsets: Offsets = "each",
    ) -> Split:
        """Split at given values of the other parameters.

        Values of x that are weights do not matter. `left_out` and `offsets` are those of `SmoothSystem.of`.
        """
        c = space.coordinates
        models = [space.assembled(x, k) for k in range(len(records))]
        designs = [model.design_matrix(r.u, r.dt) for model, r in zip(models, records, strict=True)]
        system = SmoothSystem.of(designs, records, left_out=left_out, offsets=offsets)
        first = {block.leaf: start for block, start in zip(system.blocks, system.starts, strict=False)}
        width = {block.leaf: block.columns.shape[1] for block in system.blocks}
        ends = dict(zip(first, system.starts[1:], strict=True))
        place: list[int] = []
        record: list[int] = []
        for leaf, positions, several in c.layout:
            for number in range(len(records) if several else 1):
                shift = number * width[leaf] if leaf in first and ends[leaf] - first[leaf] > width[leaf] else 0
                record += [number if several else -1] * len(positions)
                place += [first[leaf] + shift + k if leaf in first else -1 for k in positions]
        values = jax.tree_util.tree_leaves(space.template)
        held = np.zeros(system.starts[-1])
        for leaf, start in first.items():
            held[start : ends[leaf]] = np.resize(np.asarray(values[leaf], dtype=float), ends[leaf] - start)
        where = np.array(place, dtype=int)
        held[where[where >= 0]] = np.nan
        return cls(designs, system, where, np.array(record, dtype=int), held)


def responses(
    space: ParameterSpace,
    records: Sequence[Record],
    predict: Callable[[np.ndarray], list[np.ndarray]],
    x: np.ndarray,
    length: int,
) -> Float[np.ndarray, "R T p"]:
    """Derivatives of every sample with respect to every free parameter of a model with design matrices.

    Exact columns for the weights, central differences of look-ups for the few others: no scan needs to be compiled.

    `predict` gives the output of every record at physical parameters; `length` is the padded length T.
    """
    now = Split.of(space, records, x)
    rows = np.zeros((len(records), length, x.size))
    for number, (record, design) in enumerate(zip(records, now.designs, strict=True)):
        for block, start, end in zip(now.system.blocks, now.system.starts, now.system.starts[1:], strict=False):
            width = block.columns.shape[1]
            first = start + number * width if end - start > width else start
            mine = np.flatnonzero(
                (now.place >= first) & (now.place < first + width) & np.isin(now.record, (-1, number))
            )
            source = next(b for b in design.blocks if b.leaf == block.leaf).columns
            rows[number, : len(record), mine] = source[:, now.place[mine] - first][design.index].T
    for k in np.flatnonzero(now.place < 0):
        step = _STEP * max(abs(x[k]), space.scale[k]) * np.eye(x.size)[k]
        above, below = np.minimum(x + step, space.upper), np.maximum(x - step, space.lower)
        for row, high, low in zip(rows, predict(above), predict(below), strict=True):
            row[: high.size, k] = (high - low) / (above[k] - below[k])
    return rows
