"""One-sample inverses of models: the interface, a search that suits any model, and the closed form of affine outputs."""

from __future__ import annotations

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from hystfit.models.shared.bracketed import Root, solve_rising
from hystfit.models.shared.shapes import Scalar, State

# Of models whose output does not depend on the input of the same sample.
COMES_LATER = (
    "{name} cannot be inverted sample by sample, because its response comes later: leave it out and shift or lead the reference "
    "(hystfit.control.lead)"
)


class AbstractStepInverse(eqx.Module):
    """Solves `model.step(state, u0, u1, dt)[1] == target` for u1."""

    model: eqx.AbstractVar[Any]

    @property
    @abc.abstractmethod
    def needs_limits(self) -> bool:
        """A search needs an interval to search in; a closed form needs none."""

    @abc.abstractmethod
    def solve(self, state: State, u0: Scalar, target: Scalar, dt: Scalar, low: Scalar, high: Scalar) -> Root:
        """The input that a time dt [s] after u0 gives the target, maybe outside the limits; and whether the output rises on the way."""

    # Optional, as those of a model:

    @property
    def sign(self) -> float:
        """-1 where the inverse assumes an output that falls with the input."""
        return 1.0

    def advance(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """The model's step; override it where the inverse holds tables that make it faster."""
        return self.model.step(state, u0, u1, dt)


class SearchStep(AbstractStepInverse):
    """Bracketed search on the model's own step, for every model whose output rises with its input, or falls (sign -1)."""

    model: Any
    sign: float = eqx.field(static=True, default=1.0)
    needs_limits: ClassVar[bool] = True

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        miss = lambda u1: self.sign * (self.model.step(state, u0, u1, dt)[1] - target)
        return solve_rising(miss, jnp.clip(u0, low, high), low, high)


class LinearStep(AbstractStepInverse):
    """Inverse of a model whose output is affine in the new input (`Lag`, `Relaxation`): a derivative gives its gain."""

    model: Any
    needs_limits: ClassVar[bool] = False

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        value, gain = jax.jvp(lambda u: self.model.step(state, u0, u, dt)[1], (u0,), (jnp.ones_like(u0),))
        return Root(u0 + (target - value) / jnp.where(gain > 0, gain, jnp.inf), gain > 0)
