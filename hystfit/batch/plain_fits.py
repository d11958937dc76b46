"""The fits of loops over one input that are beyond doubt, as columns of numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hystfit.batch.alike import Common, common_of, solve_alike
from hystfit.batch.plain_judge import Judged, judge_plain, simulated, sound_outputs
from hystfit.batch.row import Row, row_of
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.fitting.estimate import Estimate
from hystfit.fitting.fit_model import judge
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import FitSetup, set_up_fit
from hystfit.fitting.lanes import Stack
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Status
from hystfit.results.quantity_estimates import values_of_outputs
from hystfit.results.steady_loops import Excitation
from hystfit.results.timing import Stopwatch

FEWEST = 8  # loops from which the programs of many pay
_SAME = 1e-3  # relative difference of two standard errors that is none


class PlainFits(NamedTuple):
    """Results of N loops over one input, of which some are plain.

    Attributes:
        names: of the free parameters.
        judged: numbers of each loop.
        quantities: of the fitted loops by name, shape (N,), NaN where unknown.
        examples: rows of loops judged alone, by the number of their pieces of advice: notes and units of the others are theirs.
    """

    names: tuple[str, ...]
    judged: Judged
    quantities: dict[str, np.ndarray]
    examples: dict[int, tuple[Row, tuple[str, ...]]]

    def row(self, k: int, name: str, file: str, sha256: str | None) -> Row:
        """The row of a plain loop."""
        one, advice = self.judged, self.judged.advice[k]
        example, _ = self.examples[len(advice)]
        return Row(
            name=name,
            file=file,
            sha256=sha256,
            status=Status.OK,
            reason=self.reason(k),
            codes=example.codes,
            model=example.model,
            samples=example.samples,
            values=dict(zip(self.names, one.x[k].tolist(), strict=True)),
            stderr=dict(zip(self.names, one.stderr[k].tolist(), strict=True)),
            rmse=float(one.rmse[k]),
            error_percent=float(one.percent[k]),
            max_error_percent=float(one.largest_percent[k]),
            quantities={key: float(v[k]) if np.isfinite(v[k]) else None for key, v in self.quantities.items()},
            units=example.units,
        )

    def reason(self, k: int) -> str:
        """The warnings of a plain loop: those of the example, with its own advice."""
        advice = self.judged.advice[k]
        example, said = self.examples[len(advice)]
        text = example.reason
        for mine, other in zip(advice, said, strict=True):
            text = text.replace(other, mine)
        return text


def fit_plain(
    model: AbstractHysteresis, record: Record, y: Float[np.ndarray, "N T"], options: FitOptions, *, held: bool
) -> PlainFits | None:
    """Fit loops over the input of a record; None where none of them can be judged beside others.

    Args:
        model: that is fitted.
        record: gives input, time, weights, units and names.
        y: outputs, NaN where one is missing.
        options: of each fit, without a robust loss or a noise model of its own.
        held: parameters in `fix` without a value keep that of the model.
    """
    sound = np.flatnonzero(sound_outputs(record.u, y))
    if sound.size < FEWEST:
        return None
    common = common_of(model, record, y[sound], options, held=held)
    if common is None:
        return None
    ends, stack = solve_alike(common, y[sound])
    judged = judge_plain(common, y[sound], ends, stack)
    set_up = lambda record: set_up_fit(model, Dataset.of(record), options, held=held)
    examples = _examples(common, y[sound], judged, ends.normal.cost, options, set_up)
    if examples is None:
        return None
    quantities = _quantities(common, stack, ends.normal.z)
    return _spread(PlainFits(common.setup.problem.space.names, judged, quantities, examples), sound, len(y))


def _examples(
    common: Common,
    y: Float[np.ndarray, "N T"],
    judged: Judged,
    cost: np.ndarray,
    options: FitOptions,
    set_up: Callable[[Record], FitSetup],
) -> dict[int, tuple[Row, tuple[str, ...]]] | None:
    """A loop judged alone for each number of pieces of advice; None where such a judgment is another one."""
    found: dict[int, tuple[Row, tuple[str, ...]]] = {}
    for k in np.flatnonzero(judged.plain):
        advice = judged.advice[k]
        if len(advice) in found:
            continue
        record, watch = common.record.replace(y=y[k]), Stopwatch()
        estimate = Estimate(judged.x[k], float(cost[k]), True, "converged", 1, np.array([cost[k]]))
        row = row_of("", "", record, judge(set_up(record), estimate, options, watch))
        errors = np.array([np.nan if value is None else value for value in row.stderr.values()])
        same = row.status is Status.OK and np.allclose(errors, judged.stderr[k], rtol=_SAME)
        if not same:
            return None
        found[len(advice)] = row, advice
    return found or None


def _quantities(common: Common, stack: Stack, z: np.ndarray) -> dict[str, np.ndarray]:
    """Quantities of the steady loop of each fitted model."""
    problem, model = common.setup.problem, common.setup.problem.model
    excitation = Excitation.of(problem.data, hardens=model.hardens)
    outputs = lambda record: simulated(stack, z, record.u, 0 * record.u if model.rate_independent else record.dt)
    return values_of_outputs(problem.data, excitation, outputs, timed=not model.rate_independent)


def _spread(fits: PlainFits, at: np.ndarray, count: int) -> PlainFits:
    """Results of some loops among all; the others are not plain."""

    def among(values: np.ndarray) -> np.ndarray:
        out = np.zeros((count, *values.shape[1:]), values.dtype)
        out[at] = values
        return out

    *arrays, advice = fits.judged
    said: list[Sequence[str]] = [()] * count
    for k, lines in zip(at, advice, strict=True):
        said[k] = lines
    judged = Judged(*map(among, arrays), tuple(map(tuple, said)))
    return fits._replace(judged=judged, quantities={name: among(v) for name, v in fits.quantities.items()})
