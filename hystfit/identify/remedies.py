"""Remedies where noise biases one-step regression: decimation, integrated regression, bias compensation."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from hystfit.data.record import Record
from hystfit.errors import DataError, ParameterError
from hystfit.identify.bias import noise_bias
from hystfit.identify.duhem_regression import DuhemRegressor, with_first_output
from hystfit.identify.rls import Rls
from hystfit.models.duhem import Duhem
from hystfit.models.shared.simulation import simulate
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn

_ITERATIONS = 100  # of integrated regression, at most
_SETTLED = 1e-5  # change of the simulated output, in units of its half range, at which they stop


def decimate(record: Record, increment: float) -> Record:
    """The samples between which the input has moved by `increment` [u], and all turning points.

    Between these samples the output moves by far more than its noise. Turning points are kept, because a step across one
    would hide part of the travel.

    Raises:
        ParameterError: the increment is not positive.
        DataError: fewer than two samples remain.
    """
    if not increment > 0:
        raise ParameterError(f"the increment must be positive, got {increment:g}")
    kept, previous = [0], 0
    u = record.u
    for k in range(1, len(record)):
        turned = (u[k] - u[previous]) * (u[previous] - u[kept[-1]]) < 0
        if turned and previous != kept[-1]:
            kept.append(previous)
        if abs(u[k] - u[kept[-1]]) >= increment:
            kept.append(k)
        if u[k] != u[previous]:
            previous = k
    if len(kept) < 2:
        raise DataError(
            f"an increment of {increment:g} leaves one sample of {record.name!r}: the range of its input is {np.ptp(u):g}; choose a "
            "smaller increment"
        )
    at = np.array(kept)
    note = f"decimated to {at.size} of {len(record)} samples by input increments of {increment:g}"
    return record.take(at).noted(Code.PREPARED, note)


@dataclasses.dataclass(frozen=True)
class Refinement:
    """The result of a remedy, with notes on why the iteration stopped where it did not converge."""

    model: Duhem
    converged: bool
    notes: tuple[Note, ...] = ()


def integrated_regression(model: Duhem, record: Record) -> Refinement:
    """Regression of the output itself instead of its increments:  y_k = w_0 + sum over j <= k of phi_j . theta.

    The regressors use the output simulated with the previous estimate, which has no noise; iterated until the simulation
    does not change. It is also a good start for output-error least squares: `fit(model, record, start="model")`.

    Args:
        model: any fair start (recursive least squares, `Duhem.start`); its orders and scheme are kept.
        record: one record.

    Raises:
        ModelError, DataError: see `DuhemRegressor.of`; fewer usable steps than parameters.
    """
    regressor = DuhemRegressor.of(model, [record])
    regressor.enough_rows(record)
    unit, size = float(regressor.target_unit), float(regressor.size)
    used, root = record.used, np.sqrt(np.asarray(record.weight)[record.used])
    best, last, change = model, np.asarray(simulate(model, record.u)[0]), np.inf
    for count in range(1, _ITERATIONS + 1):
        phi = np.asarray(_regressors(regressor, jnp.asarray(record.u), jnp.asarray(last)))
        columns = np.hstack(
            [np.ones((len(record), 1)), np.vstack([np.zeros(regressor.p), np.cumsum(phi, axis=0) * unit])]
        )
        solved, *_ = np.linalg.lstsq(columns[used] * root[:, None], record.y[used] * root, rcond=1e-12)
        candidate = regressor.model(solved[1:], float(solved[0]))
        if candidate is None:
            text = f"stopped after {count} iterations: the rate would not be positive; the model is that of the previous one"
            return Refinement(best, False, (warn(Code.INVALID_MODEL, text),))
        best = with_first_output(candidate, record)
        now = np.asarray(simulate(best, record.u)[0])
        change, last = float(np.max(np.abs(now - last))) / size, now
        if not np.isfinite(change):
            raise DataError(
                f"the simulation is not finite after {count} iterations of integrated regression: use method='lm'"
            )
        if change < _SETTLED:
            return Refinement(best, True)
    text = f"not converged after {_ITERATIONS} iterations: the simulation changes by {change:.1e} of its half range"
    return Refinement(best, False, (warn(Code.NOT_SETTLED, text),))


@jax.jit
def _regressors(regressor: DuhemRegressor, u: jax.Array, w: jax.Array) -> jax.Array:
    return regressor.row(u[:-1], u[1:], w[:-1], w[1:])[0]


def bias_compensated(model: Duhem, record: Record) -> Refinement:
    """Recursive least squares without the expected effect of white output noise (see `noise_bias`).

    Linear and cheap: all sums can be updated on-line. Valid for white noise only, and for a bias not much larger than the rate
    itself, hence with midpoint regressors.

    Raises:
        ModelError, DataError: see `Rls.of`; noise that is too large to identify the rate.
    """
    rls = Rls.of(model, record)
    bias = noise_bias(rls.regressor, rls.regressor.rows(record), rls.fit(record).theta)
    compensated = None if bias.theta is None else rls.model(bias.theta, record)
    if compensated is None:
        reason = bias.note(record.y_unit) or "the identified rate is not positive: use method='lm'"
        raise DataError(f"record {record.name!r}: {reason}")
    return Refinement(compensated, True)
