"""Relaxation: a displacement that follows its static value in part at once, in part slowly."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.models.base import AbstractHysteresis, check_same_length
from hystfit.models.shared.even_steps import relaxed
from hystfit.models.shared.shapes import Scalar, Signal, State
from hystfit.models.shared.simulation import checked_drive
from hystfit.models.shared.starting import sampling_interval
from hystfit.models.shared.step_inverse import AbstractStepInverse, LinearStep
from hystfit.params.param import param
from hystfit.quality.host_operators import recursion


class Relaxation(AbstractHysteresis):
    """Viscoelastic relaxation with static gain one:  y = x - sum of a_i (x - z_i),  tau_i dz_i/dt = x - z_i.

    A step of x shows the part 1 - sum of a_i at once, the rest with the time constants tau_i: loops grow, and lag, with
    frequency. Comes after a hysteresis in a `Series`; a curved piezo actuator needs it from 0.1 Hz on.

    Raises:
        ModelError: a weight without a time constant.
    """

    rate_independent: ClassVar[bool] = False
    c_template: ClassVar[str] = "relaxation"
    one_scan: ClassVar[bool] = False
    allows_thinning: ClassVar[bool] = True
    linear_in_input: ClassVar[bool] = True
    hysteretic: ClassVar[bool] = False

    a: Float[Array, " modes"] = param((0.05, 0.02), bounds=(-1.0, 1.0), scale=0.1, doc="parts that follow slowly")
    tau: Float[Array, " modes"] = param((0.1, 1.0), bounds=(0.0, np.inf), unit="s", scale=1.0, doc="time constants")

    def __check_init__(self) -> None:
        check_same_length(self, "a", "tau", "relaxation")

    def init(self, u0: Scalar) -> State:
        """State: the slow followers z, in equilibrium at u0."""
        return jnp.broadcast_to(u0, self.tau.shape)

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """Follow the new displacement for the time dt, exactly."""
        state = state - jnp.expm1(-dt / self.tau) * (u1 - state)
        return state, u1 - jnp.sum(self.a * (u1 - state))

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """The followers alone are in the scan."""
        state, total = relaxed(state, self.tau, 1.0, self.a, u, dt)
        return state, (1.0 - jnp.sum(self.a)) * u + total

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        u, dt = (np.asarray(v) for v in checked_drive(self, u, dt))
        return self.filtered(u[:, None], dt)[:, 0]

    def filtered(self, signals: np.ndarray, dt: np.ndarray) -> np.ndarray:
        """A recursion for each time constant."""
        moved = signals - signals[0]
        out = signals - float(np.sum(self.a)) * moved
        for a, tau in zip(np.asarray(self.a), np.asarray(self.tau), strict=True):
            kept = np.exp(-dt / tau)
            out += recursion((1.0, -np.append(kept[1:], 0.0)), (a * (1.0 - kept))[:, None] * moved)
        return out

    def start(self, records: Sequence[Record]) -> Relaxation:
        """Time constants from ten sampling intervals to the length of the records, small equal weights."""
        typical = sampling_interval(records)
        longest = max(float(np.sum(record.dt[1:])) for record in records)
        tau = np.geomspace(10 * typical, max(longest / 5, 100 * typical), self.tau.shape[0] + 2)[1:-1]
        return dataclasses.replace(self, a=np.full(self.a.shape, 0.02), tau=tau)

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        return LinearStep(self)
