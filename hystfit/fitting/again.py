"""The problem that a result solved, to go on from."""

from __future__ import annotations

import numpy as np

from hystfit.errors import ModelError
from hystfit.inference.problem import Problem
from hystfit.results.result import FitResult


def held_and_free(result: FitResult) -> tuple[list[str], list[str]]:
    """Names of the parameters that a fit held, and of those that it fitted (once for all records), as `Problem` takes them."""
    held = [p.name for p in result.parameters if p.fixed]
    return held, list(dict.fromkeys(name.partition("@")[0] for name in result.free_names))


def problem_of(result: FitResult, *, as_fitted: bool = False) -> tuple[Problem, np.ndarray]:
    """The problem that a result solved, and where it ended, physical, shape (p,).

    Args:
        result: of a fit.
        as_fitted: with its robust loss; else residuals count as they are, which is what likelihoods want.

    Raises:
        ModelError: the result's free parameters are not those of its model (a file that was changed by hand).
    """
    fixed, free = held_and_free(result)
    loss = result.provenance.get("loss", "linear") if as_fitted else "linear"
    problem = Problem(result.model, result.data, fix=fixed, free=free, loss=loss)
    if problem.space.names != tuple(result.free_names):
        raise ModelError(
            f"the result's free parameters {result.free_names} are not those of its model {problem.space.names}"
        )
    models = list(result.models) if len(result.models) > 1 else result.model
    return problem, problem.space.vector(models)
