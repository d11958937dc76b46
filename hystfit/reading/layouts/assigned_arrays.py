"""Arrays in the source text of programs, "V = [0.1 0.2; ...];" of MATLAB, Python or C, and lists of YAML behind or below their names."""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.layouts.array_table import table_of_arrays
from hystfit.reading.limits import FEWEST, MOST
from hystfit.reading.table.raw_table import Table

_NUMBER = r"[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?|nan|inf)"
# name = [, name = np.array([, name[600] = {, name <- c(, name: [: up to the first number.
_START = re.compile(
    rf"([A-Za-z_][\w.]*)(?:\s*\[\d*\])*\s*(?:<-|=|:)\s*(?:[A-Za-z_][\w.]*\s*)?([\[({{][\[({{\s]*)(?={_NUMBER}[\s,;\])}}])",
    re.IGNORECASE,
)
_LISTED = re.compile(
    rf"^[ \t]*([A-Za-z_]\w*)[ \t]*:[ \t]*\n((?:[ \t]*-[ \t]+{_NUMBER}[ \t]*(?:\n|$))+)", re.MULTILINE | re.IGNORECASE
)
_CONTINUED = re.compile(r"\.\.\.[^\n]*\n")  # MATLAB goes on in the next line
_CLOSING = str.maketrans("[({", "])}")
_LOOKED_AT = 4000  # characters in which the first array begins


def read_assigned_arrays(text: TextFile) -> Table | None:
    """Arrays in the text of a program (V = [1, 2, ...] of MATLAB, Python, C or R), and lists of YAML, each a column under its name."""
    content = _CONTINUED.sub(" ", text.content)
    head = content[:_LOOKED_AT]
    found = _assigned(content) if _START.search(head) else _listed(content) if _LISTED.search(head) else []
    arrays = {name: array for name, array, _ in found if array is not None and array.shape[0] >= FEWEST}
    if not arrays or sum(size for _, _, size in found) < MOST * len(content.strip()):
        return None
    note = Note(Code.FILE_FORMAT, "arrays behind their names, as programs write them")
    table = table_of_arrays(arrays, text.source, text.sha256, (*text.notes, note))
    return dataclasses.replace(table, named=len(arrays) > 1)


_Array = tuple[str, np.ndarray | None, int]  # name, numbers, and the characters that they take


def _assigned(content: str) -> list[_Array]:
    """The arrays behind equals signs."""
    found, place = [], 0
    while match := _START.search(content, place):
        opened = "".join(match[2].split())
        closing = opened[0].translate(_CLOSING)
        inner = opened[1:]
        end = re.compile(re.escape(closing)).search(content, match.end())
        if inner:  # rows within brackets of their own: the last of them closes directly before the array does
            end = re.compile(rf"[\])}}][\s,;]*{re.escape(closing)}").search(content, match.end())
        if end is None:
            break
        found.append(
            (match[1], _array(content[match.end() : end.start()], nested=bool(inner)), end.end() - match.start())
        )
        place = end.end()
    return found


def _array(body: str, *, nested: bool) -> np.ndarray | None:
    """The numbers between brackets, a vector or a matrix of rows; None where they are no numbers or rows of different lengths."""
    parts = re.split(r"[\])}]\s*,?\s*[\[({]", body) if nested else re.split(r"[;\n]", body)
    try:
        rows = [[float(cell) for cell in part.replace(",", " ").split()] for part in parts]
    except ValueError:
        return None
    rows = [row for row in rows if row]
    if len({len(row) for row in rows}) > 1:  # a vector over several lines
        return None if nested or ";" in body else np.concatenate([np.array(row) for row in rows])
    array = np.array(rows)
    wrapped = not nested and "," in body and "\n" in body and ";" not in body  # a list of several numbers in a line
    return array.ravel() if wrapped or 1 in array.shape else array


def _listed(content: str) -> list[_Array]:
    """The lists of YAML."""
    return [
        (match[1], np.array([float(line.split()[1]) for line in match[2].splitlines()]), len(match[0]))
        for match in _LISTED.finditer(content)
    ]
