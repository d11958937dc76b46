"""Slow noise of exponential covariance by a scalar Kalman filter: what `ou`, `ar1` and `discrepancy` share."""

from __future__ import annotations

import abc
from typing import TYPE_CHECKING, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.noise.base import LOG_2PI, AbstractNoise
from hystfit.inference.noise.setting import Setting
from hystfit.inference.priors import AbstractPrior, LogNormal
from hystfit.models.shared.shapes import Scalar, State
from hystfit.outcome import Code

LEAST_TIME = 1.0  # least correlation time of slow noise beside white noise, samples
_MISSING = 1e100  # variance of the white part where there is no measurement
_FASTEST = -700.0  # logarithm of a ratio between neighboring samples whose powers are 0 to all digits


class AbstractSlow(AbstractNoise):
    """Noise with a slow Gaussian part of exponential covariance."""

    covers: ClassVar[frozenset[Code]] = frozenset({Code.CORRELATED_RESIDUALS, Code.HEAVY_TAILS})

    if TYPE_CHECKING:  # fields of the subclasses, in an order of theirs
        noise_slow: Scalar  # standard deviation of the slow part
        noise_time: Scalar  # its correlation time

    @classmethod
    def default_priors(cls, longest: int, curve_size: float | None) -> dict[str, AbstractPrior]:
        """A correlation time between one sample and a third of the record: slower noise is a constant, which the offset already is."""
        slowest = max(longest / 3, 10.0)
        spread = float(np.log(slowest)) / 4  # two standard deviations each way
        return {"noise_time": LogNormal(float(np.sqrt(slowest)), spread, LEAST_TIME if cls.parts else 0.0)}

    @property
    @abc.abstractmethod
    def white_variance(self) -> Scalar:
        """Variance of the independent part at weight one."""

    def init(self) -> State:
        """State: mean and variance of the slow part after the sample before; at first the stationary ones."""
        return jnp.stack([jnp.zeros_like(self.noise_slow), self.noise_slow**2])

    def _gain(self, variance: Array, gap: Array, weight: Array) -> tuple[Array, Array, Array, Array]:
        """(decay, gain, total variance, variance after) of one sample."""
        decay = jnp.exp(-gap / self.noise_time)
        before = decay**2 * variance + (1 - decay**2) * self.noise_slow**2
        total = before + self.white_variance / jnp.where(weight > 0, weight, 1.0)
        gain = jnp.where(weight > 0, before / total, 0.0)
        return decay, gain, total, (1 - gain) * before

    def step(self, state: State, r: Scalar, gap: Scalar, weight: Scalar) -> tuple[State, Scalar, Scalar]:
        """Predict over the gap, then update with the sample."""
        state, e, logs = self.steps(state, r[None], gap, weight)
        return state, e[0], logs

    def start_of(self, count: int) -> Float[Array, "..."]:
        """State: the means of all signals, and their variance."""
        return jnp.append(jnp.zeros(count), self.noise_slow**2)

    def steps(
        self, state: Float[Array, "..."], signals: Float[Array, " m"], gap: Scalar, weight: Scalar
    ) -> tuple[Float[Array, "..."], Float[Array, " m"], Scalar]:
        """The signals share their variance."""
        decay, gain, total, after = self._gain(state[-1], gap, weight)
        means = decay * state[:-1]
        v = signals - means
        return jnp.append(means + gain * v, after), v / jnp.sqrt(total), jnp.log(total)

    def log_density(self, setting: Setting, r: Float[Array, "R T"]) -> Scalar:
        """See `AbstractNoise.log_density`; where the samples of each record count alike, variances have a closed form."""
        if setting.full is None or self.has_shapes or not self.gaussian:
            return super().log_density(setting, r)
        rows = (r, setting.full, self.white_variance / setting.weight[:, 0])
        if r.shape[0] == 1:
            return self._log_density_full(*(row[0] for row in rows))
        return jnp.sum(jax.lax.map(lambda row: self._log_density_full(*row), rows))

    def _log_density_full(self, r: Float[Array, " T"], count: Scalar, white: Scalar) -> Scalar:
        """Log density of the first `count` samples of an evenly sampled record, with white noise of one variance.

        The total variance of sample k before it is read is e (1 - u[k+1]) / (1 - u[k]) with u[k] = u[0] ratio^k: the recursion of
        the filter is a Moebius map, e and e ratio are the eigenvalues of its matrix, and the product of all variances telescopes.
        """
        lost, slow = -jnp.expm1(-2 / self.noise_time), self.noise_slow**2
        bend = lost * (white - slow)
        root = 0.5 * (jnp.abs(bend) + jnp.sqrt(bend**2 + 4 * lost * slow * white))
        settled = jnp.where(bend > 0, lost * slow * white / root, root)  # variance of the slow part after many samples
        e = settled + white
        log_ratio = jnp.maximum(2 * (jnp.log(white / e) - 1 / self.noise_time), _FASTEST)
        start = (slow - settled) / (slow + white - e * jnp.exp(log_ratio))
        u = start * jnp.exp(jnp.arange(r.shape[0] + 1) * log_ratio)
        logs = count * jnp.log(e) + jnp.log1p(-start * jnp.exp(count * log_ratio)) - jnp.log1p(-start)
        part = white / e * (1 - u[:-1]) / (1 - u[1:])  # of the total variance that is white
        decay = jnp.exp(-1 / self.noise_time)
        keep = decay * part
        _, mean = jax.lax.scan(lambda m, at: (at[0] * m + at[1], m), jnp.zeros(()), (keep, (decay - keep) * r))
        squares = jnp.where(jnp.arange(r.shape[0]) < count, (r - mean) ** 2 * part, 0.0)
        return -0.5 * (jnp.sum(squares) / white + logs + count * LOG_2PI)

    def whiten(
        self, setting: Setting, rows: Float[Array, "R T k"]
    ) -> tuple[Float[Array, "R T k"], Float[Array, "R T"]]:
        """Two scans with small bodies, gains and then means, so that XLA compiles each into one native loop when differentiated."""
        gap = jnp.broadcast_to(setting.gap, setting.weight.shape)
        even = setting.gap.ndim == 0

        def record(signals: Array, gap: Array, weight: Array) -> tuple[Array, Array]:
            on = weight > 0
            white = jnp.where(on, self.white_variance / jnp.where(on, weight, 1.0), _MISSING)
            decay = jnp.exp(-(gap[0] if even else gap) / self.noise_time)
            fresh = (1 - decay**2) * self.noise_slow**2

            def variances(after: Array, at: tuple[Array, ...]) -> tuple[Array, Array]:
                noise, square, add = (*at, decay**2, fresh) if even else at
                before = square * after + add
                return before * (noise / (before + noise)), before

            rest = (white,) if even else (white, decay**2, fresh)
            _, before = jax.lax.scan(variances, self.noise_slow**2, rest)
            gain, total = before / (before + white), before + jnp.where(on, white, 0.0)
            onward = decay if even else jnp.concatenate([decay[1:], decay[-1:]])
            keep, push = onward * (1 - gain), (onward * gain)[:, None] * signals
            first = jnp.zeros(signals.shape[1])
            _, mean = jax.lax.scan(lambda m, at: (at[0] * m + at[1], m), first, (keep, push))
            e = jnp.where(on[:, None], (signals - mean) / jnp.sqrt(total)[:, None], 0.0)
            return e, jnp.where(on, jnp.log(total), 0.0)

        if rows.shape[0] == 1:
            e, logs = record(rows[0], gap[0], setting.weight[0])
            return e[None], logs[None]
        return jax.lax.map(lambda at: record(*at), (rows, gap, setting.weight))

    def draw(self, setting: Setting, key: Array) -> Float[Array, "R T"]:
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
