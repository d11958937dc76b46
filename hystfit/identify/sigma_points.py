"""Sigma points, their weights, and covariance roots by QR: the arithmetic of the unscented transform."""

from __future__ import annotations

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.errors import ParameterError

_UNROLLED = 24  # columns up to which the factorization is unrolled; beyond, compiling it would take seconds


def triangular(rows: Float[Array, "m n"]) -> Float[Array, "n n"]:
    """Lower-triangular L with L L^T = rows^T rows, m >= n: the transposed R of a QR factorization.

    By modified Gram-Schmidt, whose R is as accurate as Householder's. Unrolled, because a call of LAPACK prevents the CPU
    compiler from compiling the filter into one loop, which then takes more than twice the time.
    """
    n = rows.shape[1]
    if n > _UNROLLED:
        return jnp.linalg.qr(rows, mode="r").T
    remaining, columns = rows.T, []
    for k in range(n):
        norm = jnp.sqrt(jnp.sum(remaining[0] ** 2))
        unit = remaining[0] / jnp.where(norm > 0, norm, 1.0)
        along = remaining @ unit
        columns.append(jnp.concatenate([jnp.zeros(k, rows.dtype), along]))
        remaining = remaining[1:] - along[1:, None] * unit
    return jnp.stack(columns, axis=1)


@dataclasses.dataclass(frozen=True)
class Unscented:
    """Scaled sigma points of n coordinates (Merwe's alpha, beta, kappa; Minase et al. 2010, section 3.3).

    With alpha = 1, beta >= 0 and kappa >= 0 no weight is negative, so that a covariance root comes from a QR factorization and
    cannot lose positive definiteness.

    Raises:
        ParameterError: n + lambda = alpha^2 (n + kappa) is not positive, or beta is not finite.
    """

    n: int
    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.beta):
            raise ParameterError(f"beta must be finite, got {self.beta}")
        if not self.spread > 0:
            raise ParameterError(
                f"alpha {self.alpha:g} and kappa {self.kappa:g} give no sigma points in {self.n} coordinates: "
                f"alpha^2 (n + kappa) must be positive; alpha=1, kappa=0 is safe"
            )

    @property
    def spread(self) -> float:
        """n + lambda: squared distance of the points in standard deviations."""
        return self.alpha**2 * (self.n + self.kappa)

    @property
    def mean_weight(self) -> float:
        """Weight of the central point in means."""
        return 1.0 - self.n / self.spread

    @property
    def central_weight(self) -> float:
        """Weight of the central point in covariances."""
        return self.mean_weight + 1.0 - self.alpha**2 + self.beta

    @property
    def safe(self) -> bool:
        """No covariance weight is negative."""
        return self.central_weight >= 0

    def points(self, mean: Float[Array, " n"], root: Float[Array, "n n"]) -> Float[Array, "m n"]:
        """2 n + 1 points, shape (2 n + 1, n): the mean, then the mean plus and minus the scaled columns of the root."""
        columns = math.sqrt(self.spread) * root.T
        return mean + jnp.concatenate([jnp.zeros_like(mean)[None], columns, -columns])

    def weights(self, center: float, like: Array) -> Float[Array, " m"]:
        """Weights of all points, shape (2 n + 1,), `center` for the central one. In a scan one vector costs half as much as slices."""
        return jnp.asarray(np.r_[center, np.full(2 * self.n, 0.5 / self.spread)], dtype=like.dtype)

    def mean(self, values: Float[Array, "m ..."]) -> Float[Array, "..."]:
        """Weighted mean of transformed points."""
        return self.weights(self.mean_weight, values) @ values

    def covariance(self, left: Float[Array, "m ..."], right: Float[Array, " m"]) -> Float[Array, "..."]:
        """Weighted sum of products of deviations, left of shape (m, ...), right of shape (m,)."""
        return (self.weights(self.central_weight, right) * right) @ left

    def root(self, deviations: Float[Array, "m n"], noise: Float[Array, "k n"]) -> Float[Array, "n n"]:
        """Lower-triangular L with L L^T = weighted deviations^T deviations + noise^T noise; NaN where that is not positive definite."""
        weights = self.weights(self.central_weight, deviations)[:, None]
        if self.safe:
            return triangular(jnp.concatenate([jnp.sqrt(weights) * deviations, noise]))
        return jnp.linalg.cholesky(deviations.T @ (weights * deviations) + noise.T @ noise)
