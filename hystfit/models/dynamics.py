"""Linear dynamics before or after a hysteresis: a delay, a lag, a resonance."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis, OutputResonance, Rest
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.even_steps import Clock, scan_in_time
from hystfit.models.shared.shapes import Scalar, Signal, State
from hystfit.models.shared.simulation import checked_drive
from hystfit.models.shared.starting import sampling_interval
from hystfit.models.shared.step_inverse import COMES_LATER, AbstractStepInverse, LinearStep
from hystfit.params.param import param
from hystfit.quality.host_operators import recursion
from hystfit.quality.summary import delay_of, dynamics_of, likeliest_lag_of


class Delay(AbstractHysteresis):
    """Pure delay by a (fractional) number of samples, between which the signal is interpolated linearly.

    Raises:
        ModelError: `longest` is less than one sample.
    """

    no_inverse: ClassVar[str] = COMES_LATER
    rate_independent: ClassVar[bool] = True
    c_template: ClassVar[str] = "delay"
    one_scan: ClassVar[bool] = False
    allows_thinning: ClassVar[bool] = False  # its delay is in samples
    linear_in_input: ClassVar[bool] = True
    hysteretic: ClassVar[bool] = False
    delays: ClassVar[bool] = True

    lag: Scalar = param(1.0, bounds=(0.0, np.inf), unit="sample", doc="delay")
    longest: int = eqx.field(static=True, default=8)

    def __check_init__(self) -> None:
        if self.longest < 1:
            raise ModelError(f"the longest delay must be at least one sample, got {self.longest}")

    def init(self, u0: Scalar) -> State:
        """State: the last inputs, newest first, all u0."""
        return jnp.broadcast_to(u0, (self.longest + 1,))

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """Push the new input, read between two old ones."""
        state = jnp.concatenate([u1[None], state[:-1]])
        lag = jnp.minimum(self.lag, float(self.longest))
        weight = jnp.maximum(0.0, 1.0 - jnp.abs(lag - jnp.arange(self.longest + 1)))
        return state, jnp.sum(weight * state)

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """The three shifted inputs around the delay, without a scan: all others have weight 0, and so have their derivatives."""
        count = self.longest + 1
        line = jnp.concatenate([state[:-1][::-1], u])
        lag = jnp.minimum(self.lag, float(self.longest))
        near = min(3, count)
        first = jnp.clip(jnp.round(jax.lax.stop_gradient(lag)).astype(int) - 1, 0, count - near)
        y = jnp.zeros_like(u)
        for k in range(near):
            weight = jnp.maximum(0.0, 1.0 - jnp.abs(lag - (first + k)))
            y = y + weight * jax.lax.dynamic_slice_in_dim(line, self.longest - first - k, u.shape[0])
        return line[-count:][::-1], y

    def start(self, records: Sequence[Record]) -> Delay:
        """The delay that the records show, one sample where they show none; the line becomes long enough for it."""
        found = [delay.samples for record in records if (delay := delay_of(record)) is not None]
        lag = float(np.median(found)) if found else 1.0
        return type(self)(lag=lag, longest=max(self.longest, math.ceil(1.2 * lag)))  # the line of the delay may grow


class Lag(AbstractHysteresis):
    """Two equal first-order lags of tau / 2 each, or one of tau: an amplifier, a sensor, anti-alias filters. Exact for steps of the input.

    The input of a sample acts over the whole interval before it, on average half an interval early: a fitted tau includes that half, and
    is valid for the sampling rate of its records. `level` is the input at which the device rested before the record, so that a jump at
    the first sample is smoothed too.

    Raises:
        ModelError: `order` is neither 1 nor 2.
    """

    rate_independent: ClassVar[bool] = False
    creeps: ClassVar[bool] = False
    linear_in_input: ClassVar[bool] = True
    hysteretic: ClassVar[bool] = False
    words: ClassVar[Mapping[str, tuple[str, ...]]] = {"rest": get_args(Rest)}

    tau: Scalar = param(0.01, bounds=(0.0, np.inf), unit="s", scale=0.01, doc="mean delay")
    level: Scalar = param(0.0, unit="u", fixed=True, doc="input at which the device rested before the record")
    rest: Rest = eqx.field(static=True, default="level")
    order: int = eqx.field(static=True, default=2)

    def __check_init__(self) -> None:
        if self.order not in (1, 2):
            raise ModelError(f"the order of a lag must be 1 or 2, got {self.order}")

    def init(self, u0: Scalar) -> State:
        """State: the outputs of the lags, in equilibrium at `level` or, where rest = "first", at the first input."""
        return jnp.broadcast_to(u0 if self.rest == "first" else self.level + 0.0 * u0, (self.order,))

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        new = _lagged(tuple(state), u1, self._factors(dt))
        return jnp.stack(new), new[-1]

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """Without the exponential where the sampling is even."""
        body = lambda state, u1, factors: (new := _lagged(state, u1, factors), new[-1])
        start = tuple(state[k] for k in range(self.order))
        state, y = scan_in_time(body, start, u, self._factors, dt, unroll=2)
        return jnp.stack(state), y

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        """A recursion for each lag on the host where the sampling is even."""
        u, dt = (np.asarray(v) for v in checked_drive(self, u, dt))
        if (clock := Clock.of(dt)) is None:
            return super().free_run(u, dt)
        rest = float(u[0] if self.rest == "first" else self.level)
        x = (clock.rows(rest, u) - rest)[:, None]
        passed = self.order * clock.interval / float(self.tau)
        decay = np.exp(-passed)
        first = recursion((1.0, -decay), (1.0 - decay) * x)
        if self.order == 1:
            return rest + clock.samples(first[:, 0])
        before = np.concatenate([x[:1], first[:-1]])
        second = recursion((1.0, -decay), (1.0 - decay) * x + decay * passed * (before - x))
        return rest + clock.samples(second[:, 0])

    def _factors(self, dt: Array) -> tuple[Array, ...]:
        """Parts of the outputs after the time dt: of each output in itself, of the first in the second, of the input in either."""
        passed = self.order * dt / self.tau
        kept, reached = jnp.exp(-passed), -jnp.expm1(-passed)
        return kept, kept * passed, reached, reached - kept * passed

    def start(self, records: Sequence[Record]) -> Lag:
        """The lag behind which hysteresis describes the output best; three samples where none does."""
        found = [lag for record in records if (lag := likeliest_lag_of(record)) is not None]
        return dataclasses.replace(self, tau=float(np.median(found or [3.0])) * sampling_interval(records))

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        """The output is affine in the new input."""
        return LinearStep(self)

    def c_part(self) -> CPart:
        return CPart.of(self, "lag", first=self.rest == "first")


def _lagged(state: tuple[Array, ...], u: Array, factors: tuple[Array, ...]) -> tuple[Array, ...]:
    """Outputs of one lag, or of two in a row, after a step to u."""
    kept, passed, reached, through = factors
    first, *second = state
    return kept * first + reached * u, *(kept * one + (passed * first + through * u) for one in second)


class SecondOrder(AbstractHysteresis):
    """A resonance with static gain one:  y'' + 2 zeta omega y' + omega^2 y = omega^2 u,  exact for inputs linear between samples."""

    no_inverse: ClassVar[str] = COMES_LATER
    rate_independent: ClassVar[bool] = False
    creeps: ClassVar[bool] = False
    c_template: ClassVar[str] = "second_order"
    linear_in_input: ClassVar[bool] = True
    hysteretic: ClassVar[bool] = False

    omega: Scalar = param(100.0, bounds=(0.0, np.inf), unit="1/s", scale=10.0, doc="natural frequency [rad]")
    zeta: Scalar = param(0.1, bounds=(0.0, 1.0), doc="damping ratio")

    def init(self, u0: Scalar) -> State:
        """State: output and its rate, in equilibrium at u0."""
        return jnp.stack([u0, jnp.zeros_like(u0)])

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """The deviation from the ramp response decays freely over the sample."""
        position, speed = self._moved((state[0], state[1]), u0, u1, self._factors(dt))
        return jnp.stack([position, speed]), position

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """Without exponential, sine and cosine where the sampling is even."""
        before = jnp.concatenate([u0[None], u[:-1]])
        body = lambda state, row, factors: (new := self._moved(state, *row, factors), new[0])
        state, y = scan_in_time(body, (state[0], state[1]), (before, u), self._factors, dt, unroll=2)
        return jnp.stack(state), y

    def _factors(self, dt: Array) -> tuple[Array, ...]:
        """1 / dt, 0 where there is no time, and the free decay over dt: position and speed after a position and a speed of 1."""
        per_time = jnp.where(dt > 0, 1.0 / jnp.where(dt > 0, dt, 1.0), 0.0)
        damped = self.omega * jnp.sqrt(jnp.maximum(1.0 - self.zeta**2, 1e-12))  # a derivative at critical damping too
        decay = jnp.exp(-self.zeta * self.omega * dt)
        cosine, sine = decay * jnp.cos(damped * dt), decay * dt * jnp.sinc(damped * dt / jnp.pi)  # sine / damped
        along = self.zeta * self.omega * sine
        return per_time, cosine + along, sine, -(self.omega**2) * sine, cosine - along

    def _moved(
        self, state: tuple[Array, Array], u0: Array, u1: Array, factors: tuple[Array, ...]
    ) -> tuple[Array, Array]:
        per_time, e_by_e, e_by_v, v_by_e, v_by_v = factors
        slope = (u1 - u0) * per_time
        lag = 2.0 * self.zeta / self.omega * slope
        # What the input adds does not wait for the state.
        position = jnp.where(per_time > 0, u1 - lag + e_by_e * (lag - u0) - e_by_v * slope, 0.0)
        speed = slope + v_by_e * (lag - u0) - v_by_v * slope
        return (position + e_by_v * state[1]) + e_by_e * state[0], (speed + v_by_e * state[0]) + v_by_v * state[1]

    def start(self, records: Sequence[Record]) -> SecondOrder:
        """The resonance that the records show; at a tenth of the sampling rate where they show none."""
        found = [seen for record in records if (seen := dynamics_of(record)) is not None and seen.underdamped]
        if not found:
            return type(self)(omega=0.2 * np.pi / sampling_interval(records, 0.01), zeta=0.3)
        frequency, damping = np.median([(seen.natural_frequency, seen.damping_ratio) for seen in found], axis=0)
        return type(self)(omega=2 * np.pi * frequency, zeta=damping)

    def output_resonance(self) -> OutputResonance:
        """The resonance itself."""
        return OutputResonance(None, float(self.omega), float(self.zeta))
