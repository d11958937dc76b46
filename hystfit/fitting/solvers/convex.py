"""The estimator of models that are linear in their weights: a bounded ridge fit inside a search over the other parameters."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import equinox as eqx
import numpy as np

from hystfit.errors import ModelError, ParameterError
from hystfit.fitting.solvers.estimate import AbstractEstimator, Estimate
from hystfit.fitting.solvers.ridge import STRENGTHS, LinearSystem, RidgeFit, eliminated, fit_ridge, linear_positions
from hystfit.fitting.solvers.variable_projection import Searched, search_nonlinear
from hystfit.inference.problem import Problem
from hystfit.outcome import Code, Note

# Relative decrease of the sum of squares at which the search ends: with 1e-6 it took up to a half more evaluations on four measured files,
# and the error on held-out samples changed by at most 4e-4 of it.
_GAIN = 1e-4


class Convex(AbstractEstimator):
    """The weights of a model that is linear in them, given its other parameters; the nonlinear ones by variable projection.

    For plays, relays and creep weights: dozens of unknowns, of which many end on zero. With nonlinear parameters free (a lag, a
    bend) those move to lower the cost at the strength found at the start, and the strength is found again at the end. At a wrong lag
    cross-validation chooses a strong ridge, with which the cost has its minimum at another wrong lag. If the ridge is strong, the
    search is therefore repeated with a weak one, and in any case with that which cross-validation chooses where the better one ends.

    Attributes:
        strengths: of the ridge, among which held-out groups choose.
        steps: of a search over nonlinear parameters.
        brief: whether this is a first look at a model, with a single search.
    """

    needs_starts: ClassVar[bool] = False
    strengths: tuple[float, ...] = eqx.field(static=True, default=STRENGTHS)
    steps: int = eqx.field(static=True, default=40)
    brief: bool = eqx.field(static=True, default=False)

    def quick(self) -> Convex:
        return dataclasses.replace(self, brief=True)

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """See `AbstractEstimator.estimate`; the first start alone matters, because the weights need none."""
        if problem.space.ties:
            raise ParameterError("tied parameters need another method than 'convex': choose method='lm'")
        at = linear_positions(problem)
        if not at.size:
            raise ModelError(f"{type(problem.model).__name__} has no linear weights: use method='lm' or 'trf'")
        others = np.setdiff1d(np.arange(len(problem.space)), at)
        x = np.array(problem.space.physical(starts[0]))
        evaluations, converged, message = 1, True, "solved"
        if others.size:
            x, evaluations, converged, message = self._search(problem, starts[0], others)
        system = LinearSystem.of(problem, x)
        fit = fit_ridge(system, self.strengths)
        x[at] = fit.weights
        found = self.of_ridge(fit, x, at, problem.scales.y, system.fold.max() + 1)
        return dataclasses.replace(found, converged=converged, message=message, evaluations=evaluations)

    def of_ridge(self, fit: RidgeFit, x: np.ndarray, at: np.ndarray, size: float, groups: int) -> Estimate:
        """The estimate that a solution gives: x has all parameters, shape (p,), and `size` is half the range of the output."""
        penalty = np.zeros((x.size, x.size))
        penalty[at, at] = fit.ridge / size**2
        note = (
            f"ridge {fit.strength:.0e} chosen by cross-validation on {groups} groups "
            f"(error {100 * fit.score / (2 * size):.2f} % of the range)"
        )
        if fit.strength == max(self.strengths):
            note += "; it is the largest tried"
        cost = 0.5 * float(fit.rss) / size**2
        return Estimate.solved(
            x,
            cost,
            penalty=penalty,
            notes=(Note(Code.CHOICE, note),),
            left_out=float(fit.score),
            toward_zero=True,
            effective=float(fit.effective) + x.size - at.size,
        )

    def _search(self, problem: Problem, z: np.ndarray, others: np.ndarray) -> Searched:
        """Where the nonlinear parameters end: with the ridge of the start or, if that is strong, a weak one, then with that of the end."""

        def search(strength: float, z: np.ndarray) -> Searched:
            at = lambda x: eliminated(problem, x, others, strength)
            return search_nonlinear(problem, at, z, others, steps=self.steps, gain=_GAIN)

        chosen = lambda x: fit_ridge(LinearSystem.of(problem, x), self.strengths)
        first = float(chosen(problem.space.physical(z)).strength)
        weak = min(self.strengths, key=lambda strength: abs(np.log(strength / 1e-6)))  # moves no lag
        tried = [*dict.fromkeys((min(first, weak),) if self.brief else (first, min(first, weak)))]
        ended = [search(strength, z) for strength in tried]
        fits = [chosen(one.x) for one in ended]
        best = int(np.argmin([fit.score for fit in fits]))
        # Else the end would depend on the start.
        if not self.brief and (strength := float(fits[best].strength)) != tried[best]:
            ended.append(search(strength, problem.space.unconstrained(problem.space.clip(ended[best].x))))
            best = len(ended) - 1
        return ended[best]._replace(evaluations=sum(one.evaluations for one in ended))
