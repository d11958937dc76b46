"""Text files as laboratories write them: their block of numbers as a `Table`.

General CSV readers fail on most such files, so the block of numbers is searched for. Under every pair of delimiter and decimal mark
the cells of a sample of lines are classified (number, missing, time stamp, text); the pair whose most frequent row pattern holds
the most numbers wins. A file that can be read in two ways is refused, with the argument that settles it.
"""

from __future__ import annotations

import contextlib
import dataclasses
import gc
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading import cells
from hystfit.reading.encodings import decode
from hystfit.reading.file_bytes import load
from hystfit.reading.header import sample_properties
from hystfit.reading.instruments import micromag_columns, waveform_units
from hystfit.reading.layout import Layout, Text, apart, sniff, split
from hystfit.reading.lines import check_lengths, lines_of
from hystfit.reading.number_block import Block, careful_block, clean_block
from hystfit.reading.other_lines import header_of, left_out
from hystfit.reading.raw_table import Table

_MOST_COLUMNS = 5000
_FIRST = 30  # lines that may hold names


def read_table(
    path: str | Path, *, delimiter: str | None = None, decimal: str | None = None, encoding: str | None = None
) -> Table:
    """All columns of a text file.

    Args:
        delimiter, decimal, encoding: detected where None.
    """
    file, source = load(path), str(path)
    content, notes = decode(file.raw, source, encoding)
    check_lengths(content, source)
    with _without_collection():
        text, block, more = _block_of(content, source, delimiter, decimal)
        return table_of_block(text, block, file.sha256, [*file.notes, *notes, *more])


def _block_of(content: str, source: str, delimiter: str | None, decimal: str | None) -> tuple[Text, Block, list[Note]]:
    """The lines with their layout, the block of numbers among them, and what was assumed of the layout."""
    lines, touching, notes = _without_broken_names(lines_of(content)), 0, []
    try:
        layout = sniff(lines, source, delimiter, decimal)
    except DataError:
        lines, touching = apart(lines)
        if delimiter is not None or not touching:
            raise
        layout = sniff(lines, source, delimiter, decimal)
    if layout.width > _MOST_COLUMNS:
        raise DataError(
            f"{source}: {layout.width} columns, and {_MOST_COLUMNS} are the most; write one sample in a line"
        )
    text = Text(lines, layout, source, settled=decimal is not None)
    block = clean_block(text, content)
    if block is None:
        lines = list(lines)
        if layout.delimiter is None and not touching:
            lines, touching = apart(lines)
            layout = sniff(lines, source, delimiter, decimal) if touching else layout
        if touching:
            words = f"columns that touch are separated before the minus sign: {touching} lines"
            notes.append(Note(Code.FILE_FORMAT, words))
        text = dataclasses.replace(text, lines=lines, layout=layout)
        block = careful_block(text, [split(line, layout.delimiter) for line in lines])
    return text, block, [*notes, Note(Code.FILE_FORMAT, layout.words())]


@contextlib.contextmanager
def _without_collection() -> Iterator[None]:
    """No search for cycles among millions of new rows, which have none and which it would visit again and again."""
    active = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if active:
            gc.enable()


def _without_broken_names(lines: Sequence[str]) -> Sequence[str]:
    """The lines; a name that is quoted over several of the first ones stands in the last of these, and the others are blank."""
    if not any(line.count('"') % 2 for line in lines[:_FIRST]):
        return lines
    lines, start = list(lines), 0
    while start < min(len(lines), _FIRST):
        end = start
        if lines[start].count('"') % 2:
            end = next((k for k in range(start + 1, min(start + 10, len(lines))) if lines[k].count('"') % 2), start)
            if end > start:
                lines[end] = " ".join(lines[start : end + 1])
                lines[start:end] = [""] * (end - start)
        start = end + 1
    return lines


