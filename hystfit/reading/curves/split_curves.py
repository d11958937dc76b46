"""The curves in a file: by a column, by blank lines or repeated headers, or each after a calibration point."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.outcome.note import has, warn
from hystfit.outcome.wrapping import listed
from hystfit.reading.choice.chosen_columns import Choice
from hystfit.reading.choice.quantity_points import LOADS
from hystfit.reading.curves.blocks_of_loops import conditions_of, loops_of
from hystfit.reading.curves.calibration_points import CURVE_NAMES, calibrated_curves
from hystfit.reading.curves.other_inputs import other_inputs
from hystfit.reading.curves.two_branches import mirrored
from hystfit.reading.curves.unseparated_curves import curves_at_conditions
from hystfit.reading.limits import FEWEST, MAJORITY, MOST_CURVES, MOST_LABELS, NEAR
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.held_levels import held_labels
from hystfit.reading.table.raw_table import Table
from hystfit.reading.table.signal_evidence import clock_goes_on, jumps, states_strokes


def text_of(value: object) -> str:
    """A value as it is compared with others: numbers without trailing zeros, text without blanks around it."""
    try:
        return f"{float(value):.12g}"  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return str(value).strip()


def labels_of(table: Table, position: int) -> np.ndarray:
    """The values of a column as text, "" where missing, shape (rows,)."""
    if position in table.labels:
        return np.array([text_of(value) for value in table.labels[position]])
    values, back = np.unique(table.columns[position], return_inverse=True)
    return np.array(["" if np.isnan(value) else f"{value:.12g}" for value in values])[back]


def levels_of(table: Table, position: int) -> np.ndarray:
    """The values of a column as text, those of a measured condition by the level at which it is held, shape (rows,)."""
    labels = labels_of(table, position)
    several = position not in table.labels and np.unique(labels).size > MOST_LABELS
    held = held_labels(table.columns[position]) if several else None
    return labels if held is None else held


def shown(values: Sequence[str] | np.ndarray) -> str:
    """The first of some values, and how many there are."""
    distinct = list(dict.fromkeys(str(value) for value in values))
    return ", ".join(distinct[:12]) + (f", ... ({len(distinct)} in all)" if len(distinct) > 12 else "")


def split_curves(
    table: Table, choice: Choice, divider: int | None, notes: list[Note]
) -> tuple[list[tuple[str, np.ndarray]], bool]:
    """Label and rows of every curve, and whether the file holds several.

    Args:
        divider: position of the column whose values separate curves; None where none was chosen.
    """
    if divider is not None:
        return _of_several_rows(_by_column(table, divider, notes), table, choice, notes), True
    if table.part is not None:
        pieces = _rows_of(table.part, len(table.parts))
        stated = any(part.stated for part in table.parts)
        if not stated and len(pieces) > 1 and (loops := loops_of(table, choice, pieces, notes)):
            notes[:] = [note for note in notes if note.code is not Code.CURVES or note is notes[-1]]
            return loops, len(loops) > 1
        return _by_part(table, choice, notes), True
    if table.calibration is not None:
        return calibrated_curves(table, choice, table.calibration, notes), True
    number = _numbers_of_curves(table, choice, notes)
    if number[-1] == 0:
        if (numbering := _numbering_apart(table, choice)) is not None:
            curves = _of_several_rows(_by_column(table, numbering, notes), table, choice, notes)
            text = f"{len(curves)} curves, numbered by column {table.names[numbering]!r}: the samples jump from one curve to the next"
            notes.append(Note(Code.CURVES, text))
            return curves, True
        number[1:] = np.cumsum(_restarts(table, choice, notes))
        if number[-1] == 0 and (found := curves_at_conditions(table, choice, notes)) is not None:
            return found, len(found) > 1
        if number[-1] == 0:
            _suggest(table, choice, notes)
            return [("", np.arange(table.rows))], False
    if number[-1] > MOST_CURVES:
        raise DataError(
            f"{table.source}: blank lines or repeated headers separate {number[-1] + 1} curves, and {MOST_CURVES} are the "
            "most; remove them, or write fewer curves in a file"
        )
    bounds = np.append(np.flatnonzero(np.diff(number, prepend=-1)), table.rows)
    if what := _goes_on(table, choice, bounds[1:-1]):
        text = f"{len(bounds) - 1} blocks are read as one record: {what} from each to the next"
        notes.append(Note(Code.CURVES, text))
        return [("", np.arange(table.rows))], False
    pieces = [np.arange(a, b) for a, b in itertools.pairwise(bounds)]
    single = sum(piece.size == 1 for piece in pieces)
    pieces = [piece for piece in pieces if piece.size > 1]
    if single:
        notes.append(Note(Code.CURVES, f"{single} blocks of a single row are not part of the curves"))
    if not pieces:
        raise DataError(f"{table.source}: every block between blank lines has a single row; remove the blank lines")
    if len(pieces) == 1:
        return [("", pieces[0])], False
    if loops := loops_of(table, choice, pieces, notes):
        return loops, len(loops) > 1
    if choice.time is None and len(pieces) == 2 and (loop := mirrored(table, choice, pieces)) is not None:
        text = "2 blocks are the branches of one loop, read as one record: each is the other one mirrored through the origin"
        notes.append(Note(Code.CURVES, text))
        return [("", loop)], False
    if not has(table.notes, Code.CURVES):
        notes.append(
            Note(Code.CURVES, f"{len(pieces)} curves, separated by blank lines, repeated headers or heads of sections")
        )
    labels = conditions_of(table, choice, pieces) or [f"curve={k}" for k in range(len(pieces))]
    return list(zip(labels, pieces, strict=True)), True


def _goes_on(table: Table, choice: Choice, starts: np.ndarray) -> str:
    """What shows that blocks, which begin at these rows, are pages of one record: its time or the number of its samples; "" without any."""
    if choice.time is not None:
        goes_on = clock_goes_on(table.columns[choice.time], starts)
        return "the time goes on at its usual steps" if goes_on else ""
    numbered = any(table.counts(k) for k in table.positions if k not in (choice.input, choice.output))
    jump = numbered and any(jumps(table.columns[k], starts - 1).any() for k in (choice.input, choice.output))
    return "the number of the sample goes on" if numbered and not jump else ""


def _by_column(table: Table, divider: int, notes: list[Note]) -> list[tuple[str, np.ndarray]]:
    """Label and rows of each value of a column."""
    labels = levels_of(table, divider)
    if blank := int((labels == "").sum()):
        where = "without a value" if np.isnan(table.columns[divider]).any() else "between the levels"
        notes.append(Note(Code.LEFT_OUT, f"left out: {blank} rows {where} of {table.names[divider]!r}"))
    first, number = np.unique(labels, return_index=True, return_inverse=True)[1:]
    order = [value for value in labels[np.sort(first)].tolist() if value]
    if len(order) > 1000 and len(order) > table.rows / 2:
        raise DataError(
            f"{table.source}: by={table.names[divider]!r} has {len(order)} values in {table.rows} rows; it does not separate curves"
        )
    title = split_unit(table.names[divider])[0]
    rows = _rows_of(number, first.size)
    return [(f"{title}={labels[k]}", rows[number[k]]) for k in np.sort(first).tolist() if labels[k]]


def _rows_of(number: np.ndarray, count: int) -> list[np.ndarray]:
    """Rows with each number from 0 to `count` - 1."""
    return np.split(np.argsort(number, kind="stable"), np.cumsum(np.bincount(number, minlength=count))[:-1])


def _by_part(table: Table, choice: Choice, notes: list[Note]) -> list[tuple[str, np.ndarray]]:
    """Name and rows of the records into which the layout of the file divides it, those without an input left out."""
    pairs = zip(table.parts, _rows_of(table.part, len(table.parts)), strict=True)
    groups = [(part.name, rows) for part, rows in pairs if rows.size]
    filled = [group for group in groups if np.isfinite(table.columns[choice.input][group[1]]).any()]
    filled = [group for group in filled if np.isfinite(table.columns[choice.output][group[1]]).any()]
    if len(filled) < len(groups):
        names = {name for name, _ in filled}
        lacking = shown([name for name, _ in groups if name not in names])
        text = f"left out: records without {table.names[choice.input]!r} or {table.names[choice.output]!r}: {lacking}"
        notes.append(warn(Code.LEFT_OUT, text))
    if not filled:
        raise DataError(
            f"{table.source}: no record has both an input and an output; choose other columns with input= and output="
        )
    return _of_several_rows(filled, table, choice, notes)


def _numbers_of_curves(table: Table, choice: Choice, notes: list[Note]) -> np.ndarray:
    """Number of the curve that each row is in, by blank lines and repeated headers, shape (rows,)."""
    begins, apart = (np.append(False, np.diff(of) > 0) for of in (table.section, table.curve))
    if choice.time is not None:  # a header repeated while time continues is a page break
        clock = table.columns[choice.time]
        page_breaks = begins & ~apart & np.append(False, clock[1:] > clock[:-1])
        if page_breaks.any():
            text = f"{page_breaks.sum()} repeated header rows do not begin a curve: time continues there"
            notes.append(Note(Code.CURVES, text))
        begins &= ~page_breaks
    return np.cumsum(begins | apart)


def _restarts(table: Table, choice: Choice, notes: list[Note]) -> np.ndarray:
    """Where the time starts again as it began, and the loop as well or anew, shape (rows - 1,): nowhere if a half cycle goes on there."""
    if choice.time is None:
        return np.zeros(table.rows - 1, dtype=bool)
    clock, loop = table.columns[choice.time], [table.columns[k] for k in (choice.input, choice.output)]
    steps = np.diff(clock)
    back = steps < 0
    nowhere = np.zeros(steps.size, dtype=bool)
    if not back.any() or not (steps > 0).any() or (back.size - back.sum() < FEWEST * (back.sum() + 1)):
        return nowhere
    again = np.abs(clock[1:][back] - clock[0]) <= np.median(steps[steps > 0])
    starts = np.append(0, np.flatnonzero(back) + 1)
    # Each part begins where the one before began, or far from where that ended.
    alike = np.all(
        [np.abs(v[starts[1:]] - v[starts[:-1]]) <= 2 * NEAR * np.ptp(v[np.isfinite(v)]) for v in loop], axis=0
    )
    apart = np.any([jumps(v, np.flatnonzero(back)) for v in loop], axis=0)
    if not again.all() or not (alike | apart).all():
        return nowhere
    notes.append(Note(Code.CURVES, f"the time starts again {int(back.sum())} times: each part is a curve"))
    return back


def restart_divider(table: Table, choice: Choice) -> int | None:
    """Position of the column that changes where the time starts again, and nowhere else; None without one."""
    if table.part is not None or table.calibration is not None or _numbers_of_curves(table, choice, [])[-1] > 0:
        return None
    begins = _restarts(table, choice, [])
    name = divider_of(table, table.line, begins) if begins.any() else None
    return None if name is None else table.names.index(name)


def _of_several_rows(
    groups: list[tuple[str, np.ndarray]], table: Table, choice: Choice, notes: list[Note]
) -> list[tuple[str, np.ndarray]]:
    """Curves of at least two rows; the others are named in the notes."""
    short = [(label, rows) for label, rows in groups if rows.size < 2]
    if short:
        u, y = (table.columns[position] for position in (choice.input, choice.output))
        first = listed([f"{label} ({u[rows[0]]:g}, {y[rows[0]]:g})" for label, rows in short])
        notes.append(Note(Code.LEFT_OUT, f"left out: curves of a single row, {first}"))
    kept = [(label, rows) for label, rows in groups if rows.size > 1]
    if not kept:
        raise DataError(f"{table.source}: every curve that by= makes has a single row; choose another column")
    return kept


def _numbering_apart(table: Table, choice: Choice) -> int | None:
    """Position of a column that numbers curves which do not follow each other; None without one.

    At half of its changes or more, the time runs back, or the input or the output makes a step that is large beside those around it; or
    the curves are closed loops of different strokes or heights without time. A column that numbers the cycles of one experiment changes
    while the samples go on, as the amplitudes of a force do: damage goes on from one to the next.
    """
    chosen = (choice.time, choice.input, choice.output)
    forces = any(table.quantity(k) in LOADS for k in chosen[1:])
    u, y = table.columns[choice.input], table.columns[choice.output]
    for position, name in enumerate(table.names):
        numbers = table.columns[position]
        if position in chosen or position in table.labels or not np.isfinite(numbers).all():
            continue
        changes = np.flatnonzero(np.diff(numbers))
        if not changes.size or np.unique(numbers).size <= changes.size or table.rows < FEWEST * (changes.size + 1):
            continue
        named = _plain(name) in CURVE_NAMES or (not forces and states_strokes(numbers, u))
        apart = jumps(u, changes) | (jumps(y, changes) & ~_reverses(u, changes))
        if choice.time is not None:
            apart |= np.diff(table.columns[choice.time])[changes] < 0
        # A column of another name, such as the reversal field of reversal curves, separates curves that all begin with a jump.
        alike = choice.time is None and _closed_loops(u, y, changes, forces)
        told = changes.size > 1 and bool(jumps(u, changes).all())
        if choice.time is not None:
            told |= np.array_equal(np.flatnonzero(np.diff(table.columns[choice.time]) < 0), changes)
        if (apart.mean() >= 0.5 or alike) if named else told:
            return position
    return None


def _reverses(u: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Whether the input turns around after these rows, where the output of one test may jump, as friction does, shape of `at`."""
    steps = np.pad(np.diff(u), 1)
    return steps[at] * steps[at + 2] < 0


