"""Text files as laboratories write them: the block of numbers as a `Table`, and what became of every other line.

General CSV readers fail on most such files, so the block is looked for directly; what could mean two things is refused
with the override that settles it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hystfit.errors import DataError
from hystfit.reading import cells
from hystfit.reading.decode import decode, load
from hystfit.reading.header import read_header, split_unit
from hystfit.reading.raw_table import Table
from hystfit.reading.sniff import Layout, sniff, split


def read_table(
    path: str | Path, *, delimiter: str | None = None, decimal: str | None = None, encoding: str | None = None
) -> Table:
    """All columns of a text file.

    Args:
        path: the file.
        delimiter, decimal, encoding: what to use instead of what is found.

    Raises:
        DataError: it is missing, not text, has no rows of numbers, or could be read in two ways.
    """
    raw, source = load(path), str(path)
    text, notes = decode(raw, source, encoding)
    lines = text.split("\n")
    if lines and not lines[-1]:
        lines.pop()
    layout = sniff(lines, source, delimiter, decimal)
    rows = [split(line, layout.delimiter) for line in lines]
    notes.append(layout.told())
    return tabulate(rows, lines, layout, source, hashlib.sha256(raw).hexdigest(), notes, settled=decimal is not None)


def tabulate(
    rows: list[list[str]],
    lines: Sequence[str],
    layout: Layout,
    source: str,
    sha256: str,
    notes: list[str],
    *,
    settled: bool = False,
) -> Table:
    """The table in some rows of cells whose layout is known; `settled` says that the decimal mark is not a guess."""
    candidates, ragged = _of_width(rows, layout)
    columns = list(zip(*[rows[k] for k in candidates], strict=True))
    values, fits = _parse_columns(columns, layout)
    index = np.array(candidates)[fits]
    keep = fits.copy()
    keep[fits] = _main_runs(rows, index, layout, lines)
    index = np.array(candidates)[keep]
    if index.size < 2:
        raise DataError(f"{source}: only {index.size} row of numbers found; a loop needs at least two")
    kept = np.flatnonzero(keep)
    chosen = [[column[k] for k in kept] for column in columns] if kept.size < len(candidates) else columns
    if not settled:
        _check_thousands(chosen, layout, index, source)
    account = _Account(rows, lines, ragged, layout, source)
    names, units, found = account.header(int(index[0]))
    left_out, told, section = account.left_out(index)
    stamps, labels, numbers = set(), {}, []
    for position, kind in enumerate(layout.kinds):
        label = names[position] or f"column {position}"
        parsed = values[position]
        column = np.full(index.size, np.nan) if parsed is None else parsed[keep]
        if kind == cells.STAMP:
            column, said = cells.seconds(chosen[position], f"{source}, {label!r}")
            stamps.add(position)
            told += [f"{label!r}: time stamps changed to seconds from the first one", *said]
        elif kind == cells.TEXT:
            labels[position] = np.array([cells.clean(cell) for cell in chosen[position]])
        elif np.nanmax(np.abs(column), initial=0.0) > 2.0**53:
            whole = cells.whole_from_first(chosen[position])
            if whole is not None:
                column = whole
                told.append(f"{label!r}: numbers too large for a double, counted from the first, {chosen[position][0]}")
        numbers.append(column)
    empty = [k for k, column in enumerate(numbers) if k not in labels and np.isnan(column).all()]
    if empty:
        told.append(f"empty columns not used: {', '.join(map(str, empty))} (columns count from 0)")
    if not found and [column[0] for column in numbers] == list(range(len(numbers))) and len(numbers) > 2:
        told.append("the first row reads 0, 1, ... and was kept as data; delete it if it numbers the columns")
    full = [name or f"column {k}" for k, name in enumerate(names)]
    return Table(
        names=tuple(full),
        units=tuple("s" if k in stamps else unit for k, unit in enumerate(units)),
        columns=tuple(numbers),
        labels=labels,
        curve=_curves(index, lines, told),
        section=section,
        line=index + 1,
        source=source,
        sha256=sha256,
        named=found,
        stamps=frozenset(stamps),
        notes=(*notes, *told),
        left_out=left_out,
    )


def _of_width(rows: list[list[str]], layout: Layout) -> tuple[list[int], list[int]]:
    """Rows of the layout's width, and others; empty cells at the end are cut or added where they mean nothing."""
    width = layout.width
    last = max(k for k, kind in enumerate(layout.kinds) if kind != cells.MISSING) + 1
    fit, ragged = [], []
    for k, row in enumerate(rows):
        if len(row) != width:
            filled = len(row)
            while filled and not row[filled - 1].strip():
                filled -= 1
            if filled == 0:
                continue
            if filled > width or filled < last:
                ragged.append(k)
                continue
            rows[k] = row[:width] + [""] * (width - len(row))
        fit.append(k)
    return fit, ragged


def _parse_columns(columns: list[tuple[str, ...]], layout: Layout) -> tuple[list[np.ndarray | None], np.ndarray]:
    """Numbers of every column (None for text and stamps), and which rows are rows of numbers."""
    count = len(columns[0])
    fits, any_number = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    values: list[np.ndarray | None] = []
    for column, kind in zip(columns, layout.kinds, strict=True):
        numbers = None
        if kind == cells.STAMP:
            fits &= np.array([cells.is_stamp(cells.clean(cell)) for cell in column])
        elif kind != cells.TEXT:
            numbers, kinds = cells.parse(column, layout.decimal)
            any_number |= kinds == cells.NUMBER
            if kind == cells.NUMBER:
                fits &= kinds != cells.TEXT
        values.append(numbers)
    return values, fits & any_number


