"""Files that are not text: numpy, MATLAB, Excel, HDF5 and Parquet; the last three need an extra."""

from __future__ import annotations

import dataclasses
import datetime
import io
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.errors import DataError, MissingExtraError, optional
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading import cells
from hystfit.reading.array_files import KINDS, check_members
from hystfit.reading.file_bytes import FileBytes, inner_name, load
from hystfit.reading.header import split_unit
from hystfit.reading.layout import Text, layout_of
from hystfit.reading.number_block import careful_block
from hystfit.reading.raw_table import Table, plain_table
from hystfit.reading.text import table_of_block

WORKBOOKS = frozenset({".xlsx", ".xlsm"})
_MOST_CELLS = 4_000_000
_MOST_COLUMNS = 5000
_SAMPLE = 2000  # rows of a sheet that show its layout
_NAMED = 6  # other sheets named in a note


def read_binary(path: str | Path, *, sheet: str | int | None = None) -> Table:
    """All columns of a .npz, .npy, .mat, .xlsx, .h5 or .parquet file."""
    suffix = inner_name(path).suffix.lower()
    if suffix not in KINDS and suffix not in WORKBOOKS:
        known = ".csv .dat .txt .tsv " + " ".join(sorted({*KINDS, *WORKBOOKS}))
        if Path(path).is_dir():
            load(path)
        raise DataError(
            f"{path}: files of kind {suffix!r} are not supported; hystfit reads {known}. If it is text use "
            "read_csv, else export it as CSV"
        )
    file = load(path)
    if suffix in WORKBOOKS:
        return _workbook(file, str(path), sheet)
    if sheet is not None:
        raise DataError(f"{path} has no sheets; leave out sheet=")
    try:
        arrays = KINDS[suffix](file.raw)
    except MissingExtraError:
        raise
    except DataError as error:
        raise DataError(f"{path}: {error}") from error
    except Exception as error:  # each library raises its own kinds on damaged files
        raise DataError(f"{path} cannot be read as {suffix}: {error}; it is damaged or of another kind") from error
    return _from_arrays(arrays, str(path), file)


def _from_arrays(arrays: Mapping[str, np.ndarray], source: str, file: FileBytes) -> Table:
    """Columns of equal length; a matrix gives one column for each of its shorter side, called name[0], name[1], ..."""
    columns: dict[str, np.ndarray] = {}
    odd, stamps = [], set()
    for name, array in arrays.items():
        array = np.squeeze(array)
        if array.dtype.kind in "mM" and array.ndim == 1 and array.size > 1:
            array = _seconds(array)
            stamps.add(name or "column 0")
        if array.dtype.kind not in "fiubUS" or array.ndim not in (1, 2) or array.size < 2:
            odd.append(name)
        elif array.ndim == 1:
            columns[name or "column 0"] = array
        else:
            tall = array if array.shape[0] >= array.shape[1] else array.T
            columns.update({f"{name}[{k}]" if name else f"column {k}": tall[:, k] for k in range(tall.shape[1])})
    if not columns:
        raise DataError(
            f"{source} holds no columns of numbers (found {', '.join(map(repr, odd)) or 'nothing'}); save arrays in it"
        )
    sizes: dict[int, int] = {}
    for array in columns.values():
        sizes[array.size] = sizes.get(array.size, 0) + (array.dtype.kind in "fiub")
    pairs = [size for size, count in sizes.items() if count > 1]
    rows = max(pairs or sizes, key=lambda size: size)
    names = [name for name, array in columns.items() if array.size == rows]
    if len(names) > _MOST_COLUMNS:
        raise DataError(
            f"{source}: {len(names)} columns of {rows} rows; {_MOST_COLUMNS} columns are the most: save fewer"
        )
    notes = [*file.notes, Note(Code.FILE_FORMAT, f"{len(names)} columns of {rows} rows")]
    clocks = [name for name in names if name in stamps]
    notes += [Note(Code.FILE_FORMAT, f"{name!r}: dates converted to seconds from the first one") for name in clocks]
    if rest := [name for name in columns if name not in names]:
        shown = ", ".join(rest[:8])
        notes.append(Note(Code.LEFT_OUT, f"left out: {len(rest)} columns of another length than {rows}: {shown}"))
    if odd:
        shown = ", ".join(odd[:8])
        notes.append(Note(Code.LEFT_OUT, f"left out: {len(odd)} variables that are not columns: {shown}"))
    units = ["s" if name in stamps else split_unit(name, names)[1] for name in names]
    table = plain_table(names, [columns[name] for name in names], source, file.sha256, tuple(notes), units)
    positions = frozenset(k for k, name in enumerate(names) if name in stamps)
    return dataclasses.replace(table, named="" not in arrays, stamps=positions)


