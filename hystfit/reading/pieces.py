"""Records from the rows of one curve: missing values, gaps and the run of time."""

from __future__ import annotations

import numpy as np

from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.reading.columns import Choice
from hystfit.reading.raw_table import Table


def records_of(table: Table, choice: Choice, title: str, notes: list[str], gaps: str) -> list[Record]:
    """One record of the rows of a curve, or its pieces where the input is missing and `gaps` is "split"."""
    columns = {"input": choice.input, "output": choice.output}
    if choice.time is not None:
        columns["time"] = choice.time
    data = {role: np.array(table.columns[position]) for role, position in columns.items()}
    notes = [*notes]
    for role, values in data.items():
        if count := int(np.isinf(values).sum()):
            data[role] = np.where(np.isinf(values), np.nan, values)
            notes.append(f"{count} infinite values of the {role} taken as missing")
    missing = int(np.isnan(data["output"]).sum())
    if missing:
        notes.append(f"{missing} outputs are missing: simulated there, not fitted")
    good = np.isfinite(data["input"])
    if "time" in data:
        good &= np.isfinite(data["time"])
    spans = _spans(good, table, title, gaps, notes)
    records = []
    for number, (start, stop) in enumerate(spans):
        part = {role: values[start:stop] for role, values in data.items()}
        said = [*notes]
        if "time" in part:
            _check_time(part["time"], table.line[start:stop], table, said)
        records.append(_record(table, choice, part, title if len(spans) == 1 else f"{title} piece={number}", said))
    return records


def _spans(good: np.ndarray, table: Table, title: str, gaps: str, notes: list[str]) -> list[tuple[int, int]]:
    where = f"{table.source}" + (f", {title}" if title else "")
    if not good.any():
        raise DataError(f"{where}: the input has no finite value; choose another column")
    first, last = int(np.argmax(good)), good.size - int(np.argmax(good[::-1]))
    if ends := first + good.size - last:
        notes.append(f"left out: {ends} rows at the ends without input or time")
    edge = np.flatnonzero(np.diff(np.concatenate([[0], good[first:last].astype(int), [0]]))) + first
    spans = list(zip(edge[::2].tolist(), edge[1::2].tolist(), strict=True))
    if len(spans) == 1:
        return spans
    gap_rows = np.flatnonzero(~good[first:last]) + first
    if gaps == "error":
        shown = ", ".join(str(line) for line in table.line[gap_rows][:6]) + (", ..." if gap_rows.size > 6 else "")
        raise DataError(
            f"{where}: input or time is missing in {gap_rows.size} rows within the record (line {shown}); a model "
            "cannot be driven through a gap: gaps='split' makes a record of each piece"
        )
    notes.append(f"split at {len(spans) - 1} gaps; {gap_rows.size} rows without input or time left out")
    short = sum(stop - start < 2 for start, stop in spans)
    if short:
        notes.append(f"left out: {short} pieces of a single row")
    spans = [(start, stop) for start, stop in spans if stop - start > 1]
    if not spans:
        raise DataError(f"{where}: no two rows with input follow each other")
    return spans


def _check_time(time: np.ndarray, line: np.ndarray, table: Table, notes: list[str]) -> None:
    step = np.diff(time)
    if (step < 0).any():
        k = int(np.argmax(step < 0))
        raise DataError(
            f"{table.source}, line {line[k + 1]}: time runs back from {time[k]:g} to {time[k + 1]:g} "
            f"({int((step < 0).sum())} time(s)). If several curves follow each other give by= or put a blank line "
            "between them; time=False reads without time"
        )
    if not (step > 0).any():
        raise DataError(f"{table.source}: time does not move (always {time[0]:g}); choose another column or time=False")
    if repeated := int((step == 0).sum()):
        notes.append(f"{repeated} time stamps repeat the one before (line {line[1:][step == 0][0]} first); kept")
    usual = float(np.median(step[step > 0]))
    if wide := int((step > 1.5 * usual).sum()):
        notes.append(f"time steps are not even: {wide} are more than 1.5 times the usual {usual:g}")


def _record(table: Table, choice: Choice, data: dict[str, np.ndarray], title: str, notes: list[str]) -> Record:
    time_unit = "s"
    if choice.time is not None:
        time_unit = table.units[choice.time]
        if not time_unit:
            time_unit = "s"
            notes.append("the unit of time is not stated; seconds assumed")
    try:
        return Record(
            u=data["input"],
            y=data["output"],
            t=data.get("time"),
            u_unit=table.units[choice.input],
            y_unit=table.units[choice.output],
            t_unit=time_unit,
            u_name=table.names[choice.input],
            y_name=table.names[choice.output],
            name=title,
            source=table.source,
            sha256=table.sha256,
            notes=tuple(notes),
        )
    except DataError as error:
        raise DataError(f"{table.source}: {error}") from error
