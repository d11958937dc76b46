"""`compare`: which model describes these loops best, judged on data that were left out of its fit."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from hystfit.config import require_seed, require_x64
from hystfit.data.record import Dataset
from hystfit.errors import DataError, HystfitError, ModelError, ParameterError
from hystfit.fitting.candidates import Candidates, candidates
from hystfit.fitting.comparison import Comparison, Purpose, Row
from hystfit.fitting.fit import fit
from hystfit.fitting.fit_setup import choose_method, solve, started_problem, without_saturated
from hystfit.fitting.left_out import SCHEMES, Scheme, bic, left_out_error
from hystfit.fitting.sizes import choose_size, first_error
from hystfit.fitting.thinning import thinned
from hystfit.fitting.verdict import with_left_out
from hystfit.fitting.workers import Workers
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import SEARCH, make_model, model_name
from hystfit.models.starting import output_range
from hystfit.outcome import Status
from hystfit.outcome.progress import progress as shown_progress
from hystfit.quality.reversal_curves import recognize_family
from hystfit.reading.in_memory import records_of
from hystfit.results.result import FitResult

# What a solver raises on data that it cannot handle, besides the library's own errors.
_SOLVER_ERRORS = (HystfitError, np.linalg.LinAlgError, ArithmeticError, RuntimeError)
_EQUAL = 1.02  # errors on left-out data up to this times the smallest do not tell models apart
_HOPELESS = 2.0  # a model whose first fit errs this much more than the best on left-out data is not validated
_HOPELESS_SIZE = 3.0  # the same of models with elements, whose other sizes may err less than the default one
_FIRST_STARTS = 2  # starting points of that fit


def compare(
    data: Any,
    models: Sequence[str | type[AbstractHysteresis] | AbstractHysteresis] | Literal["auto"] | None = None,
    *,
    left_out: Scheme = "blocks",
    purpose: Purpose = "prediction",
    seed: int = 0,
    progress: Callable[..., object] | None = None,
    workers: int | None = None,
) -> Comparison:
    """Fit several models and rank them by their cross-validation error.

    With three or more records, each is held out in turn; otherwise five contiguous blocks of each record. The input drives the
    model through a held-out block, but its output is not fitted. Single samples are never held out, because they are correlated
    with their neighbors. Test data are not used. Among models within 2 % of the smallest error, those whose fit converged and
    those with fewer parameters rank first. A model that cannot be fitted is listed with the reason.

    Args:
        data: one record or several, or a data frame.
        models: names as `hystfit models` lists them (joined by "+"), classes, models, or "prandtl-ishlinskii-search", which searches
            that family for its terms. A name without settings, or a class, stands for the number of elements that suits the data.
            None (or "auto") compares the models that suit what `check` finds, and stops those that cannot win: their first fit has
            more than twice the cross-validation error of the best model. A first fit starts from two points and is judged on the
            fitted samples; that of a model with elements has its default size, is judged by cross-validation, and may have three
            times the error.
        left_out: "blocks" as above; "future" predicts the later parts of every record from fits to what came before, which
            tests the description of creep and drift. Numbers of plays and levels, and the terms of the search, are chosen on blocks.
        purpose: "prediction"; "inverse" or "export" rank models without an inverse, or without C code, below the others.
        seed: of the starting points.
        progress: called with a line of text and the fraction done for each model; None shows them on a terminal or in a notebook.
        workers: number of models that are fitted side by side, in threads; default: one for each core, at most four. The result
            does not depend on it.

    Raises:
        HystfitError: data or settings that cannot be used, an unknown model, or no model that could be fitted.
    """
    require_x64()
    require_seed(seed)
    for what, value, known in (("left_out", left_out, SCHEMES), ("purpose", purpose, get_args(Purpose))):
        if value not in known:
            raise ParameterError(f"{what} must be one of {', '.join(known)}, got {value!r}")
    data = records_of(data)
    if left_out == "future" and recognize_family(data) is not None:
        raise ModelError("reversal curves have no order in time: use left_out='blocks'")
    named = _named(models) if models and models != "auto" else {}
    chosen = Candidates(tuple(named), "") if named else candidates(data)
    data = without_saturated(data)
    judge = _Judge(data, left_out, purpose, seed, named)
    with _progress_or_default(progress) as update:
        judge.run(chosen.names, _Shown(update, chosen.names), Workers(workers))
    rows = _ranked(judge.rows, purpose)
    if not judge.fits:
        raise judge.refusal(rows)
    best = rows[0]
    if purpose != "prediction" and not best.serves(purpose):
        reasons = "; ".join(
            f"{row.name}: {row.obstacles[purpose]}" for row in rows if row.obstacles and purpose in row.obstacles
        )
        raise ModelError(f"no model that was fitted can be used for {purpose}: {reasons}")
    return Comparison(tuple(rows), judge.fits[best.asked], judge.fits, left_out, purpose, chosen.reason)


def _named(models: Sequence[str | type[AbstractHysteresis] | AbstractHysteresis]) -> dict[str, Any]:
    """Models by the name of their row: as it was given, or that of a class or a model, numbered where several have it.

    Raises:
        ModelError: one of them is not a model.
    """
    chosen: dict[str, Any] = {}
    for choice in [models] if isinstance(models, str) else models:
        if isinstance(choice, str):
            if choice != SEARCH:
                make_model(choice)
            chosen[choice] = choice
            continue
        base = model_name(make_model(choice))
        count = sum(name == base or name.startswith(f"{base} (") for name in chosen)
        chosen[f"{base} ({count + 1})" if count else base] = choice
    return chosen


@contextlib.contextmanager
def _progress_or_default(progress: Callable[..., object] | None) -> Iterator[Callable[..., object]]:
    """The caller's progress function, or one that prints to a terminal or notebook."""
    if progress is not None:
        yield progress
        return
    with shown_progress("comparing models") as update:
        yield update


