"""Read a measured loop from a file: `read` by the file's kind, `read_csv` for text; records from the rows of a table."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.data.record import Dataset, Record, median_interval
from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.reading.columns import Choice, choose, find
from hystfit.reading.header import split_unit
from hystfit.reading.raw_table import Table
from hystfit.reading.text import read_table

TEXT_SUFFIXES = frozenset({"", ".csv", ".dat", ".txt", ".tsv", ".asc", ".prn", ".lvm", ".log", ".tab", ".frc", ".data"})
Column = str | int


def read(
    path: str | Path,
    *,
    time: Column | bool | None = None,
    input: Column | None = None,
    output: Column | None = None,
    by: Column | None = None,
    only: str | Sequence[object] | None = None,
    where: str | Mapping[str, object] | None = None,
    gaps: str = "error",
    sheet: Column | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    name: str | None = None,
) -> Record | Dataset:
    """A record, or a data set where the file holds several curves, from a file of any kind that hystfit reads.

    Args:
        path: .csv .dat .txt .tsv and other text, .npz .npy .mat .xlsx .h5 .hdf5.
        time, input, output: columns by name or number from 0; None guesses, and notes the choice;
            `time=False` reads without time.
        by: column whose values separate curves.
        only: which curves: values ("3,4" or [3, 4]) or positions from 0 as a slice ("1::4").
        where: rows to read, {"kind": "forc"} or "kind=forc".
        gaps: "error" refuses a missing input within a record, "split" makes a data set of the pieces.
        sheet: sheet of a workbook, by name or number from 0.
        delimiter, decimal, encoding: of a text file; detected where None.
        name: name of the record or data set; the file's name by default.

    Raises:
        DataError: the file cannot be read as requested; the message names the remedy.
        MissingExtraError: a package for this kind of file is not installed.
    """
    table = table_of(path, sheet=sheet, delimiter=delimiter, decimal=decimal, encoding=encoding)
    return assemble(table, time=time, input=input, output=output, by=by, only=only, where=where, gaps=gaps, name=name)


def table_of(
    path: str | Path,
    *,
    sheet: Column | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
) -> Table:
    """The columns of a file of any kind that hystfit reads; arguments and errors as for `read`."""
    suffix = Path(path).suffix.lower()
    if suffix in TEXT_SUFFIXES or re.fullmatch(r"\.\d+", suffix):
        if sheet is not None:
            raise DataError(f"{path} is text and has no sheets; leave out sheet=")
        return read_table(path, delimiter=delimiter, decimal=decimal, encoding=encoding)
    from hystfit.reading.formats import read_binary

    return read_binary(path, sheet=sheet)


def read_csv(
    path: str | Path,
    *,
    time: Column | bool | None = None,
    input: Column | None = None,
    output: Column | None = None,
    by: Column | None = None,
    only: str | Sequence[object] | None = None,
    where: str | Mapping[str, object] | None = None,
    gaps: str = "error",
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    name: str | None = None,
) -> Record | Dataset:
    """Like `read`, for a text file whatever its suffix.

    Args:
        path: of the file.
        time, input, output, by, only, where, gaps, name: see `read`.
        delimiter, decimal, encoding: of the text; detected where None.

    Raises:
        DataError: the file cannot be read as requested; the message names the remedy.
    """
    table = read_table(path, delimiter=delimiter, decimal=decimal, encoding=encoding)
    return assemble(table, time=time, input=input, output=output, by=by, only=only, where=where, gaps=gaps, name=name)


def assemble(
    table: Table,
    *,
    time: Column | bool | None = None,
    input: Column | None = None,
    output: Column | None = None,
    by: Column | None = None,
    only: str | Sequence[object] | None = None,
    where: str | Mapping[str, object] | None = None,
    gaps: str = "error",
    name: str | None = None,
) -> Record | Dataset:
    """Record or data set from a table; arguments as for `read`."""
    if gaps not in ("error", "split"):
        raise DataError(f"gaps must be 'error' or 'split', got {gaps!r}")
    stem = name or Path(table.source).stem or "record"
    notes = list(table.notes)
    table, taken = _filter(table, where, notes)
    divider = None if by is None else find(table, by, "by")
    choice = choose(table, time, input, output, taken if divider is None else [*taken, divider])
    notes += choice.notes
    groups, several = _groups(table, choice, divider, notes)
    if only is not None:
        if not several:
            raise DataError(
                f"{table.source} holds one curve, so only={only!r} cannot choose among several; separate curves with by="
            )
        groups = select_curves(groups, only, table.source)
    records: list[Record] = []
    for label, rows in groups:
        part = table.take(rows)
        title = label if several else stem
        records += _records_of(part, choice, title, [*notes, *_before(table, choice, rows)], gaps)
    if not several and len(records) == 1:
        return records[0]
    return Dataset(tuple(records), name=stem)


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
        labels = _labels(table, position)
        hit = labels == _text(value)
        if not hit.any():
            raise DataError(f"{table.source}: no row has {key} = {value!r}; its values are {_shown(labels)}")
        notes.append(Note(Code.LEFT_OUT, f"left out: {int((~hit).sum())} rows where {key} is not {value}"))
        table = table.take(hit)
        positions.append(position)
    return table, positions


def _text(value: object) -> str:
    try:
        return f"{float(value):.12g}"  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return str(value).strip()


def _labels(table: Table, position: int) -> np.ndarray:
    """The values of a column as text, "" where missing, shape (rows,)."""
    if position in table.labels:
        return np.array([_text(value) for value in table.labels[position]])
    values, back = np.unique(table.columns[position], return_inverse=True)
    return np.array(["" if np.isnan(value) else f"{value:.12g}" for value in values])[back]


def _shown(values: Sequence[str] | np.ndarray) -> str:
    distinct = list(dict.fromkeys(str(value) for value in values))
    return ", ".join(distinct[:12]) + (f", ... ({len(distinct)} in all)" if len(distinct) > 12 else "")


def _groups(
    table: Table, choice: Choice, divider: int | None, notes: list[Note]
) -> tuple[list[tuple[str, np.ndarray]], bool]:
    """Label and rows of every curve, and whether the file holds several."""
    if divider is not None:
        labels = _labels(table, divider)
        blank = int((labels == "").sum())
        if blank:
            notes.append(Note(Code.LEFT_OUT, f"left out: {blank} rows without a value of {table.names[divider]!r}"))
        order = [value for value in dict.fromkeys(labels.tolist()) if value]
        if len(order) > 1000 and len(order) > table.rows / 2:
            raise DataError(
                f"{table.source}: by={table.names[divider]!r} has {len(order)} values in {table.rows} rows; it does not separate curves"
            )
        title = split_unit(table.names[divider])[0]
        groups = [(f"{title}={value}", np.flatnonzero(labels == value)) for value in order]
        return _apart(groups, table, choice, notes), True
    block = table.curve + 0
    restart = np.flatnonzero(np.diff(table.section) > 0) + 1
    if choice.time is not None:  # a header repeated while time goes on is a page break
        clock = table.columns[choice.time]
        runs_on = [k for k in restart if clock[k] > clock[k - 1]]
        if runs_on:
            notes.append(
                Note(Code.CURVES, f"{len(runs_on)} repeated header rows do not begin a curve: time continues there")
            )
        restart = np.array([k for k in restart if k not in set(runs_on)], dtype=int)
    new = np.zeros(table.rows, dtype=bool)
    new[restart] = True
    new[1:] |= np.diff(block) > 0
    number = np.cumsum(new)
    if number[-1] == 0:
        _suggest(table, choice, notes)
        return [("", np.arange(table.rows))], False
    bounds = np.append(np.flatnonzero(np.diff(number, prepend=-1)), table.rows)
    pieces = [np.arange(a, b) for a, b in itertools.pairwise(bounds)]
    single = sum(piece.size == 1 for piece in pieces)
    pieces = [piece for piece in pieces if piece.size > 1]
    if single:
        notes.append(
            Note(Code.CURVES, f"{single} blocks of a single row (calibration points) are not part of the curves")
        )
    if len(pieces) < 2:
        if not pieces:
            raise DataError(f"{table.source}: every block between blank lines has a single row; remove the blank lines")
        return [("", pieces[0])], False
    notes.append(Note(Code.CURVES, f"{len(pieces)} curves, separated by blank lines or repeated headers"))
    return [(f"curve={k}", piece) for k, piece in enumerate(pieces)], True


def _apart(
    groups: list[tuple[str, np.ndarray]], table: Table, choice: Choice, notes: list[Note]
) -> list[tuple[str, np.ndarray]]:
    """Curves of at least two rows; the others are named in the notes."""
    short = [(label, rows) for label, rows in groups if rows.size < 2]
    for label, rows in short[:5]:
        u, y = table.columns[choice.input][rows[0]], table.columns[choice.output][rows[0]]
        notes.append(Note(Code.LEFT_OUT, f"left out: {label} has a single row ({u:g}, {y:g})"))
    if len(short) > 5:
        notes.append(Note(Code.LEFT_OUT, f"left out: {len(short) - 5} more curves of a single row"))
    kept = [(label, rows) for label, rows in groups if rows.size > 1]
    if not kept:
        raise DataError(f"{table.source}: every curve that by= makes has a single row; choose another column")
    return kept


def _suggest(table: Table, choice: Choice, notes: list[Note]) -> None:
    for position, name in enumerate(table.names):
        if position in (choice.time, choice.input, choice.output) or name.lower() not in (
            "loop",
            "curve",
            "cycle",
            "segment",
            "run",
        ):
            continue
        count = len(set(_labels(table, position).tolist()))
        if 1 < count <= table.rows / 2:
            notes.append(
                Note(
                    Code.CURVES, f"column {name!r} has {count} values: --by {name} (by={name!r}) reads each as a record"
                )
            )


def _before(table: Table, choice: Choice, rows: np.ndarray) -> list[Note]:
    """A note on the calibration point (a block of one row) right before a curve."""
    k = int(rows[0]) - 1
    single = k >= 0 and table.curve[k] != table.curve[rows[0]] and (k == 0 or table.curve[k - 1] != table.curve[k])
    if not single:
        return []
    u, y = table.columns[choice.input][k], table.columns[choice.output][k]
    text = f"calibration point before this curve (line {table.line[k]}): input {u:.9g}, output {y:.9g}"
    return [Note(Code.CURVES, text)]


def select_curves(groups: list[tuple[str, Any]], only: object, source: str) -> list[tuple[str, Any]]:
    """The (label, curve) pairs that `only` selects, by value ("3,4") or position from 0 ("1::4").

    Args:
        groups: label ("loop=3") and curve of each.
        only: the selection.
        source: path of the file, for messages.

    Raises:
        DataError: there is no such curve.
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
    parts = only.split(",") if isinstance(only, str) else only if isinstance(only, Sequence) else [only]
    wanted = list(dict.fromkeys(_text(part) for part in parts))
    unknown = [value for value in wanted if value not in values]
    if unknown or not wanted:
        raise DataError(
            f"{source}: there is no curve {', '.join(unknown) or 'in an empty only='}; there are {_shown(values)}"
        )
    return [groups[values.index(value)] for value in wanted]


