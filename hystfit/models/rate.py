"""Forces of the input's rate: viscous and saturating damping, added to a hysteresis (dampers, friction)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.data.record import Record
from hystfit.models.base import AbstractHysteresis
from hystfit.models.c_code import CPart, template
from hystfit.models.parallel.associative import StateMap
from hystfit.models.shapes import Scalar, State
from hystfit.models.slopes import Slopes
from hystfit.params.param import param


class Viscous(AbstractHysteresis):
    """Linear damping:  y = c du/dt."""

    rate_independent: ClassVar[bool] = False
    state_map: ClassVar[StateMap] = StateMap.DIAGONAL

    c: Scalar = param(0.0, unit="y*s/u", linear=True, doc="damping coefficient")

    def init(self, u0: Scalar) -> State:
        """State: the last rate, kept over repeated time stamps."""
        return jnp.zeros((1,)) * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """Rate over the sample."""
        rate = _rate(state[0], u0, u1, dt)
        return rate[None], self.c * rate

    def start(self, records: Sequence[Record]) -> Viscous:
        """No damping; it follows from the fit."""
        return type(self)(c=0.0)

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes | None:
        """The force of a step that takes one sample."""
        return Slopes.of(float(self.c) / dt) if dt else None

    def c_part(self) -> CPart:
        """A difference quotient."""
        return CPart(template("rate.c"), 1, {"FORCE": self.c, "SATURATES": 0})


class SaturatingRate(AbstractHysteresis):
    """Damping that saturates:  y = F tanh((du/dt) / v0): the yield force of a magnetorheological damper, Coulomb friction."""

    rate_independent: ClassVar[bool] = False
    state_map: ClassVar[StateMap] = StateMap.DIAGONAL

    F: Scalar = param(0.1, unit="y", linear=True, doc="force far above v0")
    v0: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u/s", doc="rate at which the force bends")

    def init(self, u0: Scalar) -> State:
        """State: the last rate, kept over repeated time stamps."""
        return jnp.zeros((1,)) * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """Rate over the sample."""
        rate = _rate(state[0], u0, u1, dt)
        return rate[None], self.F * jnp.tanh(rate / self.v0)

    def start(self, records: Sequence[Record]) -> SaturatingRate:
        """A bend at a quarter of the typical rate."""
        rates = np.concatenate([np.abs(np.diff(r.u))[r.dt[1:] > 0] / r.dt[1:][r.dt[1:] > 0] for r in records])
        typical = float(np.sqrt(np.mean(rates**2))) if rates.size else 1.0
        return type(self)(F=0.0, v0=0.25 * typical or 1.0)

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes | None:
        """Steepest at rest, flat where the force is saturated."""
        return Slopes.of(float(self.F / self.v0) / dt, 0.0) if dt else None

    def c_part(self) -> CPart:
        """A difference quotient."""
        return CPart(template("rate.c"), 1, {"FORCE": self.F, "V0": self.v0, "SATURATES": 1})


def _rate(last: Array, u0: Array, u1: Array, dt: Array) -> Array:
    return jnp.where(dt > 0, (u1 - u0) / jnp.where(dt > 0, dt, 1.0), last)
