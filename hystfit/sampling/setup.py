"""A posterior made ready for sampling: which noise, which priors, where its mode is and how it is curved there."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hystfit.data.batch import Batch
from hystfit.errors import DataError, ParameterError
from hystfit.fitting.again import problem_of
from hystfit.fitting.covariance import leftover
from hystfit.fitting.estimate import Estimate
from hystfit.fitting.released import refine_released
from hystfit.inference.newton import maximize
from hystfit.inference.noise import Setting
from hystfit.inference.priors import AbstractPrior, LogNormal, choose_priors
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import Leftover, diagnose
from hystfit.params.coordinates import BOTH, LOWER, UPPER
from hystfit.params.space import ParameterSpace
from hystfit.results.result import FitResult
from hystfit.sampling.target import Target

_MOST = 100  # parameters beyond which sampling is refused
_CURVE = 0.7  # standard deviation of the logarithm of a repeating error's size about what the residuals show of it
_WIDEST = 3.0  # standard deviation in z that a direction without curvature is given to start with


@dataclasses.dataclass(frozen=True)
class Setup:
    """A posterior made ready for sampling.

    Attributes:
        problem: model and data, as they were fitted.
        noise_name: which noise model.
        noise_space: its parameters.
        target: centered on the posterior's mode and whitened by the curvature there.
        names, units: of all parameters.
        notes: what was chosen, and why.
    """

    problem: Problem
    noise_name: str
    noise_space: ParameterSpace
    target: Target
    names: tuple[str, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...]

    def describe_priors(self) -> dict[str, str]:
        """Priors in words, by parameter."""
        return {name: str(prior) for name, prior in zip(self.names, self.target.priors, strict=True)}


def choose_noise(left: Leftover, asked: str) -> tuple[str, list[str]]:
    """The noise model to use and why: what was asked for, or for "auto" slow noise, unless the residuals call for more."""
    found = diagnose(left)
    if asked == "auto":
        name = found.recommended if found.recommended in ("discrepancy", "student-t") else "ou"
        plain = "the default, which holds independent noise as a case" if found.recommended == "iid" else ""
        return name, [f"noise model {name}: {plain or '; '.join(found.reasons)}"]
    return asked, [f"noise={asked!r} was asked for, but {why}" for why in found.objections(asked)]


def prepare(
    result: FitResult,
    *,
    noise: str = "auto",
    priors: Mapping[str, AbstractPrior] | None = None,
) -> Setup:
    """Make the posterior of a fit ready: noise model, priors, mode and curvature.

    Args:
        result: the fit; its data, free parameters and values are taken.
        noise: "auto", or a name of `hystfit.inference.noise.NOISES`.
        priors: the user's own, by parameter name; defaults for the others (`hystfit.inference.priors.default_priors`).

    Raises:
        ParameterError: an unknown name, a prior that is flat or excludes the fit, too many parameters.
    """
    problem, x = problem_of(result)
    if len(problem.space) > _MOST:
        raise ParameterError(
            f"{len(problem.space)} free parameters are too many to sample (at most {_MOST}): fix most of them, or fewer cells or plays"
        )
    left = leftover(problem, x)
    name, notes = choose_noise(left, noise)
    refined = refine_released(problem, Estimate(x, 0.0, True, "", 0, np.zeros(1)), name)
    space = refined.space
    values = np.concatenate([refined.x, refined.values])
    chosen = choose_priors_for(problem.space, space, noise_priors(space, left) | dict(priors or {}), values)
    z = np.concatenate([_inside(problem.space, refined.x), _inside(space, refined.values)])
    batch = trimmed(problem.objective.batch)
    objective = eqx.tree_at(lambda o: o.batch, problem.objective, batch)
    d = z.size
    start = Target(objective, space.coordinates, Setting.of(batch), chosen, jnp.asarray(z), jnp.eye(d))
    names, units = (*problem.space.names, *space.names), (*problem.space.units, *space.units)
    if not np.isfinite(float(start.log_prior(jnp.asarray(z)))):
        outside = [
            n
            for n, prior, v in zip(names, chosen, values, strict=True)
            if not np.isfinite(float(prior.log_density(jnp.asarray(v))))
        ]
        raise ParameterError(
            f"the fit lies outside the prior of {', '.join(outside)}: widen it, or fit again within it"
        )
    mode = find_mode(start)
    center, factor, value = whiten_by_curvature(mode)
    if not np.isfinite(value):
        raise DataError("the posterior is not finite at the fit: look at the fit's status and notes first")
    target = eqx.tree_at(lambda t: (t.center, t.factor), start, (jnp.asarray(center), jnp.asarray(factor)))
    return Setup(problem, name, space, target, names, units, tuple(notes))


def noise_priors(space: ParameterSpace, left: Leftover) -> dict[str, AbstractPrior]:
    """Defaults that the residuals decide.

    Noise slower than a third of the record is a constant, which the offset already is. An error that repeats is about as large as
    the residuals show: model and discrepancy explain each other, and without a prior that says so draws run off to
    errors of any size that the model makes good (Brynjarsdottir and O'Hagan 2014).
    """
    slowest = max(max(row.size for row in left.rows) / 3, 10.0)
    about = LogNormal(float(np.sqrt(slowest)), float(np.log(slowest)) / 4)  # one sample to the slowest: two sd each way
    found: dict[str, AbstractPrior] = {"noise_time": about}
    if left.curve_size is not None:
        found["noise_loop"] = LogNormal(left.curve_size, _CURVE)
    return {name: prior for name, prior in found.items() if name in space.names}


def choose_priors_for(
    model: ParameterSpace, noise: ParameterSpace, own: Mapping[str, AbstractPrior] | None, x: np.ndarray
) -> tuple[AbstractPrior, ...]:
    """Priors of both spaces, in their order; `own` may name parameters of either.

    Raises:
        ParameterError: see `hystfit.inference.priors.choose_priors`.
    """
    own = dict(own or {})
    theirs = {name: own.pop(name) for name in list(own) if name in noise.names}
    return choose_priors(model, own, x[: len(model)], noise.names) + choose_priors(noise, theirs, x[len(model) :])


def trimmed(batch: Batch) -> Batch:
    """A batch without padding that no record needs: a long run pays for its own compilation."""
    used = np.asarray(batch.weight) > 0
    end = int(np.max(np.flatnonzero(used.any(axis=0)))) + 1
    return jax.tree_util.tree_map(lambda v: v[:, :end], batch)


def _inside(space: ParameterSpace, x: np.ndarray) -> np.ndarray:
    """z with parameters that lie on a bound moved to where a mode can be found."""
    c = space.coordinates
    z = space.unconstrained(np.clip(x, np.asarray(c.lower), np.asarray(c.upper)))
    kind = np.asarray(c.kinds)
    one = (kind == LOWER) | (kind == UPPER)
    return np.where(one, np.maximum(z, np.log(1e-4)), np.where(kind == BOTH, np.clip(z, -9, 9), z))


@eqx.filter_jit
def _mode(target: Target) -> Any:
    return maximize(target.log_density, target.center, target.slope)


def find_mode(target: Target) -> Any:
    """The posterior's mode in z, by Newton steps from the target's center."""
    return _mode(target)


def whiten_by_curvature(mode: Any) -> tuple[np.ndarray, np.ndarray, float]:
    """(center, factor, log posterior) from an `Optimum`: factor factor' = inverse curvature, bounded where there is next to none."""
    curvature = -np.asarray(mode.hessian)
    curvature = np.where(np.isfinite(curvature), curvature, 0.0)
    size, axes = np.linalg.eigh(0.5 * (curvature + curvature.T))
    return np.asarray(mode.z), axes / np.sqrt(np.maximum(size, _WIDEST**-2)), float(mode.value)
