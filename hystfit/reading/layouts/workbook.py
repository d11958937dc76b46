"""Sheets of a workbook: the first with rows of numbers, or the one that the user names; needs the extra "files"."""

from __future__ import annotations

import dataclasses
import datetime
import io
import itertools
import warnings
import zipfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hystfit.errors import DataError, optional
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.outcome.wrapping import listed
from hystfit.reading.files.file_bytes import FileBytes
from hystfit.reading.files.text_file import Opening
from hystfit.reading.layouts.array_files import check_members
from hystfit.reading.layouts.older_sheets import MOST_CELLS, sheets_of
from hystfit.reading.layouts.transposed import turned
from hystfit.reading.limits import SAMPLE
from hystfit.reading.table.raw_table import Table, below_each_other, one_loop
from hystfit.reading.text import cells
from hystfit.reading.text.dialect import Text, dialect_of
from hystfit.reading.text.number_block import careful_block
from hystfit.reading.text.plain_text import table_of_block

_SUMMARY = 0.1  # rows of a sheet over those of the longest, below which it summarizes others


def read_workbook(file: FileBytes, opening: Opening) -> Table:
    """Excel sheets, the first with columns of numbers and those with the same ones, unless `--sheet` names one; needs the extra "files"."""
    openpyxl = optional("openpyxl", "files", "reading Excel files")

    def sheets() -> dict[str, Iterable[Sequence[Any]]]:
        with zipfile.ZipFile(io.BytesIO(file.raw)) as archive:
            check_members(archive, file.raw)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on styles and extensions of the sheets
            book = openpyxl.load_workbook(io.BytesIO(file.raw), read_only=True, data_only=True)
        return {page.title: page.iter_rows(values_only=True) for page in book.worksheets}

    return _read(file, opening, sheets, lambda: _holds_formulas(openpyxl, file.raw))


def read_older_sheets(file: FileBytes, opening: Opening) -> Table:
    """Sheets of old Excel, LibreOffice and OpenOffice, as those of .xlsx; needs the extra "files"."""
    optional("python_calamine", "files", "reading .xls and .ods files")
    return _read(file, opening, lambda: sheets_of(file.raw), lambda: False)


def _read(
    file: FileBytes,
    opening: Opening,
    sheets: Callable[[], Mapping[str, Iterable[Sequence[Any]]]],
    formulas: Callable[[], bool],
) -> Table:
    """The columns of the sheets of a workbook.

    Args:
        sheets: opens the file; the rows of its sheets by their titles.
        formulas: whether there are formulas, whose values the file may lack.
    """
    source, sheet = file.source, opening.sheet
    try:
        pages = {
            title: cells
            for name, rows in sheets().items()
            for title, cells in _side_by_side(name, _cells_of(name, rows))
        }
    except DataError as error:
        raise DataError(f"{source}: {error}") from error
    except Exception as error:  # the libraries raise zipfile, KeyError and their own errors on damaged files
        raise DataError(f"{source} cannot be read as a workbook: {error}; save it again as .xlsx or as CSV") from error
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
    wanted = titles if sheet is None else [sheet]
    there, failed = _tables(file, {title: pages[title] for title in wanted})
    if longer := [
        title for title in failed if len(pages[title]) > max((one.rows for one in there.values()), default=0)
    ]:
        raise failed[longer[0]]  # a shorter sheet is no measurement
    pairs = {title: table for title, table in there.items() if _holds_pair(table)}
    if not there:
        raise DataError(f"{source}: no rows of numbers in {', '.join(map(repr, wanted))}; name another sheet=")
    if not pairs and formulas():
        raise DataError(
            f"{source} has formulas without their values, as programs write them; open it in Excel or LibreOffice and save it there"
        )
    most = max((table.rows for table in pairs.values()), default=0)
    title = next((title for title, table in pairs.items() if table.rows >= _SUMMARY * most), next(iter(there)))
    table = there[title]
    distinct = table.named and len({*table.names}) == len(table.names)
    same = lambda other: distinct and (other.names, other.units) == (table.names, table.units)
    alike = {name: one for name, one in there.items() if name == title or same(one)}
    if len(alike) > 1:
        return _records(alike)
    return table.noted(*file.notes, _sheet_note(title, titles, pairs, chosen=sheet is not None))


def _tables(file: FileBytes, pages: Mapping[str, list[list[str]]]) -> tuple[dict[str, Table], dict[str, DataError]]:
    """The columns of the sheets with rows of numbers, and the errors of those that cannot be read, by title."""
    there: dict[str, Table] = {}
    failed: dict[str, DataError] = {}
    for title, rows in pages.items():
        try:
            if (table := _table(file, rows)) is not None:
                there[title] = table
        except DataError as error:
            failed[title] = error
    return there, failed


