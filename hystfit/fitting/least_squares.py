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
from hystfit.fitting.polish import EXACT, polish
from hystfit.fitting.thinning import thin
from hystfit.fitting.trust_region import TrustRegion
from hystfit.inference.objective import Objective
from hystfit.inference.problem import Problem
from hystfit.params.host_arrays import to_device

_ROUGH = 1e-4  # relative tolerance on z of starts that are polished later, and of a first look
_ROUGH_GAIN = 1e-6  # decrease of the cost, relative to it, that is left to the polish
_STEPS = 200  # at most, of the polish of a fit of few samples
_ON_BOUND = 1e-6  # relative distance below which the bounded solver decides whether a parameter is on its bound


class LeastSquares(AbstractEstimator):
    """Levenberg-Marquardt, or Powell's dogleg by optimistix, with forward-mode Jacobians, from several starts.

    Every start gets a few steps, in which most reach their basin; the best and the first continue for some rounds of as many. Where
    the records are long, all this happens on a short form of them (`hystfit.fitting.thinning`). The best one is polished on all
    samples, by a solver that no offset, scale or correlation of parameters slows down. A parameter that drifts to its bound never
    converges in unconstrained coordinates: the bounded trust region then finishes the fit.

    Attributes:
        method: "lm" or "dogleg".
        rtol, atol: relative and absolute tolerance on z and on the cost.
        gain: decrease of the cost promised by the linear model, relative to it, below which "lm" has converged too.
        max_steps: in a round.
        rounds: of further steps for the best start and the first.
        brief: a first look at a model: no polish, and no trust region for what has not converged.
    """

    needs_starts: ClassVar[bool] = True
    method: Literal["lm", "dogleg"] = eqx.field(static=True, default="lm")
    rtol: float = eqx.field(static=True, default=1e-8)
    atol: float = eqx.field(static=True, default=1e-10)
    gain: float = eqx.field(static=True, default=0.0)
    max_steps: int = eqx.field(static=True, default=25)
    rounds: int = eqx.field(static=True, default=4)
    brief: bool = eqx.field(static=True, default=False)

    def quick(self) -> LeastSquares:
        """See the base class."""
        return dataclasses.replace(self._rough(), brief=True)

    def _rough(self) -> LeastSquares:
        """With the tolerances of points that are polished later."""
        return dataclasses.replace(self, rtol=_ROUGH, atol=0.1 * _ROUGH, gain=_ROUGH_GAIN)

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """See `AbstractEstimator.estimate`."""
        short = thin(problem)
        objective, settings = problem.objective, self
        if short is not None:
            objective, settings = short, self._rough()
        ended = settings._run(objective, starts)
        # The first start continues too: another basin may be ahead after few steps.
        for number in dict.fromkeys((int(np.argmin(ended.cost)), 0)):
            settings._continue(objective, ended, number)
        costs, steps = ended.cost, int(ended.evaluations.sum())
        number = int(np.argmin(costs))
        z, cost, success, linearized = ended.z[number], float(costs[number]), bool(ended.converged[number]), None
        if self.brief:
            total, thinned = (float(of.batch.weight.sum()) for of in (problem.objective, objective))
            cost *= total / thinned
            return Estimate(problem.space.physical(z), cost, success, "a first look", steps, costs)
        if np.isfinite(z).all() and np.isfinite(cost):
            exact = () if short is not None else (_STEPS, EXACT)
            z, cost, success, more, linearized = polish(problem, z, *exact)
            steps, costs = steps + more, costs if short is None else costs * (cost / costs[number])
            costs[number] = cost
        x = problem.space.physical(z)
        if success and np.isfinite(z).all() and not any(problem.at_bound(x, _ON_BOUND)):
            return Estimate(x, float(costs[number]), True, "converged", steps, costs, linearized=linearized)
        finished = TrustRegion().estimate(problem, np.asarray(z)[None])
        message = "finished by the bounded trust region" if finished.converged else finished.message
        costs[number] = finished.cost
        return Estimate(finished.x, finished.cost, finished.converged, message, steps + finished.evaluations, costs)

    def _continue(self, objective: Objective, ended: Descents, number: int) -> None:
        """Further rounds for one start, in place."""
        for _ in range(self.rounds):
            if ended.converged[number] or ended.given_up[number] or not np.isfinite(ended.cost[number]):
                return
            again = self._run(objective, ended.z[number][None])
            if again.cost[0] <= ended.cost[number]:
                ended.z[number], ended.cost[number], ended.converged[number] = (
                    again.z[0],
                    again.cost[0],
                    again.converged[0],
                )
            ended.evaluations[number] += int(again.evaluations[0])

    def _run(self, objective: Objective, starts: np.ndarray) -> Descents:
        if self.method == "lm":
            return descend(objective, starts, rtol=self.rtol, atol=self.atol, steps=self.max_steps, gain=self.gain)
        runs = [_dogleg(self, objective, to_device(z)) for z in starts]  # one compilation serves any number of starts
        parts = (np.array([np.asarray(v) for v in part]) for part in zip(*runs, strict=True))
        return Descents(*parts, np.zeros(len(starts), bool))


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
