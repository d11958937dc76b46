"""First-order reversal curves: monotonic branches from their reversal points back towards saturation."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from hystfit.data.circulation import SLACK
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.quality.loops import APART

_LEAST = 5  # number of curves from which records are recognized as a family
_APART = 0.3  # least spread of the reversal points of a recognized family, as a fraction of the input's range


@dataclasses.dataclass(frozen=True)
class ReversalFamily:
    """First-order reversal curves in order of reversal.

    Attributes:
        curves: samples that count, each from its reversal point; the curve nearest to saturation first.
        rising: they rise, from positive saturation.
        notes: curves that cross, or do not close.
    """

    curves: tuple[Record, ...]
    rising: bool
    notes: tuple[str, ...]

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
    return ReversalFamily(tuple(curves), rises[0], tuple(_notes(curves, rises[0])))


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


def _notes(curves: list[Record], rising: bool) -> list[str]:
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
    if worst > SLACK * span:
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
