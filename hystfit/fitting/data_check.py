"""`check`: the data-quality report, with what a competition of models with a closed form shows: the one to try first, and a drift."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from hystfit.config import verb
from hystfit.data.dataset import Dataset
from hystfit.errors import HystfitError
from hystfit.fitting.candidates import candidates, timeless
from hystfit.fitting.fit_model import solve_model
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import without_faults
from hystfit.fitting.fit_warnings import drift_note
from hystfit.fitting.remains import residuals_of
from hystfit.fitting.screening import Screened, best_screened, screen
from hystfit.fitting.thinning import coarse, thinned
from hystfit.fitting.traits import traits
from hystfit.models.registry import judged, judged_as, make_model
from hystfit.models.starting import output_range
from hystfit.outcome import Code, Note
from hystfit.outcome.note import has, warn
from hystfit.quality.baselines import Baselines
from hystfit.quality.check import Advice, QualityReport, Trait, examine
from hystfit.quality.determination import Verdict, count
from hystfit.quality.held_out import equal_errors, held_out
from hystfit.reading.in_memory import records_of
from hystfit.results.accuracy import is_noise

_INTEGRATED = ("integrate", "true")  # option that reads a current as the charge, of which the loop is made
_RANK = {Verdict.YES: 0, Verdict.PARTLY: 1, Verdict.NO: 2}


@verb
def check(data: Any, y: Any = None, t: Any = None, *, u: Any = None) -> QualityReport:
    """Data-quality report of records, of a data frame or of arrays, which models the data determine, and which to try first.

    Args:
        data: a record, several, or a data frame; or the input, shape (T,).
        y: output, shape (T,); of a data frame the name or number of its column, guessed by default.
        t: time of each sample [s], shape (T,), or a column of a data frame.
        u: column of the input in a data frame; or the input, where it is given by name.

    Raises:
        DataError: `data` holds no records.
    """
    records = records_of(data, y, t, u=u)
    report = examine(records, judged())
    charge = any(note.option == _INTEGRATED for note in report.findings)
    short = coarse(without_faults(records))
    every = () if charge or has(report.findings, Code.NO_LOOP, Code.RECORDS_DIFFER) else _screened(short)
    shown = _traits(short, every) if every else ()
    screened = () if all(record.single_valued for record in report.records) else every
    best = _best(short, screened) if screened else None
    advice = None if best is None else _advice(short, screened, best)
    damaged = has(report.findings, Code.DEGRADING)
    if damaged and advice is not None and not make_model(advice.model).degrades:
        advice, screened = None, ()
    explained = has(report.findings, Code.SINGLE_VALUED, Code.CROSSING, Code.DRIFT)
    more = [_no_better(len(screened))] if screened and advice is None and not explained else []
    drift = None
    if best is not None and not has(report.findings, Code.DRIFT, Code.LAG, Code.DYNAMICS):
        drift = _drift(short, best)
    first = set() if advice is None else {judged_as(part.partition(":")[0]) for part in advice.model.split("+")}
    rank = lambda item: (item.model not in first, _RANK[item.verdict])
    return dataclasses.replace(
        report,
        findings=(*report.findings, *more, *([drift] if drift else [])),
        advice=advice,
        traits=shown,
        determines=tuple(sorted(report.determines, key=rank)),
    )


def _screened(records: Dataset) -> tuple[Screened, ...]:
    """The models with a closed form and their errors; none where the records drive none."""
    try:
        return tuple(screen(records))
    except HystfitError:
        return ()


def _no_better(models: int) -> Note:
    text = (
        f"none of the {count(models, 'model')} with hysteresis that were tried describes these data better than a single-valued curve: "
        "there is no loop, or it is too narrow for the noise and the sampling, or of a kind that they do not describe"
    )
    return warn(Code.SINGLE_VALUED, text)


def _traits(records: Dataset, screened: Sequence[Screened]) -> tuple[Trait, ...]:
    """What the loops show; nothing where a single-valued curve describes them."""
    baselines = Baselines.of(records)
    try:
        return () if is_noise(baselines.curve, baselines) else traits(records, screened, baselines)
    except HystfitError:
        return ()


def _drift(records: Dataset, best: Screened) -> Note | None:
    """A drift that the residuals of the best model show: those of another one may hide it."""
    if best.found is not None:
        return drift_note(best.found.residuals(), records, output_range(records).width)
    short = thinned(records)
    try:
        fit = solve_model(best.name, short, FitOptions()).unjudged
    except HystfitError:
        return None
    return drift_note(residuals_of(fit), fit.problem.data, output_range(records).width)


def _best(records: Dataset, screened: Sequence[Screened]) -> Screened | None:
    """The best of the models with a closed form; None where none of them describes a loop."""
    baselines = Baselines.of(records)
    samples = sum(int(record.used.sum()) for record in records)
    best = best_screened(screened, samples, baselines.span)
    # A single-valued curve describes them.
    as_well = best.error * equal_errors(samples) >= baselines.curve or make_model(best.name).memoryless
    return None if as_well else best


def _advice(records: Dataset, screened: Sequence[Screened], best: Screened) -> Advice:
    """What to try first."""
    percent = 100 * best.error / Baselines.of(records).span
    reason = f"cross-validation error {percent:.2g} % of the range; it {held_out(list(records)).scheme.tested}"
    if any(one.leaves_noise for one in screened):
        return Advice(best.name, reason)
    searched = (*(one.asked for one in screened if one.searches and one is not best), *candidates(records).iterated)
    of_time = any(one.found is None or not one.found.model.rate_independent for one in screened[:1])
    return Advice(best.name, reason, searched if of_time else timeless(searched))
