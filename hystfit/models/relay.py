"""A single non-ideal relay: two output levels, and two inputs at which the output jumps (thermostat, Schmitt trigger, reed switch)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.design import DesignMatrix
from hystfit.models.shared.reported import Derived
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.simulation import checked_drive
from hystfit.models.switching import Thresholds, relay_state, resting_on_first_state
from hystfit.params.param import param
from hystfit.quality.needs import Needs


class Relay(AbstractHysteresis):
    """Two levels:  y = high once u > up,  y = low once u < down,  and between both thresholds y stays as it is.

    The output is linear in the levels and piecewise constant in the thresholds: between the same two samples every threshold gives the
    same output. They are found by an exact search, and their standard errors come from the samples around the jumps. Where the first
    input lies between the thresholds, the state before a record is that of its first output, and without an output that of the nearer
    threshold. A record whose output falls as the input rises has high < low.

    Source: Mayergoyz (2003), Mathematical Models of Hysteresis and Their Applications, chapter 1.

    Raises:
        ModelError: up below down.
    """

    no_inverse: ClassVar[str] = (
        "a relay has no inverse: its output takes two levels, and no input leads to values between them"
    )
    rate_independent: ClassVar[bool] = True
    jumps: ClassVar[bool] = True
    c_template: ClassVar[str] = "relay"
    has_fast_run: ClassVar[bool] = True
    estimator: ClassVar[str] = "switching"
    either_way: ClassVar[bool] = True
    needs: ClassVar[Needs] = Needs()

    up: Scalar = param(0.5, unit="u", stepwise=True, doc="input above which the output jumps to the high level")
    down: Scalar = param(-0.5, unit="u", stepwise=True, doc="input below which the output jumps to the low level")
    low: Scalar = param(0.0, unit="y", linear=True, doc="output after the input fell below `down`")
    high: Scalar = param(1.0, unit="y", linear=True, doc="output after the input rose above `up`")

    def __check_init__(self) -> None:
        ends = self.up, self.down
        known = not any(isinstance(end, Tracer) or np.ndim(end) for end in ends) and all(
            hasattr(end, "shape") for end in ends
        )
        if known and float(self.up) < float(self.down):
            raise ModelError(f"up must not be below down, got up = {float(self.up):g}, down = {float(self.down):g}")

    def init(self, u0: Scalar) -> State:
        """State: 1 where the output is high, else 0; of the nearer threshold between both."""
        return jnp.reshape(jnp.where(u0 > 0.5 * (self.up + self.down), 1.0, 0.0), (1,))

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """Jump where the input is beyond a threshold."""
        s = jnp.where(u1 > self.up, 1.0, jnp.where(u1 < self.down, 0.0, state[0]))
        return s[None], jnp.where(s > 0.5, self.high, self.low)

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """Where the output is low, and where it is high."""
        high = relay_state(np.asarray(checked_drive(self, u, dt)[0]), float(self.up), float(self.down)).astype(float)
        return DesignMatrix.of(self, {"low": 1.0 - high[:, None], "high": high[:, None]})

    def prepared(self, record: Record) -> Record:
        """Behind one more sample that puts the relay into the state of the first output."""
        return resting_on_first_state(record)

    def start(self, records: Sequence[Record]) -> Relay:
        """Thresholds with the smallest sum of squared residuals; the levels are the means of the output at them."""
        found = Thresholds.of(records)
        return dataclasses.replace(self, up=found.up, down=found.down, low=found.low, high=found.high)

    def step_errors(self, records: Sequence[Record]) -> Relay:
        """Standard errors of the thresholds by the samples around the jumps; NaN for one that no jump determines."""
        fitted = Thresholds(*(float(value) for value in (self.up, self.down, self.low, self.high)))
        errors = tuple(map(jnp.asarray, fitted.errors(records)))
        return eqx.tree_at(lambda model: (model.up, model.down), super().step_errors(records), errors)

    def derived(self) -> tuple[Derived, ...]:
        """Half the distance of the thresholds."""
        half = lambda model: 0.5 * (model.up - model.down)
        return (Derived("half_width", "u", "half the distance of the thresholds", half),)
