"""Dialect of the rows of numbers in a text: delimiter, decimal mark and kinds of the columns, from a sample of its lines."""

from __future__ import annotations

import collections
import csv
import dataclasses
import itertools
import re
from collections.abc import Sequence

from hystfit.errors import DataError
from hystfit.reading.limits import MAJORITY, ODD, SAMPLE
from hystfit.reading.text import cells

_MOST = 300_000  # characters of the sample
_FIRST = 300  # lines of the sample that are the first ones
_NEVER_DECIMAL = (";", "\t", "|")
_HEAD = 0.02  # share of the lines, or three of them, that a header may be where all others are plain rows


@dataclasses.dataclass(frozen=True)
class Dialect:
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

    @property
    def numbers(self) -> int:
        """Number of columns of numbers."""
        return self.kinds.count(cells.NUMBER)

    def words(self) -> str:
        """Delimiter and decimal mark, for messages."""
        name = {None: "white space", "\t": "tab", ",": "comma", ";": "semicolon", "|": "bar"}
        return f"delimiter {name.get(self.delimiter, repr(self.delimiter))}, decimal mark {self.decimal!r}"


@dataclasses.dataclass(frozen=True)
class Text:
    """A text whose dialect is known.

    Attributes:
        lines: of the text.
        dialect: of the rows of numbers in it.
        source: path of the file, for messages.
        settled: the decimal mark is not a guess.
    """

    lines: Sequence[str]
    dialect: Dialect
    source: str
    settled: bool


_LAST_DECIMALS = re.compile(r"\.(\d{2,})(?:[eE][+-]\d\d)?\s*$", re.ASCII)
_TOUCHING = re.compile(r"(\.\d+(?:[eE][+-]?\d+)?)(?=-\d*\.\d)", re.ASCII)


def split(line: str, delimiter: str | None) -> list[str]:
    """Cells of one line; a delimiter within double quotes does not count."""
    if '"' in line and delimiter is not None and len(delimiter) == 1:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    return line.split(delimiter)


def apart(lines: Sequence[str]) -> tuple[list[str], int]:
    """The lines with a blank between columns of fixed width that touch ("1.23-2.34", "1.232.34"), and how many have such columns."""
    separated = [_TOUCHING.sub(r"\1 ", line) if "-" in line else line for line in _at_decimals(lines)]
    return separated, sum(a != b for a, b in zip(lines, separated, strict=True))


def _at_decimals(lines: Sequence[str]) -> Sequence[str]:
    """The lines with a blank after each number that touches the next one, where all numbers of a line have as many decimals as its last.

    The lines as they are where such a place would part a number of another line: the columns have different decimals.
    """
    places = {k: found for k, line in enumerate(lines) if line.count(".") > 1 and (found := _ends(line))}
    everywhere = {place for found in places.values() for place in found}
    parts = lambda line, place: line[place - 1 : place].isdigit() and line[place : place + 1].isdigit()
    for k, line in enumerate(lines):
        if "." in line and any(parts(line, place) for place in everywhere.difference(places.get(k, ()))):
            return lines
    cut = lambda line, found: " ".join(line[a:b] for a, b in itertools.pairwise([0, *found, len(line)]))
    return [cut(line, places[k]) if k in places else line for k, line in enumerate(lines)]


def _ends(line: str) -> list[int]:
    """Where numbers end that touch the next one."""
    last = _LAST_DECIMALS.search(line)
    if last is None:
        return []
    number = re.compile(rf"\.\d{{{len(last[1])}}}(?:[eE][+-]\d\d)?(?=\d+\.)")
    return [match.end() for match in number.finditer(line)]


def _quality(pattern: str) -> float:
    stamps = len(re.findall(f"{cells.STAMP}+", pattern))  # a date and the time beside it are one stamp
    numbers = pattern.count(cells.NUMBER) + stamps
    text = pattern.count(cells.TEXT)
    return numbers * (numbers / (numbers + text)) ** 2 if cells.NUMBER in pattern else 0.0


def dialect_of(rows: Sequence[Sequence[str]], delimiter: str | None, decimal: str) -> Dialect:
    """The most frequent pattern of cells among some rows; score 0 where no row holds a number."""
    plain, number = cells.patterns(decimal)[0].fullmatch, cells.NUMBER  # most cells are plain numbers
    counts = collections.Counter(
        "".join([number if plain(cell) else cells.kind(cell, decimal) for cell in row]) for row in rows if row
    )
    top = max(counts, key=lambda pattern: (counts[pattern] * _quality(pattern), pattern), default="")
    missing, text = cells.MISSING, cells.TEXT
    fits = [
        pattern
        for pattern in counts
        if len(pattern) == len(top)
        and all(a == b or missing in (a, b) or b == text for a, b in zip(pattern, top, strict=True))
    ]
    kinds = ""
    began = False  # whether a column before this one holds something
    for position in range(len(top)):
        votes = collections.Counter()
        for pattern in fits:
            votes[pattern[position]] += counts[pattern]
        empty = votes.pop(missing, 0)
        if not began and votes.total() < ODD * empty:
            votes.clear()
        began = began or bool(votes)
        kinds += text if text in votes else votes.most_common(1)[0][0] if votes else missing
    total = sum(counts[pattern] for pattern in fits)
    return Dialect(delimiter, decimal, kinds, total * _quality(kinds), total)


