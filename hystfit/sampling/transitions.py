"""Transitions of the no-U-turn sampler (Hoffman and Gelman 2014) of blackjax, and the dual averaging of its step size."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from hystfit.errors import optional
from hystfit.params.host_arrays import compiled
from hystfit.sampling.target import Target

CHUNK = 50  # draws in one compiled call, and between two writes to disk
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
    target: Target, q: Array, tuning: Tuning, key: Array, adapting: Array, goal: Array, depth: int
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """One chunk: (positions and statistics of each draw, fields of `Tuning`); `adapting` is an array, so that one program does both."""
    out, tuning = advance(target, q, tuning, key, adapting, goal, depth, CHUNK)
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
) -> tuple[tuple[Array, ...], Tuning]:
    """`steps` transitions, for use inside traced code; `adapting` is one flag or one per transition.

    During adaptation the step size is the trial value of dual averaging, otherwise its average.

    The step size is tuned for the acceptance `goal`; trajectories double at most `depth` times.
    """
    nuts = optional("blackjax", "bayes", "sampling by NUTS").nuts
    kernel, mass = nuts.build_kernel(), jnp.ones_like(q)

    def once(carry: tuple[Any, Tuning], at: tuple[Array, Array]) -> tuple[Any, tuple[Array, ...]]:
        (state, tuning), (key, adapts) = carry, at
        size = jnp.exp(jnp.where(adapts, tuning.size, tuning.average))
        state, info = kernel(key, state, target, size, mass, max_num_doublings=depth)
        later = tuning.after(info.acceptance_rate, goal)
        tuning = jax.tree_util.tree_map(lambda a, b: jnp.where(adapts, a, b), later, tuning)
        out = (info.is_divergent, info.acceptance_rate, info.num_integration_steps)
        return (state, tuning), (state.position, state.logdensity, *out)

    ahead = (jax.random.split(key, steps), jnp.broadcast_to(adapting, (steps,)))
    (_, tuning), out = jax.lax.scan(once, (nuts.init(q, target), tuning), ahead)
    return out, tuning
