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

from hystfit.data.record import Dataset, Record
from hystfit.errors import ParameterError
from hystfit.identify.base import Info, Sample
from hystfit.identify.bias import noise_bias
from hystfit.identify.linear import LinearIdentifier, check_enough, rows_of, starting_theta
from hystfit.identify.regressors import DuhemRegressor, Rows
from hystfit.models.base import AbstractHysteresis
from hystfit.params.param import as_array

_SLACK = 1e-12  # relative, of the condition on time-varying weights
_EXCESS = 0.02  # part of the response's RMS by which the equation error may exceed that of the batch solution


class GradientState(NamedTuple):
    """Parameters, the sample before, and how many rows were used.

    Attributes:
        theta: shape (p,), scaled.
        last: (u, y) of the sample before; NaN before the first.
        count: rows used so far (the index of time-varying weights).
    """

    theta: Float[Array, " p"]
    last: Float[Array, "2"]
    count: Int[Array, ""]


class GradientCorrection(LinearIdentifier):
    """Weighted normalized gradient steps; costs 2 p multiplications a sample, and converges slowly.

    Attributes:
        regressor: the scaled Duhem equation.
        theta0: start, shape (p,), scaled.
        weights: Lambda, shape (p,), or (K, p) for weights that vary with the row (the last stays).
        mu: part of the stable step, in (0, 2): c = mu / (floor + phi^T Lambda phi).
        floor: epsilon. Without it noise is amplified without bound at turning points, where phi vanishes.
        step: constant c instead, capped at the normalized step where it would break its bound; None for mu and floor.
    """

    method: ClassVar[str] = "gradient-correction"

    regressor: DuhemRegressor
    theta0: Float[Array, " p"]
    weights: Float[Array, "*K p"]
    mu: Float[Array, ""] = eqx.field(default=1.0, converter=as_array)
    floor: Float[Array, ""] = eqx.field(default=1.0, converter=as_array)
    step: Float[Array, ""] | None = eqx.field(default=None, converter=as_array)

    @classmethod
    def of(
        cls,
        model: AbstractHysteresis,
        data: Record | Dataset | Sequence[Record],
        *,
        start: str = "data",
        weights: Sequence[float] | np.ndarray | None = None,
        mu: float = 1.0,
        floor: float = 1.0,
        step: float | None = None,
    ) -> GradientCorrection:
        """Scaled to records, with the orders and scheme of a model; settings as the attributes.

        `weights` None equalizes the columns: one over their mean squares in the records. From zero the steps would need many
        passes: the default start is what `Duhem.start` reads off the records.

        Raises:
            ParameterError: a setting out of range, weights that are not positive or vary against the condition.
            ModelError, DataError: see `DuhemRegressor.of`; too few samples.
        """
        if not 0 < mu < 2:
            raise ParameterError(f"mu must lie in (0, 2), outside of which the error grows; got {mu:g}")
        if not 0 <= floor < np.inf:
            raise ParameterError(f"floor must not be negative, got {floor:g}; 1 suits scaled regressors")
        data = Dataset.of(data)
        regressor = DuhemRegressor.of(model, list(data))
        rows = check_enough(regressor, data)
        chosen = equalising_weights(rows) if weights is None else check_weights(weights, regressor.p)
        if step is not None:
            _check_step(step, chosen, rows)
        theta0 = starting_theta(regressor, model, list(data), start)
        return cls(regressor, theta0, jnp.asarray(chosen, dtype=theta0.dtype), mu, floor, step)  # type: ignore[arg-type]

    def init(self) -> GradientState:
        """The start."""
        return GradientState(self.theta0, jnp.full(2, jnp.nan, self.theta0.dtype), jnp.zeros((), int))

    def update(self, state: GradientState, sample: Sample) -> tuple[GradientState, Info]:
        """One sample: about 4 p multiplications."""
        phi, target, usable, last = self.equation(state.last, sample)
        weights = self.weights if self.weights.ndim == 1 else self.weights[self._row(state.count)]
        error = target - phi @ state.theta
        power = phi @ (weights * phi)
        gain = self._gain(jnp.where(usable, power, 1.0))
        theta = jnp.where(usable, state.theta + gain * error * weights * phi, state.theta)
        told = jnp.where(usable, error * self.regressor.target_unit, jnp.nan)
        return GradientState(theta, last, state.count + usable), Info(theta, told, usable)

    def _row(self, count: Array) -> Array:
        return jnp.minimum(count, self.weights.shape[0] - 1)

    def _gain(self, power: Array) -> Array:
        if self.step is None:
            return self.mu / (self.floor + power)
        return jnp.where(self.step * power < 2.0, self.step, 1.0 / power)

    def judge(
        self, data: Dataset, state: GradientState, history: np.ndarray, errors: np.ndarray
    ) -> tuple[str, list[str]]:
        """Valid, excited, near the batch solution, and not biased by noise?"""
        rows = rows_of(self.regressor, data)
        best = np.linalg.lstsq(rows.phi, rows.target, rcond=None)[0]  # where the steps head for
        notes = self._warn_of_floor()
        checks = (self.excitation(rows), self._convergence(rows, history[-1], best), self.validity(history))
        for status, found in checks:
            notes += found
            if status != "ok":
                return status, notes
        bias = noise_bias(self.regressor, rows, best)
        return ("biased" if bias.serious else "ok"), notes + bias.notes(data.units["y"])

    def _warn_of_floor(self) -> list[str]:
        if self.step is not None or float(self.floor) > 0:
            return []
        return [
            "floor = 0: the normalized step divides by phi^T Lambda phi, which vanishes at turning points, so that any noise is "
            "amplified without bound; set floor=1"
        ]

    def _convergence(self, rows: Rows, theta: np.ndarray, best: np.ndarray) -> tuple[str, list[str]]:
        """Against the least-squares solution of the same rows."""
        if not np.isfinite(theta).all():
            return "ok", []  # `validity` tells
        rms = lambda value: float(np.sqrt(np.mean((rows.target - rows.phi @ value) ** 2)))
        size, here, there = float(np.sqrt(np.mean(rows.target**2))), rms(theta), rms(best)
        if np.sqrt(max(here**2 - there**2, 0.0)) <= _EXCESS * size:
            return "ok", []
        words = f"the one-step error is {here / size:.2%} of the increments, and {there / size:.2%} could be reached"
        far = "diverged" if here > size else "not-converged"
        return far, [f"{words}: more passes, a better start (start='data'), or method='rls'"]


