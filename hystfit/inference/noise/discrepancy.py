"""Model error that recurs every loop, as a Gaussian process over input and direction."""

from __future__ import annotations

from types import ModuleType
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from hystfit.inference.noise.base import ResidualScales
from hystfit.inference.noise.ornstein_uhlenbeck import OrnsteinUhlenbeck
from hystfit.inference.noise.setting import Setting
from hystfit.inference.priors import AbstractPrior, LogNormal
from hystfit.models.shared.shapes import Scalar
from hystfit.outcome import Code
from hystfit.params.param import param

_CURVE = 0.7  # prior standard deviation of the log size of the curve about the size that the residuals suggest


class LoopDiscrepancy(OrnsteinUhlenbeck):
    """Model error that recurs every loop: a Gaussian process in (input, direction), added to slow and independent noise.

    Squared-exponential covariance in the input with inducing points over its range, independent on rising and falling branches; its
    weights are integrated out. The error is the same in every cycle, so standard errors do not fall with the number of cycles.
    """

    name: ClassVar[str] = "discrepancy"
    has_shapes: ClassVar[bool] = True
    covers: ClassVar[frozenset[Code]] = OrnsteinUhlenbeck.covers | {Code.REPEATING_RESIDUALS}
    noise_loop: Scalar = param(
        1.0, bounds=(0.0, np.inf), unit="y", scale=0.01, doc="standard deviation of the recurring error"
    )
    noise_length: Scalar = param(
        0.3, bounds=(0.08, 3.0), scale=0.3, doc="input range over which that error changes, relative to the whole range"
    )
    points: int = eqx.field(static=True, default=12)

    def columns(self, setting: Setting) -> Float[Array, "R T k"]:
        """Shapes of the inducing points on either branch."""
        return on_branches(self.noise_loop * inducing_shapes(setting.place, self.noise_length, self.points), setting)

    @classmethod
    def start(cls, scales: ResidualScales) -> LoopDiscrepancy:
        """As slow noise, with a curve of half its size."""
        plain = OrnsteinUhlenbeck.start(scales)
        return cls(plain.noise_white, plain.noise_slow, plain.noise_time, 0.5 * scales.slow)

    @classmethod
    def of_size(cls, size: float) -> LoopDiscrepancy:
        """White and slow noise of this size, and a curve of twice the size."""
        return cls(noise_white=size, noise_slow=size, noise_time=20.0, noise_loop=2 * size)

    @classmethod
    def default_priors(cls, longest: int, curve_size: float | None) -> dict[str, AbstractPrior]:
        """The prior of the curve is scaled to the residuals.

        Model and discrepancy explain the same data. Without this prior the draws include errors of any size that the model
        compensates (Brynjarsdottir and O'Hagan 2014).
        """
        curve = {} if curve_size is None else {"noise_loop": LogNormal(curve_size, _CURVE)}
        return super().default_priors(longest, curve_size) | curve

    def draw(self, setting: Setting, key: Array) -> Float[Array, "R T"]:
        first, second = jax.random.split(key)
        return super().draw(setting, first) + self.columns(setting) @ jax.random.normal(second, (2 * self.points,))

    def predictive(
        self, new: Setting, key: Array, seen: Setting, residual: Float[Array, "R T"]
    ) -> Float[Array, "Q T2"]:
        """The curve is drawn given the residuals, which determine it; the rest has the innovations of the residuals less that curve."""
        columns = self.columns(seen)
        e, _ = self.whiten(seen, jnp.concatenate([residual[..., None], columns], axis=-1))
        rows = e.reshape(-1, e.shape[-1])
        target, shapes = rows[:, 0], rows[:, 1:]
        factor = jnp.linalg.cholesky(jnp.eye(shapes.shape[1]) + shapes.T @ shapes)
        mean = jax.scipy.linalg.cho_solve((factor, True), shapes.T @ target)
        first, second, third = jax.random.split(key, 3)
        scatter = jax.random.normal(first, mean.shape)
        weights = mean + jax.scipy.linalg.solve_triangular(factor.T, scatter, lower=False)
        ahead = self.columns(new)
        # Between inducing points the curve has some variance of its own.
        rest = jnp.sqrt(jnp.maximum(self.noise_loop**2 - jnp.sum(ahead**2, axis=-1), 0.0))
        curve = ahead @ weights + rest * jax.random.normal(second, rest.shape)
        return curve + self.with_innovations_of(e[..., 0] - e[..., 1:] @ weights, seen, new, third)


def on_branches(shapes: Float[Array, "R T k"], setting: Setting) -> Float[Array, "R T k2"]:
    """Columns that are the shapes on rising branches, then on falling ones, and zero elsewhere."""
    up = setting.rising[..., None]
    return jnp.concatenate([jnp.where(up, shapes, 0.0), jnp.where(up, 0.0, shapes)], axis=-1)


def inducing_shapes(place: Any, length: Any, points: int, on: ModuleType = jnp) -> Any:
    """`points` columns F, F F' near the squared-exponential covariance of variance one; place (0 to 1) and length in input ranges."""
    solve = jax.scipy.linalg.solve_triangular if on is jnp else scipy.linalg.solve_triangular
    at = on.linspace(0.0, 1.0, points)
    cover = lambda a, b: on.exp(-0.5 * ((a[..., None] - b) / length) ** 2)
    factor = on.linalg.cholesky(cover(at, at) + 1e-8 * on.eye(points))
    inverse = solve(factor, on.eye(points), lower=True)  # smaller than a solve per sample
    return cover(place, at) @ inverse.T  # type: ignore[attr-defined]
