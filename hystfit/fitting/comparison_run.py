"""The candidates of a comparison: which are fitted, which are validated on left-out data, and which are stopped before."""

from __future__ import annotations

import dataclasses
import functools
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.errors import DataError, HystfitError, ModelError
from hystfit.fitting.candidates import Candidates
from hystfit.fitting.comparison import Purpose, Row
from hystfit.fitting.fit_model import fit_model
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import choose_method, solve, started_problem
from hystfit.fitting.left_out import Scheme, bic, left_out_error
from hystfit.fitting.registry import ESTIMATORS
from hystfit.fitting.sizes import choose_size, first_error
from hystfit.fitting.thinning import thinned
from hystfit.fitting.trial import with_left_out
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import SEARCH, make_model
from hystfit.models.starting import output_range
from hystfit.outcome import Status
from hystfit.results.result import FitResult
from hystfit.runs.threads import Workers

# What a solver raises on data that it cannot handle, besides the library's own errors.
_SOLVER_ERRORS = (HystfitError, np.linalg.LinAlgError, ArithmeticError, RuntimeError)
EQUAL = 1.02  # errors on left-out data up to this times the smallest do not tell models apart
_HOPELESS = 2.0  # a model whose first fit errs this much more than the best on left-out data is not validated
_HOPELESS_SIZE = 3.0  # the same of models with elements, whose other sizes may err less than the default one
_FIRST_STARTS = 2  # starting points of that fit


class ShownProgress:
    """Progress of models that are fitted side by side: each line names a model, its step, and how many are done.

    Args:
        update: called with a line of text and the fraction done.
        names: of the models.
    """

    def __init__(self, update: Callable[..., object], names: Sequence[str]):
        self._update, self._count, self._done, self._lock = update, len(names), 0, threading.Lock()
        update(f"{self._count} to try: {', '.join(names)}", 0.0)

    def step(self, name: str, text: str) -> None:
        """Report the step that a model has reached."""
        with self._lock:
            self._update(f"{name}: {text}", self._done / self._count)

    def done(self, name: str) -> None:
        """Report that a model is finished."""
        with self._lock:
            self._done += 1
            self._update(f"{name}: done ({self._done} of {self._count})", self._done / self._count)


class _First(NamedTuple):
    """The first fit of a model: its rms error [y], how many times the best error it may be, and its number of parameters."""

    error: float
    limit: float
    parameters: int | None = None


@dataclasses.dataclass
class Candidate:
    """A model in a comparison, with the results so far.

    Attributes:
        name: of its row.
        row: once it is validated, stopped, or has failed.
        fitted: the fit, before its validation.
        result: the fit, where it is validated.
        first: the first fit, where there was one.
        failure: why there is no result.
        seconds: time of its fits and validation.
    """

    name: str
    row: Row | None = None
    fitted: FitResult | None = None
    result: FitResult | None = None
    first: _First | None = None
    failure: Exception | None = None
    seconds: float = 0.0


def _contenders(waiting: Sequence[Candidate]) -> list[Candidate]:
    """The models to validate next: those whose first fit is near the best, because they may stop the others.

    Of models with elements, which take longest, first.
    """
    firsts = [(one, one.first) for one in waiting if one.first is not None]
    sized = [(one, first) for one, first in firsts if first.limit == _HOPELESS_SIZE]
    least = min((first.error for _, first in sized or firsts), default=0.0)
    return [one for one, first in sized or firsts if first.error <= first.limit * least]


