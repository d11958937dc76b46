"""Status and notes of a fit: whether it is usable, what is not determined, which bounds were reached."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystfit.data.preparation import CoarseClock
from hystfit.data.record import Dataset
from hystfit.fitting.covariance import Uncertainty
from hystfit.fitting.estimate import Estimate
from hystfit.inference.autocorrelation import is_correlated
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Code, Note, Severity, Status
from hystfit.outcome.note import warn
from hystfit.quality.findings import WITHOUT_TIME
from hystfit.quality.reversal_curves import recognize_family
from hystfit.quality.summary import summarize
from hystfit.results.metrics import Metrics

_POOR = 10.0  # percent of range above which no fit is called usable
_ROUGH = 3.0  # percent of range above which the fit is checked for signs of a wrong model
_SHARE = 0.7  # of the error of a single-valued curve, above which the loop itself is not described
_ENOUGH = 30  # residuals of a record needed to call them white
_MANY = 12  # weights above this number are counted in a note, not listed


def turns_back(data: Dataset) -> bool:
    """Whether any record's input reverses by more than 1 % of its range while samples count."""
    for record in data:
        u = record.u[: int(np.flatnonzero(record.used)[-1]) + 1]
        span = float(np.ptp(u))
        risen = float(np.max(u - np.minimum.accumulate(u)))
        fallen = float(np.max(np.maximum.accumulate(u) - u))
        if min(risen, fallen) > 0.01 * span > 0:
            return True
    return False


