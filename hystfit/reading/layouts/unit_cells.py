"""Tables whose cells hold their unit, "1.25 mT": the numbers in the unit of the first row, and the units as a row of the header."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

from hystfit.errors import DataError
from hystfit.params.units import conversion
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.limits import FEWEST
from hystfit.reading.names.names_with_units import is_unit
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.cells import clean
from hystfit.reading.text.dialect import split
from hystfit.reading.text.plain_text import plain_text

_CELL = re.compile(r"([+-]?(?:\d[\d.,]*|[.,]\d+)(?:[eE][+-]?\d+)?)\s?(?![eE][+-]?\d)([^\W\d_][\w/^²³·*-]*|°[CF]?|%)")
_POWERS = {"G": 9, "M": 6, "k": 3, "m": -3, "u": -6, "µ": -6, "μ": -6, "n": -9, "p": -12}
_PREFIXED = re.compile(rf"([+-]?(?:\d+[.,]?\d*|[.,]\d+))\s?([{''.join(_POWERS)}]?)")
_MARKED = re.compile(r"\d\s?[Mkuµμnp](?!\w)")  # a prefix that is no unit
_ROW = re.compile(r"[\s\"']*[+-]?[.,]?\d")
_MARKS = (";", "\t", "|", ",", None)  # between cells, the first one of which there are several
_MISSING = "nan"


def read_unit_cells(text: TextFile) -> Table | None:
    """A table with a unit in every row of some columns; None for others. A cell in another unit of the quantity is converted."""
    rows = [k for k, line in enumerate(text.head) if _ROW.match(line)]
    if len(rows) < FEWEST:
        return None
    sample = text.head[rows[-1]]
    mark = text.opening.delimiter or next(mark for mark in _MARKS if mark is None or mark in sample)
    written, text = text, _without_prefixes(text, rows, mark)
    if not _units(split(text.head[rows[-1]], mark)):
        return None if text is written else plain_text(text)
    first = next((k for k in rows if _units(split(text.head[k], mark))), 0)
    units = _units(split(text.head[first], mark))
    if sum(len(_units(split(text.head[k], mark))) == len(units) > 0 for k in rows) < max(FEWEST, len(rows) // 2):
        return None if text is written else plain_text(text)
    while first - 1 in rows and len(split(text.head[first - 1], mark)) == len(
        units
    ):  # their cells with units are empty
        first -= 1
    join = (mark or " ").join
    lines = list(text.lines)
    for k in range(first, len(lines)):
        if _ROW.match(lines[k]):
            lines[k] = join(_numbers(split(lines[k], mark), units))
    above = [clean(cell) for cell in split(lines[first - 1], mark)] if first else []
    if len(above) == len(units) and all(is_unit(cell) or not cell for cell in above):  # stated above as well
        return plain_text(text.of("\n".join(lines)))
    lines.insert(first, join(unit or "-" for unit in units))
    table = plain_text(text.of("\n".join(lines)))
    return dataclasses.replace(table, line=table.line - 1)


def _without_prefixes(text: TextFile, rows: Sequence[int], mark: str | None) -> TextFile:
    """The text with powers of ten in place of SI prefixes, in columns whose cells have nothing but such: 1.2k, 350, 3.4m."""
    if not any(_MARKED.search(text.head[k]) for k in rows):
        return text
    cells = [[clean(cell) for cell in split(text.head[k], mark)] for k in rows]
    columns = [*zip(*(row for row in cells if len(row) == len(cells[-1])), strict=True)]
    found = [[_PREFIXED.fullmatch(cell) for cell in column] for column in columns]
    prefixes = [{match[2] for match in column if match} if all(column) else set() for column in found]
    if not set().union(*prefixes) - {"", "m", "G"}:  # these are units too
        return text
    prefixed = [k for k, marks in enumerate(prefixes) if marks - {""}]
    lines = list(text.lines)
    for number in range(rows[0], len(lines)):
        row = [clean(cell) for cell in split(lines[number], mark)]
        for k in prefixed:
            if k < len(row) and (match := _PREFIXED.fullmatch(row[k])) and match[2]:
                row[k] = f"{match[1]}e{_POWERS[match[2]]}"
        lines[number] = (mark or " ").join(row)
    return text.of("\n".join(lines))


def _units(row: Sequence[str]) -> list[str]:
    """The unit of each cell of a row, "" of one without; none at all where no cell has one."""
    found = [match[2] if (match := _CELL.fullmatch(clean(cell))) else "" for cell in row]
    return found if any(found) and all(is_unit(unit) for unit in found if unit) else []


def _numbers(row: Sequence[str], units: Sequence[str]) -> list[str]:
    """The cells of a row without their units, in those of the first row; missing where a cell cannot be converted."""
    numbers = [*row]
    for k, unit in enumerate(units[: len(row)]):
        match = _CELL.fullmatch(clean(row[k])) if unit else None
        if match is None or match[2] == unit:
            numbers[k] = match[1] if match else row[k]
            continue
        try:
            factor = conversion(match[2], unit)
        except DataError:
            factor = None
        number = _MISSING if factor is None else repr(factor * float(match[1].replace(",", ".")))
        numbers[k] = number.replace(".", ",") if "," in match[1] else number
    return numbers
