"""The exact inverse of a Prandtl-Ishlinskii model, sample by sample."""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from hystfit.models.bracketed import Root
from hystfit.models.step_inverse import AbstractStepInverse


class PlayStep(AbstractStepInverse):
    """Exact inverse of `PrandtlIshlinskii` with one identity envelope and a straight single-valued part.

    A way d from the last input moves the plays whose dead band t_j it has passed: b d + sum of w_j max(0, d - t_j) is
    piecewise linear and rising, and the active plays follow from its values at the t_j. Stops give min(d, t_j) instead.
    """

    model: Any  # PrandtlIshlinskii, whose module imports this one
    needs_limits: ClassVar[bool] = False

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        """See the base class."""
        pi = self.model
        w, x0 = pi.w[0], (u0 - pi.low) / (pi.high - pi.low)
        steepness = 2.0 * jnp.sum(pi.b) + jnp.sum(pi.rise)
        now = pi.step(state, u0, u0, dt)[1]
        s, way = jnp.where(target < now, -1.0, 1.0), jnp.abs(target - now)
        dead = jnp.maximum(s * (state - x0) + pi.r, 0.0)
        reached = dead[:, None] - dead[None, :]  # way at the start of play k less the dead band of play j
        if pi.operator == "play":
            gains = steepness * dead + jnp.maximum(reached, 0.0) @ w
            active = gains < way
            slope, shift = steepness + jnp.sum(jnp.where(active, w, 0.0)), jnp.sum(jnp.where(active, w * dead, 0.0))
        else:
            gains = steepness * dead + jnp.minimum(dead[:, None], dead[None, :]) @ w
            active = gains < way
            slope, shift = steepness + jnp.sum(jnp.where(active, 0.0, w)), -jnp.sum(jnp.where(active, w * dead, 0.0))
        d = jnp.where(slope > 0, (way + shift) / jnp.where(slope > 0, slope, 1.0), jnp.where(way > 0, jnp.inf, 0.0))
        return Root(pi.low + (x0 + s * d) * (pi.high - pi.low), slope >= 0)
