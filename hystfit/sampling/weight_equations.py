"""The posterior of hundreds of linear weights: normal equations at a grid of noises, bounds, and the smoothness penalty as a prior."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hystfit.errors import ParameterError
from hystfit.inference.blocks import gram
from hystfit.inference.density import Density
from hystfit.inference.noise.slow_likelihood import Samples
from hystfit.inference.priors import AbstractPrior, HalfNormal, Normal, choose_priors
from hystfit.inference.problem import Problem
from hystfit.inference.weights import smoothness_penalty
from hystfit.models.shared.shapes import Scalar
from hystfit.params.host_arrays import to_device
from hystfit.params.space import ParameterSpace
from hystfit.sampling.noise_grid import NoiseGrid
from hystfit.sampling.setup import inside

_INSIDE = 0.1  # of the mean weight, at which a chain starts where the estimate is zero


class WeightEquations(eqx.Module):
    """Normal equations of weights w about an estimate, the outputs in units of `size`, at m noises of the same variance unit.

    Given noise number k of variance s and a strength of the penalty, w has the density exp(-q_k(w) / 2s - strength w'R w / 2 - w'D w / 2
    + d'w) on w >= 0 where `bounded`, with q_k(w) the squares of the residuals, whitened by that noise. Among w are also the other
    parameters, as unconstrained coordinates, in which the residuals are not linear: `exact` then corrects the density.
    """

    estimate: Float[Array, " p"]  # about which the equations are expanded
    squares: Float[Array, " m"]  # q_k(estimate)
    slopes: Float[Array, "m p"]  # slopes, grams: half its gradient and half its curvature
    grams: Float[Array, "m p p"]
    log_dets: Float[Array, " m"]  # log determinants of the noises' covariances over their variance
    log_shares: Float[Array, " m"]  # of the noises in the posterior, up to a constant
    roughness: Float[Array, "p p"]  # R
    penalized: Float[Array, ""]  # rank of R
    precision: Float[Array, " p"]  # diagonal of D: priors of the weights without a penalty
    pull: Float[Array, " p"]  # d
    bounded: Bool[Array, " p"]  # which weights are >= 0
    count: Float[Array, ""]  # number of samples
    exact: Exact | None = None  # the density without linearization; None where the residuals are linear in all of w

    def conditional(self, number: Any, variance: Any, strength: Any) -> tuple[Float[Array, " p"], Float[Array, "p p"]]:
        """s and P of the weights' density exp(-w'P w / 2 + s'w) for number and variance of the noise, and a strength of the penalty."""
        gram = self.grams[number]
        precision = gram / variance + strength * self.roughness + jnp.diag(self.precision)
        return (gram @ self.estimate - self.slopes[number]) / variance + self.pull, precision

    def square(self, w: Float[Array, " p"], number: Any) -> Scalar:
        """q_k(w) for noise number k."""
        away = w - self.estimate
        return jnp.maximum(self.squares[number] + (2 * self.slopes[number] + self.grams[number] @ away) @ away, 0.0)

    def fit(self, square: Any, number: Any, variance: Any) -> Scalar:
        """Log likelihood of noise number `number` with a variance, up to a constant; `square` is that of the weights."""
        return -0.5 * (self.log_dets[number] + self.count * jnp.log(variance) + square / variance)

    def log_prior(self, w: Float[Array, " p"]) -> Scalar:
        """Log prior without the penalty, up to a constant."""
        return self.pull @ w - 0.5 * jnp.sum(self.precision * w**2)

    def excess(self, w: Float[Array, " p"], number: Any, variance: Any, fit: Any) -> Scalar:
        """Log of the exact density over that of the equations, whose log likelihood is `fit`, up to a constant."""
        if self.exact is None:
            return jnp.zeros(())
        others = jnp.where(self.exact.linear, 0.0, w)
        return self.exact.log_density(w, number, variance) - fit - self.log_prior(others)

    @property
    def inside(self) -> Float[Array, " p"]:
        """The estimate, moved inside its bounds by a tenth of the mean weight, shape (p,)."""
        w, bounded = self.estimate, self.bounded
        mean = jnp.sum(jnp.where(bounded, w, 0.0)) / jnp.maximum(jnp.sum(bounded), 1)
        return jnp.where(bounded, jnp.maximum(w, _INSIDE * mean), w)


class Exact(eqx.Module):
    """The density over w of a model with parameters in which its output is not linear, up to a constant; priors of these alone."""

    density: Density
    grid: NoiseGrid
    linear: Bool[Array, " p"]
    priors: tuple[AbstractPrior | None, ...]
    size: float

    @classmethod
    def of(cls, problem: Problem, grid: NoiseGrid, priors: Mapping[str, AbstractPrior], size: float) -> Exact | None:
        """That of a problem with the noise model of the grid; None where all its parameters are weights."""
        linear = problem.space.linear
        if linear.all():
            return None
        rows = zip(problem.space.names, linear, strict=True)
        others = tuple(None if weight else priors[name] for name, weight in rows)
        return cls(problem.density, grid, to_device(linear), others, size)

    def log_density(self, w: Float[Array, " p"], number: Any, variance: Any) -> Scalar:
        """Log likelihood given a noise of the grid, and log prior of the parameters that are not weights."""
        coordinates, z = self.density.objective.coordinates, jnp.where(self.linear, 0.0, w)
        x = jnp.where(self.linear, w * self.size, coordinates.physical(z))
        noise = self.grid.parameters(number, variance * self.size**2, jnp)
        stretch = jnp.log(coordinates.slope(z))
        rows = ((prior.log_density(x[k]) + stretch[k]) for k, prior in enumerate(self.priors) if prior is not None)
        return sum(rows, self.density.log_likelihood_of(jnp.concatenate([x, noise])))


def are_free_or_positive(space: ParameterSpace) -> bool:
    """Whether zero is the only bound of weights, from below."""
    low, high = space.lower[space.linear], space.upper[space.linear]
    return not np.any(np.isfinite(high) | (np.isfinite(low) & (low != 0)))


def parameters_of(space: ParameterSpace, w: Float[np.ndarray, "... p"], size: float) -> Float[np.ndarray, "... p"]:
    """Physical parameters of a model from w."""
    return np.where(space.linear, w * size, space.physical(w))


def weight_equations(
    problem: Problem, x: np.ndarray, grid: NoiseGrid, priors: Mapping[str, AbstractPrior], size: float
) -> WeightEquations:
    """The equations of a problem about x, (p,), outputs over `size`; `priors` are of weights without a penalty and of other parameters."""
    space, linear = problem.space, problem.space.linear
    bounded = linear & (space.lower == 0)
    if not are_free_or_positive(space):
        raise ParameterError("sampler='weights' supports only the bound 0 (weights >= 0): use sampler='nuts'")
    z = inside(space, x)
    x = np.where(linear, x, space.physical(z))
    unit = np.where(linear, 1.0, space.slope(z) / size)
    roughness = smoothness_penalty(space, list(problem.data), x)
    penalized = np.diag(roughness) > 0
    precision, pull = _of_priors(problem, priors, size)
    residual, jacobian = problem.linearize(x)
    root, on = np.sqrt(np.asarray(problem.objective.batch.weight)), problem.used
    rows, r = (jacobian * unit * root[..., None])[on], (residual * root)[on][:, None] / size
    joint, log_dets = [], []
    for solve, log_det in grid.solvers(Samples.of(problem.host_setting)):
        joint.append(gram([rows, r], solve))
        log_dets.append(log_det)
    grams = np.stack(joint)
    device = to_device
    return WeightEquations(
        estimate=device(np.where(linear, x / size, z)),
        squares=device(grams[:, -1, -1]),
        slopes=device(grams[:, :-1, -1]),
        grams=device(grams[:, :-1, :-1]),
        log_dets=device(np.array(log_dets)),
        log_shares=device(grid.log_shares),
        roughness=device(roughness),
        penalized=device(float(penalized.sum())),
        precision=device(precision),
        pull=device(pull),
        bounded=device(bounded),
        count=device(float(on.sum())),
    )


def weight_priors(
    problem: Problem, x: np.ndarray, given: Mapping[str, AbstractPrior] | None
) -> dict[str, AbstractPrior]:
    """Priors by name: the user's own, which multiply a penalty, and the default ones of weights without a penalty."""
    space, own = problem.space, set(given or {})
    penalized = np.diag(smoothness_penalty(space, list(problem.data), x)) > 0
    rows = zip(space.names, choose_priors(space, given, x), penalized, strict=True)
    return {name: prior for name, prior, smooth in rows if not smooth or {name, name.partition("@")[0]} & own}


def _of_priors(problem: Problem, priors: Mapping[str, AbstractPrior], size: float) -> tuple[np.ndarray, np.ndarray]:
    """Precision, and precision times mean, of the priors of all w; zero for those with a penalty alone.

    That of a parameter in which the output is not linear is normal in its coordinate, and has the quantiles of the prior at one standard
    deviation to either side.
    """
    space = problem.space
    precision, pull = np.zeros((2, len(space)))
    for name, prior in priors.items():
        k = space.names.index(name)
        if not space.linear[k]:
            low, high = (inside(space, np.full(len(space), q))[k] for q in prior.quantiles([0.16, 0.84]))
            mean, sd = (low + high) / 2, (high - low) / 2
        elif isinstance(prior, Normal):
            mean, sd = float(prior.mean) / size, float(prior.sd) / size
        elif isinstance(prior, HalfNormal) and float(prior.edge) == 0 and prior.side > 0:
            mean, sd = 0.0, float(prior.sd) / size
        else:
            raise ParameterError(
                f"sampler='weights' takes normal priors, and half-normal ones from zero; that of {name} is {prior}: use sampler='nuts'"
            )
        precision[k], pull[k] = sd**-2, mean / sd**2
    return precision, pull
