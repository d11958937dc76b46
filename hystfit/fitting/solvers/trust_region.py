"""Bounded trust region by scipy with the JAX Jacobian: the robust path, and the oracle of the others."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import numpy as np
import scipy  # loads its subpackages when they are first used, which optimize is not in most fits

from hystfit.fitting.solvers.estimate import AbstractEstimator, Estimate
from hystfit.inference.problem import Problem


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
