"""Independent Gaussian noise."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.noise.base import LOG_2PI, AbstractNoise, ResidualScales
from hystfit.inference.noise.setting import Setting
from hystfit.models.shared.shapes import Scalar, State
from hystfit.params.param import param


class White(AbstractNoise):
    """Independent Gaussian noise."""

    name: ClassVar[str] = "iid"
    by_squares: ClassVar[bool] = True
    noise_white: Scalar = param(
        1.0, bounds=(0.0, np.inf), unit="y", scale=0.01, doc="standard deviation of independent noise"
    )

    def init(self) -> State:
        return jnp.zeros((0,))

    @classmethod
    def start(cls, scales: ResidualScales) -> White:
        """Starting values that attribute all residuals to independent noise."""
        return cls(noise_white=scales.total)

    @classmethod
    def of_size(cls, size: float) -> White:
        return cls(noise_white=size)

    def step(self, state: State, r: Scalar, gap: Scalar, weight: Scalar) -> tuple[State, Scalar, Scalar]:
        safe = jnp.where(weight > 0, weight, 1.0)
        return state, r * jnp.sqrt(safe) / self.noise_white, 2 * jnp.log(self.noise_white) - jnp.log(safe)

    def whiten(
        self, setting: Setting, rows: Float[Array, "R T k"]
    ) -> tuple[Float[Array, "R T k"], Float[Array, "R T"]]:
        on = setting.weight > 0
        safe = jnp.where(on, setting.weight, 1.0)
        e = rows * (jnp.where(on, jnp.sqrt(safe), 0.0) / self.noise_white)[..., None]
        return e, jnp.where(on, 2 * jnp.log(self.noise_white) - jnp.log(safe), 0.0)

    def of_squares(self, setting: Setting, total: Scalar) -> Scalar:
        """Log density of residuals from the sum of their squares, each times its weight."""
        each = jnp.log(self.noise_white) + 0.5 * LOG_2PI
        return jnp.asarray(0.5 * setting.log_weight) - setting.count * each - 0.5 * total / self.noise_white**2

    def draw(self, setting: Setting, key: Array) -> Float[Array, "R T"]:
        return jax.random.normal(key, setting.weight.shape) * self._sd(setting)

    def _sd(self, setting: Setting) -> Array:
        on = setting.weight > 0
        return jnp.where(on, self.noise_white / jnp.sqrt(jnp.where(on, setting.weight, 1.0)), 0.0)