def _holds_pair(table: Table) -> bool:
    """Whether at least two columns of numbers change that are no times or counters."""
    numbers = [k for k in table.positions if k not in table.labels and table.quantity(k) not in ("time", "index")]
    return sum(np.unique(table.columns[k][np.isfinite(table.columns[k])]).size > 1 for k in numbers) > 1


def _holds_formulas(openpyxl: Any, raw: bytes) -> bool:
    """Whether the first rows of a sheet have formulas."""
    book = openpyxl.load_workbook(io.BytesIO(raw), read_only=True)
    cells_of = lambda page: (cell for row in page.iter_rows(values_only=True, max_row=SAMPLE) for cell in row)
    return any(isinstance(cell, str) and cell.startswith("=") for page in book.worksheets for cell in cells_of(page))


def _side_by_side(title: str, rows: list[list[str]]) -> Iterator[tuple[str, list[list[str]]]]:
    """A sheet, or the parts of a report between columns of bars, by the title of the sheet and a number."""
    width = max(map(len, rows), default=0)
    columns = [{row[k] for row in rows if k < len(row)} for k in range(width)]
    bars = [k for k, values in enumerate(columns) if "|" in values <= {"|", ""}]
    if not bars:
        yield title, rows
        return
    for number, (left, right) in enumerate(itertools.pairwise([-1, *bars, width]), 1):
        yield f"{title} {number}", [row[left + 1 : right] for row in rows]


def _table(file: FileBytes, rows: list[list[str]]) -> Table | None:
    """The columns of a sheet, or of its part left of an empty column where remarks beside it hide the names; None without numbers."""
    whole = _table_of(file, rows)
    if whole is None or whole.named:
        return whole
    width = max(map(len, rows))
    empty = (k for k in range(2, width) if not any(row[k] for row in rows if k < len(row)))
    parts = (_table_of(file, [row[:k] for row in rows]) for k in empty)
    return next((part for part in parts if part is not None and part.named), whole)


def _table_of(file: FileBytes, rows: list[list[str]]) -> Table | None:
    """The columns of a sheet or a part of it; None where it has no rows of numbers."""
    rows = [list(row) for row in turned([[cell for cell in row if cell] for row in rows if any(row)]) or rows]
    dialect = max((dialect_of(rows[:SAMPLE], "\t", mark) for mark in (".", ",")), key=lambda one: one.score)
    if dialect.rows < 2 or dialect.score <= 0:
        return None
    text = Text(["\t".join(row) for row in rows], dialect, file.source, settled=True)
    return table_of_block(text, careful_block(text, rows), file.sha256, [])


def _records(tables: Mapping[str, Table]) -> Table:
    """Sheets with the same columns as one table, of which each is a record with its title."""
    sheets = ", ".join(map(repr, tables))
    parts = [dataclasses.replace(table.whole, name=title, metadata=table.metadata) for title, table in tables.items()]
    if (loop := one_loop([*tables], [*tables.values()])) is not None:
        text = f"{len(tables)} sheets of the same columns, each a branch: {sheets} (--sheet reads one)"
        return loop.noted(Note(Code.FILE_FORMAT, text))
    text = f"{len(tables)} sheets of the same columns, each a record: {sheets} (--sheet reads one)"
    return below_each_other([*tables.values()], parts).noted(Note(Code.CURVES, text))


def _sheet_note(title: str, titles: Sequence[str], pairs: Collection[str], *, chosen: bool) -> Note:
    """The sheet that is read; unless the user chose it, a warning where others hold columns of numbers too."""
    others = [number for number, other in enumerate(titles) if not chosen and other != title and other in pairs]
    text = f"sheet {title!r} of {', '.join(map(repr, titles))}"
    if not others:
        return Note(Code.FILE_FORMAT, text)
    named = listed([f"{titles[number]!r} (sheet='{number}')" for number in others])
    text += f" is read; other sheets with numbers: {named}"
    return warn(Code.FILE_FORMAT, text)


def _cells_of(title: str, rows: Iterable[Sequence[Any]]) -> list[list[str]]:
    """Cells of a sheet, row by row."""
    found: list[list[str]] = []
    count = 0
    for row in rows:
        count += len(row) + 1
        if count > MOST_CELLS:
            raise DataError(f"sheet {title!r} has more than {MOST_CELLS} cells, in use or not; save it as CSV")
        found.append([_cell(value) for value in row])
    return found


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat(" ") if isinstance(value, datetime.datetime) else value.isoformat()
    return cells.clean(str(value).replace("\t", " ").replace("\n", " "))
