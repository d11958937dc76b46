"""Factors of a step that depend on the time step alone: computed once where the sampling is even, else for every sample."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.models.shared.sample_scan import scan_samples
from hystfit.models.shared.shapes import Signal

_ROUNDING = 4.0  # spread of the time steps of an even clock, in units in the last place of the last time stamp

_BLOCK = 32  # samples whose factors are in memory at a time; padded records are whole numbers of blocks


def even_step(dt: Any, xp: Any = jnp) -> tuple[Any, Any]:
    """Whether all time steps but those of 0 are equal up to the rounding of time stamps, and the largest.

    Steps of 0 are allowed: records are padded with them.
    """
    longest = xp.max(dt)
    rounding = _ROUNDING * xp.finfo(dt.dtype).eps * xp.sum(dt)
    return xp.all((dt == 0.0) | (xp.abs(dt - longest) <= rounding)), longest


class Clock(NamedTuple):
    """Even time steps on the host, where a recursion needs no program; steps of 0 have not `moved`."""

    interval: float
    moved: np.ndarray

    @classmethod
    def of(cls, dt: np.ndarray) -> Clock | None:
        """None of uneven steps, or where all are 0."""
        even, longest = even_step(dt, np)
        return cls(float(longest), dt > 0.0) if even and longest > 0.0 else None

    def rows(self, rest: float, x: np.ndarray) -> np.ndarray:
        """The input before the first sample and after each step, shape (steps + 1,)."""
        return np.append(rest, x[self.moved])

    def samples(self, rows: np.ndarray) -> np.ndarray:
        """What belongs to each sample, shape (T, ...), of rows as by `rows`."""
        return rows[np.cumsum(self.moved)]


def scan_in_time(
    body: Callable[[Any, Any, Any], tuple[Any, Any]],
    carry: Any,
    samples: Any,
    factors: Callable[[Array], Any],
    dt: Signal,
    unroll: int = 1,
) -> tuple[Any, Any]:
    """`jax.lax.scan` of a body whose third argument depends on the time step alone.

    The body takes (carry, row of samples, factors) to (carry, output); `factors` makes them from a time step; dt has shape (T,) [s]. One
    pass of the loop takes `unroll` samples of even steps. Two pass a third faster where the carry is two numbers, and their derivatives no
    slower; four make a Jacobian half as fast, and arrays in the carry gain nothing.
    """
    even, longest = even_step(jax.lax.stop_gradient(dt))

    def steady() -> tuple[Any, Any]:
        moving, resting = factors(longest), factors(jnp.zeros_like(longest))

        def once(carry: Any, row: Any) -> tuple[Any, Any]:
            sample, moves = row
            chosen = jax.tree_util.tree_map(lambda a, b: jnp.where(moves, a, b), moving, resting)
            return body(carry, sample, chosen)

        return scan_samples(once, carry, (samples, dt > 0.0), unroll=unroll)

    def varying() -> tuple[Any, Any]:
        once = lambda carry, row: body(carry, *row)
        rows = lambda carry, part: jax.lax.scan(once, carry, (part[0], jax.vmap(factors)(part[1])))
        blocks = dt.shape[0] // _BLOCK
        cut = lambda v: (v[: blocks * _BLOCK].reshape(blocks, _BLOCK, *v.shape[1:]), v[blocks * _BLOCK :])
        whole, rest = (jax.tree_util.tree_map(lambda v, k=k: cut(v)[k], (samples, dt)) for k in (0, 1))
        after, y = scan_samples(rows, carry, whole, samples_per_row=_BLOCK)
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
    """Relaxations tau dz/dt = gain x - z, exact for steps of x, times in s: the last state, and their weighted sum at each sample."""

    def body(state: Array, x: Array, part: Array) -> tuple[Array, Array]:
        state = state + part * (gain * x - state)
        return state, jnp.sum(weight * state)

    return scan_in_time(body, state, x, lambda dt: -jnp.expm1(-dt / tau), dt)
