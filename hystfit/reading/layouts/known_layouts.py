"""Layouts of texts read before: in a folder of alike measurements, only the numbers of the third file and later ones are read.

Which layout a text has follows from the lines above its numbers and from the kinds of its cells, never from the numbers themselves. So a
text with the same bytes above and with nothing but plain numbers between the same delimiters below has the same names, units and notes.
A layout is used when two files, each read in full, have given it. A file that differs in anything is read in full.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

import numpy as np

from hystfit.reading.files.file_bytes import FileBytes
from hystfit.reading.files.lines import check_lengths, lines_of
from hystfit.reading.files.text_file import HEAD, Opening, TextFile
from hystfit.reading.layouts.wrapped_blocks import may_state_samples
from hystfit.reading.limits import ABOVE
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.cells import NUMBER
from hystfit.reading.text.clean_rows import clean_columns
from hystfit.reading.text.dialect import Dialect
from hystfit.reading.text.header import read_header

_MOST = 16  # layouts that are kept
_OF_NUMBERS, _ENDS, _DELIMITERS = b"0123456789+-.eE", b"\r\n", b",;\t|"
_PRINTED = bytes([*range(32, 256)]) + b"\t" + _ENDS
_DECIMALS = re.compile(rb"[.eE]")
_LOOKED_AT = 1000  # bytes of rows among which a number shows that the comma is no decimal mark
_NONE = np.zeros(0, int)
_SHORT = HEAD // 4  # lines above the numbers that are few beside any number of rows from `HEAD` on


@dataclasses.dataclass(frozen=True)
class KnownLayout:
    """What a text has in common with others of its layout.

    Attributes:
        opening: how the user asks to open them.
        suffix: of their names.
        header: bytes above the first row of numbers.
        dialect: of the rows.
        table: the columns' names, units and notes; it has no rows.
        first: line of the first row, from 1.
        rows: how many there are.
        any_length: whether texts with other numbers of rows have the same layout, where there are at least `HEAD`.
    """

    opening: Opening
    suffix: str
    header: bytes
    dialect: Dialect
    table: Table
    first: int
    rows: int
    any_length: bool

    @classmethod
    def of(cls, file: FileBytes, text: TextFile, table: Table) -> KnownLayout | None:
        """The layout of a plain text; None where more than the lines above the numbers could have decided it.

        Args:
            text: the same file, decoded.
            table: as the text was read.
        """
        first, width = int(table.line[0]), len(table.columns)
        above, end = text.lines[: first - 1], 0
        for _ in above:
            end = file.raw.find(b"\n", end) + 1
        header, others = file.raw[:end], set(file.raw[end:].translate(None, _OF_NUMBERS + _ENDS))
        if file.notes or text.opening.decimal == "," or len(others) != 1 or not others <= set(_DELIMITERS):
            return None
        if header.translate(None, _PRINTED) or header.count(b"\r") != header.count(b"\r\n"):
            return None
        delimiter = chr(others.pop())
        if width < 2 or not read_header(above[-ABOVE:], width, delimiter, ".", {})[2]:
            return None
        of_rows = (
            table.labels or table.stamps or table.problems or table.part is not None or table.calibration is not None
        )
        if of_rows or any(table.source in note.text for note in table.notes):
            return None
        kept = dataclasses.replace(table, columns=(), curve=_NONE, section=_NONE, line=_NONE, source="", sha256=None)
        any_length = (
            delimiter != "\t" and first <= _SHORT and not any(re.match(r"[\s\"']*[\d+.,;|−-]", k) for k in above)
        )
        dialect = Dialect(delimiter, ".", NUMBER * width, 0.0, 0)
        return cls(text.opening, file.suffix, header, dialect, kept, first, table.rows, any_length)

    def read(self, file: FileBytes, opening: Opening) -> Table | None:
        """The table of a text of this layout; None for others.

        Raises:
            DataError: a line is too long.
        """
        if opening != self.opening or file.suffix != self.suffix or file.notes or not file.raw.startswith(self.header):
            return None
        body, delimiter = file.raw[len(self.header) :], str(self.dialect.delimiter)
        if body.translate(None, _OF_NUMBERS + _ENDS + delimiter.encode()):
            return None
        if delimiter == "," and not _DECIMALS.search(body, 0, _LOOKED_AT):
            return None
        content = body.decode("ascii").replace("\r\n", "\n")
        if "\r" in content or (delimiter == "\t" and may_state_samples(content.partition("\n")[0])):
            return None
        check_lengths(content, file.source)
        columns = clean_columns(content, lines_of(content), 0, self.dialect, settled=opening.decimal is not None)
        if columns is None:
            return None
        rows = columns[0].size
        if rows != self.rows and not (self.any_length and min(rows, self.rows) >= HEAD):
            return None
        return dataclasses.replace(
            self.table,
            columns=tuple(columns),
            curve=np.zeros(rows, int),
            section=np.zeros(rows, int),
            line=self.first + np.arange(rows),
            source=file.source,
            sha256=file.sha256,
        )


class KnownLayouts:
    """The layouts of the texts that were read last."""

    def __init__(self) -> None:
        self._once: Sequence[KnownLayout] = ()
        self._proven: Sequence[KnownLayout] = ()

    def read(self, file: FileBytes, opening: Opening) -> Table | None:
        """The table of a text of a proven layout; None for others."""
        return next((table for one in self._proven if (table := one.read(file, opening)) is not None), None)

    def learn(self, file: FileBytes, text: TextFile, table: Table) -> None:
        """Keep the layout of a text that was read in full, and prove one that another text has given.

        Args:
            text: the same file, decoded.
            table: as the text was read.
        """
        for one in self._once:
            if (found := one.read(file, text.opening)) is not None:
                self._once = [other for other in self._once if other is not one]
                if _same(found, table):
                    self._proven = [one, *self._proven][:_MOST]
                return
        if (layout := KnownLayout.of(file, text, table)) is not None:
            self._once = [layout, *self._once][:_MOST]


def _same(one: Table, other: Table) -> bool:
    """Whether two tables are equal in everything."""

    def equal(a: object, b: object) -> bool:
        if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
            return np.array_equal(a, b)
        if isinstance(a, tuple) and isinstance(b, tuple):
            return len(a) == len(b) and all(map(equal, a, b))
        return bool(a == b)

    return all(equal(getattr(one, field.name), getattr(other, field.name)) for field in dataclasses.fields(Table))
