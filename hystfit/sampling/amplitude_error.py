"""Error of weights over loops of an amplitude that was not fitted, from posteriors without single amplitudes and without several.

Noise and prior of the weights tell how well they are known if the model is true. How far it is not, loops show that are left out: the error
grows with the ratio of their amplitude to those fitted. Over the swing of the output it is described by fractional Brownian motion
(Mandelbrot and Van Ness 1968, SIAM Rev. 10) in the logarithm of the amplitude that is zero at fitted amplitudes: it needs no length, and
no unit. Its one parameter is the variance of relative error over an e-fold of amplitude, known from as many values as amplitudes are left
out.
"""

from __future__ import annotations

import dataclasses
import itertools

import jax
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.problem import Problem
from hystfit.params.host_arrays import compiled
from hystfit.quality.held_out import FOLDS, correlation_length
from hystfit.quality.loops import APART, clear_reversals, distinct, extents
from hystfit.sampling.noise_grid import NoiseGrid
from hystfit.sampling.posterior import Posterior
from hystfit.sampling.truncated_normal import draw_truncated
from hystfit.sampling.weight_equations import WeightEquations, parameters_of, weight_equations, weight_priors

_STROKES = 2  # of each amplitude, on average, where amplitudes were chosen: a closed loop has so many
# Exponent of the fractional Brownian motion; 0.5 is a Wiener process. The errors of 38 loops left out, 28 of simulated devices of four
# kinds and 10 measured, have the largest likelihood for 0.87; its logarithm is at most 0.5 lower from 0.82 to 0.92, and 6 for 0.5.
_SMOOTH = 0.85
# Moves of the weights, after a tenth of them, for a mean with a small error beside the posterior's standard deviation.
_MOVES = 300


@dataclasses.dataclass(frozen=True)
class AmplitudeError:
    """Error of the posterior mean between and beyond fitted amplitudes."""

    levels: np.ndarray  # logarithms of the fitted swings of the input, rising
    variance: float  # of the error without noise over the output's swing, for an e-fold of amplitude
    # number of degrees of freedom with which it is known: the amplitudes left out, for the error of each has one cause
    freedom: int
    length: int  # samples over which the error is correlated

    @classmethod
    def of(cls, posterior: Posterior) -> AmplitudeError | None:
        """From posteriors without some of the amplitudes; the largest stays in all of them.

        None where weights were not sampled by "weights", where the records have one amplitude, or nearly as many as strokes, and where an
        input does not move.
        """
        if posterior.sampler != "weights":
            return None
        problem = posterior.result.problem.with_loss("linear")
        strokes = [Strokes.of(record.u) for record in problem.data]
        swings = np.concatenate([one.swings for one in strokes])
        levels = np.array(distinct(np.log(swings[swings > 0]), APART)[::-1])
        if (swings == 0).any() or levels.size < 2 or _STROKES * levels.size > swings.size:
            return None
        level = [np.abs(np.log(one.swings)[one.number, None] - levels).argmin(axis=1) for one in strokes]
        edges = np.unique(np.linspace(0, levels.size - 1, FOLDS + 1).round().astype(int))
        noise = sum(
            float(np.median(posterior[name])) ** 2 for name in ("noise_white", "noise_slow") if name in posterior.names
        )
        squares, gaps, lengths = [], [], []
        for first, last in itertools.combinations(edges, 2):
            held = [(of >= first) & (of < last) for of in level]
            weights = [np.where(mask, 0.0, record.weight) for mask, record in zip(held, problem.data, strict=True)]
            x = posterior_mean(posterior, problem.reweighted(weights))
            fitted = np.delete(levels, np.s_[first:last])
            for record, y, of, mask, one in zip(problem.data, problem.predict(x), level, held, strokes, strict=True):
                error, left = y - record.y, mask & record.used
                if left.any() and mask[record.used].all():
                    error = error - error[left].mean()  # the record's own offset is not known
                for number in np.unique(of[left]):
                    on = left & (of == number)
                    swing = one.swing_of(record.y, record.used)[on]
                    excess = max(np.mean(error[on] ** 2) - noise, 0.0)
                    squares.append(excess / max(np.mean(swing**2), noise))
                    gaps.append(_gap(levels[number], fitted))
                    lengths.append(correlation_length(error[on]))
        # Not a mean of ratios: what is left over small gaps is noise for the most part.
        variance = float(np.sum(squares) / np.sum(gaps))
        return cls(levels, variance, levels.size - 1, int(np.median(lengths)))

    def sd(self, u: np.ndarray, y: np.ndarray) -> Float[np.ndarray, " T"]:
        """Standard deviation of the error over an input u with output y, shapes (T,) [y]."""
        strokes = Strokes.of(u)
        gaps = np.array([_gap(np.log(swing), self.levels) if swing else 0.0 for swing in strokes.swings])
        return np.sqrt(self.variance * gaps[strokes.number]) * strokes.swing_of(y, np.full(y.size, True))