def table_of_block(text: Text, block: Block, sha256: str, notes: Sequence[Note]) -> Table:
    """The table of a block of numbers and the lines around it."""
    lines, layout, index = text.lines, text.layout, block.index
    notes = [*notes, *block.notes]
    if not text.settled:
        notes += _check_thousands(text, block)
    clocks = _clocks(block.cells, layout)
    header = header_of(text, block, [k for extra in clocks.values() for k in extra])
    names, units, named = header.names, header.units, header.used > 0
    above = lines[: int(index[0])]
    metadata = sample_properties(above, names)
    if not named and (micromag := micromag_columns(above)) and len(names) == len(micromag):
        (names, units), named = zip(*micromag, strict=True), True
    if not any(units):
        units = waveform_units(above, names)
    others = left_out(text, block, header)
    notes += others.notes
    if metadata:
        listed = ", ".join(f"{key} {value}" for key, value in metadata.items())
        notes.append(Note(Code.FILE_FORMAT, f"properties of the sample in the header: {listed}"))
    shown = [name or f"column {k}" for k, name in enumerate(names)]
    numbers, labels, stamps, more = _columns(text, block, clocks, shown)
    notes += more
    notes += _doubtful_first_row(text, block, numbers, labels, named=named)
    return Table(
        names=tuple(shown),
        units=tuple("s" if k in stamps else unit for k, unit in enumerate(units)),
        columns=tuple(numbers),
        labels=labels,
        curve=_curves(index, lines, notes),
        section=others.section,
        line=index + 1,
        source=text.source,
        sha256=sha256,
        named=named,
        stamps=frozenset(stamps),
        notes=tuple(notes),
        left_out=others.count,
        unread=others.unread,
        metadata=metadata,
        sectioned=any(line.strip(" ,;\t").lower() == "[data]" for line in above),
    )


def _columns(
    text: Text, block: Block, clocks: dict[int, tuple[int, ...]], names: Sequence[str]
) -> tuple[list[np.ndarray], dict[int, np.ndarray], set[int], list[Note]]:
    """Numbers of every column, text by position, positions of time stamps, and notes.

    `clocks` has the positions of the time of day that belongs to the date in a column, by the position of the date.
    """
    stamps, labels, numbers = set(), {}, []
    notes: list[Note] = []
    for position, kind in enumerate(text.layout.kinds):
        parsed = block.values[position]
        column = np.full(block.index.size, np.nan) if parsed is None else parsed
        date = next((k for k, extra in clocks.items() if position in extra), None)
        if kind == cells.STAMP and date is None:
            parts = [block.cells[k] for k in (position, *clocks.get(position, ()))]
            stamped = [" ".join(part) for part in zip(*parts, strict=True)] if len(parts) > 1 else parts[0]
            column, assumed = cells.seconds(stamped, f"{text.source}, {names[position]!r}")
            stamps.add(position)
            words = f"{names[position]!r}: time stamps converted to seconds from the first one"
            beside = "; the time of day is in the next column" if len(parts) > 1 else ""
            notes += [Note(Code.FILE_FORMAT, words + beside), *assumed]
        elif date is not None:
            column = numbers[date]
            stamps.add(position)
        elif kind == cells.TEXT:
            labels[position] = np.array([cells.clean(cell) for cell in block.cells[position]])
        elif np.nanmax(np.abs(column), initial=0.0) > 2.0**53 and block.cells:
            whole = cells.whole_from_first(block.cells[position])
            if whole is not None:
                column = whole
                words = f"too large for a double, stored as differences to {block.cells[position][0]}"
                notes.append(Note(Code.FILE_FORMAT, f"{names[position]!r}: {words}"))
        numbers.append(column)
    empty = [k for k, column in enumerate(numbers) if k not in labels and np.isnan(column).all()]
    if empty:
        numbered = ", ".join(map(str, empty))
        notes.append(Note(Code.LEFT_OUT, f"empty columns are not used: {numbered} (numbered from 0)"))
    return numbers, labels, stamps, notes


