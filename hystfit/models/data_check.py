"""`check`: the data-quality report, with a verdict for each model, and the models that suit the data."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from hystfit.models.registry import MODELS, DataKind, judged, judged_as
from hystfit.outcome.note import Code, has
from hystfit.quality.check import Advice, QualityReport, examine
from hystfit.quality.determination import ASYMMETRIC, Determination, Verdict, delayed, falling
from hystfit.quality.record_quality import RecordQuality
from hystfit.reading.in_memory import records_of

_FORCES = ("N", "mN", "uN", "µN", "kN", "MN", "kip", "lbf", "lb", "kgf")
_SYMMETRIC = 5.0  # percent of the stroke up to which a loop counts as symmetric about its center
_CENTERED = 0.2  # distance of the middle of the input from 0, relative to its range, up to which it counts as centered
_RANK = {Verdict.YES: 0, Verdict.PARTLY: 1, Verdict.NO: 2}


def check(data: Any, y: Any = None, t: Any = None, *, u: Any = None) -> QualityReport:
    """Data-quality report of records, of a data frame or of arrays, which models the data determine,
    and which to try first.

    Args:
        data: a record, several, or a data frame; or the input, shape (T,).
        y: output, shape (T,); of a data frame the name or number of its column, guessed by default.
        t: time of each sample [s], shape (T,), or a column of a data frame.
        u: column of the input in a data frame; or the input, where it is given by name.

    Raises:
        DataError: `data` holds no records.
    """
    report = examine(records_of(data, y, t, u=u), judged())
    advice = _determined(_advice(report), report)
    if advice is not None and falling(report.records) and advice.model != "preisach-forc":
        advice = dataclasses.replace(
            advice, model=f"negate+{advice.model}", reason=f"the output falls, mirrored: {advice.reason}"
        )
    if advice is not None and delayed(report.records):
        advice = dataclasses.replace(advice, model=f"delay+{advice.model}", reason=f"a pure delay: {advice.reason}")
    first = set() if advice is None else {judged_as(part) for part in advice.model.split("+")}
    rank = lambda item: (item.model not in first, _RANK[item.verdict])
    return dataclasses.replace(report, advice=advice, determines=tuple(sorted(report.determines, key=rank)))


def data_kinds(records: Sequence[RecordQuality]) -> tuple[DataKind, ...]:
    """The kinds of data of the records, apart from reversal curves; each has its own models (`registry.compared`)."""
    timed = all(record.sampling.rate is not None for record in records)
    kinds: list[DataKind] = []
    if _clockwise(records):
        kinds.append("leading")
        if timed and any(record.speed_dependent for record in records):
            kinds.append("leading-with-rate")
    else:
        kinds.append("lagging-timed" if timed else "lagging-untimed")
        if any(record.slow_lag is not None for record in records):
            kinds.append("lagging-late")
        if all(_point_symmetric(record) for record in records):
            kinds.append("point-symmetric")
    if any(record.dynamic for record in records):
        kinds.append("dynamic")
    return tuple(kinds)


def _clockwise(records: Sequence[RecordQuality]) -> bool:
    """Whether most loops run clockwise, mirrored where the output falls; by the area inside the records where no loop is open."""
    ways = [way for record in records if (way := record.circulation)]
    if ways:
        return 2 * ways.count("clockwise") > len(ways)
    return sum(-record.area if record.falls else record.area for record in records) <= 0


def _point_symmetric(record: RecordQuality) -> bool:
    """Whether the loop is centered on zero input and symmetric about its center."""
    if record.shape is None or abs(record.u.low + record.u.high) > 2 * _CENTERED * record.u.range:
        return False
    return record.shape.asymmetry_percent <= _SYMMETRIC


def _asymmetric(report: QualityReport) -> bool:
    return any(r.shape is not None and r.shape.asymmetry_percent > ASYMMETRIC for r in report.records)


def _advice(report: QualityReport) -> Advice | None:
    """The model to try first; None where the data determine no hysteresis, or show damage that no model describes."""
    verdicts = {item.model: item for item in report.determines}
    kinds = data_kinds(report.records)
    if has(report.findings, Code.REVERSAL_CURVES):
        return Advice("preisach-forc", "first-order reversal curves")
    if all(item.verdict is Verdict.NO for name, item in verdicts.items() if MODELS[name].place == "core"):
        return None
    if "dynamic" in kinds:
        if all(record.units["u"] in _FORCES for record in report.records):
            return Advice("oscillator", "the displacement resonates under a force")
        return Advice("bouc-wen+second-order", "the output resonates")
    if kinds[0] == "leading":
        if "leading-with-rate" in kinds:
            return Advice(
                "bouc-wen-force+viscous", "the loop runs clockwise, and the force depends on the input's speed"
            )
        return Advice(
            "bouc-wen-force", "the loop runs clockwise, as force against displacement; or prandtl-ishlinskii-stop"
        )
    return _lagging(report, kinds, verdicts)


def _determined(advice: Advice | None, report: QualityReport) -> Advice | None:
    """The advice, or the first model that the data determine where they do not determine any of its parts."""
    if advice is None:
        return None
    hysteresis = [item for item in report.determines if MODELS[item.model].place == "core"]
    undetermined = {item.model for item in hysteresis if item.verdict is Verdict.NO}
    if not undetermined & {judged_as(name) for name in advice.model.split("+")}:
        return advice
    best = min(hysteresis, key=lambda item: _RANK[item.verdict])
    return (
        None if best.model in undetermined else Advice(best.model, "the first model that these few samples determine")
    )


def _lagging(report: QualityReport, kinds: tuple[DataKind, ...], verdicts: dict[str, Determination]) -> Advice:
    """Plays with lag and creep where there is time; a Preisach model for magnetic loops of several amplitudes."""
    reasons = ["the loop runs counter-clockwise"]
    if all(record.switches for record in report.records):
        return Advice("preisach", "the output switches between two values")
    if kinds[0] == "lagging-untimed" and not has(report.findings, Code.MINOR_LOOPS):
        reasons.append("without time, at several amplitudes")
        return Advice("preisach-magnetic" if "point-symmetric" in kinds else "preisach", ", ".join(reasons))
    parts = ["prandtl-ishlinskii-generalized" if _asymmetric(report) else "prandtl-ishlinskii"]
    if any(record.lags for record in report.records):
        parts.insert(0, "lag")
        reasons.append("the output lags")
    if verdicts["creep"].verdict is Verdict.YES:
        parts.append("creep")
        reasons.append("it creeps")
    if _asymmetric(report):
        reasons.append("the loop is asymmetric")
    return Advice("+".join(parts), ", ".join(reasons))
