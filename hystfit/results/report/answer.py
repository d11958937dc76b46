"""The answer at the top of a report: error beside noise, the numbers of the trade, lag, what is not determined, and what to do next."""

from __future__ import annotations

import numpy as np

from hystfit.data.record import Record
from hystfit.outcome import Status
from hystfit.outcome.table import number, rounded
from hystfit.quality.lag import estimate_lag
from hystfit.quality.loops import reversals
from hystfit.results.accuracy import Limits
from hystfit.results.quantities import CREEP, QUANTITIES, Trade
from hystfit.results.result import FitResult

_NAMED = 4  # parameters named one by one
_TURN = 0.02  # of the input's range: what counts as a turning point
_LAGS = 3.0  # standard errors from which a lag is reported


def answer(result: FitResult) -> list[tuple[str, str]]:
    """Names and values, the most important first."""
    rows = [("Error", _error(result)), *_numbers(result)]
    if (lag := _lag(result.data[0])) is not None:
        rows.append(lag)
    return [*rows, ("Not determined", _undetermined(result)), ("Next", "\n".join(next_commands(result)))]


def _error(result: FitResult) -> str:
    unit = result.data.units["y"]
    size = f"{number(result.train.rmse, '.3g')} {unit}".rstrip()
    text = f"{number(result.train.nrmse_percent, '.3g')} % of the range ({size} rms); limit {Limits.of(result.baselines).error:.2g} %"
    noise = result.baselines.noise
    if noise:
        text += f"; noise of the output {noise:.2g} {unit}".rstrip()
    if result.test is not None:
        text += f"; on the test data {number(result.test.nrmse_percent, '.3g')} %"
    return text


def _numbers(result: FitResult) -> list[tuple[str, str]]:
    trade, rows = Trade.of(result.data), []
    for q in result.quantities:
        one = QUANTITIES[q.name]
        if trade not in one.leads or (q.name == CREEP and q.value == 0):
            continue
        if q.value is None:
            rows.append((_capital(one.label), "unknown" if q.reason is None else q.reason.text))
            continue
        value, error = rounded(q.value, q.stderr)
        known = f" +- {error}" if q.stderr else ""
        rows.append((_capital(one.label), f"{value}{known} {q.unit}".rstrip()))
    return rows


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _lag(record: Record) -> tuple[str, str] | None:
    """The measured lag or lead, where it is significant."""
    if not record.used.all() or record.t is None:
        return None
    turns = reversals(record.u, _TURN * float(np.ptp(record.u)))
    found = estimate_lag(record.u, record.y, record.sampling_interval, turns)
    if found is None or abs(found.samples) < _LAGS * found.stderr:
        return None
    clock = "" if found.seconds is None else f" ({abs(found.seconds):.3g} {record.t_unit})"
    what = "Lag" if found.samples > 0 else "Lead"
    return f"{what} of the output at reversals", f"{abs(found.samples):.1f} +- {found.stderr:.1f} samples{clock}"


def _undetermined(result: FitResult) -> str:
    names = [p.name for p in result.parameters if p.identifiable is False and p.at_bound is None]
    bounded = sum(p.at_bound is not None for p in result.parameters)
    text = "nothing" if not names else ", ".join(names[:_NAMED])
    if len(names) > _NAMED:
        count = f"{len(names)} of {len(result.free_names)} parameters"
        text = f"{count}, such as {names[0]}; predictions within the fitted range do not need them"
    return text + (f"; {bounded} at a bound" if bounded else "")


def next_commands(result: FitResult) -> list[str]:
    """Commands that make sense now, with FIT for the folder of the fit and LOOP for the file."""
    if result.status is Status.NO_LOOP:
        return ["hystfit check LOOP"]
    if not result.usable:
        return ["hystfit compare LOOP", "hystfit check LOOP"]
    commands = ["hystfit predict FIT LOOP2"]
    if result.model.obstacle("inverse") is None:
        commands.append("hystfit invert FIT REFERENCE")
    if result.model.obstacle("export") is None:
        commands.append("hystfit export FIT --c C")
    return [*commands, "hystfit sample FIT" if len(result.x) <= 40 else "hystfit errors FIT"]
