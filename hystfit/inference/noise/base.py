"""What every noise model provides.

A noise model is a filter over the samples of a record: `step` takes a residual and returns its innovation scaled to unit variance
and the log of the variance. A likelihood therefore costs O(T) and can share the scan of the hysteresis model.
"""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hystfit.inference.noise.setting import Setting
from hystfit.inference.priors import AbstractPrior
from hystfit.models.shared.shapes import Scalar, State
from hystfit.outcome import Code

LOG_2PI = math.log(2 * math.pi)


@dataclasses.dataclass(frozen=True)
class ResidualScales:
    """Scales of the residuals of a fit, from which noise models take their starting values.

    Attributes:
        total: standard deviation [y].
        white, slow: its split into independent and slow noise, from the differences of neighboring samples [y].
        time: integrated autocorrelation time, samples.
        count: number of residuals.
        center, spread: median, and median absolute deviation from it [y].
    """

    total: float
    white: float
    slow: float
    time: float
    count: int
    center: float
    spread: float

    @property
    def start_time(self) -> float:
        """Correlation time from which a search starts, samples."""
        return float(np.clip(self.time / 2, 2.0, self.count / 4))

    @classmethod
    def of(cls, rows: list[np.ndarray], time: float) -> ResidualScales:
        """Scales of the residuals that count, one array per record [y], with their integrated autocorrelation time in samples."""
        together, differences = np.concatenate(rows), np.concatenate([np.diff(row) for row in rows])
        total = max(float(np.std(together)), 1e-12)  # residuals may all be zero
        rough = float(np.std(differences)) / np.sqrt(2) if differences.size else 0.5 * total
        white = float(np.clip(rough, 0.05 * total, 0.95 * total)) if differences.size else rough
        center = float(np.median(together))
        spread = float(np.median(np.abs(together - center)))
        return cls(total, white, float(np.sqrt(total**2 - white**2)), time, together.size, center, spread)


