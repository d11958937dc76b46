"""First-order autoregressive noise."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hystfit.inference.noise.base import ResidualScales
from hystfit.inference.noise.exponential import AbstractSlow
from hystfit.models.shared.shapes import Scalar
from hystfit.params.param import param


class Ar1(AbstractSlow):
    """First-order autoregressive noise without a white part, for sensors whose own noise is negligible."""

    name: ClassVar[str] = "ar1"
    noise_slow: Scalar = param(1.0, bounds=(0.0, np.inf), unit="y", scale=0.01, doc="standard deviation of the noise")
    noise_time: Scalar = param(
        10.0, bounds=(0.0, np.inf), unit="sample", scale=10.0, doc="correlation time of the noise"
    )

    @property
    def white_variance(self) -> Scalar:
        """A small nugget, which keeps the covariance non-singular."""
        return (1e-6 * self.noise_slow) ** 2

    @classmethod
    def start(cls, scales: ResidualScales) -> Ar1:
        """Starting values that attribute all residuals to slow noise."""
        return cls(noise_slow=scales.total, noise_time=scales.start_time)

    @classmethod
    def of_size(cls, size: float) -> Ar1:
        """Correlated over 20 samples."""
        return cls(noise_slow=size, noise_time=20.0)
