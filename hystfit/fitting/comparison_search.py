"""The order in which a comparison tries its candidates, and what the answers so far make unnecessary."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from hystfit.fitting.candidates import Candidates
from hystfit.fitting.comparison import MARGIN
from hystfit.fitting.comparison_run import WHITE, ComparisonRun, correlation_of, score_of
from hystfit.fitting.contender import Candidate
from hystfit.fitting.structure import Structure, structure_of
from hystfit.models.registry import SEARCH, make_model
from hystfit.quality.held_out import Scheme
from hystfit.quality.summary import dynamics_of


def search(run: ComparisonRun, chosen: Candidates) -> None:
    """Run the candidates in order: the search for terms, other closed forms, those that iterate; a resonance first where one shows.

    White residuals end it: what other models would describe better is noise. Where the search describes some of the noise too, models
    with fewer parameters may predict better; they need no time, because a lag or creep would show in the residuals.
    """
    first, *others = chosen.closed
    run.run((first,))
    if white := run.is_white():
        lasting = _timeless(chosen.iterated)
        run.skip((*others, *(name for name in chosen.iterated if name not in lasting), *chosen.resonant), WHITE)
        chosen, others = Candidates((first,), lasting), []
        if not run.overfits():
            run.skip(chosen.iterated, WHITE)
            return
    waiting = run.looked_at(others)
    if (spacing := _spacing(run, waiting)) > 1:  # the errors of all must be those on the same samples
        run.run_again((first,), dataclasses.replace(run.options, spacing=spacing))
        waiting = run.looked_at(others)
    waiting = run.after_next(waiting)
    found, delay = structure_of(run.fits[SEARCH].model) if SEARCH in run.fits else (Structure(), False)
    rings, iterated = _rings(run), chosen.iterated
    if not (white or rings or delay or found.timed):
        iterated = _timeless(chosen.iterated)
        run.skip(
            [name for name in chosen.iterated if name not in iterated], "the search found no term that depends on time"
        )
    if not rings:
        run.skip(chosen.resonant, "the response shows no resonance")
    chosen = Candidates(chosen.closed, iterated, chosen.resonant if rings else ()).beside(found, delay)
    turns = (*chosen.closed, *chosen.resonant), chosen.iterated
    for number, names in enumerate(turns if rings else [sum(turns, ())]):
        if not white and run.is_white():
            run.skip((*(one.name for one in waiting), *names), WHITE)
        elif number and _resonance_needed(run):
            run.skip(names, "a resonance is needed")
        else:
            run.finish([*waiting, *run.looked_at(names)], past_white=white)
        waiting = []


def _timeless(names: Sequence[str]) -> tuple[str, ...]:
    """Those of the models that do not depend on time."""
    return tuple(name for name in names if make_model(name).rate_independent)


def _spacing(run: ComparisonRun, waiting: Sequence[Candidate]) -> int:
    """Samples over which the residuals of the best model so far are correlated, where scattered samples are held out; else 1."""
    if run.held.scheme is not Scheme.SCATTERED:
        return 1
    firsts = [one.first for one in waiting if one.first is not None]
    least, best = min(firsts, key=lambda first: first.error, default=None), run.best_row
    if least is not None and least.model is not None:
        if best is None or least.error / run.span < score_of(best) / 100:
            return run.correlation_of_model(least.model)
    return 1 if best is None else correlation_of(run.fits[best.asked])


def _rings(run: ComparisonRun) -> bool:
    """Whether the response of the longest record changes with frequency as that of an oscillator."""
    found = dynamics_of(max(run.data, key=len))
    return found is not None and found.resonant


def _resonance_needed(run: ComparisonRun) -> bool:
    """Whether the search, which has no resonance, errs far more than the best model."""
    own = next((score_of(row) for row in run.rows if row.asked == SEARCH), 0.0)
    return run.best is not None and own > MARGIN * run.best
