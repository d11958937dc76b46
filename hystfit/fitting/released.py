"""Noise models where least squares ended on a bound: what pushed a parameter there may have been the noise."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.fitting.covariance import near_bound
from hystfit.fitting.estimate import Estimate
from hystfit.fitting.generalized import NoiseFit, refine
from hystfit.inference.problem import Problem
from hystfit.params.coordinates import BOTH

_INSIDE = 0.05  # in the parameter's scale, or in the width between two bounds


def refine_released(problem: Problem, estimate: Estimate, name: str) -> NoiseFit:
    """`refine` with parameters on a bound moved inside and free again; those that return are held in a second round.

    Linear weights on a bound stay: a solver put them there, and there may be hundreds.

    Raises:
        ParameterError: an unknown noise model.
    """
    held = _on_bound(problem, estimate.x)
    linear = np.array([info.linear for info in problem.space.infos], bool)
    released = held & ~linear
    if not released.any():
        return refine(problem, estimate, name, ~held)
    c = problem.space.coordinates
    lower, upper, scale = (np.asarray(v) for v in (c.lower, c.upper, c.scale))
    edge = _INSIDE * np.where(np.asarray(c.kinds) == BOTH, upper - lower, scale)
    inside = np.where(released, np.clip(estimate.x, lower + edge, upper - edge), estimate.x)
    found = refine(problem, dataclasses.replace(estimate, x=inside), name, ~(held & linear))
    again = _on_bound(problem, found.x) & released
    if not again.any():
        return found
    x = np.where(again, estimate.x, found.x)
    return refine(problem, dataclasses.replace(estimate, x=x), name, ~(again | (held & linear)))


def _on_bound(problem: Problem, x: np.ndarray) -> np.ndarray:
    return np.array([side is not None for side in near_bound(problem, x)])
