"""Starting points: the data-driven one, and a Latin hypercube around it."""

from __future__ import annotations

import numpy as np

from hystfit.inference.problem import Problem
from hystfit.params.hypercube import spread_points

_SPREAD = 1.5  # in z: a factor of about 4 either way for a positive parameter


def spread_starts(problem: Problem, center: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Starting points of shape (count, p): the center first, the others a Latin hypercube within the bounds.

    Positive and real parameters spread by 1.5 in z around the center, parameters with two bounds over most of their range; parameters
    that enter linearly stay at the center (least squares moves them in one step).

    Args:
        problem: the problem.
        center: data-driven start, unconstrained, shape (p,).
        count: number of starts.
        seed: of the hypercube.
    """
    starts = np.tile(center, (max(count, 1), 1))
    if count <= 1:
        return starts
    spread = spread_points(problem.space.coordinates, center, count - 1, seed, spread=_SPREAD)
    starts[1:] = np.where(problem.space.linear, center, spread)
    return starts
