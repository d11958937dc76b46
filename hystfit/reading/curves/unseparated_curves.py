"""Curves below each other without anything between them: at conditions that are held in turn, or each from where the first one began."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from hystfit.data.circulation import PART
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading.choice.chosen_columns import Choice
from hystfit.reading.choice.column_facts import HEATED
from hystfit.reading.limits import JUMP, NEAR, ODD, OF_RECORD
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.held_levels import held_labels, levels_apart, levels_in_turn
from hystfit.reading.table.raw_table import Table
from hystfit.reading.table.signal_evidence import swings

_MOST = 100  # curves at temperatures of their own
_HELD = 0.2  # of the change to the temperature before or after, up to which one drifts while it is held
_FIELDS = ("field", "induction")  # which are held while the temperature is swept
_RESTS = 1e-4  # of the range of a field, up to which its steps are those of one that is held

Curves = list[tuple[str, np.ndarray]]


def curves_at_conditions(table: Table, choice: Choice, notes: list[Note]) -> Curves | None:
    """Label and rows of every curve; None where the rows are of one curve."""
    u = table.columns[choice.input]
    if not np.isfinite(u).all() or u.size < 2 * OF_RECORD:
        return None
    for position, name in enumerate(table.names):
        values, kind = table.columns[position], table.quantity(position)
        if position in (choice.input, choice.output, *table.labels) or not np.isfinite(values).all():
            continue
        is_set = choice.time is None and kind not in ("index", "status") and levels_in_turn(values)  # as of a gate
        is_set = is_set and not (kind == "" and numbers_cycles(table, position, u))
        if not (kind == "temperature" or is_set):
            continue
        rows, levels = np.arange(u.size), None
        if not is_set and table.quantity(choice.input) in _FIELDS:
            levels = held_labels(values)
            rows = np.flatnonzero(~_heated(u, values) if levels is None else levels != "")
        begins = _steps_of_plateaus(values[rows]) if levels is None else _changes(levels[rows])
        pieces = np.split(rows, begins)
        one = not begins.size and 2 * OF_RECORD <= rows.size < u.size and np.ptp(values[rows]) < HEATED
        if one or (begins.size and _cover(u, pieces) and _begin_alike(u[rows], begins, at_end=not is_set)):
            if rows.size < u.size:
                text = (
                    f"left out: {u.size - rows.size} rows in which the temperature ({name!r}) changes at a held field"
                )
                notes.append(Note(Code.LEFT_OUT, text))
            if one:
                return [("", rows)]
            means = levels_apart(np.array([np.mean(values[piece]) for piece in pieces]))
            curves = _labeled(pieces, [f"{split_unit(name)[0]}={mean:.4g}" for mean in means])
            text = f"{len(pieces)} curves, each at a {kind or 'value'} that is held ({name!r})"
            notes.append(Note(Code.CURVES, text) if is_set else _of_states(text, curves[0][0]))
            return curves
    begins = _returns(u, None if choice.time is None else table.columns[choice.time])
    pieces = [piece for piece in np.split(np.arange(u.size), begins) if piece.size > 1]
    if len(pieces) < 2 or u.size < OF_RECORD * len(pieces):
        return None
    notes.append(
        Note(Code.CURVES, f"{len(pieces)} curves: the input jumps back from the end of each to the begin of the next")
    )
    return _labeled(pieces, [f"curve={k}" for k in range(len(pieces))])


def _of_states(text: str, first: str) -> Note:
    """The warning that curves are of different states, with the option that reads the first of them."""
    option = ("only", first.partition("=")[2])
    text += f": one model of all averages over the states; fit one (only={option[1]!r}), or each with hystfit batch"
    return dataclasses.replace(warn(Code.CURVES, text), option=option)


def numbers_cycles(table: Table, position: int, u: np.ndarray) -> bool:
    """Whether a column numbers the cycles of the input, or parts of them, from each of which the input goes on to the next.

    A number that holds for several cycles may be that of a setting.
    """
    numbers = table.columns[position]
    if not table.counts(position, groups=True) or swings(u) > 2 * np.unique(numbers).size + 1:
        return False
    return bool((np.abs(np.diff(u)[np.flatnonzero(np.diff(numbers))]) <= NEAR * np.ptp(u)).all())


def _heated(u: np.ndarray, temperature: np.ndarray) -> np.ndarray:
    """Whether each row is of a sweep of the temperature at a field that is held, such as the cooling before a loop."""
    found = np.zeros(u.size, dtype=bool)
    begins = np.flatnonzero(np.abs(np.diff(u)) > _RESTS * np.ptp(u)) + 1
    for run in np.split(np.arange(u.size), begins):
        found[run] = run.size >= OF_RECORD and np.ptp(temperature[run]) > HEATED
    return found


def _steps_of_plateaus(values: np.ndarray) -> np.ndarray:
    """Rows at which a quantity that is held goes to its next value; none for one that varies in another way."""
    steps = np.abs(np.diff(values))
    largest = np.argsort(-steps, kind="stable")
    for count in range(min(_MOST - 1, values.size // OF_RECORD, np.count_nonzero(steps)), 0, -1):
        begins = np.sort(largest[:count]) + 1
        drifts = [float(np.ptp(piece)) for piece in np.split(values, begins)]
        changes = [np.inf, *steps[begins - 1], np.inf]
        if all(drift <= _HELD * min(pair) for drift, pair in zip(drifts, itertools.pairwise(changes), strict=True)):
            return begins
    return np.empty(0, dtype=int)


def _changes(labels: np.ndarray) -> np.ndarray:
    """Rows at which a label is another one than before."""
    return np.flatnonzero(labels[1:] != labels[:-1]) + 1


def _returns(u: np.ndarray, clock: np.ndarray | None) -> np.ndarray:
    """Rows at which an input that runs one way jumps back; none where curves neither begin nor end alike, or time goes on there."""
    steps = np.diff(u)
    usual = float(np.median(steps))
    against = np.sign(steps) * np.sign(usual) < 0
    jumps = against & (np.abs(steps) > JUMP * abs(usual))
    begins = np.flatnonzero(jumps) + 1
    if not begins.size or (against & ~jumps).mean() > ODD:
        return np.empty(0, dtype=int)
    if clock is not None and not (np.diff(clock)[begins - 1] > JUMP * np.median(np.diff(clock))).all():
        return np.empty(0, dtype=int)
    ends = np.append(begins - 1, u.size - 1)
    ends = ends[1:] if begins[0] == 1 else ends  # a first row that is no curve, such as a remanence measured before
    alike = _begin_alike(u, begins) or (ends.size > 2 and np.ptp(u[ends]) <= NEAR * np.ptp(u))
    return begins if alike else np.empty(0, dtype=int)


def _begin_alike(u: np.ndarray, begins: np.ndarray, *, at_end: bool = False) -> bool:
    """Whether curves begin where the first one began; with `at_end` also where all but that, which begins at rest, begin at one end."""
    end = u.max() if u[begins[0]] > u.mean() else u.min()
    places = (u[0], end) if at_end else (u[0],)
    return any((np.abs(u[begins] - place) <= NEAR * np.ptp(u)).all() for place in places)


def _cover(u: np.ndarray, pieces: Sequence[np.ndarray]) -> bool:
    return all(piece.size >= OF_RECORD and np.ptp(u[piece]) >= PART * np.ptp(u) for piece in pieces)


def _labeled(pieces: Sequence[np.ndarray], labels: Sequence[str]) -> Curves:
    """Curves with labels that differ."""
    seen: dict[str, int] = {}
    curves = []
    for piece, label in zip(pieces, labels, strict=True):
        seen[label] = seen.get(label, 0) + 1
        curves.append((label if seen[label] == 1 else f"{label} ({seen[label]})", piece))
    return curves
