"""Least squares in unconstrained coordinates by optimistix: the default estimator."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from hystfit.fitting.estimate import AbstractEstimator, Estimate
from hystfit.fitting.polish import polish
from hystfit.fitting.thinning import thin
from hystfit.fitting.trust_region import TrustRegion
from hystfit.inference.objective import Objective
from hystfit.inference.problem import Problem

_ROUGH = 1e-4  # relative tolerance on z of starts on the short form of the records
_ON_BOUND = 1e-6  # relative distance below which the bounded solver decides whether a parameter is on its bound


class LeastSquares(AbstractEstimator):
    """Levenberg-Marquardt or dogleg with forward-mode Jacobians, from several starts.

    Every start gets a few steps, in which most reach their basin; the best continues for some rounds of as many. Where the records
    are long, all this happens on a short form of them (`hystfit.fitting.thinning`), and the best start is polished on all samples.
    A parameter that drifts to its bound never converges in unconstrained coordinates: the bounded trust region then finishes the fit.

    Attributes:
        method: "lm" or "dogleg".
        rtol, atol: relative and absolute tolerance on z and on the cost.
        max_steps: in a round.
        rounds: of further steps for the best start.
    """

    needs_starts: ClassVar[bool] = True
    method: Literal["lm", "dogleg"] = eqx.field(static=True, default="lm")
    rtol: float = eqx.field(static=True, default=1e-8)
    atol: float = eqx.field(static=True, default=1e-10)
    max_steps: int = eqx.field(static=True, default=25)
    rounds: int = eqx.field(static=True, default=4)

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """See `AbstractEstimator.estimate`."""
        short = thin(problem)
        objective, settings = (problem.objective, self) if short is None else (short, _rough(self))
        runs = [settings._run(objective, z0) for z0 in starts]  # one compilation serves any number of starts
        costs = np.array([cost for _, cost, _, _ in runs])
        number = int(np.argmin(costs))
        z, cost, success, _ = runs[number]
        steps = sum(run[3] for run in runs)
        for _ in range(self.rounds):
            if success or not np.isfinite(cost):
                break
            z, cost, success, more = settings._run(objective, z)
            steps += more
        costs[number] = min(cost, costs[number])
        if short is not None and np.isfinite(z).all():
            z, cost, success, more = polish(problem, z)
            steps, costs = steps + more, costs * (cost / costs[number])
        x = problem.space.physical(z)
        if success and np.isfinite(z).all() and not any(problem.at_bound(x, _ON_BOUND)):
            return Estimate(x, float(costs[number]), True, "converged", steps, costs)
        finished = TrustRegion().estimate(problem, np.asarray(z)[None])
        message = "finished by the bounded trust region" if finished.converged else finished.message
        costs[number] = finished.cost
        return Estimate(finished.x, finished.cost, finished.converged, message, steps + finished.evaluations, costs)

    def _run(self, objective: Objective, z0: np.ndarray) -> tuple[np.ndarray, float, bool, int]:
        z, cost, success, steps = _solve(self, objective, jnp.asarray(z0))
        return np.asarray(z), float(cost), bool(success), int(steps)


def _rough(settings: LeastSquares) -> LeastSquares:
    """The tolerances of starting points that are polished later."""
    return dataclasses.replace(settings, rtol=_ROUGH, atol=0.1 * _ROUGH)


def dogleg() -> LeastSquares:
    """Powell's dogleg."""
    return LeastSquares(method="dogleg")


@eqx.filter_jit
def _solve(settings: LeastSquares, objective: Objective, z0: Array) -> tuple[Array, Array, Array, Array]:
    solver: Any = (optx.LevenbergMarquardt if settings.method == "lm" else optx.Dogleg)(settings.rtol, settings.atol)
    solution = optx.least_squares(
        lambda z, objective: objective.misfit_at(z),
        solver,
        z0,
        args=objective,
        options={"jac": "fwd"},
        max_steps=settings.max_steps,
        throw=False,
    )
    cost = 0.5 * jnp.sum(objective.misfit_at(solution.value) ** 2)
    cost = jnp.where(jnp.isfinite(cost) & jnp.isfinite(solution.value).all(), cost, jnp.inf)
    return solution.value, cost, solution.result == optx.RESULTS.successful, solution.stats["num_steps"]
