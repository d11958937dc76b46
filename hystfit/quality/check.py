"""The data-quality report: what the records hold, what is wrong with them, and which models they determine."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.outcome.note import Code, Note, Severity, has, warn
from hystfit.outcome.notebook import fragment
from hystfit.outcome.table import Column, Table, number
from hystfit.outcome.wrapping import shortened
from hystfit.quality.coverage import coverage_notes
from hystfit.quality.damage import fails_at, whole_until
from hystfit.quality.determination import Determination, Verdict, count, determine
from hystfit.quality.drift import Drift
from hystfit.quality.equal_inputs import apart_note
from hystfit.quality.findings import findings
from hystfit.quality.needs import Needs
from hystfit.quality.other_curves import no_loop_reason
from hystfit.quality.record_quality import RecordQuality
from hystfit.quality.reversal_curves import ReversalFamily, recognize_family
from hystfit.quality.summary import summarize

_MOST_RECORDS, _MOST_FINDINGS = 8, 40  # shown in the text


@dataclasses.dataclass(frozen=True)
class Advice:
    """The model that a fit without one takes.

    Attributes:
        model: as an expression such as "lag+prandtl-ishlinskii+creep".
        reason: why, and what these data do not test, in words.
    """

    model: str
    reason: str


@dataclasses.dataclass(frozen=True)
class Trait:
    """A trait of the loops: a model with a term for it has a smaller error on held-out samples than every model without.

    Attributes:
        name: "degrading", "peak-oriented", "pinched", "viscoelastic" or "rate-dependent".
        model: with the term.
        error_percent: its error on held-out samples, percent of the range.
        other, other_percent: the best model without, and its error.
    """

    name: str
    model: str
    error_percent: float
    other: str
    other_percent: float

    def __str__(self) -> str:
        return (
            f"{self.name}: {self.model} has an error of {self.error_percent:.2g} % of the range on held-out samples, the best model "
            f"without such a term ({self.other}) {self.other_percent:.2g} %"
        )


@dataclasses.dataclass(frozen=True)
class QualityReport:
    """Quality of a data set.

    Attributes:
        name: of the data set.
        records: what was measured on each record.
        findings: faults and noteworthy properties of the data.
        determines: which models the data determine, the recommended one first.
        advice: the model that a fit takes; None where the data determine none.
        traits: what the loops show.
    """

    name: str
    records: tuple[RecordQuality, ...]
    findings: tuple[Note, ...]
    determines: tuple[Determination, ...]
    advice: Advice | None = None
    traits: tuple[Trait, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """As plain lists, dicts, numbers and None, ready for JSON."""
        return {
            "name": self.name,
            "records": [_plain(dataclasses.asdict(record)) for record in self.records],
            "findings": [note.to_dict() for note in self.findings],
            "determines": [_plain(dataclasses.asdict(item)) for item in self.determines],
            "advice": None if self.advice is None else dataclasses.asdict(self.advice),
            "traits": [dataclasses.asdict(trait) for trait in self.traits],
        }

    def verdict(self, model: str) -> Determination:
        """Whether the data determine one model.

        Raises:
            KeyError: no such model in the report.
        """
        return {item.model: item for item in self.determines}[model]

    def table(self) -> Table:
        """Verdict and reason with the models for which they hold."""
        models: dict[tuple[Verdict, str], list[str]] = {}
        every = [reason for item in self.determines for reason in item.reasons]
        for item in self.determines:
            shared = [reason for reason in item.reasons if every.count(reason) > 1]
            alone = "; ".join(reason for reason in item.reasons if reason not in shared)
            for reason in (*shared, *([alone] if alone else [])):
                models.setdefault((item.verdict, reason), []).append(item.model)
        rows = [[verdict, f"{', '.join(names)}: {reason}"] for (verdict, reason), names in models.items()]
        columns = [Column("determined"), Column("models and reason", left=True)]
        return Table(columns, sorted(rows, key=lambda row: list(Verdict).index(Verdict(row[0]))))

    def text(self) -> str:
        """As a page of text."""
        several = len(self.records) > _MOST_RECORDS
        shown = self.records[: _MOST_RECORDS // 2] if several else self.records
        lines = [f"Data quality: {self.name}"]
        for record in shown:
            lines += ["", f"  {record.name}", *Table([Column(""), Column("", left=True)], _rows(record)).lines("    ")]
        if several:
            lines.append(f"  ... and {len(self.records) - len(shown)} more records")
        lines += ["", "Findings"]
        findings = [f"  - {note}" for note in self.findings] or ["  - no problems found"]
        lines += shortened(findings, _MOST_FINDINGS, "  ... and {} more")
        if self.determines:
            lines += ["", "What these data determine", *self.table().lines("  ")]
        if self.traits:
            lines += ["", "What the loops show", *(f"  - {trait}" for trait in self.traits)]
        if self.advice is not None:
            lines += ["", f"Try first: {self.advice.reason}"]
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        shown = self.records[:_MOST_RECORDS]
        parts = [part for record in shown for part in (record.name, Table(["", Column("", left=True)], _rows(record)))]
        rest = len(self.records) - len(shown)
        notes = self.findings[:_MOST_FINDINGS]
        more = f"and {rest} more records" if rest else ""
        return fragment(
            f"Data quality: {self.name}",
            (*parts, more, "Findings" if notes else "No problems found", notes, *map(str, self.traits), self.table()),
        )


def examine(data: Record | Dataset, needs: Mapping[str, Needs] | None = None) -> QualityReport:
    """Data-quality report of a record or a data set.

    Args:
        needs: what each model needs from data, by its name; without them no model is judged.

    Raises:
        DataError: `data` holds no records.
    """
    dataset = Dataset.of(data)
    records = tuple(_measured(record, single=len(dataset) == 1) for record in dataset)
    notes, determined = (*conditions_of(dataset), *findings(records)), determine(records, needs or {})
    reasons = [no_loop_reason(record) for record in dataset]
    if all(reasons):
        first = [warn(Code.NO_LOOP, reason) for reason in dict.fromkeys(reasons) if reason]
        notes = (*first, *(note for note in notes if note.code not in (Code.NO_LOOP, Code.NOT_CLOSED)))
    family = recognize_family(dataset)
    if family is None:
        notes = (*([apart] if (apart := apart_note(tuple(dataset))) else []), *notes)
        if not has(notes, Code.NO_LOOP, Code.SINGLE_VALUED):
            notes = (*notes, *coverage_notes(dataset))
    else:
        falling = (
            sum(record.falls for record in records) > len(records) / 2
        )  # not one by noise, which begins near saturation
        aside = {Code.NO_LOOP, Code.TOO_FEW_SAMPLES} | (set() if falling else {Code.FALLING})
        notes = tuple(note for note in notes if note.code not in aside)
        about = [
            Note(Code.REVERSAL_CURVES, family.words()),
            *(warn(Code.REVERSAL_CURVES, text) for text in family.notes),
        ]
        notes = (*about, *notes)
        determined = tuple(_by_family(item, family) if item.model == "preisach" else item for item in determined)
    return QualityReport(dataset.name, records, notes, determined)


def conditions_of(data: Dataset) -> tuple[Note, ...]:
    """Warnings of the reader that a record holds measurements at several conditions or levels of a further input, each once."""
    several = lambda note: note.severity is Severity.WARNING and note.option is not None
    notes = (note for record in data for note in record.notes if note.code is Code.CONDITIONS or several(note))
    return tuple(dict.fromkeys(dataclasses.replace(note, code=Code.CONDITIONS) for note in notes))


def _measured(record: Record, *, single: bool) -> RecordQuality:
    quality = summarize(record)
    if not single:
        return quality
    return dataclasses.replace(quality, whole_until=whole_until(record, quality), fails_at=fails_at(record, quality))


def _by_family(item: Determination, family: ReversalFamily) -> Determination:
    reason = f"{len(family.curves)} first-order reversal curves determine the density (use preisach-forc)"
    verdict = Verdict.PARTLY if family.notes else Verdict.YES
    return Determination(item.model, verdict, (reason, *family.notes))


def _rows(record: RecordQuality) -> list[tuple[str, str]]:
    """Labels and values for the text of one record."""
    sampling, motion, shape, units = record.sampling, record.motion, record.shape, record.units
    rate = "no time"
    if sampling.rate is not None:
        rate = f"{sampling.rate:.6g} per {units['t'] or 'unit of time'}, {sampling.duration:.6g} {units['t']} long"
    rows = [("samples", f"{sampling.n}, {rate}")]
    for symbol, column in (("input u", record.u), ("output y", record.y)):
        extent = f"{column.low:.6g} to {column.high:.6g} {units[symbol[-1]]}".rstrip()
        noise = ("at most " if column.noise_is_bound else "") + number(column.noise_rms, ".2g")
        rows.append((symbol, f"{extent}, noise {noise} rms"))
    loops = f"{count(motion.closed_loops, 'closed loop')} ({motion.major} major, {motion.minor} minor, {motion.nested} nested)"
    counts = f"{count(motion.reversals, 'reversal')}, {count(motion.cycles, 'cycle')}, {loops}"
    rows.append(("loops", f"{counts}, amplitudes: {len(motion.strokes)}, holds: {motion.holds}"))
    if shape is not None:
        width = f"{shape.width:.4g} {units['y']}".rstrip() + f" ({shape.width_percent:.1f} % of the stroke)"
        form = f"{shape.circulation or 'no open loop'}, closure {number(shape.closure_percent, '+.2f')} %"
        rows.append(("shape", f"width {width}, {form}, asymmetry {shape.asymmetry_percent:.1f} %"))
    rows.append(("drift", _drift_words(record.drift, units["y"])))
    lag = record.lag
    rows.append(("lag", "-" if lag is None else f"{lag.samples:.2f} +- {lag.stderr:.2f} samples"))
    return rows


def _drift_words(drift: Drift | None, unit: str) -> str:
    """The slope of the law of a drift; that of a line says nothing where no law explains the means."""
    if drift is None:
        return "- (needs four cycles of equal amplitude)"
    if drift.law == "none":
        return f"none in the means of {count(drift.cycles, 'similar cycle')}"
    slope, step = (drift.per_cycle, "cycle") if drift.law == "linear" else (drift.per_decade, "decade of time")
    return f"{number(slope, '.3g')} {unit}".rstrip() + f" per {step} ({drift.law})"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
