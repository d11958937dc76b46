"""Normal equations of smooth weights, collected from design matrices, for every held-out group of samples apart."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import scipy  # loads its subpackages when they are first used
from jaxtyping import Float

from hystfit.data.record import Record
from hystfit.models.shared.design import FAR, Basis, Block, Columns, DesignMatrix, Factored
from hystfit.params.host_arrays import NUMBERS
from hystfit.params.param import ParamInfo
from hystfit.quality.held_out import HeldOut, Scheme, held_out
from hystfit.runs.threads import Workers

# Part of the entries of rows that are not zero, above which their dense product takes less time: measured at 1176 and 1891 columns.
_SPARSE = 0.08


@dataclasses.dataclass(frozen=True)
class Layout:
    """Where the columns of design matrices stand in one matrix for all records, block after block."""

    blocks: tuple[Block, ...]  # of the design matrix of the first record
    # whether each record has weights of its own for a block; those of all records then stand in turn
    own: tuple[bool, ...]
    starts: tuple[int, ...]  # position of each block's first weight, and the number of all weights

    @classmethod
    def of(cls, design: DesignMatrix, records: int) -> Layout:
        """The layout for records whose design matrices have the same blocks."""
        blocks = design.blocks
        own = tuple(block.info.per_record for block in blocks)
        widths = [block.columns.shape[1] * (records if each else 1) for block, each in zip(blocks, own, strict=True)]
        return cls(blocks, own, tuple(np.cumsum([0, *widths]).tolist()))

    @property
    def levels(self) -> np.ndarray:
        """Which weights are a constant output, shape (p,), 1 or 0."""
        out = np.zeros(self.starts[-1])
        for block, start, end in zip(self.blocks, self.starts, self.starts[1:], strict=False):
            out[start:end] = (
                (block.info.per_record or block.info.common)
                and np.isneginf(block.info.bounds[0])
                and bool(np.all(block.columns == 1.0))
            )
        return out

    def first(self, position: int, record: int) -> int:
        """Position of the first weight of a block that acts on a record."""
        return self.starts[position] + record * self.blocks[position].columns.shape[1] * self.own[position]

    def columns(self, design: DesignMatrix, record: int, but: slice = slice(0, 0)) -> np.ndarray:
        """Columns of all weights on the distinct states of a record, shape (S, p); `but` those of a block are left out."""
        joint = np.zeros((design.rest.size, self.starts[-1] - (but.stop - but.start)))
        for position, block in enumerate(design.blocks):
            columns, first = block.columns, self.first(position, record)
            if first < but.start or first >= but.stop:
                first -= (but.stop - but.start) * (first >= but.stop)
                joint[:, first : first + columns.shape[1]] = columns
        return joint

    @property
    def factored(self) -> int | None:
        """Position of the first block whose columns are `Factored`; None without one."""
        return next((k for k, block in enumerate(self.blocks) if isinstance(block.columns, Factored)), None)


@dataclasses.dataclass(frozen=True)
class SmoothSystem:
    """Normal equations of all linear weights of a model, block after block, the outputs in units of `size`."""

    layout: Layout  # of all p weights
    # offsets about which the weights are solved for, zeros for all others, shape (p,): normal equations would square the size of an output
    # far from zero
    origin: np.ndarray
    # one matrix for each held-out group of samples, and a last one for those that stay in every fit, shape (groups + 1, p + 1, p + 1); the
    # output, less the response to `origin`, comes last
    grams: np.ndarray
    counts: np.ndarray  # sum of weights of each group of samples, shape (groups + 1,)
    roughness: np.ndarray  # matrix of the smoothness penalty, shape (p, p)
    bounded: np.ndarray  # which weights are >= 0, shape (p,)
    offsets: np.ndarray  # which weights are offsets of single records, shape (p,), bool
    # of each block of weights that belong to cells, by its position, columns on rows that reach as far as those of the samples that count,
    # record after record; shapes (any, p)
    visited: Mapping[int, Sequence[Columns]]
    size: float  # of the output, by which it was divided
    scattered: bool = False  # whether the groups are samples scattered over the records
    # solutions of these equations, by the bytes of the weights that were fixed
    solved: dict[bytes, Any] = dataclasses.field(default_factory=dict, init=False, compare=False, repr=False)

    @classmethod
    def of(
        cls,
        designs: Iterable[DesignMatrix],
        records: Sequence[Record],
        *,
        held: HeldOut | None = None,
    ) -> SmoothSystem:
        """Collect the equations of records.

        Args:
            designs: one for each record, with the same blocks; each is needed once, in turn, so that they may be made on the way.
            records: measured; a sample counts with its weight.
            held: groups of samples that choose the smoothness; those that suit the records by default.
        """
        held = held_out(records) if held is None else held
        size = float(np.ptp(np.concatenate([r.y[r.used] for r in records]))) or 1.0
        later = iter(designs)
        layout = Layout.of(design := next(later), len(records))
        blocks, starts, p = layout.blocks, layout.starts, layout.starts[-1]
        number_of, product = held.count + 1, layout.factored
        basis, inside = None, slice(0, 0)
        if product is not None:
            basis, inside = blocks[product].columns.basis, slice(starts[product], starts[product + 1])  # type: ignore[attr-defined]
        others = np.delete(np.arange(p + 1), inside)
        grams, counts = np.zeros((number_of, p + 1, p + 1)), np.zeros(number_of)
        sums = [_Gram(basis, inside, others, gram) for gram in grams]
        # One level for all records.
        origin = layout.levels * _far(np.mean([np.mean(record.y[record.used]) for record in records]) / size)
        with_cells = [
            k for k, block in enumerate(blocks) if block.penalty is not None and block.penalty.cells is not None
        ]
        visited: dict[int, list[Columns]] = {k: [] for k in with_cells}
        every = itertools.chain([design], later)
        for number, (record, design, folds) in enumerate(zip(records, every, held.folds, strict=True)):
            A = layout.columns(design, number, inside)
            few = None if product is None else design.blocks[product].columns.rows  # type: ignore[attr-defined]
            for fold in range(-1, number_of - 1):
                if (mask := record.used & (folds == fold)).any():
                    index = design.index[mask]
                    y = (record.y[mask] - design.rest[index]) / size - (A @ origin[others[:-1]])[index]
                    sums[fold].add(few, A, index, y, record.weight[mask])
                    counts[fold] += record.weight[mask].sum()
            for k in with_cells:
                columns = design.blocks[k].columns
                visited[k].append(columns[_turning(columns, design.index, record.used)])
        Workers(None if grams[0].size > NUMBERS else 1).run([part.finish for part in sums])
        roughness = np.zeros((p, p))
        bounded, shifts = np.zeros(p, dtype=bool), np.zeros(p, dtype=bool)
        for block, own, start, end in zip(blocks, layout.own, starts, starts[1:], strict=False):
            at = slice(start, end)
            bounded[at] = block.info.bounds[0] == 0.0
            shifts[at] = own and np.isneginf(block.info.bounds[0])
            if block.penalty is not None:
                roughness[at, at] = block.penalty.matrix
        scattered = held.scheme is Scheme.SCATTERED
        return cls(layout, origin, grams, counts, roughness, bounded, shifts, visited, size, scattered)

    @functools.cached_property
    def reach(self) -> np.ndarray:
        """Part of each cell that the samples that count switched both ways, shape (p,), 0 for cells never touched.

        NaN for weights that belong to no cells.
        """
        reach = np.full(self.layout.starts[-1], np.nan)
        for k, every in self.visited.items():
            penalty, start = self.layout.blocks[k].penalty, self.layout.starts[k]
            assert penalty is not None
            assert penalty.cells is not None
            rows = [np.asarray(columns) for columns in every]
            low = np.min([some.min(axis=0) for some in rows], axis=0)
            high = np.max([some.max(axis=0) for some in rows], axis=0)
            reach[start : start + penalty.cells.size] = np.clip((high - low) / (2 * penalty.cells), 0.0, 1.0)
        return reach

    def bounded_by(self, infos: Mapping[int, ParamInfo]) -> SmoothSystem:
        """The same equations with other declarations of the weights, by the numbers of their leaves: the bounds alone may differ."""
        blocks, bounded = [], self.bounded.copy()
        for block, start, end in zip(self.layout.blocks, self.layout.starts, self.layout.starts[1:], strict=False):
            blocks.append(dataclasses.replace(block, info=infos[block.leaf]))
            bounded[start:end] = infos[block.leaf].bounds[0] == 0.0
        return dataclasses.replace(self, layout=dataclasses.replace(self.layout, blocks=tuple(blocks)), bounded=bounded)

    def of_outputs(
        self, design: DesignMatrix, record: Record, y: Float[np.ndarray, "N T"], held: HeldOut
    ) -> Iterator[SmoothSystem]:
        """The systems of other outputs over the input of the only record, whose columns are multiplied with each other once."""
        on, (folds,) = record.used, held.folds
        index, weight, y = design.index[on], record.weight[on], y[:, on]
        columns, sizes = self.layout.columns(design, 0)[index], np.ptp(y, axis=1)
        sizes[sizes == 0] = 1.0
        origins = _far(y.mean(axis=1) / sizes)[:, None] * self.layout.levels
        rest = (y - design.rest[index]) / sizes[:, None] - origins @ columns.T
        groups = [np.flatnonzero(folds[on] == fold) for fold in (*range(held.count), -1)]
        b = np.stack([(rest[:, at] * weight[at]) @ columns[at] for at in groups], axis=1)
        squares = np.stack([rest[:, at] ** 2 @ weight[at] for at in groups], axis=1)
        for k, size in enumerate(sizes.tolist()):
            grams = self.grams.copy()
            grams[:, -1, :-1] = grams[:, :-1, -1] = b[k]
            grams[:, -1, -1] = squares[k]
            yield dataclasses.replace(self, origin=origins[k], grams=grams, size=size)

    def notes(self) -> tuple[str, ...]:
        """Cells that the data never switched, one sentence for each array of their weights."""
        lines = []
        for block, start in zip(self.layout.blocks, self.layout.starts, strict=False):
            penalty = block.penalty
            if penalty is None or penalty.cells is None:
                continue
            total = int(penalty.cells.sum())
            missing = int(penalty.cells[self.reach[start : start + penalty.cells.size] < 1e-9].sum())
            if missing:
                lines.append(
                    f"{missing} of {total} {penalty.label} were never switched by the data ({100 * missing / total:.0f} %): their weights "
                    "follow from smoothness alone, and a prediction that reaches them is extrapolation"
                )
        return tuple(lines)


def _far(level: Any) -> Any:
    """Levels in parts of the output's range; zero where zero is near."""
    return np.where(np.abs(level) > FAR, level, 0.0)


