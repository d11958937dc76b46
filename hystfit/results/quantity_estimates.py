"""Quantities that follow from a fit, with standard errors by the delta method: the gradient of each, and the covariance of the fit."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hystfit.data.circulation import SLACK
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.data.steady_cycle import from_turning_point
from hystfit.errors import HystfitError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.negate import Negate
from hystfit.models.preisach.model import Preisach
from hystfit.outcome.table import or_none
from hystfit.params.relative_size import OPEN, ROUNDED, relative_size
from hystfit.results.estimates import ParameterEstimate
from hystfit.results.measured.loop_branches import of_jump, turns_of
from hystfit.results.measured.quantities import QUANTITIES, QuantityEstimate, Unknown, applicable
from hystfit.results.measured.steady_branches import OF_HEIGHT, at_pace
from hystfit.results.measured.steady_loops import Excitation, creeps
from hystfit.results.result import FitResult

_STEP = 1e-4  # of a central difference, relative to the size of a parameter
_JUMP = 5e-3  # the same of an input at which the output jumps, of the range: five samples of the loop, half of one of which it may be off
_NEGLIGIBLE = 1e-3  # change of a quantity with a parameter by its own size, relative to the quantity's size
_MANY = 40  # free parameters, above which the columns of linear weights come from the design matrix
# Why a loop whose branches do not cross has no value.
_WITHOUT = {"coercive_input": Unknown.NO_CROSSING, "equivalent_damping_percent": Unknown.OVERDAMPED}
_CLOSED = 0.05  # of the output's range, between the two ends of a measured loop

# Samples of a half cycle up to which the loop between them is looked at (a polygon of 80 sides has 0.1 % less area than its ellipse), half
# cycles that are, and parts into which each step of the input is divided.
_COARSE, _SEEN, _INSERTED = 40, 10, 16


def quantity_values(result: FitResult) -> dict[str, float | None]:
    """The quantities of a fit without errors, by name; None where one is unknown."""
    excitation = Excitation.of(result.data, result.model)
    values = _values(result, excitation, lambda record: _run(result, record, result.model)[None])
    return {name: or_none(one[0]) for name, one in values.items()}


def quantity_estimates(result: FitResult) -> tuple[QuantityEstimate, ...]:
    """The quantities that the records and the model of a fit have, of the first record, with standard errors."""
    x, space = np.asarray(result.x), result.problem.space
    size, linear = relative_size(space, x), space.linear
    excitation = Excitation.of(result.data, result.model)
    stepwise = np.array([info.stepwise for info in space.infos])
    step = np.where(stepwise, _JUMP * (excitation.high - excitation.low), _STEP * size)
    outputs = lambda record: _perturbed(result, record, step, linear)
    values = _values(result, excitation, outputs)
    scales, rows = result.problem.scales, []
    measured = _measured(result)
    between, joint = (_between_samples(result), _between_levels(result, excitation)), result.joint
    known = None if joint is None else np.where(np.isfinite(joint), joint, 0.0)
    for name, y in values.items():
        sizes = {"%": 100.0, "{u}": scales.u, "{y}": scales.y, "{energy}": scales.y * scales.u * excitation.energy}
        natural = sizes.get(QUANTITIES[name].unit, abs(y[0]))
        with np.errstate(invalid="ignore"):  # infinite where a model near this one has no value
            change = y[1 : 1 + x.size] - y[1 + x.size :]  # none of a quantity that the model has not
            change = change / (2 * step / size)[: change.size]  # with each parameter by its own size
        one = _estimate(result, name, float(y[0]), change, size, natural, known)
        if one.reason is Unknown.NOT_FINITE and np.isfinite(values["stroke"][0]):
            why = _WITHOUT.get(name, Unknown.NOT_FINITE) if np.isfinite(values["loop_area"][0]) else Unknown.LOBES
            one = dataclasses.replace(one, reason=why)
        if one.stderr is not None and (more := [of[name] for of in between if name in of]):
            one = dataclasses.replace(one, stderr=float(np.linalg.norm([one.stderr, *more])))
        value, error = measured.get(name, (None, None))
        rows.append(dataclasses.replace(one, measured=value, measured_stderr=error))
    return tuple(rows)


def _measured(result: FitResult) -> dict[str, tuple[float, float | None]]:
    """Measured quantities and their standard errors, by name, of those that are read off loops; none of loops that noise alone opens.

    An error is that of the loop with the nearest value, among loops of all sizes. Without one, noise would make a model err.
    """
    read = [one for values in result.measured.rows.values() for one in values]
    values, found = measured_quantities(result.data) if read else {}, dict[str, tuple[float, float | None]]()
    for name, value in values.items():
        if alike := [one for one in read if one.name == name]:
            nearest = min(alike, key=lambda one: abs(one.value - value))
            relative = nearest.stderr / abs(nearest.value) if nearest.stderr is not None and nearest.value else None
            found[name] = value, None if relative is None else relative * abs(value)
    if "stroke" in found and "hysteresis_percent" in values:
        stroke, error = found["stroke"]  # a height is the difference of two noisy outputs
        of_height = None if error is None else 100 * float(np.sqrt(2)) * error / stroke
        found["hysteresis_percent"] = values["hysteresis_percent"], of_height
    return found


def _between_samples(result: FitResult) -> dict[str, float]:
    """What coarse samples leave open of each quantity: its change where the loop of the model is seen at the samples of the record alone.

    Both are read as measured loops are, over the first cycles of the first record; empty where these have many samples.
    """
    record = result.data[0]
    turns = turns_of(record.u)[:_SEEN]
    if turns.size < 2 or np.median(np.diff(turns)) > _COARSE:
        return {}
    places = np.arange(int(turns[-1]) * _INSERTED + 1) / _INSERTED
    along = lambda values: np.interp(places, np.arange(len(record)), values)
    u, t = along(record.u), None if record.t is None else along(record.t)
    units = {"u_unit": record.u_unit, "y_unit": record.y_unit, "t_unit": record.t_unit}
    of = lambda y, step: Record(u[::step], y[::step], None if t is None else t[::step], **units)
    y = _simulated_outputs(lambda one: _run(result, one, result.model)[None], of(np.zeros(places.size), 1))[0]
    if not np.isfinite(y).all():
        return {}
    all_of, coarse = (measured_quantities(Dataset((of(y, step),))) for step in (1, _INSERTED))
    return {name: abs(value - coarse[name]) for name, value in all_of.items() if name in coarse}


def _between_levels(result: FitResult, excitation: Excitation) -> dict[str, float]:
    """Standard error of the coercive input by what a Preisach model leaves open: where within a cell its relays switch."""
    levels = _levels(result.model)
    if levels is None:
        return {}
    outputs = _simulated_outputs(lambda record: _run(result, record, result.model)[None], excitation.loop)
    loops = excitation.loops(outputs)
    at = np.concatenate(
        [[excitation.low], levels[(levels > excitation.low) & (levels < excitation.high)], [excitation.high]]
    )
    branches = [np.interp(at, loops.inputs, branch[0]) for branch in (loops.rising, loops.falling)]
    errors = []
    for level in (branch - loops.level[0] for branch in branches):
        passed = np.flatnonzero((level[:-1] < 0) != (level[1:] < 0))
        errors.append(of_jump(level, at, int(passed[passed.size // 2])) if passed.size else 0.0)
    return {"coercive_input": 0.5 * float(np.hypot(*errors))}


def _levels(model: AbstractHysteresis) -> np.ndarray | None:
    """Levels of the input between which the relays of a model switch, rising; None without relays."""
    parts = getattr(model, "parts", (model,))
    of = next((np.asarray(part.levels) for part in parts if isinstance(part, Preisach)), None)
    return -of[::-1] if of is not None and any(isinstance(part, Negate) for part in parts) else of


def _estimate(
    result: FitResult,
    name: str,
    value: float,
    change: np.ndarray,
    size: np.ndarray,
    natural: float,
    known: np.ndarray | None,
) -> QuantityEstimate:
    """A quantity from its value and its change by each parameter [its size]; `known` is the finite covariance, None without one."""
    one = QUANTITIES[name]
    made = lambda value, error, reason: QuantityEstimate(name, value, error, one.units(result.data), reason)
    if not np.isfinite(value):
        return made(None, None, Unknown.NOT_FINITE)
    if known is None or result.joint is None:
        return made(value, None, Unknown.NO_ERRORS)
    without = ~np.isfinite(np.diag(result.joint))
    if not np.isfinite(change).all() or (np.abs(change[without]) > _NEGLIGIBLE * natural).any():
        return made(None, None, Unknown.NOT_DETERMINED)
    slope = np.where(without, 0.0, change / size)
    error = float(np.sqrt(max(slope @ known @ slope, 0.0)))
    if error > OPEN * natural:
        return made(None, None, Unknown.NOT_DETERMINED)
    # A loop of full height is 100 % at all parameters.
    return made(value, error if error > ROUNDED * natural else None, None)


def _values(
    result: FitResult, excitation: Excitation, outputs: Callable[[Record], np.ndarray]
) -> dict[str, np.ndarray]:
    """Quantities by name, from what gives the outputs over a record, shape (count, T)."""
    names = applicable(result.data, timed=result.model.creeps)
    of_loop = _simulated_outputs(outputs, excitation.loop)
    return values_of_outputs(names, excitation, of_loop, lambda: _simulated_outputs(outputs, excitation.step))


def values_of_outputs(
    names: Iterable[str], excitation: Excitation, of_loop: np.ndarray, of_step: Callable[[], np.ndarray]
) -> dict[str, np.ndarray]:
    """Quantities by name, each shape (count,), NaN where a simulation fails; without the creep of a model that has none.

    `of_loop` are outputs over the loops of the excitation, shape (count, T), and `of_step` gives those over its steps.
    """
    found = {}
    with np.errstate(all="ignore"):
        loops = excitation.loops(of_loop)
        for name in names:
            of_loops = QUANTITIES[name].of_loops
            if of_loops is not None:
                found[name] = of_loops(loops)
            elif creeps(creep := Excitation.creep(of_step())):
                found[name] = creep
    return found


def _simulated_outputs(outputs: Any, record: Record) -> np.ndarray:
    """Outputs over a record; NaN where the model cannot be driven by it."""
    try:
        return outputs(record)
    except HystfitError:
        return np.full((1, len(record)), np.nan)


def _simulated(result: FitResult, record: Record, x: np.ndarray) -> np.ndarray:
    """Outputs of the first record's model over a record for parameter vectors (count, p), shape (count, T)."""
    return np.stack([_run(result, record, result.problem.space.assembled(row)) for row in x])


