"""Slow and independent noise on the host: Ornstein-Uhlenbeck and white noise by tridiagonal algebra, O(T), without compilation.

The likelihood is that of `OrnsteinUhlenbeck`; every default fit needs it, and should not wait for a compilation. All residuals here
are weighted: multiplied by the square root of their weight.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
import scipy  # loads its subpackages when they are first used, which optimize is not in most fits
from jaxtyping import Float
from scipy.linalg.lapack import dpttrf, dpttrs

from hystfit.inference.blocks import gram, parts, qr
from hystfit.inference.newton import LONGEST
from hystfit.inference.noise.even_noise import EvenRows
from hystfit.inference.noise.setting import Setting

POINTS = 12  # inducing points of curves over the input
_RATIOS = (1e-2, 1.0, 1e2)  # of white to slow variance, tried before the search
_LEAST, _MOST = 1e-6, 1e6  # of that ratio
_SHORTEST = 0.2  # correlation time, samples
_STENCIL = 0.15 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1]])
_PARTS = (1.0, 0.4, 2.0)  # of a Newton step, of which the best is taken
_NEWTONS, _NO_GAIN = 20, 1e-4  # steps, and decrease of -2 log likelihood below which they end
_FLAT = 0.05  # least curvature that limits a step
_WIDEST = 1.0  # largest standard deviation of the logs of ratio and time in the average


@dataclasses.dataclass(frozen=True)
class Samples:
    """The samples that count, n of those of shape (R, T) in which `on` is true, record after record.

    `gap` is the time since the one before, in typical sampling intervals, infinite at the first of a record; `place` the input as a
    fraction of its range; `rising` tells whether the input last rose.
    """

    on: np.ndarray
    gap: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]
    place: Float[np.ndarray, " n"]
    rising: np.ndarray

    @classmethod
    def of(cls, setting: Setting) -> Samples:
        """The samples of a batch that count."""
        weight, place, rising = (np.asarray(v) for v in (setting.weight, setting.place, setting.rising))
        on = weight > 0
        time = np.cumsum(np.broadcast_to(np.asarray(setting.gap), weight.shape), axis=1)
        gaps = [np.diff(row[used], prepend=-np.inf) for row, used in zip(time, on, strict=True)]
        return cls(on, np.maximum(np.concatenate(gaps), 1e-6), weight[on], place[on], rising[on])

    def by_record(self, values: np.ndarray) -> list[np.ndarray]:
        """Values of these samples, shape (n,), record by record."""
        return by_record(values, self.on)

    def precision(self, time: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Inverse of the slow part's correlation matrix, which is tridiagonal: (diagonal, beside it, log determinant of the matrix)."""
        fresh = -np.expm1(-2 * self.gap / time)
        decay = np.exp(-self.gap[1:] / time)
        diagonal = 1 / fresh
        diagonal[:-1] += decay**2 / fresh[1:]
        return diagonal, -decay / fresh[1:], float(np.sum(np.log(fresh)))


def by_record(values: np.ndarray, on: np.ndarray) -> list[np.ndarray]:
    """Values of the samples that count, shape (n,), record by record; `on` says which do, shape (R, T), bool."""
    return np.split(values, np.cumsum(on.sum(axis=1))[:-1])