def _closed_loops(u: np.ndarray, y: np.ndarray, changes: np.ndarray, forces: bool) -> bool:
    """Whether each block of rows up to these is a closed loop, of another stroke or height than the one before.

    The height of a force changes with damage, from one cycle of a test to the next.
    """
    blocks = [[np.nan_to_num(part) for part in np.split(values, changes + 1)] for values in (u, y)]
    if any(abs(part[-1] - part[0]) > NEAR * np.ptp(part) for side in blocks for part in side):
        return False
    sizes = np.array([[np.ptp(part) for part in side] for side in blocks[: 1 if forces else 2]])
    return bool((np.abs(np.diff(sizes)) > NEAR * np.maximum(sizes[:, 1:], sizes[:, :-1])).any(axis=0).all())


def _plain(name: str) -> str:
    """A name without its unit and a word such as number, in lower case."""
    return re.sub(r"[ _.](?:id|no|nr|number|index)$", "", split_unit(name)[0].strip(" .:#").lower())


def _suggest(table: Table, choice: Choice, notes: list[Note]) -> None:
    others = [k for k in table.positions if k not in (choice.time, choice.input, choice.output)]
    numbers: list[int] = []
    for position in others:
        name = table.names[position]
        labels = labels_of(table, position)
        named = _plain(name) in CURVE_NAMES and not _are_branches(labels, table.columns[choice.input])
        count = len({*labels.tolist()}) if named else 0
        if 1 < count <= table.rows / 2:
            text = f"column {name!r} has {count} values: by={name!r} reads each as a record"
            notes.append(Note(Code.CURVES, text, option=("by", name)))
        elif position not in table.labels and table.pair is None:
            numbers.append(position)
    notes.extend(other_inputs(table, choice, numbers))


