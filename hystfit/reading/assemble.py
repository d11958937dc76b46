"""Records from a table: the roles of its columns, the rows that the user chooses, and its curves."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading.choice.chosen_columns import Choice, choose, find
from hystfit.reading.choice.conditions import without_turns
from hystfit.reading.curve_records import records_of_curve
from hystfit.reading.curves.branches_in_order import in_order_of_time
from hystfit.reading.curves.calibration_points import marked_by_kind, marked_by_place
from hystfit.reading.curves.copies import without_copies
from hystfit.reading.curves.split_curves import (
    levels_of,
    restart_divider,
    select_curves,
    shown,
    split_curves,
    text_of,
)
from hystfit.reading.limits import MAJORITY, RARE
from hystfit.reading.registry import arranged
from hystfit.reading.table import sentinels
from hystfit.reading.table.raw_table import Table
from hystfit.reading.treatment import UNTREATED, Treatment

Column = str | int
_UNREAD = 2  # rows that may be left out of any file


def assemble(
    table: Table,
    *,
    time: Column | bool | None = None,
    input: Column | None = None,
    output: Column | None = None,
    sigma: Column | None = None,
    by: Column | None = None,
    only: str | Sequence[object] | None = None,
    where: str | Mapping[str, object] | None = None,
    gaps: str = "error",
    adjusted: bool = False,
    name: str | None = None,
    treatment: Treatment = UNTREATED,
    unread: dict[str, str] | None = None,
) -> Record | Dataset:
    """Record or data set from a table.

    Args:
        time, input, output, sigma, by, only, where, gaps, adjusted, name, unread: as for `read`.
    """
    if gaps not in ("error", "split", "drop"):
        raise DataError(f"gaps must be 'error', 'split' or 'drop', got {gaps!r}")
    _check_unread(table, gaps)
    stem = name or Path(table.source).stem or "record"
    named = input is not None or output is not None
    free = not named and all(key is None or key is False for key in (time, sigma, by, where))
    table = arranged(table, named=named, free=free, adjusted=adjusted)
    table = sentinels.without_end_marks(table)
    notes = list(table.notes)
    table, replaced = sentinels.without_infinite(table)
    table, taken = _filter(table, where, notes)
    divider, spread = (None if key is None else find(table, key, role) for role, key in (("by", by), ("sigma", sigma)))
    asked = (time, *_of_layout(table, input, output))
    others = [*taken, *(position for position in (divider, spread) if position is not None)]
    table, choice, divider = _with_choice(table, asked, others, divider, notes)
    for role, position in (("time", choice.time), ("input", choice.input), ("output", choice.output)):
        notes += sentinels.replaced_notes(replaced[position], role) if position in replaced else []
    table = without_turns(_without_comments(table, choice, notes), choice.output, notes)
    table = in_order_of_time(table, choice, notes) if divider is None and not table.section.any() else table
    groups, several = split_curves(table, choice, divider, notes)
    if only is not None:
        if not several:
            raise DataError(
                f"{table.source} holds one curve, so only={only!r} cannot choose among several; separate curves with by="
            )
        groups = select_curves(groups, only, table.source)
    read = lambda label, rows: records_of_curve(
        table.take(rows), choice, label if several else stem, notes, gaps, spread, treatment
    )
    records = _readable(groups, read, unread)
    if not several and len(records) == 1:
        return records[0]
    # A column separates measurements, whose numbers may be equal.
    return Dataset(tuple(records) if divider is not None else without_copies(records), name=stem)


def _with_choice(
    table: Table,
    asked: tuple[Column | bool | None, Column | None, Column | None],
    others: Sequence[int],
    divider: int | None,
    notes: list[Note],
) -> tuple[Table, Choice, int | None]:
    """The columns of the record and that which separates curves; the table with its calibration points marked.

    Args:
        asked: time, input and output as the user names them.
        others: columns that have another use.
    """
    marked, dividers = marked_by_kind(table, others)
    named = [None if isinstance(key, bool) or key == "none" else key for key in asked]
    roles = zip(("time", "input", "output"), named, strict=True)
    _check_problems(table, [None if key is None else find(table, key, role) for role, key in roles])
    choice = choose(table, *asked, [*others, *dividers])
    if divider is None and (divider := restart_divider(table, choice)) is not None:
        choice = choose(table, *asked, [*others, *dividers, divider])
        text = f"the time starts again where column {table.names[divider]!r} changes: each of its values is a record"
        notes.append(Note(Code.CURVES, text))
    if choice.untimed:
        table = dataclasses.replace(table, interval=None)
    _check_problems(table, [choice.time, choice.input, choice.output])
    notes += [*choice.notes, *_unread_time(table, choice, asked[0])]
    if divider is None:
        if marked is None and table.part is None:
            marked = marked_by_place(table, choice)
        marked = marked if table.calibration is None else table.calibration
    return dataclasses.replace(table, calibration=marked), choice, divider


def _readable(
    groups: Sequence[tuple[str, np.ndarray]],
    read: Callable[[str, np.ndarray], list[Record]],
    unread: dict[str, str] | None,
) -> list[Record]:
    """The records of the curves that can be read; `unread` takes the reasons why others cannot.

    Raises:
        DataError: no curve can be read, or one cannot and there is no `unread`.
    """
    records, failed = list[Record](), dict[str, DataError]()
    for label, rows in groups:
        try:
            records += read(label, rows)
        except DataError as error:
            if unread is None:
                raise
            failed[label] = error
    if failed and not records:
        raise next(iter(failed.values()))
    if unread is not None:
        unread |= {label: str(error) for label, error in failed.items()}
    return records


def _of_layout(table: Table, input: Column | None, output: Column | None) -> tuple[Column | None, Column | None]:
    """Input and output: those of the user, and where one is left open that which the layout of the file determines."""
    if table.pair is None:
        return input, output
    drive, sensor = table.pair
    if input is None and (output is None or find(table, output, "output") != drive):
        input = drive
    if output is None and find(table, input if input is not None else drive, "input") != sensor:
        output = sensor
    return input, output


def _check_problems(table: Table, positions: Sequence[int | None]) -> None:
    """Refuse a chosen column that cannot be read for certain."""
    if problem := next((table.problems[k] for k in positions if k in table.problems), None):
        raise DataError(problem)


def _unread_time(table: Table, choice: Choice, time: Column | bool | None) -> list[Note]:
    """A warning where there is no time because its stamps cannot be read."""
    unread = next((table.problems[k] for k in sorted(table.stamps) if k in table.problems), None)
    if choice.time is not None or time is not None or unread is None:
        return []
    return [warn(Code.FILE_FORMAT, f"read without time: {unread}")]


def _check_unread(table: Table, gaps: str) -> None:
    """Refuse a table from which many rows of numbers are left out, as they would make jumps in the record."""
    if gaps == "error" and not table.sectioned and table.unread > max(_UNREAD, RARE * table.rows):
        raise DataError(
            f"{table.source}: {table.unread} rows of numbers cannot be read, and {table.rows} can "
            f"({', '.join(f'{count} x {reason}' for reason, count in table.left_out.items())}); correct them, or leave them out "
            "with gaps='drop'"
        )


def _filter(table: Table, where: str | Mapping[str, object] | None, notes: list[Note]) -> tuple[Table, list[int]]:
    if where is None:
        return table, []
    if isinstance(where, str):
        pairs = [part.partition("=") for part in where.split(",")]
        if not all(mark for _, mark, _ in pairs):
            raise DataError(f"where must read column=value, got {where!r}")
        where = {key.strip(): value.strip() for key, _, value in pairs}
    positions = []
    for key, value in where.items():
        position = find(table, key, "where")
        labels = levels_of(table, position)
        hit = labels == text_of(value)
        if not hit.any():
            raise DataError(f"{table.source}: no row has {key} = {value!r}; its values are {shown(labels)}")
        notes.append(Note(Code.LEFT_OUT, f"left out: {int((~hit).sum())} rows where {key} is not {value}"))
        table = table.take(hit)
        positions.append(position)
    return table, positions


def _without_comments(table: Table, choice: Choice, notes: list[Note]) -> Table:
    """The table without rows that hold a comment, and in files with a [Data] section any rows, without a measurement."""
    empty = np.isnan(table.columns[choice.input]) & np.isnan(table.columns[choice.output])
    if not table.sectioned:
        filled = [labels != "" for labels in table.labels.values()]
        comments = [cells for cells in filled if cells.mean() < MAJORITY]  # not a column of states, which every row has
        empty &= np.any(comments, axis=0) if comments else False
    if not empty.any():
        return table
    text = f"left out: {int(empty.sum())} rows without input and output (comments, other measurements)"
    notes.append(Note(Code.LEFT_OUT, text))
    return table.take(~empty)
