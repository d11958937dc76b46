"""Texts of several tables after each other, each with its own header: as aixACCT writes a summary first and then every measurement.

Tables of the same columns are records, named by their titles, with the settings and stated results above each. The tables of which there
is most are read; a table with one row for each of these records and columns of results, such as a summary, states results too.
"""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Sequence

import numpy as np

from hystfit.errors import DataError
from hystfit.outcome import Code, Note, Severity
from hystfit.outcome.wrapping import listed
from hystfit.reading.files.text_file import HEAD, TextFile
from hystfit.reading.limits import ABOVE, FEWEST, MAJORITY, MOST_CURVES
from hystfit.reading.names.column_names import column_quantity
from hystfit.reading.table.raw_table import Part, Table, below_each_other, one_loop
from hystfit.reading.text.dialect import Dialect, sniff, split
from hystfit.reading.text.header import read_header, sample_properties, setting_of
from hystfit.reading.text.plain_text import plain_text
from hystfit.reading.text.stated_results import result_of

_BLANK, _NUMBERS, _WORDS = 0, 1, 2  # what a line begins with
_LOOKED_AT = 20  # rows of a table by which a first column is seen to go on
_TITLE = 60  # characters of a title


@dataclasses.dataclass(frozen=True)
class _Piece:
    """Lines of one table: where those above it, its numbers, and the next table begin; its rows; and lines of its header."""

    above: int
    first: int
    stop: int
    rows: int
    header: tuple[str, ...]


def read_tables(text: TextFile) -> Table | None:
    """Tables after each other: each of the same columns a record, with the settings and results above it."""
    pieces = _pieces(text)
    if not _are_tables(text, pieces):
        return None
    tables = {k: table for k, piece in enumerate(pieces) if (table := _table(text, piece)) is not None}
    settings = [
        k for k, table in tables.items() if table.line[0] <= pieces[k].first
    ]  # their rows are lines of a header
    if len(tables) == len(settings) or (settings and len(pieces) - len(settings) < 2):
        return None
    tables = {k: table for k, table in tables.items() if k not in settings}
    chosen = _alike(tables)
    rest = [piece for k, piece in enumerate(pieces) if k not in chosen]
    parts = [_part(text, pieces[k], tables[k]) for k in chosen]
    parts = _with_summary(text, _with_names(parts, [_lines_above(text, pieces[k]) for k in chosen]), rest)
    notes = [*tables[chosen[0]].notes]
    notes += [
        note for k in chosen[1:] for note in tables[k].notes if note.severity is not Severity.INFO and note not in notes
    ]
    loop = one_loop([part.name for part in parts], [tables[k] for k in chosen])
    if len(chosen) > 1 and loop is None:
        notes.append(Note(Code.CURVES, f"{len(chosen)} tables of the same columns after each other, each a record"))
    if rest:
        lines = listed([f"line {piece.first + 1}" for piece in rest])
        notes.append(Note(Code.LEFT_OUT, f"left out: tables of other columns or of a few rows: {lines}"))
    top = [line for line in text.lines[: pieces[0].first] if line.strip() not in pieces[0].header]
    common = sample_properties(top, tables[chosen[0]].names)
    if loop is not None:
        return dataclasses.replace(loop, notes=tuple(notes), metadata=common | loop.metadata)
    table = below_each_other([tables[k] for k in chosen], parts) if len(chosen) > 1 else tables[chosen[0]]
    return dataclasses.replace(table, parts=tuple(parts), notes=tuple(notes), metadata=common | table.metadata)


def _alike(tables: dict[int, Table]) -> list[int]:
    """Which tables have most of their names in common with those that hold most rows; they keep the names that all of them have.

    A table of a few rows, such as the largest and smallest values, is no record.
    """
    groups: dict[frozenset[str], list[int]] = {}
    for k, table in tables.items():
        groups.setdefault(frozenset(table.names), []).append(k)
    main = max(groups, key=lambda names: sum(tables[k].rows for k in groups[names]))
    least = min(FEWEST, max(tables[k].rows for k in groups[main]))
    of_main = lambda names: len(main & names) > MAJORITY * len(main | names)
    chosen = [k for k, table in tables.items() if table.rows >= least and of_main({*table.names})]
    common = frozenset.intersection(*(frozenset(tables[k].names) for k in chosen))
    if len(common) < 2 or any(len(common) < len({*tables[k].names}) < len(tables[k].names) for k in chosen):
        return groups[main]
    for k in chosen:
        if len(common) < len(tables[k].names):
            tables[k] = tables[k].select([j for j, name in enumerate(tables[k].names) if name in common])
    return chosen


