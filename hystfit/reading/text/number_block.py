"""The rows of numbers in a text: those that have the dialect's cells, without what only resembles them."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

import numpy as np

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading.files.text_file import HEAD
from hystfit.reading.limits import BESIDE, FEW
from hystfit.reading.text import cells
from hystfit.reading.text.clean_rows import clean_columns
from hystfit.reading.text.dialect import Dialect, Text, split

# Rows of a header that hold a number for each channel: samples, scale, offset, start and step of LabVIEW.
_SETTINGS = 12
# A line that parts the header from the numbers: ***End_of_Header***, # END_HEADER, @@Data, [Data], ***DATA***.
_MARK = re.compile(r"\W*(?:end[ _]?(?:of[ _]?)?header|(?:begin|start)?[ _]?data)\W*", re.IGNORECASE)
_COMMENT_MARKS = ("#", "%", "//", "!")


def is_comment(line: str) -> bool:
    """Whether a line begins with a comment mark."""
    return line.lstrip().startswith(_COMMENT_MARKS)


def is_mark(line: str) -> bool:
    """Whether a line says that the header ends there or that the numbers begin."""
    return _MARK.fullmatch(line) is not None


@dataclasses.dataclass(frozen=True)
class Block:
    """The rows of numbers.

    Attributes:
        index: numbers of their lines, shape (rows,).
        values: numbers of every column, shape (rows,); None for text and stamps.
        cells: of every column, where they are needed; else empty.
        rows: cells of the lines, at least of those above and at the first row.
        ragged: numbers of lines of another width.
        notes: on cells that are not numbers.
    """

    index: np.ndarray
    values: list[np.ndarray | None]
    cells: list[list[str]]
    rows: list[list[str]]
    ragged: list[int]
    notes: tuple[Note, ...] = ()


def clean_block(text: Text, content: str) -> Block | None:
    """The rows of numbers where nothing but plain numbers follows the first of them, in the `content` of a file; None elsewhere."""
    lines, dialect = text.lines, text.dialect
    rows = [split(line, dialect.delimiter) for line in lines[:HEAD]]
    candidates, _ = _of_width(rows, dialect)
    if not candidates:
        return None
    _, fits, _ = _parse_columns(list(zip(*[rows[k] for k in candidates], strict=True)), dialect)
    if not fits.any():
        return None
    first = candidates[int(np.argmax(fits))]
    columns = clean_columns(content, lines, first, dialect, settled=text.settled)
    if columns is None:
        return None
    return Block(first + np.arange(columns[0].size), [*columns], [], rows, [])


def careful_block(text: Text, rows: list[list[str]]) -> Block:
    """The rows of numbers, from the cells of every line."""
    lines, dialect = text.lines, text.dialect
    candidates, ragged = _of_width(rows, dialect)
    columns = list(zip(*[rows[k] for k in candidates], strict=True))
    if not columns:
        raise DataError(f"{text.source}: no row of numbers found; a loop needs at least two")
    values, fits, spoiled = _parse_columns(columns, dialect)
    spoiled &= np.array([not is_comment(lines[k]) for k in candidates])
    keep = fits | spoiled
    index = np.array(candidates)[keep]
    keep[keep] = _main_runs(rows, index, dialect, lines)
    index, above = np.array(candidates)[keep], 0
    if index.size:
        above = _above_header(rows, lines, index, dialect) or _above_mark(lines, index)
        settings = 0 if above else _settings(rows, index, dialect)
        keep[np.flatnonzero(keep)[:settings]] = False
        index = index[settings:]
        keep[np.flatnonzero(keep)[:above]] = False
        index = index[above:]
    if index.size < 2:
        raise DataError(f"{text.source}: only {index.size} row of numbers found; a loop needs at least two")
    kept = np.flatnonzero(keep)
    chosen = [[column[k] for k in kept] for column in columns]
    notes = _spoiled_notes(rows, np.array(candidates)[keep & spoiled], dialect)
    if above:
        notes.append(warn(Code.LEFT_OUT, f"left out: {above} rows of numbers above the header"))
    return Block(index, [v if v is None else v[keep] for v in values], chosen, rows, ragged, tuple(notes))


def _of_width(rows: list[list[str]], dialect: Dialect) -> tuple[list[int], list[int]]:
    """Rows of the dialect's width, and others; empty cells at the end are cut or added where they mean nothing."""
    width = dialect.width
    last = max(k for k, kind in enumerate(dialect.kinds) if kind != cells.MISSING) + 1
    fit, ragged = [], []
    for k, row in enumerate(rows):
        if len(row) != width:
            filled = len(row)
            while filled and not row[filled - 1].strip():
                filled -= 1
            if filled == 0:
                continue
            if filled != last and not _with_remark(row[:filled], dialect):
                ragged.append(k)
                continue
            rows[k] = row[:width] + [""] * (width - len(row))
        fit.append(k)
    return fit, ragged


def _with_remark(row: list[str], dialect: Dialect) -> bool:
    """Whether a row of numbers is followed by a text, such as the event at that sample, or by a comment of any length."""
    width = dialect.width
    commented = len(row) > width and row[width].startswith(_COMMENT_MARKS)
    if not width < len(row) <= width + BESIDE and not commented:
        return False
    kinds = [cells.kind(cell, dialect.decimal) for cell in row]
    misplaced = any(kind == cells.TEXT != of for kind, of in zip(kinds, dialect.kinds, strict=False))
    return (
        not misplaced
        and cells.NUMBER in kinds[:width]
        and (commented or {*kinds[width:]} <= {cells.TEXT, cells.MISSING})
    )


