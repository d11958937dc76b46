"""Text files as laboratories write them: their encoding, their layout, and their block of numbers as a `Table`.

General CSV readers fail on most such files, so the block of numbers is searched for. Under every pair of delimiter and decimal mark
the cells of a sample of lines are classified (number, missing, time stamp, text); the pair whose most frequent row pattern holds
the most numbers wins. A file that can be read in two ways is refused, with the argument that settles it.
"""

from __future__ import annotations

import collections
import csv
import dataclasses
import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading import cells
from hystfit.reading.encodings import encoding_of
from hystfit.reading.header import read_header, sample_properties, split_unit
from hystfit.reading.instruments import micromag_columns
from hystfit.reading.raw_table import Table

_MAGIC = {
    b"PK\x03\x04": "a zip archive or Excel file (name it .xlsx)",
    b"\x89HDF": "an HDF5 file (name it .h5, or .mat if MATLAB wrote it)",
    b"\xd0\xcf\x11\xe0": "an old Excel file (save it as .xlsx)",
    b"MATLAB": "a MATLAB file (name it .mat)",
    b"\x93NUMPY": "a numpy file (name it .npy)",
    b"\x1f\x8b": "a gzip archive (unpack it)",
    b"TDSm": "a TDMS file (export it as CSV)",
    b"%PDF": "a PDF document",
    b"\x89PNG": "a picture",
    b"PAR1": "a parquet file (export it as CSV)",
}


def load(path: str | Path) -> bytes:
    """The bytes of a file.

    Raises:
        DataError: it is missing, a folder, empty or may not be read.
    """
    path = Path(path)
    if path.is_dir():
        raise DataError(f"{path} is a folder; name one file in it")
    try:
        raw = path.read_bytes()
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file; check the name and the folder that you are in") from error
    except (OSError, ValueError) as error:
        raise DataError(f"{path} cannot be read: {error}") from error
    if not raw:
        raise DataError(f"{path} is empty (0 bytes); nothing was written to it: record or copy it again")
    return raw


