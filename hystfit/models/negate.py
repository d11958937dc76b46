"""The input with the opposite sign, before a model of rising loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from hystfit.data.record import Record
from hystfit.models.memoryless import AbstractMemoryless
from hystfit.models.shared.bracketed import Root
from hystfit.models.shared.shapes import Scalar, Signal, State
from hystfit.models.shared.step_inverse import AbstractStepInverse


class Negate(AbstractMemoryless):
    """The input with the opposite sign:  x = -u.  Before a hysteresis, for outputs that fall as the input rises."""

    c_template: ClassVar[str] = "negate"
    linear_in_input: ClassVar[bool] = True

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        return state, -u1

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        return state, -u

    def start(self, records: Sequence[Record]) -> Negate:
        return self

    def inputs_between(self, low: float, high: float) -> tuple[float, float]:
        return -high, -low

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        return NegateStep(self)


class NegateStep(AbstractStepInverse):
    """Inverse of `Negate`."""

    model: Negate
    needs_limits: ClassVar[bool] = False
    sign: ClassVar[float] = -1.0

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        return Root(-target, jnp.asarray(True))
