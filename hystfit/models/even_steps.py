"""Factors of a step that depend on the time step alone: computed once where the sampling is even, else for every sample."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hystfit.models.shapes import Scalar, Signal

_ROUNDING = 4.0  # spread of the time steps of an even clock, in units in the last place of the last time stamp

_BLOCK = 32  # samples whose factors are in memory at a time; padded records are whole numbers of blocks


def even_step(dt: Signal) -> tuple[Bool[Array, ""], Scalar]:
    """Whether all time steps but those of 0 are equal up to the rounding of time stamps, and the largest.

    Steps of 0 are allowed: records are padded with them.
    """
    longest = jnp.max(dt)
    rounding = _ROUNDING * jnp.finfo(dt.dtype).eps * jnp.sum(dt)
    return jnp.all((dt == 0.0) | (jnp.abs(dt - longest) <= rounding)), longest


def scan_in_time(
    body: Callable[[Any, Any, Any], tuple[Any, Any]],
    carry: Any,
    samples: Any,
    factors: Callable[[Array], Any],
    dt: Signal,
) -> tuple[Any, Any]:
    """`jax.lax.scan` of a body whose third argument depends on the time step alone.

    Args:
        body: (carry, row of samples, factors) -> (carry, output).
        carry: before the first sample.
        samples: arrays of leading length T.
        factors: of a time step.
        dt: time since the sample before, shape (T,) [s].
    """
    even, longest = even_step(jax.lax.stop_gradient(dt))

    def steady() -> tuple[Any, Any]:
        moving, resting = factors(longest), factors(jnp.zeros_like(longest))

        def once(carry: Any, row: Any) -> tuple[Any, Any]:
            sample, moves = row
            chosen = jax.tree_util.tree_map(lambda a, b: jnp.where(moves, a, b), moving, resting)
            return body(carry, sample, chosen)

        return jax.lax.scan(once, carry, (samples, dt > 0.0))

    def varying() -> tuple[Any, Any]:
        once = lambda carry, row: body(carry, *row)
        rows = lambda carry, part: jax.lax.scan(once, carry, (part[0], jax.vmap(factors)(part[1])))
        blocks = dt.shape[0] // _BLOCK
        cut = lambda v: (v[: blocks * _BLOCK].reshape(blocks, _BLOCK, *v.shape[1:]), v[blocks * _BLOCK :])
        whole, rest = (jax.tree_util.tree_map(lambda v, k=k: cut(v)[k], (samples, dt)) for k in (0, 1))
        after, y = jax.lax.scan(rows, carry, whole)
        y = jax.tree_util.tree_map(lambda v: v.reshape(-1, *v.shape[2:]), y)
        if rest[1].shape[0] == 0:
            return after, y
        after, tail = rows(after, rest)
        return after, jax.tree_util.tree_map(lambda a, b: jnp.concatenate([a, b]), y, tail)

    return jax.lax.cond(even, steady, varying)


def relaxed(
    state: Float[Array, " modes"],
    tau: Float[Array, " modes"],
    gain: Float[Array, "..."] | float,
    weight: Float[Array, "..."] | float,
    x: Signal,
    dt: Signal,
) -> tuple[Float[Array, " modes"], Signal]:
    """Relaxations tau dz/dt = gain x - z, exact for steps of x: the last state, and their weighted sum at each sample.

    Args:
        state: before the first sample.
        tau: time constants [s].
        gain: of each relaxation, or one for all.
        weight: of each relaxation in the sum, or one for all.
        x: input.
        dt: time since the sample before [s].
    """

    def body(state: Array, x: Array, part: Array) -> tuple[Array, Array]:
        state = state + part * (gain * x - state)
        return state, jnp.sum(weight * state)

    return scan_in_time(body, state, x, lambda dt: -jnp.expm1(-dt / tau), dt)
