"""The surrogate of the paper's curved actuator (THUNDER TH-8R) in closed form, independent of the Preisach code of hystfit."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import hystfit as hf
from hystfit.models import AbstractHysteresis
from hystfit.params.param import param

OMEGA, ZETA = 328.0, 0.02  # rad/s; the paper gives the first, the second is ours
RELAXATION = ((0.12, 0.02, 0.02), (0.15, 1.5, 15.0))
STRONGER = ((0.35, 0.02, 0.02), (0.15, 1.5, 15.0))  # so that the lag at 1 Hz is as visible as in the paper
LIMITS = (0.0, 200.0)
PLANTS = {
    "unchanged": {},
    "-8 %": {"gain": 0.92},
    "changed in shape": {"rho": 1.3 * 1.646e-3, "k1": 0.33, "bend": 0.16},  # loops 30 % wider, and earlier saturation
}
NOISE = 0.05  # um rms of the displacement sensor


class Thunder(AbstractHysteresis):
    """Displacement [um] of u >= 0 [V], static: a Preisach model of closed-form Everett function followed by a nonlinearity.

    X(alpha, beta) = k1 (alpha - beta) + rho (alpha - beta)^2 (1 + 0.25 ((alpha + beta) / 180 - 1)),  y = gain psi(h),
    psi(h) = h + 0.08 h (1 - h / 120), which violates congruency by some percent, as in the paper.
    """

    rate_independent: ClassVar[bool] = True

    gain: Float[Array, ""] = param(1.0, doc="change since the identification")
    k1: Float[Array, ""] = param(0.370, unit="y/u", doc="reversible slope")
    rho: Float[Array, ""] = param(1.646e-3, unit="y/u^2", doc="density of relays")
    bend: Float[Array, ""] = param(0.08, doc="of the nonlinearity that violates congruency")

    def _everett(self, a: Array, b: Array) -> Array:
        d = a - b
        return self.k1 * d + self.rho * d * d * (1 + 0.25 * ((a + b) / 180 - 1))

    def init(self, u0: Float[Array, ""]) -> Float[Array, " state"]:
        """State: 32 dominant extrema, the last one repeated."""
        return jnp.full((32,), u0)

    def step(
        self, state: Float[Array, " state"], u0: Float[Array, ""], u1: Float[Array, ""], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""]]:
        """Wipe out the extrema that u1 passed, and sum over the stack."""
        before = jnp.concatenate([jnp.zeros(1), state[:-1]])
        low, high = jnp.minimum(before, state), jnp.maximum(before, state)
        inside = (low < u1) & (u1 < high)
        inside = inside.at[0].set(u1 < state[0])
        kept = jnp.minimum(jnp.sum(inside), state.shape[0] - 1)
        state = jnp.where(jnp.arange(state.shape[0]) < kept, state, u1)
        before = jnp.concatenate([jnp.zeros(1), state[:-1]])
        sign = jnp.where(state >= before, 1.0, -1.0)
        h = jnp.sum(sign * self._everett(jnp.maximum(state, before), jnp.minimum(state, before)))
        return state, self.gain * (h + self.bend * h * (1 - h / 120))

    def start(self, records: Sequence[hf.Record]) -> Thunder:
        """Itself: it is not fitted."""
        return self


def actuator(
    *, relaxation: tuple | None = RELAXATION, zeta: float = ZETA, omega: float = OMEGA, **changed: float
) -> hf.Series:
    """The whole plant: hysteresis, relaxation (None for none) and resonance.

    Args:
        relaxation: parts and time constants [s].
        zeta, omega: of the resonance [rad/s].
        **changed: parameters of `Thunder` that have changed since the identification.
    """
    slow = [] if relaxation is None else [hf.Relaxation(a=relaxation[0], tau=relaxation[1])]
    return hf.Series(Thunder(**changed), *slow, hf.SecondOrder(omega=omega, zeta=zeta))


def legs(
    extrema: Sequence[float], frequency: float, rate: float, full: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(t, value) of half cosines from extremum to extremum, each lasting half a period of the frequency.

    Args:
        extrema: values to pass through.
        frequency: in Hz.
        rate: samples per second.
        full: difference of extrema that takes half a period; smaller ones take less in proportion. None: all take half a period.
    """
    pieces = [np.array([float(extrema[0])])]
    for a, b in itertools.pairwise(extrema):
        count = max(2, round(0.5 / frequency * rate * (1.0 if full is None else abs(b - a) / full)))
        pieces.append(a + 0.5 * (b - a) * (1 - np.cos(np.pi * np.arange(1, count + 1) / count)))
    value = np.concatenate(pieces)
    return np.arange(value.size) / rate, value


def measure(
    plant: AbstractHysteresis, t: np.ndarray, u: np.ndarray, *, seed: int | None = None, name: str = ""
) -> hf.Record:
    """A record of a plant, with sensor noise where a seed is given."""
    y = np.array(hf.simulate(plant, u, float(t[1] - t[0]))[0])
    if seed is not None:
        y += NOISE * np.random.default_rng(seed).standard_normal(y.size)
    return hf.Record(u=u, y=y, t=t, u_unit="V", y_unit="um", name=name or "thunder")
