"""Several files as one data set: lists, patterns with wildcards, and pairs of files with input and output apart."""

from __future__ import annotations

import dataclasses
import glob
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.preparation import EVEN
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.outcome import Code, Note, Severity
from hystfit.params.units import conversion
from hystfit.reading.arrangements.branch_files import go_on, joined, turned
from hystfit.reading.arrangements.charge_throughput import cycled
from hystfit.reading.arrangements.side_by_side import stacked_files
from hystfit.reading.choice.chosen_columns import Choice, choose, find, half_of_pair
from hystfit.reading.files.archive import members_of
from hystfit.reading.files.file_bytes import exists
from hystfit.reading.limits import FEW, MAJORITY
from hystfit.reading.table.raw_table import Table

PAIR = "+"


def files_of(path: str | Path | Sequence[str | Path]) -> list[str | Path]:
    """The files (or pairs "u.csv+y.csv") that a path, a pattern such as "loops/*.csv", a zip archive, or a list of them stands for.

    Files that match a pattern are in the order of their names, with numbers by value.
    """
    if not isinstance(path, str | Path):
        files = [file for item in path for file in files_of(item)]
        names = [str(file) for file in files]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice or not files:
            raise DataError(f"{twice[0]!r} is given twice" if twice else "no files are given")
        return files
    if not glob.has_magic(str(path)) or exists(path):
        inside = members_of(Path(path)) if exists(path) else []
        members: list[str | Path] = [f"{path}/{name}" for name in sorted(inside, key=_by_number)]
        return [path] if len(inside) < 2 else members
    try:
        found = [file for file in glob.glob(str(path), recursive=True) if Path(file).is_file()]
    except (OSError, ValueError, RecursionError, re.error):  # names that the system does not take
        found = []
    if not found:
        raise DataError(f"no file matches {str(path)[:200]!r}")
    return [*sorted(found, key=_by_number)]


def _by_number(name: str) -> list[tuple[bool, int | str]]:
    """Key by which names are in order, with numbers by value."""
    return [(not part.isdigit(), int(part) if part.isdigit() else part) for part in re.split(r"(\d+)", name)]


def pair_of(path: str | Path) -> tuple[str, str] | None:
    """The file of the input and that of the output, from "u.csv+y.csv"; None for a single file."""
    if PAIR not in str(path) or exists(path) or not exists(str(path).split(PAIR)[0]):
        return None
    parts = str(path).split(PAIR)
    if len(parts) != 2:
        raise DataError(f"{str(path)!r}: a pair is the file of the input and that of the output, u.csv+y.csv")
    return parts[0], parts[1]


def combined(parts: Sequence[tuple[str, Record | Dataset]]) -> Record | Dataset:
    """One record or data set from those of several files; where names of curves occur twice, the name of the file precedes them."""
    halves = [record for _, data in parts for record in Dataset.of(data)]
    cycle = cycled(halves)
    if len(cycle) < len(halves):
        return cycle[0]
    if len(halves) == len(parts) > 1 and go_on(branches := turned(halves)):
        return joined(branches, counted=False)
    if len(parts) == 1:
        return parts[0][1] if cycle == halves else cycle[0]
    parts = list(zip([path for path, _ in parts], cycle, strict=True)) if len(halves) == len(parts) else parts
    if len(parts) == len(cycle) == 2 and _share_a_clock(*cycle):
        one, other = (str(path) for path, _ in parts)
        text = (
            f"the files have the same first column, which rises in even steps: if it is a time, {one}{PAIR}{other} is one record, "
            "with the input in the first file and the output in the second"
        )
        parts = [(path, record.noted(Code.COLUMN_CHOICE, text, Severity.WARNING)) for path, record in parts]  # type: ignore[attr-defined]
    labeled = [(path, record) for path, data in parts for record in Dataset.of(data)]
    names = [record.name for _, record in labeled]
    stems = [Path(path).stem for path, _ in labeled]
    files = dict.fromkeys(path for path, _ in parts)
    clash = len({Path(path).stem for path in files}) < len(files)
    records = []
    for (path, record), name, stem in zip(labeled, names, stems, strict=True):
        if len(set(names)) < len(names):
            label = str(Path(path).with_suffix("")) if clash else stem
            record = record.replace(name=label if name == stem else f"{label} {name}")
        records.append(record)
    shown = [Path(path).stem for path in files]
    return Dataset(
        tuple(records), name=", ".join(shown) if len(shown) < 4 else f"{shown[0]} and {len(shown) - 1} more files"
    )


def check_single(path: str, data: Record | Dataset) -> None:
    """Refuse the only file where its two columns, without names, are a time and one signal, which goes up and down by turns.

    Raises:
        DataError: the file has no other signal.
    """
    if not (isinstance(data, Record) and data.u_name == "column 0" and _is_clock(data)):
        return
    ways = np.sign(np.diff(data.y))
    if FEW < int((np.diff(ways[ways != 0]) != 0).sum()) < MAJORITY * len(data):
        raise DataError(
            f"{path}: a loop needs an input and an output, and the first of its two columns rises in even steps as a time does; "
            f"{half_of_pair(path)}. If it is the input, --input 0 --output 1 reads it (input=, output=)"
        )