class AbstractNoise(eqx.Module):
    """A noise model; its parameters are declared like those of a hysteresis model.

    Class attributes:
        name: by which users choose it.
        gaussian: whether the innovations are Gaussian.
        by_squares: the density follows from the weighted sum of squares alone; such a model has `of_squares`.
        has_shapes: the noise includes `columns`.
        parts: names of the standard deviations of white and of slow noise and of the correlation time; None without both parts.
        covers: findings about residuals that its likelihood allows for.
    """

    name: ClassVar[str]
    gaussian: ClassVar[bool] = True
    by_squares: ClassVar[bool] = False
    has_shapes: ClassVar[bool] = False
    parts: ClassVar[tuple[str, str, str] | None] = None
    covers: ClassVar[frozenset[Code]] = frozenset()

    @abc.abstractmethod
    def init(self) -> State:
        """State of the filter before the first sample."""

    @abc.abstractmethod
    def step(self, state: State, r: Scalar, gap: Scalar, weight: Scalar) -> tuple[State, Scalar, Scalar]:
        """One sample: (state, innovation scaled to unit variance, log variance). The state ignores samples of weight 0."""

    def start_of(self, count: int) -> Float[Array, "..."]:
        """`init` for several signals that are filtered at once."""
        return jnp.broadcast_to(self.init(), (count, *self.init().shape))

    def steps(
        self, state: Float[Array, "..."], signals: Float[Array, " m"], gap: Scalar, weight: Scalar
    ) -> tuple[Float[Array, "..."], Float[Array, " m"], Scalar]:
        """`step` of several signals of one record, from a state of `start_of`."""
        state, e, logs = jax.vmap(self.step, in_axes=(0, 0, None, None))(state, signals, gap, weight)
        return state, e, logs[0]

    @abc.abstractmethod
    def whiten(
        self, setting: Setting, rows: Float[Array, "R T k"]
    ) -> tuple[Float[Array, "R T k"], Float[Array, "R T"]]:
        """Filter k signals at once: (innovations scaled to unit variance, log variances), 0 where the weight is 0."""

    @abc.abstractmethod
    def draw(self, setting: Setting, key: Array) -> Float[Array, "R T"]:
        """A realization."""

    @classmethod
    @abc.abstractmethod
    def start(cls, scales: ResidualScales) -> AbstractNoise:
        """Starting values from the residuals of a fit."""

    @classmethod
    @abc.abstractmethod
    def of_size(cls, size: float) -> AbstractNoise:
        """Typical values for noise of standard deviation `size` [y], with which calibrations simulate."""

    @classmethod
    def default_priors(cls, longest: int, curve_size: float | None) -> dict[str, AbstractPrior]:
        """Priors that depend on the data, by parameter; the others come from the declarations.

        Args:
            longest: samples of the longest record.
            curve_size: standard deviation of curves over the input that the residuals suggest [y]; None where they suggest none.
        """
        return {}

    def density(self, e: Float[Array, "..."], log_variance: Float[Array, "..."]) -> Float[Array, "..."]:
        """Log density of a residual from its scaled innovation and the log variance."""
        return -0.5 * (e**2 + log_variance + LOG_2PI)

    def columns(self, setting: Setting) -> Float[Array, "R T k"]:
        """Shapes that the noise adds with independent weights of unit variance, the same in every record; none by default."""
        return jnp.zeros((*setting.weight.shape, 0))

    def of_squares(self, setting: Setting, total: Scalar) -> Scalar:
        """Log density from the weighted sum of squared residuals, where `by_squares` is set."""
        raise TypeError(f"{type(self).__name__} needs each residual")

    def gaussian_scale(self) -> Scalar:
        """Standard deviation of the Gaussian white noise with the same Fisher information about the mean [y].

        Only for noise that is not Gaussian; by numerical integration unless a closed form overrides it.
        """
        one, unit = jnp.ones(()), jnp.zeros(())
        log_variance = self.step(self.init(), unit, one, one)[2]
        e = jnp.linspace(-60.0, 60.0, 24_001)
        log_p = lambda value: self.density(value, log_variance)
        slope, p = jax.vmap(jax.grad(log_p))(e), jnp.exp(jax.vmap(log_p)(e))
        information = jnp.trapezoid(slope**2 * p, e) / jnp.trapezoid(p, e)
        return jnp.exp(0.5 * log_variance) / jnp.sqrt(information)

    def predictive(
        self, new: Setting, key: Array, seen: Setting, residual: Float[Array, "R T"]
    ) -> Float[Array, "Q T2"]:
        """Noise of a further measurement given the residuals of the fitted ones.

        By default the residuals decide the form of its distribution where the model is Gaussian, by resampled innovations, and
        nothing else; a model with shapes of its own, or that is not Gaussian, draws a realization.

        Args:
            new: the records to predict.
            key: of the random numbers.
            seen: the fitted records.
            residual: measurement less prediction over them [y].
        """
        if self.has_shapes or not self.gaussian:
            return self.draw(new, key)
        return self.with_innovations_of(self.whiten(seen, residual[..., None])[0][..., 0], seen, new, key)

    def with_innovations_of(
        self, e: Float[Array, "R T"], seen: Setting, new: Setting, key: Array
    ) -> Float[Array, "Q T2"]:
        """Noise over `new` records, less its shapes, whose innovations have the distribution of those, e, over the `seen` ones."""
        values = resample(e.reshape(-1), (seen.weight > 0).reshape(-1), new.weight.shape, key)
        return drive(self.step, self.init(), new, values)

    def log_density(self, setting: Setting, r: Float[Array, "R T"]) -> Scalar:
        """Log density of the residuals that count."""
        return self.integrated(setting, r, jnp.zeros((*r.shape, 0)), jnp.zeros(0))[0]

    def integrated(
        self, setting: Setting, r: Float[Array, "R T"], signals: Float[Array, "R T k"], precision: Float[Array, " k"]
    ) -> tuple[Scalar, Float[Array, " k"], Float[Array, "k k"]]:
        """log of the integral over w of exp(log density of r - signals w, less w' diag(precision) w / 2), and the density of w there.

        Returns:
            The logarithm, less k log(2 pi) / 2; and b and L, lower triangular, for which L'w is normal about b with unit covariance.
        """
        on, k = setting.weight > 0, signals.shape[-1]
        columns = jnp.concatenate([self.columns(setting), signals], axis=-1)
        e, logs = self.whiten(setting, jnp.concatenate([r[..., None], columns], axis=-1))
        plain = jnp.sum(jnp.where(on, self.density(e[..., 0], logs), 0.0))
        count = columns.shape[-1]
        if not count:
            return plain, jnp.zeros(0), jnp.zeros((0, 0))
        shapes, residual = e[..., 1:].reshape(-1, count), e[..., 0].reshape(-1)
        own = jnp.concatenate([jnp.ones(count - k), precision])
        value, half, factor = _integral(plain, shapes.T @ residual, shapes.T @ shapes, own)
        return value, half[count - k :], factor[count - k :, count - k :]


