"""The posterior of a fit prepared for sampling: noise model, priors, mode and curvature."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.errors import DataError, ParameterError
from hystfit.fitting.noise_refinement import refine
from hystfit.inference.correlated_priors import CorrelatedPriors, Dependence
from hystfit.inference.density import Density
from hystfit.inference.fittable import check_smooth
from hystfit.inference.newton import Optimum, maximize
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.priors import WIDE, AbstractPrior
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import ResidualAnalysis, analyze, diagnose
from hystfit.outcome import Code, Note
from hystfit.outcome.note import has, warn
from hystfit.params.coordinates import BOTH, LOWER, UPPER
from hystfit.params.host_arrays import compiled, to_device
from hystfit.params.space import ParameterSpace
from hystfit.results.result import FitResult
from hystfit.sampling.linear_part import LinearPart
from hystfit.sampling.target import Target, log_posterior

MOST = 100  # parameters beyond which sampling is refused
_RECURS = "part of the residuals recurs every loop: the model is incomplete, and its parameters are biased by more than chance. "
_WIDENS = "noise='discrepancy' widens the intervals for this error"
_WIDENED = "The intervals are widened for this error"
_OUTER = 0.01  # level of a prior, on either side, beyond which a search starts anew from its median
_OFF = 3.0  # factor in the length of an axis beyond which it is corrected
_AROUND = 200  # normal draws about the mode, for standard deviations of parameters to a twentieth
_WIDEST = 3.0  # standard deviation in v given at first to a direction without curvature


@dataclasses.dataclass(frozen=True)
class Prepared:
    """A posterior prepared for a sampler."""

    problem: Problem  # model and data as they were fitted, with noise model and priors
    noise: str  # the choice of the noise model, as users write it
    notes: tuple[Note, ...]  # what was chosen, and why

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return self.problem.names

    @property
    def priors(self) -> dict[str, AbstractPrior]:
        """Priors by name."""
        return dict(zip(self.names, self.problem.priors, strict=True))

    @property
    def dependence(self) -> Dependence | None:
        """Of the priors on each other; None where they are independent."""
        return self.problem.dependence

    def physical(self, z: np.ndarray) -> np.ndarray:
        """x of draws z, shape (chains, draws, d)."""
        return np.asarray(_physical(self.problem.density, to_device(z.reshape(-1, z.shape[-1])))).reshape(z.shape)


@dataclasses.dataclass(frozen=True)
class Setup(Prepared):
    """A posterior over the coordinates of `target`, which is centered on the mode and whitened by the curvature there."""

    target: Target

    def log_density(self, z: np.ndarray) -> np.ndarray:
        """Log posterior over z of draws, shape (chains, draws, d); that of a target contains the slopes of its coordinates."""
        rows = to_device(z.reshape(-1, z.shape[-1]))
        return np.asarray(log_posterior(self.target.density, rows)).reshape(z.shape[:-1])


@compiled
def _physical(density: Density, z: Array) -> Array:
    return jax.vmap(density.physical)(z)


def choose_noise(residuals: ResidualAnalysis, choice: str | type[AbstractNoise]) -> tuple[Any, list[Note]]:
    """The noise model to use, and notes on the choice; "auto" takes slow noise unless the residuals need another."""
    diagnosis = diagnose(residuals)
    if choice != "auto":
        mismatches = diagnosis.objections(NOISES.find(choice))  # type: ignore[arg-type]
        return choice, [
            dataclasses.replace(note, text=f"noise={choice!r} was chosen, but {note.text}") for note in mismatches
        ]
    name = diagnosis.recommended if diagnosis.recommended in ("discrepancy", "student-t") else "ou"
    reasons = "; ".join(note.text for note in diagnose(residuals, name).findings)
    if diagnosis.recommended == "iid":
        reasons = "the default, which includes independent noise"
    return name, [Note(Code.NOISE_MODEL, f"noise model {name}: {reasons}")]


def prepare(
    result: FitResult,
    *,
    noise: str | type[AbstractNoise] = "auto",
    priors: Mapping[str, AbstractPrior] | None = None,
    by_residuals: bool = True,
) -> Setup:
    """Prepare the posterior of a fit: noise model, priors (both as in `sample`), mode and curvature.

    An evidence needs priors without `by_residuals`: residuals then do not suggest the size of model error.
    """
    check_smooth(result.problem.space, "sampling")
    problem = result.problem.with_loss("linear")
    if len(problem.space) > MOST:
        raise ParameterError(
            f"{len(problem.space)} free parameters are too many for this sampler (at most {MOST}): use sampler='weights' for linear "
            "weights, or fix most of them"
        )
    residuals = analyze(problem, result.x)
    choice, notes = choose_noise(residuals, noise)
    if has(diagnose(residuals).findings, Code.REPEATING_RESIDUALS):
        widths = _WIDENED if NOISES.label(choice) == "discrepancy" else _WIDENS
        notes.append(warn(Code.INCOMPLETE, f"{_RECURS}{widths}; a model with more terms removes it"))
    refined = refine(problem, result.x, choice)
    longest = max(row.size for row in residuals.rows)
    suggested = refined.noise.default_priors(longest, residuals.curve_size if by_residuals else None)
    own = {name: prior for name, prior in suggested.items() if name in refined.space.names}
    x = np.concatenate([refined.x, refined.values])
    given = priors if isinstance(priors, CorrelatedPriors) else dict(priors or {})
    problem = refined.problem.with_noise(refined.noise, own | given, x).trimmed()
    z = np.concatenate([inside(problem.space, refined.x), inside(refined.space, refined.values)])
    if not np.isfinite(problem.log_prior(z)):
        rows = zip(problem.names, problem.priors, x, strict=True)
        outside = [name for name, prior, v in rows if not np.isfinite(float(prior.log_density(jnp.asarray(v))))]
        raise ParameterError(
            f"the fit lies outside the prior of {', '.join(outside)}: widen it, or fit again within it"
        )
    widths = to_device(_widths(problem, refined.root))
    central = _within_priors(problem, x)
    starts = [z] if np.array_equal(central, x) else [z, problem.unconstrained(central)]
    targets = [Target.about(problem.density, to_device(start), widths) for start in starts]
    modes = [(target, *whiten_by_curvature(Optimum(*_mode(target)))) for target in targets]
    target, center, factor, value = max(modes, key=lambda mode: np.nan_to_num(mode[-1], nan=-np.inf))
    if not np.isfinite(value):
        raise DataError("the posterior is not finite at the fit: check the status and the notes of the fit first")
    target = checked(target.whitened(to_device(center), to_device(factor)))
    return Setup(problem, NOISES.label(choice), tuple(notes), target)


def given_others(setup: Setup, key: Array) -> Setup:
    """The posterior in the coordinates of `LinearPart`, which straighten ridges along linear parameters; the same where there are none."""
    normal = np.asarray(jax.random.normal(key, (_AROUND, len(setup.names))))
    z = np.asarray(setup.target.unwhitened(np.concatenate([np.zeros_like(normal[:1]), normal])))
    deviations = setup.physical(z[None, 1:])[0].std(axis=0)
    linear = LinearPart.of(setup.problem, z[0], deviations[: len(setup.problem.space)])
    return setup if linear is None else dataclasses.replace(setup, target=setup.target.given_others(linear))


def inside(space: ParameterSpace, x: np.ndarray) -> np.ndarray:
    """z, with parameters that lie on a bound moved to where a mode can be found."""
    z, kinds = space.unconstrained(space.clip(x)), space.kinds
    one_sided = (kinds == LOWER) | (kinds == UPPER)
    return np.where(one_sided, np.maximum(z, np.log(1e-4)), np.where(kinds == BOTH, np.clip(z, -9, 9), z))


def _within_priors(problem: Problem, x: np.ndarray) -> np.ndarray:
    """x with the medians of the priors where it lies far out: least squares may end anywhere along what the data leave open."""
    low, middle, high = np.transpose([prior.quantiles([_OUTER, 0.5, 1 - _OUTER]) for prior in problem.priors])
    return np.where((x < low) | (x > high), middle, x)


def _widths(problem: Problem, root: np.ndarray) -> np.ndarray:
    """Widths of the bends of weights with one bound: their deviations given the others, natural sizes; `root` of the information."""
    space = problem.space
    soft = space.linear & ((space.kinds == LOWER) | (space.kinds == UPPER))
    precision = np.sum((root * space.scale) ** 2, axis=0) + WIDE**-2
    return np.pad(np.where(soft, 1 / np.sqrt(precision), 0.0), (0, len(problem.names) - soft.size))


@compiled
def _mode(target: Target) -> tuple[Array, ...]:
    """The mode over the coordinates for sampling, by Newton steps from the target's center: the fields of an `Optimum`."""
    return tuple(maximize(target.log_density, target.center, target.slope))


