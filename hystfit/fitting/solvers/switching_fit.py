"""The estimator of relays: thresholds by an exact search, as no derivative tells them, and the linear weights by least squares."""

from __future__ import annotations

import equinox as eqx
import numpy as np

from hystfit.errors import ModelError, ParameterError
from hystfit.fitting.solvers.convex import Convex
from hystfit.fitting.solvers.estimate import Estimate
from hystfit.fitting.solvers.ridge import LinearSystem, fit_ridge, linear_positions
from hystfit.inference.problem import Problem


class Switching(Convex):
    """Thresholds that the model itself reads off the records (`start`), and the weights that fit best at these, without a ridge.

    The search is exact and needs no starting values. Cross-validation keeps the thresholds, as that of a convex fit keeps a lag: a record
    has few jumps, and one held out may leave a threshold so wide a range that a whole half cycle is predicted on the wrong side.
    """

    strengths: tuple[float, ...] = eqx.field(static=True, default=(0.0,))

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """See `AbstractEstimator.estimate`; the starts matter where all weights are fixed alone."""
        space = problem.space
        if space.ties:
            raise ParameterError("tied parameters need another method than 'switching': choose method='lm'")
        for name, linear in zip(space.names, space.linear, strict=True):
            if not (linear or name in space.stepwise_names):
                raise ModelError(
                    f"thresholds are searched for beside linear weights alone, and {name} is free: give it a value (fix=)"
                )
        x = space.physical(starts[0])
        if not space.linear.all():
            x = np.where(space.linear, x, space.clip(space.vector(problem.model.start(list(problem.data)))))
        at = linear_positions(problem)
        if not at.size:
            return Estimate.solved(x, 0.5 * float(np.sum(problem.misfit(x) ** 2)))
        system = LinearSystem.of(problem, x)
        if not system.free.all():
            raise ModelError("weights with bounds cannot be solved for beside a relay: use preisach, which has both")
        x[at] = np.linalg.lstsq(system.columns, system.target)[0]
        rest = system.target - system.columns @ x[at]
        left_out = float(fit_ridge(system, self.strengths).score)
        return Estimate.solved(x, 0.5 * float(rest @ rest) / problem.scales.y**2, left_out=left_out)
