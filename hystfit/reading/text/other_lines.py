"""The lines of a text that are not rows of numbers: the header, and those that are left out and counted."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Sequence

import numpy as np

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.reading.limits import ABOVE, BESIDE, FEW
from hystfit.reading.names.coded_names import with_meanings
from hystfit.reading.names.column_names import is_channel
from hystfit.reading.names.names_with_units import is_unit, split_unit
from hystfit.reading.text import cells
from hystfit.reading.text.dialect import Dialect, Text
from hystfit.reading.text.header import read_header
from hystfit.reading.text.listed_names import is_listed, listed_names, titled_names
from hystfit.reading.text.number_block import Block, is_comment, is_mark
from hystfit.reading.text.stated_units import stated_units

_TOUCHING = re.compile(r"(?=.*\.\d+\.\d)[\s\d.eE+-]+")  # numbers of which two touch each other
_WORDED = re.compile(r"\W*[^\W\d_]{2,}")
_NUMBERS = re.compile(r"[+-]?\d+(?:[.,]\d+)?(?:e[+-]?\d+)?(?:(?:meg|[a-zµ])\b)?", re.IGNORECASE)  # 0.4, 400m, 1e-3
_SETTINGS = {"source": (0, 1), "horizontal units": (1, 0), "vertical units": (1, 1)}  # name or unit of which column
_WORDS = {
    "header": "repeated header",
    "cells": "row with another number of cells than {width}",
    "text": "line with text where numbers are expected",
    "comment": "comment line",
    "unmeasured": "row of missing values",
}


@dataclasses.dataclass(frozen=True)
class LeftOut:
    """Lines that are not in the columns.

    Attributes:
        count: by reason; notes: the same for people.
        section: number of repeated headers before each row, shape (rows,).
        unread: rows of numbers that could not be read.
    """

    count: dict[str, int]
    notes: list[Note]
    section: np.ndarray
    unread: int


@dataclasses.dataclass(frozen=True)
class Header:
    """Names and units of the columns, "" where there is none, in how many lines they stand, and whether other lines follow them.

    `over` has the cells of the line above the names, or of comments below the units, where these name groups of columns.
    """

    names: list[str]
    units: list[str]
    used: int
    apart: bool = False
    over: tuple[str, ...] = ()


def header_of(text: Text, block: Block, extra: Sequence[int] = ()) -> Header:
    """Names and units from the lines above the first row of numbers.

    Args:
        extra: positions of columns that may have no name of their own, such as the time of day beside a date.
    """
    dialect, first = text.dialect, int(block.index[0])
    while first and _is_unmeasured(block.rows[first - 1]):  # the first samples, of which nothing was measured
        first -= 1
    low = max(0, first - 12)
    empty = [k for k, kind in enumerate(dialect.kinds) if kind == cells.MISSING]
    at_end = [k for k in empty if k >= len(dialect.kinds.rstrip(cells.MISSING))]
    width = dialect.width if at_end else None  # of rows that end in an empty cell, over and beyond which settings stand
    cut = {k - low: _without_settings(block.rows[k][:width], dialect, at_end) for k in range(low, first)}
    names, units, used = read_header(text.lines[low:first], dialect.width, dialect.delimiter, dialect.decimal, cut)
    for nameless in (at_end, extra, [*extra, *at_end], empty):
        if used or not nameless:
            continue
        fewer = dialect.width - len(nameless)
        names, units, used = read_header(text.lines[low:first], fewer, dialect.delimiter, dialect.decimal, cut)
        for position in nameless:
            names.insert(position, "")
            units.insert(position, "")
    listed = [] if used and not is_listed(text.lines[first - 1]) else listed_names(text.lines[:first], dialect.width)
    used = 0 if listed else used
    if used and all(map(is_channel, names[1:])):  # of an oscilloscope, which may have labels
        labels, _ = titled_names(text.lines[: first - used], dialect.width, dialect.delimiter)
        names = [names[0], *labels[1:]] if labels else names
    titled, of_titled = (
        ([], []) if used or listed else titled_names(text.lines[:first], dialect.width, dialect.delimiter)
    )
    place = 0 if used or listed or titled else _apart(text, block)
    if not first:
        names, units = _beside(block.rows, dialect.kinds)
    elif titled:
        names, units = titled, of_titled
    elif listed:
        names, units = listed, [split_unit(name, listed)[1] for name in listed]
    elif place:
        names, units, used = read_header(text.lines[low:place], dialect.width, dialect.delimiter, dialect.decimal, cut)
    if not used and not listed and not titled and first and text.lines[first - 1].strip():
        names, used = _uneven(text, block, place or first)
        units = [split_unit(name, names)[1] for name in names]
        if not used and not place:
            names, units, used = _labeled_units(text, block)
    names, of_codes = with_meanings(names, text.lines[:first])
    units = [unit or of_code for unit, of_code in zip(units, of_codes, strict=True)]
    if not any(units[1:]):
        of_header = stated_units(text.lines[:first], names, dialect.delimiter)
        units = [unit or stated for unit, stated in zip(units, of_header, strict=True)]
    unknown = [unit for unit in units if unit and not is_unit(unit)]
    if len(unknown) >= FEW and len({*unknown}) == len(unknown):  # strain (EXX), strain (EYY), stress (SXX)
        units = ["" if unit in unknown else unit for unit in units]
    over = () if not used or place else _over(text, block, first - used - 1)
    if used > 2 and not over and not place:
        over = _over(text, block, first - 1)
    return Header(names, units, used, apart=place > 0, over=over)


def _is_unmeasured(row: Sequence[str]) -> bool:
    """Whether a row has nothing but words for missing values: NaN, NaN."""
    return len(row) > 1 and any(map(str.strip, row)) and all(cells.is_missing(cells.clean(cell)) for cell in row)


def _is_outer(row: Sequence[str], dialect: Dialect) -> bool:
    """Whether a row has something over a column that is empty: one of the tables in which the rows of numbers are nested."""
    return any(kind == cells.MISSING and cell.strip() for cell, kind in zip(row, dialect.kinds, strict=False))


def _without_settings(row: Sequence[str], dialect: Dialect, at_end: Sequence[int]) -> list[str]:
    """The cells of a row without numbers over columns that are empty: those at the end, and all of them in a row of names."""
    kinds = [cells.kind(cell, dialect.decimal) for cell in row]
    names = all(kinds[j : j + 1] == [cells.TEXT] for j, kind in enumerate(dialect.kinds) if kind == cells.NUMBER)
    empty = [j for j, kind in enumerate(dialect.kinds) if kind == cells.MISSING] if names else at_end
    return ["" if j in empty and kinds[j] == cells.NUMBER else cell for j, cell in enumerate(row)]


def _beside(rows: Sequence[Sequence[str]], kinds: str) -> tuple[list[str], list[str]]:
    """Names and units in the settings of an oscilloscope to the left of its instants and its values."""
    found: tuple[list[str], list[str]] = ([""] * len(kinds), [""] * len(kinds))
    for row in rows[:ABOVE]:
        for k, (setting, value) in enumerate(itertools.pairwise(map(cells.clean, row))):
            part, column = _SETTINGS.get(setting.lower(), (0, len(kinds)))
            numbers = [j for j in range(k, len(kinds)) if kinds[j] == cells.NUMBER]
            if column < len(numbers):
                found[part][numbers[column]] = value
    return found


def heads_of_sections(lines: Sequence[str], index: np.ndarray) -> set[str]:
    """Comments above the first row and between rows that differ in their numbers alone, as in "# loop at 50 A/m", and such lines of words.

    Args:
        lines: of the file.
        index: those that are rows.
    """
    between = [lines[k + 1] for k in index[:-1][np.diff(index) == 2]]
    above = {_NUMBERS.sub("0", line) for line in lines[: index[0]]}
    alike: dict[str, set[str]] = {}
    for line in [*lines[: index[0]], *between]:
        plain = _NUMBERS.sub("0", line)
        if is_comment(line) or (_WORDED.match(line) and plain in above):  # ZONE T="specimen 2"
            alike.setdefault(plain, set()).add(line)
    return {line for group in alike.values() if len(group) > 1 for line in group if not group.isdisjoint(between)}


def _over(text: Text, block: Block, place: int) -> tuple[str, ...]:
    """The cells of a line that names groups of columns: it has fewer words than there are columns; () for other lines."""
    width, row = text.dialect.width, [cells.clean(cell) for cell in block.rows[place]] if place >= 0 else []
    row = [*row, *[""] * (width - len(row))]
    words = [word for word, _ in itertools.groupby(filter(None, row))]
    several = 1 < len(words) == len({*words}) < width
    return tuple(row) if text.dialect.delimiter and len(row) == width and row[1:] and several else ()


def _apart(text: Text, block: Block) -> int:
    """Line after the names where a few lines that are no rows of the table stand between them and the numbers; 0 without them.

    They are words without cells ("@@Data"), rows of numbers of another width, or, where the rows of the table are set in by empty cells,
    those of the tables in which it is nested and any number of settings.
    """
    dialect, first = text.dialect, int(block.index[0])
    nested = lambda row: _is_outer(row, dialect)
    fits = lambda cell, kind: kind == cells.MISSING or cells.kind(cell, dialect.decimal) == cells.TEXT
    heads = heads_of_sections(text.lines, block.index)
    for place in range(first - 1, max(0, first - 1 - FEW), -1):  # "@@Data", maybe with the title of a section below it
        if is_mark(text.lines[place]) or text.lines[place] in heads:
            return place
        if len(block.rows[place]) >= dialect.width and not text.lines[place].rstrip().endswith(":"):
            break
    for place in range(first - 1, max(0, first - 1 - ABOVE), -1):
        between = block.rows[place]
        if place < first - FEW and not nested(between):
            break
        mostly, kinds = _mostly_numbers(between, text)
        label = is_comment(text.lines[place]) or (kinds[:1] == [cells.TEXT] and cells.NUMBER in kinds)  # "Cycle 1"
        other = len(between) != dialect.width and (len(between) < 2 or mostly)
        if not (nested(between) or label or other):
            break
        row = [cells.clean(cell) for cell in block.rows[place - 1]]
        named = dialect.width > 2 or any(split_unit(cell)[1] for cell in row)
        wide = len(row) - dialect.width  # rows that a first one with more cells follows lack the cells at its end
        if (
            dialect.delimiter is None
            or not 0 <= wide <= BESIDE * other
            or not named
            or any("=" in cell for cell in row)
        ):
            continue
        if all(map(fits, row, dialect.kinds)):
            return place
        if not nested(row):
            return 0
    return 0


def _uneven(text: Text, block: Block, place: int) -> tuple[list[str], int]:
    """Names from a header with one name fewer (row numbers and names of rows have none) or up to two more than there are columns.

    Args:
        place: line after the header.
    """
    dialect, first = text.dialect, int(block.index[0])
    width, row = dialect.width, [cells.clean(cell) for cell in block.rows[place - 1]]
    if any(cells.kind(cell, dialect.decimal) != cells.TEXT or "=" in cell for cell in row):
        return [""] * width, 0
    numbered = [block.rows[k][0].strip(' "') for k in range(first, min(first + 2, len(block.rows))) if block.rows[k]]
    if len(row) == width - 1 and (numbered in (["0", "1"], ["1", "2"]) or dialect.kinds[0] == cells.TEXT):
        return ["", *row], 1
    return [""] * width, 0


def _labeled_units(text: Text, block: Block) -> tuple[list[str], list[str], int]:
    """Names and units, and their lines, where the units are behind a word ("Units  s  V  um") or under all names but the first."""
    dialect, first = text.dialect, int(block.index[0])
    width, units = dialect.width, [cells.clean(cell) for cell in block.rows[first - 1]]
    if len(units) == width + 1 and not is_unit(units[0]):
        units = units[1:]
    elif len(units) == width - 1 > 1 and dialect.delimiter is None and 2 * sum(map(is_unit, units)) > width:
        units = ["", *(unit if is_unit(unit) else "" for unit in units)]
    if len(units) != width or not all(map(is_unit, filter(None, units))):
        return [""] * width, [""] * width, 0
    for place in range(first - 2, max(-1, first - 2 - FEW), -1):
        names = [cells.clean(cell) for cell in block.rows[place]]
        names = names[1:] if len(names) == width + 1 and all(units) else names
        if len(names) == width and all(cells.kind(name, dialect.decimal) == cells.TEXT for name in names):
            return names, units, first - place
        names, _, used = read_header([text.lines[place]], width, dialect.delimiter, dialect.decimal, {})
        if used:
            return names, [unit or split_unit(name)[1] for unit, name in zip(units, names, strict=True)], first - place
    return [""] * width, units, 1


def left_out(text: Text, block: Block, header: Header) -> LeftOut:
    """The lines that are neither the header nor rows of numbers, counted by reason."""
    groups, unread = _grouped(text, block, header.names)
    odd_above = _directly_above(text, block, header)
    groups["cells"] = odd = odd_above + groups["cells"]
    above = sum(bool(line.strip()) for line in text.lines[: block.index[0]]) - header.used - len(odd_above)
    count: dict[str, int] = {}
    notes = []
    if above > 0:
        count["metadata"] = above
        notes.append(Note(Code.FILE_FORMAT, f"metadata above the numbers: {above} line" + "s" * (above > 1)))
    good, dialect = block.index.size, text.dialect
    if len(odd) > 2 and len(odd) > 0.25 * good:
        raise DataError(
            f"{text.source}, line {odd[0] + 1}: {len(odd)} rows do not have the {dialect.width} cells that {good} "
            f"rows have ({dialect.words()}); set the delimiter or the decimal mark, or keep one table in the file"
        )
    for key, numbers in groups.items():
        if numbers:
            words = _WORDS[key].format(width=dialect.width)
            count[words] = len(numbers)
            first = f"line {numbers[0] + 1}: {text.lines[numbers[0]].strip()[:40]!r}"
            notes.append(Note(Code.LEFT_OUT, f"left out: {len(numbers)} x {words}, first in {first}"))
    return LeftOut(count, notes, np.searchsorted(np.array(groups["header"]), block.index), unread)


def _mostly_numbers(row: Sequence[str], text: Text) -> tuple[bool, list[str]]:
    """Whether more than half of the cells are numbers, and the kind of each."""
    kinds = [cells.kind(cell, text.dialect.decimal) for cell in row]
    return kinds.count(cells.NUMBER) > len(kinds) / 2, kinds


def _directly_above(text: Text, block: Block, header: Header) -> list[int]:
    """Rows of numbers of another width that end where the header, or the first row, begins: they are no metadata."""
    end = start = int(block.index[0]) - (0 if header.apart else header.used)
    while start and len(row := block.rows[start - 1]) != text.dialect.width and _mostly_numbers(row, text)[0]:
        start -= 1
    return list(range(start, end))


def _grouped(text: Text, block: Block, names: list[str]) -> tuple[dict[str, list[int]], int]:
    """Numbers of the lines left out by reason, and how many before the last row are rows of numbers."""
    ragged, index, unread = set(block.ragged), block.index, 0
    groups: dict[str, list[int]] = {key: [] for key in _WORDS}
    outside = np.ones(len(text.lines), dtype=bool)
    outside[index] = False
    touching = {k for k in np.flatnonzero(outside).tolist() if _TOUCHING.fullmatch(text.lines[k])}
    outside[: index[0]] = False
    for k in np.flatnonzero(outside).tolist():
        line = text.lines[k]
        if not line.strip(" \t,;|"):
            continue
        row = block.rows[k]
        if any(names) and len(row) == len(names) and [cells.clean(cell) for cell in row] == names:
            groups["header"].append(k)
        elif is_comment(line):
            groups["comment"].append(k)
        elif _is_unmeasured(row):
            groups["unmeasured"].append(k)
        else:
            mostly, kinds = _mostly_numbers(row, text)
            groups["cells" if k in ragged and mostly else "text"].append(k)
            begun = cells.NUMBER in (kinds[:1] if k in ragged else kinds)
            outer = _is_outer(row, text.dialect)
            unread += int((mostly or begun) and not outer and k < index[-1] and k not in touching)
    return groups, unread + len(touching)
