"""Smooth weights from design matrices: convex, bounded, the smoothness chosen by the error on held-out data."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from hystfit.data.record import Record
from hystfit.models.design import FAR, Block, DesignMatrix, effective_number, with_own_offsets
from hystfit.models.nonnegative import solve_nonnegative, submatrix
from hystfit.quality.held_out import HeldOut, held_out

SMOOTHNESS = tuple(10.0**k for k in range(-9, 0))
Offsets = Literal["each", "shared", "none"]
_NUMBERS = (
    2**21
)  # of rows that wait to be multiplied (16 MiB): products of few rows each would only move the sums through memory
_EQUAL = 1.01  # ratio of errors on held-out groups, or of residuals, below which two strengths are equally good


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


@dataclasses.dataclass(frozen=True)
class SmoothFit:
    """Solution of a `SmoothSystem`.

    Attributes:
        weights: all p weights, in output units; fixed ones as given.
        smoothness: strength of the penalty, relative to the number of samples.
        left_out: root mean square error on held-out groups, in parts of the output's range, for each strength; infinite for those
            that were not tried.
        error: the same for the strength chosen; None where there was no choice.
        rss: sum of squared residuals, output units.
        cost: the same with the penalty added.
        effective: number of weights that the data determine, see `effective_number`.
        penalty: what the penalty adds to the normal matrix, diagonal, in units of outputs / weights, shape (p,).
        size: of the output, as in the system.
    """

    weights: np.ndarray
    smoothness: float
    left_out: np.ndarray
    error: float | None
    rss: float
    cost: float
    effective: float
    penalty: np.ndarray
    size: float


def fit_smooth(
    system: SmoothSystem, strengths: Sequence[float] = SMOOTHNESS, *, fixed: np.ndarray | None = None
) -> SmoothFit:
    """Solve for the weights, with the smoothness whose error on held-out groups in turn is smallest.

    The offset of a record that is left out as a whole is fitted to it.

    Args:
        system: the equations.
        strengths: of the penalty to choose among; a single one is used without a choice.
        fixed: values of weights that are not fitted, NaN for the others, output units, shape (p,).
    """
    fixed = np.full(system.roughness.shape[0], np.nan) if fixed is None else fixed
    trials = _Trials(system, fixed)
    left_out = trials.left_out(strengths, refitted=True) if len(strengths) > 1 else []
    best = trials.chosen(strengths, left_out)
    v, _, rss = trials.solved(strengths[best])
    strength = strengths[best] * trials.n
    cost = (rss + strength * float(v @ trials.rough @ v)) * system.size**2
    weights = fixed.copy()
    weights[trials.free] = (v + system.origin[trials.free]) * system.size
    penalty = strength * np.diag(system.roughness)
    error, effective = (left_out[best], trials.effective(strengths[best])) if left_out else (None, np.nan)
    return SmoothFit(
        weights, strengths[best], np.array(left_out), error, rss * system.size**2, cost, effective, penalty, system.size
    )


def left_out_error(system: SmoothSystem, strengths: Sequence[float], fixed: np.ndarray) -> float:
    """`SmoothFit.error` in less time, for choices between systems; arguments as for `fit_smooth`.

    Weights that the fit of all samples holds at zero stay there without a group too, except in the error of the strength chosen: this
    takes a third of the time, and prefers weaker penalties.
    """
    trials = _Trials(system, fixed)
    best = trials.chosen(strengths, trials.left_out(strengths, refitted=False))
    return trials.error(strengths[best], refitted=True)


class _Solved(NamedTuple):
    """Weights, which of them are not held at zero, and the sum of squared residuals."""

    weights: np.ndarray
    positive: np.ndarray
    rss: float


class _Trials:
    """Solutions of a system with penalties of different strengths, each started from the one before.

    Args:
        system: the equations.
        fixed: see `fit_smooth`.
    """

    def __init__(self, system: SmoothSystem, fixed: np.ndarray):
        self._grams, self.free = _reduced(system, fixed - system.origin * system.size)
        self._total, self.n = self._grams.sum(axis=0), float(system.counts.sum())
        self.rough, self._bounded = system.roughness[np.ix_(self.free, self.free)], system.bounded[self.free]
        self._own, self._counts = system.offsets[self.free], system.counts
        self._solved: dict[float, _Solved] = {}
        self._errors: dict[tuple[float, bool], float] = {}
        self._positive: np.ndarray | None = None

    def left_out(self, strengths: Sequence[float], *, refitted: bool) -> list[float]:
        """The error on held-out groups with each rising strength; infinite for those that are not tried.

        Every second one from the strongest until the error grows, and the neighbors of the best: among weak ones, with which other
        samples hardly determine the weights, the error has several minima.
        """
        errors = [np.inf] * len(strengths)
        for k in range(len(strengths) - 1, -1, -2):
            errors[k] = self.error(strengths[k], refitted=refitted)
            if errors[k] > _EQUAL * min(errors):
                break
        best = int(np.argmin(errors))
        for k in range(max(best - 1, 0), min(best + 2, len(strengths))):
            errors[k] = self.error(strengths[k], refitted=refitted)
        return errors

    def error(self, strength: float, *, refitted: bool) -> float:
        """Root mean square error on the held-out groups; `refitted` says whether each fit decides which weights are zero."""
        refitted &= bool(self._bounded.any())
        if (strength, refitted) not in self._errors:
            self._errors[strength, refitted] = self._error(strength, refitted=refitted)
        return self._errors[strength, refitted]

    def _error(self, strength: float, *, refitted: bool) -> float:
        squares, positive = 0.0, self.solved(strength).positive
        bounded = self._bounded if refitted else np.zeros_like(self._bounded)
        at = np.arange(self.free.size) if refitted else np.flatnonzero(positive)
        rows = np.append(at, self.free.size)
        total, rough = submatrix(self._total, rows), submatrix(self.rough, at)
        for gram, count in zip(self._grams[:-1], self._counts[:-1], strict=True):
            own = submatrix(gram, rows)
            others = total - own
            v, _ = _solve(others, strength * (self.n - count) * rough, bounded[at], positive[at])
            absent = self._own[at] & (np.diag(others)[:-1] == 0)
            r = np.append(-with_own_offsets(own[:-1, :-1], own[None, :-1, -1], v[None], absent)[0], 1.0)
            squares += max(float(r @ own @ r), 0.0)
        return float(np.sqrt(squares / self._counts[:-1].sum()))

    def effective(self, strength: float) -> float:
        """Number of weights that the data determine."""
        return effective_number(self._total[:-1, :-1], strength * self.n * self.rough, self.solved(strength).positive)

    def chosen(self, strengths: Sequence[float], left_out: Sequence[float]) -> int:
        """The strength with the smallest left-out error (the first one without errors).

        Where the errors of several strengths are practically equal, those that fit the data clearly worse are out of the choice:
        a block that alone determines a weight is then predicted by the penalty, which has no say where that block is measured.
        """
        if not left_out:
            return 0
        order = np.argsort(left_out, kind="stable")
        rss = {int(k): self.solved(strengths[k]).rss for k in order if left_out[k] <= _EQUAL * left_out[order[0]]}
        return next(k for k in rss if rss[k] <= _EQUAL**2 * min(rss.values()))

    def solved(self, strength: float) -> _Solved:
        """The weights that all samples give."""
        if strength not in self._solved:
            v, self._positive = _solve(self._total, strength * self.n * self.rough, self._bounded, self._positive)
            r = np.append(-v, 1.0)
            self._solved[strength] = _Solved(v, self._positive, max(float(r @ self._total @ r), 0.0))
        return self._solved[strength]


def _reduced(system: SmoothSystem, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrices without the fixed weights, whose part moves to the side of the output, and the free ones' positions.

    `values` are those of the fixed weights, NaN for the free ones, output units, shape (p,).
    """
    free, fixed = np.flatnonzero(np.isnan(values)), np.flatnonzero(~np.isnan(values))
    if not fixed.size:
        return system.grams, free
    T = np.zeros((values.size + 1, free.size + 1))
    T[free, np.arange(free.size)] = 1.0
    T[fixed, -1] = -values[fixed] / system.size
    T[-1, -1] = 1.0
    return np.stack([T.T @ gram @ T for gram in system.grams]), free


def _solve(
    gram: np.ndarray, penalty: np.ndarray, bounded: np.ndarray, start: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    A = gram[:-1, :-1] + penalty
    A[np.diag_indices(len(A))] += 1e-12 * np.trace(A) / len(A)
    return solve_nonnegative(A, gram[:-1, -1], bounded, start)
