"""How the rows of numbers in a text are written: delimiter, decimal mark, and what each column holds.

Under every pair of delimiter and decimal mark the cells of a sample of lines are told apart (number, missing, time
stamp, text); the pair whose most frequent row pattern holds the most numbers wins.
"""

from __future__ import annotations

import collections
import csv
import dataclasses
import re
from collections.abc import Sequence

from hystfit.errors import DataError
from hystfit.reading import cells

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

    def told(self) -> str:
        """The delimiter and the decimal mark in words."""
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
            found = layout_of(rows, mark, point)
            if found.score > best.score * (1 + 1e-9):
                best = found
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
