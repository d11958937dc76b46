"""Notes on the numbers of a fit: what is not determined, which bounds were reached, what the errors include."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.preparation import CoarseClock
from hystfit.data.record import Record
from hystfit.fitting.judgment.covariance import Uncertainty
from hystfit.fitting.solvers.estimate import Estimate
from hystfit.inference.problem import Problem, Side
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.outcome.wrapping import NAMED, listed
from hystfit.params.space import MANY, ParameterSpace
from hystfit.quality.findings import WITHOUT_TIME
from hystfit.quality.loops import APART


def notes_of(problem: Problem, model: AbstractHysteresis, estimate: Estimate, errors: Uncertainty) -> list[Note]:
    """Notes on the estimates: parameters at bounds, undetermined parameters, and how the standard errors were computed."""
    notes = [*estimate.notes, *notes_on_time(problem.data)]
    if (stated := problem.data[0].sigma) is not None:
        text = f"the residuals are {errors.sigma / stated:.2g} times the given standard deviations, of which only the ratios are used"
        notes.append(Note(Code.WEIGHTED, text))
    notes += notes_of_model(problem.data, model)
    unknown = Unknown(errors.inactive, errors.directions, errors.reaching, errors.rank)
    notes += notes_of_errors(problem.space, problem.at_bound(estimate.x), unknown, estimate.penalty)
    if errors.residuals.correlated or errors.ratio != 1.0:
        change = f"{errors.ratio:.2g} times those for independent residuals"
        if abs(errors.ratio - 1) < APART:
            change = f"unchanged (factor {errors.ratio:.2g})"
        text = f"residuals {errors.residuals.memory}; standard errors are {change}{_slow_part(errors)}"
        notes.append(Note(Code.ERROR_RATIO, text))
    return notes


def notes_on_time(data: Dataset) -> list[Note]:
    """Notes on records without time, or with time stamps that repeat."""
    notes = []
    if all(record.t is None for record in data):
        notes.append(Note(Code.NO_TIME, f"the data have no usable time: {WITHOUT_TIME}"))
    coarse = [record.name for record in data if record.t is not None and CoarseClock.of(record.t)]
    if coarse:
        text = f"time stamps of {coarse[0]!r} repeat, and the model was driven with these time steps: Record.sampled makes them even"
        notes.append(warn(Code.COARSE_CLOCK, text))
    return notes


def notes_of_model(data: Dataset, model: AbstractHysteresis) -> list[Note]:
    """What a fitted model says about the records."""
    advise = type(model).advice  # a bound method of an equinox module takes ten times as long to call
    said = {record.name: advise(model, *_counted(record)) for record in data}
    speaking = [name for name, lines in said.items() if lines]
    if len(speaking) <= NAMED:
        return [
            warn(Code.MODEL_ADVICE, line) for line in dict.fromkeys(line for lines in said.values() for line in lines)
        ]
    others = f"{speaking[0]!r}, and likewise {len(speaking) - 1} other records"
    return [warn(Code.MODEL_ADVICE, f"{others}: {line}") for line in said[speaking[0]]]


def _counted(record: Record) -> tuple[np.ndarray, np.ndarray | None]:
    """Input and time steps of a record from its first sample that counts: not from a calibration point before a reversal curve."""
    first = record.first
    return record.u[first:], None if record.dt is None else record.dt[first:]


class Unknown(NamedTuple):
    """What the data do not determine, see `Uncertainty`."""

    inactive: np.ndarray
    directions: Sequence[str]
    reaching: Sequence[str]
    rank: int


def notes_of_errors(
    space: ParameterSpace, sides: Sequence[Side | None], unknown: Unknown, penalty: np.ndarray | None
) -> list[Note]:
    """Notes on bounds that were reached (`sides`), on what is not determined, and on a regularization (`penalty`: see `Estimate`)."""
    notes = [*_bounds_reached(space, sides), *_undetermined(space, unknown)]
    if penalty is not None and np.any(penalty > 0):
        text = "standard errors treat the smoothing penalty as prior information; the data alone would give larger ones"
        notes.append(Note(Code.REGULARIZED, text))
    return notes


def _bounds_reached(space: ParameterSpace, sides: Sequence[Side | None]) -> list[Note]:
    linear = space.linear
    reached = list(zip(space.names, sides, linear, strict=True))
    notes = [
        warn(
            Code.AT_BOUND,
            f"{name} is at its {side} bound: it has no standard error, and those of the others treat the bound as prior information",
        )
        for name, side, is_linear in reached
        if side and not is_linear
    ]
    zero = sum(1 for _, side, is_linear in reached if side and is_linear)
    if zero:
        verb = "is" if zero == 1 else "are"
        notes.append(Note(Code.ZERO_WEIGHTS, f"{zero} of {sum(linear)} weights {verb} zero (at the bound)"))
    return notes


def _undetermined(space: ParameterSpace, errors: Unknown) -> list[Note]:
    notes, names = [], space.names
    inactive = [name for name, none in zip(names, errors.inactive, strict=True) if none]
    if inactive:
        notes.append(warn(Code.NO_INFLUENCE, f"no influence on these data: {listed(inactive)}"))
    if len(errors.directions) > 3 and space.linear.sum() > MANY:
        text = (
            f"the data do not determine {len(errors.directions)} combinations of the weights (rank {errors.rank} of {len(names)}); "
            "predictions within the fitted range do not need them"
        )
        notes.append(Note(Code.NOT_DETERMINED, text))
    else:
        for parameters in errors.directions:
            single = ", " not in parameters
            text = f"the data do not determine {parameters}" if single else f"the data cannot separate {parameters}"
            notes.append(warn(Code.NOT_DETERMINED, text))
    notes += [
        warn(Code.NOT_DETERMINED, f"the data hardly determine {name}: its 95 % interval reaches its bound")
        for name in errors.reaching
    ]
    return notes


def _slow_part(errors: Uncertainty) -> str:
    """Note on slow noise, where the standard errors include it."""
    noise = errors.residuals.noise
    if not errors.residuals.correlated or noise is None:
        return ""
    time = noise.noise.parameters["noise_time"]
    if time <= 2 * errors.correlation_time:
        return ""
    return f" (they include slow noise with a correlation time of {time:.3g} samples)"
