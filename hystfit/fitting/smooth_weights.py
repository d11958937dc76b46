"""Smooth weights by one convex solve, inside a search over the few other free parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import numpy as np

from hystfit.errors import ModelError
from hystfit.fitting.convex import search_nonlinear
from hystfit.fitting.estimate import AbstractEstimator, Estimate
from hystfit.inference.problem import Problem
from hystfit.inference.weights import Split
from hystfit.models.preisach.smooth import SMOOTHNESS, fit_smooth, left_out_error
from hystfit.outcome import Code, Note
from hystfit.quality.reversal_curves import reversal_curves

_FEW = 6  # free parameters besides the weights that the search serves


class SmoothWeights(AbstractEstimator):
    """Weights that are smooth, and >= 0 as their bounds say, given the other free parameters; those by a simplex outside.

    For models with the method `design_matrix`: `Preisach`, solved on distinct states, and its compositions with a lag, creep or a
    resonance, whose parameters move to lower the cost at the smoothness found at the start; it is chosen again at the end.

    Attributes:
        smoothness: strengths of the penalty among which held-out groups choose.
        max_evaluations: of the search.
    """

    needs_starts: ClassVar[bool] = False
    smoothness: tuple[float, ...] = eqx.field(static=True, default=SMOOTHNESS)
    max_evaluations: int = eqx.field(static=True, default=120)

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """See `AbstractEstimator.estimate`; the first start alone matters, because the weights need none.

        Raises:
            ModelError: the model has no smooth weights, or too many other parameters are free.
        """
        if problem.model.estimator != "preisach":
            raise ModelError(
                f"{type(problem.model).__name__} has no smooth weights: use method='convex', or 'lm' without linear weights"
            )
        # Reversal curves start from saturation, and are checked to be such.
        family = reversal_curves(list(problem.data)) if problem.model.from_saturation else None
        split = lambda x: Split.of(problem.space, list(problem.data), x, held=problem.held_out)
        x = np.array(problem.space.physical(starts[0]))
        now = split(x)
        others = np.flatnonzero(now.place < 0)
        evaluations, converged, message = 1, True, "solved"
        if others.size:
            x, evaluations, converged, message = self._search(problem, split, now, starts[0], others)
            now = split(x)
        fit = fit_smooth(now.system, self.smoothness, fixed=now.fixed)
        weights = now.place >= 0
        size = problem.scales.y
        penalty = np.zeros(x.size)
        x[weights], penalty[weights] = fit.weights[now.place[weights]], fit.penalty[now.place[weights]] / size**2
        texts = [] if family is None else [family.words(), *family.notes]
        texts += now.system.notes()
        if fit.error is not None:
            texts.append(
                f"smoothness {fit.smoothness:.0e} chosen by cross-validation on {problem.held_out.count} groups "
                f"(error {100 * fit.error:.2g} % of the range)"
            )
        notes = tuple(Note(Code.CHOICE, text) for text in texts)
        cost = 0.5 * fit.rss / size**2
        left_out = None if fit.error is None else fit.error * now.system.size
        effective = fit.effective + others.size
        costs = np.array([cost])
        linearized = None if others.size else problem.linearization(x, now.gram(x, size))
        return Estimate(
            x,
            cost,
            converged,
            message,
            evaluations,
            costs,
            penalty,
            notes,
            left_out,
            effective=effective,
            linearized=linearized,
        )

    def _search(
        self, problem: Problem, split: Callable[[np.ndarray], Split], first: Split, z: np.ndarray, others: np.ndarray
    ) -> tuple[np.ndarray, int, bool, str]:
        """Physical parameters at the lowest penalized cost, number of evaluations, whether it converged, and a message."""
        if others.size > _FEW:
            names = ", ".join(problem.space.names[k] for k in others[:_FEW])
            raise ModelError(
                f"smooth weights are fitted together with at most {_FEW} other parameters, and {others.size} are free ({names}, ...): "
                "fix some, or use method='trf'"
            )
        strength = fit_smooth(first.system, self.smoothness, fixed=first.fixed).smoothness

        def cost(x: np.ndarray) -> float:
            now = split(x)
            return float(np.log(fit_smooth(now.system, (strength,), fixed=now.fixed).cost + 1e-300))

        # The tolerances are small compared with the standard errors: the cost of n samples rises by 1 / n over one of them.
        return search_nonlinear(problem, cost, z, others, maxfev=self.max_evaluations, xatol=1e-5, fatol=1e-7)


def left_out_score(problem: Problem, x: np.ndarray, smoothness: tuple[float, ...] = SMOOTHNESS) -> float:
    """Root mean square error on the held-out groups that choose the smoothness, output units.

    The weights in x are solved for; `smoothness` has two or more strengths.
    """
    now = Split.of(problem.space, list(problem.data), x, held=problem.held_out)
    return left_out_error(now.system, smoothness, now.fixed) * now.system.size
