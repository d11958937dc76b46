"""What is done to one candidate of a comparison: a first fit, the fit of the size that suits the data, and its validation."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from hystfit.config import expect_few_runs
from hystfit.data.dataset import Dataset
from hystfit.fitting.comparison.compared_models import MARGIN, Obstacles, Row
from hystfit.fitting.comparison.contender import Candidate, First
from hystfit.fitting.comparison.left_out import LeftOut, bic, inner_error, left_out_error
from hystfit.fitting.comparison.sizes import Known, SizeSearch, weights_of
from hystfit.fitting.comparison.standings import Standings, correlation_of, leaves_noise
from hystfit.fitting.comparison.told_filters import with_filters_of
from hystfit.fitting.fit_model import Solved, solve_model
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import FitSetup, choose_method, set_up_fit, solve, started_problem
from hystfit.fitting.solvers.least_squares import LeastSquares
from hystfit.fitting.solvers.registry import ESTIMATORS
from hystfit.fitting.solvers.thinning import thinned
from hystfit.fitting.trial import with_inner_loops, with_left_out
from hystfit.inference.problem import Problem
from hystfit.inference.weights import Split
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import SEARCH, make_model, model_name
from hystfit.outcome import Code, Note, Status
from hystfit.results.result import FitResult

_FIRST_STARTS = 2  # starting points of a first fit
# Error of a fit that descends over that of its first fit, at least: 0.983 to 1.007 in 35 fits of six measured files.
_LOWERED = 0.95

Progress = Callable[[str], object]


class CandidateFits:
    """Fits of candidates, which use what those of others told: sizes, equations of the same elements, and the error to beat.

    `named` are models by the name of their row, where the user chose them; the standings are those of the models that are done.
    """

    def __init__(
        self, data: Dataset, left_out: LeftOut, options: FitOptions, named: dict[str, Any], standings: Standings
    ):
        self.data, self.left_out, self.options, self.named, self.standings = data, left_out, options, named, standings
        self._early: dict[str, Solved] = {}  # fits that the choice of a spacing needed
        # Of the last fit, which the next one takes where its bounds alone differ.
        self._equations: tuple[Problem, Split] | None = None
        self._known = Known()
        # Final cross-validation errors over those of first fits, of models with elements.
        self._lowered: list[float] = []

    def few_runs(self, name: str) -> AbstractContextManager[None]:
        """Context for the work on a model, whose small programs are compiled quickly unless its steps search.

        Without optimization those of `jiles-atherton` take 0.7 of the time to compile, and four times as long to run.
        """
        return expect_few_runs(long=name != SEARCH and make_model(self.named.get(name, name)).searches)

    # -- the first fit, which decides whether and when a model is validated --

    def first(self, one: Candidate, progress: Progress) -> None:
        """Make a first fit; models that the user chose, and a search, are validated at once."""
        if self.named or one.name == SEARCH:
            self.fit(one, progress)
            self.validate(one, progress)
            return
        model = make_model(one.name)
        handicap = self.standings.handicap(Status.OK, model)
        known = self._alike(model)
        if known is not None and known.left_out is not None:
            one.first = First(known.left_out, len(known.free_names), handicap=handicap)
            return
        progress("first fit")
        one.sizes = SizeSearch(self.data, self.options.spacing, progress, self._known, self._told)
        if (found := one.sizes.first(model)) is not None:
            one.first = First(found[1], weights_of(found[0]), found[0], handicap=handicap)
        else:
            one.first, one.started = self._descended(model)
            one.first = one.first._replace(handicap=handicap)

    def _descended(self, model: AbstractHysteresis) -> tuple[First, tuple[AbstractHysteresis, ...]]:
        """The first fit of a model without elements, by few starting points and steps that end early, and what it started from.

        The latter is empty where the fit starts from more samples.
        """
        # A filter sees an input of coarser steps later: of a sweep to 50 Hz thinned samples left six times the error.
        fitted = thinned(self.data) if model.allows_thinning and model.rate_independent else self.data
        problem, points = started_problem(model, fitted)
        method = ESTIMATORS.make(choose_method(problem)).quick()
        # Points that a model reads off the records are sorted, the best first.
        starts = 1 if len(points) > 1 else min(_FIRST_STARTS, self.options.starts)
        alike = self.standings.all_held and [*map(len, fitted)] == [*map(len, self.data)]
        lowered = _LOWERED if alike and isinstance(method, LeastSquares) else 1 / MARGIN
        estimate = solve(problem, method, starts, self.options.seed, points, self._worth(lowered, model))
        weight = np.asarray(problem.objective.batch.weight)
        rms = problem.scales.y * float(np.nan_to_num(np.sqrt(2 * estimate.cost / weight.sum()), nan=np.inf))
        return First(rms, estimate.x.size, lowered=lowered), points if fitted is self.data else ()

    def excluded(self, one: Candidate) -> Row | None:
        """The row of a model whose first fit is far from the error above which it cannot win; None for a model that may win."""
        first, name = one.first, one.name
        if first is None:
            return None
        most = self.standings.most(Status.OK, make_model(name))
        error = 100 * first.error / self.standings.span
        # Sizes and other choices lower the error of a model with elements by about as much as that of another, or as a fit does.
        lowered = min([first.lowered, *(self._lowered if first.model is not None else ())])
        if not np.isfinite(error) or error * lowered <= most:
            return None
        note = (
            f"stopped after a first fit with an error of {error:.2g} %, because beside another model it cannot win above a "
            f"cross-validation error of {most:.2g} % (hystfit compare --models {name} validates it)"
        )
        return Row(name, name, in_sample_percent=error, parameters=first.parameters, note=note)

    # -- the fit --

    def fit(self, one: Candidate, progress: Progress) -> None:
        """Fit a model of the size that suits the data."""
        progress("fit")
        if one.screened is not None:
            options = dataclasses.replace(self.options, start=_shared_values(one.screened), starts=1)
            model = one.screened.model
            few, records = len(one.screened.problem.data), len(self.data)
            text = f"models were compared on {few} of {records} records, and the best there fitted to all"
            one.choices = (Note(Code.CHOICE, text),)
            one.solved = solve_model(model, self.data, options, self._worth(_LOWERED, model))
            return
        if one.name == SEARCH:
            one.solved = solve_model(SEARCH, self.data, self.options)
            return
        given = self.named.get(one.name, one.name)
        model = make_model(given)
        of_last, self._equations = self._equations, None
        # A model that is given, and settings in a name, give the size; the colon of my_model.py:MyModel is none.
        sized = isinstance(given, AbstractHysteresis) or ":" in one.name.replace(".py:", "")
        ready = None
        if not sized:
            chosen, ready = self._sized(one, model, progress, of_last)
            given = given if chosen is None else chosen
        one.sizes = None  # with its equations
        early = self._early.get(model_name(given)) if isinstance(given, AbstractHysteresis) else None
        if one.started and ready is None:
            ready = set_up_fit(model, self.data, self.options, started=one.started)
        one.solved = early or solve_model(given, self.data, self.options, self._worth(_LOWERED, model), ready)

    def _sized(
        self, one: Candidate, model: AbstractHysteresis, progress: Progress, of_last: tuple[Problem, Split] | None
    ) -> tuple[AbstractHysteresis | None, FitSetup | None]:
        """The model of the size that suits the data, and its setup if known; none without choices. `of_last`: equations of the last fit."""
        if (alike := self._alike(model, one.first)) is not None:
            given = type(model).of(**alike.model.settings())  # type: ignore[attr-defined]
            if of_last is None:
                return given, None
            ready = set_up_fit(given, self.data, self.options, held=True)
            problem, equations = of_last  # of the same cells
            ready.problem.equations = equations.beside(problem.space, ready.problem.space, len(self.data))
            return given, ready
        sizes = one.sizes or SizeSearch(self.data, self.options.spacing, progress, self._known, self._told)
        chosen, one.choices = sizes.chosen(model)
        if not one.choices:
            return None, None
        if (ready := sizes.setup(chosen)) is not None and ready.problem.equations is not None:
            self._equations = ready.problem, ready.problem.equations
        if ready is None:
            started = chosen.start(list(self.data))
            if (told := self._told(started)) is not started:
                ready = set_up_fit(chosen, self.data, self.options, started=(told,))
        return chosen, ready

    def _told(self, model: AbstractHysteresis) -> AbstractHysteresis:
        """A model whose filters, such as a lag or a relaxation, have the values of those in the best fit that has such ones."""
        fits = sorted(self.standings.fits.values(), key=lambda fit: fit.left_out or np.inf)
        return with_filters_of([fit.model for fit in fits], model)

    def _alike(self, model: AbstractHysteresis, first: First | None = None) -> FitResult | None:
        """The fit of a model with the same elements and other bounds, whose size serves both unless a first fit errs less."""
        # Beside bounded masses, and of reversal curves beside either.
        least = np.inf if first is None or first.model is None else first.error
        fits = self.standings.fits.values()
        kinds = ((fit, type(fit.model)) for fit in fits if model.choices(list(self.data)))
        alike = lambda kind: isinstance(model, kind) or (model.from_saturation and issubclass(kind, type(model)))
        found = (fit for fit, kind in kinds if alike(kind) and type(model) is not kind)
        return next((fit for fit in found if (fit.left_out or 0.0) <= least), None)

    def _worth(self, lowered: float, model: AbstractHysteresis) -> float:
        """The rms error [y] of a descent, of which a finished fit leaves this part at least, above which it would be beaten."""
        return self.standings.most(Status.OK, model) * self.standings.span / 100 / lowered

    def correlation_of_model(self, model: AbstractHysteresis) -> int:
        """Samples over which the residuals of a model's fit are correlated; the fit is kept for its turn."""
        fit = self._early[model_name(model)] = solve_model(model, self.data, self.options)
        return correlation_of(fit.unjudged)

    def beaten(self, one: Candidate) -> Row | None:
        """The row of a model that errs more on the samples it was fitted to than another on left-out data; None for the others."""
        if one.solved is None:
            return None
        result = one.solved.unjudged
        most = self.standings.most(result.status, result.model)
        error = 100 * result.problem.error_where_held_out(result.problem.misfit(result.x)) / self.standings.span
        if error <= most:
            return None
        note = (
            f"not cross-validated: its error on the fitted samples, {error:.2g} %, exceeds the cross-validation error above "
            f"which it cannot win beside another model, {most:.2g} % (hystfit compare --models {one.name} validates it)"
        )
        largest, parameters = result.train.max_error_percent, len(result.free_names)
        return Row(result.name, one.name, None, error, largest, parameters, note=note)

    # -- the validation --

    def validate(self, one: Candidate, progress: Progress) -> None:
        """Measure the error of a fit on left-out data."""
        assert one.solved is not None
        result, span = one.solved.unjudged, self.standings.span
        progress("cross-validation")
        most = self.standings.most(result.status, result.model)
        score, criterion = left_out_error(result, self.left_out, most * span / 100), bic(result)
        if self.left_out == "auto" and np.isfinite(score):
            result = with_left_out(result, float(score))
            inner = inner_error(result, float(score), most * span / 100)
            if inner is not None:
                result = with_inner_loops(result, inner)
                score = float(np.sqrt(score * inner))
        known, stopped = np.isfinite(score), np.isfinite(most) and np.isposinf(score)
        effective = one.solved.estimate.effective or float(len(result.free_names))
        one.result = result.with_notes(*one.choices)
        one.row = Row(
            name=one.name if ".py:" in one.name else result.name,
            asked=one.name,
            score_percent=100 * score / span if known else None,
            in_sample_percent=result.train.nrmse_percent,
            max_error_percent=result.train.max_error_percent,
            parameters=len(result.free_names),
            status=result.status,
            note=f"its cross-validation ended at an error of {most:.2g} %, above which it cannot win" * bool(stopped),
            bic=criterion if np.isfinite(criterion) else None,
            obstacles=Obstacles(result),
            family_inverts=result.model.has_inverse,
            hysteretic=result.model.hysteretic,
            paced=self.standings.paced(result.model),
            leaves_noise=bool(known) and leaves_noise(result, effective),
            effective=effective,
        )
        if one.first is not None and one.first.model is not None and result.left_out is not None:
            self._lowered.append(one.first.left_by(result.left_out))

    # -- what is kept between candidates --

    def restart(self, options: FitOptions) -> None:
        """Fit with other options from here on."""
        self.options, self._early = options, {}

    def release(self) -> None:
        """Forget equations and sizes, which take memory."""
        self._equations, self._known = None, Known()


def _shared_values(fit: FitResult) -> dict[str, float]:
    """Values of the parameters that all records share and that are no weights, by name."""
    space = fit.problem.space
    kept = ~(space.per_record | space.linear)
    return {name: float(value) for name, value, keep in zip(space.names, fit.x, kept, strict=True) if keep}
