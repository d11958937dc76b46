"""In which order a comparison tries models, and what makes it leave some of them out: the reasons are those that its rows give."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

from hystfit.fitting.comparison.candidates import Candidates, timeless
from hystfit.fitting.comparison.compared_models import MARGIN
from hystfit.fitting.comparison.comparison_run import WHITE, ComparisonRun
from hystfit.fitting.comparison.contender import Candidate
from hystfit.fitting.comparison.standings import correlation_of
from hystfit.fitting.structure.model_structure import Structure, falls, on_falling_line, structure_of
from hystfit.models.registry import SEARCH
from hystfit.quality.baselines import Baselines
from hystfit.quality.equal_inputs import none_describes
from hystfit.quality.held_out import Scheme
from hystfit.quality.summary import dynamics_of
from hystfit.results.accuracy import Limits

LATE = "such models of time are tried where the others leave more than noise"
NO_GAIN = "the noise alone exceeds the error with which it would win"
NO_LOOP = f"{WHITE}, out of which no loop stands"
NO_RESONANCE = "the response shows no resonance"
RESONANCE = "a resonance is needed"
DIFFER = "no one model describes records that differ at equal inputs"


def search(run: ComparisonRun, chosen: Candidates) -> None:
    """Try models from the cheapest to the dearest, and stop where the best leaves nothing to describe.

    1. Plays and stops with the terms that cross-validation chooses.
    2. Other models with a closed form, in the order of their first fits.
    3. Models whose parameters are searched for, with the terms that step 1 found; those with a resonance first where the response shows
       one, nowhere else.
    4. Late models: those of time that the records hardly test, and those for loops of the other direction.
    """
    run.run(chosen.closed[:1])
    searched = chosen.closed[0] == SEARCH
    if none_describes(list(run.data)):
        run.skip(chosen.names[1:], DIFFER)
    elif searched and run.standings.is_white():
        _beside_noise(run, chosen)
    else:
        at_one_pace = searched and run.standings.is_white(paced=True)
        chosen = _without_time(run, chosen) if at_one_pace else chosen
        waiting = _closed_forms(run, chosen.closed)
        closed, rings = chosen.closed, _rings(run)
        chosen = _after_closed_forms(run, chosen, rings=rings, at_one_pace=at_one_pace)
        _iterated(run, chosen, waiting, rings=rings)
        _late(run, chosen, rough=_rough(run, closed), at_one_pace=at_one_pace)


def _beside_noise(run: ComparisonRun, chosen: Candidates) -> None:
    """Where the search leaves noise, other models could only describe the noise better, and a lag or creep would show in the residuals.

    Where the search describes some of the noise too, models without time that have fewer parameters may predict better.
    """
    kept = timeless(chosen.iterated) if run.standings.overfits() else ()
    run.skip([name for name in chosen.names[1:] if name not in kept], WHITE)
    run.run(Candidates((), kept).beside(*_terms(run)).iterated)


def _without_time(run: ComparisonRun, chosen: Candidates) -> Candidates:
    """What to try beside a search that leaves noise at one pace, where its lag or force of the rate may stand for a loop."""
    first, *others = chosen.closed
    kept = timeless(others)
    run.skip([name for name in others if name not in kept], WHITE)
    return dataclasses.replace(chosen, closed=(first, *kept))


def _closed_forms(run: ComparisonRun, closed: Sequence[str]) -> list[Candidate]:
    """After the first of them, fit that with the best first look, and return those that may still win."""
    first, *others = closed
    waiting = run.looked_at(others)
    if (spacing := _spacing(run, waiting)) > 1:  # the errors of all must be those on the same samples
        run.run_again((first,), dataclasses.replace(run.candidate_fits.options, spacing=spacing))
        waiting = run.looked_at(others)
    return run.after_next(waiting)


def _terms(run: ComparisonRun) -> tuple[Structure, bool]:
    """What the search found before and beside its plays, and whether it took a pure delay."""
    fits = run.standings.fits
    found, delay = structure_of(fits[SEARCH].model) if SEARCH in fits else (Structure(), False)
    return dataclasses.replace(found, falls=falls(run.data), line=found.line or on_falling_line(run.data)), delay


def _after_closed_forms(run: ComparisonRun, chosen: Candidates, *, rings: bool, at_one_pace: bool) -> Candidates:
    """What remains to be tried, with the terms that the search found.

    The response `rings` where it shows a resonance; noise is left `at_one_pace` by terms of time that the records do not tell from a loop.
    """
    found, delay = _terms(run)
    if at_one_pace or (run.standings.one_pace and run.standings.is_white()):
        found = dataclasses.replace(found, lag=0.0, creep=False, rate=0)
    if not (rings or delay or found.timed):
        chosen = chosen.timed_late()  # beside plays that do not fit a loop, creep may not show
    if run.standings.shows_no_loop(chosen.iterated):
        run.skip((*chosen.iterated, *chosen.late), NO_LOOP)
        chosen = dataclasses.replace(chosen, iterated=(), late=())
    if not rings:
        run.skip(chosen.resonant, NO_RESONANCE)
        chosen = dataclasses.replace(chosen, resonant=())
    return chosen.beside(found, delay)


def _iterated(run: ComparisonRun, chosen: Candidates, waiting: list[Candidate], *, rings: bool) -> None:
    """Try what iterates, and closed forms that wait, until the best leaves noise."""
    first, second = (*chosen.closed, *chosen.resonant), chosen.iterated
    for number, names in enumerate((first, second) if rings else ((*first, *second),)):
        if run.standings.is_white():
            run.skip((*(one.name for one in waiting), *names), WHITE)
        elif number and _resonance_needed(run):
            run.skip(names, RESONANCE)
        else:
            run.run_until_settled(waiting, names)
        waiting = []


def _late(run: ComparisonRun, chosen: Candidates, *, rough: bool, at_one_pace: bool) -> None:
    """Try late models where the others leave more than noise, or describe the loops only roughly."""
    if at_one_pace or (run.standings.is_white(paced=None) and not rough):
        run.skip(chosen.late, LATE)
    else:
        late = [name for name in chosen.late if run.standings.may_win(name)]
        run.skip([name for name in chosen.late if name not in late], NO_GAIN)
        run.run(late)
    if rough:
        run.run(chosen.last)


def _rough(run: ComparisonRun, closed: Sequence[str]) -> bool:
    """Whether the best model with a closed form describes the loops only roughly, but better than a single-valued curve."""
    baselines = Baselines.of(run.data)
    least = min((row.score for row in run.standings.rows if row.asked in closed), default=math.inf)
    return Limits.of(baselines).error < least < 100 * baselines.curve / run.standings.span


def _spacing(run: ComparisonRun, waiting: Sequence[Candidate]) -> int:
    """Samples over which the residuals of the best model so far are correlated, where scattered samples are held out; else 1."""
    if run.standings.held.scheme is not Scheme.SCATTERED:
        return 1
    firsts = [one.first for one in waiting if one.first is not None]
    least, best = min(firsts, key=lambda first: first.ranked, default=None), run.standings.best_row
    if least is not None and least.model is not None:
        if best is None or least.error / run.standings.span < best.score / 100:
            return run.candidate_fits.correlation_of_model(least.model)
    return 1 if best is None else correlation_of(run.standings.fits[best.asked])


def _rings(run: ComparisonRun) -> bool:
    """Whether the response of the longest record changes with frequency as that of an oscillator."""
    found = dynamics_of(max(run.data, key=len))
    return found is not None and found.resonant


def _resonance_needed(run: ComparisonRun) -> bool:
    """Whether the search, which has no resonance, errs far more than the best model."""
    own = next((row.score for row in run.standings.rows if row.asked == SEARCH), 0.0)
    return run.standings.best is not None and own > MARGIN * run.standings.best
