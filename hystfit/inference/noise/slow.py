"""Slow noise of exponential covariance, with independent noise on top or without."""

from __future__ import annotations

import abc
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.setting import Setting
from hystfit.params.param import param

_NOTHING = 1e100  # variance of the measurement where there is none


class AbstractSlow(AbstractNoise):
    """Noise with a slow Gaussian part of exponential covariance, by a scalar Kalman filter."""

    @property
    @abc.abstractmethod
    def white_variance(self) -> Float[Array, ""]:
        """Variance of the independent part at weight one."""

    def init(self) -> Float[Array, " state"]:
        """State: mean and variance of the slow part after the sample before; at first the stationary ones."""
        return jnp.stack([jnp.zeros_like(self.noise_slow), self.noise_slow**2])

    def _gain(self, variance: Array, gap: Array, weight: Array) -> tuple[Array, Array, Array, Array]:
        """(decay, gain, total variance, variance after) of one sample."""
        decay = jnp.exp(-gap / self.noise_time)
        before = decay**2 * variance + (1 - decay**2) * self.noise_slow**2
        total = before + self.white_variance / jnp.where(weight > 0, weight, 1.0)
        gain = jnp.where(weight > 0, before / total, 0.0)
        return decay, gain, total, (1 - gain) * before

    def step(
        self, state: Float[Array, " state"], r: Float[Array, ""], gap: Float[Array, ""], weight: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""], Float[Array, ""]]:
        """Predict over the gap, then learn."""
        decay, gain, total, after = self._gain(state[1], gap, weight)
        mean = decay * state[0]
        v = r - mean
        return jnp.stack([mean + gain * v, after]), v / jnp.sqrt(total), jnp.log(total)

    def whiten(
        self, setting: Setting, rows: Float[Array, "R T k"]
    ) -> tuple[Float[Array, "R T k"], Float[Array, "R T"]]:
        """Two scans with small bodies, the gains and then the means: they stay compiled into one piece under differentiation."""
        gap = jnp.broadcast_to(setting.gap, setting.weight.shape)
        even = setting.gap.ndim == 0

        def record(signals: Array, gap: Array, weight: Array) -> tuple[Array, Array]:
            on = weight > 0
            white = jnp.where(on, self.white_variance / jnp.where(on, weight, 1.0), _NOTHING)
            decay = jnp.exp(-(gap[0] if even else gap) / self.noise_time)
            fresh = (1 - decay**2) * self.noise_slow**2

            def variances(after: Array, at: tuple[Array, ...]) -> tuple[Array, Array]:
                own, square, add = (*at, decay**2, fresh) if even else at
                before = square * after + add
                return before * (own / (before + own)), before

            rest = (white,) if even else (white, decay**2, fresh)
            _, before = jax.lax.scan(variances, self.noise_slow**2, rest)
            gain, total = before / (before + white), before + jnp.where(on, white, 0.0)
            onward = decay if even else jnp.concatenate([decay[1:], decay[-1:]])
            keep, push = onward * (1 - gain), (onward * gain)[:, None] * signals
            _, mean = jax.lax.scan(lambda m, at: (at[0] * m + at[1], m), jnp.zeros(signals.shape[1]), (keep, push))
            e = jnp.where(on[:, None], (signals - mean) / jnp.sqrt(total)[:, None], 0.0)
            return e, jnp.where(on, jnp.log(total), 0.0)

        if rows.shape[0] == 1:
            e, logs = record(rows[0], gap[0], setting.weight[0])
            return e[None], logs[None]
        return jax.lax.map(lambda at: record(*at), (rows, gap, setting.weight))

    def draw(self, setting: Setting, key: Array) -> Float[Array, "R T"]:
        """See `AbstractNoise.draw`."""
        gap = jnp.broadcast_to(setting.gap, setting.weight.shape)
        decay = jnp.exp(-gap / self.noise_time)
        first, second, third = jax.random.split(key, 3)
        push = jnp.sqrt(1 - decay**2) * self.noise_slow * jax.random.normal(first, gap.shape)
        start = self.noise_slow * jax.random.normal(second, gap.shape[:1])
        move = lambda v, at: (at[0] * v + at[1], at[0] * v + at[1])
        slow = jax.lax.scan(move, start, (decay.T, push.T))[1].T
        on = setting.weight > 0
        sd = jnp.sqrt(self.white_variance / jnp.where(on, setting.weight, 1.0))
        return slow + sd * jax.random.normal(third, gap.shape)


class OrnsteinUhlenbeck(AbstractSlow):
    """Slow noise, an Ornstein-Uhlenbeck process, and independent noise on top, by a scalar Kalman filter.

    The usual state of affairs: a sensor's noise, and drift or model error that takes many samples to change.
    """

    name: ClassVar[str] = "ou"
    gaussian: ClassVar[bool] = True
    noise_white: Float[Array, ""] = param(
        1.0, bounds=(0.0, np.inf), unit="y", scale=0.01, doc="standard deviation of independent noise"
    )
    noise_slow: Float[Array, ""] = param(
        1.0, bounds=(0.0, np.inf), unit="y", scale=0.01, doc="standard deviation of slow noise"
    )
    noise_time: Float[Array, ""] = param(
        10.0, bounds=(0.0, np.inf), unit="sample", scale=10.0, doc="correlation time of slow noise"
    )

    @property
    def white_variance(self) -> Float[Array, ""]:
        """Of the sensor."""
        return self.noise_white**2


class Ar1(AbstractSlow):
    """First-order autoregressive noise without a white part: honest only where the sensor itself is quiet."""

    name: ClassVar[str] = "ar1"
    gaussian: ClassVar[bool] = True
    noise_slow: Float[Array, ""] = param(
        1.0, bounds=(0.0, np.inf), unit="y", scale=0.01, doc="standard deviation of the noise"
    )
    noise_time: Float[Array, ""] = param(
        10.0, bounds=(0.0, np.inf), unit="sample", scale=10.0, doc="correlation time of the noise"
    )

    @property
    def white_variance(self) -> Float[Array, ""]:
        """Next to nothing: two samples at one time must not contradict each other for certain."""
        return (1e-6 * self.noise_slow) ** 2
