"""What a model leaves of a measurement, as a random process: the likelihoods of `fit`, `sample` and `calibrate`.

Every noise model is a filter over the samples of a record, so that a likelihood costs O(T) and may share the model's scan:
`step` takes a residual and gives its innovation, scaled to variance one, and the logarithm of the variance by which it was scaled.
"""

from __future__ import annotations

import abc
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.batch import Batch
from hystfit.errors import ParameterError
from hystfit.params import param

_LOG_2PI = float(np.log(2 * np.pi))
_NOTHING = 1e100  # variance of the measurement where there is none
_UNEVEN = 0.02  # deviation from even sampling, relative, below which the filters take one interval for all samples


class Setting(eqx.Module):
    """The data as a noise model sees them.

    Attributes:
        gap: time since the sample before, in typical sampling intervals, shape (R, T), or () where sampling is even.
        weight: shape (R, T), 0 where a sample does not count; white noise has variance white^2 / weight.
        place: input in parts of its range, 0 to 1, shape (R, T).
        rising: whether the input last rose, shape (R, T), bool.
        count: of the samples that count.
        log_weight: sum of the logarithms of their weights.
    """

    gap: Float[Array, "*samples"]
    weight: Float[Array, "R T"]
    place: Float[Array, "R T"]
    rising: Array
    count: Float[Array, ""]
    log_weight: Float[Array, ""]

    @classmethod
    def of(cls, batch: Batch) -> Setting:
        """The setting of a batch; records without time are taken as evenly sampled."""
        u, dt, weight = (np.asarray(v) for v in (batch.u, batch.dt, batch.weight))
        low, high = float(u.min()), float(u.max())
        typical = float(np.median(dt[dt > 0])) if (dt > 0).any() else 1.0
        gap = dt / typical if (dt > 0).any() else np.ones_like(dt)
        last = [int(np.flatnonzero(row)[-1]) if row.any() else 0 for row in weight]
        inside = np.concatenate([row[1 : end + 1] for row, end in zip(gap, last, strict=True)])
        even = bool(np.all(np.abs(inside - 1.0) < _UNEVEN))
        turning = np.sign(np.diff(u, axis=1, prepend=u[:, :1]))
        return cls(
            gap=jnp.asarray(1.0 if even else gap),
            weight=jnp.asarray(weight),
            place=jnp.asarray((u - low) / (high - low)),
            rising=jnp.asarray(np.stack([_held(row) for row in turning]) > 0),
            count=jnp.asarray(float(np.count_nonzero(weight))),
            log_weight=jnp.asarray(float(np.sum(np.log(weight[weight > 0])))),
        )


def _held(sign: np.ndarray) -> np.ndarray:
    """Signs with each zero replaced by the last sign before it, or the first after it."""
    known = np.flatnonzero(sign)
    if not known.size:
        return np.ones_like(sign)
    at = np.maximum.accumulate(np.where(sign != 0, np.arange(sign.size), known[0]))
    return sign[at]


class AbstractNoise(eqx.Module):
    """A noise model; its parameters are declared like those of a hysteresis model."""

    name: ClassVar[str]
    gaussian: ClassVar[bool]
    by_squares: ClassVar[bool] = (
        False  # the weighted sum of squares is all that the density needs: see `White.of_squares`
    )

    @abc.abstractmethod
    def init(self) -> Float[Array, " state"]:
        """State of the filter before the first sample."""

    @abc.abstractmethod
    def step(
        self, state: Float[Array, " state"], r: Float[Array, ""], gap: Float[Array, ""], weight: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""], Float[Array, ""]]:
        """One sample: (state, innovation scaled to variance one, log of its variance). Nothing is learnt where weight = 0."""

    def density(self, e: Float[Array, "..."], log_variance: Float[Array, "..."]) -> Float[Array, "..."]:
        """Log density of a residual from its scaled innovation and the log of the variance."""
        return -0.5 * (e**2 + log_variance + _LOG_2PI)

    def columns(self, setting: Setting) -> Float[Array, "R T k"] | None:
        """Shapes that the noise adds with independent weights of variance one, the same in every record; None for no such part."""
        return None

    @abc.abstractmethod
    def whiten(
        self, setting: Setting, rows: Float[Array, "R T k"]
    ) -> tuple[Float[Array, "R T k"], Float[Array, "R T"]]:
        """Apply the filter to k signals at once: (innovations scaled to variance one, logs of the variances); 0 where weight = 0."""

    @abc.abstractmethod
    def draw(self, setting: Setting, key: Array) -> Float[Array, "R T"]:
        """A realisation."""

    def log_density(self, setting: Setting, r: Float[Array, "R T"]) -> Float[Array, ""]:
        """Log density of the residuals that count."""
        columns = self.columns(setting)
        on = setting.weight > 0
        if columns is None:
            e, logs = self.whiten(setting, r[..., None])
            return jnp.sum(jnp.where(on, self.density(e[..., 0], logs), 0.0))
        e, logs = self.whiten(setting, jnp.concatenate([r[..., None], columns], axis=-1))
        plain = jnp.sum(jnp.where(on, self.density(e[..., 0], logs), 0.0))
        shapes, own = e[..., 1:].reshape(-1, columns.shape[-1]), e[..., 0].reshape(-1)
        factor = jnp.linalg.cholesky(jnp.eye(shapes.shape[1]) + shapes.T @ shapes)
        half = jax.scipy.linalg.solve_triangular(factor, shapes.T @ own, lower=True)
        return plain + 0.5 * jnp.sum(half**2) - jnp.sum(jnp.log(jnp.diag(factor)))


