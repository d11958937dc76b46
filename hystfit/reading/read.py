"""Read measured loops from files: `read` by the kind of a file, `read_csv` for text."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading.assemble import Column, assemble
from hystfit.reading.files.archive import split_member
from hystfit.reading.files.file_bytes import inner_name, load
from hystfit.reading.files.text_file import Opening
from hystfit.reading.frames import frame_table, is_frame
from hystfit.reading.registry import table_of_file
from hystfit.reading.several import check_single, combined, files_of, pair_of, pair_table
from hystfit.reading.table.raw_table import Table
from hystfit.reading.treatment import Treatment


def read(
    path: str | Path | Sequence[str | Path] | Any,
    *,
    time: Column | bool | None = None,
    input: Column | None = None,
    output: Column | None = None,
    sigma: Column | None = None,
    by: Column | None = None,
    only: str | Sequence[object] | None = None,
    where: str | Mapping[str, object] | None = None,
    gaps: str = "error",
    rate: float | None = None,
    dt: float | None = None,
    units: str | Sequence[str] | None = None,
    integrate: bool = False,
    smooth: int | None = None,
    sheet: Column | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    adjusted: bool = False,
    name: str | None = None,
    unread: dict[str, str] | None = None,
) -> Record | Dataset:
    """A record, or a data set where there are several curves or files, from files of any kind that hystfit reads.

    Args:
        path: text of any layout, JSON, NumPy, MATLAB, Excel, HDF5 or Parquet, recognized by the content whatever the name, also packed as
            .gz .bz2 .xz or in a .zip; or several of them: a list, or a pattern such as "loops/*.csv". "u.csv+y.csv" is one
            record with its input in the first file and its output in the second. Or a data frame (pandas, polars, a dictionary
            of columns).
        time, input, output: columns by name or number from 0; None guesses, and notes the choice;
            `time=False` reads without time.
        sigma: column with the standard deviation of the output of each sample, from which the weights follow.
        by: column whose values separate curves.
        only: which curves: values ("3,4" or [3, 4]) or positions from 0 as a slice ("1::4").
        where: rows to read, {"kind": "forc"} or "kind=forc".
        gaps: "error" refuses a missing input within a record, and a file with many rows that cannot be read; "split" makes a
            data set of the pieces, "drop" joins them.
        rate: sampling rate [Hz], for files without a usable clock.
        dt: sampling interval [s], instead of the rate.
        units: of input and output ("V,um" or a pair); values in other units of the same quantity are converted.
        integrate: replace the output by its integral over time (the charge of a current).
        smooth: smooth the input by a zero-phase filter of so many samples (odd).
        sheet: sheet of a workbook, by name or number from 0.
        delimiter, decimal, encoding: of a text file; detected where None.
        adjusted: take the columns that the instrument adjusted (for a slope, an offset) in place of the raw ones.
        name: name of the record or data set; the file's name by default.
        unread: takes the reasons why some curves cannot be read, by their names; without it, one such curve is an error.

    Raises:
        DataError: the file cannot be read as requested; the message names the remedy.
        MissingExtraError: a package for this kind of file is not installed.
    """
    layout = {"sheet": sheet, "delimiter": delimiter, "decimal": decimal, "encoding": encoding}
    columns = {"time": time, "input": input, "output": output}
    options = {"sigma": sigma, "by": by, "only": only, "where": where, "gaps": gaps, "adjusted": adjusted}
    options |= {"treatment": Treatment(rate, dt, units, integrate, smooth), "unread": unread}
    if is_frame(path):
        if file_options := [key for key, value in layout.items() if value is not None]:
            raise DataError(f"a data frame is not a file: leave out {file_options[0]}=")
        return assemble(frame_table(path), **columns, **options, name=name or "data")
    return _read_all(path, lambda file: table_of(file, **layout), columns, options, name, layout)


def table_of(
    path: str | Path,
    *,
    sheet: Column | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
) -> Table:
    """The columns of a file of any kind that hystfit reads; arguments and errors as for `read`."""
    return table_of_file(load(path), Opening(sheet, delimiter, decimal, encoding))


def read_csv(
    path: str | Path | Sequence[str | Path],
    *,
    time: Column | bool | None = None,
    input: Column | None = None,
    output: Column | None = None,
    sigma: Column | None = None,
    by: Column | None = None,
    only: str | Sequence[object] | None = None,
    where: str | Mapping[str, object] | None = None,
    gaps: str = "error",
    rate: float | None = None,
    dt: float | None = None,
    units: str | Sequence[str] | None = None,
    integrate: bool = False,
    smooth: int | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    adjusted: bool = False,
    name: str | None = None,
) -> Record | Dataset:
    """Like `read`, for text files only: other files are refused.

    Args:
        path: as for `read`.
        time, input, output, sigma, rate, dt, units, integrate, smooth, by, only, where, gaps, name: see `read`.
        delimiter, decimal, encoding: of the text; detected where None.
        adjusted: see `read`.

    Raises:
        DataError: the file cannot be read as requested; the message names the remedy.
    """
    layout = {"delimiter": delimiter, "decimal": decimal, "encoding": encoding}
    columns = {"time": time, "input": input, "output": output}
    rows = {"sigma": sigma, "by": by, "only": only, "where": where, "gaps": gaps, "adjusted": adjusted}
    treatment = Treatment(rate, dt, units, integrate, smooth)
    open_one = lambda file: table_of_file(load(file), Opening(**layout), text_only=True)
    return _read_all(path, open_one, columns, rows | {"treatment": treatment}, name, layout)


def _read_all(
    path: str | Path | Sequence[str | Path],
    open_one: Callable[[str | Path], Table],
    columns: dict[str, Any],
    options: dict[str, Any],
    name: str | None,
    layout: dict[str, Any],
) -> Record | Dataset:
    """Every file of a path, list or pattern; `columns` and `options` are those of `assemble`, `layout` those of `table_of`."""
    parts = []
    chosen_so = {key: value for key, value in options.items() if key != "unread"}
    reading = as_texts({**layout, **columns, **chosen_so, **vars(options["treatment"])})
    files, unread = files_of(path), []
    for file in files:
        pair = pair_of(file)
        label = inner_name(file if pair is None else pair[0]).stem if name is None or len(files) > 1 else name
        try:
            table, chosen = (open_one(file), columns) if pair is None else pair_table(pair, open_one, columns)
            parts.append((str(file if pair is None else pair[0]), assemble(table, **chosen, **options, name=label)))
        except DataError as error:
            if not split_member(Path(file))[1]:  # an archive may hold other files too
                raise
            unread.append(error)
    if not parts:
        raise unread[0]
    if len(parts) == 1 and not any(columns.values()):
        check_single(*parts[0])
    if unread:
        words = f"left out: {len(unread)} files of the archive that hold no loop, the first because {unread[0]}"
        parts = [(file, _noted(data, warn(Code.LEFT_OUT, words))) for file, data in parts]
    read = lambda record: record.replace(reading=reading)
    data = combined(parts)
    data = data.map(read) if isinstance(data, Dataset) else read(data)
    return data if name is None else dataclasses.replace(data, name=name)


def _noted(data: Record | Dataset, note: Note) -> Record | Dataset:
    """The data with a note on every record."""
    told = lambda record: record.replace(notes=(*record.notes, note))
    return data.map(told) if isinstance(data, Dataset) else told(data)


def as_texts(options: Mapping[str, Any]) -> dict[str, str]:
    """Options for reading that are not the defaults, by name, as they are written at the shell: "V,um", "kind=forc", "true", "none".

    Args:
        options: of `read`, and others, which are left out.
    """
    changed = {name: options[name] for name, default in _defaults().items() if options.get(name) not in (None, default)}
    return {name: _as_text(value) for name, value in changed.items()}


@functools.cache
def _defaults() -> dict[str, Any]:
    """The defaults of the options for reading, by name."""
    return {name: parameter.default for name, parameter in inspect.signature(read).parameters.items() if name != "name"}


def _as_text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "none"  # the only option that may be False is time
    if isinstance(value, Mapping):
        return ",".join(f"{key}={_as_text(item)}" for key, item in value.items())
    return value if isinstance(value, str) else ",".join(map(str, value)) if isinstance(value, Sequence) else str(value)