def _parse_columns(
    columns: list[tuple[str, ...]], dialect: Dialect
) -> tuple[list[np.ndarray | None], np.ndarray, np.ndarray]:
    """Numbers of every column (None for text and stamps), which rows are rows of numbers, and which but for a word in a cell."""
    count = len(columns[0])
    stamped, short = np.ones(count, dtype=bool), np.ones(count, dtype=bool)
    any_number, spoiled = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    leading: np.ndarray | None = None
    set_out, lacking = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)  # rows of tables that hold this one
    values: list[np.ndarray | None] = []
    for column, kind in zip(columns, dialect.kinds, strict=True):
        numbers = None
        if kind == cells.STAMP:
            stamped &= np.array([cells.is_stamp(cells.clean(cell)) for cell in column])
        elif kind != cells.TEXT:
            numbers, kinds = cells.parse(column, dialect.decimal)
            if kind == cells.NUMBER:
                any_number |= kinds == cells.NUMBER
                text = kinds == cells.TEXT
                leading = kinds == cells.NUMBER if leading is None else leading
                lacking |= kinds == cells.MISSING
                spoiled |= text
                short[text] &= np.array([cells.is_word(column[k]) for k in np.flatnonzero(text)], dtype=bool)
            elif leading is None:
                set_out |= kinds == cells.NUMBER  # a text is a comment
        values.append(numbers)
    fits = stamped & any_number & ~spoiled & ~(set_out & lacking)
    below = np.arange(count) > (np.argmax(fits) if fits.any() else count)
    return values, fits, stamped & spoiled & short & below & (np.zeros(count, bool) if leading is None else leading)


def _spoiled_notes(rows: Sequence[Sequence[str]], spoiled: np.ndarray, dialect: Dialect) -> list[Note]:
    """A note on words in place of numbers."""
    if not spoiled.size:
        return []
    is_text = lambda cell, kind: kind == cells.NUMBER and cells.kind(cell, dialect.decimal) in (cells.TEXT, cells.STAMP)
    first = next(cell for cell, kind in zip(rows[spoiled[0]], dialect.kinds, strict=True) if is_text(cell, kind))
    text = f"words in place of numbers are treated as missing values: {spoiled.size} rows, the first with {first.strip()!r}"
    return [warn(Code.MISSING_VALUES, f"{text} in line {spoiled[0] + 1}")]


def _above_header(rows: Sequence[Sequence[str]], lines: Sequence[str], index: np.ndarray, dialect: Dialect) -> int:
    """Number of rows of numbers that stand above the header, which is followed by many more."""
    if index[0] and lines[index[0] - 1].strip():
        return 0
    top = int(np.argmax(np.diff(index) > 1)) + 1 if (np.diff(index) > 1).any() else index.size
    if top > FEW or index.size - top <= 2 * top:
        return 0
    between = range(index[top - 1] + 1, index[top])
    if not all(lines[k].strip() for k in between):
        return 0
    is_name = lambda cell: cells.kind(cell, dialect.decimal) == cells.TEXT
    headers = [k for k in between if len(rows[k]) == dialect.width and all(map(is_name, rows[k]))]
    return top if headers and len(headers) == len(between) else 0


def _settings(rows: Sequence[Sequence[str]], index: np.ndarray, dialect: Dialect) -> int:
    """Number of rows above the table with a word in a column that is empty in its rows: "HResolution", 0.001, 0.001."""
    empty = [k for k, kind in enumerate(dialect.kinds) if kind == cells.MISSING]
    words = lambda row: any(cells.kind(row[k], dialect.decimal) == cells.TEXT for k in empty)
    count = next((n for n, k in enumerate(index) if not words(rows[k])), 0)
    return count if count and index[count] - index[count - 1] > 1 else 0


def _above_mark(lines: Sequence[str], index: np.ndarray) -> int:
    """Number of rows of numbers that stand above the line that ends the header, which is followed by many more."""
    marks = [k for k in range(int(index[0]), int(index[0]) + HEAD) if k < len(lines) and is_mark(lines[k])]
    above = int(np.searchsorted(index, marks[-1])) if marks else 0
    return above if above <= _SETTINGS and index.size - above > 2 * above else 0


def _main_runs(rows: list[list[str]], index: np.ndarray, dialect: Dialect, lines: Sequence[str]) -> np.ndarray:
    """Which rows belong with the longest run: a run that shares none of its tags (text cells) does not."""
    tags = [k for k, kind in enumerate(dialect.kinds) if kind == cells.TEXT]
    keep = np.ones(index.size, dtype=bool)
    tags = [k for k in tags if index.size and not cells.are_clocks([rows[index[0]][k]])]
    if not tags or index.size < 2:
        return keep
    starts = np.flatnonzero(np.diff(index, prepend=-2) > 1)

    def apart(k: int) -> bool:
        unmeasured = len(rows[k]) == dialect.width and all(
            cells.is_missing(cells.clean(cell))
            for cell, kind in zip(rows[k], dialect.kinds, strict=True)
            if kind == cells.NUMBER
        )
        return bool(lines[k].strip()) and not is_comment(lines[k]) and not unmeasured

    starts = np.array([s for s in starts if s == 0 or any(map(apart, range(index[s - 1] + 1, index[s])))])
    ends = np.append(starts[1:], index.size)
    column = np.array([cells.clean(rows[k][tags[0]]) for k in index])
    longest = int(np.argmax(ends - starts))
    main = set(column[starts[longest] : ends[longest]])
    for start, end in zip(starts, ends, strict=True):
        if not main.intersection(column[start:end]):
            keep[start:end] = False
    return keep
