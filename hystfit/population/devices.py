"""The first stage of a population: the likelihood of each device about its fit, and draws from it where it is not normal."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.fitting.noise_refinement import refine
from hystfit.inference.density import Density
from hystfit.inference.priors import AbstractPrior, LogitNormal, LogNormal, Normal
from hystfit.inference.problem import Problem
from hystfit.outcome import Severity, Status
from hystfit.params.coordinates import BOTH, LOWER, REAL
from hystfit.params.host_arrays import compiled
from hystfit.params.space import ParameterSpace
from hystfit.population.hierarchy import Pool
from hystfit.results.result import FitResult
from hystfit.sampling.sample import sample

_WIDER = 3.0  # of the prior of a device's own draws over the spread of the population, so that its tails are drawn too
_TRIED = 200  # draws whose likelihood is computed
DRAWS = 2000  # of a device's own posterior, at most


@dataclasses.dataclass(frozen=True)
class Common:
    """The coordinates z of all devices, those of the first: natural scales of single records do not enter. `at`: what scatters."""

    space: ParameterSpace
    at: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """Names of these parameters, without records."""
        return tuple(self.space.names[k].partition("@")[0] for k in self.at)

    def z_of(self, x: Float[np.ndarray, "... p"]) -> Float[np.ndarray, "... p"]:
        """z from physical values of these parameters."""
        full = self._among(x, self.space.vector(self.space.template))
        return np.asarray(self.space.coordinates.unconstrained(full, 1e-6, np))[..., self.at]

    def x_of(self, z: Float[np.ndarray, "... p"]) -> Float[np.ndarray, "... p"]:
        """Physical values from z."""
        return np.asarray(self.space.coordinates.physical(self._among(z), np))[..., self.at]

    def slope(self, z: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """dx/dz."""
        return np.asarray(self.space.coordinates.slope(self._among(z), np))[self.at]

    def precision(self, information: Float[np.ndarray, "q q"], z: Float[np.ndarray, " p"]) -> Float[np.ndarray, "p p"]:
        """Precision in z, about z, from the information about all parameters of a device, physical: the others are integrated out."""
        slope = self.slope(z)
        return slope[:, None] * marginal(information, self.at) * slope[None, :]

    def _among(self, values: np.ndarray, others: np.ndarray | float = 0.0) -> np.ndarray:
        """Values of all parameters of the space: of these, and `others` elsewhere."""
        full = np.empty((*values.shape[:-1], len(self.space)))
        full[...] = others
        full[..., self.at] = values
        return full

    def priors(self, mean: np.ndarray, sd: np.ndarray) -> dict[str, AbstractPrior]:
        """Independent priors over physical values that are normal in z."""
        space, middle = self.space, self.x_of(mean)
        priors: dict[str, AbstractPrior] = {}
        for k, name, x, width in zip(self.at, self.names, middle, sd, strict=True):
            low, high, kind = float(space.lower[k]), float(space.upper[k]), space.kinds[k]
            if kind == REAL:
                priors[name] = Normal(float(x), float(space.scale[k] * width))
            elif kind == BOTH:
                priors[name] = LogitNormal(low, high, float(x), float(width))
            else:
                edge, side = (low, 1.0) if kind == LOWER else (high, -1.0)
                priors[name] = LogNormal(side * (float(x) - edge), float(width), edge, side)
        return priors


@dataclasses.dataclass(frozen=True)
class Device:
    """One device."""

    name: str  # of the device
    result: FitResult  # its fit
    problem: Problem  # with the noise model of its residuals, whose parameters stay at their estimates
    noise: str  # name of that noise model
    x: np.ndarray  # maximum of the likelihood under that noise, all free parameters, physical
    # mean, precision: of the normal approximation of the likelihood in the common coordinates, shapes (p,) and (p, p); parameters that do
    # not scatter between devices (an offset of each record) are integrated out
    mean: np.ndarray
    precision: np.ndarray

    @classmethod
    def of(cls, name: str, result: FitResult, common: Common) -> Device:
        """From the fit of a device."""
        noise = result.noise.name if result.noise.refines else "ou" if result.noise.parameters else "iid"
        refined = refine(result.problem.with_loss("linear"), result.x, noise)
        mean = common.z_of(refined.x[common.at])
        precision = common.precision(refined.root.T @ refined.root, mean)
        return cls(name, result, refined.problem, noise, refined.x, mean, precision)

    def log_weights(self, z: Float[np.ndarray, "n p"], common: Common) -> Float[np.ndarray, " n"]:
        """Log likelihood at draws less that of the normal approximation."""
        x = np.tile(self.x, (len(z), 1))
        x[:, common.at] = common.x_of(z)
        own = self.problem.space.clip(x)
        density, noise = self.problem.density, self.problem.noise_space
        assert noise is not None
        held = noise.unconstrained(noise.vector(self.problem.noise))
        exact = np.asarray(_log_likelihoods(density, jnp.asarray(own), jnp.asarray(held)))
        away = z - self.mean
        return exact + 0.5 * np.einsum("ni,ij,nj->n", away, self.precision, away)

    def effective(self, z: Float[np.ndarray, "n p"], common: Common) -> float:
        """Effective fraction of draws of the population when they are weighted by the full likelihood, 0 to 1."""
        tried = z[np.linspace(0, len(z) - 1, min(_TRIED, len(z))).astype(int)]
        weights = self.log_weights(tried, common)
        weights = np.exp(weights - np.nanmax(weights))
        weights = np.where(np.isfinite(weights), weights, 0.0)
        return float(weights.sum() ** 2 / np.sum(weights**2) / len(tried))

    def pool(self, mean: np.ndarray, sd: np.ndarray, common: Common, seed: int) -> Pool:
        """Draws from its own posterior, with a prior a few times wider than the population."""
        priors = common.priors(mean, _WIDER * sd)
        posterior = sample(self.result, "independence", noise=self.noise, priors=priors, seed=seed)
        flat = posterior.draws.reshape(-1, len(posterior.names))[:, common.at]
        flat = flat[np.linspace(0, len(flat) - 1, min(DRAWS, len(flat))).astype(int)]
        z = common.z_of(flat)
        failed = posterior.status is Status.NOT_CONVERGED
        problems = tuple(
            dataclasses.replace(note, text=f"{self.name}: {note.text}")
            for note in posterior.notes
            if failed and note.severity is Severity.WARNING
        )
        return Pool(z, -0.5 * np.sum(((z - mean) / (_WIDER * sd)) ** 2, axis=1), problems)


def marginal(information: Float[np.ndarray, "q q"], at: np.ndarray) -> Float[np.ndarray, "p p"]:
    """Information about the parameters at these positions, with the others integrated out."""
    others = np.setdiff1d(np.arange(len(information)), at)
    inner = information[np.ix_(at, at)]
    if others.size:
        cross = information[np.ix_(at, others)]
        inner = inner - cross @ np.linalg.pinv(information[np.ix_(others, others)], hermitian=True) @ cross.T
    return inner


@compiled
def _log_likelihoods(density: Density, x: Array, noise: Array) -> Array:
    """Log likelihood at each row of physical x, shape (n, p), with the parameters of the noise held."""
    coordinates = density.objective.coordinates
    return jax.lax.map(lambda row: density.log_likelihood(jnp.concatenate([coordinates.unconstrained(row), noise])), x)


def effects_of(covariates: Mapping[str, Any], names: tuple[str, ...]) -> tuple[np.ndarray, dict[str, float]]:
    """Design matrix (a column of ones, then centered covariates), and the means of the covariates."""
    columns, means = [np.ones(len(names))], {}
    for label, values in covariates.items():
        column = np.array([float(values[name]) for name in names])
        means[label] = float(column.mean())
        columns.append(column - column.mean())
    return np.stack(columns, axis=1), means
