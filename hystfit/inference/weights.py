"""The linear weights of a problem: their design matrices, and derivatives without a pass for each of hundreds of weights."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence

import jax
import numpy as np
from jaxtyping import Float

from hystfit.data.record import Record
from hystfit.errors import ParameterError
from hystfit.inference.blocks import parts
from hystfit.models.preisach.model import Preisach
from hystfit.models.preisach.smooth_system import Layout, SmoothSystem
from hystfit.models.shared.design import DesignMatrix, Factored
from hystfit.params.space import ParameterSpace
from hystfit.quality.held_out import HeldOut

_STEP = 1e-6  # of a central difference, relative to a parameter's size


@dataclasses.dataclass(frozen=True)
class Split:
    """The free parameters of a problem, split into the weights of its design matrices and the others."""

    system: SmoothSystem  # equations of all weights, the held ones included
    # position of each free parameter among the weights, shape (p,); -1 for parameters that are not weights
    place: np.ndarray
    record: np.ndarray  # number of the record that a per-record parameter belongs to, -1 for shared ones, shape (p,)
    fixed: np.ndarray  # values of the weights that are not free, NaN for the free ones

    @classmethod
    def of(
        cls, space: ParameterSpace, records: Sequence[Record], x: np.ndarray, *, held: HeldOut | None = None
    ) -> Split:
        """Split at values x of the other parameters (those of weights do not matter); `held` is that of `SmoothSystem.of`."""
        if space.ties:
            raise ParameterError("tied parameters need another method than 'preisach': choose method='lm'")
        system = SmoothSystem.of(_designs(space, records, x), records, held=held)
        return cls._split(space, system, len(records))

    @classmethod
    def _split(cls, space: ParameterSpace, system: SmoothSystem, records: int) -> Split:
        place, record = _placed(space, system.layout, records)
        fixed = _fixed(space, system.layout)
        fixed[place[place >= 0]] = np.nan
        return cls(system, place, record, fixed)

    def beside(self, own: ParameterSpace, space: ParameterSpace, records: int) -> Split | None:
        """The same equations for weights of a space with other bounds, as masses of either sign; None where the columns may differ."""
        mine, others = (jax.tree_util.tree_leaves(one.template) for one in (own, space))
        weights = {block.leaf for block in self.system.layout.blocks}
        pairs = enumerate(zip(mine, others, strict=False))
        alike = all(np.shape(a) == np.shape(b) and (k in weights or np.array_equal(a, b)) for k, (a, b) in pairs)
        if len(mine) != len(others) or not alike or own.template.settings() != space.template.settings():
            return None
        return self._split(space, self.system.bounded_by({leaf.index: leaf.info for leaf in space.leaves}), records)

    def gram(self, x: np.ndarray, unit: float) -> Float[np.ndarray, "p1 p1"]:
        """Normal matrix of [derivatives of the misfit, misfit] at x, where all free parameters are weights: no pass over the samples."""
        system, weights = self.system, self.fixed.copy()
        weights[self.place] = x
        total = system.grams.sum(axis=0)
        misfit = np.append(weights - system.origin * system.size, -system.size)
        products = total @ misfit
        gram = np.empty((x.size + 1, x.size + 1))
        gram[:-1, :-1] = total.take(self.place, 0).take(self.place, 1)
        gram[-1, :-1] = gram[:-1, -1] = products[self.place]
        gram[-1, -1] = max(float(misfit @ products), 0.0)
        return gram / unit**2


def _designs(space: ParameterSpace, records: Sequence[Record], x: np.ndarray) -> Iterator[DesignMatrix]:
    """Design matrices of the records, made when they are wanted for: those of all records would take far more memory than the sums."""
    models = space.of_records(x, len(records), np.asarray)
    first = next(models)
    if isinstance(first, Preisach):  # whose records differ in weights alone
        return first.design_matrices([record.u for record in records])
    models = itertools.chain([first], models)
    return (model.design_matrix(record.u, record.dt) for model, record in zip(models, records, strict=True))


def _placed(space: ParameterSpace, layout: Layout, records: int) -> tuple[np.ndarray, np.ndarray]:
    """`place` and `record` of `Split`."""
    number_of = {block.leaf: number for number, block in enumerate(layout.blocks)}
    place: list[int] = []
    owner: list[int] = []
    for leaf, positions, several in space.coordinates.layout:
        for record in range(records if several else 1):
            owner += [record if several else -1] * len(positions)
            first = layout.first(number_of[leaf], record) if leaf in number_of else None
            place += [-1 if first is None else first + k for k in positions]
    return np.array(place, dtype=int), np.array(owner, dtype=int)


def weighted_columns(
    space: ParameterSpace, records: Sequence[Record], x: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Columns of the weights `at` positions, (n, k), and the output less the response without them, (n,), times roots of the weights."""
    designs = _designs(space, records, x)
    layout = Layout.of(first := next(designs), len(records))
    place, _ = _placed(space, layout, len(records))
    values = _fixed(space, layout, x)
    values[place[place >= 0]] = x[place >= 0]
    values[place[at]] = 0.0
    columns, target = [], []
    for number, (record, design) in enumerate(zip(records, itertools.chain([first], designs), strict=True)):
        used, rest = record.used, design.rest.copy()
        index, root = design.index[used], np.sqrt(record.weight[used])
        solved = np.zeros((index.size, at.size))
        for position, block in enumerate(design.blocks):  # block after block: no copy of the whole matrix
            part, start = block.columns, layout.first(position, number)
            rest += part @ values[start : start + part.shape[1]]
            wanted = np.flatnonzero((place[at] >= start) & (place[at] < start + part.shape[1]))
            part = np.asarray(part) if wanted.size else part
            for k in wanted:
                solved[:, k] = part[index, place[at[k]] - start]
        rest = rest[index]
        columns.append(solved)
        if (root != 1).any():
            solved *= root[:, None]
        target.append((record.y[used] - rest) * root)
    return columns[0] if len(columns) == 1 else np.concatenate(columns), np.concatenate(target)