def _run(result: FitResult, record: Record, model: AbstractHysteresis) -> np.ndarray:
    """Output of a model of the fit's type over a record, shape (T,)."""
    return type(model).free_run(model, record.u, None if result.model.rate_independent else record.dt)


def _perturbed(result: FitResult, record: Record, step: np.ndarray, linear: np.ndarray) -> np.ndarray:
    """Outputs at the estimate, with each parameter larger by its step, and with each smaller, shape (1 + 2 p, T).

    A linear parameter takes one simulation, or none where the design matrix has its column.
    """
    x = np.asarray(result.x)
    middle = _simulated(result, record, x[None])
    every = np.repeat(middle, 1 + 2 * x.size, axis=0)
    larger, smaller = every[1 : 1 + x.size], every[1 + x.size :]
    columns = _columns(result, record) if x.size > _MANY else {}
    for k in range(x.size):
        if k in columns:
            change = step[k] * columns[k]
        elif linear[k]:
            change = _simulated(result, record, (x + step[k] * (np.arange(x.size) == k))[None])[0] - middle[0]
        else:
            moved = x + np.outer([step[k], -step[k]], np.arange(x.size) == k)
            larger[k], smaller[k] = _simulated(result, record, moved)
            continue
        larger[k] += change
        smaller[k] -= change
    return every


