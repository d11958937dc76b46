"""Sigma points, their weights, and covariance roots by QR: the arithmetic of the unscented transform."""

from __future__ import annotations

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

CENTRAL = 2.0  # weight of the central point in covariances; in means it has none
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
    """Sigma points of n coordinates (Minase et al. 2010, section 3.3), with Merwe's alpha = 1, beta = 2 and kappa = 0.

    No weight is negative, so that a covariance root comes from a QR factorization and cannot lose positive definiteness.
    """

    n: int

    def points(self, mean: Float[Array, " n"], root: Float[Array, "n n"]) -> Float[Array, "m n"]:
        """2 n + 1 points, shape (2 n + 1, n): the mean, then the mean plus and minus the scaled columns of the root."""
        columns = math.sqrt(self.n) * root.T
        return mean + jnp.concatenate([jnp.zeros_like(mean)[None], columns, -columns])

    def weights(self, center: float, like: Array) -> Float[Array, " m"]:
        """Weights of all points, shape (2 n + 1,), `center` for the central one. In a scan one vector costs half as much as slices."""
        return jnp.asarray(np.r_[center, np.full(2 * self.n, 0.5 / self.n)], dtype=like.dtype)

    def mean(self, values: Float[Array, "m ..."]) -> Float[Array, "..."]:
        """Weighted mean of transformed points."""
        return self.weights(0.0, values) @ values

    def covariance(self, left: Float[Array, "m ..."], right: Float[Array, " m"]) -> Float[Array, "..."]:
        """Weighted sum of products of deviations, left of shape (m, ...), right of shape (m,)."""
        return (self.weights(CENTRAL, right) * right) @ left

    def root(self, deviations: Float[Array, "m n"], noise: Float[Array, "k n"]) -> Float[Array, "n n"]:
        """Lower-triangular L with L L^T = weighted deviations^T deviations + noise^T noise."""
        weights = self.weights(CENTRAL, deviations)[:, None]
        return triangular(jnp.concatenate([jnp.sqrt(weights) * deviations, noise]))
