"""The estimator of models that are linear in their weights: a bounded ridge fit inside a search over the other parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
import scipy  # loads its subpackages when they are first used, which optimize is not in most fits

from hystfit.errors import ModelError, ParameterError
from hystfit.fitting.solvers.estimate import AbstractEstimator, Estimate
from hystfit.fitting.solvers.ridge import STRENGTHS, LinearSystem, RidgeFit, fit_ridge, linear_positions, penalized
from hystfit.inference.problem import Problem
from hystfit.outcome import Code, Note


class Convex(AbstractEstimator):
    """The weights of a model that is linear in them, given its other parameters; the nonlinear ones by a simplex outside.

    For plays, relays and creep weights: dozens of unknowns, of which many end on zero. With nonlinear parameters free (a lag, a
    bend) those move to lower the cost at the strength found at the start, and the strength is found again at the end. At a wrong lag
    cross-validation chooses a strong ridge, with which the cost has its minimum at another wrong lag. If the ridge is strong, the
    search is therefore repeated with a weak one.

    Attributes:
        strengths: of the ridge, among which held-out groups choose.
        max_evaluations: of an outer search.
    """

    needs_starts: ClassVar[bool] = False
    strengths: tuple[float, ...] = eqx.field(static=True, default=STRENGTHS)
    max_evaluations: int = eqx.field(static=True, default=80)

    def quick(self) -> Convex:
        return dataclasses.replace(self, max_evaluations=15)

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

    def _search(self, problem: Problem, z: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, int, bool, str]:
        """Where the nonlinear parameters end: with the ridge of the start or, if that is strong, with a weak one, by left-out error."""

        def search(strength: float) -> tuple[np.ndarray, int, bool, str]:
            cost = lambda x: float(np.log(penalized(LinearSystem.of(problem, x), strength) + 1e-300))
            limits = {"maxfev": self.max_evaluations, "xatol": 1e-2, "fatol": 1e-4}
            return search_nonlinear(problem, cost, z, others, **limits)

        first = float(fit_ridge(LinearSystem.of(problem, problem.space.physical(z)), self.strengths).strength)
        weak = min(self.strengths, key=lambda strength: abs(np.log(strength / 1e-6)))  # moves no lag
        ended = [search(strength) for strength in dict.fromkeys((first, min(first, weak)))]
        scores = [fit_ridge(LinearSystem.of(problem, x), self.strengths).score for x, *_ in ended] if ended[1:] else [0]
        x, _, converged, message = ended[int(np.argmin(scores))]
        return x, sum(evaluations for _, evaluations, _, _ in ended), converged, message


def search_nonlinear(
    problem: Problem, cost: Callable[[np.ndarray], float], z: np.ndarray, others: np.ndarray, **options: Any
) -> tuple[np.ndarray, int, bool, str]:
    """Search over the nonlinear parameters of a model whose weights are solved for inside (variable projection).

    From unconstrained z, to the lowest cost of physical parameters: these, the number of evaluations, whether it converged, and a message.
    """

    def at(inner: np.ndarray) -> np.ndarray:
        trial = z.copy()
        trial[others] = inner
        return np.array(problem.space.physical(trial))

    if others.size == 1:  # by parabolas: a sixth of the evaluations of a simplex
        bracket, limits = (
            (z[others[0]], z[others[0]] + 0.2),  # of its natural scale
            {"maxiter": options["maxfev"], "xtol": options["xatol"]},
        )
        of_number = lambda v: cost(at(np.atleast_1d(v)))
        solution = scipy.optimize.minimize_scalar(of_number, bracket, method="brent", options=limits)
    else:
        solution = scipy.optimize.minimize(lambda v: cost(at(v)), z[others], method="Nelder-Mead", options=options)
    # Along a direction that the data do not determine a simplex moves on without end, at costs that no longer differ.
    level = others.size > 1 and bool(np.ptp(solution.final_simplex[1]) <= options["fatol"])
    stopped = f"the search over nonlinear parameters stopped after {solution.nfev} evaluations"
    converged = bool(solution.success) or level
    return at(np.atleast_1d(solution.x)), int(solution.nfev), converged, "converged" if converged else stopped
