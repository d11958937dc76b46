"""`Table`: the columns of a file before input and output are chosen, and which lines are not in them."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.outcome import Note


@dataclasses.dataclass(frozen=True)
class Table:
    """Columns of one file, at the positions that they have there.

    Attributes:
        names: of the columns, "column 3" where the file has none.
        units: their units, "" if unknown.
        columns: numbers, one array (rows,) for each column, NaN where a value is missing or is text.
        labels: text columns by position, arrays (rows,) of str.
        stamps: positions of columns of time stamps, converted to seconds from the first.
        curve: number of the block between blank lines that a row is in, from 0, shape (rows,).
        section: number of repeated header rows before a row, shape (rows,).
        line: line (or sheet row) of each row in the file, from 1, shape (rows,).
        named: whether the file has names.
        source: path; sha256: checksum of the file's bytes.
        notes: what was assumed and left out.
        left_out: rows or lines that are not in the columns, counted by reason.
        unread: how many of them are rows of numbers that could not be read.
        metadata: properties of the sample in the header (size, mass, ...), as written there.
        sectioned: the file has sections [Header] and [Data], in which rows without a measurement are ordinary.
        calibration: which rows are calibration points, shape (rows,), bool; None where that is unknown or there are none.
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
    notes: tuple[Note, ...] = ()
    left_out: dict[str, int] = dataclasses.field(default_factory=dict)
    unread: int = 0
    metadata: dict[str, str] = dataclasses.field(default_factory=dict)
    sectioned: bool = False
    calibration: np.ndarray | None = None

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
            calibration=None if self.calibration is None else self.calibration[rows],
        )

    def describe(self) -> str:
        """The columns in one line, for error messages."""
        parts = []
        for position, name in enumerate(self.names):
            state = ", text" if position in self.labels else ", constant" if self.constant(position) else ""
            parts.append(f"{position}: {name!r}{state}")
        return "; ".join(parts[:24]) + ("; ..." if len(parts) > 24 else "")


def plain_table(
    names: list[str],
    arrays: list[np.ndarray],
    source: str,
    sha256: str | None,
    notes: tuple[Note, ...],
    units: list[str],
) -> Table:
    """A table from arrays of equal length, as binary formats hold them.

    Args:
        arrays: one for each column, shape (rows,).
    """
    rows = arrays[0].size
    columns, labels = [], {}
    for position, array in enumerate(arrays):
        if array.dtype.kind in "fiub":
            with np.errstate(invalid="ignore"):  # signaling NaN of damaged files, which are made quiet
                column = np.array(array, dtype=np.float64)
                column[np.isnan(column)] = np.nan
            columns.append(column)
        else:
            labels[position] = np.array([str(value) for value in array])
            columns.append(np.full(rows, np.nan))
    zeros = np.zeros(rows, dtype=int)
    line = np.arange(1, rows + 1)
    return Table(tuple(names), tuple(units), tuple(columns), labels, zeros, zeros, line, source, sha256, notes=notes)
