"""What to do where noise spoils one-step regression: decimate, regress on the simulated output, or fit the free run."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError, ParameterError
from hystfit.fitting.least_squares import LeastSquares
from hystfit.identify.bias import noise_bias
from hystfit.identify.linear import check_enough, rows_of, with_first_output
from hystfit.identify.regressors import DuhemRegressor
from hystfit.identify.rls import Rls
from hystfit.inference.problem import Problem
from hystfit.models.base import simulate
from hystfit.models.duhem import Duhem
from hystfit.outcome import Code


def decimate(record: Record, increment: float) -> Record:
    """Keep the samples at which the input has moved by `increment` [u] since the last one kept, and all turning points.

    The output then moves by far more than its noise between the samples kept. Turning points stay, as a step across one would
    hide part of the travel.

    Raises:
        ParameterError: the increment is not positive.
        DataError: fewer than two samples would be left.
    """
    if not increment > 0:
        raise ParameterError(f"the increment must be positive, got {increment:g}")
    kept, before = [0], 0
    u = record.u
    for k in range(1, len(record)):
        turned = (u[k] - u[before]) * (u[before] - u[kept[-1]]) < 0
        if turned and before != kept[-1]:
            kept.append(before)
        if abs(u[k] - u[kept[-1]]) >= increment:
            kept.append(k)
        if u[k] != u[before]:
            before = k
    if len(kept) < 2:
        raise DataError(
            f"an increment of {increment:g} leaves {len(kept)} sample of {record.name!r}: its input spans "
            f"{np.ptp(u):g}; choose a smaller one"
        )
    at = np.array(kept)
    note = f"decimated to {at.size} of {len(record)} samples by input increments of {increment:g}"
    return record.take(at).noted(Code.PREPARED, note)


@dataclasses.dataclass(frozen=True)
class Refinement:
    """The outcome of a remedy.

    Attributes:
        model: as the first record sees it.
        converged: the iteration settled.
        iterations: it took.
        notes: one sentence each.
    """

    model: Duhem
    converged: bool
    iterations: int
    notes: tuple[str, ...] = ()


def integrated_regression(
    model: Duhem, record: Record, *, iterations: int = 100, tolerance: float = 1e-5
) -> Refinement:
    """Regress the output itself, not its increments:  y_k = w_0 + sum over j <= k of phi_j . theta.

    The regressors take the output simulated with the last estimate, which has no noise; iterated until the simulation
    stays. Start from any fair model (recursive least squares, `Duhem.start`).

    Args:
        model: start; its orders and scheme are kept.
        record: one record.
        iterations: at most.
        tolerance: change of the simulated output, in units of its half range, at which to stop.

    Raises:
        ModelError, DataError: see `DuhemRegressor.of`; fewer usable steps than parameters.
    """
    regressor = DuhemRegressor.of(model, [record])
    check_enough(regressor, Dataset.of(record))
    unit, size = float(regressor.target_unit), float(regressor.size)
    used, root = record.used, np.sqrt(np.asarray(record.weight)[record.used])
    best, last, change = model, np.asarray(simulate(model, record.u)[0]), np.inf
    for count in range(1, iterations + 1):
        phi = np.asarray(_rows_on(regressor, jnp.asarray(record.u), jnp.asarray(last)))
        columns = np.hstack(
            [np.ones((len(record), 1)), np.vstack([np.zeros(regressor.p), np.cumsum(phi, axis=0) * unit])]
        )
        solved, *_ = np.linalg.lstsq(columns[used] * root[:, None], record.y[used] * root, rcond=1e-12)
        candidate = regressor.model(solved[1:], float(solved[0]))
        if candidate is None:
            note = (
                f"stopped after {count} rounds: the rate would not be positive; the model of the round before is given"
            )
            return Refinement(best, False, count, (note,))
        best = with_first_output(candidate, record)
        now = np.asarray(simulate(best, record.u)[0])
        change, last = float(np.max(np.abs(now - last))) / size, now
        if not np.isfinite(change):
            raise DataError(
                f"the simulation is not finite after {count} rounds of integrated regression: use method='lm'"
            )
        if change < tolerance:
            return Refinement(best, True, count)
    note = f"not settled after {iterations} rounds (the simulation still moves by {change:.1e} of its half range)"
    return Refinement(best, False, iterations, (note,))


@jax.jit
def _rows_on(regressor: DuhemRegressor, u: jax.Array, w: jax.Array) -> jax.Array:
    return regressor.row(u[:-1], u[1:], w[:-1], w[1:])[0]


def bias_compensated(model: Duhem, record: Record) -> Refinement:
    """Recursive least squares with the expected effect of white output noise taken out (see `noise_bias`).

    Linear and cheap: sums that can be kept on-line. Holds for white noise alone, and while the pull is not much larger than the
    rate itself, so with midpoint regressors.

    Raises:
        ModelError, DataError: see `Rls.of`; noise that drowns the rate.
    """
    rls = Rls.of(model, record)
    rows = rows_of(rls.regressor, Dataset.of(record))
    bias = noise_bias(rls.regressor, rows, rls.fit(record).theta)
    compensated = None if bias.theta is None else rls.model(bias.theta, record)
    if compensated is None:
        raise DataError(
            f"record {record.name!r}: {'; '.join(bias.notes('')) or 'the identified rate is not positive: use method=lm'}"
        )
    return Refinement(compensated, True, 1)


def output_error(model: Duhem, record: Record) -> Refinement:
    """Least squares on the free run, started from integrated regression (which starts from `model`).

    Raises:
        PrecisionError: double precision is off.
        ModelError, DataError: see `Problem`.
    """
    start = integrated_regression(model, record)
    problem = Problem(start.model, record)
    center = problem.space.unconstrained(problem.space.vector(start.model))
    estimate = LeastSquares().estimate(problem, center[None])
    fitted = problem.space.coordinates.assemble(jnp.asarray(estimate.x))
    notes = () if estimate.converged else (estimate.message,)
    return Refinement(fitted, estimate.converged, estimate.evaluations, notes)
