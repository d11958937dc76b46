"""The rate of an input over a sample."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array


def rate_over(u0: Array, u1: Array, dt: Array, last: Array) -> Array:
    """Rate from u0 to u1 [u/s]; the last one where no time passes, at a repeated time stamp or in padding."""
    return jnp.where(dt > 0, (u1 - u0) / jnp.where(dt > 0, dt, 1.0), last)