class _Shown:
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


def _ranked(rows: Sequence[Row], purpose: Purpose) -> list[Row]:
    """From best to worst. Of models whose errors are within 2 % of the smallest, converged fits and fewer parameters come first."""
    ranked = sorted(rows, key=lambda row: _rank(row, purpose))
    least = ranked[0].score_percent if ranked else None
    if least is None:
        return ranked
    kind = _rank(ranked[0], purpose)[:-1]
    equal = [row for row in ranked if _rank(row, purpose)[:-1] == kind and (row.score_percent or 0.0) <= _EQUAL * least]
    simple = sorted(equal, key=lambda row: (row.status is Status.NOT_CONVERGED, row.parameters or 0, row.score_percent))
    return simple + ranked[len(equal) :]


def _rank(row: Row, purpose: Purpose) -> tuple[Any, ...]:
    """Fitted models first, then those that serve the purpose, then the smallest error on left-out data."""
    return (
        row.in_sample_percent is None,
        row.status is Status.NO_LOOP,
        purpose != "prediction" and not row.serves(purpose),
        row.score_percent is None,
        row.score_percent or row.in_sample_percent or 0.0,
    )


class _First(NamedTuple):
    """The first fit of a model: its rms error [y], how many times the best error it may be, and its number of parameters."""

    error: float
    limit: float
    parameters: int | None = None


def _contenders(firsts: dict[str, _First], alone: bool) -> list[str]:
    """The models to validate next: of those with elements the ones whose first fit is near the best, because they may stop the others.

    Args:
        firsts: first fits by name.
        alone: no model has been validated yet, so that the others wait for the ones whose first fit is near the best.
    """
    sized = {name: first for name, first in firsts.items() if first.limit == _HOPELESS_SIZE}
    if not sized and not alone:
        return list(firsts)
    least = min((first.error for first in (sized or firsts).values()), default=0.0)
    return [name for name, first in (sized or firsts).items() if first.error <= first.limit * least]


@dataclasses.dataclass(frozen=True)
class _Outcome:
    """Outcome of the work on one candidate.

    Attributes:
        row, result: of the comparison, where the candidate was validated.
        first: the first fit, where there was one.
        failure: why there is no result.
        seconds: what it took.
    """

    row: Row | None = None
    result: FitResult | None = None
    first: _First | None = None
    failure: Exception | None = None
    seconds: float = 0.0

    def after(self, earlier: _Outcome | None) -> _Outcome:
        """This work as the second on the same candidate."""
        if earlier is None:
            return self
        return dataclasses.replace(self, first=earlier.first, seconds=earlier.seconds + self.seconds)


