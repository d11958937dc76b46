"""Smooth weights by one convex solve, inside a search over the few other free parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import ClassVar

import equinox as eqx
import numpy as np

from hystfit.errors import ModelError
from hystfit.fitting.solvers.estimate import AbstractEstimator, Estimate
from hystfit.fitting.solvers.variable_projection import (
    Eliminated,
    Searched,
    counted,
    output_slopes,
    search_nonlinear,
)
from hystfit.inference.problem import Problem
from hystfit.inference.weights import Split, column_products
from hystfit.models.preisach.smooth import (
    SMOOTHNESS,
    LeftOutErrors,
    SmoothFit,
    errs_more,
    fit_smooth,
    left_out_errors,
)
from hystfit.outcome import Code, Note
from hystfit.quality.reversal_curves import reversal_curves

_FEW = 6  # free parameters besides the weights that the search serves
_GAIN = 1e-7  # relative decrease of the sum of squares at which it ends


class SmoothWeights(AbstractEstimator):
    """Weights that are smooth, and >= 0 as their bounds say, given the other free parameters; those by variable projection.

    For models with the method `design_matrix`: `Preisach`, solved on distinct states, and its compositions with a lag, creep or a
    resonance, whose parameters move to lower the cost at the smoothness found at the start; it is chosen again at the end.

    Attributes:
        smoothness: strengths of the penalty among which held-out groups choose.
        steps: of a search over other parameters.
        most: error where samples are held out [y], above which with the weakest smoothness no other is tried.
    """

    needs_starts: ClassVar[bool] = False
    smoothness: tuple[float, ...] = eqx.field(static=True, default=SMOOTHNESS)
    steps: int = eqx.field(static=True, default=40)
    most: float = eqx.field(static=True, default=np.inf)

    def up_to(self, most: float) -> SmoothWeights:
        return dataclasses.replace(self, most=most)

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """See `AbstractEstimator.estimate`; the first start alone matters, because the weights need none."""
        if problem.model.estimator != "preisach":
            raise ModelError(
                f"{type(problem.model).__name__} has no smooth weights: use method='convex', or method='lm' if it has no linear weights"
            )
        # Reversal curves start from saturation, and are checked to be such.
        family = reversal_curves(list(problem.data)) if problem.model.from_saturation else None
        split = lambda x: Split.of(problem.space, list(problem.data), x, held=problem.held_out)
        x = np.array(problem.space.physical(starts[0]))
        now, problem.equations = problem.equations or split(x), None
        others = np.flatnonzero(now.place < 0)
        evaluations, converged, message = 1, True, "solved"
        if others.size:
            x, evaluations, converged, message = self._search(problem, split, now, starts[0], others)
            now = split(x)
        most = self.most / now.system.size
        if np.isfinite(most) and (fit := errs_more(now.system, self.smoothness, now.fixed, most)) is not None:
            found = self.of_fit(fit, now, x, problem.scales.y)
            return dataclasses.replace(found, converged=False, message="not finished")
        fit = fit_smooth(now.system, self.smoothness, fixed=now.fixed)
        texts = [] if family is None else [family.words(), *family.notes]
        size = problem.scales.y
        found = self.of_fit(fit, now, x, size, problem.held_out.count, [*texts, *now.system.notes()])
        linearized = None if others.size else problem.linearization(found.x, now.gram(found.x, size))
        return dataclasses.replace(
            found, converged=converged, message=message, evaluations=evaluations, linearized=linearized
        )

    def of_fit(
        self, fit: SmoothFit, split: Split, x: np.ndarray, size: float, groups: int = 0, texts: Sequence[str] = ()
    ) -> Estimate:
        """The estimate that a solution gives: x has the parameters that are no weights, shape (p,), `size` is half the output's range."""
        at = np.flatnonzero(split.place >= 0)
        own = split.place[at]
        x, penalty = x.copy(), np.zeros((x.size, x.size))
        x[at], penalty[np.ix_(at, at)] = fit.weights[own], fit.penalty[np.ix_(own, own)] / size**2
        texts = [*texts]
        if fit.error is not None:
            texts.append(
                f"smoothness {fit.smoothness:.0e} chosen by cross-validation on {groups} groups "
                f"(error {100 * fit.error:.2g} % of the range)"
            )
        cost = 0.5 * fit.rss / size**2
        return Estimate.solved(
            x,
            cost,
            penalty=penalty,
            notes=tuple(Note(Code.CHOICE, text) for text in texts),
            left_out=None if fit.error is None else fit.error * fit.size,
            effective=None if fit.effective is None else fit.effective + x.size - at.size,
        )

    def _search(
        self, problem: Problem, split: Callable[[np.ndarray], Split], first: Split, z: np.ndarray, others: np.ndarray
    ) -> Searched:
        """Where the other parameters end, with the smoothness of the start."""
        if others.size > _FEW:
            names = ", ".join(problem.space.names[k] for k in others[:_FEW])
            raise ModelError(
                f"smooth weights are fitted together with at most {_FEW} other parameters, and {others.size} are free ({names}, ...): "
                "fix some, or use method='trf'"
            )
        strength = fit_smooth(first.system, self.smoothness, fixed=first.fixed).smoothness

        eliminated = lambda x: eliminated_smooth(problem, x, others, split(x), strength)
        # The gain is small compared with the standard errors: the cost of n samples rises by 1 / n over one of them.
        return search_nonlinear(problem, eliminated, z, others, steps=self.steps, gain=_GAIN)


def eliminated_smooth(problem: Problem, x: np.ndarray, others: np.ndarray, split: Split, strength: float) -> Eliminated:
    """What smooth weights leave at physical x, beside the nonlinear parameters at the positions `others`."""
    fit = fit_smooth(split.system, (strength,), fixed=split.fixed)
    at = np.flatnonzero(split.place >= 0)
    full, own = x.copy(), split.place[at]
    full[at] = fit.weights[own]
    output, rough = counted(problem, problem.predict(full)), float(np.sqrt(max(fit.cost - fit.rss, 0.0)))

    def slopes() -> np.ndarray:
        direct = output_slopes(problem, full, others, output)
        products = column_products(problem.space, list(problem.data), full, direct)
        changes = fit.following(split.system, products)
        moved = np.tile(full, (others.size, 1))
        moved[:, at] += changes[own].T
        # The output is linear in the weights.
        followed = np.stack([counted(problem, problem.predict(one)) - output for one in moved], axis=1)
        weights = np.where(np.isnan(split.fixed), fit.weights, 0.0)
        bending = weights @ fit.penalty @ changes / max(rough, 1e-300)
        return np.vstack([direct + followed, bending])

    return Eliminated(np.append(output - counted(problem, [record.y for record in problem.data]), rough), slopes)


def left_out_scores(
    problem: Problem,
    x: np.ndarray,
    smoothness: tuple[float, ...] = SMOOTHNESS,
    *,
    keep: bool = False,
    most: float = np.inf,
    likely: float | None = None,
) -> LeftOutErrors:
    """Errors with the smoothness that the held-out groups choose, output units; lower bounds of them where these are above `most`.

    The weights in x are solved for; `smoothness` has two or more strengths, of which a similar model chose the `likely` one. With `keep`
    the equations stay with the problem for its fit, where all free parameters are weights.
    """
    now = problem.equations or Split.of(problem.space, list(problem.data), x, held=problem.held_out)
    if keep and (now.place >= 0).all():
        problem.equations = now
    size = now.system.size
    found = left_out_errors(now.system, smoothness, now.fixed, most / size, likely)
    return found._replace(held=size * found.held, overall=size * found.overall)
