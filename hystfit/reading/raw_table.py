"""`Table`: what a file holds before anybody says which column is the input, with an account of what was left out."""

from __future__ import annotations

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class Table:
    """Columns of one file, at the positions that they have there.

    Attributes:
        names: what the columns are called, "column 3" where the file does not say.
        units: their units, "" if unknown.
        columns: numbers, one array (rows,) a column, NaN where a value is missing or is text.
        labels: text columns by position, arrays (rows,) of str.
        stamps: positions of columns that were time stamps and are now seconds from the first.
        curve: which block between blank lines a row belongs to, from 0, shape (rows,).
        section: counts repeated header rows before a row, shape (rows,).
        line: line (or sheet row) of each row in the file, from 1, shape (rows,).
        named: whether the file gave names.
        source: path; sha256: checksum of the file's bytes.
        notes: what was found, assumed and left out, one sentence each.
        left_out: rows or lines that are not in the columns, counted by reason.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: tuple[np.ndarray, ...]
    labels: dict[int, np.ndarray]
    curve: np.ndarray
    section: np.ndarray
    line: np.ndarray
    source: str
    sha256: str | None
    named: bool = True
    stamps: frozenset[int] = frozenset()
    notes: tuple[str, ...] = ()
    left_out: dict[str, int] = dataclasses.field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Number of rows of numbers."""
        return self.line.size

    def constant(self, position: int) -> bool:
        """Whether a column has no two different numbers."""
        values = self.columns[position]
        values = values[np.isfinite(values)]
        return values.size == 0 or bool((values == values[0]).all())

    def take(self, rows: np.ndarray) -> Table:
        """The table of some rows, chosen by mask or by index."""
        return dataclasses.replace(
            self,
            columns=tuple(column[rows] for column in self.columns),
            labels={position: label[rows] for position, label in self.labels.items()},
            curve=self.curve[rows],
            section=self.section[rows],
            line=self.line[rows],
        )

    def describe(self) -> str:
        """The columns in one line, for error messages."""
        told = []
        for position, name in enumerate(self.names):
            state = ", text" if position in self.labels else ", constant" if self.constant(position) else ""
            told.append(f"{position}: {name!r}{state}")
        return "; ".join(told[:24]) + ("; ..." if len(told) > 24 else "")


def plain_table(
    names: list[str],
    arrays: list[np.ndarray],
    source: str,
    sha256: str | None,
    notes: tuple[str, ...],
    units: list[str],
) -> Table:
    """A table from arrays of equal length, as binary formats hold them."""
    rows = arrays[0].size
    columns, labels = [], {}
    for position, array in enumerate(arrays):
        if array.dtype.kind in "fiub":
            columns.append(np.asarray(array, dtype=np.float64))
        else:
            labels[position] = np.array([str(value) for value in array])
            columns.append(np.full(rows, np.nan))
    zeros = np.zeros(rows, dtype=int)
    line = np.arange(1, rows + 1)
    return Table(tuple(names), tuple(units), tuple(columns), labels, zeros, zeros, line, source, sha256, notes=notes)
