"""Recursive least squares (Zhou and Wang 2013, eq. (7) of the repaired text)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import ParameterError
from hystfit.identify.base import Run
from hystfit.identify.bias import noise_bias
from hystfit.identify.duhem_regression import DuhemRegressor, LinearIdentifier, Rows, regression_of
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shapes import Scalar
from hystfit.outcome import Note, Status
from hystfit.params.param import as_array

_WINDUP = 1e3  # growth of the mean variance over the prior at which forgetting pauses


class RlsState(NamedTuple):
    """State of the recursion.

    Attributes:
        theta: shape (p,), in the units of the basis.
        root: S with P = S S^T in the square-root form, P itself in the symmetric one, shape (p, p).
        last: (u, y) of the previous sample; NaN before the first.
    """

    theta: Float[Array, " p"]
    root: Float[Array, "p p"]
    last: Float[Array, "2"]


class Rls(LinearIdentifier):
    """Recursive least squares on one-step equations, which minimizes sum of lambda^(K-k) (target - phi . theta)^2 + prior.

    Attributes:
        regressor: the one-step Duhem equation.
        theta0: start, shape (p,), in the units of the basis.
        forgetting: lambda, in (0, 1]; 1 weights all samples alike. Forgetting pauses without excitation, so the covariance cannot
            wind up.
        prior: P_0 = prior * identity, in the units of the basis.
        form: "square-root" (Potter's update of a factor of P, which stays positive definite in single precision) or "symmetric"
            (P itself, made symmetric after every step).

    Raises:
        ParameterError: forgetting or prior out of range, or an unknown form.
    """

    method: ClassVar[str] = "rls"

    regressor: DuhemRegressor
    theta0: Float[Array, " p"]
    forgetting: Scalar = eqx.field(default=1.0, converter=as_array)
    prior: Scalar = eqx.field(default=1e8, converter=as_array)
    form: str = eqx.field(static=True, default="square-root")

    @classmethod
    def of(
        cls,
        model: AbstractHysteresis,
        data: Record | Dataset | Sequence[Record],
        *,
        start: str = "zero",
        basis: str = "legendre",
        forgetting: float = 1.0,
        prior: float = 1e8,
        form: str = "square-root",
    ) -> Rls:
        """Scaled to records.

        Args:
            model: a `Duhem`, which gives the orders and the scheme.
            data: the records.
            start: theta0 is "zero", the values of the "model", or read from the "data".
            basis: of the regressors, "legendre" or the paper's "powers".
            forgetting, prior, form: see the attributes.

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
        regressor, _, theta0 = regression_of(model, Dataset.of(data), basis, start)
        return cls(regressor, theta0, forgetting, prior, form)  # type: ignore[arg-type]

    def init(self) -> RlsState:
        """The start and its prior covariance."""
        scale = jnp.sqrt(self.prior) if self.form == "square-root" else self.prior
        root = scale * jnp.eye(self.regressor.p, dtype=self.theta0.dtype)
        return RlsState(self.theta0, root, jnp.full(2, jnp.nan, self.theta0.dtype))

    def correct(self, state: RlsState, phi: Array, error: Array) -> RlsState:
        """About 2 p^2 multiplications."""
        gain, root = (self._potter if self.form == "square-root" else self._symmetric)(state.root, phi)
        return state._replace(theta=state.theta + gain * error, root=root)

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

    def check(self, run: Run, rows: Rows) -> tuple[Status, list[Note]]:
        """Whether the estimate is valid, determined by the input, and not biased by noise."""
        status, notes = self.validity(run.history)
        if status is not Status.OK:
            return status, notes
        if (unexcited := self.excitation(rows)) is not None:
            return Status.UNDETERMINED, [unexcited]
        weight = float(self.forgetting) ** np.arange(rows.target.size)[::-1]
        biased = noise_bias(self.regressor, rows, run.history[-1], weight).note(run.data.units["y"])
        return (Status.OK, []) if biased is None else (Status.BIASED, [biased])