class White(AbstractNoise):
    """Independent Gaussian noise."""

    name: ClassVar[str] = "iid"
    gaussian: ClassVar[bool] = True
    by_squares: ClassVar[bool] = True
    noise_white: Float[Array, ""] = param(
        1.0, bounds=(0.0, np.inf), unit="y", scale=0.01, doc="standard deviation of independent noise"
    )

    def init(self) -> Float[Array, " state"]:
        """No state."""
        return jnp.zeros((0,))

    def step(
        self, state: Float[Array, " state"], r: Float[Array, ""], gap: Float[Array, ""], weight: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""], Float[Array, ""]]:
        """The residual itself."""
        safe = jnp.where(weight > 0, weight, 1.0)
        return state, r * jnp.sqrt(safe) / self.noise_white, 2 * jnp.log(self.noise_white) - jnp.log(safe)

    def whiten(
        self, setting: Setting, rows: Float[Array, "R T k"]
    ) -> tuple[Float[Array, "R T k"], Float[Array, "R T"]]:
        """Divide by the standard deviation."""
        on = setting.weight > 0
        safe = jnp.where(on, setting.weight, 1.0)
        e = rows * (jnp.where(on, jnp.sqrt(safe), 0.0) / self.noise_white)[..., None]
        return e, jnp.where(on, 2 * jnp.log(self.noise_white) - jnp.log(safe), 0.0)

    def of_squares(self, setting: Setting, total: Float[Array, ""]) -> Float[Array, ""]:
        """Log density of residuals from the sum of their squares, each times its weight."""
        each = jnp.log(self.noise_white) + 0.5 * _LOG_2PI
        return 0.5 * setting.log_weight - setting.count * each - 0.5 * total / self.noise_white**2

    def draw(self, setting: Setting, key: Array) -> Float[Array, "R T"]:
        """See `AbstractNoise.draw`."""
        return jax.random.normal(key, setting.weight.shape) * self._sd(setting)

    def _sd(self, setting: Setting) -> Array:
        on = setting.weight > 0
        return jnp.where(on, self.noise_white / jnp.sqrt(jnp.where(on, setting.weight, 1.0)), 0.0)


class StudentT(White):
    """Independent noise with heavy tails, Student's t of `noise_dof` degrees of freedom: outliers count little."""

    name: ClassVar[str] = "student-t"
    gaussian: ClassVar[bool] = False
    by_squares: ClassVar[bool] = False
    noise_dof: Float[Array, ""] = param(
        5.0, bounds=(1.0, np.inf), scale=4.0, doc="degrees of freedom; few mean heavy tails, many a Gaussian"
    )

    def density(self, e: Float[Array, "..."], log_variance: Float[Array, "..."]) -> Float[Array, "..."]:
        """Student's t with scale `noise_white`."""
        nu = self.noise_dof
        lead = jax.lax.lgamma(0.5 * (nu + 1)) - jax.lax.lgamma(0.5 * nu) - 0.5 * jnp.log(nu * jnp.pi)
        return lead - 0.5 * log_variance - 0.5 * (nu + 1) * jnp.log1p(e**2 / nu)

    def draw(self, setting: Setting, key: Array) -> Float[Array, "R T"]:
        """See `AbstractNoise.draw`."""
        return jax.random.t(key, self.noise_dof, setting.weight.shape) * self._sd(setting)


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


