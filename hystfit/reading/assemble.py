"""Records from the rows of a table: roles of the columns, rows that are left out, curves, gaps and clocks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.preparation import CoarseClock, RoundedStamps
from hystfit.data.record import Record, median_interval
from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.params.units import quantity
from hystfit.reading.choice.chosen_columns import Choice, choose, find
from hystfit.reading.choice.conditions import changed_conditions, without_turns
from hystfit.reading.curves.branches_in_order import in_order_of_time
from hystfit.reading.curves.calibration_points import marked_by_kind, marked_by_place
from hystfit.reading.curves.copies import without_copies
from hystfit.reading.curves.split_curves import (
    divider_of,
    labels_of,
    restart_divider,
    select_curves,
    shown,
    split_curves,
    text_of,
)
from hystfit.reading.limits import FEW, MAJORITY, OF_RECORD, RARE
from hystfit.reading.names.column_names import column_unit
from hystfit.reading.registry import arranged
from hystfit.reading.table import sentinels
from hystfit.reading.table.raw_table import Part, Table
from hystfit.reading.text.cells import unit_of_epoch
from hystfit.reading.text.stated_interval import unit_of_interval
from hystfit.reading.treatment import UNTREATED, Treatment, weighted

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
    read = lambda label, rows: _records_of(
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
        labels = labels_of(table, position)
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


def _records_of(
    table: Table,
    choice: Choice,
    title: str,
    notes: list[Note],
    gaps: str,
    sigma: int | None,
    treatment: Treatment,
) -> list[Record]:
    """One record of the rows of a curve, or its pieces where the input is missing and `gaps` is "split"."""
    columns = {"input": choice.input, "output": choice.output}
    if choice.time is not None:
        columns["time"] = choice.time
    data = {role: np.array(table.columns[position]) for role, position in columns.items()}
    notes = [*notes]
    for role in ("input", "output"):
        data[role], coded = sentinels.without_codes(data[role], role)
        notes += coded
        if (shifted := sentinels.shifted_marks(data[role])).size >= FEW and gaps == "error":
            lines = ", ".join(map(str, table.line[shifted[:5]]))
            raise DataError(
                f"{table.source}: {shifted.size} numbers of the {role} are a tenth of those around them, or ten times these "
                f"(lines {lines}): decimal marks were lost when the file was written; export it again (gaps='drop' reads it as it is)"
            )
    if (failed := sentinels.failed_inputs(data["input"], data["output"])).size:
        text = f"left out: {failed.size} rows in which the input alone reads 0, as that of a sensor that failed"
        notes.append(warn(Code.MISSING_VALUES, f"{text}; lines {', '.join(map(str, table.line[failed[:5]]))}"))
        kept = np.delete(np.arange(table.rows), failed)
        table, data = table.take(kept), {role: values[kept] for role, values in data.items()}
    if sentinels.ends_with_zeros(data.values()):
        notes.append(
            Note(
                Code.LEFT_OUT,
                "left out: the last row, which is 0 in all columns and far from the row before: an end mark",
            )
        )
        table, data = table.take(np.arange(table.rows - 1)), {role: values[:-1] for role, values in data.items()}
    if gaps == "error" and (others := _rows_of_others(data)).any():
        notes.append(Note(Code.LEFT_OUT, f"left out: {others.sum()} rows of other columns"))
        table, data = table.take(~others), {role: values[~others] for role, values in data.items()}
    missing = int(np.isnan(data["output"]).sum())
    if missing:
        notes.append(Note(Code.MISSING_VALUES, f"missing outputs: {missing} samples, simulated but not fitted"))
    if "time" in data and data["time"].size > 2 and (np.diff(data["time"]) < 0).all():
        notes.append(
            Note(Code.TIME_STEPS, "the time decreases from row to row: the rows are read from the last to the first")
        )
        table, data = table.take(np.arange(table.rows)[::-1]), {role: values[::-1] for role, values in data.items()}
    good = np.isfinite(data["input"])
    if "time" in data:
        good &= np.isfinite(data["time"])
    if gaps == "drop" and good.any() and not good.all():
        text = (
            f"left out: {int((~good).sum())} rows without input or time; the samples before and after them are joined"
        )
        notes.append(warn(Code.LEFT_OUT, text))
        table, data, good = table.take(good), {role: values[good] for role, values in data.items()}, good[good]
    spans = _spans(good, table, title, gaps, notes)
    records = []
    for number, (start, stop) in enumerate(spans):
        part = {role: values[start:stop] for role, values in data.items()}
        piece_notes = [*notes]
        if "time" in part and not (treatment.interval and np.ptp(part["time"]) == 0):
            _check_time(part["time"], table.line[start:stop], table, piece_notes)
        name = title if len(spans) == 1 else f"{title} piece={number}"
        record = _record(table, choice, part, name, piece_notes)
        if table.calibration is not None:
            record = record.replace(weight=np.where(table.calibration[start:stop], 0.0, record.weight))
        if sigma is not None:
            record = weighted(record, table.columns[sigma][start:stop], table.units[sigma])
        records.append(treatment.of(record, table.interval))
    return records


def _rows_of_others(data: dict[str, np.ndarray]) -> np.ndarray:
    """Rows with neither input nor output where points are not sampled evenly, or between those of an input in every n-th row, bool."""
    missing = np.isnan(data["input"])
    at = np.flatnonzero(~missing)
    if at.size >= OF_RECORD and np.ptp(np.diff(at)) == 0:
        return missing
    steps = np.diff(data["time"]) if "time" in data else np.zeros(0)
    sampled = steps.size > 0 and np.ptp(steps) <= np.median(steps)
    return np.zeros_like(missing) if sampled else missing & np.isnan(data["output"])


def _spans(good: np.ndarray, table: Table, title: str, gaps: str, notes: list[Note]) -> list[tuple[int, int]]:
    where = f"{table.source}" + (f", {title}" if title else "")
    if not good.any():
        raise DataError(f"{where}: the input has no finite value; choose another column")
    first, last = int(np.argmax(good)), good.size - int(np.argmax(good[::-1]))
    if ends := first + good.size - last:
        notes.append(Note(Code.LEFT_OUT, f"left out: {ends} rows at the ends without input or time"))
    edge = np.flatnonzero(np.diff(np.concatenate([[0], good[first:last].astype(int), [0]]))) + first
    spans = list(zip(edge[::2].tolist(), edge[1::2].tolist(), strict=True))
    if len(spans) == 1:
        return spans
    gap_rows = np.flatnonzero(~good[first:last]) + first
    if gaps == "error":
        shown = ", ".join(str(line) for line in table.line[gap_rows][:6]) + (", ..." if gap_rows.size > 6 else "")
        raise DataError(
            f"{where}: input or time is missing in {gap_rows.size} rows within the record (line {shown}); a model "
            "cannot be driven through a gap: gaps='split' makes a record of each piece, gaps='drop' joins them"
        )
    text = f"left out: {gap_rows.size} rows without input or time; the record is split there"
    notes.append(Note(Code.LEFT_OUT, text))
    short = sum(stop - start < 2 for start, stop in spans)
    if short:
        notes.append(Note(Code.LEFT_OUT, f"left out: {short} pieces of a single row"))
    spans = [(start, stop) for start, stop in spans if stop - start > 1]
    if not spans:
        raise DataError(f"{where}: no two successive rows have an input")
    return spans


def _check_time(time: np.ndarray, line: np.ndarray, table: Table, notes: list[Note]) -> None:
    step = np.diff(time)
    if (step < 0).any():
        k = int(np.argmax(step < 0))
        divider = divider_of(table, line, step < 0)
        apart = (
            "give by= or put a blank line between them" if divider is None else f"by={divider!r} reads each as a record"
        )
        raise DataError(
            f"{table.source}, line {line[k + 1]}: time decreases from {time[k]:g} to {time[k + 1]:g} "
            f"({int((step < 0).sum())} time(s)). If several curves follow each other {apart}; time=False reads without time"
        )
    if not (step > 0).any():
        raise DataError(
            f"{table.source}: time is constant ({time[0]:g}); choose another column, time=False to read without time, or rate="
        )
    if CoarseClock.of(time) is not None or RoundedStamps.of(time) is not None:
        return
    if repeated := int((step == 0).sum()):
        text = f"repeated time stamps: {repeated}, first in line {line[1:][step == 0][0]}; kept"
        notes.append(Note(Code.TIME_STEPS, text))
    interval = median_interval(step)
    if interval and (wide := int((step > 1.5 * interval).sum())):
        text = f"uneven time steps: {wide} are longer than 1.5 times the median of {interval:g}"
        notes.append(Note(Code.TIME_STEPS, text))


def _constants(table: Table, choice: Choice) -> dict[str, str]:
    """Columns of one number besides those of the record, by name: a temperature, a preload, a frequency."""
    others = [k for k in range(len(table.names)) if table.named and k not in (choice.time, choice.input, choice.output)]
    values = {table.names[k]: table.columns[k] for k in others}
    return {name: f"{v[0]:.15g}" for name, v in values.items() if v[0] == v[-1] and bool((v == v[0]).all())}


def _record(table: Table, choice: Choice, data: dict[str, np.ndarray], title: str, notes: list[Note]) -> Record:
    time_unit = "s" if choice.time is None else table.units[choice.time]
    if quantity(time_unit) not in ("", "time"):  # Time(T): a letter in the place of the unit
        time_unit = ""
    if choice.time is not None:
        time_unit = time_unit or unit_of_epoch(data["time"].min(), data["time"].max())
        time_unit = time_unit or unit_of_interval(median_interval(np.diff(data["time"])), table.interval)
    part = table.parts[0 if table.part is None else int(table.part[0])] if table.parts else Part()
    if not time_unit:
        notes.append(Note(Code.FILE_FORMAT, "the file has no unit of time: seconds are assumed"))
    try:
        return Record(
            u=data["input"],
            y=data["output"],
            t=data.get("time"),
            u_unit=column_unit(table.names[choice.input], table.units[choice.input]),
            y_unit=column_unit(table.names[choice.output], table.units[choice.output]),
            t_unit=time_unit or "s",
            u_name=table.names[choice.input],
            y_name=table.names[choice.output],
            name=title,
            source=table.source,
            sha256=table.sha256,
            metadata={**_constants(table, choice), **table.metadata, **part.metadata},
            stated=part.stated,
            notes=(*notes, *changed_conditions(table, (choice.time, choice.input, choice.output), choice.output)),
        )
    except DataError as error:
        raise DataError(f"{table.source}: {error}") from error
