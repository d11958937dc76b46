"""A fit judged on data that it did not use: further records, and samples left out of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import HystfitError
from hystfit.outcome import Code, Note, Severity, Status
from hystfit.outcome.note import has, warn
from hystfit.quality.baselines import Baselines
from hystfit.results.accuracy import POOR, Metrics, accuracy_note, exceeded_limits, is_noise
from hystfit.results.result import FitResult

_OFFSET = 0.5  # fraction of the test error that remains, below which a constant offset explains it
_WORSE = 3.0  # times the error of the fit, up to which that of cross-validation is no objection, as up to `POOR`


@dataclasses.dataclass(frozen=True)
class Trial:
    """A fit on records that were not fitted: errors beside those of simple descriptions, `OK`, `ROUGH` or `POOR`, and reasons."""

    metrics: Metrics
    baselines: Baselines
    status: Status
    notes: tuple[Note, ...]


def evaluate_on(result: FitResult, records: Sequence[Record], *, refit_offset: bool = False) -> Trial:
    """Judge a fit on records that were not fitted; with `refit_offset`, each prediction is shifted to the mean of its record."""
    try:
        records = [result.in_fitted_units(result.problem.prepared(record)) for record in records]
        runs = [result.predict(record, refit_offset=refit_offset) for record in records]
    except HystfitError as error:
        raise type(error)(f"test data: {error}") from error
    rows = [(run - record.y)[record.used] for run, record in zip(runs, records, strict=True)]
    metrics = Metrics.of([r.y[r.used] for r in records], [run[r.used] for run, r in zip(runs, records, strict=True)])
    baselines = Baselines.of(result.data, records, refit_offset=refit_offset)
    units = dict.fromkeys(note for record in records for note in record.notes if note.code is Code.UNITS)
    notes, status = [dataclasses.replace(note, text=f"test data: {note.text}") for note in units], Status.OK
    percent = metrics.nrmse_percent
    if percent is not None and percent > POOR and not is_noise(metrics.rmse, baselines):
        status = Status.POOR
        text = f"test data: the error is {percent:.3g} % of the range: the model does not describe these records"
        notes.append(Note(Code.TEST_ERROR, text, Severity.ERROR))
    elif reasons := exceeded_limits(metrics, rows, baselines):
        status = Status.ROUGH
        notes += [warn(Code.TEST_ERROR, f"test data: {text}") for text in reasons]
    notes.append(accuracy_note(metrics, rows, baselines, "test error"))
    notes += [note for record in records if (note := result.extrapolation(record))]
    notes += [note for record in records if (note := result.assumption(record, refit_offset=refit_offset))]
    if status is not Status.OK and not refit_offset:
        shifted = np.concatenate([row - row.mean() for row in rows])
        if np.sqrt(np.mean(shifted**2)) < _OFFSET * metrics.rmse:
            text = "a constant offset of each record explains most of the test error: fit it with refit_offset="
            notes.append(warn(Code.RECORD_PARAMETERS, text))
    return Trial(metrics, baselines, status, tuple(notes))


def with_test(result: FitResult, test: Record | Dataset | Sequence[Record], *, refit_offset: bool = False) -> FitResult:
    """The result judged on records that were not fitted: their error, and a status that includes it; offsets as in `evaluate_on`."""
    trial = evaluate_on(result, list(Dataset.of(test)), refit_offset=refit_offset)
    notes = [Note(Code.OFFSET_REFITTED, "the offset of each test record was refitted")] if refit_offset else []
    status = worse(result.status, trial.status)
    changed = dataclasses.replace(result, test=trial.metrics, test_baselines=trial.baselines, status=status)
    return changed.with_notes(*trial.notes, *notes)


def worse(first: Status, second: Status) -> Status:
    """The status of a fit that has one on its records and another on further data."""
    if first is Status.OK or (first is Status.ROUGH and second is Status.POOR):
        return second
    return first


def with_left_out(result: FitResult, rmse: float) -> FitResult:
    """The result with its cross-validation error [y], which decides the status where it is far larger than that of the fit.

    Where there are at least as many parameters as samples, a warning states that only this error tests the fit.
    """
    result, span = dataclasses.replace(result, left_out=rmse), result.baselines.span
    limit = largest_left_out(span, result.train.rmse)
    if len(result.free_names) >= result.train.n:
        text = f"{len(result.free_names)} parameters for {result.train.n} samples: only the cross-validation error tests this fit"
        if not has(result.notes, Code.MANY_WEIGHTS):
            result = result.with_notes(warn(Code.MANY_WEIGHTS, text))
    if not result.usable or not rmse > limit:
        return result
    text = (
        f"the cross-validation error is {100 * rmse / span:.3g} % of the range, above the limit of {100 * limit / span:.3g} %: the fit "
        "does not predict held-out samples"
    )
    return dataclasses.replace(result.with_notes(warn(Code.LEFT_OUT_ERROR, text), first=True), status=Status.ROUGH)


def with_inner_loops(result: FitResult, rmse: float) -> FitResult:
    """The result with a warning where the error on smaller loops, each amplitude held out in turn [y], is above the limit."""
    span = result.baselines.span
    limit = largest_left_out(span, result.train.rmse)
    if not result.usable or not rmse > limit:
        return result
    text = (
        f"the fit describes these loops and does not predict others: on the smaller loops, each amplitude held out in turn, the error is "
        f"{100 * rmse / span:.3g} % of the range, above the limit of {100 * limit / span:.3g} %"
    )
    return result.with_notes(warn(Code.LEFT_OUT_ERROR, text), first=True)


def carried_over(result: FitResult, other: FitResult) -> FitResult:
    """The result with notes on the choices of another judgment of the same fit, and on its error on smaller loops."""
    carried = {Code.CHOICE} if has(result.notes, Code.LEFT_OUT_ERROR) else {Code.CHOICE, Code.LEFT_OUT_ERROR}
    return result.with_notes(*(note for note in other.notes if note.code in carried and note not in result.notes))


def largest_left_out(span: Any, rmse: Any) -> Any:
    """Largest error of samples left out of usable fits, of which the outputs' ranges and the rms errors are known [y]."""
    return np.maximum(POOR / 100 * span, _WORSE * rmse)