def equalising_weights(rows: Rows) -> np.ndarray:
    """One over the mean square of each regressor, shape (p,)."""
    return 1.0 / np.maximum(np.mean(rows.phi**2, axis=0), np.finfo(float).tiny)


def check_weights(weights: Sequence[float] | np.ndarray, p: int) -> np.ndarray:
    """Weights of shape (p,) or (K, p) that satisfy the paper's conditions (i) and (ii).

    Raises:
        ParameterError: wrong shape, not positive and finite, or weights that vary so that no one of them has the largest
            relative decrease throughout.
    """
    array = np.asarray(weights, dtype=float)
    if array.ndim not in (1, 2) or array.shape[-1] != p or array.shape[0] == 0:
        raise ParameterError(f"weights must have shape ({p},) or (K, {p}), got {array.shape}")
    if not (np.isfinite(array).all() and (array > 0).all()):
        raise ParameterError("weights must be positive and finite: a zero weight never corrects its parameter")
    if array.ndim == 2:
        kept = np.log(array[1:]) - np.log(array[:-1])  # the largest relative decrease is the smallest ratio
        leads = np.all(kept <= kept.min(axis=1, keepdims=True) + _SLACK, axis=0)
        if not leads.any():
            raise ParameterError(
                "time-varying weights: at every step the same weight must have the largest relative decrease, or the proof of "
                "convergence fails; scale all weights by one common factor, or keep them constant"
            )
    return array


def _check_step(step: float, weights: np.ndarray, rows: Rows) -> None:
    largest = float(np.max(rows.phi**2 @ np.atleast_2d(weights).max(axis=0)))
    if not 0 < step < 2 / largest:
        raise ParameterError(
            f"step must lie in (0, {2 / largest:.4g}) on these records, where the error falls at every row; got {step:g}"
        )
