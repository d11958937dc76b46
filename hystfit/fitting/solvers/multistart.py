"""Starting points of a fit: models with starting values from the data, or one of them and a Latin hypercube about it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystfit.errors import ParameterError
from hystfit.fitting.solvers.ridge import LinearSystem
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.params.hypercube import spread_points


def spread_starts(problem: Problem, center: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Starting points of shape (count, p): the center first, the others a Latin hypercube within the bounds.

    Positive and real parameters spread by 1.5 in z around the center, parameters with two bounds over most of their range; parameters
    that enter linearly stay at the center (least squares moves them in one step).
    """
    starts = np.tile(center, (max(count, 1), 1))
    if count <= 1:
        return starts
    # In z: a factor of about 4 either way for a positive parameter.
    spread = spread_points(problem.space.coordinates, center, count - 1, seed, spread=1.5)
    starts[1:] = np.where(problem.space.linear, center, spread)
    return starts


def starting_vectors(problem: Problem, count: int, seed: int, points: Sequence[AbstractHysteresis] = ()) -> np.ndarray:
    """Starting points of shape (S, p) in unconstrained coordinates; arguments as for `solve`."""
    if not len(problem.space):
        raise ParameterError("every parameter is fixed: there is nothing to fit (use predict)")
    models = points[:count] or (problem.model,)
    at = [problem.space.unconstrained(with_record_parameters(problem, problem.space.vector(model))) for model in models]
    return np.stack(at) if len(at) > 1 else spread_starts(problem, at[0], count, seed)


def with_record_parameters(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Starting values with each record's own linear parameters (offsets, first outputs) solved for, and all inside their bounds."""
    per_record = problem.space.linear & problem.space.per_record
    if len(problem.data) > 1 and per_record.any():
        system = LinearSystem.of(problem, x, per_record)
        x = x.copy()
        x[per_record] = np.linalg.lstsq(system.columns, system.target, rcond=None)[0]
    return problem.space.clip(x)
