"""Model error that repeats every loop, as a Gaussian process over input and direction."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.noise.setting import Setting
from hystfit.inference.noise.slow import OrnsteinUhlenbeck
from hystfit.params.param import param


class LoopDiscrepancy(OrnsteinUhlenbeck):
    """Model error that repeats every loop: a Gaussian process in (input, direction), beside slow and independent noise.

    Squared-exponential covariance in the input with inducing points over its range, independent on rising and falling branches; its
    weights are integrated out. More cycles add nothing to what it hides, so errors stop falling with their number.
    """

    name: ClassVar[str] = "discrepancy"
    noise_loop: Float[Array, ""] = param(
        1.0, bounds=(0.0, np.inf), unit="y", scale=0.01, doc="standard deviation of the error that repeats"
    )
    noise_length: Float[Array, ""] = param(
        0.3, bounds=(0.08, 3.0), scale=0.3, doc="input over which that error changes, in parts of the range"
    )
    points: int = eqx.field(static=True, default=12)

    def columns(self, setting: Setting) -> Float[Array, "R T k"]:
        """Shapes of the inducing points on either branch."""
        shapes = self.noise_loop * inducing_shapes(setting.place, self.noise_length, self.points)
        up = setting.rising[..., None]
        return jnp.concatenate([jnp.where(up, shapes, 0.0), jnp.where(up, 0.0, shapes)], axis=-1)

    def draw(self, setting: Setting, key: Array) -> Float[Array, "R T"]:
        """See `AbstractNoise.draw`."""
        first, second = jax.random.split(key)
        return super().draw(setting, first) + self.columns(setting) @ jax.random.normal(second, (2 * self.points,))


def inducing_shapes(
    place: Float[Array, "*samples"], length: Float[Array, ""], points: int
) -> Float[Array, "*samples k"]:
    """Columns F with F F' close to the squared-exponential covariance of variance one over 0 <= place <= 1."""
    at = jnp.linspace(0.0, 1.0, points)
    cover = lambda a, b: jnp.exp(-0.5 * ((a[..., None] - b) / length) ** 2)
    factor = jnp.linalg.cholesky(cover(at, at) + 1e-8 * jnp.eye(points))
    undone = jax.scipy.linalg.solve_triangular(factor, jnp.eye(points), lower=True)  # small; the samples are many
    return cover(place, at) @ undone.T
