"""Tables in which several loops stand side by side, in groups of columns that are named alike but for their numbers."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Sequence

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.params.units import quantity
from hystfit.reading.arrangements.specimens import names_objects
from hystfit.reading.limits import FEWEST
from hystfit.reading.names.branch_words import BRANCHES, words_of
from hystfit.reading.names.column_names import column_quantity, is_terminal
from hystfit.reading.names.names_with_units import is_unit, split_unit
from hystfit.reading.table.raw_table import Table

_NUMBER = re.compile(r"[ _.#-]*\d+$|\[\d+\]$")  # of a loop, at the end of a name: H1, H_2, H.1, and H[1] of a matrix
# Words between underscores and signs, and of CamelCase; a number keeps its decimals: 0.5T of H_0.5T.
_WORD = re.compile(r"\d+\.\d+[^\W_]*|[^\W_]+?(?=[\W_]|$|(?<=[a-z])(?=[A-Z]))")
_CONDITION = re.compile(
    r"(.*?)(?:[\s_@(]|at\b)*(?:[^\W_]+ ?= ?)?([+-]?\d+(?:[.,]\d+)?)\s*([A-Za-z°%]+)\)?"
)  # a value and its unit behind a name: M 5K, Id (Vd = 1 V), Vbias=1 V
# Part of the mean step from row to row below which samples follow each other from column to column, where there are more rows;
# its reciprocal where there are more columns.
_SMOOTHER = 0.3
# An object by its number or letter.
_LABELED = re.compile(r"(.*?[^\W\d_])(?: +(\S{1,3})|[_-]?(\d{1,3}|(?<=[a-z_-])[A-Z]))")


def stacked(table: Table) -> Table | None:
    """Loops side by side, of the same columns each (H1, B1, H2, B2, or t, x, F, t, x, F), are a record each; None for other tables.

    Names may have words of their group (M_300K, H_300K). No other column of numbers stands beside them, apart from one that numbers the
    rows: channels of one experiment, which share a time, are no loops of their own. Groups of columns follow each other, or the columns of
    a matrix of inputs precede those of a matrix of outputs (H1, H2, B1, B2), or outputs at several conditions follow one input (H, 5 K,
    300 K). Columns may end at different rows. Words above the names, one over each group, name the records.
    """
    there = [k for k in table.positions if k in table.labels or np.isfinite(table.columns[k]).any()]
    # The first column may number the rows, and so may one of the same name in every group.
    if there and table.counts(there[0]) and column_quantity(table.names[there[0]]) in ("", "index"):
        first = there[0]
        there = [k for k in there if not (table.names[k] == table.names[first] and table.counts(k))]
    count = len(there)
    if not table.named or count < 3:
        return None
    if (conditions := _of_conditions(table, there)) is not None or count < 4:
        return conditions
    bases = [_base(table.names[k]) for k in there]
    for size in range(2, count // 2 + 1):
        groups = [there[k : k + size] for k in range(0, count, size)]
        if count % size == 0 and len({*bases[:size]}) == size and bases == bases[:size] * len(groups):
            return _below_each_other(table, groups)
    for size in range(2, count // 2 + 1):
        groups = [there[k : k + size] for k in range(0, count, size)]
        titles, names = (
            _titles([[table.names[k] for k in group] for group in groups]) if count % size == 0 else ([], [])
        )
        units = {table.units[k] for k in there}
        if len(units) == 1 and "" not in units:  # Ha_x, Ha_y, M_x, M_y in A/m: components of vectors
            continue
        if titles and (below := _below_each_other(table, groups, titles)) is not None:
            return dataclasses.replace(below, names=tuple(names))
    clock, rest = there[0], there[1:]
    if table.quantity(clock) == "time":
        return _at_conditions(table, clock, rest)
    half = count // 2
    if count % 2 == 0 and len({*bases[:half]}) == len({*bases[half:]}) == 1 and bases[0] != bases[-1]:
        return _below_each_other(table, [[there[k], there[k + half]] for k in range(half)])
    return None


def _of_conditions(table: Table, there: Sequence[int]) -> Table | None:
    """One input and an output at each of several conditions, and other columns behind them, which are left out; None for other tables."""
    titles = [_condition(table.names[k]) or _object(table.names[k]) for k in there[1:]]
    told = [title for title in itertools.takewhile(bool, titles) if title]
    count = len(told)
    outputs, others = there[1 : count + 1], there[count + 1 :]
    apart = 1 < count == len({*told}) and not any(titles[count:]) and len(others) < count
    if not apart or len({(base, unit) for base, _, unit in told}) > 1:
        return None
    names = [f"{value} {unit}".strip() for _, value, unit in told]
    output = told[0][0] or "output"
    alike = dataclasses.replace(table, names=tuple(output if k in outputs else n for k, n in enumerate(table.names)))
    if others:
        shown = ", ".join(repr(table.names[k]) for k in others)
        alike = alike.noted(Note(Code.LEFT_OUT, f"columns not used: {shown}"))
    return _below_each_other(alike, [[there[0], k] for k in outputs], names)


def _at_conditions(table: Table, clock: int, rest: Sequence[int]) -> Table | None:
    """Groups of columns that share a time, of one experiment at each of several conditions (V_1Hz, x_1Hz, V_5Hz, x_5Hz)."""
    for size in (size for size in range(2, len(rest) // 2 + 1) if len(rest) % size == 0):
        groups = [rest[k : k + size] for k in range(0, len(rest), size)]
        titles, names = _titles([[table.names[k] for k in group] for group in groups])
        if titles and all(_condition(title) for title in titles):
            below = _below_each_other(table, [[clock, *group] for group in groups], titles)
            return below and dataclasses.replace(below, names=(table.names[clock], *names))
    return None


def _condition(name: str) -> tuple[str, str, str] | None:
    """The rest of a name, and the value and unit of a condition that it states ("M 5K", "280 K", "B at 50 Hz"); None without one."""
    match = _CONDITION.fullmatch(_bare(name))
    return (match[1], match[2], match[3]) if match and quantity(match[3]) else None


def _object(name: str) -> tuple[str, str, str] | None:
    """An empty name, the title of one of several objects ("Pixel A", "Device3", "SpecimenB_kN"), and no unit; None for other names."""
    for text in (split_unit(name)[0], _bare(name)):
        match = _LABELED.fullmatch(text)
        if match and names_objects(match[1]):
            return "", f"{match[1]} {match[2] or match[3]}", ""
    return None


def _bare(name: str) -> str:
    """A name without a unit in brackets."""
    base, unit = split_unit(name)
    return base if name.endswith((")", "]")) and is_unit(unit) else name


def _titles(groups: Sequence[Sequence[str]]) -> tuple[list[str], list[str]]:
    """The words that all names of a group have, and those of no other group, and the rest of the names, which is that of all groups.

    In M_300K and H_300K beside M_77K and H_77K these are 300K, 77K, and M, H; none where the names are made in another way.
    """
    words = [[_WORD.findall(_bare(name)) for name in group] for group in groups]
    shared = [set.intersection(*map(set, names)) for names in words]
    common = set.intersection(*shared)
    rest = [
        [" ".join(w for w in name if w not in own) for name in names] for names, own in zip(words, shared, strict=True)
    ]
    titles = [" ".join(w for w in names[0] if w in own) for names, own in zip(words, shared, strict=True)]
    told = not all(is_terminal(name) for name in groups[0])  # DrainI, DrainV, GateI, GateV
    told &= all(own - common for own in shared) and len({*titles}) == len(titles)
    told &= not any(len(title) > 2 and column_quantity(title) not in ("", "index") for title in titles)  # pos, torque
    spelled = all(re.search(r"[^\W\d]", name) for name in rest[0])
    alike = spelled and all(other == rest[0] for other in rest) and len({*rest[0]}) == len(rest[0])
    return (titles, rest[0]) if told and alike else ([], [])


def stacked_files(table: Table, inputs: int) -> Table | None:
    """The loops of a file of inputs and a file of outputs, one below the other; None for other files.

    A loop is a column, or, in files without names whose numbers change less from column to column than from row to row, a row.

    Args:
        table: the columns of the first file, then those of the second.
        inputs: number of columns of the first.
    """
    bases = [_base(name) if table.named else "" for name in table.names]
    if inputs < 2 or len(bases) != 2 * inputs or any(len(set(side)) > 1 for side in (bases[:inputs], bases[inputs:])):
        return None
    drives, sensors = np.column_stack(table.columns[:inputs]), np.column_stack(table.columns[inputs:])
    if not table.named and not table.labels and table.rows > 1 and runs_along_rows(drives, sensors):
        number = np.repeat(np.arange(table.rows), inputs)
        loops = dataclasses.replace(
            table.select([0, inputs]).take(number), columns=(drives.ravel(), sensors.ravel()), curve=number
        )
        return loops.noted(Note(Code.CURVES, f"{table.rows} loops, one in each row of the two files"))
    if any((np.diff(table.columns[k]) > 0).all() for k in (0, inputs)):  # a time, which no header names
        return None
    return _below_each_other(table, [[k, k + inputs] for k in range(inputs)])


def runs_along_rows(*signals: np.ndarray) -> bool:
    """Whether signals, each of shape (rows, columns), change less from column to column than from row to row: a row is a loop."""
    rows, columns = signals[0].shape
    change = lambda axis: sum(float(np.nanmean(np.abs(np.diff(signal, axis=axis)))) for signal in signals)
    ratio = 1 / _SMOOTHER if rows < columns else _SMOOTHER  # a loop has more samples than there are loops
    return change(1) < ratio * change(0)


def _below_each_other(table: Table, groups: Sequence[Sequence[int]], titles: Sequence[str] = ()) -> Table | None:
    """The loops in groups of columns, one below the other; None where these hold something else.

    Args:
        groups: positions of the columns of each, in the same order.
        titles: of the records; the words above the columns where there are none.
    """
    first, width = groups[0], len(groups[0])
    kinds = [table.quantity(k) if table.named else "" for k in first]
    alike = all(table.units[k] == table.units[one] for group in groups for k, one in zip(group, first, strict=True))
    clocks = kinds.count("time") + kinds.count("index")
    if table.labels or table.stamps or not alike or (clocks if width == 2 else kinds.count("time") != 1):
        return None
    if any(np.array_equal(table.columns[a], table.columns[b], equal_nan=True) for a, b in itertools.pairwise(first)):
        return None  # two channels, each with its time
    kept = [np.flatnonzero(np.all([np.isfinite(table.columns[k]) for k in group], axis=0)) for group in groups]
    if min(rows.size for rows in kept) < FEWEST:
        return None
    below = lambda side: np.concatenate(
        [table.columns[group[side]][rows] for group, rows in zip(groups, kept, strict=True)]
    )
    joined = dataclasses.replace(
        table.select(first).take(np.concatenate(kept)), columns=tuple(below(side) for side in range(width)), over=()
    )
    number = np.repeat(np.arange(len(groups)), [rows.size for rows in kept])
    base = table.whole
    titles = titles or [next((table.over[k] for k in group if table.over and table.over[k]), "") for group in groups]
    named = all(titles) and not any(words_of(title) & BRANCHES for title in titles)
    if "time" in kinds and not named and width > 2 and _goes_on(joined.columns[kinds.index("time")], number):
        text = f"{len(groups)} groups of {width} columns side by side, whose times follow each other, are read as one record"
        pulses = tuple(dataclasses.replace(part, stated=()) for part in table.parts)  # what was stated is of pulses
        return dataclasses.replace(joined, parts=pulses).noted(Note(Code.CURVES, text))
    text = f"{len(groups)} loops side by side, each of {width} columns named alike, are read as curves"
    return dataclasses.replace(
        joined,
        curve=number,  # where these follow each other they are the branches of one loop
        section=np.zeros_like(number),
        part=number if named else None,
        parts=tuple(dataclasses.replace(base, name=title) for title in titles) if named else table.parts,
    ).noted(Note(Code.CURVES, text))


def _goes_on(clock: np.ndarray, number: np.ndarray) -> bool:
    """Whether each group begins later than the one before it ends."""
    begins = np.flatnonzero(np.diff(number)) + 1
    return bool((clock[begins] > clock[begins - 1]).all())


def _base(name: str) -> str:
    """Name of a column without its unit and its number."""
    return numbered(name)[0].lower()


def numbered(name: str) -> tuple[str, int | None]:
    """Name of a column without its unit and its number, and this number; None without one."""
    text = split_unit(name)[0].strip()
    match = _NUMBER.search(text)
    return (text, None) if match is None else (text[: match.start()], int(match[0].strip(" _.#-[]")))