def sniff(lines: Sequence[str], source: str, delimiter: str | None, decimal: str | None) -> Dialect:
    """Delimiter, decimal mark and kinds of the columns.

    Args:
        delimiter, decimal: chosen by the user; detected where None.
    """
    filled = _sample(lines)
    if delimiter is not None:
        delimiter = {"tab": "\t", "\\t": "\t", "comma": ",", "semicolon": ";"}.get(delimiter, delimiter)
        marks: list[str | None] = [None if delimiter in (" ", "space", "whitespace", "") else delimiter]
    else:
        marks = [mark for mark in (",", ";", "\t", "|") if any(mark in line for line in filled)] + [None]
    if decimal not in (None, ".", ","):
        raise DataError(f"the decimal mark must be '.' or ',', got {decimal!r}")
    best, text_of_best = Dialect(None, ".", "", 0.0, 0), 0
    for mark in marks:
        if (
            mark is None
            and best.delimiter in _NEVER_DECIMAL
            and best.rows > MAJORITY * len(filled)
            and best.numbers > 1
            and not (best.delimiter == "\t" and _has_rows_of_blanks(filled, best))
        ):
            break  # blanks within its cells part words
        rows = [split(line, mark) for line in filled]
        for point in (".", ",") if decimal is None else (decimal,):
            dialect = dialect_of(rows, mark, point)
            text = _text_size(rows, dialect)
            tie = dialect.score > best.score * (1 - 1e-9) and text < text_of_best  # words, not pieces of rows
            if dialect.score > best.score * (1 + 1e-9) or tie:
                best, text_of_best = dialect, text
            if point == "." and mark is not None and _is_plain(dialect, filled):
                break
        if mark is not None and _is_plain(best, filled) and best.delimiter == mark:
            break
    if best.score == 0.0:
        raise DataError(
            f"{source}: no row of numbers found in {len(lines)} lines; it begins {filled[0].strip()[:60]!r}. "
            "Give delimiter= and decimal= if there are numbers in it"
            if filled
            else f"{source} holds no text but blank lines; record or copy it again"
        )
    if best.delimiter == "," and best.decimal == "." and delimiter is None and decimal is None:
        _check_comma(filled, best, source)
    return best


def _text_size(rows: Sequence[Sequence[str]], dialect: Dialect) -> int:
    """Number of characters in the columns of text."""
    positions = [k for k, kind in enumerate(dialect.kinds) if kind == cells.TEXT]
    return sum(len(row[k].strip()) for row in rows if len(row) == dialect.width for k in positions) if positions else 0


def _has_rows_of_blanks(filled: Sequence[str], dialect: Dialect) -> bool:
    """Whether blanks part the numbers of some rows, as tabs do those of the others."""
    rows = (line.split() for line in filled if len(split(line, dialect.delimiter)) != dialect.width)
    number = lambda cell: cells.kind(cell, dialect.decimal) == cells.NUMBER
    return any(len(row) == dialect.width and all(map(number, row)) for row in rows)


def _is_plain(dialect: Dialect, filled: Sequence[str]) -> bool:
    """Whether nearly all lines are plain numbers between one mark, so that no other mark can find more of them."""
    head = len(filled) - dialect.rows
    if dialect.delimiter is None or set(dialect.kinds) != {cells.NUMBER} or head > max(3, _HEAD * len(filled)):
        return False
    text = "\n".join(filled[head:])
    return not any(mark in text for mark in {",", ";", "\t", "|", " "} - {dialect.delimiter})


def _sample(lines: Sequence[str]) -> list[str]:
    """Some lines that are not blank: the first ones and others from all over the text."""
    if len(lines) > 20 * SAMPLE:  # enough of them are not blank
        lines = [*lines[:SAMPLE], *lines[SAMPLE :: len(lines) // (10 * SAMPLE)]]
    filled = list(filter(str.strip, lines))
    if len(filled) > SAMPLE:
        step = (len(filled) - _FIRST) / (SAMPLE - _FIRST)
        filled = filled[:_FIRST] + [filled[_FIRST + int(step * k)] for k in range(SAMPLE - _FIRST)]
    size = sum(map(len, filled))
    if size > _MOST:  # long lines: every n-th
        filled = filled[:3] + filled[3 :: -(-size // _MOST)]
    return filled


def _check_comma(filled: Sequence[str], dialect: Dialect, source: str) -> None:
    """Refuse rows such as 0,10,1,20 under the two names "t,y": each comma could be a delimiter or a decimal mark."""
    if dialect.width % 2:
        return
    rows = [split(line, ",") for line in filled]
    rows = [row for row in rows if len(row) == dialect.width and all(cells.kind(c, ".") == cells.NUMBER for c in row)]
    if not rows or any(re.search(r"[.eE]", cell) for row in rows for cell in row):
        return
    tails = [cell.strip() for row in rows for cell in row[1::2]]
    digits = all(tail.isdigit() for tail in tails)
    zeros = any(len(tail) > 1 and tail[0] == "0" for tail in tails)
    half = dialect.width // 2
    spaced = half > 1 and all(len(re.split(r",\s+", line.strip())) == half for line in filled if line[:1].isdigit())
    named = half > 1 and any(
        len(re.split(r"[,;\t]", line.strip())) == half and not re.search(r"\d", line) for line in filled[:8]
    )
    if digits and (zeros or spaced or named):
        raise DataError(
            f"{source}: ambiguous: in {','.join(rows[-1])!r} the comma could be the delimiter or the decimal mark. "
            "Give delimiter=',' if it separates columns, or write the file again with ';' between columns"
        )
