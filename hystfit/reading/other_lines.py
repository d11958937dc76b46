"""The lines of a text that are not rows of numbers: the header, and those that are left out and counted."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.reading import cells
from hystfit.reading.header import read_header, split_unit
from hystfit.reading.layout import Layout

_COMMENT_MARKS = ("#", "%", "//", "!")
_WORDS = {
    "header": "repeated header",
    "cells": "row with another number of cells than {width}",
    "text": "line with text where numbers are expected",
    "comment": "comment line",
}


def is_comment(line: str) -> bool:
    """Whether a line begins with a comment mark."""
    return line.lstrip().startswith(_COMMENT_MARKS)


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


class OtherLines:
    """Accounts for every line that is not a row of numbers."""

    def __init__(
        self, rows: Sequence[list[str]], lines: Sequence[str], ragged: Sequence[int], layout: Layout, source: str
    ):
        self.rows, self.lines, self.layout, self.source = rows, lines, layout, source
        self.ragged = ragged
        self.names: list[str] = []

    def header(self, first: int, extra: Sequence[int] = ()) -> tuple[list[str], list[str], bool]:
        """Names and units, and whether there were any, from the lines above row `first`.

        Args:
            first: number of the first row of numbers.
            extra: positions of columns that may have no name of their own, such as the time of day beside a date.
        """
        low = max(0, first - 12)
        cut = {k - low: self.rows[k] for k in range(low, first)}
        layout = self.layout
        names, units, used = read_header(self.lines[low:first], layout.width, layout.delimiter, layout.decimal, cut)
        empty = range(len(layout.kinds.rstrip(cells.MISSING)), layout.width)
        for nameless in (empty, extra, [*extra, *empty]):
            if used or not nameless:
                continue
            fewer = layout.width - len(nameless)
            names, units, used = read_header(self.lines[low:first], fewer, layout.delimiter, layout.decimal, cut)
            for position in nameless:
                names.insert(position, "")
                units.insert(position, "")
        if not used and first and self.lines[first - 1].strip():
            names, used = self._uneven(first)
            units = [split_unit(name, names)[1] for name in names]
        self.names, self.used, self.first = names, used, first
        return names, units, used > 0

    def _uneven(self, first: int) -> tuple[list[str], int]:
        """Names from a header with one name fewer (row numbers have none) or up to two more than there are columns."""
        width, row = self.layout.width, [cells.clean(cell) for cell in self.rows[first - 1]]
        if any(cells.kind(cell, self.layout.decimal) != cells.TEXT or "=" in cell for cell in row):
            return [""] * width, 0
        numbered = [self.rows[k][0].strip(' "') for k in range(first, min(first + 2, len(self.rows))) if self.rows[k]]
        if len(row) == width - 1 and numbered in (["0", "1"], ["1", "2"]):
            return ["", *row], 1
        if self.layout.delimiter is not None and width < len(row) <= width + 2:
            return row[:width], 1
        return [""] * width, 0

    def left_out(self, index: np.ndarray) -> LeftOut:
        """The lines without the rows of numbers.

        Args:
            index: numbers of the rows of numbers, shape (rows,).
        """
        above = sum(bool(line.strip()) for line in self.lines[: self.first])
        count: dict[str, int] = {}
        notes = []
        if above > self.used:
            count["metadata"] = above - self.used
            notes.append(Note(Code.FILE_FORMAT, f"metadata above the numbers: {above - self.used} lines"))
        groups, unread = self._grouped(index)
        self._refuse(len(groups["cells"]), index.size, groups["cells"])
        for key, numbers in groups.items():
            if numbers:
                words = _WORDS[key].format(width=self.layout.width)
                count[words] = len(numbers)
                first = f"line {numbers[0] + 1}: {self.lines[numbers[0]].strip()[:40]!r}"
                notes.append(Note(Code.LEFT_OUT, f"left out: {len(numbers)} x {words}, first in {first}"))
        repeated = np.array(groups["header"])
        section = np.searchsorted(repeated, index) if repeated.size else np.zeros(index.size, dtype=int)
        return LeftOut(count, notes, section, unread)

    def _grouped(self, index: np.ndarray) -> tuple[dict[str, list[int]], int]:
        """Numbers of the lines left out by reason, and how many before the last row are rows of numbers."""
        ragged, unread = set(self.ragged), 0
        groups: dict[str, list[int]] = {key: [] for key in _WORDS}
        inside = np.zeros(len(self.lines), dtype=bool)
        inside[index] = True
        if inside[self.first :].all():
            return groups, 0
        for k in (np.flatnonzero(~inside[self.first :]) + self.first).tolist():
            line = self.lines[k]
            if not line.strip(" \t,;|"):
                continue
            if is_comment(line) and not (any(self.names) and self._is_header(k)):
                groups["comment"].append(k)
                continue
            if any(self.names) and self._is_header(k):
                groups["header"].append(k)
                continue
            kinds = [cells.kind(cell, self.layout.decimal) for cell in self.rows[k]]
            mostly = kinds.count(cells.NUMBER) > len(kinds) / 2
            groups["cells" if k in ragged and mostly else "text"].append(k)
            unread += int((mostly or (k not in ragged and cells.NUMBER in kinds)) and k < index[-1])
        return groups, unread

    def _is_header(self, k: int) -> bool:
        row = self.rows[k]
        return len(row) == len(self.names) and [cells.clean(cell) for cell in row] == self.names

    def _refuse(self, odd: int, good: int, where: list[int]) -> None:
        if odd > 2 and odd > 0.25 * good:
            raise DataError(
                f"{self.source}, line {where[0] + 1}: {odd} rows do not have the {self.layout.width} cells that {good} "
                f"rows have ({self.layout.words()}); set the delimiter or the decimal mark, or keep one table in the file"
            )
