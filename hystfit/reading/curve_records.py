"""Records from the rows of one curve: codes of missing values, rows that are no samples, gaps and clocks."""

from __future__ import annotations

import numpy as np

from hystfit.data.preparation import CoarseClock, RoundedStamps
from hystfit.data.record import Record, median_interval
from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.params.units import quantity, symbol_of
from hystfit.reading.choice.chosen_columns import Choice
from hystfit.reading.choice.conditions import changed_conditions
from hystfit.reading.curves.demagnetization_curves import lacks_sign
from hystfit.reading.curves.split_curves import divider_of
from hystfit.reading.limits import FEW, ODD, OF_RECORD
from hystfit.reading.names.column_names import column_unit
from hystfit.reading.table import sentinels
from hystfit.reading.table.raw_table import Part, Table
from hystfit.reading.text.cells import unit_of_epoch
from hystfit.reading.text.stated_interval import unit_of_interval
from hystfit.reading.treatment import Treatment, weighted

_Data = dict[str, np.ndarray]  # columns by role: "input", "output", "time"


def records_of_curve(
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
    _without_codes(table, data, notes, gaps)
    table, data = _samples(table, data, notes, gaps)
    if lacks_sign(table, choice, data["input"], data["output"]):
        data["input"] = 0.0 - data["input"]
        text = "the output falls from a remanence as the field grows: a demagnetization curve, whose field is read as negative"
        notes.append(warn(Code.PREPARED, text))
    good = np.isfinite(data["input"])
    if "time" in data:
        good &= np.isfinite(data["time"])
    if gaps == "drop" and good.any() and not good.all():
        text = (
            f"left out: {int((~good).sum())} rows without input or time; the samples before and after them are joined"
        )
        notes.append(warn(Code.LEFT_OUT, text))
        table, data = _taken(table, data, good)
        good = good[good]
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


def _without_codes(table: Table, data: _Data, notes: list[Note], gaps: str) -> None:
    """Replace codes of missing values, and refuse numbers whose decimal marks were lost."""
    for role in ("input", "output"):
        data[role], coded = sentinels.without_codes(data[role], role)
        notes += coded
        if (shifted := sentinels.shifted_marks(data[role])).size >= FEW and gaps == "error":
            lines = ", ".join(map(str, table.line[shifted[:5]]))
            raise DataError(
                f"{table.source}: {shifted.size} numbers of the {role} are a tenth of those around them, or ten times these "
                f"(lines {lines}): decimal marks were lost when the file was written; export it again (gaps='drop' reads it as it is)"
            )


def _samples(table: Table, data: _Data, notes: list[Note], gaps: str) -> tuple[Table, _Data]:
    """The rows that are samples of the curve, in the order of time."""
    if (failed := sentinels.failed_inputs(data["input"], data["output"])).size:
        text = f"left out: {failed.size} rows in which the input alone reads 0, as that of a sensor that failed"
        notes.append(warn(Code.MISSING_VALUES, f"{text}; lines {', '.join(map(str, table.line[failed[:5]]))}"))
        kept = np.delete(np.arange(table.rows), failed)
        table, data = _taken(table, data, kept)
    if sentinels.ends_with_zeros(data.values()):
        notes.append(
            Note(
                Code.LEFT_OUT,
                "left out: the last row, which is 0 in all columns and far from the row before: an end mark",
            )
        )
        table, data = _taken(table, data, np.arange(table.rows - 1))
    if gaps == "error":
        _interpolate(data, notes)
        if (others := _rows_of_others(data)).any():
            notes.append(Note(Code.LEFT_OUT, f"left out: {others.sum()} rows of other columns"))
            table, data = _taken(table, data, ~others)
    missing = int(np.isnan(data["output"]).sum())
    if missing:
        notes.append(Note(Code.MISSING_VALUES, f"missing outputs: {missing} samples, simulated but not fitted"))
    if "time" in data and data["time"].size > 2 and (np.diff(data["time"]) < 0).all():
        notes.append(
            Note(Code.TIME_STEPS, "the time decreases from row to row: the rows are read from the last to the first")
        )
        table, data = _taken(table, data, np.arange(table.rows)[::-1])
    return table, data


def _interpolate(data: _Data, notes: list[Note]) -> None:
    """Put the input, which moves along a line from sample to sample, where an output with a clock of its own was sampled."""
    u, y, t = data["input"], data["output"], data.get("time", np.zeros(0))
    known, measured = np.isfinite(u), np.isfinite(y)
    together, alone = known & measured, measured & ~known
    clocked = t.size > 0 and np.isfinite(t).all() and (np.diff(t) >= 0).all()
    if not clocked or not known.any() or together.sum() >= ODD * measured.sum():
        return
    data["input"] = np.where(alone, np.interp(t, t[known], u[known], left=np.nan, right=np.nan), u)
    text = f"{alone.sum()} outputs have times of their own, at which the input is interpolated between its samples"
    notes.append(Note(Code.MISSING_VALUES, text))


def _taken(table: Table, data: _Data, rows: np.ndarray) -> tuple[Table, _Data]:
    """Some rows of both."""
    return table.take(rows), {role: values[rows] for role, values in data.items()}


def _rows_of_others(data: _Data) -> np.ndarray:
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
    others = [k for k in table.positions if table.named and k not in (choice.time, choice.input, choice.output)]
    values = {table.names[k]: table.columns[k] for k in others}
    return {name: f"{v[0]:.15g}" for name, v in values.items() if v[0] == v[-1] and bool((v == v[0]).all())}


def _record(table: Table, choice: Choice, data: _Data, title: str, notes: list[Note]) -> Record:
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
            t_unit=symbol_of(time_unit) or "s",
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
