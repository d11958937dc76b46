"""Bound-constrained fits by jaxopt: L-BFGS-B and projected gradient.

The one file that imports jaxopt, whose authors no longer maintain it.
"""

from __future__ import annotations

import warnings
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.fitting.estimate import AbstractEstimator, Estimate
from hystfit.inference.objective import Objective
from hystfit.inference.problem import Problem


def _jaxopt() -> Any:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="JAXopt is no longer maintained", category=DeprecationWarning)
        import jaxopt
    return jaxopt


class BoundedDescent(AbstractEstimator):
    """Minimizes the logarithm of the cost in physical coordinates, in units of each parameter's size at the start, within the bounds.

    Attributes:
        method: "lbfgsb", or "projected-gradient" for many weights.
        tolerance: on the projected gradient.
        max_steps: from each start.
    """

    needs_starts: ClassVar[bool] = True
    method: Literal["lbfgsb", "projected-gradient"] = eqx.field(static=True, default="lbfgsb")
    tolerance: float = eqx.field(static=True, default=1e-5)
    max_steps: int = eqx.field(static=True, default=500)

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """See `AbstractEstimator.estimate`."""
        space, c = problem.space, problem.space.coordinates
        lower, upper = (np.asarray(v) for v in (c.lower, c.upper))
        solutions = []
        for z in starts:
            x0 = np.clip(space.physical(z), lower, upper)
            size = np.maximum(np.abs(x0), 0.1 * np.asarray(c.scale))
            v, cost, error, steps = _descend(self, problem.objective, jnp.asarray(x0 / size), jnp.asarray(size))
            solutions.append((np.clip(np.asarray(v) * size, lower, upper), float(cost), float(error), int(steps)))
        costs = np.array([cost if np.isfinite(cost) else np.inf for _, cost, _, _ in solutions])
        x, cost, error, _ = solutions[int(np.argmin(costs))]
        converged = error <= 10 * self.tolerance
        message = "converged" if converged else f"projected gradient {error:.1e} after its steps: try method='trf'"
        return Estimate(x, cost, converged, message, sum(steps for *_, steps in solutions), costs)


def projected_gradient() -> BoundedDescent:
    """Projected gradient, for many weights."""
    return BoundedDescent(method="projected-gradient")


@eqx.filter_jit
def _descend(
    settings: BoundedDescent, objective: Objective, v0: Array, size: Array
) -> tuple[Array, Array, Array, Array]:
    jaxopt, c = _jaxopt(), objective.coordinates
    squares = lambda v, objective: 0.5 * jnp.sum(objective.misfit(v * size) ** 2)
    first = squares(v0, objective)

    def cost(v: Array, objective: Objective) -> Array:
        # The logarithm keeps gradients of order one however small the residuals are.
        return 0.5 * jnp.log(squares(v, objective) / first + 1e-12)

    bounds = (c.lower / size, c.upper / size)
    if settings.method == "lbfgsb":
        solver = jaxopt.LBFGSB(cost, maxiter=settings.max_steps, tol=settings.tolerance)
    else:
        solver = jaxopt.ProjectedGradient(
            cost, jaxopt.projection.projection_box, maxiter=settings.max_steps, tol=settings.tolerance
        )
    solution = solver.run(v0, bounds, objective)
    last = squares(solution.params, objective)
    better = last <= first  # a failed line search must not lose the start
    v = jnp.where(better, solution.params, v0)
    return v, jnp.where(better, last, first), solution.state.error, solution.state.iter_num