class _Judge:
    """Fits candidates and keeps their rows.

    Args:
        data: records.
        left_out, purpose: see `compare`.
        seed: of the starting points.
        named: models by the name of their row; where the user chose them, every one is validated, however poor its fit.
    """

    def __init__(self, data: Dataset, left_out: Scheme, purpose: Purpose, seed: int, named: dict[str, Any]):
        self.data, self.left_out, self.purpose, self.seed, self.named = data, left_out, purpose, seed, named
        self.rows: list[Row] = []
        self.fits: dict[str, FitResult] = {}
        self.errors: list[Exception] = []

    def run(self, names: Sequence[str], shown: _Shown, workers: Workers) -> None:
        """Fit and validate candidates side by side, and stop those that cannot win; an error leaves one out.

        Args:
            names: of the candidates.
            shown: progress.
            workers: threads.
        """
        outcomes: dict[str, _Outcome] = {}

        def each(work: Callable[[str, Callable[[str], object]], Any], chosen: Sequence[str]) -> None:
            tasks = [functools.partial(self._timed, work, name, shown, workers) for name in chosen]
            for name, outcome in zip(chosen, workers.run(tasks), strict=True):
                outcomes[name] = outcome.after(outcomes.get(name))

        each(self._first_fit, names)
        waiting = [name for name in names if outcomes[name].row is None]
        self._keep([name for name in names if name not in waiting], outcomes, shown)
        while waiting:
            stopped = {name: row for name in waiting if (row := self._excluded_row(name, outcomes[name])) is not None}
            for name, row in stopped.items():
                outcomes[name] = dataclasses.replace(outcomes[name], row=row)
            going = {name: first for name in waiting if name not in stopped and (first := outcomes[name].first)}
            leading = _contenders(going, self._best() is None)
            each(self._judged, leading)
            self._keep([*stopped, *leading], outcomes, shown)
            waiting = [name for name in going if name not in leading]
        self.rows.sort(key=lambda row: names.index(row.asked) if row.asked in names else -1)

    def _timed(
        self, work: Callable[[str, Callable[[str], object]], _Outcome], name: str, shown: _Shown, workers: Workers
    ) -> _Outcome:
        """Run one piece of work on a candidate and measure its time; an error becomes the candidate's row."""

        def say(text: str) -> None:
            workers.check()
            shown.step(name, text)

        started = time.perf_counter()
        try:
            outcome = work(name, say)
        except _SOLVER_ERRORS as error:
            row = Row(name, name, None, None, None, None, 0.0, Status.FAILED, f"left out: {error}")
            outcome = _Outcome(row=row, failure=error)
        return dataclasses.replace(outcome, seconds=time.perf_counter() - started)

    def _keep(self, names: Sequence[str], outcomes: dict[str, _Outcome], shown: _Shown) -> None:
        """Add the rows of candidates that are done."""
        for name in names:
            outcome = outcomes[name]
            assert outcome.row is not None
            self.rows.append(dataclasses.replace(outcome.row, seconds=outcome.seconds))
            if outcome.failure is not None:
                self.errors.append(outcome.failure)
            if outcome.result is not None:
                self.fits[name] = outcome.result
            shown.done(name)

    def refusal(self, rows: Sequence[Row]) -> HystfitError:
        """The error where no candidate could be fitted: what is wrong with the data, where all found the same."""
        first = self.errors[0]
        if isinstance(first, DataError) and all(str(error) == str(first) for error in self.errors):
            return first
        return ModelError("no model could be fitted: " + "; ".join(f"{row.name}: {row.note}" for row in rows))

    def _judged(self, name: str, progress: Callable[[str], object]) -> _Outcome:
        progress("fit")
        if name == SEARCH:
            result = fit(SEARCH, self.data, seed=self.seed)
        else:
            given = self.named.get(name, name)
            model = make_model(given)
            # A model that is given, and settings in a name, give the size; the colon of my_model.py:MyModel is none.
            sized = isinstance(given, AbstractHysteresis) or ":" in name.replace(".py:", "")
            if not sized and (choice := choose_size(model, self.data, progress)).notes:
                result = fit(choice.model, self.data, seed=self.seed).with_notes(*choice.notes)
            else:
                result = fit(given, self.data, seed=self.seed)
        progress("cross-validation")
        score, criterion = left_out_error(result, self.left_out), bic(result)
        if self.left_out == "blocks" and np.isfinite(score):
            result = with_left_out(result, float(score))
        obstacles = {use: text for use in ("inverse", "export") if (text := result.model.obstacle(use))}
        row = Row(
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
        return _Outcome(row=row, result=result)

    def _first_fit(self, name: str, progress: Callable[[str], object]) -> _Outcome:
        """A first fit, which decides whether a model is validated; the models that users chose, and a search, are validated."""
        if self.named or name == SEARCH:
            return self._judged(name, progress)
        model = make_model(name)
        progress("first fit")
        if (error := first_error(model, self.data)) is not None:
            return _Outcome(first=_First(error, _HOPELESS_SIZE))
        if model.estimator is not None:
            return self._judged(name, progress)
        problem, points = started_problem(model, thinned(self.data) if model.allows_thinning else self.data)
        estimate = solve(problem, choose_method(problem), _FIRST_STARTS, self.seed, points)
        weight = np.asarray(problem.objective.batch.weight)
        rms = problem.scales.y * float(np.sqrt(2 * estimate.cost / weight.sum()))
        return _Outcome(first=_First(rms, _HOPELESS, estimate.x.size))

    def _best(self) -> float | None:
        """The smallest error on left-out data so far, of models that serve the purpose."""
        rivals = [row for row in self.rows if self.purpose == "prediction" or row.serves(self.purpose)]
        return min((row.score_percent for row in rivals if row.score_percent is not None), default=None)

    def _excluded_row(self, name: str, outcome: _Outcome) -> Row | None:
        """The row of a model whose first fit is far from the best error on left-out data; None for a model that may win."""
        best, first = self._best(), outcome.first
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

    @property
    def _span(self) -> float:
        return output_range(self.data).width