@dataclasses.dataclass(frozen=True)
class SlowNoise:
    """Ornstein-Uhlenbeck and white noise of one set of records, and perhaps random curves on top."""

    samples: Samples  # where
    white: float  # white, slow: standard deviations, in the unit of the residuals
    slow: float
    time: float  # correlation time of the slow part, typical sampling intervals
    # columns with independent weights of standard deviation `loop`, shape (n, k); k may be 0
    shapes: Float[np.ndarray, "n k"]
    loop: float = 0.0  # see `shapes`
    length: float = 1.0  # length scale of the shapes in the input, relative to its range

    @property
    def parameters(self) -> dict[str, float]:
        """By the names of `hystfit.inference.noise`."""
        values = {"noise_white": self.white, "noise_slow": self.slow, "noise_time": self.time}
        return values | ({"noise_loop": self.loop} if self.shapes.shape[1] else {})

    def solve(self, rows: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """The inverse covariance, without the shapes', times each column."""
        return slow_solver(self.samples, (self.white / self.slow) ** 2, self.time)[0](rows) / self.slow**2

    def apply(self, rows: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """The covariance times each column."""
        diagonal, beside, _ = self.samples.precision(self.time)
        root = np.sqrt(self.samples.weight)[:, None]
        factored = dpttrf(diagonal, beside)
        plain = self.slow**2 * root * dpttrs(*factored[:2], root * rows)[0] + self.white**2 * rows
        return plain + self.loop**2 * self.shapes @ (self.shapes.T @ rows) if self.shapes.shape[1] else plain


def slow_solver(samples: Samples, ratio: float, time: float) -> tuple[Callable[[np.ndarray], np.ndarray], float]:
    """X -> inverse of (correlation of the slow part + ratio) times X for weighted columns X, and the log determinant of that matrix.

    The ratio is that of white to slow variance, the time that of the slow part in typical sampling intervals.
    """
    diagonal, beside, log_slow = samples.precision(time)
    pivots, below, _ = dpttrf(diagonal + samples.weight / ratio, beside)
    root = np.sqrt(samples.weight)[:, None] / ratio

    def solve(rows: np.ndarray) -> np.ndarray:
        return rows / ratio - root * dpttrs(pivots, below, root * rows)[0]

    return solve, samples.gap.size * float(np.log(ratio)) + log_slow + float(np.sum(np.log(pivots)))


@dataclasses.dataclass(frozen=True)
class SlowNoiseFit:
    """Slow and independent noise estimated from residuals: the most probable one, and others about it by their posterior weights."""

    noise: SlowNoise
    others: tuple[SlowNoise, ...]
    shares: Float[np.ndarray, " m"]

    def projected(self, basis: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "p p"]:
        """basis' Sigma basis, averaged over the uncertainty of the noise."""
        averaged = lambda columns: sum(
            share * noise.apply(columns) for share, noise in zip(self.shares, self.others, strict=True)
        )
        return gram([basis], averaged)


@dataclasses.dataclass(frozen=True)
class Contrasts:
    """The restricted likelihood of slow and independent noise (Patterson and Thompson 1971), which allows for the fitted parameters.

    It is that of one fit, or of N fits on the same samples, whose residuals and bases then have a leading axis.
    """

    samples: Samples  # the samples
    residual: Float[np.ndarray, "*N n"]  # of the fit, shape (..., n)
    # orthonormal columns that span its derivatives, shape (..., n, p): contrasts to them alone are used
    basis: Float[np.ndarray, "*N n p"]
    shapes: Float[np.ndarray, "n k"]  # see `SlowNoise`
    # mean square of the part of the residuals that the shapes describe; the prior of their variance is log-normal about the value that
    # gives this on average, because shapes too smooth for the residuals would otherwise grow without limit
    power: float = 0.0
    length: float = 1.0  # length scale of the shapes

    @functools.cached_property
    def _even(self) -> list[EvenRows] | None:
        lead = self.residual.shape[:-1]
        columns = [self.basis, self.residual[..., None], np.broadcast_to(self.shapes, (*lead, *self.shapes.shape))]
        return EvenRows.of(columns, self.samples.gap, self.samples.weight)

    @functools.cached_property
    def expected(self) -> Float[np.ndarray, "*N"]:
        """Variance of the shapes' weights for which `power` remains on average, after the fit has absorbed its part."""
        along, n = self.basis.swapaxes(-1, -2) @ self.shapes, self.residual.shape[-1]
        absorbed = lambda part: self.basis[..., part, :] @ along
        squares = (
            np.sum((self.shapes[part] - absorbed(part)) ** 2, axis=(-2, -1)) for part in parts(n, self.shapes.shape[1])
        )
        return np.asarray(self.power * n / sum(squares))

    def at(
        self, ratio: Float[np.ndarray, "*N m"], time: Float[np.ndarray, "*N m"], fits: np.ndarray | None = None
    ) -> tuple[Float[np.ndarray, "*N m"], Float[np.ndarray, "*N m"], Float[np.ndarray, "*N m"]]:
        """(-2 log likelihood, variance of the slow part, that of the shapes' weights) at m ratios of white to slow variance, and times.

        Both variances follow in closed form or on a grid: the former is the best one, the latter a mean over its posterior. With `fits` of
        some of the fits alone, by their numbers.
        """
        n, p = self.basis.shape[-2:]
        joint, log_det = self._joint(ratio, time, fits)
        inside = joint[..., :p, :p]
        trace = np.trace(inside, axis1=-2, axis2=-1)
        factor = np.linalg.cholesky(inside + 1e-12 * trace[..., None, None] * np.eye(p))
        half = np.linalg.solve(factor, joint[..., :p, p:])
        inner = joint[..., p:, p:] - half.swapaxes(-1, -2) @ half
        log_det = log_det + 2 * np.sum(np.log(np.diagonal(factor, axis1=-2, axis2=-1)), axis=-1)
        if inner.shape[-1] == 1:
            square = np.maximum(inner[..., 0, 0], 1e-300) / (n - p)
            return (n - p) * np.log(square) + log_det, square, np.zeros(square.shape)
        size, axes = np.linalg.eigh(inner[..., 1:, 1:])
        size, score = np.maximum(size, 0.0)[..., None, :], (inner[..., :1, 1:] @ axes)
        expected = self.expected if fits is None else self.expected[fits]
        strength = np.geomspace(1e-3, 1e6, 91) / size[..., -1]  # variance of the weights over that of the slow part
        shrunk = 1 + strength[..., None] * size
        left = inner[..., 0, 0, None] - np.sum(strength[..., None] * score**2 / shrunk, axis=-1)
        square = np.maximum(left, 1e-300) / (n - p)
        value = (n - p) * np.log(square) + np.sum(np.log(shrunk), axis=-1) + log_det[..., None]
        value = value + np.log(strength * square / expected[..., None, None]) ** 2  # a factor e either way
        least = value.min(axis=-1)
        share = np.exp(-0.5 * (value - least[..., None]))
        share /= share.sum(axis=-1, keepdims=True)
        return least, np.sum(share * square, axis=-1), np.sum(share * strength * square, axis=-1)

    def _joint(
        self, ratio: Float[np.ndarray, "*N m"], time: Float[np.ndarray, "*N m"], fits: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """X' M^-1 X of basis, residual and shapes, shape (..., m, k, k), and log det M, shape (..., m)."""
        if self._even is not None:
            grams, log_dets = zip(*(rows.at(ratio, time, fits) for rows in self._even), strict=True)
            return np.sum(grams, axis=0), np.sum(log_dets, axis=0)
        if self.residual.ndim == 1:
            return self._one([self.basis, self.residual, self.shapes], ratio, time)
        numbers = range(len(self.residual)) if fits is None else fits.tolist()
        rows = [
            self._one([self.basis[k], self.residual[k], self.shapes], *point)
            for k, *point in zip(numbers, ratio, time, strict=True)
        ]
        return np.stack([joint for joint, _ in rows]), np.stack([log_det for _, log_det in rows])

    def _one(self, columns: list[np.ndarray], ratio: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        solvers = [slow_solver(self.samples, *point) for point in zip(ratio, time, strict=True)]
        joint = [gram(columns, solve) for solve, _ in solvers]
        return np.stack(joint), np.array([log_det for _, log_det in solvers])


def fit_slow_noise(contrasts: Contrasts) -> SlowNoiseFit:
    """The noise that maximizes the restricted likelihood, and those about it."""
    one = dataclasses.replace(contrasts, residual=contrasts.residual[None], basis=contrasts.basis[None])
    return fit_slow_noises(one)[0]


def fit_slow_noises(contrasts: Contrasts) -> list[SlowNoiseFit]:
    """`fit_slow_noise` of N fits, side by side."""
    samples, (count, n) = contrasts.samples, contrasts.residual.shape
    low, high = np.log([_LEAST, _SHORTEST]), np.log([_MOST, 4.0 * n])
    inside = lambda at: np.moveaxis(np.exp(np.clip(at, low, high)), -1, 0)
    times = np.log(np.geomspace(1.0, max(n / 4, 4.0), 5))
    tried = np.stack(np.meshgrid(np.log(_RATIOS), times, indexing="ij"), -1).reshape(-1, 2)
    center, least, axes = _minima(lambda at, fits: contrasts.at(*inside(at), fits)[0], tried, count, low, high)
    nodes, ideal = _nodes()
    about = center[:, None] + np.concatenate([np.zeros((count, 1, 2)), nodes @ axes.swapaxes(1, 2)], axis=1)
    values, slow, loop = contrasts.at(*inside(about))
    shares = ideal * np.exp(0.5 * (np.sum(nodes**2, axis=1) - (values[:, 1:] - least[:, None])))
    shapes, length = contrasts.shapes, contrasts.length

    def noise(ratio: float, time: float, slow: float, loop: float) -> SlowNoise:
        white = float(np.sqrt(ratio * slow))
        return SlowNoise(samples, white, float(np.sqrt(slow)), float(time), shapes, float(loop) ** 0.5, length)

    made = []
    for share, *rows in zip(shares, *inside(about), slow, loop, strict=True):
        first, *others = (noise(*one) for one in zip(*rows, strict=True))
        made.append(SlowNoiseFit(first, tuple(others), share / share.sum()))
    return made


def _minima(
    value: Callable[[np.ndarray, np.ndarray], np.ndarray],
    tried: np.ndarray,
    count: int,
    low: np.ndarray,
    high: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Minima of so many functions of two variables by Newton steps, their values, and the axes of exp(-value / 2) about each.

    `value` is that of some of the functions, by their numbers, at points (a, m, 2) of each, shape (a, m). Each search begins at the best of
    the points `tried`, and its center stays between `low` and `high`. Derivatives are differences on a stencil whose points, like all
    others, are computed together: that takes little longer than one.
    """
    going, axes = np.arange(count), np.zeros((count, 2, 2))
    center, least = _best(
        np.broadcast_to(tried, (count, *tried.shape)), value(np.broadcast_to(tried, (count, *tried.shape)), going)
    )
    for number in range(_NEWTONS + 1):
        about = center[going, None] + _STENCIL
        beside = value(about, going)
        slope, curvature = _derivatives(least[going], beside)
        size, ways = np.linalg.eigh(curvature)
        axes[going] = ways * np.minimum(1 / np.sqrt(np.maximum(0.5 * size, 1e-12)), _WIDEST)[:, None]
        if number == _NEWTONS:
            break
        step = -ways @ (ways.swapaxes(1, 2) @ slope[..., None] / np.maximum(np.abs(size), _FLAT)[..., None])
        step *= np.minimum(1.0, LONGEST / np.maximum(np.abs(step).max(axis=(1, 2), keepdims=True), 1e-300))
        taken = center[going, None] + np.array(_PARTS)[:, None] * step.swapaxes(1, 2)
        points = np.clip(np.concatenate([taken, about], axis=1), low, high)
        values = np.concatenate([value(points[:, : len(_PARTS)], going), beside], axis=1)
        new, lower = _best(points, values)
        better = least[going] - lower >= _NO_GAIN
        going = going[better]
        if not going.size:
            break
        center[going], least[going] = new[better], lower[better]
    return center, least, axes


def _best(points: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The point of each row where its value is least, and that value."""
    at = np.arange(len(values)), np.argmin(values, axis=1)
    return points[at], values[at]


def _derivatives(at: np.ndarray, beside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients (N, 2) and Hessians (N, 2, 2) from the values at points (N,) and at `_STENCIL` about them (N, 6)."""
    h, (a, b, c, d, e, g) = _STENCIL[0, 0], beside.T
    cross = (e + g - a - b - c - d + 2 * at) / (2 * h**2)
    curvature = np.array([[(a + b - 2 * at) / h**2, cross], [cross, (c + d - 2 * at) / h**2]])
    return np.stack([a - b, c - d], axis=-1) / (2 * h), np.moveaxis(curvature, -1, 0)


def _nodes() -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, " m"]]:
    """Nodes and weights of a 3 x 3 Gauss-Hermite rule for a standard normal density."""
    at, weight = np.polynomial.hermite_e.hermegauss(3)
    return np.stack(np.meshgrid(at, at), -1).reshape(-1, 2), np.outer(weight, weight).ravel() / (2 * np.pi)


def least_squares_root(
    fit: SlowNoiseFit, jacobian: Float[np.ndarray, "n p"], *, overwrite: bool = False
) -> Float[np.ndarray, "k p"]:
    """R with (R'R)^-1 the covariance of a least-squares estimate under this noise, J^+ Sigma J^+'; k is the smaller of n and p.

    From J = Q T: R = L^-1 T with L L' = Q' Sigma Q, so that directions that J does not determine stay undetermined in R. With `overwrite`,
    J may be destroyed to save its size in memory.
    """
    Q, T = qr(jacobian, overwrite=overwrite)
    size = np.linalg.norm(T, axis=0)
    size[size == 0] = 1.0
    factor = np.linalg.cholesky(fit.projected(Q))
    return scipy.linalg.solve_triangular(factor, T / size, lower=True) * size