def _records_of(table: Table, choice: Choice, title: str, notes: list[Note], gaps: str) -> list[Record]:
    """One record of the rows of a curve, or its pieces where the input is missing and `gaps` is "split"."""
    columns = {"input": choice.input, "output": choice.output}
    if choice.time is not None:
        columns["time"] = choice.time
    data = {role: np.array(table.columns[position]) for role, position in columns.items()}
    notes = [*notes]
    for role, values in data.items():
        if count := int(np.isinf(values).sum()):
            data[role] = np.where(np.isinf(values), np.nan, values)
            notes.append(Note(Code.MISSING_VALUES, f"infinite values of the {role} are treated as missing: {count}"))
    missing = int(np.isnan(data["output"]).sum())
    if missing:
        notes.append(Note(Code.MISSING_VALUES, f"missing outputs: {missing} samples, simulated but not fitted"))
    good = np.isfinite(data["input"])
    if "time" in data:
        good &= np.isfinite(data["time"])
    spans = _spans(good, table, title, gaps, notes)
    records = []
    for number, (start, stop) in enumerate(spans):
        part = {role: values[start:stop] for role, values in data.items()}
        piece_notes = [*notes]
        if "time" in part:
            _check_time(part["time"], table.line[start:stop], table, piece_notes)
        name = title if len(spans) == 1 else f"{title} piece={number}"
        records.append(_record(table, choice, part, name, piece_notes))
    return records


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
            "cannot be driven through a gap: gaps='split' makes a record of each piece"
        )
    notes.append(
        Note(Code.LEFT_OUT, f"left out: {gap_rows.size} rows without input or time; the record is split there")
    )
    short = sum(stop - start < 2 for start, stop in spans)
    if short:
        notes.append(Note(Code.LEFT_OUT, f"left out: {short} pieces of a single row"))
    spans = [(start, stop) for start, stop in spans if stop - start > 1]
    if not spans:
        raise DataError(f"{where}: no two rows with input follow each other")
    return spans


