"""A quick look at the families with a closed form: their errors on held-out samples, without the fit or the verdict of any."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.errors import HystfitError
from hystfit.fitting.candidates import candidates
from hystfit.fitting.comparison import handicap
from hystfit.fitting.fit_setup import started_problem, without_faults
from hystfit.fitting.ridge import LinearSystem, fit_ridge
from hystfit.fitting.sizes import SizeSearch, weights_of
from hystfit.fitting.smooth_weights import left_out_scores
from hystfit.fitting.structure import structure_of
from hystfit.fitting.structure_search import Found, search_structure
from hystfit.fitting.thinning import thinned
from hystfit.fitting.verdict import residuals_are_white
from hystfit.inference.problem import Problem
from hystfit.models.registry import SEARCH, make_model, model_name
from hystfit.outcome import Status
from hystfit.quality.baselines import Baselines
from hystfit.quality.held_out import Scheme, correlation_length, equal_errors, held_out
from hystfit.results.accuracy import POOR, Limits


@dataclasses.dataclass(frozen=True)
class Screened:
    """A model with its root mean square error on held-out samples [y].

    Attributes:
        name: expression that makes it.
        error: infinite for a model that cannot be solved for.
        weights: number of its weights.
        inverse: whether it has one.
        asked: the name that it was tried by, without the settings chosen.
        found: what the search found, where it is its model.
        leaves_noise: whether it leaves nothing but noise, see `residuals_are_white`.
        beaten: whether its error is at least this one, which is enough to tell that it is not the model to try first.
        rough: whether its error is larger than that of a usable description.
    """

    name: str
    error: float
    weights: int
    inverse: bool
    asked: str = ""
    found: Found | None = None
    leaves_noise: bool = False
    beaten: bool = False
    rough: bool = False

    @property
    def ranked(self) -> float:
        """The error by which it ranks, as in a comparison; one on held-out samples alone does not count a rough fit twice."""
        return self.error * handicap(Status.OK, self.inverse and not self.rough)


def screen(data: Dataset) -> list[Screened]:
    """Score the families with a closed form: on thinned records, with few of their choices, and other parameters where they start.

    The search comes first, and the only one where it leaves nothing but noise; the last candidates follow where the others describe the
    loops roughly at best. Where it is the best on scattered samples, these are as far apart as its residuals are correlated. So does
    `compare`.
    """
    data = without_faults(data)
    screened = list(_screened(data))
    best = min(screened, key=lambda one: one.ranked, default=None)
    if best is None or best.found is None or held_out(list(data)).scheme is not Scheme.SCATTERED:
        return screened
    spacing = max(map(correlation_length, best.found.residuals()))
    return list(_screened(data, spacing)) if spacing > 1 else screened


def _screened(data: Dataset, spacing: int = 1) -> Iterator[Screened]:
    """The models in turn; arguments as of `held_out`."""
    chosen, baselines, look = candidates(data), Baselines.of(data), _Look(data, spacing)
    equal, most = equal_errors(sum(int(record.used.sum()) for record in data)), float("inf")
    least, limit = float("inf"), Limits.of(baselines).error * baselines.span / 100
    waiting, last = list(chosen.closed), list(chosen.last)
    while waiting or (last and limit < least < baselines.curve):
        name = (waiting or last).pop(0)
        one = _searched(data, baselines, spacing) if name == SEARCH else look.at(name, most)
        if one is None:
            continue
        one = dataclasses.replace(one, rough=one.error > limit)
        yield one
        if one.leaves_noise:
            return
        least, most = min(least, one.error), min(most, equal * one.ranked)
        if one.found is not None:
            waiting += chosen.beside(*structure_of(one.found.model)).closed


def looked_at_closely(beaten: Iterable[Screened], data: Dataset) -> list[Screened]:
    """Beaten models with their own errors."""
    look = _Look(without_faults(data))
    found = (look.at(one.asked, float("inf")) for one in beaten)
    return [one for one in found if one is not None]


def _searched(data: Dataset, baselines: Baselines, spacing: int) -> Screened:
    found = search_structure(data, spacing=spacing)
    weights = weights_of(found.model)
    noise = residuals_are_white(found.residuals(), baselines.curve, weights)
    error = _ranking_error(Problem(found.model, data, spacing=spacing), found.score)
    return Screened(model_name(found.model), error, weights, found.model.has_inverse, SEARCH, found, noise)


def _ranking_error(problem: Problem, error: float) -> float:
    """The error on held-out samples where smaller loops count too, see `hystfit.fitting.left_out.ranking_error`."""
    inner = problem.by_inner_loops() if problem.held_out.scheme is Scheme.SCATTERED else None
    if inner is None:
        return error
    x = inner.space.vector(inner.model)
    if inner.model.estimator == "preisach":
        return float(np.sqrt(error * left_out_scores(inner, x).held))
    return float(np.sqrt(error * fit_ridge(LinearSystem.of(inner, x)).score))


class _Look:
    """Solves models on thinned records; not the search, whose terms may depend on the rate."""

    def __init__(self, data: Dataset, spacing: int = 1):
        self._data, self._short, self._spacing = data, thinned(data), spacing
        self._fewer = max(1, round(spacing * sum(map(len, self._short)) / sum(map(len, data))))
        self._sizes = SizeSearch(self._short, self._fewer)

    def at(self, name: str, most: float) -> Screened | None:
        """A model, and whether it is beaten because it is ranked at an error above `most`; None where these records cannot start it."""
        model = make_model(name)
        most /= handicap(Status.OK, model.has_inverse)
        if (first := self._sizes.first(model, most)) is not None:
            model, error = first
            if not (beaten := error > most):
                problem, _ = started_problem(model, self._short, spacing=self._fewer)
                error = _ranking_error(problem, error)
            return Screened(model_name(model), error, weights_of(model), model.has_inverse, name, beaten=beaten)
        try:  # it has no sizes to choose
            short = model.allows_thinning
            problem, _ = started_problem(
                model, self._short if short else self._data, spacing=self._fewer if short else self._spacing
            )
            system = LinearSystem.of(problem, problem.space.vector(problem.model))
        except HystfitError:
            return None
        model, error = problem.model, _ranking_error(problem, float(fit_ridge(system).score))
        return Screened(model_name(model), error, weights_of(model), model.has_inverse, name)


def best_screened(models: Iterable[Screened], samples: int, span: float) -> Screened:
    """The model to try first: of those whose errors this number of samples does not tell apart, the one with the fewest weights.

    Where every error is poor, few weights speak for no model, and the smallest error decides.

    Args:
        span: range of the output.
    """
    every = list(models)
    least = min(one.ranked for one in every)
    within = equal_errors(samples) if 100 * least <= POOR * span else 1.0
    return min((one for one in every if one.ranked <= within * least), key=lambda one: one.weights)
