"""The fits of loops of one structure that are beyond doubt, as columns of numbers, and the estimates of others that are solved."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

import numpy as np

from hystfit.batch.alike import Common, Group, Loops, common_of, solve_alike
from hystfit.batch.bucketed import Task
from hystfit.batch.many_fits import ERRORS
from hystfit.batch.plain_judge import Judged, RowNotes, judge_plain, row_notes
from hystfit.batch.row import Row, row_of
from hystfit.batch.row_accuracy import soundness
from hystfit.batch.simulated_rows import shared_and_own, simulated
from hystfit.batch.weight_rows import judge_weights, solve_weights
from hystfit.data.batch import bucket
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.fitting.fit_model import judge
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import FitSetup, without_faults
from hystfit.fitting.solvers.estimate import Estimate
from hystfit.fitting.solvers.lanes import Stack
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Note, Status
from hystfit.outcome.table import or_none
from hystfit.results.measured.quantities import applicable
from hystfit.results.measured.steady_loops import Excitation
from hystfit.results.provenance import Stopwatch
from hystfit.results.quantity_estimates import values_of_outputs

FEWEST = 8  # loops from which the programs of many pay
_SAME = 1e-3  # relative difference of two standard errors that is none


class PlainFits(NamedTuple):
    """Results of N loops, group by group, of which some are plain."""

    names: tuple[str, ...]  # of the free parameters
    judged: Judged  # numbers of each loop
    quantities: dict[str, np.ndarray]  # of the fitted loops by name, shape (N,), NaN where unknown
    notes: RowNotes  # on plain loops
    # the row of a plain loop that was judged alone, which has the units of all; None where no loop is plain
    example: Row | None
    common: Common  # what the loops have in common
    starts: np.ndarray  # of each loop, unconstrained, shape (N, S, p); none for weights
    estimate: Callable[[int], Estimate]  # the estimate of a loop, from its number

    def posed(self, k: int, record: Record, options: FitOptions) -> tuple[FitSetup, Task | None, Estimate | None]:
        """The fit of a close loop that is not plain, and its estimate, or what it takes to solve it beside others from every start."""
        setup = setup_of(self.common, record, options)
        if self.common.of_weights:
            return setup, None, self.estimate(k)
        return setup, Task.of(setup.problem, self.starts[k]), None

    def columns(self) -> dict[str, np.ndarray]:
        """The numbers of all loops, shape (N,), by the names of `Row.numbers`."""
        one, columns = self.judged, dict[str, np.ndarray]()
        for k, name in enumerate(self.names):
            columns |= {f"value {name}": one.x[:, k], f"stderr {name}": one.stderr[:, k]}
        columns |= dict(zip(ERRORS, (one.rmse, one.percent, one.largest_percent), strict=True))
        return columns | {f"quantity {name}": values for name, values in self.quantities.items()}

    def row(self, k: int, name: str, file: str, record: Record) -> Row:
        """The row of a plain loop and its record."""
        one, example = self.judged, cast(Row, self.example)
        return Row(
            name=name,
            file=file,
            sha256=record.sha256 or record.digest(),
            status=Status.OK,
            reason=self.notes.reason(k),
            codes=self.notes.codes(k),
            model=example.model,
            samples=int(np.count_nonzero(record.used)),
            values=dict(zip(self.names, one.x[k].tolist(), strict=True)),
            stderr=dict(zip(self.names, map(or_none, one.stderr[k].tolist()), strict=True)),
            rmse=float(one.rmse[k]),
            error_percent=float(one.percent[k]),
            max_error_percent=float(one.largest_percent[k]),
            quantities={key: or_none(float(v[k])) for key, v in self.quantities.items()},
            units=example.units,
        )


def setup_of(common: Common, record: Record, options: FitOptions) -> FitSetup:
    """The fit of another loop, without starting values of its own."""
    own = common.setup.problem
    settings = {"fix": options.fix, "free": options.free, "loss": options.loss, "spacing": options.spacing}
    problem = Problem(own.model, without_faults(Dataset.of(record)), **settings)
    return dataclasses.replace(common.setup, problem=problem, points=(own.model,))


def fit_plain(
    model: AbstractHysteresis, groups: Sequence[Group], options: FitOptions, *, held: bool
) -> PlainFits | None:
    """Fit loops in groups of one input each; None where they cannot be solved together.

    The records of a group have the same labels, lengths of one bucket, and NaN where an output is missing; no fit has a robust loss or a
    noise model of its own. With `held`, parameters in `fix` without a value keep that of the model.
    """
    every = Loops(tuple(groups))
    faultless = soundness(every)
    sound = np.flatnonzero(faultless.sound)
    if sound.size < FEWEST:
        return None
    loops = every.take(sound)
    common = common_of(model, loops, options, held=held)
    if common is None:
        return None
    solved = _solved_weights if common.of_weights else _solved_lanes
    judged, on_errors, estimate, outputs = solved(common, loops, faultless.noise[sound])
    notes = row_notes(common, loops, judged, on_errors)
    examples = _examples(common, loops, judged, estimate, notes, options)
    if examples is None:
        judged = judged._replace(plain=np.zeros(len(loops), bool))
    example = examples[0] if examples else None
    quantities = _quantities(common, loops, outputs)
    names, starts = common.setup.problem.space.names, common.starts_of(loops)
    fits = PlainFits(names, judged, quantities, notes, example, common, starts, estimate)
    return _spread(fits, sound, len(every))


class _Solved(NamedTuple):
    """Solved loops: their numbers, notes on the errors of plain ones, estimates by number, and outputs over the input of their groups.

    `outputs` takes one record a group, and gives shape (N, T), padded with outputs that mean nothing.
    """

    judged: Judged
    on_errors: Sequence[Sequence[Note]]
    estimate: Callable[[int], Estimate]
    outputs: Callable[[Sequence[Record]], np.ndarray]


def _solved_lanes(common: Common, loops: Loops, noise: np.ndarray) -> _Solved:
    """By Levenberg-Marquardt."""
    ends, stack = solve_alike(common, loops)
    judged, cost, model = judge_plain(common, loops, ends, stack, noise), ends.normal.cost, common.setup.problem.model
    estimate = lambda k: Estimate(judged.x[k], float(cost[k]), True, "converged", 1, np.array([cost[k]]))
    counts, timed = [len(group.y) for group in loops.groups], not model.rate_independent
    outputs = lambda records: _outputs(stack, ends.normal.z, records, counts, timed=timed, causal=model.causal)
    return _Solved(judged, [()] * len(loops), estimate, outputs)


def _solved_weights(common: Common, loops: Loops, noise: np.ndarray) -> _Solved:
    """By convex optimization."""
    weights = solve_weights(common, loops)
    judged, on_errors = judge_weights(weights, loops, noise)
    return _Solved(judged, on_errors, weights.estimate, lambda records: weights.outputs(records[0]))


def _examples(
    common: Common,
    loops: Loops,
    judged: Judged,
    estimate: Callable[[int], Estimate],
    notes: RowNotes,
    options: FitOptions,
) -> list[Row] | None:
    """Plain loops judged alone, one of each set of notes; None where such a judgment is another one."""
    rows = list[Row]()
    for k in notes.examples():
        group, watch = loops.take(np.array([k])).groups[0], Stopwatch()
        record = group.record.replace(y=group.y[0])
        row = row_of("", "", record, judge(setup_of(common, record, options), estimate(k), options, watch))
        errors = np.array([np.nan if value is None else value for value in row.stderr.values()], float)
        same = (row.status, row.codes, row.reason) == (Status.OK, notes.codes(k), notes.reason(k))
        if not same or not np.allclose(errors, judged.stderr[k], rtol=_SAME, equal_nan=True):
            return None
        rows.append(row)
    return rows


def _quantities(
    common: Common, loops: Loops, outputs_of: Callable[[Sequence[Record]], np.ndarray]
) -> dict[str, np.ndarray]:
    """Quantities of the steady loop of each fitted model."""
    model, timed = common.setup.problem.model, common.setup.problem.model.creeps
    datasets = [Dataset.of(group.record) for group in loops.groups]
    excitations = [Excitation.of(data, model) for data in datasets]
    of_loop = outputs_of([one.loop for one in excitations])
    of_step = outputs_of([one.step for one in excitations]) if timed else np.zeros((len(loops), 0))
    group_of = np.repeat(np.arange(len(datasets)), [len(group.y) for group in loops.groups])
    kinds = dict[tuple[tuple[str, ...], Excitation], list[int]]()  # groups by their names and all but the range
    for k, (data, one) in enumerate(zip(datasets, excitations, strict=True)):
        names = applicable(data, timed=timed)
        kinds.setdefault((names, dataclasses.replace(one, low=0.0, high=0.0, interval=0.0)), []).append(k)
    found = dict[str, np.ndarray]()
    for (names, _), numbers in kinds.items():
        rows, first = np.flatnonzero(np.isin(group_of, numbers)), excitations[numbers[0]]
        low, high = np.array([(excitations[k].low, excitations[k].high) for k in group_of[rows]]).T[:, :, None]
        one = first if len(numbers) == 1 else dataclasses.replace(first, low=low, high=high)
        outputs = of_loop[rows, : len(first.loop)]
        for name, values in values_of_outputs(names, one, outputs, lambda rows=rows: of_step[rows]).items():
            found.setdefault(name, np.full(len(loops), np.nan))[rows] = values
    return found


def _outputs(
    stack: Stack, z: np.ndarray, records: Sequence[Record], counts: Sequence[int], *, timed: bool, causal: bool
) -> np.ndarray:
    """Outputs of each loop's model over the input of its group, shape (N, T), padded with outputs that mean nothing."""
    coordinates, scales = shared_and_own(stack.objective.coordinates)
    if len(records) == 1:
        return simulated(coordinates, scales, z, records[0].u, records[0].dt if timed else 0 * records[0].u)
    lengths = np.repeat([bucket(len(record)) if causal else len(record) for record in records], counts)
    of_group, out = np.repeat(np.arange(len(records)), counts), np.full((len(z), lengths.max()), np.nan)
    for length in np.unique(lengths).tolist():
        at = np.flatnonzero(lengths == length)
        u, dt = np.empty((at.size, length)), np.zeros((at.size, length) if timed else length)
        for row, group in enumerate(of_group[at]):
            record = records[group]
            u[row, : len(record)], u[row, len(record) :] = record.u, record.u[-1]
            if timed:
                dt[row, : len(record)] = record.dt
        out[at, :length] = simulated(coordinates, scales[at], z[at], u, dt)
    return out


def _spread(fits: PlainFits, at: np.ndarray, count: int) -> PlainFits:
    """Results of some loops among all; the others are not plain."""

    def among(values: np.ndarray) -> np.ndarray:
        out = np.zeros((count, *values.shape[1:]), values.dtype)
        out[at] = values
        return out

    return fits._replace(
        judged=Judged(*map(among, fits.judged)),
        quantities={name: among(values) for name, values in fits.quantities.items()},
        notes=fits.notes.among(at, count),
        starts=among(fits.starts),
        estimate=lambda k: fits.estimate(int(np.searchsorted(at, k))),
    )