def column_products(
    space: ParameterSpace, records: Sequence[Record], x: np.ndarray, sides: Float[np.ndarray, "n q"]
) -> Float[np.ndarray, "w q"]:
    """Products of the columns of all weights with samples of the records that count, both times roots of the weights of the samples."""
    designs = _designs(space, records, x)
    layout = Layout.of(first := next(designs), len(records))
    total, end = np.zeros((layout.starts[-1], sides.shape[1])), 0
    for number, (record, design) in enumerate(zip(records, itertools.chain([first], designs), strict=True)):
        used = record.used
        begin, end = end, end + int(np.count_nonzero(used))
        states = np.zeros((design.rest.size, sides.shape[1]))
        np.add.at(states, design.index[used], np.sqrt(record.weight[used])[:, None] * sides[begin:end])
        for position, block in enumerate(design.blocks):
            start = layout.first(position, number)
            columns = block.columns
            product = columns.transposed_product(states) if isinstance(columns, Factored) else columns.T @ states
            total[start : start + len(product)] += product
    return total


def _fixed(space: ParameterSpace, layout: Layout, x: np.ndarray | None = None) -> np.ndarray:
    """The template's values of all weights, with those of tied ones at x."""
    tree = space.template if x is None or not space.ties else space.assembled(x)
    values, leaves = np.zeros(layout.starts[-1]), jax.tree_util.tree_leaves(tree)
    for block, start, end in zip(layout.blocks, layout.starts, layout.starts[1:], strict=False):
        values[start:end] = np.resize(np.asarray(leaves[block.leaf], dtype=float), end - start)
    return values


def responses(
    space: ParameterSpace, records: Sequence[Record], predict: Callable[[np.ndarray], list[np.ndarray]], x: np.ndarray
) -> Iterator[tuple[int, slice, Float[np.ndarray, "T p"]]]:
    """Number of the record, samples, and their derivatives by every free parameter of a model with design matrices, block after block.

    Exact columns for the weights, central differences of look-ups for the few others: no scan needs to be compiled. `predict` gives the
    output of every record at physical parameters.
    """
    designs = _designs(space, records, x)
    layout = Layout.of(first := next(designs), len(records))
    place, owner = _placed(space, layout, len(records))
    others = np.flatnonzero(place < 0)
    slopes = [_difference(space, predict, x, int(k)) for k in others]
    for number, design in enumerate(itertools.chain([first], designs)):
        mine = np.flatnonzero((place >= 0) & np.isin(owner, (-1, number)))
        columns = layout.columns(design, number)
        for part in parts(design.index.size, x.size):
            rows = np.zeros((part.stop - part.start, x.size))
            rows[:, mine] = columns[np.ix_(design.index[part], place[mine])]
            for k, slope in zip(others, slopes, strict=True):
                rows[:, k] = slope[number][part]
            yield number, part, rows


def _difference(
    space: ParameterSpace, predict: Callable[[np.ndarray], list[np.ndarray]], x: np.ndarray, k: int
) -> list[np.ndarray]:
    """Derivative of the output of every record with respect to parameter k, by a central difference inside its bounds."""
    step = _STEP * max(abs(x[k]), space.scale[k]) * np.eye(x.size)[k]
    above, below = np.minimum(x + step, space.upper), np.maximum(x - step, space.lower)
    pairs = zip(predict(above), predict(below), strict=True)
    return [(high - low) / (above[k] - below[k]) for high, low in pairs]


def free_columns(
    space: ParameterSpace, design: DesignMatrix, number: int, records: int
) -> tuple[Float[np.ndarray, "S p"], Float[np.ndarray, " S"]]:
    """Columns of all free parameters of a linear model on distinct states, in a record, and the output where these are zero."""
    layout = Layout.of(design, records)
    place, owner = _placed(space, layout, records)
    fixed = _fixed(space, layout)
    fixed[place] = 0.0
    joint = layout.columns(design, number)
    mine = np.isin(owner, (-1, number))
    return np.where(mine, joint[:, place], 0.0), design.rest + joint @ fixed


def smoothness_penalty(space: ParameterSpace, records: Sequence[Record], x: np.ndarray) -> Float[np.ndarray, "p p"]:
    """Matrix of the smoothness penalty on the free parameters; zero for those without one, and for models without design matrices."""
    matrix = np.zeros((x.size, x.size))
    if space.assembled(x, 0).estimator != "preisach":
        return matrix
    layout = Layout.of(next(_designs(space, records, x)), len(records))
    place, _ = _placed(space, layout, len(records))
    for block, start, end in zip(layout.blocks, layout.starts, layout.starts[1:], strict=False):
        if block.penalty is not None:
            at = np.flatnonzero((place >= start) & (place < end))
            matrix[np.ix_(at, at)] = block.penalty.matrix[np.ix_(place[at] - start, place[at] - start)]
    return matrix
