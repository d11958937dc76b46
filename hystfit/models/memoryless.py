"""The base of models without memory: a line, a constant, a sign and a curve."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp

from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.shapes import Scalar, State


class AbstractMemoryless(AbstractHysteresis):
    """A response that depends on the present input alone: it has no state, and no loop."""

    rate_independent: ClassVar[bool] = True
    hysteretic: ClassVar[bool] = False

    def init(self, u0: Scalar) -> State:
        return jnp.zeros((0,), dtype=jnp.result_type(float))
