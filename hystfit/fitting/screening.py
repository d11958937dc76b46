"""A quick look at the families with a closed form: their errors on held-out samples, without the fit or the verdict of any."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator

from hystfit.data.dataset import Dataset
from hystfit.errors import HystfitError
from hystfit.fitting.candidates import candidates
from hystfit.fitting.comparison import MARGIN
from hystfit.fitting.fit_setup import started_problem, without_faults
from hystfit.fitting.ridge import LinearSystem, fit_ridge
from hystfit.fitting.sizes import SizeSearch, weights_of
from hystfit.fitting.structure_search import Found, search_structure
from hystfit.fitting.thinning import thinned
from hystfit.fitting.verdict import residuals_are_white
from hystfit.models.registry import SEARCH, make_model, model_name
from hystfit.quality.baselines import Baselines
from hystfit.quality.held_out import equal_errors
from hystfit.results.accuracy import POOR


@dataclasses.dataclass(frozen=True)
class Screened:
    """A model with its root mean square error on held-out samples [y].

    Attributes:
        name: expression that makes it.
        error: infinite for a model that cannot be solved for.
        weights: number of its weights.
        inverse: whether it has one.
        found: what the search found, where it is its model.
        leaves_noise: whether it leaves nothing but noise, see `residuals_are_white`.
    """

    name: str
    error: float
    weights: int
    inverse: bool
    found: Found | None = None
    leaves_noise: bool = False


def screen(data: Dataset) -> Iterator[Screened]:
    """Score the families with a closed form: on thinned records, with few of their choices, and other parameters where they start.

    The search comes first, and the only one where it leaves nothing but noise, as in `compare`.
    """
    data = without_faults(data)
    short = thinned(data)  # not for the search, whose terms may depend on the rate
    for name in candidates(data).closed:
        found = None
        if name == SEARCH:
            found = search_structure(data)
            model, error = found.model, found.score
        elif (first := SizeSearch(short).first(make_model(name))) is not None:
            model, error = first
        else:  # it has no sizes to choose
            try:
                problem, _ = started_problem(make_model(name), short if make_model(name).allows_thinning else data)
                system = LinearSystem.of(problem, problem.space.vector(problem.model))
            except HystfitError:  # these records cannot start it
                continue
            model, error = problem.model, float(fit_ridge(system).score)
        weights = weights_of(model)
        noise = found is not None and residuals_are_white(found.residuals(), Baselines.of(data).curve, weights)
        yield Screened(model_name(model), error, weights, model.has_inverse, found, noise)
        if noise:
            return


def best_screened(models: Iterable[Screened], samples: int, span: float) -> Screened:
    """The model to try first: of those whose errors this number of samples does not tell apart, the one with the fewest weights.

    Where every error is poor, few weights speak for no model, and the smallest error decides.

    Args:
        span: range of the output.
    """
    own = lambda one: one.error * (1.0 if one.inverse else MARGIN)
    every = list(models)
    least = min(map(own, every))
    within = equal_errors(samples) if 100 * least <= POOR * span else 1.0
    return min((one for one in every if own(one) <= within * least), key=lambda one: one.weights)
