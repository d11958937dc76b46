"""Creep: slow relaxations whose step response is logarithmic over decades of time."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # loads its subpackages when they are first used, which optimize is not in most fits
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis, Rest, check_same_length
from hystfit.models.shared.bracketed import Root
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.even_steps import Clock, relaxed
from hystfit.models.shared.shapes import Scalar, Signal, State
from hystfit.models.shared.simulation import checked_drive
from hystfit.models.shared.slopes import Slopes
from hystfit.models.shared.starting import fitted_input_range, input_range, sampling_interval
from hystfit.models.shared.step_inverse import AbstractStepInverse
from hystfit.params.param import element_places, element_weights, param
from hystfit.quality.host_operators import lagged
from hystfit.quality.needs import Needs

# Two modes a decade from 0.05 s, weights by non-negative least squares on log10(t / 0.1 s) over 0.1 to 1000 s: error 2e-4 decade.
_TAU = tuple(0.05 * 10 ** (i / 2) for i in range(10))
_WEIGHTS = (0.50681, 0.49935, 0.49995, 0.50038, 0.49920, 0.50164, 0.49578, 0.51714, 0.39820, 0.94761)
_BASE = 0.80793


class LogCreep(AbstractHysteresis):
    """Logarithmic creep of a displacement (Minase et al. 2010, eq. (2)):  L(t) = L0 [1 + gamma log10(t / 0.1 s)] after a step.

    Ten relaxations tau_i dz_i/dt = -z_i + gamma w_i x stand for the logarithm, so that any input and irregular time steps
    work: y = (1 - gamma b) x + sum of z_i. Comes after a hysteresis in a `Series`. gamma may depend on the displacement, a
    polynomial gamma_0 + gamma_1 (x / span) + ..., its order the length of the array less one.
    """

    rate_independent: ClassVar[bool] = False
    c_template: ClassVar[str] = "log_creep"
    one_scan: ClassVar[bool] = False
    allows_thinning: ClassVar[bool] = True

    gamma: Float[Array, " k"] = param(
        (0.01,), bounds=(-0.5, 0.5), scale=0.02, vector=True, doc="creep per decade of time, polynomial in x / span"
    )
    span: Scalar = param(
        1.0, bounds=(0.0, np.inf), unit="y", fixed=True, doc="displacement by which x is divided in the polynomial"
    )
    tau: Float[Array, " modes"] = element_places(_TAU, unit="s", doc="time constants of the relaxations")
    weights: Float[Array, " modes"] = element_places(_WEIGHTS, doc="decades that each relaxation stands for")
    base: Scalar = param(_BASE, fixed=True, doc="decades that have passed before the first relaxation")

    def __check_init__(self) -> None:
        check_same_length(self, "weights", "tau", "relaxation")

    @classmethod
    def spanning(cls, shortest: float, longest: float, **fields: object) -> LogCreep:
        """Relaxations, two per decade, for times from `shortest` to `longest` [s] after a step; gamma stays per decade since 0.1 s.

        Args:
            shortest: time after a step from which the creep is logarithmic [s].
            longest: time up to which it is [s].
            **fields: other parameters of `LogCreep`.

        Raises:
            ModelError: times that are not positive and in order.
        """
        if not 0 < shortest < longest:
            raise ModelError(f"creep needs 0 < shortest < longest, got {shortest:g} and {longest:g} s")
        modes = int(np.ceil(2 * np.log10(longest / shortest))) + 2
        tau = 0.5 * shortest * 10 ** (np.arange(modes) / 2)
        t = np.geomspace(shortest, longest, 400)
        # The base may have either sign.
        columns = np.column_stack([1 - np.exp(-t[:, None] / tau), -np.ones(t.size), np.ones(t.size)])
        solution, _ = scipy.optimize.nnls(columns, np.log10(t / 0.1))
        return cls(tau=tau, weights=solution[:-2], base=solution[-2] - solution[-1], **fields)

    def _rate(self, x: Array) -> Array:
        relative, total = x / self.span, jnp.zeros_like(x)
        for k in range(self.gamma.shape[0] - 1, -1, -1):
            total = total * relative + self.gamma[k]
        return total

    def init(self, u0: Scalar) -> State:
        """State: the relaxations, in equilibrium at u0."""
        return self._rate(u0) * self.weights * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """Relax towards the new displacement for the time dt, exactly."""
        gamma = self._rate(u1)
        state = state - jnp.expm1(-dt / self.tau) * (gamma * self.weights * u1 - state)
        return state, (1 - gamma * self.base) * u1 + jnp.sum(state)

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        gamma = self._rate(u)
        state, total = relaxed(state, self.tau, self.weights, 1.0, gamma * u, dt)
        return state, (1 - gamma * self.base) * u + total

    def start(self, records: Sequence[Record]) -> LogCreep:
        """A small creep; the span from the range of the signal that reaches it."""
        place = input_range(records)
        span = abs(place.center) + place.half
        gamma = np.where(np.arange(self.gamma.shape[0]) == 0, 0.01, 0.0)
        return dataclasses.replace(self, gamma=gamma, span=span)

    @property
    def linear_in_input(self) -> bool:
        """Where gamma does not depend on the displacement."""
        return self.gamma.shape[0] == 1

    def without_creep(self) -> LogCreep:
        return dataclasses.replace(self, gamma=jnp.zeros_like(self.gamma))

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        return CreepStep(self)


class CreepStep(AbstractStepInverse):
    """Inverse of `LogCreep` (Minase et al. 2010, eq. (19)): (target - remaining relaxations) / gain of one sample."""

    model: LogCreep
    needs_limits: ClassVar[bool] = False

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        creep = self.model
        share = -jnp.expm1(-dt / creep.tau)
        remainder = target - jnp.sum((1 - share) * state)
        k = jnp.sum(share * creep.weights) - creep.base
        gain = lambda x: x * (1 + k * creep._rate(x))
        if creep.gamma.shape[0] == 1:
            slope = 1 + k * creep.gamma[0]
            return Root(remainder / slope, slope > 0)

        def newton(_: Array, x: Array) -> Array:
            value, slope = jax.jvp(gain, (x,), (jnp.ones_like(x),))
            return x - (value - remainder) / slope

        x = jax.lax.fori_loop(0, 8, newton, u0)
        return Root(x, jax.jvp(gain, (x,), (jnp.ones_like(x),))[1] > 0)


class LinearCreep(AbstractHysteresis):
    """Linear creep operators of the input, with log-spaced time constants:  y = sum of a_i z_i,  tau_i dz_i/dt = x - z_i.

    x = (u - low) / (high - low). One weight for all time constants is the logarithmic law and what short records
    determine; a weight for each is Kuhnen's general operator. Added to a hysteresis in a `Sum`; linear in a.
    """

    rate_independent: ClassVar[bool] = False
    one_scan: ClassVar[bool] = False
    allows_thinning: ClassVar[bool] = True
    words: ClassVar[Mapping[str, tuple[str, ...]]] = {"rest": get_args(Rest)}
    needs: ClassVar[Needs] = Needs(loop=False, time=True, creep=True)

    a: Float[Array, " k"] = element_weights(
        (0.0,), scale=0.02, doc="weight of the relaxations, one for all or one for each"
    )
    tau: Float[Array, " modes"] = element_places(
        tuple(np.geomspace(0.05, 200.0, 7)), unit="s", doc="time constants of the relaxations"
    )
    low: Scalar = param(0.0, unit="u", fixed=True, doc="input where x = 0")
    high: Scalar = param(1.0, unit="u", fixed=True, doc="input where x = 1")
    level: Scalar = param(0.0, unit="u", fixed=True, doc="input at which the device rested before the record")
    rest: Rest = eqx.field(static=True, default="level")

    def __check_init__(self) -> None:
        if hasattr(self.a, "shape") and hasattr(self.tau, "shape") and self.a.shape not in ((1,), self.tau.shape):
            raise ModelError(f"one weight for all or one per time constant {self.tau.shape}: got {self.a.shape}")

    def init(self, u0: Scalar) -> State:
        """State: the relaxations, at rest."""
        rest = u0 if self.rest == "first" else self.level + 0.0 * u0
        return jnp.broadcast_to((rest - self.low) / (self.high - self.low), self.tau.shape)

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """Relax towards the new input for the time dt, exactly."""
        x = (u1 - self.low) / (self.high - self.low)
        state = state - jnp.expm1(-dt / self.tau) * (x - state)
        return state, jnp.sum(self.a * state)

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        x = (u - self.low) / (self.high - self.low)
        return relaxed(state, self.tau, 1.0, self.a, x, dt)

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        """Relaxation by relaxation on the host where the sampling is even."""
        u, dt = (np.asarray(v) for v in checked_drive(self, u, dt))
        if (clock := Clock.of(dt)) is None:
            return super().free_run(u, dt)
        rows = clock.rows(float(u[0] if self.rest == "first" else self.level), u)
        x = ((rows - float(self.low)) / (float(self.high) - float(self.low)))[:, None]
        weights = np.broadcast_to(np.asarray(self.a), self.tau.shape)
        lags = np.asarray(self.tau) / clock.interval
        return clock.samples(sum(w * lagged(x, lag)[:, 0] for w, lag in zip(weights, lags, strict=True)))

    def start(self, records: Sequence[Record]) -> LinearCreep:
        """Range of the samples that count, time constants from ten sampling intervals on; the weight follows from a linear solve."""
        place = fitted_input_range(records)
        typical = sampling_interval(records)
        tau = np.geomspace(10 * typical, 40000 * typical, self.tau.shape[0])
        return dataclasses.replace(self, low=place.low, high=place.high, tau=tau)

    def without_creep(self) -> LinearCreep:
        return dataclasses.replace(self, a=np.zeros(self.a.shape))

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes | None:
        """What relaxes within one sample."""
        if dt is None:
            return None
        shares = -np.expm1(-dt / np.asarray(self.tau)) * np.asarray(self.a)
        return Slopes.of(float(shares.sum()) / (float(self.high) - float(self.low)))

    def c_part(self) -> CPart:
        """One recursion per relaxation."""
        return CPart.of(self, "linear_creep", first=self.rest == "first", a=np.broadcast_to(self.a, self.tau.shape))
