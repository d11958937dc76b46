"""A constant, to be added to a model in a `Sum`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hystfit.data.record import Record
from hystfit.models.memoryless import AbstractMemoryless
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.slopes import Slopes
from hystfit.params.param import param


class Offset(AbstractMemoryless):
    """A separate constant for each record:  y = value."""

    c_template: ClassVar[str] = "offset"

    value: Scalar = param(0.0, unit="y", per_record=True, linear=True, doc="constant added to the output")

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        return state, self.value + 0.0 * u1

    def start(self, records: Sequence[Record]) -> Offset:
        """Mean of the output."""
        return type(self)(value=float(np.mean([np.mean(record.y[record.used]) for record in records])))

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes:
        """None."""
        return Slopes(0.0, 0.0)
