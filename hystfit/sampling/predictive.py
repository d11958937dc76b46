"""Predictive draws: what a further measurement would show, given what the fitted records say of the noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.batch import Batch
from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.fitting.again import problem_of
from hystfit.fitting.generalized import raw_residual
from hystfit.inference.noise import LoopDiscrepancy, Setting, make_noise
from hystfit.inference.problem import Objective
from hystfit.models.base import run
from hystfit.params.coordinates import Coordinates
from hystfit.params.space import ParameterSpace
from hystfit.results.result import FitResult

if TYPE_CHECKING:
    from hystfit.sampling.posterior import Posterior


@eqx.filter_jit
def _simulate_all(coordinates: Coordinates, x: Array, u: Array, dt: Array, own: int) -> Array:
    return jax.lax.map(lambda row: run(coordinates.assemble(row, own), u, dt)[0], x)


def simulate_draws(result: FitResult, record: Record, x: np.ndarray) -> np.ndarray:
    """Outputs over a record's input for rows of free parameters x, shape (count, p): (count, T).

    Raises:
        ModelError: no time for a model that needs it.
    """
    if record.t is None and not result.model.rate_independent:
        raise ModelError(f"{result.name} depends on time, and record {record.name!r} has none")
    problem, _ = problem_of(result)
    names = [r.name for r in result.data]
    own = names.index(record.name) if record.name in names else 0
    arrays = (jnp.asarray(x), jnp.asarray(record.u), jnp.asarray(record.dt))
    return np.asarray(_simulate_all(problem.space.coordinates, *arrays, own))


def predictive_draws(posterior: Posterior, record: Record, count: int, seed: int) -> Float[np.ndarray, "count T"]:
    """Outputs that might be measured over a record's input: parameters vary, and noise is added.

    What repeats with input and direction is drawn given the residuals of the fitted records, which determine it: it belongs to the
    prediction. Slow noise has forgotten them, and is drawn from its stationary distribution, as is independent noise.
    """
    names, p = posterior.names, len(posterior.result.free_names)
    flat = posterior.draws.reshape(-1, len(names))
    rows = flat[np.random.default_rng(seed).choice(len(flat), min(count, len(flat)), replace=False)]
    y = simulate_draws(posterior.result, record, rows[:, :p])
    if "noise_dof" in names:
        dof, size = (rows[:, names.index(name), None] for name in ("noise_dof", "noise_white"))
        return y + size * np.random.default_rng(seed + 1).standard_t(np.broadcast_to(dof, y.shape))
    parts = [k for k, name in enumerate(names) if name in ("noise_white", "noise_slow")]
    variance = np.sum(rows[:, parts] ** 2, axis=1)[:, None]
    if "noise_loop" in names:
        curve, unknown = _repeating(posterior, record, rows, seed)
        y, variance = y + curve, variance + unknown
    return y + np.sqrt(variance) * np.random.default_rng(seed + 1).normal(size=y.shape)


def _repeating(
    posterior: Posterior, record: Record, rows: np.ndarray, seed: int
) -> tuple[Float[np.ndarray, "count T"], Float[np.ndarray, "count T"]]:
    """A repeating error for each draw over a record's input, and the variance that its shapes cannot make there."""
    from hystfit.sampling.setup import trimmed

    problem, _ = problem_of(posterior.result)
    noise = make_noise(posterior.noise)
    coordinates = ParameterSpace.of(noise, scales=problem.scales).coordinates
    batch = trimmed(problem.objective.batch)
    objective = eqx.tree_at(lambda o: o.batch, problem.objective, batch)
    limits = float(np.min(batch.u)), float(np.max(batch.u))
    settings = Setting.of(batch), Setting.of(Batch.of(record), limits)
    curve, unknown = _curves(objective, coordinates, *settings, jnp.asarray(rows), jax.random.key(seed))
    return np.asarray(curve)[:, : len(record)], np.asarray(unknown)[:, : len(record)]


@eqx.filter_jit
def _curves(
    objective: Objective, coordinates: Coordinates, seen: Setting, new: Setting, rows: Array, key: Array
) -> tuple[Array, Array]:
    p = len(objective.coordinates.kinds)

    def one(at: tuple[Array, Array]) -> tuple[Array, Array]:
        x, key = at
        noise: LoopDiscrepancy = coordinates.assemble(x[p:])
        columns = noise.columns(seen)
        left = -raw_residual(objective, x[:p])  # measurement less prediction
        e, _ = noise.whiten(seen, jnp.concatenate([left[..., None], columns], axis=-1))
        e = e.reshape(-1, e.shape[-1])
        own, shapes = e[:, 0], e[:, 1:]
        factor = jnp.linalg.cholesky(jnp.eye(shapes.shape[1]) + shapes.T @ shapes)
        mean = jax.scipy.linalg.cho_solve((factor, True), shapes.T @ own)
        push = jax.random.normal(key, mean.shape)
        weights = mean + jax.scipy.linalg.solve_triangular(factor.T, push, lower=False)
        ahead = noise.columns(new)[0]
        return ahead @ weights, jnp.maximum(noise.noise_loop**2 - jnp.sum(ahead**2, axis=-1), 0.0)

    return jax.lax.map(one, (rows, jax.random.split(key, rows.shape[0])))
