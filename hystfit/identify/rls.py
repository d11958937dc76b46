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
from hystfit.models.shared.shapes import Scalar
from hystfit.outcome import Note, Status
from hystfit.params.param import as_array

_WINDUP = 1e3  # growth of the mean variance over the prior at which forgetting pauses


class RlsState(NamedTuple):
    """State of the recursion: theta in units of the basis, root S with P = S S^T, and (u, y) of the sample before (NaN at first)."""

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

    Raises:
        ParameterError: forgetting or prior out of range.
    """

    method: ClassVar[str] = "rls"

    regressor: DuhemRegressor
    theta0: Float[Array, " p"]
    forgetting: Scalar = eqx.field(default=1.0, converter=as_array)
    prior: Scalar = eqx.field(default=1e8, converter=as_array)

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
    ) -> Rls:
        """Scaled to records.

        Args:
            model: a `Duhem`, which gives the orders and the scheme.
            data: the records.
            start: theta0 is "zero", the values of the "model", or read from the "data".
            basis: of the regressors, "legendre" or the paper's "powers".
            forgetting, prior: see the attributes.

        Raises:
            ParameterError: a setting out of range.
            ModelError, DataError: see `DuhemRegressor.of`; too few samples.
        """
        if not 0 < forgetting <= 1:
            raise ParameterError(f"forgetting must lie in (0, 1], got {forgetting:g}; 0.99 to 1 is usual")
        if not 0 < prior < np.inf:
            raise ParameterError(f"prior must be positive and finite, got {prior:g}")
        regressor, _, theta0 = regression_of(model, Dataset.of(data), basis, start)
        return cls(regressor, theta0, forgetting, prior)  # type: ignore[arg-type]

    def init(self) -> RlsState:
        """The start and its prior covariance."""
        root = jnp.sqrt(self.prior) * jnp.eye(self.regressor.p, dtype=self.theta0.dtype)
        return RlsState(self.theta0, root, jnp.full(2, jnp.nan, self.theta0.dtype))

    def correct(self, state: RlsState, phi: Array, error: Array) -> RlsState:
        """Potter's update of a factor of P, which stays positive definite in single precision: about 2 p^2 multiplications."""
        root = state.root
        winds_up = jnp.sum(root**2) > _WINDUP * self.prior * self.regressor.p
        forgetting = jnp.where(winds_up, 1.0, self.forgetting)
        f = root.T @ phi
        total = forgetting + f @ f
        column = root @ f
        down = column / (total + jnp.sqrt(forgetting * total))
        root = (root - down[:, None] * f[None, :]) / jnp.sqrt(forgetting)
        return state._replace(theta=state.theta + column / total * error, root=root)

    def covariance(self, state: RlsState) -> Float[Array, "p p"]:
        """P, in the units of the basis."""
        return state.root @ state.root.T

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
