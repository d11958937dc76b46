"""Gradient correction: weighted, normalized steps along one row at a time (Zhou and Wang 2013, eq. (8) of the repaired text).

theta <- theta + c Lambda phi (target - phi . theta). For constant Lambda and no noise the weighted error
V = (theta - truth)^T Lambda^-1 (theta - truth) falls by c e^2 (2 - c phi^T Lambda phi) at every step, e the row's error: hence
0 < c < 2 / (phi^T Lambda phi). For weights that vary, Lambda_m V falls as long as Lambda_m has the largest relative decrease
of all weights at every step (the paper's two forms of this condition, over Lambda(k) and over Lambda(k+1), are the same).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import ParameterError
from hystfit.identify.base import Run
from hystfit.identify.bias import noise_bias
from hystfit.identify.duhem_regression import DuhemRegressor, LinearIdentifier, Rows, regression_of
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.shapes import Scalar
from hystfit.outcome import Code, Note, Status
from hystfit.outcome.note import warn
from hystfit.params.param import as_array

_EXCESS = 0.02  # fraction of the response's RMS by which the equation error may exceed that of the batch solution


class GradientState(NamedTuple):
    """State of the recursion: theta in units of the basis, (u, y) of the sample before (NaN at first), and how many rows were used."""

    theta: Float[Array, " p"]
    last: Float[Array, "2"]
    count: Int[Array, ""]


class GradientCorrection(LinearIdentifier):
    """Weighted normalized gradient steps; costs 2 p multiplications a sample, and converges slowly.

    Attributes:
        regressor: the one-step Duhem equation.
        theta0: start, shape (p,), in the units of the basis.
        weights: Lambda, shape (p,), or (K, p) for weights that vary with the row; the last row of weights is kept.
        mu: relative step size, in (0, 2): c = mu / (floor + phi^T Lambda phi).
        floor: epsilon. Without it noise is amplified without bound at turning points, where phi vanishes.
        step: constant c instead, replaced by the normalized step where it exceeds its bound; None for mu and floor.
    """

    method: ClassVar[str] = "gradient-correction"

    regressor: DuhemRegressor
    theta0: Float[Array, " p"]
    weights: Float[Array, "*K p"]
    mu: Scalar = eqx.field(default=1.0, converter=as_array)
    floor: Scalar = eqx.field(default=1.0, converter=as_array)
    step: Scalar | None = eqx.field(default=None, converter=as_array)

    @classmethod
    def of(
        cls,
        model: AbstractHysteresis,
        data: Record | Dataset | Sequence[Record],
        *,
        start: str = "data",
        basis: str = "legendre",
        weights: Sequence[float | int] | np.ndarray | None = None,
        mu: float = 1.0,
        floor: float = 1.0,
        step: float | None = None,
    ) -> GradientCorrection:
        """Scaled to records.

        Args:
            model: a `Duhem`, which gives the orders and the scheme.
            data: the records.
            start: theta0 is "zero" (which needs many passes), the values of the "model", or read from the "data".
            basis: of the regressors, "legendre" or the paper's "powers".
            weights: Lambda; None takes one over the mean square of each regressor in the records.
            mu, floor, step: see the attributes.

        Raises:
            ParameterError: a setting out of range, weights that are not positive or vary against the condition.
            ModelError, DataError: see `DuhemRegressor.of`; too few samples.
        """
        if not 0 < mu < 2:
            raise ParameterError(f"mu must lie in (0, 2), outside of which the error grows; got {mu:g}")
        if not 0 <= floor < np.inf:
            raise ParameterError(f"floor must not be negative, got {floor:g}; 1 suits scaled regressors")
        regressor, rows, theta0 = regression_of(model, Dataset.of(data), basis, start)
        if weights is None:
            lambdas = 1.0 / np.maximum(np.mean(rows.phi**2, axis=0), np.finfo(float).tiny)
        else:
            lambdas = check_weights(weights, regressor.p)
        largest = float(np.max(rows.phi**2 @ np.atleast_2d(lambdas).max(axis=0)))
        if step is not None and not 0 < step < 2 / largest:
            raise ParameterError(
                f"step must lie in (0, {2 / largest:.4g}) on these records, where the error falls at every row; got {step:g}"
            )
        return cls(regressor, theta0, jnp.asarray(lambdas, dtype=theta0.dtype), mu, floor, step)  # type: ignore[arg-type]

    def init(self) -> GradientState:
        return GradientState(self.theta0, jnp.full(2, jnp.nan, self.theta0.dtype), jnp.zeros((), int))

    def correct(self, state: GradientState, phi: Array, error: Array) -> GradientState:
        """About 4 p multiplications."""
        number = jnp.minimum(state.count, len(self.weights) - 1)
        weights = self.weights if self.weights.ndim == 1 else self.weights[number]
        gain = self._gain(phi @ (weights * phi))
        return state._replace(theta=state.theta + gain * error * weights * phi, count=state.count + 1)

    def _gain(self, power: Array) -> Array:
        """Step c for phi^T Lambda phi, which is 0 in a row that is not used."""
        power = jnp.where(power > 0, power, 1.0)
        normalized = self.mu / (self.floor + power)
        return normalized if self.step is None else jnp.where(self.step * power < 2.0, self.step, 1.0 / power)

    def check(self, run: Run, rows: Rows) -> tuple[Status, list[Note]]:
        """Whether the input determines the estimate, and it is near the batch solution, valid and not biased by noise."""
        best = np.linalg.lstsq(rows.phi, rows.target, rcond=None)[0]  # the fixed point of the steps
        notes = []
        if self.step is None and float(self.floor) == 0:
            text = "floor = 0: the step divides by phi^T Lambda phi, which vanishes at turning points and amplifies noise; set floor=1"
            notes.append(warn(Code.STEP_SIZE, text))
        if (unexcited := self.excitation(rows)) is not None:
            return Status.UNDETERMINED, [*notes, unexcited]
        for status, problems in (self._convergence(rows, run.history[-1], best), self.validity(run.history)):
            if status is not Status.OK:
                return status, [*notes, *problems]
        biased = noise_bias(self.regressor, rows, best).note(run.data.units["y"])
        return (Status.OK, notes) if biased is None else (Status.BIASED, [*notes, biased])

    def _convergence(self, rows: Rows, theta: np.ndarray, best: np.ndarray) -> tuple[Status, list[Note]]:
        """Against the least-squares solution of the same rows; theta that is not finite is left to `validity`."""
        if not np.isfinite(theta).all():
            return Status.OK, []
        rms = lambda value: float(np.sqrt(np.mean((rows.target - rows.phi @ value) ** 2)))
        size, error, least = float(np.sqrt(np.mean(rows.target**2))), rms(theta), rms(best)
        if np.sqrt(max(error**2 - least**2, 0.0)) <= _EXCESS * size:
            return Status.OK, []
        text = (
            f"the one-step error is {100 * error / size:.2f} % of the increments, and the least possible is "
            f"{100 * least / size:.2f} %: use more "
            "passes, a better start (start='data'), or method='rls'"
        )
        return Status.DIVERGED if error > size else Status.NOT_CONVERGED, [warn(Code.ONE_STEP_ERROR, text)]


def check_weights(weights: Sequence[float | int] | np.ndarray, p: int) -> np.ndarray:
    """Weights of shape (p,) or (K, p) that satisfy the paper's conditions (i) and (ii)."""
    array = np.asarray(weights, dtype=float)
    if array.ndim not in (1, 2) or array.shape[-1] != p or array.shape[0] == 0:
        raise ParameterError(f"weights must have shape ({p},) or (K, {p}), got {array.shape}")
    if not (np.isfinite(array).all() and (array > 0).all()):
        raise ParameterError("weights must be positive and finite: a parameter of weight zero is never corrected")
    if array.ndim == 2:
        ratio = np.log(array[1:]) - np.log(array[:-1])  # the largest relative decrease is the smallest ratio
        leads = np.all(ratio <= ratio.min(axis=1, keepdims=True) + 1e-12, axis=0)  # rounding
        if not leads.any():
            raise ParameterError(
                "time-varying weights: the same weight must have the largest relative decrease at every step, or convergence is not "
                "guaranteed; scale all weights by one common factor, or keep them constant"
            )
    return array