def _check_time(time: np.ndarray, line: np.ndarray, table: Table, notes: list[Note]) -> None:
    step = np.diff(time)
    if (step < 0).any():
        k = int(np.argmax(step < 0))
        raise DataError(
            f"{table.source}, line {line[k + 1]}: time decreases from {time[k]:g} to {time[k + 1]:g} "
            f"({int((step < 0).sum())} time(s)). If several curves follow each other give by= or put a blank line "
            "between them; time=False reads without time"
        )
    if not (step > 0).any():
        raise DataError(f"{table.source}: time is constant ({time[0]:g}); choose another column or time=False")
    if repeated := int((step == 0).sum()):
        notes.append(
            Note(Code.TIME_STEPS, f"repeated time stamps: {repeated}, first in line {line[1:][step == 0][0]}; kept")
        )
    interval = median_interval(step)
    if interval and (wide := int((step > 1.5 * interval).sum())):
        notes.append(
            Note(Code.TIME_STEPS, f"uneven time steps: {wide} are longer than 1.5 times the median of {interval:g}")
        )


def _record(table: Table, choice: Choice, data: dict[str, np.ndarray], title: str, notes: list[Note]) -> Record:
    time_unit = "s"
    if choice.time is not None:
        time_unit = table.units[choice.time]
        if not time_unit:
            time_unit = "s"
            notes.append(Note(Code.FILE_FORMAT, "the file has no unit of time: seconds are assumed"))
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
