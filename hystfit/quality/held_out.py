"""What is held out of a fit to judge it: whole records, amplitude levels, cycles, or scattered samples, as the records allow."""

from __future__ import annotations

import dataclasses
import enum
import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from hystfit.data.circulation import SLACK
from hystfit.data.record import Record
from hystfit.quality.loops import SEVERAL, clear_reversals, distinct, extents

# Groups that are held out in turn: more refits hardly change the error (Breiman and Spector 1992).
FOLDS = 5
GAIN = 0.98  # another term or size is taken only if it lowers the error on held-out data by at least 2 %
# Of the error of models without time, below which one with a lag, creep or a force of the rate is taken where all branches have one
# duration, so that the speed is a function of amplitude and place, which those describe too: such a term leaves 0.88 to 0.98 of it in
# simulated static loops, 0.74 in another, and 0.2 to 0.78 where there is a force or a lag (three simulated and three measured devices).
AT_ONE_PACE = 0.8


class Scheme(enum.StrEnum):
    """What is held out in turn."""

    RECORDS = "records"
    LEVELS = "levels"
    CYCLES = "cycles"
    SCATTERED = "scattered"
    INNER = "scattered, inner loops"
    FUTURE = "future"

    @property
    def held(self) -> str:
        """What is held out, in words."""
        return _WORDS[self][0]

    @property
    def tested(self) -> str:
        """Which predictions the error speaks for, in words."""
        return _WORDS[self][1]


_WORDS = {
    Scheme.RECORDS: ("whole records", "predicts records like these"),
    Scheme.LEVELS: ("whole amplitude levels", "predicts amplitudes between those measured"),
    Scheme.CYCLES: ("contiguous fifths of the cycles", "predicts further cycles within the measured range"),
    Scheme.SCATTERED: ("scattered samples", "predicts this loop; other amplitudes are not tested by these data"),
    Scheme.INNER: ("scattered samples and on smaller loops (geometric mean)", "predicts these loops and smaller ones"),
    Scheme.FUTURE: ("the last three fifths, one after another", "predicts what follows the measured time"),
}


@dataclasses.dataclass(frozen=True)
class HeldOut:
    """Groups of samples that are held out in turn.

    Attributes:
        scheme: what they are.
        folds: of each record the number of the group of every sample, shape (T,); -1 for samples that stay in every fit, and for those
            that do not count.
    """

    scheme: Scheme
    folds: tuple[np.ndarray, ...]

    @property
    def count(self) -> int:
        """Number of groups."""
        return 1 + max(int(fold.max(initial=-1)) for fold in self.folds)

    def after(self, lengths: Iterable[int]) -> HeldOut:
        """The same of records before which something was put, so that they have these lengths; it is in no group."""
        folds = (np.concatenate([np.full(n - f.size, -1), f]) for n, f in zip(lengths, self.folds, strict=True))
        return HeldOut(self.scheme, tuple(folds))

    def splits(self) -> list[tuple[list[np.ndarray], list[np.ndarray]]]:
        """(samples to fit, samples to predict) of each group: one mask (T,) for each record."""
        return [([f != k for f in self.folds], [f == k for f in self.folds]) for k in range(self.count)]


def held_out(records: Sequence[Record], spacing: int = 1) -> HeldOut:
    """The groups that suit the records.

    | records | held out |
    |---|---|
    | three or more | whole records: those inside the range of the others, or all where fewer than two are |
    | cycles of three or more amplitudes, each repeated | whole levels but the largest |
    | a cycle or more in each fifth | fifths of the record, apart from branches that leave the range of the rest |
    | a single loop, or few | runs of `spacing` samples, every fifth run; models are ranked by `inner_loops` too |

    Whatever only the held-out part determines would test an extrapolation, which prefers coarse models.

    Args:
        spacing: samples over which errors are correlated; scattered runs have this length where the record is long enough.
    """
    if sum(bool(record.used.any()) for record in records) >= SEVERAL:
        return HeldOut(Scheme.RECORDS, _whole_records(records))
    turns = [clear_reversals(record.u) for record in records]
    levels = [_levels(record, turn) for record, turn in zip(records, turns, strict=True)]
    if all(_is_divided(level) for level in levels):
        return HeldOut(Scheme.LEVELS, tuple(levels))
    if all(turn.size >= 2 * FOLDS for turn in turns):
        folds = [_fifths(record, turn) for record, turn in zip(records, turns, strict=True)]
        if all(_is_divided(fold) for fold in folds):
            return HeldOut(Scheme.CYCLES, tuple(folds))
    return HeldOut(Scheme.SCATTERED, tuple(_scattered(record, spacing) for record in records))


