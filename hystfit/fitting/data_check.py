"""`check`: the data-quality report, with the model that a fit without one takes, what the loops show, and a drift."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hystfit.config import verb
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import HystfitError
from hystfit.fitting.comparison.candidates import candidates
from hystfit.fitting.comparison.compare import compare
from hystfit.fitting.comparison.compared_models import Comparison, Row
from hystfit.fitting.fit_setup import without_faults
from hystfit.fitting.solvers.ridge import LinearSystem, fit_ridge, linear_positions
from hystfit.fitting.solvers.thinning import coarse, thinned
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import SEARCH, judged, judged_as, make_model
from hystfit.models.self_similar import POWERS, SelfSimilarStops
from hystfit.models.springpot import Springpot
from hystfit.models.viscoelastic import Viscoelastic
from hystfit.outcome import Code, Note, Status
from hystfit.outcome.note import has, warn
from hystfit.quality.baselines import Baselines
from hystfit.quality.check import Advice, QualityReport, Trait, examine
from hystfit.quality.determination import Verdict, count
from hystfit.quality.findings import INTEGRATED
from hystfit.quality.held_out import equal_errors
from hystfit.quality.loops import clear_reversals
from hystfit.quality.summary import paces
from hystfit.reading.in_memory import records_of
from hystfit.results.accuracy import is_noise

_OF_TIME = ("viscoelastic", "rate-dependent")
_STATIC = (
    "prandtl-ishlinskii",
    "prandtl-ishlinskii-stop",
    "prandtl-ishlinskii-hardening",
)  # scored beside what the search took


def traits(data: Dataset, rows: Sequence[Row], baselines: Baselines) -> tuple[Trait, ...]:
    """The trait of the best model, if its error is smaller than those of all models without that trait and of a curve.

    The difference must be larger than what as many errors as the records have branches leave open. Traits of time need branches of several
    durations.
    """
    short = thinned(without_faults(data))
    validated = [row for row in rows if row.score_percent is not None]
    scores: list[_Score] = [
        (row.score * baselines.span / 100, row.name, _kind(make_model(row.name))) for row in validated
    ]
    scores.append((baselines.curve, "a single-valued curve", ""))
    known = {name for row in validated for name in (row.name, row.asked)}
    for name in dict.fromkeys((*_STATIC, *candidates(data).closed)):
        if name != SEARCH and name not in known:
            scores += _scored(name, short)
    branches = sum(clear_reversals(record.u).size + 1 for record in short)
    left_out = {None} if paces(data) > 1 else {None, *_OF_TIME}
    (error, name, kind), (other, rival, _) = _first_two(scores, left_out)
    equal = equal_errors(branches)
    if kind == "" or error * equal >= other:
        return ()
    percent = lambda value: float(100 * value / baselines.span)
    found = [Trait(kind, name, percent(error), rival, percent(other))]
    for term, words, without in _counterparts(name, short) if kind == "degrading" else ():
        if error * equal < without:
            found.append(Trait(term, name, percent(error), f"{name} {words}", percent(without)))
    return tuple(found)


_Score = tuple[float, str, str | None]  # error on held-out samples, name and trait of a model


def _first_two(scores: Sequence[_Score], left_out: set[str | None]) -> tuple[_Score, _Score]:
    """The best model, and the best of those with another trait; those with some traits are left out."""
    scores = [score for score in scores if score[2] not in left_out]
    first = min(scores)
    return first, min((score for score in scores if score[2] != first[2]), default=first)


def _kind(model: AbstractHysteresis) -> str | None:
    """The trait that a model has a term for; "" for static loops without damage, None where creep accounts for its time."""
    parts = getattr(model, "parts", (model,))
    if model.without_creep() is not None:
        return None
    if any(isinstance(part, (Springpot, Viscoelastic)) for part in parts):
        return "viscoelastic"
    return "degrading" if model.degrades else "" if model.rate_independent else "rate-dependent"


def _scored(name: str, short: Dataset) -> list[_Score]:
    """Error, name and trait of a model at its starting values; nothing where it cannot be solved for."""
    try:
        model = make_model(name).start(list(short))
        return [(_error(model, short), name, _kind(model))]
    except (HystfitError, np.linalg.LinAlgError):
        return []


def _counterparts(name: str, short: Dataset) -> Iterator[tuple[str, str, float]]:
    """Traits of self-similar stops, the same model without the term for each, in words, and its error; none of another model."""
    model = make_model(name).start(list(short))
    if isinstance(model, SelfSimilarStops):
        largest = max(float(np.max(np.abs(record.u))) for record in short)
        unscaled = _error(dataclasses.replace(model, floor=largest), short)
        yield "peak-oriented", "over the largest input of the record", unscaled
        yield "pinched", "with branches that only soften", float(fit_ridge(without_slip(Problem(model, short))).score)


def _error(model: AbstractHysteresis, data: Dataset) -> float:
    """Root mean square error on held-out samples, weights solved for [y]."""
    problem = Problem(model, data)
    return float(fit_ridge(LinearSystem.of(problem, problem.space.vector(problem.model))).score)


_BENT = [power for power in POWERS if power > 1]


def without_slip(problem: Problem) -> LinearSystem:
    """The linear system of self-similar stops, alone in a problem, whose branches at one peak can only soften.

    A pinched branch is soft near zero input and stiffens towards the last peak: the device slips until the gap of the last peak is closed.
    Stops do so by negative weights, and self-similar stops by powers of u over its peak too. Here the weights of the stops are >= 0, and
    the powers above one are of u itself: a spring that hardens makes no slip that grows with the peak.
    """
    system = LinearSystem.of(problem, problem.space.vector(problem.model))
    names = [problem.space.names[k] for k in linear_positions(problem)]
    stops, powers = problem.model.w.shape[-1], len(POWERS)
    bent = {f"c[{peak},{k}]" for peak in range(problem.model.peaks.size) for k in range(1, powers)}
    bent |= {f"fading[{stops + k}]" for k in range(1, powers)}
    kept = np.array([name not in bent for name in names])
    softening = np.array([name.startswith("w[") for name in names])
    spring = _spring(list(problem.data))
    added = np.ones(spring.shape[1], dtype=bool)
    return dataclasses.replace(
        system,
        columns=np.hstack([system.columns[:, kept], spring]),
        free=np.append((system.free & ~softening)[kept], added),
        ridged=np.append(system.ridged[kept], added),
    )


def _spring(records: Sequence[Record]) -> np.ndarray:
    """Odd powers of the input over its largest value, weighted, on the samples that count, shape (n, powers)."""
    largest = max(float(np.max(np.abs(record.u))) for record in records)
    places = ((record.u[record.used] / largest, record.weight[record.used]) for record in records)
    return np.concatenate([np.sqrt(weight)[:, None] * v[:, None] ** np.array(_BENT) for v, weight in places])


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
    report = examine(records, judged())
    found = None if data_only or is_settled(report) else _compared(records)
    return with_models(report, records, found)


def is_settled(report: QualityReport) -> bool:
    """Whether no model can add to a report: there is no loop, no one loop, or the output is to be integrated first."""
    charge = any(note.option == INTEGRATED for note in report.findings)
    return charge or has(report.findings, Code.NO_LOOP, Code.RECORDS_DIFFER)


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