def _columns(result: FitResult, record: Record) -> dict[int, np.ndarray]:
    """Columns of the design matrix over a record, shape (T,), by the number of the free parameter that they belong to."""
    space = result.problem.space
    design = result.model.design_matrix(record.u, None if result.model.rate_independent else record.dt)
    blocks = {block.leaf: np.asarray(block.columns) for block in design.blocks}
    of_first = lambda source: source[2] in (None, 0) and space.leaves[source[0]].index in blocks
    return {
        k: blocks[space.leaves[source[0]].index][design.index, source[1]]
        for k, source in enumerate(space.sources)
        if of_first(source)
    }


def derived_estimates(result: FitResult) -> tuple[ParameterEstimate, ...]:
    """The derived quantities of the fitted model, of the first record; no standard error where a parameter has none."""
    coordinates, units = result.problem.space.coordinates, result.problem.scales.label
    rows = []
    for name, unit, doc, value in result.model.derived():
        of_parameters = lambda x, value=value: value(coordinates.assemble(x, 0))
        number, slope = (np.asarray(v) for v in jax.value_and_grad(of_parameters)(jnp.asarray(result.x)))
        behind = slope != 0
        variance = float(slope[behind] @ result.covariance[np.ix_(behind, behind)] @ slope[behind])
        known = bool(behind.any() and np.isfinite(variance))
        error = float(np.sqrt(max(variance, 0.0))) if known else None
        rows.append(ParameterEstimate(name, float(number), error, units(unit), None, None, False, None, known, doc))
    return tuple(rows)


