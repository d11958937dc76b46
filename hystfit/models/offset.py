"""A constant, to be added to a model in a `Sum`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.models.base import (
    AbstractHysteresis,
)
from hystfit.models.c_code import CPart, template
from hystfit.models.parallel.associative import StateMap
from hystfit.params.param import param


class Offset(AbstractHysteresis):
    """A constant of its own for each record:  y = value."""

    rate_independent: ClassVar[bool] = True
    state_map: ClassVar[StateMap] = StateMap.DIAGONAL

    value: Float[Array, ""] = param(0.0, unit="y", per_record=True, linear=True, doc="constant added to the output")

    def init(self, u0: Float[Array, ""]) -> Float[Array, " state"]:
        """No state."""
        return jnp.zeros((0,), dtype=jnp.result_type(float))

    def step(
        self, state: Float[Array, " state"], u0: Float[Array, ""], u1: Float[Array, ""], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""]]:
        """The constant."""
        return state, self.value + 0.0 * u1

    def start(self, records: Sequence[Record]) -> Offset:
        """Mean of the output."""
        return type(self)(value=float(np.mean([np.mean(record.y[record.used]) for record in records])))

    def c_part(self) -> CPart:
        """A number."""
        return CPart(template("offset.c"), 0, {"VALUE": self.value})
