"""The mechanical Bouc-Wen oscillator: force in, displacement out (Wen 1976)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.starting import input_range, output_range
from hystfit.params.param import param
from hystfit.quality.needs import Needs


class BoucWenOscillator(AbstractHysteresis):
    """Mass, damper and hysteretic spring under a force u, displacement y:

        m y'' + d y' + a k y + (1 - a) k z = u,    z' = y' - (beta sgn(y' z) + gamma) |z|^n (1 / zy)^n y',   beta + gamma = 1

    in the normalized form: z tends to +-zy, the yield displacement, and gamma = 1 - beta, so that no parameter is redundant.
    Runge-Kutta of fourth order with `substeps` a sample; the force is linear between samples.

    Raises:
        ModelError: fewer than one substep.
    """

    rate_independent: ClassVar[bool] = False
    needs: ClassVar[Needs] = Needs(
        time=True, dynamics=True, too_few="mass, damping and stiffness trade off; measure around the resonance"
    )

    m: Float[Array, ""] = param(1.0, bounds=(0.0, np.inf), unit="u*s^2/y", doc="mass")
    d: Float[Array, ""] = param(0.1, bounds=(0.0, np.inf), unit="u*s/y", doc="damping")
    k: Float[Array, ""] = param(1.0, bounds=(0.0, np.inf), unit="u/y", doc="stiffness before yielding")
    a: Float[Array, ""] = param(0.3, bounds=(0.0, 1.0), doc="stiffness after yielding in parts of k")
    zy: Float[Array, ""] = param(0.3, bounds=(0.0, np.inf), unit="y", doc="yield displacement")
    beta: Float[Array, ""] = param(0.5, bounds=(0.0, 1.0), doc="share of the unloading shape, 1 - gamma")
    n: Float[Array, ""] = param(1.0, bounds=(0.5, 12.0), fixed=True, doc="sharpness of yielding")
    offset: Float[Array, ""] = param(
        0.0, unit="y", per_record=True, doc="displacement that is read at rest", linear=True
    )
    substeps: int = eqx.field(static=True, default=2)

    def __check_init__(self) -> None:
        if self.substeps < 1:
            raise ModelError(f"at least one substep a sample is needed, got {self.substeps}")

    def init(self, u0: Float[Array, ""]) -> Float[Array, " state"]:
        """State: displacement, velocity, z; at rest in the unloaded position."""
        return jnp.zeros((3,)) + 0.0 * u0

    def _slope(self, state: Array, force: Array) -> Array:
        y, v, z = state[0], state[1], state[2]
        acceleration = (force - self.d * v - self.k * (self.a * y + (1 - self.a) * z)) / self.m
        magnitude = jnp.abs(z) / self.zy
        safe = jnp.where(magnitude > 0, magnitude, 1.0)
        power = jnp.where(magnitude > 0, jnp.exp(self.n * jnp.log(safe)), 0.0)
        sign = jnp.where(v * z >= 0, 1.0, -1.0)
        return jnp.stack([v, acceleration, v * (1.0 - (self.beta * sign + 1.0 - self.beta) * power)])

    def step(
        self, state: Float[Array, " state"], u0: Float[Array, ""], u1: Float[Array, ""], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""]]:
        """Classical Runge-Kutta over the sample."""
        step = dt / self.substeps

        def once(i: Array, state: Array) -> Array:
            at = lambda part: u0 + (u1 - u0) * (i + part) / self.substeps
            k1 = self._slope(state, at(0.0))
            k2 = self._slope(state + 0.5 * step * k1, at(0.5))
            k3 = self._slope(state + 0.5 * step * k2, at(0.5))
            k4 = self._slope(state + step * k3, at(1.0))
            return state + step * (k1 + 2 * k2 + 2 * k3 + k4) / 6

        state = jax.lax.fori_loop(0, self.substeps, once, state)
        return state, self.offset + state[0]

    def start(self, records: Sequence[Record]) -> BoucWenOscillator:
        """Stiffness from the ranges, mass and damping from a resonance above the input's frequency."""
        force, out = input_range(records).half, output_range(records).half
        record = records[0]
        crossings = np.count_nonzero(np.diff(np.sign(record.u - np.mean(record.u))))
        duration = float(record.dt.sum()) or 1.0
        omega = 2 * np.pi * max(crossings / (2 * duration), 1 / duration)
        k = 1.5 * force / out
        return eqx.tree_at(
            lambda s: (s.m, s.d, s.k, s.a, s.zy),
            self,
            tuple(
                jnp.asarray(v, dtype=float) for v in (k / (3 * omega) ** 2, 0.2 * k / (3 * omega), k, 0.4, 0.3 * out)
            ),
        )