def _line_kinds(text: TextFile) -> np.ndarray:
    """What each line begins with after blanks, quotes and empty cells: nothing, a number, or words; shape (lines,)."""
    raw = np.frombuffer(text.content.encode("utf-8", "surrogatepass") + b"\n\n", np.uint8)
    starts = np.append(0, np.flatnonzero(raw == ord("\n")) + 1)[: len(text.lines)]
    skipped = np.isin(np.arange(256), [ord(c) for c in " \t\"',;|"])
    while (blank := skipped[raw[starts]]).any():
        starts = starts + blank
    kinds = np.full(256, _WORDS)
    kinds[[ord(c) for c in "0123456789+-."]] = _NUMBERS
    kinds[0xE2] = _NUMBERS  # first byte of the minus sign U+2212
    kinds[ord("\n")] = _BLANK
    ruled = (raw[starts] == ord("-")) & (raw[starts + 1] == ord("-"))  # a rule below the names or the rows
    return np.where(ruled, _BLANK, kinds[raw[starts]])


def _pieces(text: TextFile) -> list[_Piece]:
    """The tables of a text: numbers below a header of as many names; numbers below other words go on with the table before."""
    kinds = _line_kinds(text)
    numbers, words = np.flatnonzero(kinds == _NUMBERS), np.flatnonzero(kinds == _WORDS)
    runs = np.searchsorted(words, numbers)  # lines of words before each line of numbers
    firsts = np.flatnonzero(np.diff(runs, prepend=-1))
    if not 1 < firsts.size <= MOST_CURVES:
        return []
    counts = np.diff(np.append(firsts, numbers.size))
    longest = int(numbers[firsts[np.argmax(counts)]])
    try:
        sample = text.lines[longest : longest + HEAD]
        dialect = sniff(sample, text.source, text.opening.delimiter, text.opening.decimal)
    except DataError:
        return []
    found: list[_Piece] = []
    for k, count in zip(firsts.tolist(), counts.tolist(), strict=True):
        first, stop = int(numbers[k]), int(numbers[k + count - 1]) + 1
        above = found[-1].stop if found else 0
        header = _header(text.lines[max(above, first - ABOVE) : first], text.lines[first], dialect)
        width = lambda line: len(split(text.lines[line].rstrip("\t ;,"), dialect.delimiter))
        if found and _is_remark(header, found[-1].header) and width(first) == width(found[-1].first):
            header = ()
        if header or not found:
            found.append(_Piece(above, first, stop, count, header))
        else:
            found[-1] = dataclasses.replace(found[-1], stop=stop, rows=found[-1].rows + count)
    return [piece for piece in found if piece.header]


def _header(above: Sequence[str], row: str, dialect: Dialect) -> tuple[str, ...]:
    """The lines of names and units directly above a row of numbers; () without one."""
    width = len(split(row.rstrip("\t ;,"), dialect.delimiter))
    if width < 2:
        return ()
    used = read_header([line.rstrip("\t ;,") for line in above], width, dialect.delimiter, dialect.decimal, {})[2]
    return tuple(line.strip() for line in [line for line in above if line.strip()][-used:]) if used else ()


def _is_remark(header: Sequence[str], before: Sequence[str]) -> bool:
    """Whether lines between rows are words about them, as no word is a quantity, unlike those of the header before."""
    return bool(header and before) and not _quantities(header[0]) and bool(_quantities(before[0]))


def _quantities(header: str) -> set[str]:
    """Physical quantities of the names in a line."""
    return {*map(column_quantity, re.split(r"[\t,;|]|\s+", header))} - {""}


