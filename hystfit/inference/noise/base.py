"""What every noise model can do.

Each noise model is a filter over the samples of a record, so that a likelihood costs O(T) and may share the model's scan:
`step` takes a residual and gives its innovation, scaled to variance one, and the logarithm of the variance by which it was scaled.
"""

from __future__ import annotations

import abc
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hystfit.inference.noise.setting import Setting

LOG_2PI = 1.8378770664093453


class AbstractNoise(eqx.Module):
    """A noise model; its parameters are declared like those of a hysteresis model."""

    name: ClassVar[str]
    gaussian: ClassVar[bool]
    by_squares: ClassVar[bool] = (
        False  # the weighted sum of squares is all that the density needs: see `White.of_squares`
    )

    @abc.abstractmethod
    def init(self) -> Float[Array, " state"]:
        """State of the filter before the first sample."""

    @abc.abstractmethod
    def step(
        self, state: Float[Array, " state"], r: Float[Array, ""], gap: Float[Array, ""], weight: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""], Float[Array, ""]]:
        """One sample: (state, innovation scaled to variance one, log of its variance). Nothing is learned where weight = 0."""

    def density(self, e: Float[Array, "..."], log_variance: Float[Array, "..."]) -> Float[Array, "..."]:
        """Log density of a residual from its scaled innovation and the log of the variance."""
        return -0.5 * (e**2 + log_variance + LOG_2PI)

    def columns(self, setting: Setting) -> Float[Array, "R T k"] | None:
        """Shapes that the noise adds with independent weights of variance one, the same in every record; None for no such part."""
        return None

    @abc.abstractmethod
    def whiten(
        self, setting: Setting, rows: Float[Array, "R T k"]
    ) -> tuple[Float[Array, "R T k"], Float[Array, "R T"]]:
        """Apply the filter to k signals at once: (innovations scaled to variance one, logs of the variances); 0 where weight = 0."""

    @abc.abstractmethod
    def draw(self, setting: Setting, key: Array) -> Float[Array, "R T"]:
        """A realization."""

    def log_density(self, setting: Setting, r: Float[Array, "R T"]) -> Float[Array, ""]:
        """Log density of the residuals that count."""
        columns = self.columns(setting)
        on = setting.weight > 0
        if columns is None:
            e, logs = self.whiten(setting, r[..., None])
            return jnp.sum(jnp.where(on, self.density(e[..., 0], logs), 0.0))
        e, logs = self.whiten(setting, jnp.concatenate([r[..., None], columns], axis=-1))
        plain = jnp.sum(jnp.where(on, self.density(e[..., 0], logs), 0.0))
        shapes, own = e[..., 1:].reshape(-1, columns.shape[-1]), e[..., 0].reshape(-1)
        factor = jnp.linalg.cholesky(jnp.eye(shapes.shape[1]) + shapes.T @ shapes)
        half = jax.scipy.linalg.solve_triangular(factor, shapes.T @ own, lower=True)
        return plain + 0.5 * jnp.sum(half**2) - jnp.sum(jnp.log(jnp.diag(factor)))
