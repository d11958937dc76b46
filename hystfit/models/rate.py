"""Outputs of the input's rate, added to a hysteresis: viscous and saturating damping (dampers, friction), excess loss (magnetics)."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.data.record import Record
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.sample_rate import rate_over
from hystfit.models.shared.shapes import Scalar, Signal, State
from hystfit.models.shared.simulation import checked_drive
from hystfit.models.shared.slopes import Slopes
from hystfit.models.shared.starting import speed, speeds
from hystfit.params.param import param


class _AbstractRate(AbstractHysteresis):
    """A force of the rate du/dt over the last sample."""

    rate_independent: ClassVar[bool] = False
    creeps: ClassVar[bool] = False
    takes_rate: ClassVar[bool] = True

    @abc.abstractmethod
    def force(self, rate: Any) -> Any:
        """Output at rates of the input [u/s], of any shape, in JAX or in NumPy."""

    def init(self, u0: Scalar) -> State:
        """State: the last rate, kept over repeated time stamps."""
        return jnp.zeros((1,)) * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """Rate over the sample."""
        rate = rate_over(u0, u1, dt, state[0])
        return rate[None], self.force(rate)

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """All rates at once, unless a time stamp is repeated within the record: padding repeats the last one."""
        passes = dt[1:] > 0
        count = jnp.sum(passes)

        def at_once() -> tuple[Array, Array]:
            before = jnp.concatenate([u0[None], u[:-1]])
            rates = rate_over(before, u, dt, state[0])
            rates = jnp.where(jnp.arange(u.shape[0]) > count, rates[count], rates)
            return rates[-1:], self.force(rates)

        ordered = jnp.all(passes == (jnp.arange(passes.shape[0]) < count))
        return jax.lax.cond(ordered, at_once, lambda: super(_AbstractRate, self).sweep(state, u0, u, dt))

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        """All rates at once on the host."""
        u, dt = (np.asarray(v) for v in checked_drive(self, u, dt))
        passes = dt > 0
        rates = np.diff(u, prepend=u[0]) / np.where(passes, dt, 1.0)
        last = np.maximum.accumulate(np.where(passes, np.arange(u.size), 0))
        return jax.tree.map(np.asarray, self).force(rates[last])


class Viscous(_AbstractRate):
    """Linear damping:  y = c du/dt."""

    hysteretic: ClassVar[bool] = False

    c: Scalar = param(0.0, unit="y*s/u", linear=True, doc="damping coefficient")

    def force(self, rate: Any) -> Any:
        """Proportional to the rate."""
        return self.c * rate

    def start(self, records: Sequence[Record]) -> Viscous:
        """No damping; it follows from the fit."""
        return type(self)(c=0.0)

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes | None:
        """The force of a step that takes one sample."""
        return Slopes.of(float(self.c) / dt) if dt else None

    def c_part(self) -> CPart:
        return CPart.of(self, "rate", force=self.c, saturates=0)


class SaturatingRate(_AbstractRate):
    """Damping that saturates:  y = F tanh((du/dt) / v0): the yield force of a magnetorheological damper, Coulomb friction."""

    F: Scalar = param(0.1, unit="y", linear=True, doc="force far above v0")
    v0: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u/s", doc="rate at which the force bends")

    def force(self, rate: Any) -> Any:
        """Bends at v0."""
        return self.F * rate.__array_namespace__().tanh(rate / self.v0)

    def start(self, records: Sequence[Record]) -> SaturatingRate:
        """A bend at a quarter of the typical rate."""
        rates = np.concatenate([speeds(record) for record in records])
        typical = float(np.sqrt(np.mean(rates**2))) if rates.size else 1.0
        return type(self)(F=0.0, v0=0.25 * typical or 1.0)

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes | None:
        """Steepest at rest, flat where the force is saturated."""
        return Slopes.of(float(self.F / self.v0) / dt, 0.0) if dt else None

    def c_part(self) -> CPart:
        return CPart.of(self, "rate", force=self.F, saturates=1)


class Excess(_AbstractRate):
    """Excess loss:  y = g v / (v^2 + e^2)^(1/4), the root of the rate v = du/dt with its sign (Bertotti 1988).

    Over a flux density u the output is a field, and g is the root of sigma G V0 S, with conductivity sigma, G = 0.1356, V0 the field of
    the statistics of walls and S the section. The classical eddy field is that of `Viscous`, with c = sigma d^2 / 12 of a sheet of
    thickness d.
    """

    g: Scalar = param(
        0.0, bounds=(0.0, np.inf), unit="y*s^0.5/u^0.5", linear=True, doc="output over the root of the rate"
    )
    e: Scalar = param(1e-6, bounds=(0.0, np.inf), unit="u/s", fixed=True, doc="rate below which the root is rounded")

    def force(self, rate: Any) -> Any:
        """The root of the rate, without the infinite slope at zero."""
        return self.g * rate / (rate**2 + self.e**2) ** 0.25

    def start(self, records: Sequence[Record]) -> Excess:
        """None; it follows from the fit. The root is rounded at a thousandth of the largest rate."""
        return type(self)(g=0.0, e=1e-3 * speed(records, 1.0))

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes | None:
        """Steepest at rest, falling towards none."""
        return Slopes.of(float(self.g / self.e**0.5) / dt, 0.0) if dt else None

    def c_part(self) -> CPart:
        return CPart.of(self, "rate", force=self.g, v0=self.e, saturates=2)
