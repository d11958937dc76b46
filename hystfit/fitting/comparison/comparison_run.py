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
from hystfit.fitting.comparison.candidate_fits import CandidateFits
from hystfit.fitting.comparison.compared_models import Purpose, Row
from hystfit.fitting.comparison.contender import Candidate, leader
from hystfit.fitting.comparison.left_out import LeftOut
from hystfit.fitting.comparison.sizes import weights_of
from hystfit.fitting.comparison.standings import Standings
from hystfit.fitting.comparison.suggested import suggested
from hystfit.fitting.fit_model import Solved
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.trial import carried_over, with_left_out
from hystfit.models.registry import make_model
from hystfit.outcome import Status
from hystfit.outcome.progress import ShownProgress
from hystfit.quality.held_out import Scheme, inner_loops
from hystfit.results.result import FitResult
from hystfit.runs.threads import Workers

# What a solver raises on data that it cannot handle, besides the library's own errors.
_SOLVER_ERRORS = (HystfitError, np.linalg.LinAlgError, ArithmeticError, RuntimeError)

WHITE = "the residuals of the best model are noise"

_SIDE_BY_SIDE = 2  # first fits at a time, whatever the number of cores, on which results must not depend

_Work = Callable[[Candidate, Callable[[str], object]], None]


class ComparisonRun:
    """Tries candidates side by side and keeps their rows.

    Models that are `named` by the user, by the name of their row, are validated however poor their fit. `standings` are the models that are
    done, `errors` those of models that could not be fitted.
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
        self.data, self.left_out = data, left_out
        self.standings = Standings(data, purpose, all_validated=bool(named))
        self.errors: list[Exception] = []
        self.candidate_fits = CandidateFits(data, left_out, options, named, self.standings)
        self._shown, self._workers = shown, workers
        self._solved: dict[str, Solved] = {}
        self._asked: set[str] = set()  # names of candidates so far

    def on(self, data: Dataset) -> ComparisonRun:
        """A comparison with the same options on other records."""
        fits, purpose = self.candidate_fits, self.standings.purpose
        return ComparisonRun(data, self.left_out, purpose, fits.options, fits.named, self._shown, self._workers)

    def refit(self, name: str, screened: FitResult) -> None:
        """Fit and validate a candidate from its fit to some of the records; it stops once it cannot win."""
        one = Candidate(name, screened=screened)
        self._complete(one)
        self._keep_finished([one])

    def run(self, names: Sequence[str]) -> None:
        """Fit and validate candidates side by side, and stop those that cannot win; an error leaves one out."""
        self.finish(self.looked_at(names))

    def run_again(self, names: Sequence[str], options: FitOptions) -> None:
        """Forget what was found, and run candidates with other options."""
        self.standings.clear()
        self.candidate_fits.restart(options)
        self.errors = []
        self.run(names)

    def looked_at(self, names: Sequence[str]) -> list[Candidate]:
        """Candidates after their first fits."""
        candidates = [Candidate(name) for name in names]
        self._asked.update(names)
        self._each(self.candidate_fits.first, candidates)
        return candidates

    def run_until_settled(self, waiting: list[Candidate], names: Sequence[str]) -> None:
        """Finish candidates that wait after their first fits, and the others by name, from those with the fewest parameters on.

        One that errs by no more than the noise is fitted at once: where its residuals are white, the others are not looked at.
        """
        ahead = sorted(names, key=lambda name: weights_of(make_model(name)))
        while ahead:
            looked, ahead = self.looked_at(ahead[:_SIDE_BY_SIDE]), ahead[_SIDE_BY_SIDE:]
            waiting = [*waiting, *looked]
            if any(one.first is not None and self.standings.is_noise(one.first.error) for one in looked):
                waiting = self.after_next(waiting)
                if self.standings.is_settled():
                    break
        self.finish(waiting, past_white=False)
        self.skip(ahead, WHITE)

    def finish(self, candidates: Sequence[Candidate], *, past_white: bool = True) -> None:
        """Fit and validate candidates in the order of their first fits; where the best leaves noise the others stop unless `past_white`.

        What the fits suggest joins them.
        """
        waiting = self._keep_finished(candidates)
        while waiting:
            if not past_white and self.standings.is_white():
                self.skip([one.name for one in waiting], WHITE)
                return
            waiting = self.after_next(waiting)
            waiting += self.looked_at([name for name in suggested(self.standings) if name not in self._asked])

    def after_next(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Fit and validate the model with the best first fit; returns those that may still win."""
        waiting = self._keep_finished(candidates)
        for one in waiting:
            one.row = self.candidate_fits.excluded(one)
        ahead = leader([one for one in waiting if one.row is None], self.standings.equal)
        if ahead is not None:
            self._complete(ahead)
        return self._keep_finished(waiting)

    def _complete(self, one: Candidate) -> None:
        """Fit a candidate, and validate it if it may win."""
        self._each(self.candidate_fits.fit, [one])
        one.row = one.row or self.candidate_fits.beaten(one)
        self._each(self.candidate_fits.validate, [one] if one.row is None else [])

    def skip(self, names: Sequence[str], reason: str) -> None:
        """Add a row for each candidate that is not tried."""
        for name in names:
            note = f"not tried: {reason} (hystfit compare --models {name} tries it)"
            self.standings.add(Row(name, name, note=note))

    def _each(self, work: _Work, chosen: Sequence[Candidate]) -> None:
        self._workers.run([functools.partial(self._timed, work, one) for one in chosen])

    def _timed(self, work: _Work, one: Candidate) -> None:
        """Run one piece of work on a candidate and measure its time; an error becomes the candidate's row."""

        def say(text: str) -> None:
            self._workers.check()
            self._shown.step(one.name, text)

        started = time.perf_counter()
        try:
            with self.candidate_fits.few_runs(one.name):
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
            self.standings.add(dataclasses.replace(one.row, seconds=one.seconds), one.result)
            if one.failure is not None:
                self.errors.append(one.failure)
            if one.result is not None and one.solved is not None:
                self._solved[one.name] = one.solved
            self._shown.done(one.name)
        return [one for one in candidates if one.row is None]

    def judged(self, name: str) -> FitResult:
        """A fit with its standard errors."""
        self.candidate_fits.release()
        known = self.standings.fits[name]
        with self.candidate_fits.few_runs(name):
            result = self._solved[name].judged()
        if known.left_out is not None:
            result = with_left_out(result, known.left_out)
        return carried_over(result, known)

    @property
    def scheme(self) -> Scheme:
        """What was held out."""
        if self.left_out == "future":
            return Scheme.FUTURE
        scattered = self.standings.held.scheme is Scheme.SCATTERED
        return Scheme.INNER if scattered and inner_loops(list(self.data)) is not None else self.standings.held.scheme
