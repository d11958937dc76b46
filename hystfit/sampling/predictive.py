"""Predictive draws: a further measurement, given what the fitted records determine of model and noise.

They include the uncertainty of the parameters; for a record that was not fitted, the spread of per-record parameters (the offset) over
the fitted records; and the noise: white and slow noise of stationary size, with innovations resampled from those of the fitted
records (`hystfit.inference.noise.base`), and a recurring error as the residuals determine it. Over a record that was not fitted they
include the error of many weights, which absorb part of the model's error at the fitted loops: between and beyond fitted amplitudes as
loops that are left out show (`hystfit.sampling.amplitude_error`), and otherwise that on the groups that the fit held out. Beyond that, no
error of the model at amplitudes, frequencies or levels that were not fitted is included.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import verb
from hystfit.data.batch import Batch
from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.inference.density import Density
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.noise.setting import Setting
from hystfit.inference.problem import Problem
from hystfit.inference.weights import free_columns
from hystfit.models.shared.simulation import run
from hystfit.params.coordinates import Coordinates
from hystfit.quality.held_out import correlation_length
from hystfit.quality.host_operators import recursion
from hystfit.results.result import FitResult
from hystfit.sampling.posterior import Posterior


@eqx.filter_jit
def simulate_rows(coordinates: Coordinates, x: Array, u: Array, dt: Array, numbers: Array) -> Array:
    """Outputs (n, T) at physical x, (n, p), over one input, each with the parameters that a record of these numbers has for itself."""
    return jax.lax.map(lambda row: run(coordinates.assemble(*row), u, dt)[0], (x, numbers))


@verb
def simulate_draws(result: FitResult, record: Record, x: np.ndarray, seed: int) -> Float[np.ndarray, "count T"]:
    """Outputs over a record's input at physical x, (count, p); for a record not fitted `seed` chooses whose own parameters each takes."""
    if record.t is None and not result.model.rate_independent:
        raise ModelError(f"{result.name} depends on time, and record {record.name!r} has none")
    arrays = (jnp.asarray(x), jnp.asarray(record.u), jnp.asarray(record.dt))
    known = result.is_fitted(record)
    numbers = np.random.default_rng(seed).integers(len(result.data), size=len(x))
    numbers = np.full(len(x), result.record_number(record)) if known else numbers
    if result.problem.closed_form:
        return _by_columns(result, record, x, numbers)
    coordinates = result.problem.space.coordinates
    if not (known or result.problem.settled):
        coordinates = coordinates.at(result.model.of_record(record))
    return np.asarray(simulate_rows(coordinates, *arrays, jnp.asarray(numbers)))


def _by_columns(result: FitResult, record: Record, x: np.ndarray, numbers: np.ndarray) -> Float[np.ndarray, "count T"]:
    """`simulate_draws` of a model that is linear in all free parameters, for the numbers of the records whose own parameters act."""
    design = result.model.design_matrix(record.u, record.dt)
    y = np.empty((len(x), len(record)))
    for number in np.unique(numbers):
        at = np.flatnonzero(numbers == number)
        columns, rest = free_columns(result.problem.space, design, int(number), len(result.data))
        y[at] = (x[at] @ columns.T + rest)[:, design.index]
    return y


def predictive_draws(posterior: Posterior, record: Record, count: int, seed: int) -> Float[np.ndarray, "count T"]:
    """Outputs that might be measured over a record's input: parameters vary, and noise is added; `seed` is that of all choices."""
    result = posterior.result
    given, record = record, result.in_fitted_units(record)
    rows = posterior.draws.reshape(-1, len(posterior.names))[posterior.chosen(count, seed)]
    y = simulate_draws(result, record, rows[:, : len(result.free_names)], seed)
    problem = result.problem.with_loss("linear").with_noise(NOISES.make(posterior.noise))
    inputs = np.concatenate([fitted.u for fitted in result.data])
    new = Setting.of(Batch.of(record), (float(inputs.min()), float(inputs.max())))
    new = dataclasses.replace(new, weight=jnp.ones_like(new.weight))  # unmeasured samples have noise too
    density, about = density_of_draws(problem, result.x)
    noise = np.asarray(_noise_of_draws(density, new, jnp.asarray(rows), jax.random.key(seed), about))[:, : len(record)]
    if not result.is_fitted(record):
        y = y + _error_beyond(posterior, record, y, noise, seed)
    return result.to_unit_of(given, y + noise)


def _error_beyond(
    posterior: Posterior, record: Record, y: np.ndarray, noise: np.ndarray, seed: int
) -> Float[np.ndarray, "count T"]:
    """Error of the model over a record that was not fitted, as far as neither the draws nor the noise explain it.

    Its variance is that of `AmplitudeError` where loops of several amplitudes were fitted, and otherwise of the error on the groups that
    the fit held out, if it did; the errors of a group have one cause. It is known from few values: the draws are those of Student's t.
    """
    rng, result, beyond = np.random.default_rng(seed), posterior.result, posterior.beyond
    problem, shape = result.problem, y - y.mean(axis=1, keepdims=True)
    if beyond is None:
        squares, freedom = (result.left_out or 0.0) ** 2 - np.mean(noise**2), problem.held_out.count
        length = correlation_length(problem.residuals(result.x)[problem.used])
    else:
        squares, freedom, length = beyond.sd(record.u, y.mean(axis=0)) ** 2, beyond.freedom, beyond.length
    missing = np.maximum(squares - np.var(shape, axis=0).mean(), 0.0)
    scale = np.sqrt(freedom / rng.chisquare(freedom, size=(len(y), 1)))
    return np.sqrt(missing) * scale * _correlated(rng, y.shape, length)


def _correlated(rng: np.random.Generator, shape: tuple[int, int], length: int) -> Float[np.ndarray, "count T"]:
    """Stationary Gaussian paths of unit variance, correlated over `length` samples."""
    decay = np.exp(-1 / length)
    before = decay * rng.normal(size=shape[0])
    drive = np.sqrt(1 - decay**2) * rng.normal(size=shape)
    drive[:, 0] += before
    return recursion((1.0, -decay), drive.T).T


def density_of_draws(problem: Problem, x: np.ndarray) -> tuple[Density, Any]:
    """The density of a problem, and, of a model that is linear, residuals and their derivatives at a point x, (p,), and this point."""
    if problem.closed_form:
        return problem.density, (*problem.linearize(x), x)
    return problem.trimmed().density, None


@eqx.filter_jit
def _noise_of_draws(density: Density, new: Setting, rows: Array, key: Array, about: Any) -> Array:
    """Noise over a new record from each draw; `about` as of `density_of_draws`."""

    def one(at: tuple[Array, Array]) -> Array:
        x, key = at
        residual = residual_at(density, x, about)
        return density.noise.assemble(x[density.p :]).predictive(new, key, density.setting, -residual)[0]

    return jax.lax.map(one, (rows, jax.random.split(key, rows.shape[0])))


def residual_at(density: Density, x: Array, about: Any) -> Array:
    """Prediction less measurement of a draw, shape (R, T): simulated, or linear about a point (residuals, derivatives, point)."""
    if about is None:
        return density.objective.residual(x[: density.p])
    residual, jacobian, start = about
    return residual + jacobian @ (x[: density.p] - start)
