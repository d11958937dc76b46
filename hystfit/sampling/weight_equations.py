"""The posterior of hundreds of linear weights: normal equations at a grid of noises, bounds, and the smoothness penalty as a prior."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hystfit.errors import ParameterError
from hystfit.inference.blocks import gram
from hystfit.inference.noise.slow_likelihood import Samples, SlowNoiseFit, slow_solver
from hystfit.inference.priors import AbstractPrior, HalfNormal, Normal, choose_priors
from hystfit.inference.problem import Problem
from hystfit.inference.weights import smoothness_penalty
from hystfit.params.host_arrays import to_device

_STEPS = np.array([-2.4, -1.2, 0.0, 1.2, 2.4])  # of the grid of noises along each axis, in standard deviations
_INSIDE = 0.1  # of the mean weight, at which a chain starts where the estimate is zero


class WeightEquations(eqx.Module):
    """Normal equations of weights w about an estimate, the outputs in units of `size`, at m noises of the same variance unit.

    Given noise number k of variance s and a strength of the penalty, w has the density exp(-q_k(w) / 2s - strength w'R w / 2 - w'D w / 2
    + d'w) on w >= 0 where `bounded`, with q_k(w) the squares of the residuals, whitened by that noise.

    Attributes:
        estimate: about which the equations are expanded, shape (p,).
        squares: q_k(estimate), shape (m,).
        slopes, grams: half its gradient and half its curvature, shapes (m, p) and (m, p, p).
        log_dets: log determinants of the noises' covariances over their variance, shape (m,).
        roughness: R, shape (p, p).
        penalized: rank of R.
        precision: diagonal of D: priors of the weights without a penalty, shape (p,).
        pull: d, shape (p,).
        bounded: which weights are >= 0, shape (p,).
        count: number of samples.
    """

    estimate: Float[Array, " p"]
    squares: Float[Array, " m"]
    slopes: Float[Array, "m p"]
    grams: Float[Array, "m p p"]
    log_dets: Float[Array, " m"]
    roughness: Float[Array, "p p"]
    penalized: Float[Array, ""]
    precision: Float[Array, " p"]
    pull: Float[Array, " p"]
    bounded: Bool[Array, " p"]
    count: Float[Array, ""]

    def conditional(self, number: Any, variance: Any, strength: Any) -> tuple[Float[Array, " p"], Float[Array, "p p"]]:
        """s and P of the weights' density exp(-w'P w / 2 + s'w) for number and variance of the noise, and a strength of the penalty."""
        gram = self.grams[number]
        precision = gram / variance + strength * self.roughness + jnp.diag(self.precision)
        return (gram @ self.estimate - self.slopes[number]) / variance + self.pull, precision

    @property
    def inside(self) -> Float[Array, " p"]:
        """The estimate, moved inside its bounds, shape (p,)."""
        w, bounded = self.estimate, self.bounded
        mean = jnp.sum(jnp.where(bounded, w, 0.0)) / jnp.maximum(jnp.sum(bounded), 1)
        return jnp.where(bounded, jnp.maximum(w, _INSIDE * mean), w)


@dataclasses.dataclass(frozen=True)
class NoiseGrid:
    """Noises among which the sampler moves, on a grid about the most probable one.

    Attributes:
        ratios: of white to slow variance, shape (m,); None for independent noise.
        times: correlation times, typical sampling intervals, shape (m,).
    """

    ratios: np.ndarray | None
    times: np.ndarray

    @classmethod
    def about(cls, fit: SlowNoiseFit | None) -> NoiseGrid:
        """Along the principal axes of the logarithms of both about the noise of a fit; one independent noise where that is None."""
        if fit is None:
            return cls(None, np.zeros(1))
        place = lambda noise: np.log([(noise.white / noise.slow) ** 2, noise.time])
        center, others = place(fit.noise), np.array([place(noise) for noise in fit.others])
        # Nodes of a 3 x 3 Gauss-Hermite rule: the neighbors of the middle one lie at sqrt(3) standard deviations.
        first, second = (others[5] - others[4]) / np.sqrt(3), (others[7] - others[4]) / np.sqrt(3)
        at = center + (_STEPS[:, None, None] * first + _STEPS[None, :, None] * second).reshape(-1, 2)
        return cls(np.exp(at[:, 0]), np.exp(at[:, 1]))

    def solvers(self, samples: Samples) -> list[tuple[Any, float]]:
        """For each noise: the inverse covariance over the variance times columns, and the log determinant."""
        if self.ratios is None:
            return [(lambda rows: rows, 0.0)]
        return [slow_solver(samples, ratio, time) for ratio, time in zip(self.ratios, self.times, strict=True)]

    def parameters(self, number: np.ndarray, variance: np.ndarray) -> np.ndarray:
        """Parameters of the noise model from numbers and variances [y^2], in the order of its declarations: shape (..., q)."""
        if self.ratios is None:
            return np.sqrt(variance)[..., None]
        white = np.sqrt(variance * self.ratios[number])
        return np.stack([white, np.sqrt(variance), self.times[number]], axis=-1)


def weight_equations(
    problem: Problem, x: np.ndarray, grid: NoiseGrid, priors: Mapping[str, AbstractPrior], size: float
) -> WeightEquations:
    """The equations of a problem whose free parameters are all linear weights.

    Args:
        x: estimate, shape (p,).
        size: of the output, by which it is divided.
    """
    space = problem.space
    if not space.linear.all():
        names = [name for name, linear in zip(space.names, space.linear, strict=True) if not linear]
        raise ParameterError(
            f"sampler='weights' needs parameters in which the output is linear, and {', '.join(names[:4])} "
            f"{'is' if len(names) == 1 else 'are'} not: fix them, or use sampler='nuts'"
        )
    bounded = space.lower == 0
    if np.any(np.isfinite(space.upper)) or np.any(np.isfinite(space.lower) & ~bounded):
        raise ParameterError("sampler='weights' knows one bound, weights >= 0: use sampler='nuts'")
    roughness = smoothness_penalty(space, list(problem.data), x)
    penalized = np.diag(roughness) > 0
    precision, pull = _of_priors(problem, priors)
    residual, jacobian = problem.linearize(x)
    samples, root = Samples.of(problem.host_setting), np.sqrt(np.asarray(problem.objective.batch.weight))
    on = problem.used
    rows, r = (jacobian * root[..., None])[on], (residual * root)[on][:, None] / size
    joint, log_dets = [], []
    for solve, log_det in grid.solvers(samples):
        joint.append(gram([rows, r], solve))
        log_dets.append(log_det)
    grams = np.stack(joint)
    device = to_device
    return WeightEquations(
        estimate=device(x / size),
        squares=device(grams[:, -1, -1]),
        slopes=device(grams[:, :-1, -1]),
        grams=device(grams[:, :-1, :-1]),
        log_dets=device(np.array(log_dets)),
        roughness=device(roughness),
        penalized=device(float(penalized.sum())),
        precision=device(precision * size**2),
        pull=device(pull * size),
        bounded=device(bounded),
        count=device(float(on.sum())),
    )


def weight_priors(
    problem: Problem, x: np.ndarray, given: Mapping[str, AbstractPrior] | None
) -> dict[str, AbstractPrior]:
    """Priors by name: the user's own, which multiply a penalty, and the default ones of weights without a penalty.

    Raises:
        ParameterError: see `choose_priors`.
    """
    space, own = problem.space, set(given or {})
    penalized = np.diag(smoothness_penalty(space, list(problem.data), x)) > 0
    rows = zip(space.names, choose_priors(space, given, x), penalized, strict=True)
    return {name: prior for name, prior, smooth in rows if not smooth or {name, name.partition("@")[0]} & own}


def _of_priors(problem: Problem, priors: Mapping[str, AbstractPrior]) -> tuple[np.ndarray, np.ndarray]:
    """Precision, and precision times mean, of the priors of all weights; zero for those with a penalty alone."""
    precision, pull = np.zeros((2, len(problem.space)))
    for name, prior in priors.items():
        k = problem.space.names.index(name)
        if isinstance(prior, Normal):
            precision[k], pull[k] = float(prior.sd) ** -2.0, float(prior.mean) / float(prior.sd) ** 2
        elif isinstance(prior, HalfNormal) and float(prior.edge) == 0 and prior.side > 0:
            precision[k] = float(prior.sd) ** -2.0
        else:
            raise ParameterError(
                f"sampler='weights' takes normal priors, and half-normal ones from zero; that of {name} is {prior}: use sampler='nuts'"
            )
    return precision, pull
