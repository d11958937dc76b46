"""A quick look at the families with a closed form: their errors on held-out samples, without the fit or the verdict of any."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.errors import HystfitError
from hystfit.fitting.candidates import candidates
from hystfit.fitting.comparison import handicap
from hystfit.fitting.fit_model import solve_model
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import started_problem, without_faults
from hystfit.fitting.remains import correlation_of
from hystfit.fitting.ridge import LinearSystem, fit_ridge
from hystfit.fitting.sizes import SizeSearch, weights_of
from hystfit.fitting.smooth_weights import left_out_scores
from hystfit.fitting.structure import falls, structure_of
from hystfit.fitting.structure_search import Found, search_structure
from hystfit.fitting.thinning import thinned
from hystfit.fitting.verdict import residuals_are_white
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import SEARCH, make_model, model_name
from hystfit.outcome import Status
from hystfit.quality.baselines import Baselines
from hystfit.quality.held_out import Scheme, correlation_length, equal_errors, held_out
from hystfit.quality.summary import paces
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
        searches: whether it has parameters that a fit searches for; its error is that at their starting values.
        paced: see `hystfit.fitting.comparison.Row`.
        rough: whether its error is larger than that of a usable description.
    """

    name: str
    error: float
    weights: int
    inverse: bool
    asked: str = ""
    found: Found | None = None
    leaves_noise: bool = False
    searches: bool = False
    paced: bool = False
    rough: bool = False

    @property
    def ranked(self) -> float:
        """The error by which it ranks, as in a comparison; one on held-out samples alone does not count a rough fit twice."""
        return self.error * handicap(Status.OK, self.inverse and not self.rough, self.paced)


def screen(data: Dataset) -> list[Screened]:
    """Score the families with a closed form: on thinned records, with few of their choices, and other parameters where they start.

    The search comes first, and the only one where it leaves nothing but noise; the last candidates follow where the others describe the
    loops roughly at best. Scattered samples are as far apart as the residuals of the best model are correlated. So does `compare`.
    """
    data = without_faults(data)
    screened = list(_screened(data))
    best = min(screened, key=lambda one: one.ranked, default=None)
    if best is None or best.leaves_noise or held_out(list(data)).scheme is not Scheme.SCATTERED:
        return screened
    spacing = _correlation(best, data)
    return list(_screened(data, spacing)) if spacing > 1 else screened


def _correlation(best: Screened, data: Dataset) -> int:
    """Samples over which the residuals of a model are correlated; one where it cannot be fitted."""
    if best.found is not None:
        return max(map(correlation_length, best.found.residuals()))
    short = thinned(data)
    try:
        fit = solve_model(best.name, short, FitOptions()).unjudged
    except (HystfitError, np.linalg.LinAlgError):
        return 1
    return round(correlation_of(fit) * sum(map(len, data)) / sum(map(len, short)))


def _screened(data: Dataset, spacing: int = 1) -> Iterator[Screened]:
    """The models in turn; arguments as of `held_out`."""
    chosen, baselines, look = candidates(data), Baselines.of(data), _Look(data, spacing)
    least, limit = float("inf"), Limits.of(baselines).error * baselines.span / 100
    waiting, last = list(chosen.closed), list(chosen.last)
    while waiting or (last and limit < least < baselines.curve):
        name = (waiting or last).pop(0)
        one = _searched(data, baselines, spacing) if name == SEARCH else look.at(name)
        if one is None:
            continue
        one = dataclasses.replace(one, rough=one.error > limit)
        yield one
        if one.leaves_noise:
            return
        least = min(least, one.error)
        if one.found is not None:
            found, delay = structure_of(one.found.model)
            waiting += chosen.beside(dataclasses.replace(found, falls=falls(data)), delay).closed


def _searched(data: Dataset, baselines: Baselines, spacing: int) -> Screened:
    found = search_structure(data, spacing=spacing)
    weights = weights_of(found.model)
    noise = residuals_are_white(found.residuals(), baselines.curve, weights)
    error = _ranking_error(Problem(found.model, data, spacing=spacing), found.score)
    paced = _is_paced(found.model, data)
    return Screened(model_name(found.model), error, weights, found.model.has_inverse, SEARCH, found, noise, paced=paced)


def _is_paced(model: AbstractHysteresis, data: Dataset) -> bool:
    return not model.rate_independent and paces(data) < 2


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

    def at(self, name: str) -> Screened | None:
        """A model; None where these records cannot start it."""
        model = make_model(name)
        if (first := self._sizes.first(model)) is not None:
            problem, _ = started_problem(first[0], self._short, spacing=self._fewer)
            return _screened_of(name, problem, first[1])
        try:  # it has no sizes to choose
            short = model.allows_thinning
            problem, _ = started_problem(
                model, self._short if short else self._data, spacing=self._fewer if short else self._spacing
            )
            system = LinearSystem.of(problem, problem.space.vector(problem.model))
        except HystfitError:
            return None
        return _screened_of(name, problem, float(fit_ridge(system).score))


def _screened_of(name: str, problem: Problem, error: float) -> Screened:
    """A model that was tried by this name, with its error on held-out samples [y]."""
    model, searches = problem.model, not problem.space.linear.all()
    error = _ranking_error(problem, error)
    paced, inverse = _is_paced(model, problem.data), model.has_inverse
    return Screened(model_name(model), error, weights_of(model), inverse, name, searches=searches, paced=paced)


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