def decode(raw: bytes, source: str, encoding: str | None) -> tuple[str, list[Note]]:
    """Text of a file and what was assumed about its encoding.

    Raises:
        DataError: the bytes are not text, or not in the encoding that was given.
    """
    for magic, what in _MAGIC.items():
        if raw.startswith(magic):
            raise DataError(f"{source} is not text but {what}")
    notes: list[Note] = []
    if encoding is None:
        encoding = encoding_of(raw, source)
        if encoding == "latin-1":
            text = "the encoding of the text was not recognized, and latin-1 is assumed: set --encoding (encoding=)"
            notes.append(warn(Code.FILE_FORMAT, text))
        elif encoding not in ("utf-8", "utf-8-sig"):
            notes.append(Note(Code.FILE_FORMAT, f"encoding {encoding}, which was recognized from the text"))
    try:
        text = raw.decode(encoding).removeprefix("\ufeff")
    except LookupError as error:
        raise DataError(f"{source}: there is no encoding {encoding!r}; use utf-8, utf-16 or cp1252") from error
    except UnicodeError as error:
        raise DataError(
            f"{source} is not text in {encoding}: {error}; leave the encoding out or give another"
        ) from error
    if padded := len(text) - len(text.rstrip("\x00")):
        text = text.rstrip("\x00")
        notes.append(Note(Code.LEFT_OUT, f"{padded} NUL bytes at the end"))
    odd = len(re.findall(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]", text))
    if "\x00" in text or odd > max(2, 0.01 * len(text)):
        place = re.search(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]", text)
        line = 1 + text.count("\n", 0, place.start() if place else 0)
        raise DataError(
            f"{source}, line {line}: {odd} NUL or control bytes; this is a binary or damaged file: export it as text, "
            "or name it by its format (.mat, .npz, .xlsx, .h5)"
        )
    return text.replace("\r\r\n", "\n").replace("\r\n", "\n").replace("\r", "\n"), notes


_SAMPLE = 900


@dataclasses.dataclass(frozen=True)
class Layout:
    """How the rows of numbers are written: delimiter (None is any white space), decimal mark, kinds of the columns."""

    delimiter: str | None
    decimal: str
    kinds: str
    score: float
    rows: int

    @property
    def width(self) -> int:
        """Number of columns, empty ones included."""
        return len(self.kinds)

    def words(self) -> str:
        """Delimiter and decimal mark, for messages."""
        name = {None: "white space", "\t": "tab", ",": "comma", ";": "semicolon", "|": "bar"}
        return f"delimiter {name.get(self.delimiter, repr(self.delimiter))}, decimal mark {self.decimal!r}"


def split(line: str, delimiter: str | None) -> list[str]:
    """Cells of one line; a delimiter within double quotes does not count."""
    if '"' in line and delimiter is not None and len(delimiter) == 1:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    return line.split(delimiter)


def _quality(pattern: str) -> float:
    numbers = pattern.count(cells.NUMBER) + pattern.count(cells.STAMP)
    text = pattern.count(cells.TEXT)
    return numbers * (numbers / (numbers + text)) ** 2 if cells.NUMBER in pattern else 0.0


def layout_of(rows: Sequence[Sequence[str]], delimiter: str | None, decimal: str) -> Layout:
    """The most frequent pattern of cells among some rows; score 0 where no row holds a number."""
    counts = collections.Counter("".join([cells.kind(cell, decimal) for cell in row]) for row in rows if row)
    top = max(counts, key=lambda pattern: (counts[pattern] * _quality(pattern), pattern), default="")
    missing, text = cells.MISSING, cells.TEXT
    fits = [
        pattern
        for pattern in counts
        if len(pattern) == len(top)
        and all(a == b or missing in (a, b) or b == text for a, b in zip(pattern, top, strict=True))
    ]
    kinds = ""
    for position in range(len(top)):
        votes = collections.Counter()
        for pattern in fits:
            votes[pattern[position]] += counts[pattern]
        votes.pop(missing, None)
        kinds += text if text in votes else votes.most_common(1)[0][0] if votes else missing
    total = sum(counts[pattern] for pattern in fits)
    return Layout(delimiter, decimal, kinds, total * _quality(kinds), total)


def sniff(lines: Sequence[str], source: str, delimiter: str | None, decimal: str | None) -> Layout:
    """Delimiter, decimal mark and kinds of the columns.

    Raises:
        DataError: no line holds numbers under any of them, or the comma could be both.
    """
    filled = [line for line in lines if line.strip()]
    if len(filled) > _SAMPLE:
        step = len(filled) / (_SAMPLE - 300)
        filled = filled[:300] + [filled[int(step * k)] for k in range(_SAMPLE - 300)]
    if delimiter is not None:
        delimiter = {"tab": "\t", "\\t": "\t", "comma": ",", "semicolon": ";"}.get(delimiter, delimiter)
        marks: list[str | None] = [None if delimiter in (" ", "space", "whitespace") else delimiter]
    else:
        marks = [mark for mark in (",", ";", "\t", "|") if any(mark in line for line in filled)] + [None]
    if decimal not in (None, ".", ","):
        raise DataError(f"the decimal mark must be '.' or ',', got {decimal!r}")
    best = Layout(None, ".", "", 0.0, 0)
    for mark in marks:
        rows = [split(line, mark) for line in filled]
        for point in (".", ",") if decimal is None else (decimal,):
            layout = layout_of(rows, mark, point)
            if layout.score > best.score * (1 + 1e-9):
                best = layout
    if best.score == 0.0:
        raise DataError(
            f"{source}: no row of numbers found in {len(lines)} lines; it begins {filled[0].strip()[:60]!r}. "
            "Give delimiter= and decimal= if there are numbers in it"
            if filled
            else f"{source} holds {len(lines)} blank lines and nothing else"
        )
    if best.delimiter == "," and best.decimal == "." and delimiter is None and decimal is None:
        _check_comma(filled, best, source)
    return best


def _check_comma(filled: Sequence[str], layout: Layout, source: str) -> None:
    """Refuse rows such as 0,10,1,20 under the two names "t,y": each comma could be a delimiter or a decimal mark."""
    rows = [split(line, ",") for line in filled]
    rows = [row for row in rows if len(row) == layout.width and all(cells.kind(c, ".") == cells.NUMBER for c in row)]
    if layout.width % 2 or not rows or any(re.search(r"[.eE]", cell) for row in rows for cell in row):
        return
    tails = [cell.strip() for row in rows for cell in row[1::2]]
    digits = all(tail.isdigit() for tail in tails)
    zeros = any(len(tail) > 1 and tail[0] == "0" for tail in tails)
    half = layout.width // 2
    spaced = half > 1 and all(len(re.split(r",\s+", line.strip())) == half for line in filled if line[:1].isdigit())
    named = half > 1 and any(
        len(re.split(r"[,;\t]", line.strip())) == half and not re.search(r"\d", line) for line in filled[:8]
    )
    if digits and (zeros or spaced or named):
        raise DataError(
            f"{source}: ambiguous: in {','.join(rows[-1])!r} the comma could be the delimiter or the decimal mark. "
            "Give delimiter=',' if it separates columns, or write the file again with ';' between columns"
        )


def read_table(
    path: str | Path, *, delimiter: str | None = None, decimal: str | None = None, encoding: str | None = None
) -> Table:
    """All columns of a text file.

    Args:
        path: the file.
        delimiter, decimal, encoding: detected where None.

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
    notes.append(Note(Code.FILE_FORMAT, layout.words()))
    return tabulate(rows, lines, layout, source, hashlib.sha256(raw).hexdigest(), notes, settled=decimal is not None)


def tabulate(
    rows: list[list[str]],
    lines: Sequence[str],
    layout: Layout,
    source: str,
    sha256: str,
    notes: list[Note],
    *,
    settled: bool = False,
) -> Table:
    """The table in rows of cells whose layout is known.

    Args:
        rows: cells of every line.
        lines: the same as text.
        layout: of the rows of numbers.
        source, sha256: path and checksum of the file.
        notes: on how it was read so far.
        settled: the decimal mark is not a guess.
    """
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
    names, units, named = account.header(int(index[0]))
    above = lines[: int(index[0])]
    metadata = sample_properties(above, names)
    if not named and (columns := micromag_columns(above)) and len(names) == len(columns):
        (names, units), named = zip(*columns, strict=True), True
    left_out, more_notes, section = account.left_out(index)
    notes = [*notes, *more_notes]
    if metadata:
        listed = ", ".join(f"{key} {value}" for key, value in metadata.items())
        notes.append(Note(Code.FILE_FORMAT, f"properties of the sample in the header: {listed}"))
    stamps, labels, numbers = set(), {}, []
    for position, kind in enumerate(layout.kinds):
        label = names[position] or f"column {position}"
        parsed = values[position]
        column = np.full(index.size, np.nan) if parsed is None else parsed[keep]
        if kind == cells.STAMP:
            column, assumed = cells.seconds(chosen[position], f"{source}, {label!r}")
            stamps.add(position)
            notes += [
                Note(Code.FILE_FORMAT, f"{label!r}: time stamps converted to seconds from the first one"),
                *assumed,
            ]
        elif kind == cells.TEXT:
            labels[position] = np.array([cells.clean(cell) for cell in chosen[position]])
        elif np.nanmax(np.abs(column), initial=0.0) > 2.0**53:
            whole = cells.whole_from_first(chosen[position])
            if whole is not None:
                column = whole
                first = chosen[position][0]
                notes.append(
                    Note(Code.FILE_FORMAT, f"{label!r}: too large for a double, stored as differences to {first}")
                )
        numbers.append(column)
    empty = [k for k, column in enumerate(numbers) if k not in labels and np.isnan(column).all()]
    if empty:
        numbered = ", ".join(map(str, empty))
        notes.append(Note(Code.LEFT_OUT, f"empty columns are not used: {numbered} (numbered from 0)"))
    if not named and [column[0] for column in numbers] == list(range(len(numbers))) and len(numbers) > 2:
        text = "the first row is 0, 1, ... and was read as data; delete it if it numbers the columns"
        notes.append(Note(Code.FILE_FORMAT, text))
    full = [name or f"column {k}" for k, name in enumerate(names)]
    return Table(
        names=tuple(full),
        units=tuple("s" if k in stamps else unit for k, unit in enumerate(units)),
        columns=tuple(numbers),
        labels=labels,
        curve=_curves(index, lines, notes),
        section=section,
        line=index + 1,
        source=source,
        sha256=sha256,
        named=named,
        stamps=frozenset(stamps),
        notes=tuple(notes),
        left_out=left_out,
        metadata=metadata,
        sectioned=any(line.strip(" ,;\t").lower() == "[data]" for line in above),
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
    """Refuse numbers in which a mark is either a thousands separator or the decimal mark, and nothing in the file decides."""
    numbers = [k for k, kind in enumerate(layout.kinds) if kind == cells.NUMBER]
    evidence = {k: cells.thousands(columns[k], layout.decimal) for k in numbers}
    proven = any(marks[2] for marks in evidence.values())
    certain = any(marks[3] for marks in evidence.values())
    doubt = next((k for k, marks in evidence.items() if marks[0] or (marks[1] and not certain)), None)
    if doubt is None or proven:
        return
    other = "," if layout.decimal == "." else "."
    mark = other if evidence[doubt][0] else layout.decimal
    row = next(k for k, cell in enumerate(columns[doubt]) if mark in cell)
    raise DataError(
        f"{source}, line {index[row] + 1}: ambiguous: in {columns[doubt][row].strip()!r} the {mark!r} could be "
        "the decimal mark or set thousands apart; give decimal='.' or decimal=',' (--decimal, decimal=)"
    )


def _curves(index: np.ndarray, lines: Sequence[str], notes: list[Note]) -> np.ndarray:
    """Number of the block between blank lines that each row is in."""
    curve = np.zeros(index.size, dtype=int)
    gaps = np.flatnonzero(np.diff(index) > 1)
    for k in gaps:
        if any(not line.strip(" \t,;|") for line in lines[index[k] + 1 : index[k + 1]]):
            curve[k + 1] = 1
    curve = np.cumsum(curve)
    if curve[-1] > 1 and curve[-1] == index.size - 1:
        notes.append(Note(Code.CURVES, "blank lines between all rows are double spacing and do not separate curves"))
        return np.zeros(index.size, dtype=int)
    return curve


class _Account:
    """Accounts for every line that is not a row of numbers."""

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

    def left_out(self, index: np.ndarray) -> tuple[dict[str, int], list[Note], np.ndarray]:
        """Counts by reason, notes, and the number of repeated headers before each row."""
        above = sum(bool(line.strip()) for line in self.lines[: self.first])
        count: dict[str, int] = {}
        notes = []
        if above > self.used:
            count["metadata"] = above - self.used
            notes.append(Note(Code.FILE_FORMAT, f"metadata above the numbers: {above - self.used} lines"))
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
        for key, numbers in groups.items():
            if numbers:
                count[words[key]] = len(numbers)
                first = f"line {numbers[0] + 1}: {self.lines[numbers[0]].strip()[:40]!r}"
                notes.append(Note(Code.LEFT_OUT, f"left out: {len(numbers)} x {words[key]}, first in {first}"))
        return count, notes, np.searchsorted(np.array(groups["header"]), index)

    def _refuse(self, odd: int, good: int, where: list[int]) -> None:
        if odd > 2 and odd > 0.25 * good:
            raise DataError(
                f"{self.source}, line {where[0] + 1}: {odd} rows do not have the {self.layout.width} cells that {good} "
                f"rows have ({self.layout.words()}); set the delimiter or the decimal mark, or keep one table in the file"
            )
