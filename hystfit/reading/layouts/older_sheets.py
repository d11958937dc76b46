"""Sheets of spreadsheets other than .xlsx: the binary ones of old Excel (.xls), and OpenDocument (.ods); needs the extra "files"."""

from __future__ import annotations

import dataclasses
import datetime
import io
import zipfile
from collections.abc import Iterator, Sequence
from typing import Any

from hystfit.errors import DataError
from hystfit.reading.layouts.array_files import check_members

MOST_CELLS = 4_000_000  # of a sheet, in use or not: each takes about 60 bytes


@dataclasses.dataclass(frozen=True)
class Sheet:
    """A sheet: its title, and its rows of cells, "" where a cell is empty."""

    title: str
    rows: Sequence[Sequence[Any]]

    def iter_rows(self, *, values_only: bool = True, max_row: int | None = None) -> Iterator[Sequence[Any]]:
        """The rows, as a sheet of openpyxl gives them."""
        yield from self.rows[:max_row]


def sheets_of(raw: bytes) -> list[Sheet]:
    """The sheets in the bytes of a file.

    Raises:
        DataError: it unpacks to many times its size, or a sheet has too many cells.
    """
    import python_calamine as calamine

    if raw.startswith(b"PK"):
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            check_members(archive, raw)
    book = calamine.CalamineWorkbook.from_filelike(io.BytesIO(raw))
    return [_sheet(name, book.get_sheet_by_name(name)) for name in book.sheet_names]


def _sheet(name: str, sheet: Any) -> Sheet:
    if sheet.total_height * sheet.total_width > MOST_CELLS:
        raise DataError(f"sheet {name!r} has more than {MOST_CELLS} cells, in use or not; save it as CSV")
    return Sheet(name, [[_cell(value) for value in row] for row in sheet.to_python(skip_empty_area=False)])


def _cell(value: Any) -> Any:
    """Midnight as a time of its day, which is a date in the file."""
    if isinstance(value, datetime.date) and not isinstance(value, datetime.datetime):
        return datetime.datetime(value.year, value.month, value.day)
    return value
