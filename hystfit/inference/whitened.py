"""Least squares under a Gaussian noise model: whitened residuals, their normal equations, and the restricted likelihood."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.setting import Setting
from hystfit.inference.objective import Objective
from hystfit.models.shared.shapes import Scalar


class Whitened(eqx.Module):
    """Least squares in the coordinates in which a Gaussian noise model is white; shapes of the noise are integrated out."""

    objective: Objective
    noise: AbstractNoise
    setting: Setting

    def normal_of(
        self, r: Float[Array, "R T"], J: Float[Array, "R T p"]
    ) -> tuple[Scalar, Float[Array, " p"], Float[Array, "p p"]]:
        """Half the squared whitened residual, its gradient and the information matrix, from residuals and their derivatives."""
        k = J.shape[-1] + 1
        e, count = self._filter(jnp.concatenate([r[..., None], J], axis=-1))
        inner, shapes = e[:, :k], e[:, k:]
        gram = inner.T @ inner
        if count:
            cross = shapes.T @ inner
            gram = gram - cross.T @ jnp.linalg.solve(jnp.eye(count) + shapes.T @ shapes, cross)
        return 0.5 * gram[0, 0], gram[0, 1:], gram[1:, 1:]

    def rows(self, r: Float[Array, "R T"], J: Float[Array, "R T p"]) -> Float[Array, "n q"]:
        """Whitened columns [shapes, J, r] above the prior rows of the shapes' weights: a QR of them solves everything."""
        e, shapes = self._filter(jnp.concatenate([J, r[..., None]], axis=-1), first=True)
        return jnp.concatenate([e, jnp.eye(shapes, e.shape[1])])

    def _filter(self, signals: Array, *, first: bool = False) -> tuple[Array, int]:
        """Whitened signals, shape (n, k), with the shapes of the noise before or after them, and the number of shapes."""
        columns = self.noise.columns(self.setting)
        joined = [columns, signals] if first else [signals, columns]
        e, _ = self.noise.whiten(self.setting, jnp.concatenate(joined, axis=-1))
        return e.reshape(-1, e.shape[-1]), columns.shape[-1]


def restricted(noise: AbstractNoise, setting: Setting, r: Array, J: Array, moving: Array) -> Array:
    """Restricted log likelihood of a noise model (Patterson and Thompson 1971).

    r has shape (R, T) [y], its derivatives J (R, T, p). Columns of J that are not `moving` are not fitted; a small ridge keeps a
    rank-deficient J harmless.
    """
    size = jnp.sqrt(jnp.sum(J**2, axis=(0, 1)))
    columns = J * jnp.where(moving & (size > 0), 1 / jnp.where(size > 0, size, 1.0), 0.0) * jnp.linalg.norm(r)
    parts = [r[..., None], columns, noise.columns(setting)]
    e, logs = noise.whiten(setting, jnp.concatenate(parts, axis=-1))
    e = e.reshape(-1, e.shape[-1])
    target, others = e[:, 0], e[:, 1:]
    prior = jnp.concatenate([jnp.where(moving, 1e-10, 1.0), jnp.ones(others.shape[1] - J.shape[-1])])
    factor = jnp.linalg.cholesky(others.T @ others + jnp.diag(prior))
    half = jax.scipy.linalg.solve_triangular(factor, others.T @ target, lower=True)
    return -0.5 * jnp.sum(logs) - 0.5 * (jnp.sum(target**2) - jnp.sum(half**2)) - jnp.sum(jnp.log(jnp.diag(factor)))
