"""A straight line of either sign, to be added to a model in a `Sum`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from hystfit.data.record import Record
from hystfit.models.memoryless import AbstractMemoryless
from hystfit.models.shared.design import DesignMatrix
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.simulation import checked_drive
from hystfit.params.param import param


class Linear(AbstractMemoryless):
    """A response without memory, in proportion to the input:  y = k u.

    The sample holder or the paramagnetic part of a magnetic moment, the gas spring of a damper, the leakage of a capacitor.
    """

    c_template: ClassVar[str] = "linear"
    linear_in_input: ClassVar[bool] = True

    k: Scalar = param(0.0, unit="y/u", linear=True, doc="slope")

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        return state, self.k * u1

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        return float(self.k) * np.asarray(checked_drive(self, u, dt)[0])

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        return DesignMatrix.of(self, {"k": np.asarray(checked_drive(self, u, dt)[0])[:, None]})

    def start(self, records: Sequence[Record]) -> Linear:
        """No slope; it follows from the fit."""
        return type(self)(k=0.0)