def _is_clock(record: Record) -> bool:
    """Whether the input of a record without a time, and without a unit, rises in even steps."""
    steps = np.diff(record.u)
    even = steps.size > 1 and steps.min() > 0 and bool(np.ptp(steps) <= EVEN * np.median(steps))
    return even and record.t is None and not record.u_unit


def _share_a_clock(one: Record, other: Record) -> bool:
    """Whether two records without a time have the same input, which rises in even steps."""
    return _is_clock(one) and other.t is None and np.array_equal(one.u, other.u)


def pair_table(
    paths: tuple[str, str], open_one: Callable[[str], Table], columns: Mapping[str, Any]
) -> tuple[Table, dict[str, Any]]:
    """The columns of two files side by side, and which of them are time, input and output.

    Args:
        columns: names or numbers of time, input and output, each in its own file (a number for time in the first); None guesses.
    """
    tables = tuple(open_one(path) for path in paths)
    first, second = tables
    if first.rows != second.rows:
        raise DataError(
            f"{paths[0]!r} has {first.rows} rows of numbers and {paths[1]!r} has {second.rows}: the input and the output of a "
            "record need the same number of samples"
        )
    clock = columns.get("time")
    clocks = [clock if not isinstance(clock, str) or _has(table, clock) else None for table in tables]
    if str(clock).isdigit():
        clocks[1] = None  # a number is a position in the first file
    if isinstance(clock, str) and clock.lower() != "none" and clocks == [None, None]:
        find(first, clock, "time")
    both = _side_by_side(tables, paths)
    taken = Note(Code.PREPARED, f"input from {paths[0]}, output from {paths[1]}")
    chosen = columns.get("input") is not None or columns.get("output") is not None or clock not in (None, False)
    if not chosen and (loops := stacked_files(both, len(first.names))) is not None:
        return dataclasses.replace(loops, notes=(*loops.notes, taken)), {"time": False, "input": 0, "output": 1}
    drive = one_sided(first, "output", time=clocks[0], input=columns.get("input"))
    sensor = one_sided(second, "input", time=clocks[1], output=columns.get("output"))
    if not chosen:
        _check_halves(paths, tables, drive.input, sensor.output)
    time, shift = drive.time, len(first.names)
    if time is None and sensor.time is not None:
        time = shift + sensor.time
    elif time is not None and sensor.time is not None:
        _check_clocks(paths, tables, (time, sensor.time))
    both = dataclasses.replace(both, notes=tuple(dict.fromkeys([*both.notes, *drive.notes, *sensor.notes, taken])))
    return both, {"time": False if time is None else time, "input": drive.input, "output": shift + sensor.output}


def _check_halves(paths: tuple[str, str], tables: tuple[Table, Table], drive: int, sensor: int) -> None:
    """Refuse two files that each have both columns, as branches of a loop do: the output of one belongs to no input of the other."""
    names = tables[0].names[drive], tables[1].names[sensor]
    whole = all(table.named and {*names} <= {*table.names} for table in tables) and names[0] != names[1]
    if whole and not np.array_equal(tables[0].columns[drive], tables[1].columns[tables[1].names.index(names[0])]):
        raise DataError(
            f"{paths[0]!r} and {paths[1]!r} both have {names[0]!r} and {names[1]!r}, with other values of {names[0]!r}: each is a curve of "
            f"its own; hystfit check {shlex.join(paths)} reads both (read([...])), and --input and --output (input=, output=) name columns "
            "that belong together"
        )


def _side_by_side(tables: tuple[Table, Table], paths: tuple[str, str]) -> Table:
    """The columns of two tables of equally many rows as those of one."""
    first, second = tables
    shift = len(first.names)
    return dataclasses.replace(
        first,
        names=(*first.names, *second.names),
        units=(*first.units, *second.units),
        columns=(*first.columns, *second.columns),
        labels=first.labels | {shift + k: label for k, label in second.labels.items()},
        stamps=first.stamps | {shift + k for k in second.stamps},
        named=first.named and second.named,
        source=PAIR.join(paths),
        sha256=PAIR.join(str(table.sha256) for table in tables),
        notes=tuple(dict.fromkeys([*first.notes, *second.notes])),
    )


def _has(table: Table, name: str) -> bool:
    if name.lower() == "none":
        return True
    try:
        find(table, name, "time")
    except DataError:
        return False
    return True


def one_sided(table: Table, missing: str, **columns: Any) -> Choice:
    """The columns of a table that lacks the input or the output; the position of the missing one is past the end.

    Args:
        **columns: names or numbers of the others, None guesses.
    """
    position = len(table.names)
    return choose(table.beside(f"no {missing}", np.arange(float(table.rows))), **{**columns, missing: position})


def _check_clocks(paths: Sequence[str], tables: Sequence[Table], clocks: Sequence[int]) -> None:
    """Refuse two clocks that differ by more than half a sampling interval."""
    times = []
    for table, clock in zip(tables, clocks, strict=True):
        seconds = table.columns[clock] * (conversion(table.units[clock] or "s", "s") or 1.0)
        times.append(seconds - seconds[0])
    apart = float(np.nanmax(np.abs(times[0] - times[1])))
    if apart > 0.5 * float(np.nanmedian(np.diff(times[0]))):
        raise DataError(
            f"the times of {paths[0]!r} and {paths[1]!r} differ by up to {apart:.4g} s: input and output were "
            "not sampled at the same times. Resample one of them, or read without time (time=False)"
        )