def _are_branches(labels: np.ndarray, drive: np.ndarray) -> bool:
    """Whether a column numbers branches of a loop, as in most of its blocks the input ends far from where it began."""
    blocks = [
        part for part in np.split(drive, np.flatnonzero(labels[1:] != labels[:-1]) + 1) if np.isfinite(part).all()
    ]
    return sum(abs(part[-1] - part[0]) > MAJORITY * np.ptp(part) for part in blocks) > MAJORITY * len(blocks)


def divider_of(table: Table, line: np.ndarray, begins: np.ndarray) -> str | None:
    """Name of the column whose value changes at the rows where curves begin, and nowhere else; None without one.

    Args:
        table: the rows.
        line: lines of the file that are looked at, shape (n,).
        begins: whether the next of these lines begins a curve, shape (n - 1,).
    """
    rows = np.searchsorted(table.line, line)
    for position, name in enumerate(table.names):
        labels = labels_of(table, position)[rows]
        if np.array_equal(labels[1:] != labels[:-1], begins):
            return name
    return None


def select_curves(groups: list[tuple[str, Any]], only: object, source: str) -> list[tuple[str, Any]]:
    """The (label, curve) pairs that `only` selects, by value ("3,4") or position from 0 ("1::4").

    Args:
        groups: label ("loop=3") and curve of each.
    """
    values = [label.partition("=")[2] or label for label, _ in groups]
    if isinstance(only, str) and (found := re.fullmatch(r"\s*(-?\d*):(-?\d*)(?::(-?\d*))?\s*", only)):
        limits = [int(part) if part else None for part in found.groups()]
        if limits[2] == 0:
            raise DataError(f"only={only!r}: the step of a slice must not be 0")
        chosen = groups[slice(*limits)]
        if not chosen:
            raise DataError(f"{source}: only={only!r} chooses none of {len(groups)} curves (positions from 0)")
        return chosen
    whole = [only] if isinstance(only, str) and text_of(only) in values else None  # a name with a comma in it
    parts = whole or (only.split(",") if isinstance(only, str) else only if isinstance(only, Sequence) else [only])
    wanted = list(dict.fromkeys(text_of(part) for part in parts))
    unknown = [value for value in wanted if value not in values]
    if unknown or not wanted:
        raise DataError(
            f"{source}: there is no curve {', '.join(unknown) or 'in an empty only='}; there are {shown(values)}"
        )
    return [groups[values.index(value)] for value in wanted]
