"""Least squares in unconstrained coordinates: the default estimator."""

from __future__ import annotations

import dataclasses
from typing import ClassVar, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.fitting.estimate import AbstractEstimator, Estimate
from hystfit.fitting.levenberg_marquardt import Descents, descend
from hystfit.fitting.polish import polish
from hystfit.fitting.thinning import thin
from hystfit.fitting.trust_region import TrustRegion
from hystfit.inference.objective import Objective
from hystfit.inference.problem import Problem
from hystfit.params.host_arrays import to_device

_ROUGH = 1e-4  # relative tolerance on z of starts on the short form of the records
_ROUGH_GAIN = 1e-6  # decrease of the cost, relative to it, that is left to the polish
_ON_BOUND = 1e-6  # relative distance below which the bounded solver decides whether a parameter is on its bound


class LeastSquares(AbstractEstimator):
    """Levenberg-Marquardt, or Powell's dogleg by optimistix, with forward-mode Jacobians, from several starts.

    Every start gets a few steps, in which most reach their basin; the best continues for some rounds of as many. Where the records
    are long, all this happens on a short form of them (`hystfit.fitting.thinning`), and the best start is polished on all samples.
    A parameter that drifts to its bound never converges in unconstrained coordinates: the bounded trust region then finishes the fit.

    Attributes:
        method: "lm" or "dogleg".
        rtol, atol: relative and absolute tolerance on z and on the cost.
        gain: decrease of the cost promised by the linear model, relative to it, below which "lm" has converged too.
        max_steps: in a round.
        rounds: of further steps for the best start.
    """

    needs_starts: ClassVar[bool] = True
    method: Literal["lm", "dogleg"] = eqx.field(static=True, default="lm")
    rtol: float = eqx.field(static=True, default=1e-8)
    atol: float = eqx.field(static=True, default=1e-10)
    gain: float = eqx.field(static=True, default=0.0)
    max_steps: int = eqx.field(static=True, default=25)
    rounds: int = eqx.field(static=True, default=4)

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """See `AbstractEstimator.estimate`."""
        short = thin(problem)
        objective, settings = (problem.objective, self) if short is None else (short, _rough(self))
        ended = settings._run(objective, starts)
        costs, steps = ended.cost, int(ended.evaluations.sum())
        number = int(np.argmin(costs))
        z, cost, success = ended.z[number], float(costs[number]), bool(ended.converged[number])
        for _ in range(self.rounds):
            if success or not np.isfinite(cost):
                break
            again = settings._run(objective, z[None])
            z, cost, success = again.z[0], float(again.cost[0]), bool(again.converged[0])
            steps += int(again.evaluations[0])
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

    def _run(self, objective: Objective, starts: np.ndarray) -> Descents:
        if self.method == "lm":
            return descend(objective, starts, rtol=self.rtol, atol=self.atol, steps=self.max_steps, gain=self.gain)
        runs = [_dogleg(self, objective, to_device(z)) for z in starts]  # one compilation serves any number of starts
        return Descents(*(np.array([np.asarray(v) for v in part]) for part in zip(*runs, strict=True)))


def _rough(settings: LeastSquares) -> LeastSquares:
    """The tolerances of starting points that are polished later."""
    return dataclasses.replace(settings, rtol=_ROUGH, atol=0.1 * _ROUGH, gain=_ROUGH_GAIN)


def dogleg() -> LeastSquares:
    """Powell's dogleg."""
    return LeastSquares(method="dogleg")


@eqx.filter_jit
def _dogleg(settings: LeastSquares, objective: Objective, z0: Array) -> tuple[Array, Array, Array, Array]:
    import optimistix as optx  # its import takes 0.2 s, which no other fit needs

    solution = optx.least_squares(
        lambda z, objective: objective.misfit_at(z),
        optx.Dogleg(settings.rtol, settings.atol),
        z0,
        args=objective,
        options={"jac": "fwd"},
        max_steps=settings.max_steps,
        throw=False,
    )
    cost = 0.5 * jnp.sum(objective.misfit_at(solution.value) ** 2)
    cost = jnp.where(jnp.isfinite(cost) & jnp.isfinite(solution.value).all(), cost, jnp.inf)
    return solution.value, cost, solution.result == optx.RESULTS.successful, solution.stats["num_steps"]
