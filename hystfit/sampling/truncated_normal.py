"""Exact Hamiltonian Monte Carlo for a normal density with some coordinates >= 0 (Pakman and Paninski 2014, J. Comput. Graph. Stat. 23).

With the precision as mass matrix the motion is x(t) = mean + (x - mean) cos t + v sin t in every coordinate: no step size, no rejection.
Where a coordinate reaches zero the velocity is reflected in the metric of the precision, v - 2 (v_i / C_ii) C[:, i], C the covariance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hystfit.models.shared.shapes import Scalar

_TIME = 0.5 * math.pi  # after which the motion without bounds has forgotten its start


class _Flight(NamedTuple):
    """A trajectory on its way: position, velocity and the time that is left."""

    x: Float[Array, " p"]
    v: Float[Array, " p"]
    left: Scalar


def draw_truncated(
    key: Array,
    x: Float[Array, " p"],
    slope: Float[Array, " p"],
    precision: Float[Array, "p p"],
    bounded: Bool[Array, " p"],
    moves: int = 1,
) -> Float[Array, "moves p"]:
    """Ends of transitions that leave exp(-x'P x / 2 + s'x) on x >= 0 (where `bounded`) as it is; the precision P is positive definite.

    All moves share the factorization, which takes three times as long as one of them.
    """
    factor = jnp.linalg.cholesky(precision)
    covariance = jax.scipy.linalg.cho_solve((factor, True), jnp.eye(x.size))
    mean = covariance @ slope

    def onward(flight: _Flight) -> _Flight:
        x, v, left = flight
        tangent = jnp.where(bounded, _half_tangent(x, v, mean), jnp.inf)
        i = jnp.argmin(tangent)
        hit = 2 * jnp.arctan(tangent[i])
        time, reflected = jnp.minimum(hit, left), hit < left
        along, across = jnp.cos(time), jnp.sin(time)
        x, v = mean + (x - mean) * along + v * across, v * along - (x - mean) * across
        v = v - jnp.where(reflected, 2 * v[i] / covariance[i, i], 0.0) * covariance[i]
        x = jnp.where(bounded, jnp.maximum(x, 0.0), x)
        return _Flight(x.at[i].set(jnp.where(reflected, 0.0, x[i])), v, left - time)

    def move(x: Array, key: Array) -> tuple[Array, Array]:
        velocity = jax.scipy.linalg.solve_triangular(factor, jax.random.normal(key, x.shape), lower=True, trans=1)
        start = _Flight(x, velocity, jnp.asarray(_TIME))
        x = jax.lax.while_loop(lambda flight: flight.left > 0, onward, start).x
        return x, x

    return jax.lax.scan(move, x, jax.random.split(key, moves))[1]


def _half_tangent(x: Float[Array, " p"], v: Float[Array, " p"], mean: Float[Array, " p"]) -> Float[Array, " p"]:
    """tan(t / 2) of the first time t > 0 at which each coordinate is zero; infinite where it never is.

    It is the smallest positive root of (2 mean - x) s^2 + 2 v s + x = 0, in the form without cancellation; at x = 0 the coordinate has
    just been reflected, v > 0, and the root s = 0 does not count.
    """
    bend = 2 * mean - x
    inside = v * v - bend * x
    root = jnp.sqrt(jnp.maximum(inside, 0.0))
    falling = jnp.where(inside > 0, x / jnp.where(v < 0, root - v, 1.0), jnp.inf)
    rising = jnp.where(bend < 0, (v + root) / jnp.where(bend < 0, -bend, 1.0), jnp.inf)
    return jnp.where(v < 0, falling, rising)