def inner_loops(records: Sequence[Record]) -> HeldOut | None:
    """Loops inside the largest one, each amplitude held out in turn; None where all are of one size, or reach outside it.

    Scattered samples tell how well a model interpolates in the loops that it was fitted to. Of two loops of four magnetic materials
    (20 pairs, six models) the model that they choose predicts a third one with 1.75 times the error of the best, 17 times at worst; the
    inner loop alone chooses one with 1.49 and 12 times, the geometric mean of both errors 1.16 and 1.9 times. Among the levels of one model
    inner loops choose no better than scattered samples.
    """
    span = max(float(np.ptp(record.u)) for record in records)
    edges = [np.array([0, *clear_reversals(record.u), len(record)]) for record in records]
    strokes = [extents(record.u, at) / span for record, at in zip(records, edges, strict=True)]
    # The first and the last stroke of a record are parts of loops.
    whole = [of[1:-1] if of.size > 2 else of.max(keepdims=True) for of in strokes]
    sizes = np.array(distinct(np.concatenate(whole)))
    if sizes.size == 1:
        return None
    nearest = lambda values, of: np.abs(values[:, None] - of).argmin(axis=1)
    folds = []
    for record, at, of, own in zip(records, edges, strokes, whole, strict=True):
        level = nearest(own[nearest(of, own)], sizes)
        groups = np.where(level == 0, -1, (level - 1) % FOLDS)
        folds.append(np.where(record.used, np.repeat(groups, np.diff(at)), -1))
    inputs = np.concatenate([record.u[record.used] for record in records])
    group = np.concatenate([fold[record.used] for fold, record in zip(folds, records, strict=True)])
    largest, slack = inputs[group < 0], SLACK * span
    if not 0 < largest.size < inputs.size:
        return None
    if inputs.min() < largest.min() - slack or inputs.max() > largest.max() + slack:
        return None
    return HeldOut(Scheme.INNER, tuple(folds))


def correlation_length(errors: np.ndarray) -> int:
    """Samples after which the autocorrelation of errors, shape (n,), has fallen below 1 / e."""
    errors = errors - errors.mean()
    power = np.abs(np.fft.rfft(errors, 2 * errors.size)) ** 2
    correlation = np.fft.irfft(power)[: errors.size]
    if not correlation[0] > 0:
        return 1
    below = np.flatnonzero(correlation < correlation[0] / np.e)
    return int(below[0]) if below.size else errors.size


def equal_errors(samples: int, correlated: int = 1) -> float:
    """Ratio of rms errors that a sample of this size does not tell apart: one and the standard error of a root mean square.

    Args:
        samples: number of held-out samples.
        correlated: over how many of them the errors are correlated.
    """
    return 1.0 + float(np.sqrt(correlated / (2 * samples)))


def future(records: Sequence[Record]) -> HeldOut:
    """Fifths of every record, of which the third to the last are predicted from what came before (Buerkner et al. 2020)."""
    return HeldOut(Scheme.FUTURE, tuple(_of_masks(record, record.blocks(FOLDS)) for record in records))


def _is_divided(fold: np.ndarray) -> bool:
    """Whether the samples that count are in two groups or more."""
    return len(np.unique(fold[fold >= 0])) > 1


def _of_masks(record: Record, masks: Sequence[np.ndarray]) -> np.ndarray:
    fold = np.full(len(record), -1)
    for k, mask in enumerate(masks):
        fold[mask] = k
    return fold


def _whole_records(records: Sequence[Record]) -> tuple[np.ndarray, ...]:
    """Records dealt out to at most five groups; those of which no sample counts are in none."""
    counted = np.array([k for k, record in enumerate(records) if record.used.any()])
    low, high = (np.array([f(records[k].u[records[k].used]) for k in counted]) for f in (np.min, np.max))
    slack, inside = SLACK * float(high.max() - low.min()), np.empty(counted.size, dtype=bool)
    for k in range(counted.size):
        others = np.arange(counted.size) != k
        inside[k] = low[k] >= low[others].min() - slack and high[k] <= high[others].max() + slack
    if inside.sum() < 2:
        inside[:] = True
    group = np.full(len(records), -1)
    group[counted[inside]] = np.arange(int(inside.sum())) % FOLDS
    return tuple(np.where(record.used, number, -1) for record, number in zip(records, group, strict=True))


def _levels(record: Record, turns: np.ndarray) -> np.ndarray:
    """Groups by amplitude, the largest in none; no groups where there are too few levels, or these are not repeated."""
    none = np.full(len(record), -1)
    if not turns.size:
        return none
    span = float(np.ptp(record.u))
    edges = np.array([0, *turns, len(record)])
    strokes = extents(record.u, edges) / span
    values = distinct(strokes[1:-1])
    count = len(values)
    if count < SEVERAL or turns.size < 4 * count:  # two cycles of each
        return none
    level = np.abs(strokes[:, None] - np.array(values)).argmin(axis=1)
    group = np.where(level == 0, -1, (level - 1) % min(count - 1, FOLDS))
    return np.where(record.used, np.repeat(group, np.diff(edges)), -1)


def _fifths(record: Record, turns: np.ndarray) -> np.ndarray:
    """Contiguous fifths; branches that leave the range of the other fifths stay in every fit."""
    fold = _of_masks(record, record.blocks(FOLDS))
    slack, edges = SLACK * float(np.ptp(record.u)), [0, *turns.tolist(), len(record)]
    ranges = {k: (record.u[fold == k].min(), record.u[fold == k].max()) for k in np.unique(fold[fold >= 0])}
    for first, last in itertools.pairwise(edges):
        branch = record.u[first : min(last + 1, len(record))]
        others = [ranges[k] for k in ranges if k not in fold[first:last]]
        low, high = min((low for low, _ in others), default=np.inf), max((high for _, high in others), default=-np.inf)
        if branch.min() < low - slack or branch.max() > high + slack:
            fold[first:last] = -1
    return fold


def _scattered(record: Record, spacing: int) -> np.ndarray:
    """Runs of samples, every fifth in the same group."""
    used = np.flatnonzero(record.used)
    # Ten runs at least, so that a group covers all parts of a loop.
    length = max(1, min(spacing, used.size // (10 * FOLDS)))
    fold = np.full(len(record), -1)
    fold[used] = np.arange(used.size) // length % FOLDS
    return fold
