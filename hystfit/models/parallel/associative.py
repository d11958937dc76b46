"""Whole records at once: maps from one state to the next that compose into maps of the same kind, by associative scans.

A play clamps its state, a relaxation or a Duhem branch moves it by an affine map. Both follow from the model's own step: a clamp from
the states that infinite states go to, an affine map from the step at zero and its derivative.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hystfit.models.shapes import Scalar, Signal, State

Step = Callable[[Array, Array, Array, Array], tuple[Array, Array]]


class StateMap(enum.Enum):
    """What a step does to the state of a model, for any input."""

    CLAMP = "clamp"  # each number is shifted, then clamped to an interval:  x -> min(max(x + shift, low), high)
    DIAGONAL = "diagonal"  # each number goes through an affine map of its own
    AFFINE = "affine"  # an affine map of all numbers


def sweep_at_once(step: Step, kind: StateMap, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
    """State after the last sample and outputs, as those of a scan of the step."""
    rows = (jnp.concatenate([u0[None], u[:-1]]), u, dt)
    moved = lambda state, row: step(state, *row)[0]
    if kind is StateMap.CLAMP:
        states = clamp_scan(*jax.vmap(lambda row: _clamp(lambda s: moved(s, row), state))(rows), state)
    else:
        parts = jax.vmap(lambda row: _affine(lambda s: moved(s, row), state, kind))(rows)
        states = affine_scan(*parts, state)
    before = jnp.concatenate([state[None], states[:-1]])
    return states[-1], jax.vmap(lambda s, row: step(s, *row)[1])(before, rows)


def _clamp(moved: Callable[[Array], Array], like: Array) -> tuple[Array, Array, Array]:
    """Shift, lower and upper end of the step's interval; no shift where the interval is finite, whose ends contain it."""
    low, high = moved(jnp.full_like(like, -jnp.inf)), moved(jnp.full_like(like, jnp.inf))
    free = jnp.isinf(low) & jnp.isinf(high)
    return jnp.where(free, moved(jnp.zeros_like(like)), 0.0), low, high


def _affine(moved: Callable[[Array], Array], like: Array, kind: StateMap) -> tuple[Array, Array]:
    """Factor, shape (n,) or (n, n), and push of the step's affine map."""
    zero = jnp.zeros_like(like)
    if kind is StateMap.DIAGONAL:
        push, factor = jax.jvp(moved, (zero,), (jnp.ones_like(like),))
        return factor, push
    return jax.jacfwd(moved)(zero), moved(zero)


def _composed(join: Callable[[Any, Any], Any], maps: Any, identity: Any) -> Any:
    """The composition of each map with all before it, by doubling: log2(T) passes of one compiled loop.

    `jax.lax.associative_scan` does half the work, but its program grows with T: its compilation takes ten times as long.

    `join` composes a map and a later one; the maps are arrays of leading length T, and `identity` changes nothing.
    """
    length = jax.tree_util.tree_leaves(maps)[0].shape[0]
    before = jax.tree_util.tree_map(lambda v, one: jnp.broadcast_to(jnp.asarray(one, v.dtype), v.shape), maps, identity)

    def once(k: Array, maps: Any) -> Any:
        behind = lambda head, v: jax.lax.dynamic_slice_in_dim(jnp.concatenate([head, v]), length - 2**k, length)
        return join(jax.tree_util.tree_map(behind, before, maps), maps)

    return jax.lax.fori_loop(0, max(length - 1, 0).bit_length(), once, maps)


def clamp_scan(
    shift: Float[Array, "T n"], low: Float[Array, "T n"], high: Float[Array, "T n"], start: Float[Array, " n"]
) -> Float[Array, "T n"]:
    """x_k = min(max(x_(k-1) + shift_k, low_k), high_k) for all k."""
    clamp = lambda x, low, high: jnp.maximum(low, jnp.minimum(high, x))

    def join(first: Any, second: Any) -> Any:
        (s1, low1, high1), (s2, low2, high2) = first, second
        return s1 + s2, clamp(low1 + s2, low2, high2), clamp(high1 + s2, low2, high2)

    total, low, high = _composed(join, (shift, low, high), (0.0, -jnp.inf, jnp.inf))
    return clamp(start + total, low, high)


def affine_scan(
    factor: Float[Array, "T n"] | Float[Array, "T n n"], push: Float[Array, "T n"], start: Float[Array, " n"]
) -> Float[Array, "T n"]:
    """x_k = factor_k x_(k-1) + push_k for all k."""
    matrices = factor.ndim > push.ndim
    times = (lambda a, b: jnp.einsum("...ij,...j->...i", a, b)) if matrices else jnp.multiply
    both = jnp.matmul if matrices else jnp.multiply

    def join(first: Any, second: Any) -> Any:
        (a1, b1), (a2, b2) = first, second
        return both(a2, a1), times(a2, b1) + b2

    factor, push = _composed(join, (factor, push), (jnp.eye(push.shape[1]) if matrices else 1.0, 0.0))
    return times(factor, jnp.broadcast_to(start, push.shape)) + push


def ratio_scan(maps: Float[Array, "T 2 2"], start: Scalar) -> Signal:
    """x_k = (a_k x_(k-1) + b_k) / (c_k x_(k-1) + d_k) for all k: the variance of a Kalman filter with one state.

    `maps` holds [[a, b], [c, d]] >= 0 of each sample, and x starts >= 0.
    """

    def join(first: Array, second: Array) -> Array:
        product = jnp.matmul(second, first)
        return product / jnp.max(product, axis=(1, 2), keepdims=True)  # a common factor cancels, and must not overflow

    (a, b), (c, d) = jnp.moveaxis(_composed(join, maps, jnp.eye(2)), 0, -1)
    return (a * start + b) / (c * start + d)
