"""Bounded trust region by scipy with the JAX Jacobian: the robust path, and the oracle of the others."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array

from hystfit.fitting.estimate import AbstractEstimator, Estimate
from hystfit.inference.problem import Objective, Problem


class TrustRegion(AbstractEstimator):
    """scipy's `least_squares(method="trf")` in physical coordinates, each parameter in units of its scale.

    Attributes:
        tolerance: on cost, step and gradient.
        max_evaluations: of the residuals, for each start.
    """

    tolerance: float = eqx.field(static=True, default=1e-10)
    max_evaluations: int = eqx.field(static=True, default=300)

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """See `AbstractEstimator.estimate`."""
        objective, space = problem.objective, problem.space
        scale = np.asarray(space.coordinates.scale)
        lower, upper = (np.asarray(b) / scale for b in (space.coordinates.lower, space.coordinates.upper))
        solutions = []
        for z in starts:
            x0 = np.clip(space.physical(z) / scale, lower, upper)
            solutions.append(
                scipy.optimize.least_squares(
                    lambda v: np.asarray(_residuals(objective, jnp.asarray(v * scale))),
                    x0,
                    jac=lambda v: np.asarray(_jacobian(objective, jnp.asarray(v * scale))) * scale,  # type: ignore[arg-type]
                    bounds=(lower, upper),
                    x_scale="jac",
                    ftol=self.tolerance,
                    xtol=self.tolerance,
                    gtol=self.tolerance,
                    max_nfev=self.max_evaluations,
                )
            )
        costs = np.array([s.cost if np.isfinite(s.cost) else np.inf for s in solutions])
        best = solutions[int(np.argmin(costs))]
        x = np.clip(best.x * scale, np.asarray(space.coordinates.lower), np.asarray(space.coordinates.upper))
        evaluations = int(sum(s.nfev for s in solutions))
        return Estimate(x, float(best.cost), best.status > 0, str(best.message), evaluations, costs)


@eqx.filter_jit
def _residuals(objective: Objective, x: Array) -> Array:
    return objective.misfit(x)


@eqx.filter_jit
def _jacobian(objective: Objective, x: Array) -> Array:
    return jax.jacfwd(objective.misfit)(x)
