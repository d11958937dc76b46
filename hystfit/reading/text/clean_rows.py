"""Rows of plain numbers and nothing else below the header, which a parser in C reads: the same numbers, many times faster."""

from __future__ import annotations

import io
import sys
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from hystfit.reading.limits import SAMPLE
from hystfit.reading.text import cells
from hystfit.reading.text.dialect import Dialect

_LARGEST_WHOLE = 2.0**53  # larger whole numbers are read digit by digit
_TAIL = 1 << 16  # characters at the end that are searched for blanks at a time


def clean_columns(
    text: str, lines: Sequence[str], first: int, dialect: Dialect, *, settled: bool
) -> list[np.ndarray] | None:
    """All columns from line `first` on, each of shape (rows,); None where a line needs a careful reading.

    That is a line with anything but plain finite numbers, or a mark that could separate thousands.

    Args:
        settled: the decimal mark is not a guess.
    """
    if set(dialect.kinds) != {cells.NUMBER}:
        return None
    start = 0
    for _ in range(first):
        start = text.index("\n", start) + 1
    body = text[start : _end_of_rows(text, start)]
    count = np.count_nonzero(np.frombuffer(body.encode(), np.uint8) == ord("\n")) + 1
    if count < 2 or (dialect.decimal == "," and "." in body):
        return None
    if not settled and not _shows_its_mark(lines, first, body, dialect):
        return None
    numbers = _parsed(body, dialect)
    if numbers is None or numbers.shape != (count, dialect.width):
        return None
    if not (np.abs(numbers) <= _LARGEST_WHOLE).all():  # not for NaN either
        return None
    return [np.ascontiguousarray(column) for column in numbers.T]


def _end_of_rows(text: str, start: int) -> int:
    """Where the last line ends that is not blank; `start` where there is none from there on."""
    end = len(text)
    while end > start:
        part = text[max(start, end - _TAIL) : end]
        if filled := len(part.rstrip(" \t,;|\n")):
            found = text.find("\n", end - len(part) + filled)
            return found if found >= 0 else len(text)
        end -= len(part)
    return start


def _shows_its_mark(lines: Sequence[str], first: int, body: str, dialect: Dialect) -> bool:
    """Whether the decimal mark does not occur, or a number from line `first` on proves that it does not separate thousands."""
    if dialect.decimal not in body or (dialect.decimal == "." and not cells.dots_are_doubtful(dialect.delimiter)):
        return True
    return any(
        dialect.decimal in cell and not cells.may_be_thousands(cells.clean(cell), dialect.decimal)
        for line in lines[first : first + SAMPLE]
        for cell in line.split(dialect.delimiter)
    )


def _parsed(body: str, dialect: Dialect) -> np.ndarray | None:
    """Numbers of all rows, shape (rows, columns), correctly rounded; None where a cell is not a number."""
    if "pandas" in sys.modules:  # its parser is three times as fast, but importing it takes longer than reading a file
        return _by_pandas(body, dialect)
    return _by_numpy(body, dialect)


def _by_numpy(body: str, dialect: Dialect) -> np.ndarray | None:
    rows = body.replace(",", ".") if dialect.decimal == "," else body
    try:
        return np.loadtxt(rows.split("\n"), delimiter=dialect.delimiter, comments=None, ndmin=2)
    except ValueError:
        return None


def _by_pandas(body: str, dialect: Dialect) -> np.ndarray | None:
    import pandas as pd

    options: dict[str, Any] = {
        "header": None,
        "na_filter": False,
        "quoting": 3,
        "skip_blank_lines": False,
        "dtype": np.float64,
    }
    if int(pd.__version__.partition(".")[0]) < 3:
        options["float_precision"] = "round_trip"  # later versions always round correctly
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            frame = pd.read_csv(
                io.BytesIO(body.encode()),
                sep=r"\s+" if dialect.delimiter is None else dialect.delimiter,
                decimal=dialect.decimal,
                engine="c",
                low_memory=False,
                **options,
            )
    except Exception:  # of many kinds; the careful reader says what is wrong
        return None
    return frame.to_numpy()
