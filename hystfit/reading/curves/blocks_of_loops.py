"""Loops whose branches stand in blocks below each other, and the measured condition that tells blocks apart."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.choice.chosen_columns import Choice
from hystfit.reading.choice.column_facts import HEATED
from hystfit.reading.limits import NEAR
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Table
from hystfit.reading.table.signal_evidence import meet

_INNER = (0.1, 0.5, 0.9)  # quantiles of a condition that is held: its first samples may not have settled
_CLEARLY = 4.0  # times the range of a condition within a curve, by which it differs from curve to curve


def loops_of(
    table: Table, choice: Choice, pieces: Sequence[np.ndarray], notes: list[Note]
) -> list[tuple[str, np.ndarray]]:
    """Label and rows of loops of which blocks are the branches, each beginning where the previous one ends; none of other blocks.

    If there is a clock, it goes on within each loop, after no pause that is longer than a branch: then the sample has rested.
    """
    u, y = table.columns[choice.input], table.columns[choice.output]
    breaks = np.union1d(_restarts(table, choice, pieces), _heated(table, choice, pieces)).astype(int).tolist()
    groups = [pieces[a:b] for a, b in itertools.pairwise([0, *breaks, len(pieces)])]
    loops = [np.concatenate(group) for group in groups]
    if choice.time is not None and not all(_goes_on(table.columns[choice.time], group) for group in groups):
        return []
    if not all(len(group) > 1 and _follow_each_other(u, y, group) for group in groups):
        return []
    each = "each begins where the previous one ends, and the input reverses"
    if len(loops) == 1:
        notes.append(Note(Code.CURVES, f"{len(pieces)} blocks are branches of one loop, read as one record: {each}"))
        return [("", loops[0])]
    text = f"{len(pieces)} blocks are branches of {len(loops)} loops, a record of each: within it {each}"
    notes.append(Note(Code.CURVES, text))
    labels = conditions_of(table, choice, loops) or [f"loop={k}" for k in range(len(loops))]
    return list(zip(labels, loops, strict=True))


def _restarts(table: Table, choice: Choice, pieces: Sequence[np.ndarray]) -> np.ndarray:
    """Blocks before which the clock runs back."""
    if choice.time is None:
        return np.empty(0, dtype=int)
    clock = table.columns[choice.time]
    back = [clock[piece[0]] < clock[before[-1]] for before, piece in itertools.pairwise(pieces)]
    return np.flatnonzero(back) + 1


def _goes_on(clock: np.ndarray, group: Sequence[np.ndarray]) -> bool:
    """Whether a clock rises through the blocks of a loop, and stands still between two no longer than either of them lasts."""
    rises = bool((np.diff(clock[np.concatenate(group)]) > 0).all())
    pauses = [clock[piece[0]] - clock[before[-1]] for before, piece in itertools.pairwise(group)]
    return rises and max(pauses, default=0.0) <= min(float(np.ptp(clock[piece])) for piece in group)


def _heated(table: Table, choice: Choice, pieces: Sequence[np.ndarray]) -> np.ndarray:
    """Blocks before which a temperature changes that is held within each; none where one is a signal."""
    kinds = [*map(table.quantity, table.positions)]
    if not table.named or "temperature" in (kinds[choice.input], kinds[choice.output]):
        return np.empty(0, dtype=int)
    for values in (table.columns[k] for k, kind in enumerate(kinds) if kind == "temperature"):
        if all(np.isfinite(values[piece]).any() for piece in pieces):
            held, spread = _levels(values, pieces)
            if (changes := np.flatnonzero(np.abs(np.diff(held)) > max(HEATED, _CLEARLY * spread))).size:
                return changes + 1
    return np.empty(0, dtype=int)


def _levels(values: np.ndarray, pieces: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
    """Median of a condition in each block, and the most that it varies within one."""
    low, held, high = np.transpose([np.nanquantile(values[piece], _INNER) for piece in pieces])
    return held, float((high - low).max())


def _follow_each_other(u: np.ndarray, y: np.ndarray, pieces: Sequence[np.ndarray]) -> bool:
    """Whether the input runs up and down in turn from block to block, and each block begins near the end of the one before."""
    near, way = NEAR * np.ptp(u[np.isfinite(u)]), 0.0
    for piece in pieces:
        ends = u[piece[0]], u[piece[-1]]
        stroke = float(ends[1] - ends[0])
        # A block is one branch: nowhere does it leave the range between its ends.
        inside = np.all((u[piece] >= min(ends) - near) & (u[piece] <= max(ends) + near))
        if not inside or abs(stroke) <= near or stroke * way > 0:
            return False
        way = stroke
    return meet([u[piece] for piece in pieces]) and meet([y[piece] for piece in pieces])


def conditions_of(table: Table, choice: Choice, pieces: Sequence[np.ndarray]) -> list[str]:
    """A label of every curve by the measured condition that tells them apart, such as the current of a damper; none without one."""
    for position, name in enumerate(table.names if table.named else ()):
        values = table.columns[position]
        if position in (choice.time, choice.input, choice.output, *table.labels) or not np.isfinite(values).all():
            continue
        levels, spread = _levels(values, pieces)
        apart = float(np.diff(np.sort(levels)).min())
        if apart > _CLEARLY * spread:
            digits = 1 - math.floor(math.log10(apart))
            return [f"{split_unit(name)[0]}={round(level, digits) + 0.0:.12g}" for level in levels.tolist()]
    return []
