"""Greedy search for the terms of a Prandtl-Ishlinskii model, or of a curve without hysteresis, judged on held-out samples.

Plays or stops, one envelope or three, the degree of the single-valued part, a lag, creep, forces of the input's rate, hardening.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.steady_cycle import with_steady_start
from hystfit.fitting.structure.model_structure import Structure, build
from hystfit.fitting.structure.structure_columns import STEP_OF_LAGS, Terms
from hystfit.inference.fittable import check_fittable
from hystfit.models.base import AbstractHysteresis
from hystfit.models.dynamics import Delay
from hystfit.models.prandtl_ishlinskii import Operator, PrandtlIshlinskii
from hystfit.models.registry import model_name
from hystfit.models.series import Series
from hystfit.outcome import Code, Note
from hystfit.quality.baselines import rounding_error
from hystfit.quality.held_out import AT_ONE_PACE, GAIN, HeldOut, equal_errors, held_out
from hystfit.quality.loops import SEVERAL, turns_back
from hystfit.quality.summary import delay_of, slow_lag_of
from hystfit.results.accuracy import POOR

_CLEARLY = 0.8  # of the error at a lag, below which a finer lag is taken before any other term
_BESIDE_CURVE = ("rest", "lag", "order", "rate")  # creep opens loops at every rate, as hysteresis does
_PLAYS, _OTHER_PLAYS = 20, (10, 40, 80)  # of the search for terms; numbers tried with the terms found


@dataclasses.dataclass(frozen=True)
class Found:
    """Result of the structure search: a model, started on the data, ready for `fit(..., start="model")`, and its terms.

    `score` is the root mean square error on left-out blocks, output units; `tried` counts candidates, and `trail` is each step in words.
    """

    model: AbstractHysteresis
    structure: Structure
    plays: int
    score: float
    tried: int
    trail: tuple[str, ...]

    def notes(self) -> tuple[Note, ...]:
        """The choice, and each step towards it."""
        first = f"{model_name(self.model)} is the best of {self.tried} combinations of terms by cross-validation"
        return tuple(Note(Code.CHOICE, text) for text in (first, *self.trail))


def search_structure(data: Dataset, *, plays: int | None = None, spacing: int = 1) -> Found:
    """Search for the terms of a model, also behind a pure delay where the records show one.

    Args:
        plays: number of thresholds; by default the held-out error chooses it among those that the data can determine.
        spacing: samples over which errors are correlated, see `held_out`.
    """
    check_fittable(PrandtlIshlinskii.of(1), data)
    begun = data.map(with_steady_start)  # as the model is fitted
    held = held_out(list(data), spacing).after(map(len, begun))
    lag = lambda records: max(slow_lag_of(record) or 0.0 for record in records)
    found = _search(begun, held, plays, lag(data))
    if not any(delay_of(record) for record in data):
        return found
    delay = Delay().start(list(data))
    delayed = lambda record: record.replace(u=delay.free_run(record.u, record.dt))
    later = _search(begun.map(delayed), held, plays, lag(data.map(delayed)))
    if later.score >= GAIN * found.score:
        return found
    parts = later.model.parts if isinstance(later.model, Series) else (later.model,)
    return dataclasses.replace(later, model=Series(delay, *parts), tried=found.tried + later.tried)


def _search(data: Dataset, held: HeldOut, plays: int | None, lag: float) -> Found:
    """Greedy search from plays or stops, and from a single-valued curve, which wins where those predict held-out samples no better.

    A lag that the records show [samples] adds lags about it.
    """
    terms = Terms(data, min(_PLAYS, max_plays(data)) if plays is None else plays, held)
    # Lags about one longer than those tried on all records.
    options = terms.options(lag if terms.timed else 0.0)
    beside = {field: values for field, values in options.items() if field in _BESIDE_CURVE}
    curve = _greedy([Structure("curve")], terms, beside, plays)
    if not turns_back(data):  # plays would only be knots of a curve
        return dataclasses.replace(curve, tried=len(terms.scores) + curve.tried)
    loops = _greedy([Structure(operator, falls=terms.falls) for operator in get_args(Operator)], terms, options, plays)
    chosen = curve if _enough(curve, loops, terms) else loops
    return dataclasses.replace(chosen, tried=len(terms.scores) + loops.tried + curve.tried)


def _greedy(starts: Sequence[Structure], terms: Terms, options: dict[str, tuple[Any, ...]], plays: int | None) -> Found:
    """Repeat the single change that lowers the held-out error most, from the best of some structures; `tried` counts other sizes."""
    structure = min(starts, key=terms.score)
    score, path, trail = terms.score(structure), [structure], list[str]()
    # Rounding errors recur where the cycles repeat: terms that describe them would also lower the error on held-out cycles.
    rounding = rounding_error(terms.data)
    finer = _doubled(terms)
    while score > rounding:
        best = _next(structure, score, terms, options)
        if terms.score(best) >= GAIN * score:
            break
        # A knee between two thresholds looks like an asymmetry, and like creep where time and path cannot be told apart.
        resizes = plays is None and structure.operator != "curve" and finer.plays > terms.plays
        if resizes and finer.served(structure) and finer.score(structure) < terms.score(best):
            trail += [*_steps(path, terms), _resized(finer, terms, structure, score)]
            path, terms, score = [structure], finer, finer.score(structure)
            finer = _doubled(terms)
            continue
        if len(path) > 1 and best.differs_in_lag(structure) and structure.differs_in_lag(path[-2]):
            path.pop()  # both are one step
        path.append(best)
        structure, score = best, terms.score(best)
    found = Found(
        build(structure, terms.data, terms.plays), structure, terms.plays, score, 0, (*trail, *_steps(path, terms))
    )
    return _of_best_size(found, terms) if plays is None and score > rounding else found


def _doubled(terms: Terms) -> Terms:
    """Twice as many plays, tried before each term.

    They lower the error of three clipped loops of a stop by 33 to 43 %, and creep, which is not there, by 4 %; that of a loop of 13 plays
    by 68 %, and three envelopes by 12 %.
    """
    return Terms(terms.data, min(2 * terms.plays, max_plays(terms.data)), terms.held)


def _of_best_size(found: Found, terms: Terms) -> Found:
    """A structure with the number of plays that lowers its held-out error; `tried` counts the numbers."""
    structure, most = found.structure, max_plays(terms.data)
    # A curve with few knots is taken where it predicts no worse: a line needs two.
    few = (2,) if structure.operator == "curve" else ()
    tried, chosen, score, trail = 0, terms, found.score, found.trail
    for other in dict.fromkeys((*few, *(min(other, most) for other in _OTHER_PLAYS))):
        resized = Terms(terms.data, other, terms.held)
        if other == terms.plays or not resized.served(structure):
            continue
        tried += 1
        if resized.score(structure) < (1.0 if other in few else GAIN) * score:
            trail = (*trail, _resized(resized, chosen, structure, score))
            chosen, score = resized, resized.score(structure)
    return Found(build(structure, terms.data, chosen.plays), structure, chosen.plays, score, tried, trail)


def _steps(path: Sequence[Structure], terms: Terms) -> list[str]:
    """Each change of one term, in words."""
    return [
        _step(new.change_from(old), terms.score(old), terms.score(new), terms.span)
        for old, new in itertools.pairwise(path)
    ]


def _resized(new: Terms, old: Terms, structure: Structure, score: float) -> str:
    """The step to another number of plays, in words."""
    return _step(f"{new.plays} instead of {old.plays} {structure.elements}", score, new.score(structure), new.span)


def _enough(curve: Found, loops: Found, terms: Terms) -> bool:
    """Whether a single-valued curve, with what may come before and beside it, predicts held-out samples as well as plays or stops do.

    A lag or a force of the rate that leaves most of a loop is no evidence that there is none.
    """
    if curve.structure.timed and 100 * curve.score > POOR * terms.span:
        return False
    at_one_pace = curve.structure.timed and not (loops.structure.timed or terms.several_paces)
    factor = AT_ONE_PACE if at_one_pace else equal_errors(terms.samples)
    return curve.score <= max(factor * loops.score, rounding_error(terms.data))


def _next(structure: Structure, score: float, terms: Terms, options: dict[str, tuple[Any, ...]]) -> Structure:
    """The structure with one change whose error is least; one with a finer lag where that is clearly better, or nothing else helps."""
    # With other terms another lag may be the right one: a finer lag must not keep them out.
    near = dataclasses.replace(structure, lag=round(structure.lag / STEP_OF_LAGS) * STEP_OF_LAGS)
    changes = [
        changed
        for old in dict.fromkeys((structure, near))
        for field, values in options.items()
        for value in values
        if value != getattr(old, field) and terms.served(changed := dataclasses.replace(old, **{field: value}))
    ]
    best = min((one for one in changes if _is_sure(one, structure, terms)), key=terms.score, default=structure)
    finer = dataclasses.replace(structure, lag=terms.lag_between(structure)) if structure.lag else structure
    clearly = terms.score(finer) < _CLEARLY * score
    return finer if clearly or terms.score(best) >= GAIN * score else best


def _is_sure(changed: Structure, structure: Structure, terms: Terms) -> bool:
    """Whether a change adds no first force of the rate or lag, or one that the records tell from the place in the loop."""
    first = (changed.lag or changed.rate) and not (structure.lag or structure.rate)
    return not first or terms.several_paces or terms.score(changed) < AT_ONE_PACE * terms.score(structure)


def max_plays(data: Dataset) -> int:
    """Number of thresholds that the samples and the distinct levels of the input can determine."""
    samples = sum(int(record.used.sum()) for record in data)
    inputs = np.concatenate([record.u[record.used] for record in data])
    levels = np.unique(np.round(200 * inputs / (float(np.ptp(inputs)) or 1.0))).size  # closer ones count as one
    return max(SEVERAL, min(samples // 4, levels, max(_OTHER_PLAYS)))


def _step(change: str, before: float, after: float, span: float) -> str:
    before, after = 100 * before / span, 100 * after / span
    digits = max(0, 1 - int(np.floor(np.log10(after)))) if after > 0 else 2
    return (
        f"{change} reduced the cross-validation error by {100 * (1 - after / before):.0f} %, from {before:.{digits}f} to "
        f"{after:.{digits}f} % of the range"
    )