def _main_runs(rows: list[list[str]], index: np.ndarray, layout: Layout, lines: Sequence[str]) -> np.ndarray:
    """Which rows belong with the longest run: a run that shares none of its tags (text cells) does not."""
    tags = [k for k, kind in enumerate(layout.kinds) if kind == cells.TEXT]
    keep = np.ones(index.size, dtype=bool)
    if not tags or index.size < 2:
        return keep
    starts = np.flatnonzero(np.diff(index, prepend=-2) > 1)
    starts = np.array([s for s in starts if s == 0 or any(lines[k].strip() for k in range(index[s - 1] + 1, index[s]))])
    ends = np.append(starts[1:], index.size)
    column = np.array([cells.clean(rows[k][tags[0]]) for k in index])
    longest = int(np.argmax(ends - starts))
    main = set(column[starts[longest] : ends[longest]])
    for start, end in zip(starts, ends, strict=True):
        if not main.intersection(column[start:end]):
            keep[start:end] = False
    return keep


def _check_thousands(columns: Sequence[Sequence[str]], layout: Layout, index: np.ndarray, source: str) -> None:
    """Raise where a mark could set thousands apart or be the decimal mark and nothing in the file tells which."""
    numbers = [k for k, kind in enumerate(layout.kinds) if kind == cells.NUMBER]
    evidence = {k: cells.thousands(columns[k], layout.decimal) for k in numbers}
    proven = any(found[2] for found in evidence.values())
    certain = any(found[3] for found in evidence.values())
    doubt = next((k for k, found in evidence.items() if found[0] or (found[1] and not certain)), None)
    if doubt is None or proven:
        return
    other = "," if layout.decimal == "." else "."
    mark = other if evidence[doubt][0] else layout.decimal
    row = next(k for k, cell in enumerate(columns[doubt]) if mark in cell)
    raise DataError(
        f"{source}, line {index[row] + 1}: ambiguous: in {columns[doubt][row].strip()!r} the {mark!r} could be "
        "the decimal mark or set thousands apart; give decimal='.' or decimal=',' to say which mark is the decimal one"
    )


def _curves(index: np.ndarray, lines: Sequence[str], told: list[str]) -> np.ndarray:
    """Number of the block between blank lines that each row is in."""
    curve = np.zeros(index.size, dtype=int)
    gaps = np.flatnonzero(np.diff(index) > 1)
    for k in gaps:
        if any(not line.strip(" \t,;|") for line in lines[index[k] + 1 : index[k + 1]]):
            curve[k + 1] = 1
    curve = np.cumsum(curve)
    if curve[-1] > 1 and curve[-1] == index.size - 1:
        told.append("blank lines between all rows taken as double spacing, not as separate curves")
        return np.zeros(index.size, dtype=int)
    return curve


class _Account:
    """Says what became of every line that is not a row of numbers."""

    def __init__(self, rows: list[list[str]], lines: Sequence[str], ragged: list[int], layout: Layout, source: str):
        self.rows, self.lines, self.layout, self.source = rows, lines, layout, source
        self.ragged = ragged
        self.names: list[str] = []

    def header(self, first: int) -> tuple[list[str], list[str], bool]:
        """Names and units, and whether there were any, from the lines above row `first`."""
        low = max(0, first - 12)
        cut = {k - low: self.rows[k] for k in range(low, first)}
        layout = self.layout
        names, units, used = read_header(self.lines[low:first], layout.width, layout.delimiter, layout.decimal, cut)
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

    def left_out(self, index: np.ndarray) -> tuple[dict[str, int], list[str], np.ndarray]:
        """Counts by reason, sentences for the notes, and the number of repeated headers before each row."""
        above = sum(bool(line.strip()) for line in self.lines[: self.first])
        count: dict[str, int] = {}
        told = []
        if above > self.used:
            count["metadata"] = above - self.used
            told.append(f"{above - self.used} lines above the numbers read as metadata")
        ragged = set(self.ragged)
        groups: dict[str, list[int]] = {"header": [], "cells": [], "text": [], "comment": []}
        inside = np.zeros(len(self.lines), dtype=bool)
        inside[index] = True
        for k in (np.flatnonzero(~inside[self.first :]) + self.first).tolist():
            if not self.lines[k].strip(" \t,;|"):
                continue
            row = [cells.clean(cell) for cell in self.rows[k]]
            if any(self.names) and row == self.names:
                groups["header"].append(k)
            elif self.lines[k].lstrip().startswith(("#", "%", "//", "!")):
                groups["comment"].append(k)
            elif k in ragged and sum(cells.kind(c, self.layout.decimal) == cells.NUMBER for c in row) > len(row) / 2:
                groups["cells"].append(k)
            else:
                groups["text"].append(k)
        self._refuse(len(groups["cells"]), index.size, groups["cells"])
        words = {
            "header": "repeated header",
            "cells": f"row with another number of cells than {self.layout.width}",
            "text": "line with text where numbers are expected",
            "comment": "comment line",
        }
        for key, found in groups.items():
            if found:
                count[words[key]] = len(found)
                shown = self.lines[found[0]].strip()[:40]
                told.append(f"left out: {len(found)} x {words[key]}, first in line {found[0] + 1}: {shown!r}")
        return count, told, np.searchsorted(np.array(groups["header"]), index)

    def _refuse(self, odd: int, good: int, where: list[int]) -> None:
        if odd > 2 and odd > 0.25 * good:
            raise DataError(
                f"{self.source}, line {where[0] + 1}: {odd} rows do not have the {self.layout.width} cells that {good} "
                f"rows have ({self.layout.told()}); give delimiter= or decimal=, or keep one table in the file"
            )
