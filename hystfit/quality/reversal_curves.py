"""First-order reversal curves: monotonic branches from their reversal points back towards saturation, and corrections of them."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence

import numpy as np

from hystfit.data.circulation import FEWEST, SLACK
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.quality.faults import CLEAR, SIGNIFICANCE, noise_rms
from hystfit.quality.loops import APART

_LEAST = 5  # number of curves from which records are recognized as a family
_APART = 0.3  # least spread of the reversal points of a recognized family, as a fraction of the input's range


@dataclasses.dataclass(frozen=True)
class ReversalFamily:
    """First-order reversal curves in order of reversal.

    Attributes:
        curves: samples that count, each from its reversal point; the curve nearest to saturation first.
        rising: they rise, from positive saturation.
    """

    curves: tuple[Record, ...]
    rising: bool

    @functools.cached_property
    def notes(self) -> tuple[str, ...]:
        """Curves that cross, or do not close."""
        return tuple(_notes(self.curves, self.rising))

    def words(self) -> str:
        """One line for a report."""
        start, unit = [r.u[0] for r in self.curves], f" {self.curves[0].u_unit}".rstrip()
        direction, side = ("rising", "positive") if self.rising else ("falling", "negative")
        return (
            f"{len(self.curves)} first-order reversal curves, {direction} from reversals at {min(start):.4g} to {max(start):.4g}"
            f"{unit} to {side} saturation"
        )


def reversal_curves(data: Dataset | Sequence[Record]) -> ReversalFamily:
    """Check that records are first-order reversal curves; samples that do not count and curves of one sample are omitted."""
    used = [record for record in Dataset.of(data) if np.count_nonzero(record.used) > 1]
    curves = [record if record.used.all() else record.take(record.used) for record in used]
    if len(curves) < 2:
        raise DataError(
            f"two reversal curves or more are needed, got {len(curves)}: read the file with its curve column (by=)"
        )
    rises = [bool(np.sum(np.sign(np.diff(r.u))) > 0) for r in curves]
    if len(set(rises)) > 1:
        raise DataError(f"{sum(rises)} of {len(curves)} curves rise and the others fall: use one kind at a time")
    for r, rising in zip(curves, rises, strict=True):
        forward = r.u if rising else -r.u
        back = np.maximum.accumulate(forward) - forward
        if back.max() > SLACK * np.ptp(r.u):
            turn = int(np.argmax(forward[: int(np.argmax(back))]))
            raise DataError(
                f"curve {r.name!r} reverses at sample {turn}: the input of a reversal curve is monotonic; split the curve there"
            )
    curves.sort(key=lambda r: r.u[0], reverse=rises[0])
    if abs(curves[-1].u[0] - curves[0].u[0]) <= SLACK * np.ptp(np.concatenate([r.u for r in curves])):
        raise DataError(
            f"{len(curves)} curves begin at the same input, {curves[0].u[0]:.4g}: each reversal curve must begin at its own reversal, "
            "and these differ by something other than their input"
        )
    return ReversalFamily(tuple(curves), rises[0])


def recognize_family(data: Dataset | Sequence[Record]) -> ReversalFamily | None:
    """The family of reversal curves, where the records are one: five or more, each from its own reversal past all others'.

    None where they are not.
    """
    records = [r for r in Dataset.of(data) if np.count_nonzero(r.used) > 1]
    if len(records) < _LEAST:
        return None
    try:
        family = reversal_curves(records)
    except DataError:
        return None
    span = float(np.ptp(np.concatenate([r.u for r in family.curves])))
    starts, ends = (np.array([r.u[k] for r in family.curves]) for k in (0, -1))
    past = ends.min() > starts.max() if family.rising else ends.max() < starts.min()
    return family if past and np.ptp(starts) >= _APART * span else None


def _notes(curves: Sequence[Record], rising: bool) -> list[str]:
    span = float(np.ptp(np.concatenate([r.y for r in curves])))
    notes = []
    sign = 1.0 if rising else -1.0
    worst, pair = 0.0, ("", "")
    for upper, lower in itertools.pairwise(curves):
        u = upper.u[(upper.u >= lower.u.min()) & (upper.u <= lower.u.max())]
        if u.size:
            gap = sign * (at_inputs(lower, u) - at_inputs(upper, u))
            if gap.max() > worst:
                worst, pair = float(gap.max()), (upper.name, lower.name)
    known = [noise for noise, is_bound in (noise_rms(r.y) for r in curves) if noise and not is_bound]
    chance = CLEAR * math.sqrt(2) * float(np.median(known)) if known else 0.0  # of the difference of two curves
    if worst > max(SLACK * span, chance):
        notes.append(
            f"curves {pair[0]} and {pair[1]} cross by {100 * worst / span:.1f} % of the range: a non-negative density cannot "
            "describe this"
        )
    end = min(r.u.max() for r in curves) if rising else max(r.u.min() for r in curves)
    ends = [float(at_inputs(r, np.array([end]))[0]) for r in curves]
    if np.ptp(ends) > APART * span:
        level = f"{end:g} {curves[0].u_unit}".rstrip()
        notes.append(
            f"at {level} the curves differ by {100 * np.ptp(ends) / span:.1f} % of the range: they do not close, because the "
            "largest input does not saturate"
        )
    return notes


def at_inputs(record: Record, u: np.ndarray) -> np.ndarray:
    """Output of a curve at given inputs, by linear interpolation.

    Args:
        u: inputs, shape (N,) [unit of u].
    """
    order = np.argsort(record.u, kind="stable")
    return np.interp(u, record.u[order], record.y[order])


_FIT = 5  # points after a point from which a parabola is continued to it
_WIDTHS = (3, 5, 9, 17, 33)  # calibration points in the running mean of the drift, chosen by points left out


def corrected_curves(data: Dataset) -> tuple[Dataset, tuple[Note, ...]]:
    """Curves without drift and without first points that had not settled, and what was done.

    Args:
        data: one record for each curve, in the order of measurement; a sample of weight 0 at its start is its calibration point.

    Returns:
        The data set, and one note for each correction; the data set itself where there is none.
    """
    data, drift = _without_drift(data)
    data, unsettled = _without_unsettled_points(data)
    return data, (*drift, *unsettled)


def _without_drift(data: Dataset) -> tuple[Dataset, list[Note]]:
    """Outputs times mean over local calibration output, where calibration outputs of neighbors are more alike than of others."""
    calibrated = [not r.used[0] and bool(np.isfinite(r.y[0])) for r in data]
    levels = np.array([r.y[0] for r, has_one in zip(data, calibrated, strict=True) if has_one])
    if levels.size < FEWEST or not all(calibrated) or drift_probability(levels) > SIGNIFICANCE:
        return data, []
    slow = _running_mean(levels)
    factors = levels.mean() / slow
    scaled = [dataclasses.replace(r, y=r.y * factor) for r, factor in zip(data, factors, strict=True)]
    spread = 100 * float(np.ptp(slow) / abs(levels.mean()))
    text = (
        f"drift: outputs scaled so that the calibration points agree, which differed by {spread:.2g} % from slow drift"
    )
    return Dataset(tuple(scaled)), [Note(Code.CURVES, text)]


def drift_probability(levels: np.ndarray) -> float:
    """Probability of differences between neighbors as small as these if the order did not matter (von Neumann's ratio, 1941)."""
    from scipy.stats import norm

    n, variance = levels.size, float(levels.var())
    if variance == 0:
        return 1.0
    ratio = float(np.mean(np.diff(levels) ** 2)) / variance
    deviation = np.sqrt(4 * (n - 2) / (n**2 - 1))
    return float(norm.cdf((ratio - 2 * n / (n - 1)) / deviation))


def _running_mean(levels: np.ndarray) -> np.ndarray:
    """The slow part of a sequence: its running mean over the width that best predicts each value from the others."""

    def means(width: int, *, own: bool) -> np.ndarray:
        window = np.ones(width)
        window[width // 2] = own
        return np.convolve(levels, window, "same") / np.convolve(np.ones(levels.size), window, "same")

    widths = [w for w in _WIDTHS if w <= levels.size]
    best = min(widths, key=lambda w: float(np.mean((levels - means(w, own=False)) ** 2)))
    return means(best, own=True)


def _without_unsettled_points(data: Dataset) -> tuple[Dataset, list[Note]]:
    """First outputs are continued from the curve after them, where they lie further from it than the next points do from theirs."""
    from scipy.stats import wilcoxon

    count = 0
    while count < 3:
        first, second = (np.array([_distance(r, count + k) for r in data]) for k in range(2))
        both = np.isfinite(first) & np.isfinite(second) & (first != second)
        if both.sum() < FEWEST:
            break
        if wilcoxon(first[both] - second[both], alternative="greater").pvalue > SIGNIFICANCE:
            break
        count += 1
    if not count:
        return data, []
    which = "first point" if count == 1 else f"first {count} points"
    text = f"{which} of every curve, measured before the field had settled: replaced by the parabola through the next {_FIT} points"
    return data.map(lambda record: _continued(record, count)), [Note(Code.CURVES, text)]


def _distance(record: Record, place: int) -> float:
    """Distance of a used sample from the parabola through the next ones, over its factor of error; NaN near the end of a curve."""
    part = np.flatnonzero(record.used)[place : place + 1 + _FIT]
    if part.size <= _FIT or np.ptp(record.u[part]) == 0:
        return np.nan
    weights = _parabola(record.u[part[1:]], record.u[part[:1]])[0]
    return float(abs(record.y[part[0]] - weights @ record.y[part[1:]]) / np.sqrt(1 + weights @ weights))


def _parabola(known: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Weights of outputs at known inputs (N,) in the best parabola at wanted ones (M,), shape (M, N)."""
    scale = float(np.ptp(known)) or 1.0
    columns = lambda u: np.vander((u - known[0]) / scale, 3)
    return columns(wanted) @ np.linalg.pinv(columns(known))


def _continued(record: Record, count: int) -> Record:
    """The record with its first used outputs from the parabola after them; unchanged where it is too short."""
    used = np.flatnonzero(record.used)
    if used.size < count + _FIT:
        return record
    first, after = used[:count], used[count : count + _FIT]
    y = record.y.copy()
    y[first] = _parabola(record.u[after], record.u[first]) @ record.y[after]
    return dataclasses.replace(record, y=y)
