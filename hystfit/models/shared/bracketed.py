"""A bracketed root search for rising functions, safe where they are flat, kinked or not rising at all."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from hystfit.models.shared.shapes import Scalar


class Root(NamedTuple):
    """Result of a bracketed search: where the function came nearest to zero, and whether no slope met on the way fell."""

    x: Scalar
    rising: Bool[Array, ""]


class _Search(NamedTuple):
    low: Array
    high: Array
    ends: Array  # whether the function is known at low, at high
    x: Array
    moved: Array  # length of the way to x
    best: Array
    least: Array
    rising: Array
    trials: Array
    done: Array


def solve_rising(function: Callable[[Scalar], Scalar], start: Scalar, low: Scalar, high: Scalar) -> Root:
    """Root of a rising function by Newton steps from `start`, held in a finite bracket and halved where they fail.

    The side of `start` on which the root lies is searched alone: the first trial is a small step into it, because a hysteresis has another
    slope on each side of its last input. Where no root lies there the end of the bracket, or the nearest miss, is returned. The slope is
    taken by forward differentiation; halving needs none.
    """
    at_start = function(start)
    up = at_start < 0
    side = jnp.where(up, 1.0, -1.0)
    small = 1e-7 * (high - low)
    eps = jnp.finfo(at_start.dtype).eps
    trial = jnp.clip(start + side * small, low, high)
    search = _Search(
        low=jnp.where(up, start, low),
        high=jnp.where(up, high, start),
        ends=jnp.stack([up, ~up]),
        x=trial,
        moved=jnp.abs(trial - start),
        best=start,
        least=jnp.abs(at_start),
        rising=jnp.asarray(True),
        trials=jnp.asarray(0),
        done=(at_start == 0) | (trial == start) | ~jnp.isfinite(at_start),
    )

    def body(s: _Search) -> _Search:
        value, slope = jax.jvp(function, (s.x,), (jnp.ones_like(s.x),))
        below = value < 0
        low, high = jnp.where(below, s.x, s.low), jnp.where(below, s.high, s.x)
        ends = jnp.stack([s.ends[0] | below, s.ends[1] | ~below])
        newton = s.x - value / jnp.where(slope > 0, slope, 1.0)
        settled = (slope > 0) & (jnp.abs(newton - s.x) <= 2 * eps * jnp.abs(s.x))
        held = jnp.clip(newton, low, high)
        # An end of known value is not tried again, and at most five Newton steps follow each other unless they become short.
        refused = (
            ~(slope > 0)
            | ((held == low) & ends[0])
            | ((held == high) & ends[1])
            | ((s.trials % 6 == 5) & (jnp.abs(newton - s.x) > 0.5 * s.moved))
            | ~jnp.isfinite(newton)
        )
        middle = 0.5 * (low + high)
        trial = jnp.where(refused, middle, held)
        narrow = high - low <= 2 * eps * jnp.maximum(jnp.abs(low), jnp.abs(high))
        better = jnp.abs(value) < s.least
        return _Search(
            low,
            high,
            ends,
            trial,
            jnp.abs(trial - s.x),
            jnp.where(better, s.x, s.best),
            jnp.where(better, jnp.abs(value), s.least),
            s.rising & ~(slope < 0),
            s.trials + 1,
            settled | narrow | (value == 0) | ((trial == s.x) & ~refused),
        )

    found = jax.lax.while_loop(lambda s: ~s.done & (s.trials < 100), body, search)
    return Root(found.best, found.rising)


def implicit_root(
    function: Callable[[Scalar], Scalar], start: Scalar, low: Scalar, high: Scalar, *, least: float
) -> Scalar:
    """`solve_rising`, differentiable by the implicit function theorem; a slope below `least` is that of a jump."""
    search = lambda function, start: solve_rising(function, start, low, high).x
    divided = lambda slope, y: y / jnp.maximum(slope(jnp.ones_like(y)), least)
    return jax.lax.custom_root(function, start, search, divided)
