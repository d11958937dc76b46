"""Recursive least squares (Zhou and Wang 2013, eq. (7) of the repaired text)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Dataset, Record
from hystfit.errors import ParameterError
from hystfit.identify.base import Info, Sample
from hystfit.identify.bias import noise_bias
from hystfit.identify.linear import LinearIdentifier, check_enough, rows_of, starting_theta
from hystfit.identify.regressors import DuhemRegressor
from hystfit.models.base import AbstractHysteresis
from hystfit.params.param import as_array

_WINDUP = 1e3  # growth of the mean variance over the prior at which forgetting pauses


class RlsState(NamedTuple):
    """Parameters, covariance factor and the sample before.

    Attributes:
        theta: shape (p,), scaled.
        root: S with P = S S^T in the square-root form, P itself in the symmetric one, shape (p, p).
        last: (u, y) of the sample before; NaN before the first.
    """

    theta: Float[Array, " p"]
    root: Float[Array, "p p"]
    last: Float[Array, "2"]


class Rls(LinearIdentifier):
    """Recursive least squares on one-step equations, which minimizes sum of lambda^(K-k) (target - phi . theta)^2 + prior.

    Attributes:
        regressor: the scaled Duhem equation.
        theta0: start, shape (p,), scaled.
        forgetting: lambda, in (0, 1]; 1 weighs all samples alike. Forgetting pauses while the input does not excite, so that the
            covariance cannot wind up.
        prior: P_0 = prior * identity, on scaled regressors.
        form: "square-root" (Potter's update of a factor of P, which stays positive in single precision) or "symmetric" (P
            itself, made symmetric after every step).

    Raises:
        ParameterError: forgetting or prior out of range, or an unknown form.
    """

    method: ClassVar[str] = "rls"

    regressor: DuhemRegressor
    theta0: Float[Array, " p"]
    forgetting: Float[Array, ""] = eqx.field(default=1.0, converter=as_array)
    prior: Float[Array, ""] = eqx.field(default=1e8, converter=as_array)
    form: str = eqx.field(static=True, default="square-root")

    @classmethod
    def of(
        cls,
        model: AbstractHysteresis,
        data: Record | Dataset | Sequence[Record],
        *,
        start: str = "zero",
        forgetting: float = 1.0,
        prior: float = 1e8,
        form: str = "square-root",
    ) -> Rls:
        """Scaled to records, with the orders and scheme of a model; settings as the attributes.

        Raises:
            ParameterError: a setting out of range.
            ModelError, DataError: see `DuhemRegressor.of`; too few samples.
        """
        if not 0 < forgetting <= 1:
            raise ParameterError(f"forgetting must lie in (0, 1], got {forgetting:g}; 0.99 to 1 is usual")
        if not 0 < prior < np.inf:
            raise ParameterError(f"prior must be positive and finite, got {prior:g}")
        if form not in ("square-root", "symmetric"):
            raise ParameterError(f"form must be square-root or symmetric, got {form!r}")
        data = Dataset.of(data)
        regressor = DuhemRegressor.of(model, list(data))
        check_enough(regressor, data)
        theta0 = starting_theta(regressor, model, list(data), start)
        return cls(regressor, theta0, forgetting, prior, form)  # type: ignore[arg-type]

    def init(self) -> RlsState:
        """The start and its prior covariance."""
        scale = jnp.sqrt(self.prior) if self.form == "square-root" else self.prior
        root = scale * jnp.eye(self.regressor.p, dtype=self.theta0.dtype)
        return RlsState(self.theta0, root, jnp.full(2, jnp.nan, self.theta0.dtype))

    def update(self, state: RlsState, sample: Sample) -> tuple[RlsState, Info]:
        """One sample: about 2 p^2 multiplications."""
        phi, target, usable, last = self.equation(state.last, sample)
        error = target - phi @ state.theta
        gain, root = (self._potter if self.form == "square-root" else self._symmetric)(state.root, phi)
        theta = jnp.where(usable, state.theta + gain * error, state.theta)
        root = jnp.where(usable, root, state.root)
        told = jnp.where(usable, error * self.regressor.target_unit, jnp.nan)
        return RlsState(theta, root, last), Info(theta, told, usable)

    def _forgetting(self, trace: Array) -> Array:
        return jnp.where(trace > _WINDUP * self.prior * self.regressor.p, 1.0, self.forgetting)

    def _potter(self, root: Array, phi: Array) -> tuple[Array, Array]:
        forgetting = self._forgetting(jnp.sum(root**2))
        f = root.T @ phi
        total = forgetting + f @ f
        column = root @ f
        down = column / (total + jnp.sqrt(forgetting * total))
        return column / total, (root - down[:, None] * f[None, :]) / jnp.sqrt(forgetting)

    def _symmetric(self, P: Array, phi: Array) -> tuple[Array, Array]:
        forgetting = self._forgetting(jnp.trace(P))
        column = P @ phi
        gain = column / (forgetting + phi @ column)
        P = (P - gain[:, None] * column[None, :]) / forgetting
        return gain, 0.5 * (P + P.T)

    def covariance(self, state: RlsState) -> Float[Array, "p p"]:
        """P, by either form."""
        return state.root @ state.root.T if self.form == "square-root" else state.root

    def judge(self, data: Dataset, state: RlsState, history: np.ndarray, errors: np.ndarray) -> tuple[str, list[str]]:
        """Valid, excited, and not biased by noise?"""
        rows = rows_of(self.regressor, data)
        notes: list[str] = []
        for status, found in (self.validity(history), self.excitation(rows)):
            notes += found
            if status != "ok":
                return status, notes
        weight = float(self.forgetting) ** np.arange(rows.target.size)[::-1]
        bias = noise_bias(self.regressor, rows, history[-1], weight)
        return ("biased" if bias.serious else "ok"), notes + bias.notes(data.units["y"])
