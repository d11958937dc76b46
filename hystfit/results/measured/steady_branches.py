"""Which branches of a record repeat: those behind the curve of first loading, at one pace."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence
from statistics import median_low

import numpy as np
from jaxtyping import Bool, Float

from hystfit.data.record import Record
from hystfit.params.units import conversion
from hystfit.quality.faults import CLEAR
from hystfit.results.measured.loop_branches import Branch, Pair
from hystfit.results.measured.measured_value import LoopValue

# Of the height of a loop, most by which the output of a steady cycle ends away from where it began. After a first rise from rest it is 0.5
# on three simulated piezo stacks and a pneumatic muscle, whose loops are so narrow that it is less than 7 % of the range; loops that drift
# with the temperature or creep have less than 0.1.
OF_HEIGHT = 0.25
# Largest ratio of durations of cycles at one pace: frequencies of a sweep differ by a third of an octave or more.
SAME_PACE = 1.25
_SLOW = 10.0  # s: cycles that take longer have a duration, and no frequency
# Values that change with the pace, and what begins with these; the last does not change with the first cycle.
_NAMED = ("coercive_input", "remanence", "loop_area", "stroke")


def without_first_loading(branches: list[Branch], first: int, sigma: float) -> list[Branch]:
    """Large branches, in the order of time, without the first piece of the record, where later ones in its direction begin elsewhere.

    That piece has `first` samples; `sigma` is the noise of the output [y], NaN where it is unknown.
    """
    same = [b.y[0] for b in branches[1:] if b.rises == branches[0].rises]
    if not same or branches[0].u.size != first:
        return branches
    away = abs(branches[0].y[0] - float(np.median(same)))
    return branches[1:] if away > CLEAR * np.sqrt(2) * np.nan_to_num(sigma) else branches


def usual_duration(durations: Sequence[float]) -> float:
    """The middle one of the most durations at one pace, the slowest of several that have as many."""
    every = np.sort(durations)[::-1]
    alike = [every[at_pace(every, one)] for one in every]
    return median_low(max(alike, key=len).tolist())


def at_pace(durations: Float[np.ndarray, " C"], usual: float) -> Bool[np.ndarray, " C"]:
    """Which durations are those of the same pace as another; unknown ones are not told apart."""
    return ~((durations > SAME_PACE * usual) | (usual > SAME_PACE * durations))


def at_one_pace(branches: list[Branch]) -> tuple[list[Branch], float | None]:
    """Branches of the cycles at the usual pace, and how long these take; None where all do, or without time."""
    lasts = np.array([one.duration + other.duration for one, other in itertools.pairwise(branches)])
    if not lasts.size:
        return branches, None
    usual = usual_duration(lasts)
    kept = sorted({k for first in np.flatnonzero(at_pace(lasts, usual)).tolist() for k in (first, first + 1)})
    return ([branches[k] for k in kept], usual) if len(kept) < len(branches) else (branches, None)


def starts_from_rest(one: Branch, other: Branch, sigma: float) -> bool:
    """Whether the output ends away from where it began, by more than a steady cycle does: its first branch is that of first loading."""
    low, high = max(one.u.min(), other.u.min()), min(one.u.max(), other.u.max())
    at = np.linspace(low, high, one.u.size)
    along = [np.interp(at, *(column[np.argsort(b.u, kind="stable")] for column in (b.u, b.y))) for b in (one, other)]
    gap, height = abs(float(other.y[-1] - one.y[0])), float(np.abs(along[0] - along[1]).max())
    return gap > max(OF_HEIGHT * height, CLEAR * np.sqrt(2) * float(np.nan_to_num(sigma)))


def pace_words(seconds: float) -> str:
    """What tells the pace of cycles that take this long, behind the name of a quantity."""
    return f", at {1 / seconds:.3g} Hz" if seconds < _SLOW else f", in cycles of {seconds:.3g} s"


def labeled(
    rows: Iterable[LoopValue], record: Record, pairs: Sequence[Pair], duration: float | None, sigma: float
) -> Iterator[LoopValue]:
    """Rows that name the frequency of the cycles where others are left out, and the first cycle where it is the only one."""
    second = conversion(record.t_unit, "s")
    words = pace_words(second * duration) if duration and second else ""
    if len(pairs) == 1 and starts_from_rest(*pairs[0], sigma):
        words += " (first cycle, from rest)"
    changed = _NAMED if duration else _NAMED[:-1]
    for row in rows:
        yield dataclasses.replace(row, label=row.label + words) if row.name.startswith(changed) else row
