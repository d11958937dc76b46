"""The log posterior in whitened coordinates q: z = center + factor q, with the posterior near N(0, I) in q after a fit."""

from __future__ import annotations

import equinox as eqx
import jax
from jaxtyping import Array, Float

from hystfit.inference.density import Density


class Target(eqx.Module):
    """The log posterior that samplers draw from.

    Attributes:
        density: over z, the unconstrained parameters of model and noise.
        center, factor: z = center + factor q.
    """

    density: Density
    center: Float[Array, " d"]
    factor: Float[Array, "d d"]

    def unwhitened(self, q: Float[Array, " d"]) -> Float[Array, " d"]:
        """z from q."""
        return self.center + self.factor @ q

    def physical(self, q: Float[Array, " d"]) -> Float[Array, " d"]:
        """x from q."""
        return self.density.physical(self.unwhitened(q))

    def __call__(self, q: Float[Array, " d"]) -> Float[Array, ""]:
        """Log posterior over q; its reverse-mode gradient is that of `Density.slope`."""

        @jax.custom_vjp
        def value(q: Array) -> Array:
            return self.density.log_density(self.unwhitened(q))

        def both(q: Array) -> tuple[Array, Array]:
            total, gradient = self.density.slope(self.unwhitened(q))
            return total, self.factor.T @ gradient

        value.defvjp(both, lambda gradient, cotangent: (cotangent * gradient,))
        return value(q)
