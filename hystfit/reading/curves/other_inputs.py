"""Warnings of columns that are set or held at levels within a record, as the current of a damper is: a model has one input."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Iterator

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading.choice.chosen_columns import Choice
from hystfit.reading.curves.unseparated_curves import numbers_cycles
from hystfit.reading.table.held_levels import held_labels, held_levels, levels_apart, levels_in_turn
from hystfit.reading.table.raw_table import Table
from hystfit.reading.table.signal_evidence import explained, states_strokes, swings

_STATE = re.compile(r"status|state|code|flag|valid|error|range", re.IGNORECASE)  # of an instrument, which is no input
_AGREES = 0.9  # part of the steps of the input that a column of its direction agrees with: not those by noise
# Of the variance of a condition that the input and the output explain: it follows them. The input explains 0 to 0.06 of the currents of
# dampers and of prestresses, and more than 0.5 of what is switched within every cycle; the output, which they drive, up to 0.77 of them,
# and 0.99 of its own sign.
_WITH_INPUT, _WITH_OUTPUT = 0.5, 0.9
_STROKES = 2  # of the input during each level: what follows the input or the output changes within them


def other_inputs(table: Table, choice: Choice, positions: Iterable[int]) -> Iterator[Note]:
    """A warning for each of these columns of numbers that is a further input, with how to read the samples of one of its levels."""
    kinds = [*map(table.quantity, table.positions)]
    known = set()  # quantities and numbers of levels, as those of several thermometers
    for position in positions:
        name, values = table.names[position], table.columns[position]
        if kinds[position] in ("index", "time") or _STATE.search(name):
            continue
        drive = table.columns[choice.input]
        if _is_direction(values, drive) or (kinds[position] == "" and numbers_cycles(table, position, drive)):
            continue
        if levels := levels_in_turn(values):
            if states_strokes(values, drive):
                continue
            yield _note(name, "set to", levels, ("where", f"{name}={levels[-1]:g}"), "the samples of one level")
        elif kinds[position] not in ("velocity", "") and (held := _held_apart(table, choice, position)):
            if (sensor := (kinds[position], len(held))) in known:
                continue
            known.add(sensor)
            yield _note(
                name,
                "held at",
                levels_apart(np.array([one[0] for one in held])),
                *_remedy(table, choice, position, held),
            )


def _note(name: str, word: str, levels: list[float], option: tuple[str, str], what: str) -> Note:
    shown = ", ".join(f"{level:.4g}" for level in levels)
    key, value = option
    text = f"column {name!r} is {word} {len(levels)} levels ({shown}), and a model has one input: {key}={value!r} reads {what}"
    return dataclasses.replace(warn(Code.CURVES, text), option=option)


def _remedy(
    table: Table, choice: Choice, position: int, held: list[tuple[float, int, int]]
) -> tuple[tuple[str, str], str]:
    """The option that reads the rows of one level, and what they are: records where each level is held once, else a stretch."""
    labels = held_labels(table.columns[position])
    at_levels = np.empty(0) if labels is None else labels[labels != ""]
    if at_levels.size and np.count_nonzero(at_levels[1:] != at_levels[:-1]) < len(held):
        return ("by", table.names[position]), "each level as a record"
    _, first, stop = max(held, key=lambda one: one[2] - one[1])
    clock = np.arange(table.rows) if choice.time is None else table.columns[choice.time]
    return ("window", f"{clock[first]:.10g}:{clock[stop - 1]:.10g}"), "the longest stretch of one level"


def _held_apart(table: Table, choice: Choice, position: int) -> list[tuple[float, int, int]]:
    """The levels at which a column is held whatever the input and the output are; none of one that follows either of them."""
    values, together = table.columns[position], np.zeros(table.rows)
    held = held_levels(values)
    if all(swings(table.columns[choice.input][first:stop]) > _STROKES for _, first, stop in held):
        return held  # the output, which it sets, may tell it as well
    loop = ((table.columns[choice.input], _WITH_INPUT), (table.columns[choice.output], _WITH_OUTPUT))
    return [] if held and any(explained(one, values, together) > most for one, most in loop) else held


def _is_direction(values: np.ndarray, drive: np.ndarray) -> bool:
    """Whether a column of two levels tells whether the input rises or falls."""
    step = np.diff(drive)
    rising, high = step[step != 0] > 0, values[1:][step != 0] > values.min()
    agree = float(np.mean(rising == high)) if high.size else 0.5
    return np.unique(values).size == 2 and max(agree, 1.0 - agree) > _AGREES
