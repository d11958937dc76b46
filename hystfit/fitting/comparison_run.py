"""The candidates of a comparison: each gets a first fit, and the best ones a fit and a validation until no other can win."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.errors import HystfitError
from hystfit.fitting.comparison import AT_ONE_PACE, MARGIN, Obstacles, Purpose, Row, handicap
from hystfit.fitting.contender import Candidate, First, leader
from hystfit.fitting.fit_model import Solved, solve_model
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import choose_method, set_up_fit, solve, started_problem
from hystfit.fitting.least_squares import LeastSquares
from hystfit.fitting.left_out import LeftOut, bic, left_out_error, ranking_error
from hystfit.fitting.registry import ESTIMATORS
from hystfit.fitting.remains import correlation_of, leaves_noise, without_loop
from hystfit.fitting.sizes import Known, SizeSearch, weights_of
from hystfit.fitting.thinning import thinned
from hystfit.fitting.trial import with_left_out
from hystfit.inference.problem import Problem
from hystfit.inference.weights import Split
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import SEARCH, make_model, model_name
from hystfit.models.starting import output_range
from hystfit.outcome import Code, Status
from hystfit.outcome.progress import ShownProgress
from hystfit.quality.held_out import HeldOut, Scheme, equal_errors, held_out, inner_loops
from hystfit.quality.summary import paces
from hystfit.results.result import FitResult
from hystfit.runs.threads import Workers

# What a solver raises on data that it cannot handle, besides the library's own errors.
_SOLVER_ERRORS = (HystfitError, np.linalg.LinAlgError, ArithmeticError, RuntimeError)

WHITE = "the residuals of the best model are noise"
_FIRST_STARTS = 2  # starting points of a first fit
# Error of a fit that descends over that of its first fit, at least: 0.983 to 1.007 in 35 fits of six measured files.
_LOWERED = 0.95

_Work = Callable[[Candidate, Callable[[str], object]], None]


class ComparisonRun:
    """Fits candidates and keeps their rows.

    Args:
        data: records.
        left_out, purpose: see `compare`.
        options: of every fit.
        named: models by the name of their row; where the user chose them, every one is validated, however poor its fit.
        shown: progress of the models.
        workers: which fit them side by side.
    """

    def __init__(
        self,
        data: Dataset,
        left_out: LeftOut,
        purpose: Purpose,
        options: FitOptions,
        named: dict[str, Any],
        shown: ShownProgress,
        workers: Workers,
    ):
        self.data, self.left_out, self.purpose, self.options, self.named = data, left_out, purpose, options, named
        self.one_pace = paces(data) < 2
        self.rows: list[Row] = []
        self.fits: dict[str, FitResult] = {}
        self._shown, self._workers = shown, workers
        self._solved: dict[str, Solved] = {}
        self._correlated: dict[str, int] = {}  # samples over which the residuals of a fit are correlated
        self.errors: list[Exception] = []
        self._early: dict[str, Solved] = {}  # fits that the choice of a spacing needed
        # Of the last fit, which the next one takes where its bounds alone differ.
        self._equations: tuple[Problem, Split] | None = None
        self._known = Known()
        # Final cross-validation errors over those of first fits, of models with elements.
        self._lowered: list[float] = []

    # -- the candidates in turn --

    def run(self, names: Sequence[str]) -> None:
        """Fit and validate candidates side by side, and stop those that cannot win; an error leaves one out."""
        self.finish(self.looked_at(names))

    def run_again(self, names: Sequence[str], options: FitOptions) -> None:
        """Forget what was found, and run candidates with other options."""
        self.options, self.rows, self.fits, self.errors, self._early = options, [], {}, [], {}
        self.run(names)

    def looked_at(self, names: Sequence[str]) -> list[Candidate]:
        """Candidates after their first fits."""
        candidates = [Candidate(name) for name in names]
        self._each(self._first_fit, candidates)
        return candidates

    def finish(self, candidates: Sequence[Candidate], *, past_white: bool = True) -> None:
        """Fit and validate candidates in the order of their first fits; where the best leaves noise the others stop unless `past_white`."""
        waiting = self._keep_finished(candidates)
        while waiting:
            if not past_white and self.is_white():
                self.skip([one.name for one in waiting], WHITE)
                return
            waiting = self.after_next(waiting)

    def after_next(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Fit and validate the model with the best first fit; returns those that may still win."""
        waiting = self._keep_finished(candidates)
        for one in waiting:
            one.row = self._excluded_row(one)
        ahead = leader([one for one in waiting if one.row is None], self.equal)
        if ahead is not None:
            self._each(self._fit, [ahead])
            ahead.row = ahead.row or self._beaten_row(ahead)
            self._each(self._validate, [ahead] if ahead.row is None else [])
        return self._keep_finished(waiting)

    def skip(self, names: Sequence[str], reason: str) -> None:
        """Add a row for each candidate that is not tried."""
        note = "not tried: {} (hystfit compare --models {} tries it)"
        self.rows += [Row(name, name, note=note.format(reason, name)) for name in names]

    def _each(self, work: _Work, chosen: Sequence[Candidate]) -> None:
        self._workers.run([functools.partial(self._timed, work, one) for one in chosen])

    def _timed(self, work: _Work, one: Candidate) -> None:
        """Run one piece of work on a candidate and measure its time; an error becomes the candidate's row."""

        def say(text: str) -> None:
            self._workers.check()
            self._shown.step(one.name, text)

        started = time.perf_counter()
        try:
            work(one, say)
        except _SOLVER_ERRORS as error:
            one.row = Row(one.name, one.name, status=Status.FAILED, note=f"left out: {error}")
            one.failure = error
        one.seconds += time.perf_counter() - started

    def _keep_finished(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Add the rows of candidates that are done, and return the others."""
        for one in candidates:
            if one.row is None:
                continue
            self.rows.append(dataclasses.replace(one.row, seconds=one.seconds))
            if one.failure is not None:
                self.errors.append(one.failure)
            if one.result is not None and one.solved is not None:
                self.fits[one.name], self._solved[one.name] = one.result, one.solved
                self._correlated[one.name] = correlation_of(one.result)
                first, left_out = one.first, one.result.left_out
                if first is not None and first.model is not None and left_out is not None:
                    self._lowered.append(left_out / first.error if left_out < first.error else 1.0)
            self._shown.done(one.name)
        return [one for one in candidates if one.row is None]

    # -- one candidate --

    def _first_fit(self, one: Candidate, progress: Callable[[str], object]) -> None:
        """A first fit, which decides whether a model is validated; the models that users chose, and a search, are validated."""
        if self.named or one.name == SEARCH:
            self._fit(one, progress)
            self._validate(one, progress)
            return
        model = make_model(one.name)
        known = self._alike(model)
        if known is not None and known.left_out is not None:
            one.first = First(known.left_out, len(known.free_names), handicap=self._handicap(Status.OK, model))
            return
        progress("first fit")
        one.sizes = SizeSearch(self.data, self.options.spacing, progress, self._known)
        if (found := one.sizes.first(model)) is not None:
            one.first = First(found[1], weights_of(found[0]), found[0], handicap=self._handicap(Status.OK, model))
        else:
            fitted = thinned(self.data) if model.allows_thinning else self.data
            problem, points = started_problem(model, fitted)
            method = ESTIMATORS.make(choose_method(problem)).quick()
            # Points that a model reads off the records are sorted, the best first.
            starts = 1 if len(points) > 1 else min(_FIRST_STARTS, self.options.starts)
            alike = self._all_held and [*map(len, fitted)] == [*map(len, self.data)]
            lowered = _LOWERED if alike and isinstance(method, LeastSquares) else 1 / MARGIN
            estimate = solve(problem, method, starts, self.options.seed, points, self._worth(lowered, model))
            weight = np.asarray(problem.objective.batch.weight)
            rms = problem.scales.y * float(np.nan_to_num(np.sqrt(2 * estimate.cost / weight.sum()), nan=np.inf))
            one.first = First(rms, estimate.x.size, lowered=lowered, handicap=self._handicap(Status.OK, model))

    def _alike(self, model: AbstractHysteresis, first: First | None = None) -> FitResult | None:
        """The fit of a model with the same elements and other bounds, whose size serves both unless a first fit errs less."""
        # Beside bounded masses, and of reversal curves beside either.
        least = np.inf if first is None or first.model is None else first.error
        kinds = ((fit, type(fit.model)) for fit in self.fits.values() if model.choices(list(self.data)))
        alike = lambda kind: isinstance(model, kind) or (model.from_saturation and issubclass(kind, type(model)))
        found = (fit for fit, kind in kinds if alike(kind) and type(model) is not kind)
        return next((fit for fit in found if (fit.left_out or 0.0) <= least), None)

    def _fit(self, one: Candidate, progress: Callable[[str], object]) -> None:
        """Fit a model of the size that suits the data."""
        name = one.name
        progress("fit")
        if name == SEARCH:
            one.solved = solve_model(SEARCH, self.data, self.options)
            return
        given = self.named.get(name, name)
        model = make_model(given)
        # A model that is given, and settings in a name, give the size; the colon of my_model.py:MyModel is none.
        sized = isinstance(given, AbstractHysteresis) or ":" in name.replace(".py:", "")
        (known, self._equations), ready = (self._equations, None), None
        if not sized and (alike := self._alike(model, one.first)) is not None:
            given = type(model).of(**alike.model.settings())
            if known is not None:  # of the same cells
                ready = set_up_fit(given, self.data, self.options, held=True)
                ready.problem.equations = known[1].beside(known[0].space, ready.problem.space, len(self.data))
        elif not sized:
            one.sizes = one.sizes or SizeSearch(self.data, self.options.spacing, progress, self._known)
            chosen, one.choices = one.sizes.chosen(model)
            given = chosen if one.choices else given
        early = self._early.get(model_name(given)) if isinstance(given, AbstractHysteresis) else None
        if one.sizes is not None and isinstance(given, AbstractHysteresis):
            ready = one.sizes.setup(given)
            if ready is not None and ready.problem.equations is not None:
                self._equations = ready.problem, ready.problem.equations
        one.sizes = None  # with its equations
        one.solved = early or solve_model(given, self.data, self.options, self._worth(_LOWERED, model), ready)

    def _worth(self, lowered: float, model: AbstractHysteresis) -> float:
        """The rms error [y] of a descent, of which a finished fit leaves this part at least, above which it would be beaten."""
        return self._most(Status.OK, model) * self.span / 100 / lowered

    def _most(self, status: Status, model: AbstractHysteresis) -> float:
        """The error on left-out data above which a model cannot win [percent of range]."""
        known = None if self.named else self.least
        return np.inf if known is None else self.equal * known / self._handicap(status, model)

    def _validate(self, one: Candidate, progress: Callable[[str], object]) -> None:
        """Measure the error of a fit on left-out data."""
        assert one.solved is not None
        name, result = one.name, one.solved.unjudged
        progress("cross-validation")
        most = self._most(result.status, result.model)
        score, criterion = left_out_error(result, self.left_out, most * self.span / 100), bic(result)
        if self.left_out == "auto" and np.isfinite(score):
            result = with_left_out(result, float(score))
            score = ranking_error(result, float(score), most * self.span / 100)
        stopped = np.isfinite(most) and np.isposinf(score)
        effective = one.solved.estimate.effective or float(len(result.free_names))
        one.result = result.with_notes(*one.choices)
        one.row = Row(
            name=name if ".py:" in name else result.name,
            asked=name,
            score_percent=100 * score / self.span if np.isfinite(score) else None,
            in_sample_percent=result.train.nrmse_percent,
            max_error_percent=result.train.max_error_percent,
            parameters=len(result.free_names),
            status=result.status,
            note=f"its cross-validation ended at an error of {most:.2g} %, above which it cannot win" * bool(stopped),
            bic=criterion if np.isfinite(criterion) else None,
            obstacles=Obstacles(result),
            family_inverts=result.model.has_inverse,
            hysteretic=result.model.hysteretic,
            paced=self._paced(result.model),
            leaves_noise=bool(np.isfinite(score)) and leaves_noise(result, effective),
            effective=effective,
        )

    def _excluded_row(self, one: Candidate) -> Row | None:
        """The row of a model whose first fit is far from the error above which it cannot win; None for a model that may win."""
        first, name = one.first, one.name
        if first is None:
            return None
        most = self._most(Status.OK, make_model(name))
        error = 100 * first.error / self.span
        # Sizes and other choices lower the error of a model with elements by about as much as that of another, or as a fit does.
        lowered = min([first.lowered, *(self._lowered if first.model is not None else ())])
        if not np.isfinite(error) or error * lowered <= most:
            return None
        note = (
            f"stopped after a first fit with an error of {error:.2g} %, because beside another model it cannot win above a "
            f"cross-validation error of {most:.2g} % (hystfit compare --models {name} validates it)"
        )
        return Row(name, name, in_sample_percent=error, parameters=first.parameters, note=note)

    def _beaten_row(self, one: Candidate) -> Row | None:
        """The row of a model that errs more on the samples it was fitted to than another on left-out data; None for the others."""
        if one.solved is None:
            return None
        result = one.solved.unjudged
        most = self._most(result.status, result.model)
        error = 100 * result.problem.error_where_held_out(result.problem.misfit(result.x)) / self.span
        if error <= most:
            return None
        note = (
            f"not cross-validated: its error on the fitted samples, {error:.2g} %, exceeds the cross-validation error above "
            f"which it cannot win beside another model, {most:.2g} % (hystfit compare --models {one.name} validates it)"
        )
        largest, parameters = result.train.max_error_percent, len(result.free_names)
        return Row(result.name, one.name, None, error, largest, parameters, note=note)

    # -- what was found --

    def correlation_of_model(self, model: AbstractHysteresis) -> int:
        """Samples over which the residuals of a model's fit are correlated; the fit is kept for its turn."""
        fit = self._early[model_name(model)] = solve_model(model, self.data, self.options)
        return correlation_of(fit.unjudged)

    @property
    def best(self) -> float | None:
        """The smallest error on left-out data so far, of models that serve the purpose [percent of range]."""
        return min((row.score_percent for row in self._rivals() if row.score_percent is not None), default=None)

    @property
    def least(self) -> float | None:
        """The smallest error so far by which a model ranks, of those that serve the purpose [percent of range]."""
        return min((row.ranked_percent for row in self._rivals() if row.ranked_percent is not None), default=None)

    def _rivals(self) -> list[Row]:
        return [row for row in self.rows if self.purpose == "prediction" or row.serves(self.purpose)]

    @property
    def best_row(self) -> Row | None:
        """The row of the fit with the smallest error on left-out data so far, which a `paced` one must have by far."""
        error = lambda row: row.score / (AT_ONE_PACE if row.paced else 1.0)
        return min((row for row in self.rows if row.asked in self.fits), key=error, default=None)

    @property
    def equal(self) -> float:
        """Ratio of errors on held-out samples up to which models are not told apart."""
        samples = sum(int(record.used.sum()) for record in self.data)
        return equal_errors(samples, 1 if (best := self.best_row) is None else self._correlated[best.asked])

    def is_white(self, *, paced: bool | None = False) -> bool:
        """Whether the best model leaves only noise; `paced` also requires `Row.paced` of it to be this, None does not."""
        best = self.best_row
        return best is not None and best.leaves_noise and paced in (None, best.paced)

    def may_win(self, name: str) -> bool:
        """Whether a model that leaves nothing but the noise of the output could win."""
        noise = max((fit.baselines.noise or 0.0 for fit in self.fits.values()), default=0.0)
        return 100 * noise / self.span < self._most(Status.OK, make_model(name))

    def shows_no_loop(self, names: Sequence[str]) -> bool:
        """Whether the best model leaves white residuals, and no loop worth the parameters of these models."""
        best = self.best_row
        if best is None or not names:
            return False
        return without_loop(self.fits[best.asked], min(weights_of(make_model(name)) for name in names))

    def overfits(self) -> bool:
        """Whether the best model errs more on held-out samples than on those that it was fitted to."""
        best = self.best_row
        fitted = None if best is None else best.in_sample_percent
        return best is not None and fitted is not None and best.score > self.equal * fitted

    def judged(self, name: str) -> FitResult:
        """A fit with its standard errors."""
        self._equations, self._known, known = None, Known(), self.fits[name]
        result = self._solved[name].judged()
        if known.left_out is not None:
            result = with_left_out(result, known.left_out)
        return result.with_notes(
            *(note for note in known.notes if note.code is Code.CHOICE and note not in result.notes)
        )

    @property
    def scheme(self) -> Scheme:
        """What was held out."""
        if self.left_out == "future":
            return Scheme.FUTURE
        scattered = self.held.scheme is Scheme.SCATTERED
        return Scheme.INNER if scattered and inner_loops(list(self.data)) is not None else self.held.scheme

    @functools.cached_property
    def held(self) -> HeldOut:
        """The groups that are held out in turn."""
        return held_out(list(self.data))

    def _handicap(self, status: Status, model: AbstractHysteresis) -> float:
        return handicap(status, model.has_inverse, self._paced(model))

    def _paced(self, model: AbstractHysteresis) -> bool:
        """See `Row.paced`."""
        return self.one_pace and not model.rate_independent

    @functools.cached_property
    def _all_held(self) -> bool:
        """Whether all samples are held out in turn: only then the error on held-out samples is that of all."""
        return all((fold >= 0)[record.used].all() for fold, record in zip(self.held.folds, self.data, strict=True))

    @functools.cached_property
    def span(self) -> float:
        """Range of the output [y]."""
        return output_range(self.data).width
