"""`check`: the data-quality report, with the model that a fit without one takes, what the loops show, and a drift."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from hystfit.config import verb
from hystfit.data.dataset import Dataset
from hystfit.errors import HystfitError
from hystfit.fitting.comparison.candidates import suited
from hystfit.fitting.comparison.compare import compare
from hystfit.fitting.comparison.compared_models import Comparison
from hystfit.fitting.comparison.traits import traits
from hystfit.fitting.fit_setup import without_faults
from hystfit.fitting.solvers.thinning import coarse
from hystfit.models.registry import judged, judged_as
from hystfit.outcome import Code, Note, Severity, Status
from hystfit.outcome.note import has, warn
from hystfit.quality.baselines import Baselines
from hystfit.quality.check import Advice, QualityReport, Trait, examine
from hystfit.quality.determination import Verdict, count
from hystfit.quality.findings import INTEGRATED
from hystfit.quality.held_out import equal_errors
from hystfit.reading.in_memory import records_of
from hystfit.results.accuracy import is_noise

_RANK = {Verdict.YES: 0, Verdict.PARTLY: 1, Verdict.NO: 2}


@verb
def check(data: Any, y: Any = None, t: Any = None, *, u: Any = None, data_only: bool = False) -> QualityReport:
    """Data-quality report of records, of a data frame or of arrays, which models the data determine, and which one a fit takes.

    Args:
        data: a record, several, or a data frame; or the input, shape (T,).
        y: output, shape (T,); of a data frame the name or number of its column, guessed by default.
        t: time of each sample [s], shape (T,), or a column of a data frame.
        u: column of the input in a data frame; or the input, where it is given by name.
        data_only: do not compare models, which takes nearly all of the time.

    Raises:
        DataError: `data` holds no records.
    """
    records = records_of(data, y, t, u=u)
    suits = suited(records)
    report = examine(records, {name: needs for name, needs in judged().items() if suits(needs)})
    found = None if data_only or is_settled(report) else _compared(records)
    return with_models(report, records, found)


def is_settled(report: QualityReport) -> bool:
    """Whether no model can add to a report: there is no loop, no one loop, too few samples, or the output is to be integrated first."""
    rate = any(
        note.code is Code.RATE and (note.option == INTEGRATED or note.severity is Severity.WARNING)
        for note in report.findings
    )
    few = any(note.code is Code.TOO_FEW_SAMPLES and note.severity is Severity.ERROR for note in report.findings)
    return rate or few or has(report.findings, Code.NO_LOOP, Code.RECORDS_DIFFER)


def with_models(report: QualityReport, records: Dataset, found: Comparison | None) -> QualityReport:
    """A report of records with what a comparison adds: which model a fit takes, what the loops show, which findings it refutes."""
    shown = () if found is None else _traits(records, found)
    advice, findings = _judged(report, found)
    first = set() if advice is None else {judged_as(part.partition(":")[0]) for part in advice.model.split("+")}
    rank = lambda item: (item.model not in first, _RANK[item.verdict])
    return dataclasses.replace(
        report,
        findings=findings,
        advice=advice,
        traits=shown,
        determines=tuple(sorted(report.determines, key=rank)),
    )


def _judged(report: QualityReport, found: Comparison | None) -> tuple[Advice | None, tuple[Note, ...]]:
    """The advice, and the findings with what the comparison adds and refutes."""
    findings = report.findings
    if found is None or all(record.single_valued for record in report.records):
        return None, findings
    if _is_curve(found):
        explained = has(findings, Code.SINGLE_VALUED, Code.CROSSING, Code.DRIFT)
        return None, findings if explained else (*findings, _no_loop(found))
    if not has(findings, Code.DRIFT, Code.LAG, Code.DYNAMICS):
        findings = (*findings, *(note for note in found.winner.notes if note.code is Code.DRIFT))
    degrades = found.winner.model.degrades
    if has(findings, Code.FAILURE) and not (degrades and found.winner.status is Status.OK):
        return None, findings  # a model can describe the part before it
    if not degrades:
        if found.rows[0].leaves_noise:
            findings = tuple(note for note in findings if note.code is not Code.DEGRADING)
        elif has(findings, Code.DEGRADING):
            return None, findings
    return Advice(found.winner.name, found.reason), findings


def _compared(records: Dataset) -> Comparison | None:
    """What a fit without a model takes; None where the records drive none."""
    try:
        return compare(records)
    except HystfitError:
        return None


def _is_curve(found: Comparison) -> bool:
    """Whether a single-valued curve describes the records as well as the best model, or its fit without time shows no loop."""
    winner = found.winner
    samples = sum(int(record.used.sum()) for record in winner.problem.data)
    fitted = [row.score for row in found.rows if row.status is Status.NO_LOOP and not row.hysteretic]
    curve = min(100 * winner.baselines.curve / winner.baselines.span, *fitted, math.inf)
    as_well = found.rows[0].score * equal_errors(samples) >= curve
    return as_well or winner.model.memoryless or (winner.status is Status.NO_LOOP and winner.model.rate_independent)


def _no_loop(found: Comparison) -> Note:
    tried = count(sum(row.fitted for row in found.rows), "model")
    text = (
        f"none of the {tried} that were tried describes these data better than a single-valued curve: "
        "there is no loop, or it is too narrow for the noise and the sampling, or of a kind that they do not describe"
    )
    return warn(Code.SINGLE_VALUED, text)


def _traits(records: Dataset, found: Comparison) -> tuple[Trait, ...]:
    """What the loops show; nothing where a single-valued curve describes them."""
    data = coarse(without_faults(records))
    baselines = Baselines.of(data)
    best = found.winner.model
    if is_noise(baselines.curve, baselines) or (
        best.rate_independent and not best.degrades and found.rows[0].leaves_noise
    ):
        return ()
    try:
        return traits(data, found.rows, baselines)
    except HystfitError:
        return ()
