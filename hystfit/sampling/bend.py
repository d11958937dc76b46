"""Coordinates for sampling between two bounds: linear inside, bent only near the bounds.

A logistic coordinate z squeezes a wide posterior next to a bound into a long tail that linear whitening does not fit: chains stay
there, or do not get there. In v, with t = v / 4 + 1/2,

    (x - lower) / (upper - lower) = g(t) = e [softplus(t / e) - softplus((t - 1) / e)],

x is linear in v within about 3 e of the bounds and an exponential beyond; e -> infinity is the logistic map. Value and slope agree
with those of z in the middle.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

BEND = 0.05  # e, as a part of the interval


def unbent(v: Float[Array, "... d"], both: Bool[Array, " d"]) -> Float[Array, "... d"]:
    """The unconstrained coordinates z of `hystfit.params.coordinates` from v; equal where there are not two bounds.

    Args:
        v: coordinates for sampling.
        both: which elements have two bounds.
    """
    t = jnp.where(both, v, 0.0) / 4 + 0.5
    near = jnp.minimum(t, 1 - t)  # from the nearer bound, so that small parts keep their digits
    part = BEND * (jax.nn.softplus(near / BEND) - jax.nn.softplus((near - 1) / BEND))
    z = jnp.log(part) - jnp.log1p(-part)
    return jnp.where(both, jnp.where(t < 0.5, z, -z), v)


def bent(z: Float[Array, "... d"], both: Bool[Array, " d"]) -> Float[Array, "... d"]:
    """v from z, the inverse of `unbent`.

    Args:
        z: unconstrained coordinates.
        both: which elements have two bounds.
    """
    part = jax.nn.sigmoid(-jnp.abs(z))
    near = BEND * (jnp.log(jnp.expm1(part / BEND)) - jnp.log1p(-jnp.exp((part - 1) / BEND)))
    return jnp.where(both, jnp.where(z < 0, 1, -1) * (4 * near - 2), z)


def log_slope(v: Float[Array, " d"], both: Bool[Array, " d"]) -> Float[Array, ""]:
    """log |det dz/dv|.

    Args:
        v: coordinates for sampling.
        both: which elements have two bounds.
    """
    t = jnp.where(both, v, 0.0) / 4 + 0.5
    near = jnp.minimum(t, 1 - t)
    part = BEND * (jax.nn.softplus(near / BEND) - jax.nn.softplus((near - 1) / BEND))
    by_part = (
        jax.nn.log_sigmoid(near / BEND) + jax.nn.log_sigmoid((1 - near) / BEND) + jnp.log(-jnp.expm1(-1 / BEND) / 4)
    )
    return jnp.sum(jnp.where(both, by_part - jnp.log(part) - jnp.log1p(-part), 0.0))
