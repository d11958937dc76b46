"""The log posterior in whitened coordinates q: v = center + factor q, with the posterior near N(0, I) in q after a fit."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hystfit.inference.density import Density
from hystfit.params.coordinates import BOTH
from hystfit.sampling.bend import bent, log_slope, unbent


class Target(eqx.Module):
    """The log posterior that samplers draw from.

    Attributes:
        density: over z, the unconstrained parameters of model and noise.
        center, factor: v = center + factor q, where v are the coordinates of `hystfit.sampling.bend`.
    """

    density: Density
    center: Float[Array, " d"]
    factor: Float[Array, "d d"]

    @classmethod
    def about(cls, density: Density, z: Float[Array, " d"]) -> Target:
        """Centered on z, not whitened."""
        return cls(density, bent(jnp.asarray(z), _both(density)), jnp.eye(z.shape[0]))

    def whitened(self, center: Float[Array, " d"], factor: Float[Array, "d d"]) -> Target:
        """The same density in other coordinates q.

        Args:
            center: v where q = 0, shape (d,).
            factor: dv/dq, shape (d, d).
        """
        return Target(self.density, center, factor)

    def unwhitened(self, q: Float[Array | np.ndarray, "... d"]) -> Float[Array, "... d"]:
        """z from q."""
        return unbent(self.center + q @ self.factor.T, _both(self.density))

    def physical(self, q: Float[Array, " d"]) -> Float[Array, " d"]:
        """x from q."""
        return self.density.physical(self.unwhitened(q))

    def log_density(self, v: Float[Array, " d"], lean: bool = False) -> Float[Array, ""]:
        """Log posterior over v.

        Args:
            v: shape (d,).
            lean: see `Density.log_density`.
        """
        both = _both(self.density)
        return self.density.log_density(unbent(v, both), lean) + log_slope(v, both)

    def slope(self, v: Float[Array, " d"]) -> tuple[Float[Array, ""], Float[Array, " d"]]:
        """`log_density` and its gradient."""
        both = _both(self.density)
        z, stretch = jax.jvp(lambda v: unbent(v, both), (v,), (jnp.ones_like(v),))
        total, gradient = self.density.slope(z)
        change, by_change = jax.value_and_grad(log_slope)(v, both)
        return total + change, gradient * stretch + by_change

    def __call__(self, q: Float[Array, " d"]) -> Float[Array, ""]:
        """Log posterior over q; its reverse-mode gradient is that of `slope`."""

        @jax.custom_vjp
        def value(q: Array) -> Array:
            return self.log_density(self.center + self.factor @ q)

        def both(q: Array) -> tuple[Array, Array]:
            total, gradient = self.slope(self.center + self.factor @ q)
            return total, self.factor.T @ gradient

        value.defvjp(both, lambda gradient, cotangent: (cotangent * gradient,))
        return value(q)


def _both(density: Density) -> Bool[Array, " d"]:
    """Which parameters have two bounds."""
    return jnp.asarray([kind == BOTH for kind in (*density.objective.coordinates.kinds, *density.noise.kinds)])