def _gap(level: float, fitted: np.ndarray) -> float:
    """Variance at a level of fractional Brownian motion of unit variance over a unit that is zero at fitted levels, rising."""
    if np.abs(fitted - level).min() <= APART:
        return 0.0
    at, zeros = level - fitted[0], fitted[1:] - fitted[0]
    together = _covariance(at, zeros)
    known = together @ np.linalg.solve(_covariance(zeros[:, None], zeros), together) if zeros.size else 0.0
    return float(_covariance(at, at) - known)


def _covariance(a: np.ndarray | float, b: np.ndarray | float) -> np.ndarray:
    """Of fractional Brownian motion at a and b."""
    power = lambda distance: np.abs(distance) ** (2 * _SMOOTH)
    return np.asarray(0.5 * (power(a) + power(b) - power(np.subtract(a, b))))


@dataclasses.dataclass(frozen=True)
class Strokes:
    """Branches of an input between clear reversals."""

    edges: np.ndarray  # first sample of each, and the end, shape (K + 1,)
    number: np.ndarray  # of the stroke of every sample, shape (T,)
    # change of the input over each, shape (K,); of the first and the last at least that of their neighbor
    swings: np.ndarray

    @classmethod
    def of(cls, u: np.ndarray) -> Strokes:
        """Strokes of an input, shape (T,)."""
        edges = np.concatenate([[0], clear_reversals(u), [u.size]])
        return cls(edges, np.repeat(np.arange(edges.size - 1), np.diff(edges)), _swings(u, edges))

    def swing_of(self, y: np.ndarray, used: np.ndarray) -> Float[np.ndarray, " T"]:
        """Change of an output over the stroke of each sample, by the samples that are used, shapes (T,)."""
        return _swings(np.where(used, y, np.nan), self.edges)[self.number]


def _swings(values: np.ndarray, edges: np.ndarray) -> Float[np.ndarray, " K"]:
    """Range of values over each stroke; those that the ends of a record cut off have at least that of their neighbor."""
    swings = extents(values, edges)
    if swings.size > 1:
        swings[0], swings[-1] = swings[:2].max(), swings[-2:].max()
    return swings


def posterior_mean(posterior: Posterior, problem: Problem) -> Float[np.ndarray, " p"]:
    """Mean of the weights given the samples of a problem, with the median noise and smoothness of a posterior and default priors."""
    x, size = posterior.result.x, float(problem.scales.y)
    noise = {name: float(np.median(posterior[name])) for name in posterior.names if name.startswith("noise_")}
    unit, grid = noise["noise_white"], NoiseGrid.one()
    if "noise_slow" in noise:
        unit = noise["noise_slow"]
        grid = NoiseGrid.one((noise["noise_white"] / unit) ** 2, noise["noise_time"])
    equations = weight_equations(problem, x, grid, weight_priors(problem, x, None), size)
    strength = float(np.median(posterior.stats["smoothness"])) * posterior.result.problem.used.sum()
    w = np.asarray(_mean(equations, (unit / size) ** 2, strength, jax.random.key(posterior.seed)))
    return parameters_of(problem.space, w, size)


@compiled
def _mean(equations: WeightEquations, variance: Array, strength: Array, key: Array) -> Array:
    """Mean of the weights with one noise and one strength of the penalty, shape (p,)."""
    slope, precision = equations.conditional(0, variance, strength)
    draws = draw_truncated(key, equations.inside, slope, precision, equations.bounded, _MOVES)
    return draws[_MOVES // 10 :].mean(axis=0)