def _are_tables(text: TextFile, pieces: Sequence[_Piece]) -> bool:
    """Whether the pieces are tables of their own, and not one whose header is repeated on every page while its first column goes on."""
    if max((piece.rows for piece in pieces), default=0) < FEWEST or len(pieces) < 2:
        return False
    if len({piece.header for piece in pieces}) > 1:
        return any(_quantities(piece.header[0]) for piece in pieces)  # else they are remarks
    between = [line for piece in pieces[1:] for line in text.lines[piece.above : piece.first] if line.strip()]
    if len(between) == sum(len(piece.header) for piece in pieces[1:]):
        return False
    first = lambda k: re.match(r"[\s\"]*([+-]?[\d.]+(?:[eE][+-]?\d+)?)", text.lines[k])
    found = [first(k) for piece in pieces for k in np.linspace(piece.first, piece.stop - 1, _LOOKED_AT, dtype=int)]
    values = [float(match[1]) if match else 0.0 for match in found]
    return any(a > b for a, b in itertools.pairwise(values))


def _table(text: TextFile, piece: _Piece) -> Table | None:
    """One table with the lines above it; None where these lines are no table."""
    lines = text.lines[piece.above : piece.stop]
    try:
        table = plain_text(dataclasses.replace(text, content="\n".join(lines) + "\n"))
    except DataError:
        return None
    last = [column[-1] for column in table.columns]
    if any(table.take(np.arange(table.rows - 1)).counts(k) for k in range(len(last))) and not any(last):
        table = table.take(np.arange(table.rows - 1))  # a row of zeros below the numbered ones is an end mark
    return dataclasses.replace(table, line=table.line + piece.above)


def _part(text: TextFile, piece: _Piece, table: Table) -> Part:
    """Title, properties and stated results above a table."""
    titles = [line for line in _lines_above(text, piece) if setting_of(line) is None]
    title = titles[-1] if titles else ""
    title = title[1:-1] if title.startswith("[") and title.endswith("]") else title
    return Part(title, table.metadata, table.whole.stated)


def _lines_above(text: TextFile, piece: _Piece) -> list[str]:
    """The short lines above the header of a table, without marks around them."""
    above = [line.strip() for line in text.lines[piece.above : piece.first] if line.strip()]
    short = [line for line in above[: len(above) - len(piece.header)] if len(line) <= _TITLE]
    bare = [re.sub(r"^[#%*<>=\s-]+|[*<>=:\s-]+$", "", line) for line in short]
    return [re.sub(r"\s+", " ", title) for title in bare if title]


def _with_names(parts: Sequence[Part], above: Sequence[Sequence[str]]) -> list[Part]:
    """The parts with a name each: their titles where these differ, else the settings of each in the same line above, else their numbers.

    What was set has fewer digits than what was measured then: "Bm = 0.1 T" before "Pcv = 8.360 kW/m3".
    """
    titles = [part.name for part in parts]
    settings = sorted(zip(*(reversed(lines) for lines in above), strict=False), key=lambda names: max(map(len, names)))
    for names in (titles, *settings):
        if len({*names, ""}) == len(parts) + 1:
            return [dataclasses.replace(part, name=name) for part, name in zip(parts, names, strict=True)]
    return [dataclasses.replace(part, name=f"table={k}") for k, part in enumerate(parts, start=1)]


def _with_summary(text: TextFile, parts: Sequence[Part], others: Sequence[_Piece]) -> list[Part]:
    """The parts with the results of a table that has a row for each of them, beside those that stand above their own tables."""
    stated = [{one.label: one for one in part.stated} for part in parts]
    for piece in others:
        names = _cells(piece.header[0])
        rows = [_cells(line) for line in text.lines[piece.first : piece.stop] if line.strip()]
        for known, row in zip(stated, rows if len(rows) == len(parts) else (), strict=False):
            found = (result_of(name, cell.replace(",", ".")) for name, cell in zip(names, row, strict=False))
            known |= {one.label: one for one in found if one is not None and one.label not in known}
    return [dataclasses.replace(part, stated=tuple(known.values())) for part, known in zip(parts, stated, strict=True)]


def _cells(line: str) -> list[str]:
    """Cells of a line of a summary, in which the numbers are no more than that."""
    return split(line.strip(), next((mark for mark in ("\t", ";", ",") if mark in line), None))