def _doubtful_first_row(
    text: Text,
    block: Block,
    numbers: Sequence[np.ndarray],
    labels: dict[int, np.ndarray],
    *,
    named: bool,
) -> list[Note]:
    """A warning where the first row may be a header of numbers: 0, 1, 2, or whole numbers above decimals."""
    if named or labels or len(numbers) < 2 or block.index.size < 4:
        return []
    first = [column[0] for column in numbers]
    if len(numbers) > 2 and (first == list(range(len(first))) or first == list(range(1, len(first) + 1))):
        words = "the first row is 0, 1, ... and was read as data; delete it if it numbers the columns"
        return [warn(Code.FILE_FORMAT, words)]
    top, *below = [split(text.lines[k], text.layout.delimiter) for k in block.index[:50]]
    decimals = lambda row: sum(text.layout.decimal in cell for cell in row)
    if decimals(top) == 0 and all(decimals(row) >= len(numbers) - 1 and decimals(row) > 0 for row in below):
        words = "the first row holds whole numbers and the others decimals; it was read as data: delete it if it is a header"
        return [warn(Code.FILE_FORMAT, words)]
    return []


def _clocks(columns: Sequence[Sequence[str]], layout: Layout) -> dict[int, tuple[int, ...]]:
    """Columns that hold the time of day, and AM or PM, of the date in the column before, by the position of the date."""
    found: dict[int, tuple[int, ...]] = {}
    for k, kind in enumerate(layout.kinds):
        if kind != cells.STAMP or k + 1 >= layout.width or layout.kinds[k + 1] not in (cells.STAMP, cells.TEXT):
            continue
        if not cells.are_dates(columns[k]) or not cells.are_clocks(columns[k + 1]):
            continue
        halves = k + 2 < layout.width and {cells.clean(cell).upper() for cell in columns[k + 2]} <= {"AM", "PM"}
        found[k] = (k + 1, k + 2) if halves else (k + 1,)
    return found


def _check_thousands(text: Text, block: Block) -> list[Note]:
    """Notes on marks that could separate thousands; none for clean rows, where the decimal mark showed itself."""
    layout, columns = text.layout, block.cells
    numbers = [k for k, kind in enumerate(layout.kinds) if kind == cells.NUMBER] if columns else []
    evidence = {k: cells.thousands(columns[k], layout.decimal) for k in numbers}
    proven = any(marks[2] for marks in evidence.values())
    certain = any(marks[3] for marks in evidence.values())
    doubt = next((k for k, marks in evidence.items() if marks[0] or (marks[1] and not certain)), None)
    other = "," if layout.decimal == "." else "."
    if doubt is None:
        return _doubtful_dots([columns[k] for k in numbers], layout)
    mark = other if evidence[doubt][0] else layout.decimal
    row = next(k for k, cell in enumerate(columns[doubt]) if mark in cell)
    cell = columns[doubt][row].strip()
    if proven:
        words = f"the {other!r} separates thousands, as in {cell!r}; if it is the decimal mark give decimal={other!r}"
        return [Note(Code.FILE_FORMAT, f"{words} (--decimal {other})")]
    raise DataError(
        f"{text.source}, line {block.index[row] + 1}: ambiguous: in {cell!r} the {mark!r} could be "
        "the decimal mark or separate thousands; give decimal='.' or decimal=',' (--decimal, decimal=)"
    )


def _doubtful_dots(columns: Sequence[Sequence[str]], layout: Layout) -> list[Note]:
    """A warning where every decimal point could separate thousands, as in 12.345 between semicolons."""
    if layout.decimal != "." or not cells.dots_are_doubtful(layout.delimiter):
        return []
    dotted = ""
    for cell in (cell for column in columns for cell in column if "." in cell):
        dotted = cells.clean(cell)
        if not cells.may_be_thousands(dotted, "."):
            return []
    if not dotted:
        return []
    text = (
        f"the '.' in numbers such as {dotted!r} is read as the decimal mark; if it separates thousands give decimal=','"
    )
    return [warn(Code.FILE_FORMAT, f"{text} (--decimal ,)")]


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
