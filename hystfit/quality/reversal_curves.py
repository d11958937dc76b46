"""First-order reversal curves as data: branches that run one way from their reversal points back towards saturation."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError

_LEAST = 5  # curves from which records are recognized as a family
_APART = 0.3  # spread of the reversal points of a recognized family, in parts of the input's range
_BACK = 0.01  # by which a curve's input may run back, in parts of its range
_CROSS = 0.01  # crossing of neighboring curves, in parts of the output's range, that is told
_CLOSE = 0.05  # spread of the curves' ends at the largest common input that is told


@dataclasses.dataclass(frozen=True)
class ReversalFamily:
    """First-order reversal curves in order of reversal.

    Attributes:
        curves: samples that count, the reversal point first, the one nearest the saturation they came from first.
        rising: they run upward, having come from positive saturation.
        notes: where curves cross, or do not close.
    """

    curves: tuple[Record, ...]
    rising: bool
    notes: tuple[str, ...]

    def words(self) -> str:
        """In one line, for a report."""
        start = [r.u[0] for r in self.curves]
        way, side = ("rise", "positive") if self.rising else ("fall", "negative")
        return (
            f"{len(self.curves)} first-order reversal curves: they {way} from reversals at {min(start):.4g} to {max(start):.4g} "
            f"back towards {side} saturation"
        )


def reversal_curves(data: Dataset | Sequence[Record]) -> ReversalFamily:
    """Check that records are first-order reversal curves. Samples that do not count are passed over, and curves of one sample.

    Args:
        data: one record a curve, the reversal point first.

    Raises:
        DataError: fewer than two curves, branches that turn round, or directions that differ.
    """
    curves = [_counting(record) for record in Dataset.of(data) if np.count_nonzero(record.used) > 1]
    if len(curves) < 2:
        raise DataError(
            f"reversal curves come in families; got {len(curves)} record(s): read the file by its curve column (by=)"
        )
    rises = [bool(np.sum(np.sign(np.diff(r.u))) > 0) for r in curves]
    if len(set(rises)) > 1:
        raise DataError(f"{sum(rises)} of {len(curves)} curves rise and the others fall: give one kind at a time")
    for r, rising in zip(curves, rises, strict=True):
        way = r.u if rising else -r.u
        back = np.maximum.accumulate(way) - way
        if back.max() > _BACK * np.ptp(r.u):
            turn = int(np.argmax(way[: int(np.argmax(back))]))
            raise DataError(
                f"curve {r.name!r} turns round at sample {turn}: a reversal curve runs one way from its reversal point; split it "
                "there"
            )
    curves.sort(key=lambda r: r.u[0], reverse=rises[0])
    return ReversalFamily(tuple(curves), rises[0], tuple(_notes(curves, rises[0])))


def recognize_family(data: Dataset | Sequence[Record]) -> ReversalFamily | None:
    """The family that records are, where they look like one: five or more, each from its own reversal past all others'.

    None where they do not.
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


def _counting(record: Record) -> Record:
    if record.used.all():
        return record
    at = record.used
    t = None if record.t is None else record.t[at]
    return record.replace(u=record.u[at], y=record.y[at], t=t, weight=record.weight[at])


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
    if worst > _CROSS * span:
        notes.append(
            f"curves {pair[0]} and {pair[1]} cross by {worst / span:.1%} of the range: non-negative masses cannot follow that"
        )
    end = min(r.u.max() for r in curves) if rising else max(r.u.min() for r in curves)
    ends = [float(at_inputs(r, np.array([end]))[0]) for r in curves]
    if np.ptp(ends) > _CLOSE * span:
        notes.append(
            f"at {end:g} the curves differ by {np.ptp(ends) / span:.1%} of the range: they do not close, "
            "so the largest field was no saturation"
        )
    return notes


def at_inputs(record: Record, u: np.ndarray) -> np.ndarray:
    """Output of a curve at inputs, between its samples on straight lines."""
    order = np.argsort(record.u, kind="stable")
    return np.interp(u, record.u[order], record.y[order])
