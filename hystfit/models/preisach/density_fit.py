"""Fit the parameters of a Preisach density on distinct states: gradients by look-ups instead of a scan over the samples."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array

from hystfit.data.record import Dataset, Record
from hystfit.inference.problem import Problem
from hystfit.models.preisach.compiled import Compiled, compile_for, respond
from hystfit.models.preisach.density import ParametricPreisach
from hystfit.params.coordinates import Coordinates


@eqx.filter_jit
def _predict(coordinates: Coordinates, z: Array, inputs: list[Compiled]) -> Array:
    return jnp.concatenate([respond(coordinates.tree(z, k).preisach(), c) for k, c in enumerate(inputs)])


@eqx.filter_jit
def _slopes(coordinates: Coordinates, z: Array, inputs: list[Compiled]) -> Array:
    return jax.jacfwd(lambda z: _predict(coordinates, z, inputs))(z)


def fit_density(
    model: ParametricPreisach, data: Record | Dataset | Sequence[Record], *, fix: Sequence[str] = ()
) -> tuple[ParametricPreisach, scipy.optimize.OptimizeResult]:
    """Least squares of a parametric density on records, from the model's data-driven start.

    Args:
        model: its levels are spread over the records.
        data: records; samples count with their weights.
        fix: parameters to hold.

    Returns:
        The model as seen by the first record, and what the solver says (`cost` in output units squared).

    Raises:
        HystfitError: data or names that cannot be used.
    """
    records = list(Dataset.of(data))
    started = model.start(records)
    problem = Problem(started, records, fix=fix)
    coordinates = problem.space.coordinates
    z = problem.space.unconstrained(problem.space.vector(problem.model))
    inputs = [compile_for(started.preisach(), r.u) for r in records]
    weight = np.sqrt(np.concatenate([np.where(r.used, r.weight, 0.0) for r in records]))
    y = np.concatenate([np.where(r.used, r.y, 0.0) for r in records])
    residual = lambda z: weight * (np.asarray(_predict(coordinates, jnp.asarray(z), inputs)) - y)
    slopes = lambda z: weight[:, None] * np.asarray(_slopes(coordinates, jnp.asarray(z), inputs))
    found = scipy.optimize.least_squares(residual, np.asarray(z), jac=slopes, x_scale="jac", max_nfev=200)
    return coordinates.tree(jnp.asarray(found.x)), found