def _turning(columns: Columns, index: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Rows, by `index`, of the used samples but those between two neighbors on one branch, along which all cells switch one way."""
    moves = np.diff((columns @ np.ones(columns.shape[1]))[index])
    ends = used.copy()
    ends[1:-1] &= ~(used[:-2] & used[2:] & (moves[1:] * moves[:-1] > 0))
    return np.unique(index[ends])


class _Gram:
    """A'A of rows that come in parts, of which few are in memory; some columns of A may be a product of sparse rows and a `basis`.

    `inside` tells which columns are that product, `others` the plain columns, the output last; the sum is made in `whole`, shape
    (p + 1, p + 1), zeros at first.
    """

    def __init__(self, basis: Basis | None, inside: slice, others: np.ndarray, whole: np.ndarray):
        self._basis, self._inside, self._others = basis, inside, others
        self._whole, self._few = whole, None
        self._between = np.zeros((0 if basis is None else basis.shape[0], others.size))
        self._waiting = list[tuple[Any, np.ndarray]]()

    def add(self, few: Any, A: np.ndarray, index: np.ndarray, y: np.ndarray, weight: np.ndarray) -> None:
        """Add samples: `few` are sparse rows of the product on distinct states, or None; A are the plain columns there."""
        states, place = np.unique(index, return_inverse=True)
        mass = np.bincount(place, weight)
        mean = np.bincount(place, weight * y) / mass
        self._whole[-1, -1] += float(weight @ (y - mean[place]) ** 2)
        root = np.sqrt(mass)
        if few is not None:
            few = few[states]
            few.data *= np.repeat(root, np.diff(few.indptr))
        self._waiting.append((few, np.column_stack([A[states], mean]) * root[:, None]))
        # Products of few rows each would only move the sums through memory.
        if sum(rows.size + (0 if some is None else some.nnz) for some, rows in self._waiting) > NUMBERS:
            self._multiply()

    def _multiply(self) -> None:
        """Sum the rows that wait."""
        if not self._waiting:
            return
        parts, rows = zip(*self._waiting, strict=True)
        self._waiting, rows = [], np.concatenate(rows)
        if self._basis is None:
            self._whole += rows.T @ rows
            return
        few = scipy.sparse.vstack(parts, format="csr")
        if few.shape[0] < few.shape[1]:  # the products with the basis would take longer than those of the rows  # type: ignore[index]
            every = np.empty((len(rows), len(self._whole)))
            every[:, self._inside], every[:, self._others] = Factored(few, self._basis), rows
            self._whole += every.T @ every
            return
        if few.nnz > _SPARSE * few.shape[0] * few.shape[1]:  # type: ignore[index]
            few = few.toarray()
        product = few.T @ few
        self._few = product if self._few is None else self._few + product
        self._between += few.T @ rows
        self._whole[np.ix_(self._others, self._others)] += rows.T @ rows

    def finish(self) -> None:
        """Complete the sum."""
        self._multiply()
        if self._basis is not None and self._few is not None:
            inside, others, spread = self._inside, self._others, self._basis.spread
            few = self._few.toarray() if scipy.sparse.issparse(self._few) else self._few
            self._whole[inside, inside] += spread(spread(few).T)
            between = spread(self._between)
            self._whole[inside, others] += between
            self._whole[others, inside] += between.T
