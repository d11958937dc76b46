"""Independent noise with heavy tails."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.noise.base import ResidualScales
from hystfit.inference.noise.setting import Setting
from hystfit.inference.noise.white import White
from hystfit.models.shared.shapes import Scalar
from hystfit.outcome import Code
from hystfit.params.param import param


class StudentT(White):
    """Independent noise with heavy tails, Student's t of `noise_dof` degrees of freedom: outliers have little weight."""

    name: ClassVar[str] = "student-t"
    gaussian: ClassVar[bool] = False
    by_squares: ClassVar[bool] = False
    covers: ClassVar[frozenset[Code]] = frozenset({Code.HEAVY_TAILS})
    noise_dof: Scalar = param(
        5.0, bounds=(1.0, np.inf), scale=4.0, doc="degrees of freedom; few mean heavy tails, many a Gaussian"
    )

    @classmethod
    def start(cls, scales: ResidualScales) -> StudentT:
        """The scale is that of the middle of the residuals, which outliers do not move."""
        white = max(scales.spread * 1.2, 1e-3 * scales.total, abs(scales.center) * 1e-9)
        return cls(noise_white=white, noise_dof=5.0)

    @classmethod
    def of_size(cls, size: float) -> StudentT:
        return cls(noise_white=size, noise_dof=5.0)

    def gaussian_scale(self) -> Scalar:
        """From the Fisher information per sample, (dof + 1) / (dof + 3) / scale^2."""
        return self.noise_white * jnp.sqrt((self.noise_dof + 3) / (self.noise_dof + 1))

    def density(self, e: Float[Array, "..."], log_variance: Float[Array, "..."]) -> Float[Array, "..."]:
        """Student's t with scale `noise_white`."""
        nu = self.noise_dof
        lead = jax.lax.lgamma(0.5 * (nu + 1)) - jax.lax.lgamma(0.5 * nu) - 0.5 * jnp.log(nu * jnp.pi)
        return lead - 0.5 * log_variance - 0.5 * (nu + 1) * jnp.log1p(e**2 / nu)

    def draw(self, setting: Setting, key: Array) -> Float[Array, "R T"]:
        return jax.random.t(key, self.noise_dof, setting.weight.shape) * self._sd(setting)
