"""`compare`: which model describes these loops best, judged on data that were left out of its fit; in which order models are tried."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, get_args

from hystfit.config import verb
from hystfit.errors import DataError, HystfitError, ModelError, ParameterError
from hystfit.fitting.candidates import Candidates, candidates, timeless
from hystfit.fitting.comparison import MARGIN, STRONG, UNFIT, Comparison, Fits, Purpose, Row
from hystfit.fitting.comparison_run import WHITE, ComparisonRun
from hystfit.fitting.contender import Candidate
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import without_faults
from hystfit.fitting.left_out import CHOICES, LeftOut
from hystfit.fitting.remains import correlation_of
from hystfit.fitting.structure import Structure, falls, structure_of
from hystfit.fitting.thinning import coarse
from hystfit.fitting.verdict import turns_back
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import SEARCH, make_model, model_name
from hystfit.models.starting import output_range
from hystfit.outcome import Status
from hystfit.outcome.progress import ShownProgress
from hystfit.outcome.progress import progress as shown_progress
from hystfit.params.relative_size import ROUNDED
from hystfit.quality.baselines import Baselines, rounding_error
from hystfit.quality.equal_inputs import none_describes
from hystfit.quality.held_out import Scheme
from hystfit.quality.summary import dynamics_of
from hystfit.reading.in_memory import records_of
from hystfit.results.accuracy import Limits
from hystfit.runs.threads import Workers

LATE = "such models of time are tried where the others leave more than noise"
NO_GAIN = "the noise alone exceeds the error with which it would win"
NO_LOOP = f"{WHITE}, out of which no loop stands"


def search(run: ComparisonRun, chosen: Candidates) -> None:
    """Run the candidates in order: the search for terms, other closed forms, models that iterate, and those that wait for a reason.

    Records that no one model can describe end it after the search: the verdict is the same with every model.
    """
    run.run(chosen.closed[:1])
    if none_describes(list(run.data)):
        run.skip(chosen.names[1:], "no one model describes records that differ at equal inputs")
        return
    white, paced = chosen.closed[0] == SEARCH and run.is_white(), run.is_white(paced=True)
    chosen = _beside_white_search(run, chosen) if white else _beside_paced_search(run, chosen) if paced else chosen
    if white and not chosen.iterated:
        return
    closed, waiting = chosen.closed, _closed_forms(run, chosen)
    rings = _rings(run)
    chosen = _after_closed_forms(run, chosen, rings=rings, white=white, paced=paced)
    first, second = (*chosen.closed, *chosen.resonant), chosen.iterated
    for number, names in enumerate((first, second) if rings else ((*first, *second),)):
        if not white and run.is_white():
            run.skip((*(one.name for one in waiting), *names), WHITE)
        elif number and _resonance_needed(run):
            run.skip(names, "a resonance is needed")
        else:
            run.finish([*waiting, *run.looked_at(names)], past_white=white)
        waiting = []
    rough = _rough(run, closed)
    if paced or (run.is_white(paced=None) and not rough):
        run.skip(chosen.late, LATE)
    else:
        late = [name for name in chosen.late if run.may_win(name)]
        run.skip([name for name in chosen.late if name not in late], NO_GAIN)
        run.run(late)
    if chosen.last and rough:
        run.run(chosen.last)


def _beside_white_search(run: ComparisonRun, chosen: Candidates) -> Candidates:
    """What to try beside a search whose residuals are noise: other models could only describe the noise better.

    Where the search describes some of the noise too, models with fewer parameters may predict better. Those without time suffice, because
    a lag or creep would show in the residuals.
    """
    kept = Candidates(chosen.closed[:1], timeless(chosen.iterated) if run.overfits() else ())
    run.skip([name for name in chosen.names if name not in kept.names], WHITE)
    return kept


def _beside_paced_search(run: ComparisonRun, chosen: Candidates) -> Candidates:
    """What to try beside a search whose residuals are noise at one pace, where its lag or force of the rate may stand for a loop."""
    first, *others = chosen.closed
    kept = timeless(others)
    run.skip([name for name in others if name not in kept], WHITE)
    return dataclasses.replace(chosen, closed=(first, *kept))


def _closed_forms(run: ComparisonRun, chosen: Candidates) -> list[Candidate]:
    """Fit the closed form with the best first look, and return those that may still win."""
    first, *others = chosen.closed
    waiting = run.looked_at(others)
    if (spacing := _spacing(run, waiting)) > 1:  # the errors of all must be those on the same samples
        run.run_again((first,), dataclasses.replace(run.options, spacing=spacing))
        waiting = run.looked_at(others)
    return run.after_next(waiting)


def _after_closed_forms(run: ComparisonRun, chosen: Candidates, *, rings: bool, white: bool, paced: bool) -> Candidates:
    """What remains to be tried, with the terms that the search found.

    Args:
        rings: whether the response shows a resonance.
        white: whether the residuals of the search are noise.
        paced: the same, where its terms of time may stand for a loop.
    """
    found, delay = structure_of(run.fits[SEARCH].model) if SEARCH in run.fits else (Structure(), False)
    found = dataclasses.replace(found, falls=falls(run.data))
    if paced or (run.one_pace and run.is_white()):
        found = dataclasses.replace(found, lag=0.0, creep=False, rate=0)
    if not (rings or delay or found.timed):
        chosen = chosen.timed_late()  # beside plays that do not fit a loop, creep may not show
    if not white and run.shows_no_loop(chosen.iterated):
        run.skip((*chosen.iterated, *chosen.late), NO_LOOP)
        chosen = dataclasses.replace(chosen, iterated=(), late=())
    if not rings:
        run.skip(chosen.resonant, "the response shows no resonance")
        chosen = dataclasses.replace(chosen, resonant=())
    return chosen.beside(found, delay)


def _rough(run: ComparisonRun, closed: Sequence[str]) -> bool:
    """Whether the best model with a closed form describes the loops only roughly, but better than a single-valued curve."""
    baselines = Baselines.of(run.data)
    least = min((row.score for row in run.rows if row.asked in closed), default=math.inf)
    return Limits.of(baselines).error < least < 100 * baselines.curve / run.span


def _spacing(run: ComparisonRun, waiting: Sequence[Candidate]) -> int:
    """Samples over which the residuals of the best model so far are correlated, where scattered samples are held out; else 1."""
    if run.held.scheme is not Scheme.SCATTERED:
        return 1
    firsts = [one.first for one in waiting if one.first is not None]
    least, best = min(firsts, key=lambda first: first.ranked, default=None), run.best_row
    if least is not None and least.model is not None:
        if best is None or least.error / run.span < best.score / 100:
            return run.correlation_of_model(least.model)
    return 1 if best is None else correlation_of(run.fits[best.asked])


def _rings(run: ComparisonRun) -> bool:
    """Whether the response of the longest record changes with frequency as that of an oscillator."""
    found = dynamics_of(max(run.data, key=len))
    return found is not None and found.resonant


def _resonance_needed(run: ComparisonRun) -> bool:
    """Whether the search, which has no resonance, errs far more than the best model."""
    own = next((row.score for row in run.rows if row.asked == SEARCH), 0.0)
    return run.best is not None and own > MARGIN * run.best


@verb
def compare(
    data: Any,
    models: Sequence[str | type[AbstractHysteresis] | AbstractHysteresis] | Literal["auto"] | None = None,
    *,
    left_out: LeftOut = "auto",
    purpose: Purpose = "prediction",
    seed: int = 0,
    starts: int = 8,
    progress: Callable[..., object] | None = None,
    workers: int | None = None,
) -> Comparison:
    """Fit several models and rank them by their cross-validation error.

    What is held out follows the records (`hystfit.quality.held_out`): whole records, amplitude levels, cycles, or scattered samples of a
    single loop; beside scattered samples of loops of several sizes smaller loops, and the geometric mean of both errors ranks. The input
    drives the model through what is held out, but its output is not fitted; the offset of a whole record is. Test data are not used.
    Among models within one standard error of the smallest error, those rank first whose fit converged, that have no hysteresis, of which
    the data determine fewer parameters, and that have an inverse; one that has not converged or describes the loops only roughly, or whose
    family has no inverse, must err clearly less. A model that cannot be fitted is listed with the reason. Long records that are sampled
    far finer than their signals count by the means of several samples, on which the winner is fitted too
    (`hystfit.fitting.thinning.coarse`).

    Args:
        data: one record or several, or a data frame.
        models: names as `hystfit models` lists them (joined by "+"), classes, models, or "prandtl-ishlinskii-search", which searches
            that family for its terms. A name without settings, or a class, stands for the number of elements that suits the data.
            None (or "auto") tries every family that the records can drive, those with a resonance where the response shows one, and
            stops those that cannot win: their fit errs more than the best model does in cross-validation, or their first fit errs one
            and a half times as much, or 5 % more where all its samples are held out in turn. A first fit starts from two points and is
            judged on the fitted samples; that of a model with elements has its default size, is judged by cross-validation on at most
            2048 samples or so, and stops once the choices that lowered the error of another such model would not suffice. Records that
            differ at equal inputs by more than a usable fit errs get one model, because none changes the verdict; where the residuals are
            noise and show no loop, models that iterate are left out.
        left_out: "auto" as above; "future" predicts the later parts of every record from fits to what came before, which tests the
            description of creep and drift. Numbers of plays and levels, and the terms of the search, are chosen as by "auto".
        purpose: "prediction"; "inverse" or "export" rank models without an inverse, or without C code, below the others.
        seed: of the starting points.
        starts: number of starting points of each fit, see `fit`.
        progress: called with a line of text and the fraction done for each model; None shows them on a terminal or in a notebook.
        workers: number of models that are fitted side by side, in threads; default: one for each core, at most four. The result
            does not depend on it.

    Raises:
        HystfitError: data or settings that cannot be used, an unknown model, or no model that could be fitted.
    """
    options = FitOptions(seed=seed, starts=starts)
    options.check()
    for what, value, known in (("left_out", left_out, CHOICES), ("purpose", purpose, get_args(Purpose))):
        if value not in known:
            raise ParameterError(f"{what} must be one of {', '.join(known)}, got {value!r}")
    data = records_of(data)
    if left_out == "future" and not turns_back(data):
        raise ModelError("reversal curves have no order in time: use left_out='auto'")
    named = _named(models) if models and models != "auto" else {}
    chosen = Candidates(tuple(named)) if named else candidates(data)
    data = coarse(without_faults(data))
    update = shown_progress("comparing models") if progress is None else contextlib.nullcontext(progress)
    with update as shown:
        run = ComparisonRun(
            data, left_out, purpose, options, named, ShownProgress(shown, chosen.names), Workers(workers)
        )
        if named:
            run.run(chosen.names)
        else:
            search(run, chosen)
    floor = max(rounding_error(data) / output_range(data).width, ROUNDED)
    rows = _ranked(run.rows, purpose, 100 * floor, equal=run.equal)
    if not run.fits:
        raise _refusal(run.errors, rows)
    best = rows[0]
    if purpose != "prediction" and not best.serves(purpose):
        reasons = "; ".join(
            f"{row.name}: {row.obstacles[purpose]}" for row in rows if row.obstacles and purpose in row.obstacles
        )
        raise ModelError(f"no model that was fitted can be used for {purpose}: {reasons}")
    fits = Fits(run.fits, run.judged)
    return Comparison(tuple(rows), fits[best.asked], fits, run.scheme, purpose)


def _refusal(errors: Sequence[Exception], rows: Sequence[Row]) -> HystfitError:
    """The error where no candidate could be fitted: what is wrong with the data, where all found the same."""
    if isinstance(errors[0], DataError) and len(set(map(str, errors))) == 1:
        return errors[0]
    return ModelError("no model could be fitted: " + "; ".join(f"{row.name}: {row.note}" for row in rows))


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


def _ranked(rows: Sequence[Row], purpose: Purpose, floor: float = 0.0, *, equal: float = 1.0) -> list[Row]:
    """From best to worst; among errors that do not differ, fits that converged and describe the loop, at one pace those without time, those
    without strong evidence against them by BIC, fewer determined parameters and an inverse come first.

    A few large errors decide held-out errors, which then do not differ, though one model describes all other samples better. A fit that has
    not converged is not first beside one that can be used.

    Args:
        rows: of the models.
        purpose: of the choice.
        floor: error up to which they do not differ [percent of range], that of rounding, which recurs where the cycles repeat.
        equal: ratio to the smallest error up to which they do not differ.
    """
    ranked = sorted(rows, key=lambda row: _rank(row, purpose))
    if not ranked or ranked[0].score_percent is None:
        return ranked
    least = _error(ranked[0])
    ended = [row for row in ranked if row.status not in UNFIT]
    unfinished = ranked[0].status is Status.NOT_CONVERGED
    if unfinished and ended and ended[0].status is Status.OK:
        first = _ranked(ended, purpose, floor, equal=equal)[0]
        return [first, *(row for row in ranked if row is not first)]
    kind = _rank(ranked[0], purpose)[:-1]
    most = max(equal * least, floor)
    alike = [row for row in ranked if _rank(row, purpose)[:-1] == kind and _error(row) <= most]
    plain = lambda row: (
        row.hysteretic,
        row.effective or row.parameters or 0,
        not row.family_inverts,
        row.score_percent,
    )
    # Rounding errors are no evidence.
    bics = [row.bic for row in alike if row.bic is not None] if equal * least > floor else []
    limit = min(bics, default=math.inf) + STRONG
    unlikely = lambda row: row.bic is not None and row.bic > limit
    simple = sorted(alike, key=lambda row: (row.status in UNFIT, row.paced, unlikely(row), *plain(row)))
    return simple + ranked[len(alike) :]


def _error(row: Row) -> float:
    """Error by which a model ranks [percent of range]: one that describes the loops only roughly must err clearly less."""
    return (row.ranked_percent or 0.0) * (MARGIN if row.status is Status.ROUGH else 1.0)


def _rank(row: Row, purpose: Purpose) -> tuple[Any, ...]:
    """Validated models first, then those that serve the purpose, then the smallest error on left-out data."""
    return (
        row.in_sample_percent is None,
        row.status is Status.UNTESTED,
        row.status is Status.NO_LOOP and row.hysteretic,
        purpose != "prediction" and not row.serves(purpose),
        row.score_percent is None,
        _error(row) or (row.in_sample_percent or 0.0) * row.handicap,
    )