# -- without the model ---------------------------------------------------------------------------------------------------------


def measured_quantities(data: Dataset) -> dict[str, float]:
    """Quantities of the loops as measured, by name, without a model: medians over the closed loops that cover the range of all records.

    Samples are joined by straight lines. Loops at another pace than that of the steady loop of a fit have other widths and do not count.
    Empty where no two successive branches cover the range and meet at both ends: a first rise from rest and the branch after it are no
    loop.
    """
    excitation = Excitation.of(data)
    inputs = np.linspace(excitation.low, excitation.high, 2001)
    branches: dict[bool, list[np.ndarray]] = {True: [], False: []}
    cycle = excitation.interval * excitation.points
    for record in data.map(from_turning_point):
        turns = np.unique([0, *turns_of(record.u), len(record) - 1]).tolist()
        found = [
            (bool(record.u[b] > record.u[a]), _measured_branch(record, a, b, inputs))
            for a, b in itertools.pairwise(turns)
        ]
        lasts = [0.0] * len(found) if record.t is None else (record.t[turns[2:]] - record.t[turns[:-2]]).tolist()
        loops = [one for one in zip(itertools.pairwise(found), lasts, strict=False) if _closed(*one[0])]
        for pair, duration in loops:
            if duration > 0 and not at_pace(np.array([duration]), cycle):
                continue
            for rises, branch in pair:
                branches[rises].append(branch)
    if not branches[True]:
        return {}
    found = map(np.array, branches.values())
    loops = excitation.of_branches(inputs, *found)
    values = {name: float(np.median(q.of_loops(loops))) for name, q in QUANTITIES.items() if q.of_loops is not None}
    return {name: value for name, value in values.items() if np.isfinite(value)}


def _closed(one: tuple[bool, np.ndarray | None], other: tuple[bool, np.ndarray | None]) -> bool:
    """Whether two successive branches cover the range, and the second ends where the first began."""
    (rises, first), (_, second) = one, other
    if first is None or second is None:
        return False
    end = 0 if rises else -1
    most = min(_CLOSED * float(np.ptp(first)), OF_HEIGHT * float(np.max(np.abs(first - second))))
    return bool(abs(first[end] - second[end]) <= most)


def _measured_branch(record: Record, first: int, last: int, inputs: np.ndarray) -> np.ndarray | None:
    """The measured output at inputs between two turning points; None where the branch does not cover them."""
    kept = first + np.flatnonzero(record.used[first : last + 1])
    onward = np.sign(record.u[last] - record.u[first]) * record.u[kept]
    slack = SLACK * float(inputs[-1] - inputs[0])
    kept = kept[onward >= np.maximum.accumulate(onward) - slack]  # without small loops inside the branch
    kept = kept[np.argsort(record.u[kept], kind="stable")]
    u = record.u[kept]
    if not kept.size or u[0] > inputs[0] + slack or u[-1] < inputs[-1] - slack:
        return None
    return np.interp(inputs, u, record.y[kept])
