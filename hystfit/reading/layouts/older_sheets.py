"""Sheets of spreadsheets other than .xlsx: the binary ones of old Excel (.xls), and OpenDocument (.ods); needs the extra "files"."""

from __future__ import annotations

import datetime
import io
import zipfile
from typing import Any

from hystfit.errors import DataError
from hystfit.reading.layouts.array_files import check_members

MOST_CELLS = 4_000_000  # of a sheet, in use or not: each takes about 60 bytes


def sheets_of(raw: bytes) -> dict[str, list[list[Any]]]:
    """The rows of the sheets in the bytes of a file by their titles, "" where a cell is empty.

    Raises:
        DataError: it unpacks to many times its size, or a sheet has too many cells.
    """
    import python_calamine as calamine

    if raw.startswith(b"PK"):
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            check_members(archive, raw)
    book = calamine.CalamineWorkbook.from_filelike(io.BytesIO(raw))
    return {name: _rows(name, book.get_sheet_by_name(name)) for name in book.sheet_names}


def _rows(name: str, sheet: Any) -> list[list[Any]]:
    if sheet.total_height * sheet.total_width > MOST_CELLS:
        raise DataError(f"sheet {name!r} has more than {MOST_CELLS} cells, in use or not; save it as CSV")
    return [[_cell(value) for value in row] for row in sheet.to_python(skip_empty_area=False)]


def _cell(value: Any) -> Any:
    """Midnight as a time of its day, which is a date in the file."""
    if isinstance(value, datetime.date) and not isinstance(value, datetime.datetime):
        return datetime.datetime(value.year, value.month, value.day)
    return value
