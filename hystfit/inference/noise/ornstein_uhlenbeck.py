"""Slow noise with independent noise on top."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hystfit.inference.noise.base import ResidualScales
from hystfit.inference.noise.exponential import LEAST_TIME, AbstractSlow
from hystfit.models.shared.shapes import Scalar
from hystfit.params.param import param


class OrnsteinUhlenbeck(AbstractSlow):
    """An Ornstein-Uhlenbeck process with independent noise on top: sensor noise, and drift or model error that changes slowly.

    Its correlation time is at least one sample: faster noise cannot be distinguished from the independent part, and its size could be any.
    """

    name: ClassVar[str] = "ou"
    parts: ClassVar[tuple[str, str, str] | None] = ("noise_white", "noise_slow", "noise_time")
    noise_white: Scalar = param(
        1.0, bounds=(0.0, np.inf), unit="y", scale=0.01, doc="standard deviation of independent noise"
    )
    noise_slow: Scalar = param(1.0, bounds=(0.0, np.inf), unit="y", scale=0.01, doc="standard deviation of slow noise")
    noise_time: Scalar = param(
        10.0, bounds=(LEAST_TIME, np.inf), unit="sample", scale=10.0, doc="correlation time of slow noise"
    )

    @property
    def white_variance(self) -> Scalar:
        """Variance of the white (sensor) noise."""
        return self.noise_white**2

    @classmethod
    def start(cls, scales: ResidualScales) -> OrnsteinUhlenbeck:
        """White and slow parts from the differences of neighboring residuals, the time from their autocorrelation."""
        return cls(noise_white=scales.white, noise_slow=scales.slow, noise_time=scales.start_time)

    @classmethod
    def of_size(cls, size: float) -> OrnsteinUhlenbeck:
        """White and slow noise of the same size, correlated over 20 samples."""
        return cls(noise_white=size, noise_slow=size, noise_time=20.0)
