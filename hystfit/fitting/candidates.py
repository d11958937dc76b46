"""Which models are worth trying on records, by what `check` finds about them."""

from __future__ import annotations

import dataclasses

from hystfit.data.record import Dataset
from hystfit.models.registry import SEARCH, DataKind, compared, make_model
from hystfit.quality.loops import loop_area
from hystfit.quality.reversal_curves import recognize_family
from hystfit.quality.summary import RecordQuality, summarize

_SYMMETRIC = 5.0  # percent of the stroke up to which a loop counts as symmetric about its center
_CENTERED = 0.2  # distance of the middle of the input from 0, in parts of its range, up to which it counts as centered


@dataclasses.dataclass(frozen=True)
class Candidates:
    """Models that a comparison tries.

    Attributes:
        names: expressions; those whose weights follow from a linear solve come first, because they take seconds.
        reason: what was found about the data.
    """

    names: tuple[str, ...]
    reason: str


def candidates(data: Dataset) -> Candidates:
    """Models worth comparing on records, and why."""
    if recognize_family(data) is not None:
        return Candidates(compared("reversal-curves"), "the records are first-order reversal curves")
    records = [summarize(record) for record in data]
    timed = all(record.t is not None for record in data)
    kinds: list[DataKind] = []
    if _clockwise(data, records):
        kinds.append("leading")
        found = ["clockwise loops (a force that leads)"]
        if timed and any(record.speed_dependent for record in records):
            kinds.append("leading-with-rate")
            found.append("an output that depends on the rate of the input")
    else:
        kinds.append("lagging-timed" if timed else "lagging-untimed")
        found = [f"counter-clockwise loops (an output that lags) with{'' if timed else 'out'} time"]
        if all(_point_symmetric(record) for record in records):
            kinds.append("point-symmetric")
            found.append("loops symmetric about their center")
    if any(record.dynamic for record in records):
        kinds.append("dynamic")
        found.append("a resonance")
    names = (SEARCH, *compared(*kinds))
    linear = lambda name: name == SEARCH or make_model(name).estimator is not None
    return Candidates(tuple(sorted(names, key=linear, reverse=True)), "the data have " + ", ".join(found))


def _clockwise(data: Dataset, records: list[RecordQuality]) -> bool:
    """Whether most loops run clockwise; by the area inside the records where no loop could be measured."""
    ways = [record.shape.circulation for record in records if record.shape is not None and record.shape.circulation]
    if ways:
        return 2 * ways.count("clockwise") > len(ways)
    return sum(loop_area(record.u[record.used], record.y[record.used]) for record in data) <= 0


def _point_symmetric(record: RecordQuality) -> bool:
    """Whether the loop is that of a material without remembered sign: centered on zero input, and alike on both sides."""
    if record.shape is None or abs(record.u.low + record.u.high) > 2 * _CENTERED * record.u.range:
        return False
    return record.shape.asymmetry_percent <= _SYMMETRIC