class LoopDiscrepancy(OrnsteinUhlenbeck):
    """Model error that repeats every loop: a Gaussian process in (input, direction), beside slow and independent noise.

    Squared-exponential covariance in the input with inducing points over its range, independent on rising and falling branches; its
    weights are integrated out. More cycles add nothing to what it hides, so errors stop falling with their number.
    """

    name: ClassVar[str] = "discrepancy"
    noise_loop: Float[Array, ""] = param(
        1.0, bounds=(0.0, np.inf), unit="y", scale=0.01, doc="standard deviation of the error that repeats"
    )
    noise_length: Float[Array, ""] = param(
        0.3, bounds=(0.08, 3.0), scale=0.3, doc="input over which that error changes, in parts of the range"
    )
    points: int = eqx.field(static=True, default=12)

    def columns(self, setting: Setting) -> Float[Array, "R T k"]:
        """Shapes of the inducing points on either branch."""
        shapes = self.noise_loop * inducing_shapes(setting.place, self.noise_length, self.points)
        up = setting.rising[..., None]
        return jnp.concatenate([jnp.where(up, shapes, 0.0), jnp.where(up, 0.0, shapes)], axis=-1)

    def draw(self, setting: Setting, key: Array) -> Float[Array, "R T"]:
        """See `AbstractNoise.draw`."""
        first, second = jax.random.split(key)
        return super().draw(setting, first) + self.columns(setting) @ jax.random.normal(second, (2 * self.points,))


def inducing_shapes(
    place: Float[Array, "*samples"], length: Float[Array, ""], points: int
) -> Float[Array, "*samples k"]:
    """Columns F with F F' close to the squared-exponential covariance of variance one over 0 <= place <= 1."""
    at = jnp.linspace(0.0, 1.0, points)
    cover = lambda a, b: jnp.exp(-0.5 * ((a[..., None] - b) / length) ** 2)
    factor = jnp.linalg.cholesky(cover(at, at) + 1e-8 * jnp.eye(points))
    flat = cover(place.reshape(-1), at)
    return jax.scipy.linalg.solve_triangular(factor, flat.T, lower=True).T.reshape(*place.shape, points)


NOISES: dict[str, type[AbstractNoise]] = {
    kind.name: kind for kind in (White, OrnsteinUhlenbeck, Ar1, StudentT, LoopDiscrepancy)
}


def make_noise(name: str) -> AbstractNoise:
    """A noise model by name, with default values.

    Raises:
        ParameterError: an unknown name; the message lists them.
    """
    if name not in NOISES:
        raise ParameterError(f"noise must be one of {', '.join(NOISES)}, got {name!r}")
    return NOISES[name]()


def starting_noise(name: str, residuals: list[np.ndarray], time: float) -> AbstractNoise:
    """A noise model with starting values read off residuals.

    Args:
        name: see `NOISES`.
        residuals: of each record, the samples that count, output units.
        time: their integrated autocorrelation time in samples.

    Raises:
        ParameterError: an unknown name.
    """
    noise = make_noise(name)
    together = np.concatenate(residuals)
    total = max(float(np.std(together)), 1e-12)
    rough = np.concatenate([np.diff(r) for r in residuals])
    white = float(np.clip(np.std(rough) / np.sqrt(2), 0.05 * total, 0.95 * total)) if rough.size else 0.5 * total
    slow = float(np.sqrt(total**2 - white**2))
    center, spread = np.median(together), np.median(np.abs(together - np.median(together)))
    values: dict[str, float] = {
        "noise_white": white,
        "noise_slow": slow,
        "noise_time": float(np.clip(time / 2, 2.0, together.size / 4)),
        "noise_loop": 0.5 * slow,
        "noise_length": 0.3,
    }
    if name == "iid":
        values["noise_white"] = total
    elif name == "ar1":
        values["noise_slow"] = total
    elif name == "student-t":
        values.update(noise_white=max(float(spread) * 1.2, 1e-3 * total, abs(float(center)) * 1e-9), noise_dof=5.0)
    fields = {k: jnp.asarray(v) for k, v in values.items() if hasattr(noise, k)}
    return eqx.tree_at(lambda n: [getattr(n, k) for k in fields], noise, list(fields.values()))