def _seconds(stamps: np.ndarray) -> np.ndarray:
    """Dates or durations of numpy as seconds from the first one that is there, shape (rows,), NaN where missing."""
    there = stamps[~np.isnat(stamps)]
    passed = stamps - (there[0] if there.size else stamps[0])
    unit = np.timedelta64(1, np.datetime_data(passed.dtype)[0])
    if np.datetime_data(passed.dtype)[0] in ("Y", "M", "generic"):
        return np.full(stamps.size, np.nan)
    factor = np.datetime_data(passed.dtype)[1] * (unit / np.timedelta64(1, "s"))
    return np.where(np.isnat(passed), np.nan, passed.astype(np.int64) * factor)


def _workbook(file: FileBytes, source: str, sheet: str | int | None) -> Table:
    openpyxl = optional("openpyxl", "files", "reading Excel files")
    try:
        with zipfile.ZipFile(io.BytesIO(file.raw)) as archive:
            check_members(archive, file.raw)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on styles and extensions of the sheets
            book = openpyxl.load_workbook(io.BytesIO(file.raw), read_only=True, data_only=True)
        pages = {page.title: page for page in book.worksheets}
    except DataError as error:
        raise DataError(f"{source}: {error}") from error
    except Exception as error:  # openpyxl raises zipfile, KeyError and its own errors on damaged files
        raise _unreadable(source, error) from error
    titles = list(pages)
    if isinstance(sheet, str) and sheet not in pages and sheet.isdigit():
        sheet = int(sheet)
    if isinstance(sheet, int):
        if not 0 <= sheet < len(titles):
            raise DataError(
                f"{source}: there is no sheet {sheet}; there are {len(titles)} (from 0): {', '.join(titles)}"
            )
        sheet = titles[sheet]
    if sheet is not None and sheet not in pages:
        raise DataError(f"{source}: there is no sheet {sheet!r}; there are {', '.join(titles)}")
    for title in titles if sheet is None else [sheet]:
        rows = _cells_of(pages[title], source)
        layout = layout_of(rows[:_SAMPLE], "\t", ".")
        if layout.rows > 1 and layout.score > 0:
            notes = [*file.notes, _sheet_note(title, pages, source, chosen=sheet is not None)]
            text = Text(["\t".join(row) for row in rows], layout, source, settled=True)
            return table_of_block(text, careful_block(text, rows), file.sha256, notes)
    searched = ", ".join(map(repr, titles if sheet is None else [sheet]))
    raise DataError(f"{source}: no rows of numbers in {searched}; name another sheet=")


def _sheet_note(title: str, pages: dict[str, Any], source: str, *, chosen: bool) -> Note:
    """The sheet that is read; unless the user chose it, a warning where others after it hold rows of numbers too."""
    titles = list(pages)
    others = []
    for number, other in enumerate(titles):
        if not chosen and number > titles.index(title):
            layout = layout_of(_cells_of(pages[other], source, _SAMPLE), "\t", ".")
            others += [number] if layout.rows > 1 and layout.score > 0 else []
    listed = ", ".join(map(repr, titles))
    if not others:
        return Note(Code.FILE_FORMAT, f"sheet {title!r} of {listed}")
    named = ", ".join(f"{titles[number]!r} (sheet='{number}')" for number in others[:_NAMED])
    more = f" and {len(others) - _NAMED} more" if len(others) > _NAMED else ""
    text = f"sheet {title!r} of {listed} is read; other sheets with numbers: {named}{more}"
    return warn(Code.FILE_FORMAT, text)


def _unreadable(source: str, error: Exception) -> DataError:
    return DataError(f"{source} cannot be read as an Excel file: {error}; save it again as .xlsx or as CSV")


def _cells_of(page: Any, source: str, most: int | None = None) -> list[list[str]]:
    """Cells of a sheet, row by row.

    Args:
        most: number of rows; None for all.
    """
    rows: list[list[str]] = []
    count = 0
    try:
        for row in page.iter_rows(values_only=True, max_row=most):
            count += len(row) + 1
            if count > _MOST_CELLS:
                raise DataError(
                    f"{source}, sheet {page.title!r} has more than {_MOST_CELLS} cells, in use or not; save it as CSV"
                )
            rows.append([_cell(value) for value in row])
    except DataError:
        raise
    except Exception as error:  # as above
        raise _unreadable(source, error) from error
    return rows


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat(" ") if isinstance(value, datetime.datetime) else value.isoformat()
    return cells.clean(str(value).replace("\t", " ").replace("\n", " "))