class ComparisonRun:
    """Fits candidates and keeps their rows.

    Args:
        data: records.
        left_out, purpose: see `compare`.
        options: of every fit.
        named: models by the name of their row; where the user chose them, every one is validated, however poor its fit.
    """

    def __init__(self, data: Dataset, left_out: Scheme, purpose: Purpose, options: FitOptions, named: dict[str, Any]):
        self.data, self.left_out, self.purpose, self.options, self.named = data, left_out, purpose, options, named
        self.rows: list[Row] = []
        self.fits: dict[str, FitResult] = {}
        self.errors: list[Exception] = []

    def search(self, chosen: Candidates, shown: ShownProgress, workers: Workers) -> None:
        """Run the candidates; models without a resonance only where the search, which has none, errs about as little as the best."""
        names = (*chosen.names, *chosen.without_resonance)
        self.run(chosen.names, shown, workers)
        if chosen.without_resonance:
            rows = self._rows_without_resonance(chosen.without_resonance)
            if rows is None:
                self.run(chosen.without_resonance, shown, workers)
            else:
                self.rows += rows
        self.rows.sort(key=lambda row: names.index(row.asked) if row.asked in names else -1)

    def _rows_without_resonance(self, names: Sequence[str]) -> list[Row] | None:
        """Rows of models that are not tried, because a resonance is needed; None where that is in doubt."""
        best = self._best()
        search = next((row.score_percent for row in self.rows if row.asked == SEARCH), None)
        if best is None or search is None or search <= _HOPELESS * best:
            return None
        note = (
            f"not tried: without a resonance the cross-validation error is {search:.2g} %, with one {best:.2g} % "
            "(hystfit compare --models NAME tries a model)"
        )
        return [Row(name, name, None, None, None, None, 0.0, Status.UNTESTED, note) for name in names]

    def run(self, names: Sequence[str], shown: ShownProgress, workers: Workers) -> None:
        """Fit and validate candidates side by side, and stop those that cannot win; an error leaves one out."""

        def each(work: Callable[[Candidate, Callable[[str], object]], None], chosen: Sequence[Candidate]) -> None:
            workers.run([functools.partial(self._timed, work, one, shown, workers) for one in chosen])

        candidates = [Candidate(name) for name in names]
        each(self._first_fit, candidates)
        waiting = self._keep_finished(candidates, shown)
        while waiting:
            for one in waiting:
                one.row = self._excluded_row(one)
            contenders = _contenders([one for one in waiting if one.row is None])
            each(self._fit, contenders)
            for one in contenders:
                one.row = one.row or self._beaten_row(one)
            each(self._validate, [one for one in contenders if one.row is None])
            waiting = self._keep_finished(waiting, shown)

    def _timed(
        self,
        work: Callable[[Candidate, Callable[[str], object]], None],
        one: Candidate,
        shown: ShownProgress,
        workers: Workers,
    ) -> None:
        """Run one piece of work on a candidate and measure its time; an error becomes the candidate's row."""

        def say(text: str) -> None:
            workers.check()
            shown.step(one.name, text)

        started = time.perf_counter()
        try:
            work(one, say)
        except _SOLVER_ERRORS as error:
            one.row = Row(one.name, one.name, None, None, None, None, 0.0, Status.FAILED, f"left out: {error}")
            one.failure = error
        one.seconds += time.perf_counter() - started

    def _keep_finished(self, candidates: Sequence[Candidate], shown: ShownProgress) -> list[Candidate]:
        """Add the rows of candidates that are done, and return the others."""
        for one in candidates:
            if one.row is None:
                continue
            self.rows.append(dataclasses.replace(one.row, seconds=one.seconds))
            if one.failure is not None:
                self.errors.append(one.failure)
            if one.result is not None:
                self.fits[one.name] = one.result
            shown.done(one.name)
        return [one for one in candidates if one.row is None]

    def refusal(self, rows: Sequence[Row]) -> HystfitError:
        """The error where no candidate could be fitted: what is wrong with the data, where all found the same."""
        first = self.errors[0]
        if isinstance(first, DataError) and all(str(error) == str(first) for error in self.errors):
            return first
        return ModelError("no model could be fitted: " + "; ".join(f"{row.name}: {row.note}" for row in rows))

    def _fit(self, one: Candidate, progress: Callable[[str], object]) -> None:
        """Fit a model of the size that suits the data."""
        name = one.name
        progress("fit")
        if name == SEARCH:
            one.fitted = fit_model(SEARCH, self.data, self.options)
            return
        given = self.named.get(name, name)
        model = make_model(given)
        # A model that is given, and settings in a name, give the size; the colon of my_model.py:MyModel is none.
        sized = isinstance(given, AbstractHysteresis) or ":" in name.replace(".py:", "")
        first = one.first.error if one.first else None
        if not sized and (choice := choose_size(model, self.data, progress, first)).notes:
            one.fitted = fit_model(choice.model, self.data, self.options).with_notes(*choice.notes)
        else:
            one.fitted = fit_model(given, self.data, self.options)

    def _validate(self, one: Candidate, progress: Callable[[str], object]) -> None:
        """Measure the error of a fit on left-out data."""
        name, result = one.name, one.fitted
        assert result is not None
        progress("cross-validation")
        score, criterion = left_out_error(result, self.left_out), bic(result)
        if self.left_out == "blocks" and np.isfinite(score):
            result = with_left_out(result, float(score))
        obstacles = {use: text for use in ("inverse", "export") if (text := result.obstacle(use))}
        one.result = result
        one.row = Row(
            name=name if ".py:" in name else result.name,
            asked=name,
            score_percent=100 * score / self._span if np.isfinite(score) else None,
            in_sample_percent=result.train.nrmse_percent,
            max_error_percent=result.train.max_error_percent,
            parameters=len(result.free_names),
            seconds=0.0,
            status=result.status,
            bic=criterion if np.isfinite(criterion) else None,
            obstacles=obstacles,
        )

    def _first_fit(self, one: Candidate, progress: Callable[[str], object]) -> None:
        """A first fit, which decides whether a model is validated; the models that users chose, and a search, are validated."""
        if self.named or one.name == SEARCH:
            self._fit(one, progress)
            self._validate(one, progress)
            return
        model = make_model(one.name)
        progress("first fit")
        if (error := first_error(model, self.data)) is not None:
            one.first = _First(error, _HOPELESS_SIZE)
        else:
            problem, points = started_problem(model, thinned(self.data) if model.allows_thinning else self.data)
            method = ESTIMATORS.make(choose_method(problem)).quick()
            # Points that a model reads off the records are sorted, the best first.
            starts = 1 if len(points) > 1 else min(_FIRST_STARTS, self.options.starts)
            estimate = solve(problem, method, starts, self.options.seed, points)
            weight = np.asarray(problem.objective.batch.weight)
            rms = problem.scales.y * float(np.sqrt(2 * estimate.cost / weight.sum()))
            one.first = _First(rms if np.isfinite(rms) else np.inf, _HOPELESS, estimate.x.size)

    def _best(self) -> float | None:
        """The smallest error on left-out data so far, of models that serve the purpose."""
        rivals = [row for row in self.rows if self.purpose == "prediction" or row.serves(self.purpose)]
        return min((row.score_percent for row in rivals if row.score_percent is not None), default=None)

    def _excluded_row(self, one: Candidate) -> Row | None:
        """The row of a model whose first fit is far from the best error on left-out data; None for a model that may win."""
        best, first, name = self._best(), one.first, one.name
        if best is None or first is None:
            return None
        error = 100 * first.error / self._span
        if not np.isfinite(error) or error <= first.limit * best:
            return None
        note = (
            f"stopped after a first fit with an error of {error:.2g} %, because another model has a cross-validation error "
            f"of {best:.2g} % (hystfit compare --models {name} validates it)"
        )
        return Row(name, name, None, error, None, first.parameters, 0.0, Status.UNTESTED, note)

    def _beaten_row(self, one: Candidate) -> Row | None:
        """The row of a model that errs more on the samples it was fitted to than another on left-out data; None for the others."""
        best, result = self._best(), one.fitted
        if best is None or result is None:
            return None
        weight = np.asarray(result.problem.objective.batch.weight)
        squares = float(np.sum(weight * result.problem.residuals(result.x) ** 2))
        error = 100 * np.sqrt(squares / weight.sum()) / self._span
        if error <= EQUAL * best:
            return None
        note = (
            f"not cross-validated: its error on the fitted samples, {error:.2g} %, exceeds the cross-validation error of another model, "
            f"{best:.2g} % (hystfit compare --models {one.name} validates it)"
        )
        return Row(
            result.name,
            one.name,
            None,
            error,
            result.train.max_error_percent,
            len(result.free_names),
            0.0,
            Status.UNTESTED,
            note,
        )

    @property
    def _span(self) -> float:
        return output_range(self.data).width
