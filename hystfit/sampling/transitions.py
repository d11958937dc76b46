"""Transitions of the no-U-turn sampler (Hoffman and Gelman 2014) of blackjax, and the dual averaging of its step size."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from hystfit.errors import optional
from hystfit.params.host_arrays import compiled
from hystfit.sampling.jumps import CHUNK, Offers
from hystfit.sampling.target import Target

_GAIN = 5.0  # of the step size's logarithm in the error of the acceptance


class Tuning(NamedTuple):
    """State of the dual averaging of the step size (Hoffman and Gelman 2014, section 3.2), logarithms.

    The first size is about right in whitened coordinates: trials need not start at ten times it, and their gain is a quarter of the
    usual one. They then scatter by 15 %, not 50 %, about the average, which has the acceptance that the trials have on average.
    """

    size: Array
    average: Array
    error: Array
    middle: Array
    m: Array

    @classmethod
    def about(cls, size: float) -> Tuning:
        """Before the first step."""
        log_size = jnp.log(jnp.asarray(size, float))
        return cls(log_size, log_size, jnp.zeros(()), log_size, jnp.ones(()))

    def after(self, acceptance: Array, goal: Array) -> Tuning:
        """One step later."""
        share = 1 / (self.m + 10.0)
        error = (1 - share) * self.error + share * (goal - acceptance)
        size = jnp.clip(self.middle - jnp.sqrt(self.m) * _GAIN * error, -12.0, 2.0)
        weight = self.m**-0.75
        return Tuning(size, weight * size + (1 - weight) * self.average, error, self.middle, self.m + 1)


@compiled
def advance_chunk(
    target: Target, q: Array, tuning: Tuning, key: Array, adapting: Array, goal: Array, depth: int, offers: Offers
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """One chunk: (positions and statistics of each draw, fields of `Tuning`); `adapting` is an array, so that one program does both."""
    out, tuning = advance(target, q, tuning, key, adapting, goal, depth, CHUNK, offers)
    return out, tuple(tuning)


def advance(
    target: Target,
    q: Array,
    tuning: Tuning,
    key: Array,
    adapting: Array,
    goal: Array,
    depth: int,
    steps: int,
    offers: Offers | None = None,
) -> tuple[tuple[Array, ...], Tuning]:
    """`steps` transitions, for use inside traced code; `adapting` is one flag or one per transition.

    During adaptation the step size is the trial value of dual averaging, otherwise its average.

    The step size is tuned for the acceptance `goal`; trajectories double at most `depth` times. Where `offers` say so, jumps take the
    place of a trajectory; their acceptance is NaN.
    """
    nuts = optional("blackjax", "bayes", "sampling by NUTS").nuts
    kernel, mass = nuts.build_kernel(), jnp.ones_like(q)

    def follow(key: Array, state: Any, size: Array, moved: Array) -> tuple[Any, tuple[Array, ...]]:
        begin = lambda state: nuts.init(state.position, target)  # a jump has no gradient
        state = jax.lax.cond(moved, begin, lambda state: state, state)
        state, info = kernel(key, state, target, size, mass, max_num_doublings=depth)
        return state, (info.is_divergent, info.acceptance_rate, info.num_integration_steps)

    def leap(key: Array, state: Any, offered: tuple[Array, ...]) -> tuple[Any, tuple[Array, ...]]:
        assert offers is not None
        position, density = offers.jumps.taken(key, state.position, state.logdensity, offered)
        state = state._replace(position=position, logdensity=density)
        return state, (jnp.asarray(False), jnp.asarray(jnp.nan), jnp.zeros((), int))

    def once(carry: tuple[Any, Tuning, Array], at: tuple[Array, ...]) -> tuple[Any, tuple[Array, ...]]:
        (state, tuning, moved), (key, adapts, on, *offered) = carry, at
        size = jnp.exp(jnp.where(adapts, tuning.size, tuning.average))
        trajectory = lambda: follow(key, state, size, moved)
        state, out = jax.lax.cond(on, lambda: leap(key, state, offered), trajectory) if offered else trajectory()
        later = tuning.after(out[1], goal)
        tuning = jax.tree_util.tree_map(lambda a, b: jnp.where(adapts, a, b), later, tuning)
        return (state, tuning, on), (state.position, state.logdensity, *out)

    offered = (jnp.zeros(steps, bool),) if offers is None else (offers.on, *offers.offered)
    ahead = (jax.random.split(key, steps), jnp.broadcast_to(adapting, (steps,)), *offered)
    state = nuts.init(q, lambda q: jnp.sum(q))  # the first transition replaces the density
    (_, tuning, _), out = jax.lax.scan(once, (state, tuning, jnp.asarray(True)), ahead)
    return out, tuning
