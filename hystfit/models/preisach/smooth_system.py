"""Normal equations of smooth weights, collected from design matrices, for every held-out group of samples apart."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from hystfit.data.record import Record
from hystfit.models.design import FAR, Block, DesignMatrix
from hystfit.quality.held_out import HeldOut, held_out

Offsets = Literal["each", "shared", "none"]
# Numbers of rows that wait to be multiplied (16 MiB): products of few rows each would only move the sums through memory.
_NUMBERS = 2**21


@dataclasses.dataclass(frozen=True)
class Layout:
    """Where the columns of design matrices stand in one matrix for all records, block after block.

    Attributes:
        blocks: of the design matrix of the first record, those that are used.
        kept: their numbers among all its blocks.
        own: whether each record has weights of its own for a block; those of all records then stand in turn.
        starts: position of each block's first weight, and the number of all weights.
    """

    blocks: tuple[Block, ...]
    kept: tuple[int, ...]
    own: tuple[bool, ...]
    starts: tuple[int, ...]

    @classmethod
    def of(cls, design: DesignMatrix, records: int, offsets: Offsets = "each") -> Layout:
        """The layout for records whose design matrices have the same blocks.

        Args:
            design: of one of them.
            records: how many there are.
            offsets: see `SmoothSystem.of`.
        """
        kept = tuple(k for k, block in enumerate(design.blocks) if offsets != "none" or not _is_offset(block))
        blocks = tuple(design.blocks[k] for k in kept)
        own = tuple(block.info.per_record and offsets == "each" for block in blocks)
        widths = [block.columns.shape[1] * (records if each else 1) for block, each in zip(blocks, own, strict=True)]
        return cls(blocks, kept, own, tuple(np.cumsum([0, *widths]).tolist()))

    @property
    def levels(self) -> np.ndarray:
        """Which weights are a constant output, shape (p,), 1 or 0."""
        out = np.zeros(self.starts[-1])
        for block, start, end in zip(self.blocks, self.starts, self.starts[1:], strict=False):
            out[start:end] = (
                _is_offset(block) and np.isneginf(block.info.bounds[0]) and bool(np.all(block.columns == 1.0))
            )
        return out

    def first(self, position: int, record: int) -> int:
        """Position of the first weight of a block that acts on a record."""
        return self.starts[position] + record * self.blocks[position].columns.shape[1] * self.own[position]

    def columns(self, design: DesignMatrix, record: int) -> np.ndarray:
        """Columns of all weights on the distinct states of a record, shape (S, p)."""
        joint = np.zeros((design.rest.size, self.starts[-1]))
        for position, number in enumerate(self.kept):
            columns, first = design.blocks[number].columns, self.first(position, record)
            joint[:, first : first + columns.shape[1]] = columns
        return joint


@dataclasses.dataclass(frozen=True)
class SmoothSystem:
    """Normal equations of all linear weights of a model, block after block, the outputs in units of `size`.

    Attributes:
        layout: of all p weights.
        origin: offsets about which the weights are solved for, zeros for all others, shape (p,): normal equations would square the size
            of an output far from zero.
        grams: one matrix for each held-out group of samples, and a last one for those that stay in every fit, shape
            (groups + 1, p + 1, p + 1); the output, less the response to `origin`, comes last.
        counts: sum of weights of each group of samples, shape (groups + 1,).
        roughness: matrix of the smoothness penalty, shape (p, p).
        bounded: which weights are >= 0, shape (p,).
        offsets: which weights are offsets of single records, shape (p,), bool.
        reach: part of each cell that the samples that count switched both ways, shape (p,), 0 for cells never touched; NaN for
            weights that belong to no cells.
        size: of the output, by which it was divided.
    """

    layout: Layout
    origin: np.ndarray
    grams: np.ndarray
    counts: np.ndarray
    roughness: np.ndarray
    bounded: np.ndarray
    offsets: np.ndarray
    reach: np.ndarray
    size: float

    @classmethod
    def of(
        cls,
        designs: Iterable[DesignMatrix],
        records: Sequence[Record],
        *,
        held: HeldOut | None = None,
        nonnegative: bool = True,
        offsets: Offsets = "each",
    ) -> SmoothSystem:
        """Collect the equations of records.

        Args:
            designs: one for each record, with the same blocks; each is needed once, in turn, so that they may be made on the way.
            records: measured; a sample counts with its weight.
            held: groups of samples that choose the smoothness; those that suit the records by default.
            nonnegative: bound weights from below as their parameters are bounded.
            offsets: weights declared for each record have a value for each, one for all, or none.
        """
        held = held_out(records) if held is None else held
        size = float(np.ptp(np.concatenate([r.y[r.used] for r in records]))) or 1.0
        others = iter(designs)
        layout = Layout.of(design := next(others), len(records), offsets)
        blocks, starts, p = layout.blocks, layout.starts, layout.starts[-1]
        grams = np.zeros((held.count + 1, p + 1, p + 1))
        sums = [_Gram(gram) for gram in grams]
        counts = np.zeros(len(grams))
        # One level for all records.
        origin = layout.levels * _far(np.mean([np.mean(record.y[record.used]) for record in records]) / size)
        low, high = np.full(p, np.inf), np.full(p, -np.inf)
        every = itertools.chain([design], others)
        for number, (record, design, folds) in enumerate(zip(records, every, held.folds, strict=True)):
            A = layout.columns(design, number)
            for fold in range(-1, held.count):
                if (mask := record.used & (folds == fold)).any():
                    y = (record.y[mask] - design.rest[design.index[mask]]) / size - (A @ origin)[design.index[mask]]
                    sums[fold].add(_rows(A, design.index[mask], y, record.weight[mask]))
                    counts[fold] += record.weight[mask].sum()
            seen = A[np.unique(design.index[record.used])]
            low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
        for part in sums:
            part.finish()
        roughness, reach = np.zeros((p, p)), np.full(p, np.nan)
        bounded, shifts = np.zeros(p, dtype=bool), np.zeros(p, dtype=bool)
        for block, own, start, end in zip(blocks, layout.own, starts, starts[1:], strict=False):
            at = slice(start, end)
            bounded[at] = nonnegative and block.info.bounds[0] == 0.0
            shifts[at] = own and np.isneginf(block.info.bounds[0])
            if block.penalty is not None:
                roughness[at, at] = block.penalty.matrix
                if block.penalty.cells is not None:
                    reach[at] = np.clip((high - low)[at] / (2 * block.penalty.cells), 0.0, 1.0)
        return cls(layout, origin, grams, counts, roughness, bounded, shifts, reach, size)

    def of_outputs(
        self, design: DesignMatrix, record: Record, y: Float[np.ndarray, "N T"], held: HeldOut
    ) -> Iterator[SmoothSystem]:
        """The systems of other outputs over the input of the only record, whose columns are multiplied with each other once.

        Args:
            design: of the record.
            record: has the input and the weights of the samples.
            y: outputs.
            held: groups of samples, as for the record.
        """
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


def _is_offset(block: Block) -> bool:
    return block.info.per_record or block.info.common


class _Gram:
    """A'A of rows that come in parts, of which few are in memory.

    Args:
        total: where it is summed, zeros, shape (width, width).
    """

    def __init__(self, total: np.ndarray):
        self._total, self._waiting = total, list[np.ndarray]()

    def add(self, rows: np.ndarray) -> None:
        """Add rows, shape (k, width)."""
        self._waiting.append(rows)
        if sum(map(len, self._waiting)) * len(self._total) > _NUMBERS:
            self.finish()

    def finish(self) -> None:
        """Sum the rows that wait."""
        if self._waiting:
            rows = np.concatenate(self._waiting)
            self._waiting = []
            self._total += rows.T @ rows


def _rows(A: np.ndarray, index: np.ndarray, y: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Rows (A, y), one a state that the samples visit, and a last one: their sums of squares are those of the samples."""
    states, place = np.unique(index, return_inverse=True)
    mass = np.bincount(place, weight)
    mean = np.bincount(place, weight * y) / mass
    spread = np.zeros((1, A.shape[1] + 1))
    spread[0, -1] = np.sqrt(max(float(weight @ (y - mean[place]) ** 2), 0.0))
    return np.concatenate([np.column_stack([A[states], mean]) * np.sqrt(mass)[:, None], spread])
