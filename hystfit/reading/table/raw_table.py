"""`Table`: the columns of a file before input and output are chosen, and which lines are not in them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from hystfit.data.record import Stated
from hystfit.outcome import Note
from hystfit.reading.names.branch_words import BRANCHES, FALLING, words_of
from hystfit.reading.names.column_names import column_quantity
from hystfit.reading.table.signal_evidence import meet


@dataclasses.dataclass(frozen=True)
class Part:
    """What a file says of one of its records.

    Attributes:
        name: of the record, "" where the file gives none.
        metadata: properties of the sample, as written there.
        stated: results that the instrument computed.
    """

    name: str = ""
    metadata: dict[str, str] = dataclasses.field(default_factory=dict)
    stated: tuple[Stated, ...] = ()


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
        part: number of the record that a row belongs to, shape (rows,), where the layout of the file divides it into records; else None.
        parts: what the file says of each of these records, by number; of a file that is not divided the only one, or ().
        pair: positions of the input and the output, where the layout of the file determines them.
        problems: why the numbers of a column are in doubt, by position; an error where the column is used.
        interval: time between two rows that the file states [s]; None where it states none.
        over: the cells above the names, which name groups of columns ("W1", "", "W2", ""); () without such a line.
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
    part: np.ndarray | None = None
    parts: tuple[Part, ...] = ()
    pair: tuple[int, int] | None = None
    problems: dict[int, str] = dataclasses.field(default_factory=dict)
    interval: float | None = None
    over: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """Number of rows of numbers."""
        return self.line.size

    @property
    def positions(self) -> range:
        """Positions of all columns."""
        return range(len(self.names))

    def quantity(self, position: int) -> str:
        """Physical quantity of a column by its name and unit, "" if unknown."""
        return column_quantity(self.names[position], self.units[position])

    @property
    def clocks(self) -> list[int]:
        """Positions of the columns of times."""
        return [k for k in self.positions if k in self.stamps or self.quantity(k) == "time"]

    @property
    def whole(self) -> Part:
        """What the file says of its only record."""
        return self.parts[0] if self.parts else Part()

    def constant(self, position: int) -> bool:
        """Whether a column has no two different numbers."""
        values = self.columns[position]
        values = values[np.isfinite(values)]
        return values.size == 0 or bool((values == values[0]).all())

    def runs(self, position: int) -> float:
        """The way a column runs in one direction, 1 or -1; 0 for other columns."""
        ways = {*np.sign(np.diff(self.columns[position])).tolist()} - {0.0}
        return ways.pop() if len(ways) == 1 else 0.0

    def counts(self, position: int, *, groups: bool = False) -> bool:
        """Whether a column is a row number: whole numbers that go up by one from 0 or 1; or with `groups` the number of a group of rows."""
        values = self.columns[position]
        steps = np.diff(values)
        return values[0] in (0.0, 1.0) and bool(((steps == 1.0) | (groups and steps.any() and steps == 0.0)).all())

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
            part=None if self.part is None else self.part[rows],
        )

    def select(self, positions: Sequence[int]) -> Table:
        """The table with some of its columns, in this order."""
        place = {old: new for new, old in enumerate(positions)}
        of = lambda by_position: {place[k]: value for k, value in by_position.items() if k in place}
        pair = (
            self.pair if self.pair is None or not place.keys() >= {*self.pair} else tuple(place[k] for k in self.pair)
        )
        return dataclasses.replace(
            self,
            names=tuple(self.names[k] for k in positions),
            units=tuple(self.units[k] for k in positions),
            columns=tuple(self.columns[k] for k in positions),
            labels=of(self.labels),
            problems=of(self.problems),
            stamps=frozenset(place[k] for k in self.stamps if k in place),
            pair=pair,
            over=tuple(self.over[k] for k in positions) if self.over else (),
        )

    def beside(self, name: str, values: np.ndarray, unit: str = "") -> Table:
        """The table with one more column of numbers at its end, shape (rows,)."""
        names, units, columns = (*self.names, name), (*self.units, unit), (*self.columns, values)
        return dataclasses.replace(self, names=names, units=units, columns=columns)

    def noted(self, *notes: Note) -> Table:
        """The table with more notes."""
        return dataclasses.replace(self, notes=(*self.notes, *notes))

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


_PAGE = 0.9  # part of the range of an input that no page of a loop covers, while a loop of its own does


def one_loop(titles: Sequence[str], tables: Sequence[Table]) -> Table | None:
    """The branches of a loop by their titles, the second of two that rise turned, or its pages, as one record; None for other tables."""
    words = [words_of(title) for title in titles]
    branches = all(word & BRANCHES for word in words) and any(word & FALLING for word in words)
    if len(tables) < 2 or not (branches or _are_pages(tables)):
        return None
    ordered = [*tables]
    numbered = int(tables[0].counts(0))
    if len(ordered) == 2 and ordered[0].runs(numbered) * ordered[1].runs(numbered) > 0:  # both listed upward
        ordered[1] = ordered[1].take(np.arange(ordered[1].rows)[::-1])
    return dataclasses.replace(below_each_other(ordered, [Part()]), part=None)


def _are_pages(tables: Sequence[Table]) -> bool:
    """Whether each table goes on where the one before it ends, in every column, and none has most of the range of one that turns."""
    if any(table.labels for table in tables) or {*tables[0].names} != set.intersection(*({*t.names} for t in tables)):
        return False
    turning = []
    for name in tables[0].names:
        columns = [table.columns[table.names.index(name)] for table in tables]
        if not meet(columns):
            return False
        steps = np.concatenate([np.diff(column) for column in columns])
        if steps.min(initial=0.0) < 0 < steps.max(initial=0.0):
            turning.append(max(map(np.ptp, columns)) / np.ptp(np.concatenate(columns)))
    return min(turning, default=1.0) < _PAGE


def below_each_other(tables: Sequence[Table], parts: Sequence[Part]) -> Table:
    """Tables with columns of the same names as one, of which each is a record; the columns are in the order of the first."""
    first, rows = tables[0], [table.rows for table in tables]
    places = [[table.names.index(name) for name in first.names] for table in tables]
    below = lambda of, k: np.concatenate([of(table)[place[k]] for table, place in zip(tables, places, strict=True)])
    zeros = np.zeros(sum(rows), dtype=int)
    return dataclasses.replace(
        first,
        columns=tuple(below(lambda table: table.columns, k) for k in range(len(first.names))),
        labels={k: below(lambda table: table.labels, k) for k in first.labels},
        curve=zeros,
        section=zeros,
        line=np.concatenate([table.line for table in tables]),
        part=np.repeat(np.arange(len(tables)), rows),
        parts=tuple(parts),
        metadata={},
        left_out={},
        unread=sum(table.unread for table in tables),
    )