def whiten_by_curvature(mode: Optimum) -> tuple[np.ndarray, np.ndarray, float]:
    """(center, factor, log posterior) from an `Optimum`: factor factor' = inverse curvature, bounded where there is hardly any."""
    curvature = -np.asarray(mode.hessian)
    curvature = np.where(np.isfinite(curvature), curvature, 0.0)
    size, axes = np.linalg.eigh(0.5 * (curvature + curvature.T))
    return np.asarray(mode.z), axes / np.sqrt(np.maximum(size, _WIDEST**-2)), float(mode.value)


def checked(target: Target) -> Target:
    """The target with axes as long as the distance over which the log posterior falls by about 1/2.

    Curvature at a kink, or on a plateau that ends, does not give this distance: its mass matrix may be wrong by orders of magnitude.
    """
    for _ in range(10):  # each by at most a factor of ten
        fall = np.nan_to_num(np.asarray(_fall(target)), nan=np.inf)
        times = np.clip(np.sqrt(0.5 / np.maximum(fall, 1e-12)), 0.1, 10.0)
        times = np.where(np.maximum(times, 1 / times) > _OFF, times, 1.0)
        factor = np.asarray(target.factor)
        times = np.minimum(times, np.maximum(_WIDEST / np.linalg.norm(factor, axis=0), 1.0))
        if np.all(times == 1.0):
            break
        target = target.whitened(target.center, to_device(factor * times))
    return target


@compiled
def _fall(target: Target) -> Array:
    """Fall of the log posterior from the center to the ends of each axis, mean of either side, shape (d,)."""
    # One loop over the center and the ends, so that the density is compiled once.
    steps = jnp.concatenate([jnp.zeros_like(target.center)[None], target.factor.T, -target.factor.T])
    at = jax.lax.map(target.log_density, target.center + steps)
    return at[0] - at[1:].reshape(2, -1).mean(axis=0)