def curve_error(data: Dataset) -> float:
    """RMSE of the best single-valued curve, without hysteresis: Legendre degree 7, and an offset for each record."""
    rows, right = [], []
    low = min(float(r.u.min()) for r in data)
    high = max(float(r.u.max()) for r in data)
    for k, record in enumerate(data):
        x = 2 * (record.u[record.used] - low) / (high - low) - 1
        offsets = np.zeros((x.size, len(data)))
        offsets[:, k] = 1.0
        rows.append(np.hstack([np.polynomial.legendre.legvander(x, 7)[:, 1:], offsets]))
        right.append(record.y[record.used])
    A, y = np.concatenate(rows), np.concatenate(right)
    return float(np.sqrt(np.mean((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2)))


def residuals_are_white(rows: Sequence[np.ndarray], plain: float, parameters: int) -> bool:
    """Whether residuals are white and the loop stands out of them: however large they are, no other model would leave less.

    Args:
        rows: residuals of each record.
        plain: RMSE of the best single-valued curve.
        parameters: number of the model's; the loop must be worth them by the Bayesian information criterion.
    """
    count = sum(row.size for row in rows)
    rmse = float(np.sqrt(np.mean(np.concatenate(rows) ** 2)))
    if min(row.size for row in rows) < _ENOUGH or any(is_correlated(row) for row in rows) or not 0 < rmse < plain:
        return False
    return bool(2 * count * np.log(plain / rmse) > parameters * np.log(count))


def status_of(
    data: Dataset, model: AbstractHysteresis, estimate: Estimate, train: Metrics, rows: Sequence[np.ndarray]
) -> tuple[Status, list[Note]]:
    """Status of a fit, and the notes that give the reason.

    Args:
        data: the records fitted.
        model: the fitted model.
        estimate: where the fit ended.
        train: its error.
        rows: residuals of each record, samples that count only [y].
    """
    if not (model.from_saturation or turns_back(data)):
        return Status.NO_LOOP, [_no_loop(data)]
    error = lambda code, text: Note(code, text, Severity.ERROR)
    percent = train.nrmse_percent if train.nrmse_percent is not None else np.inf
    plain = curve_error(data)
    white = percent > _ROUGH and residuals_are_white(rows, plain, estimate.x.size)
    if percent > _POOR and not white:
        text = f"the error is {percent:.3g} % of the range: the model does not describe this loop"
        return Status.POOR, [error(Code.POOR_FIT, text)]
    if percent > _ROUGH and train.rmse > _SHARE * plain and not white:
        text = (
            f"the error is {100 * train.rmse / plain:.0f} % of that of a single-valued curve without hysteresis: the loop itself is not "
            "described"
        )
        return Status.POOR, [error(Code.POOR_FIT, text)]
    if percent > _ROUGH and not white and any(summarize(record).degrading for record in data):
        text = (
            f"the loop loses stiffness from cycle to cycle (damage), and the error is {percent:.3g} % of the range: the model has no "
            "term for damage (see hystfit check)"
        )
        return Status.POOR, [error(Code.MODEL_MISMATCH, text)]
    if not estimate.converged:
        return Status.NOT_CONVERGED, [error(Code.SOLVER, estimate.message)]
    if white and (percent > _POOR or train.rmse > _SHARE * plain):
        text = (
            f"the error is {percent:.3g} % of the range, but the residuals are white (measurement noise): average more cycles or "
            "increase the amplitude"
        )
        return Status.OK, [Note(Code.MEASUREMENT_NOISE, text)]
    return Status.OK, []


def _no_loop(data: Dataset) -> Note:
    family = recognize_family(data)
    if family is None:
        text = "the input never turns back by more than 1 % of its range: there is no loop in these data"
    else:
        text = (
            f"{family.words()}; this model starts each of them at rest on its reversal point: use preisach-forc, which starts from "
            "saturation"
        )
    return Note(Code.NO_LOOP, text, Severity.ERROR)


def notes_of(problem: Problem, model: AbstractHysteresis, estimate: Estimate, errors: Uncertainty) -> list[Note]:
    """Notes that belong beside the numbers: bounds, undetermined parameters, and how the standard errors were obtained.

    Args:
        problem: what was fitted.
        model: the fitted model.
        estimate: where the fit ended.
        errors: its standard errors.
    """
    notes = list(estimate.notes)
    if all(record.t is None for record in problem.data):
        notes.append(Note(Code.NO_TIME, f"the data have no usable time: {WITHOUT_TIME}"))
    coarse = [record.name for record in problem.data if record.t is not None and CoarseClock.of(record.t)]
    if coarse:
        text = f"time stamps of {coarse[0]!r} repeat, and the model was driven with these steps: Record.sampled gives even ones"
        notes.append(warn(Code.COARSE_CLOCK, text))
    if (stated := problem.data[0].sigma) is not None:
        text = f"the residuals are {errors.sigma / stated:.2g} times the standard deviations given; only their ratios are used"
        notes.append(Note(Code.WEIGHTED, text))
    advice = dict.fromkeys(line for record in problem.data for line in model.advice(record.u, record.dt))
    notes += [warn(Code.MODEL_ADVICE, line) for line in advice]
    notes += _bounds_reached(problem, estimate.x)
    notes += _undetermined(problem, errors)
    if estimate.penalty is not None and np.any(estimate.penalty > 0):
        text = "standard errors treat the smoothing penalty as prior information; the data alone would give larger ones"
        notes.append(Note(Code.REGULARIZED, text))
    if errors.correlation_time > 1.0 or errors.ratio != 1.0:
        change = f"{errors.ratio:.2g} times those for independent residuals"
        if 0.95 < errors.ratio < 1.05:
            change = f"unchanged by that (factor {errors.ratio:.2g})"
        text = (
            f"residuals are autocorrelated over {errors.correlation_time:.3g} samples; standard errors are {change}"
            f"{_slow_part(errors)}"
        )
        notes.append(Note(Code.ERROR_RATIO, text))
    return notes


def _bounds_reached(problem: Problem, x: np.ndarray) -> list[Note]:
    linear = [info.linear for info in problem.space.infos]
    reached = list(zip(problem.space.names, problem.at_bound(x), linear, strict=True))
    notes = [
        warn(
            Code.AT_BOUND,
            f"{name} is at its {side} bound: it has no standard error, and those of the others assume it stays there",
        )
        for name, side, is_linear in reached
        if side and not is_linear
    ]
    zero = sum(1 for _, side, is_linear in reached if side and is_linear)
    if zero:
        verb = "is" if zero == 1 else "are"
        notes.append(Note(Code.ZERO_WEIGHTS, f"{zero} of {sum(linear)} weights {verb} zero (at the bound)"))
    return notes


def _undetermined(problem: Problem, errors: Uncertainty) -> list[Note]:
    notes, names = [], problem.space.names
    inactive = [name for name, none in zip(names, errors.inactive, strict=True) if none]
    if inactive:
        shown = ", ".join(inactive[:_MANY]) + (f" and {len(inactive) - _MANY} more" if len(inactive) > _MANY else "")
        notes.append(warn(Code.NO_INFLUENCE, f"no influence on these data: {shown}"))
    if len(errors.directions) > 3 and sum(info.linear for info in problem.space.infos) > _MANY:
        text = (
            f"the data do not determine {len(errors.directions)} combinations of the weights (rank {errors.rank} of {len(names)}); "
            "predictions within the fitted range do not need them"
        )
        notes.append(Note(Code.NOT_DETERMINED, text))
    else:
        for parameters in errors.directions:
            single = "," not in parameters
            text = f"the data do not determine {parameters}" if single else f"the data cannot separate {parameters}"
            notes.append(warn(Code.NOT_DETERMINED, text))
    notes += [
        warn(Code.NOT_DETERMINED, f"the data hardly determine {name}: its 95 % interval reaches its bound")
        for name in errors.reaching
    ]
    return notes


def _slow_part(errors: Uncertainty) -> str:
    """The slow noise behind errors that a short correlation time alone would not explain."""
    noise = errors.residuals.noise
    if not errors.residuals.correlated or noise is None:
        return ""
    time = noise.noise.parameters["noise_time"]
    return (
        f" (they include slow noise with a correlation time of {time:.3g} samples)"
        if time > 2 * errors.correlation_time
        else ""
    )
