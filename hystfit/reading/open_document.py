"""Sheets of an OpenDocument spreadsheet (.ods), as LibreOffice writes them: the cells of every row, with what is written short repeated."""

from __future__ import annotations

import dataclasses
import io
import zipfile
from collections.abc import Iterator
from xml.etree import ElementTree

from hystfit.errors import DataError
from hystfit.reading.array_files import check_members

_TABLE = "{urn:oasis:names:tc:opendocument:xmlns:table:1.0}"
_OFFICE = "{urn:oasis:names:tc:opendocument:xmlns:office:1.0}"
_TEXT = "{urn:oasis:names:tc:opendocument:xmlns:text:1.0}"
_MOST_COLUMNS, _MOST_ROWS = 5000, 1_000_000
_VALUES = ("value", "date-value", "time-value", "boolean-value")


@dataclasses.dataclass(frozen=True)
class Sheet:
    """A sheet: its title, and its rows of cells, None where a cell is empty."""

    title: str
    rows: list[list[str | None]]

    def iter_rows(self, *, values_only: bool = True, max_row: int | None = None) -> Iterator[list[str | None]]:
        """The rows, as a sheet of openpyxl gives them."""
        yield from self.rows[:max_row]


def sheets_of(raw: bytes) -> list[Sheet]:
    """The sheets in the bytes of an OpenDocument spreadsheet.

    Raises:
        DataError: it has definitions that would be expanded, or unpacks to many times its size.
    """
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        check_members(archive, raw)
        content = archive.read("content.xml")
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise DataError("it has definitions of its own, which are not read: save it again")
    tables = ElementTree.fromstring(content).iter(f"{_TABLE}table")
    return [Sheet(table.get(f"{_TABLE}name", ""), _rows(table)) for table in tables]


def _rows(table: ElementTree.Element) -> list[list[str | None]]:
    rows: list[list[str | None]] = []
    for row in table.iter(f"{_TABLE}table-row"):
        cells: list[str | None] = []
        for cell in row:
            if cell.tag in (f"{_TABLE}table-cell", f"{_TABLE}covered-table-cell"):
                cells += [_value(cell)] * _times(cell, "columns", _MOST_COLUMNS - len(cells))
        while cells and cells[-1] is None:
            cells.pop()
        rows += [cells] * (_times(row, "rows", _MOST_ROWS - len(rows)) if cells else 1)
    return rows


def _times(element: ElementTree.Element, what: str, most: int) -> int:
    return min(int(element.get(f"{_TABLE}number-{what}-repeated", "1")), max(most, 0))


def _value(cell: ElementTree.Element) -> str | None:
    """The number or date of a cell, else its text; None where it is empty."""
    stored = next((value for key in _VALUES if (value := cell.get(f"{_OFFICE}{key}")) is not None), None)
    lines = ["".join(line.itertext()) for line in cell.iter(f"{_TEXT}p")]
    return stored or " ".join(lines) or None