def integral(
    plain: Scalar, products: Float[Array, "m m"], precision: Float[Array, " k"]
) -> tuple[Scalar, Float[Array, " k"], Float[Array, "k k"]]:
    """`AbstractNoise.integrated` of Gaussian noise by products of whitened signals, first the residual; `plain`: log density at zero."""
    return _integral(plain - 0.5 * products[0, 0], products[1:, 0], products[1:, 1:], precision)


def _integral(plain: Array, pull: Array, gram: Array, precision: Array) -> tuple[Array, Array, Array]:
    factor = jnp.linalg.cholesky(jnp.diag(precision) + gram)
    half = jax.scipy.linalg.solve_triangular(factor, pull, lower=True)
    return plain + 0.5 * jnp.sum(half**2) - jnp.sum(jnp.log(jnp.diag(factor))), half, factor


def resample(
    e: Float[Array, " n"], on: Bool[Array, " n"], shape: tuple[int, ...], key: Array
) -> Float[Array, "*shape"]:
    """Independent values with the distribution of the innovations, of mean zero and unit variance: a smoothed bootstrap.

    Innovations of Gaussian noise are normal. Those of noise with spikes have a narrow middle and heavy tails: normal ones give bands of 90
    % that cover 92 to 97 %, and resampled ones keep the form of the noise, its size and its correlation (Stoffer and Wall 1991; Davison and
    Hinkley 1997, chapter 6). A normal kernel (Silverman 1986, sections 3.4 and 6.4) gives few residuals their tails.
    """
    count = jnp.sum(on)
    mean = jnp.sum(jnp.where(on, e, 0.0)) / count
    deviation = jnp.where(on, e - mean, 0.0)
    unit = deviation / jnp.maximum(jnp.sqrt(jnp.sum(deviation**2) / count), jnp.finfo(e.dtype).tiny)
    low, high = jnp.nanquantile(jnp.where(on, unit, jnp.nan), jnp.array([0.25, 0.75]))
    width = 0.9 * jnp.minimum(1.0, (high - low) / 1.34) * count**-0.2
    first, second = jax.random.split(key)
    chosen = jax.random.choice(first, unit, shape, p=on / count)
    return (chosen + width * jax.random.normal(second, shape)) / jnp.sqrt(1 + width**2)


def drive(
    step: Callable[[State, Scalar, Scalar, Scalar], tuple[State, Scalar, Scalar]],
    state: State,
    setting: Setting,
    e: Float[Array, "R T"],
) -> Float[Array, "R T"]:
    """The noise [y] whose innovations e, of unit variance, are given; `step` is affine in the residual, and all weights are positive."""

    def sample(state: State, at: tuple[Array, ...]) -> tuple[State, Array]:
        e, gap, weight = at
        _, of_zero, log_variance = step(state, jnp.zeros(()), gap, weight)
        r = jnp.exp(0.5 * log_variance) * (e - of_zero)
        return step(state, r, gap, weight)[0], r

    gap = jnp.broadcast_to(setting.gap, setting.weight.shape)
    return jax.vmap(lambda *rows: jax.lax.scan(sample, state, rows)[1])(e, gap, setting.weight)
