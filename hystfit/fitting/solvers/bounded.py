"""Fits within bounds: L-BFGS-B of jaxopt, and the trust region of scipy, the robust path and the oracle of the others.

The one file that imports jaxopt, whose authors no longer maintain it. Where it does not import, L-BFGS-B of scipy takes its place.
"""

from __future__ import annotations

import warnings
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # loads its subpackages when they are first used, which optimize is not in most fits
from jaxtyping import Array

from hystfit.fitting.solvers.estimate import AbstractEstimator, Estimate
from hystfit.inference.objective import Objective
from hystfit.inference.problem import Problem
from hystfit.outcome import Code, Note
from hystfit.params.host_arrays import compiled


def _jaxopt() -> Any:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="JAXopt is no longer maintained", category=DeprecationWarning)
        import jaxopt
    return jaxopt


def _why_not_jaxopt() -> str:
    """Why jaxopt does not import; "" where it does."""
    try:
        _jaxopt()
    except Exception as error:  # a package without maintenance breaks in any way with a later JAX
        return f"{type(error).__name__}: {error}"
    return ""


class BoundedDescent(AbstractEstimator):
    """Minimizes the logarithm of the cost in physical coordinates, in units of each parameter's size at the start, within the bounds.

    Attributes:
        tolerance: on the projected gradient.
        max_steps: from each start.
    """

    needs_starts: ClassVar[bool] = True
    tolerance: float = eqx.field(static=True, default=1e-5)
    max_steps: int = eqx.field(static=True, default=500)

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        space = problem.space
        missing, solutions = _why_not_jaxopt(), []
        descend = _descend_by_scipy if missing else _descend
        for z in starts:
            x0 = space.clip(space.physical(z))
            size = np.maximum(np.abs(x0), 0.1 * space.scale)
            v, cost, error, steps = descend(self, problem.objective, jnp.asarray(x0 / size), jnp.asarray(size))
            solutions.append((space.clip(np.asarray(v) * size), float(cost), float(error), int(steps)))
        costs = np.array([cost if np.isfinite(cost) else np.inf for _, cost, _, _ in solutions])
        x, cost, error, _ = solutions[int(np.argmin(costs))]
        converged = error <= 10 * self.tolerance
        message = "converged" if converged else f"projected gradient {error:.1e} after the last step: try method='trf'"
        text = f"jaxopt cannot be imported ({missing}): L-BFGS-B of SciPy was used instead"
        notes = (Note(Code.CHOICE, text),) if missing else ()
        return Estimate(x, cost, converged, message, sum(steps for *_, steps in solutions), costs, notes=notes)


@compiled
def _descend(
    settings: BoundedDescent, objective: Objective, v0: Array, size: Array
) -> tuple[Array, Array, Array, Array]:
    jaxopt, c = _jaxopt(), objective.coordinates
    first = _squares(v0, objective, size)
    cost = lambda v, objective: _cost(v, objective, size, first)
    bounds = (c.lower / size, c.upper / size)
    solution = jaxopt.LBFGSB(cost, maxiter=settings.max_steps, tol=settings.tolerance).run(v0, bounds, objective)
    last = _squares(solution.params, objective, size)
    better = last <= first  # a failed line search must not lose the start
    v = jnp.where(better, solution.params, v0)
    return v, jnp.where(better, last, first), solution.state.error, solution.state.iter_num


def _squares(v: Array, objective: Objective, size: Array) -> Array:
    return 0.5 * jnp.sum(objective.misfit(v * size) ** 2)


def _cost(v: Array, objective: Objective, size: Array, first: Array) -> Array:
    # The logarithm keeps gradients of order one however small the residuals are.
    return 0.5 * jnp.log(_squares(v, objective, size) / first + 1e-12)


@compiled
def _cost_and_slope(v: Array, objective: Objective, size: Array, first: Array) -> tuple[Array, Array]:
    return jax.value_and_grad(_cost)(v, objective, size, first)


def _descend_by_scipy(
    settings: BoundedDescent, objective: Objective, v0: Array, size: Array
) -> tuple[np.ndarray, float, float, int]:
    c, first = objective.coordinates, _squares(v0, objective, size)
    lower, upper = np.asarray(c.lower / size), np.asarray(c.upper / size)

    def cost(v: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = _cost_and_slope(jnp.asarray(v), objective, size, first)
        return float(value), np.asarray(slope)

    solution = scipy.optimize.minimize(
        cost,
        np.asarray(v0),
        jac=True,
        method="L-BFGS-B",
        bounds=scipy.optimize.Bounds(lower, upper),  # type: ignore[arg-type]
        options={"maxiter": settings.max_steps, "gtol": settings.tolerance, "ftol": 0.0},
    )
    last = float(_squares(jnp.asarray(solution.x), objective, size))
    if not last <= float(first):  # a failed line search must not lose the start
        return np.asarray(v0), float(first), np.inf, int(solution.nit)
    projected = solution.x - np.clip(solution.x - solution.jac, lower, upper)
    return solution.x, last, float(np.linalg.norm(projected)), int(solution.nit)


class TrustRegion(AbstractEstimator):
    """scipy's `least_squares(method="trf")` in physical coordinates, each parameter in units of its scale.

    Parameters of records without weight stay where they start: rounding would move them without limit.

    Attributes:
        tolerance: on cost, step and gradient.
        max_evaluations: of the residuals, for each start.
    """

    needs_starts: ClassVar[bool] = True
    tolerance: float = eqx.field(static=True, default=1e-10)
    max_evaluations: int = eqx.field(static=True, default=300)

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        at = np.flatnonzero(~problem.idle)
        scale, lower, upper = (part[at] for part in (problem.space.scale, problem.space.lower, problem.space.upper))
        ends, solutions = [], []
        for z in starts:
            start = problem.space.clip(problem.space.physical(z))

            def whole(v: np.ndarray, start: np.ndarray = start) -> np.ndarray:
                x = start.copy()
                x[at] = v * scale
                return x

            with np.errstate(all="ignore"):  # of trial steps that are not taken
                solution = scipy.optimize.least_squares(
                    lambda v: problem.misfit(whole(v)),
                    start[at] / scale,
                    jac=lambda v: problem.linearize_misfit(whole(v))[1][:, at] * scale,  # type: ignore[arg-type]
                    bounds=(lower / scale, upper / scale),
                    x_scale="jac",
                    ftol=self.tolerance,
                    xtol=self.tolerance,
                    gtol=self.tolerance,
                    max_nfev=self.max_evaluations,
                )
            solutions.append(solution)
            ends.append(problem.space.clip(whole(solution.x)))
        costs = np.array([s.cost if np.isfinite(s.cost) else np.inf for s in solutions])
        number = int(np.argmin(costs))
        best = solutions[number]
        evaluations = int(sum(s.nfev for s in solutions))
        return Estimate(ends[number], float(best.cost), best.status > 0, str(best.message), evaluations, costs)
