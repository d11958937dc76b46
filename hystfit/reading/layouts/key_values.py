"""Logs of programs and microcontrollers, in which every number stands behind its name: "t=0.01 V=3.5 pos: 1.2 um"."""

from __future__ import annotations

import collections
import itertools
import re

from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.limits import MOST, OF_RECORD
from hystfit.reading.names.names_with_units import is_unit
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text

_NUMBER = r"[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?|nan|NaN|inf)"
_AFTER = r"\s?[A-Za-zµμ°%Ω][\w/²°µμ%]*(?![\w/]*\"?\s*[=:])"  # a word that is not the name of the next number
_NAME = r"(?<![A-Za-zµμ_])[A-Za-zµμ_][\w.()\[\]/%µμ-]{0,99}+"  # bounded, for lines without blanks
_PAIR = re.compile(rf"({_NAME})\"?\s*[=:]\s*\"?({_NUMBER})(?![\d.:])({_AFTER})?")
_STAMP = re.compile(r"\W*((?:\d{4}-\d\d-\d\d[ T])?\d\d:\d\d:\d\d(?:[.,]\d+)?)")


def read_key_values(text: TextFile) -> Table | None:
    """Logs in which each number stands behind its name (t=0.1 V=3.5 x: 1.2 um), in one line a sample or one line a number."""
    head = [line for line in text.head if line.strip()]
    if len(head) < OF_RECORD:
        return None
    pairs = [_PAIR.findall(line) for line in head]
    least = min(2, max(map(len, pairs)))
    if least == 0 or sum(len(found) >= least for found in pairs) < MOST * len(head):
        return None
    lines = [(line, _PAIR.findall(line)) for line in text.lines if line.strip()]
    rows = _rows_of_lines(lines) if least > 1 else _rows_of_blocks([found for _, found in lines])
    if rows is None or len(rows) < OF_RECORD:
        return None
    stamped = [match[1].replace(",", ".") for line, _ in lines if (match := _STAMP.match(line))] if least > 1 else []
    stamps = stamped if len(stamped) == len(rows) == len(lines) else []
    names = [_titled(name, after) for name, _, after in rows[0]]
    cells = [[number for _, number, _ in row] for row in rows]
    if stamps:
        names, cells = ["time", *names], [[stamp, *row] for stamp, row in zip(stamps, cells, strict=True)]
    table = plain_text(text.of("\n".join("\t".join(row) for row in [names, *cells])))
    notes = [Note(Code.FILE_FORMAT, "numbers behind their names, in one line a sample or one line a number")]
    if least > 1 and (others := len(lines) - len(rows)):
        notes.append(warn(Code.LEFT_OUT, f"left out: {others} lines without the numbers that the other lines have"))
    return table.noted(*notes)


_Pairs = list[tuple[str, str, str]]  # name, number and the word after it


def _titled(name: str, after: str) -> str:
    """The name of a column, with the word after its numbers where that is a unit."""
    return f"{name} [{after.strip()}]" if after and is_unit(after.strip()) else name


def _rows_of_lines(lines: list[tuple[str, _Pairs]]) -> list[_Pairs] | None:
    """The numbers of the lines that have the names which most lines have; None where these are too few."""
    names = collections.Counter(tuple(name for name, _, _ in found) for _, found in lines)
    usual, count = names.most_common(1)[0]
    if len(usual) < 2 or len({*usual}) < len(usual) or count < MOST * len(lines):
        return None
    return [found for _, found in lines if tuple(name for name, _, _ in found) == usual]


def _rows_of_blocks(found: list[_Pairs]) -> list[_Pairs] | None:
    """The numbers of lines that have one each, in which the same names come again and again; None for other lines."""
    pairs = [*itertools.chain.from_iterable(found)]
    names = [name for name, _, _ in pairs]
    period = names.index(names[0], 1) if names[0] in names[1:] else 0
    whole = len(pairs) - len(pairs) % max(period, 1)
    if period < 2 or any(names[k] != names[k % period] for k in range(whole)):
        return None
    return [pairs[k : k + period] for k in range(0, whole, period)]
