"""Text files as laboratories write them: their block of numbers as a `Table`.

General CSV readers fail on most such files, so the block of numbers is searched for. Under every pair of delimiter and decimal mark
the cells of a sample of lines are classified (number, missing, time stamp, text); the pair whose most frequent row pattern holds
the most numbers wins. A file that can be read in two ways is refused, with the argument that settles it.
"""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import re
from collections.abc import Iterator, Sequence

import numpy as np

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.outcome.wrapping import listed
from hystfit.reading.files.lines import check_lengths
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.limits import ABOVE, MOST_COLUMNS
from hystfit.reading.names.latex_names import without_latex
from hystfit.reading.table.raw_table import Part, Table
from hystfit.reading.text import cells
from hystfit.reading.text.dialect import Dialect, Text, apart, sniff, split
from hystfit.reading.text.header import sample_properties
from hystfit.reading.text.listed_names import with_next
from hystfit.reading.text.number_block import Block, careful_block, clean_block
from hystfit.reading.text.other_lines import Header, header_of, heads_of_sections, left_out
from hystfit.reading.text.stated_interval import stated_interval
from hystfit.reading.text.stated_results import stated_in

_WORDS = re.compile(r"\s*[^\d\s+.,;|-]")  # a line that begins with no number
_SECTION = 2  # such lines between rows of numbers from which they begin a section; a single one is a comment


def plain_text(text: TextFile, header: Header | None = None) -> Table:
    """Text of any layout: delimiter, decimal mark, header, units and encoding are recognized.

    Args:
        header: names and units of the columns, where the layout of the file has them elsewhere than above the numbers.
    """
    check_lengths(text.content, text.source)
    with _without_collection():
        parsed, block, more = _block_of(text)
        return table_of_block(parsed, block, text.sha256, [*text.notes, *more], header)


def _block_of(file: TextFile) -> tuple[Text, Block, list[Note]]:
    """The lines with their dialect, the block of numbers among them, and what was assumed of the dialect."""
    source, delimiter, decimal = file.source, file.opening.delimiter, file.opening.decimal
    lines, touching, notes = _with_whole_names(file.lines), 0, []
    try:
        dialect = sniff(lines, source, delimiter, decimal)
    except DataError:
        lines, touching = apart(lines)
        if delimiter is not None or not touching:
            raise
        dialect = sniff(lines, source, delimiter, decimal)
    if dialect.width > MOST_COLUMNS:
        raise DataError(
            f"{source}: {dialect.width} columns, and {MOST_COLUMNS} are the most; write one sample in a line"
        )
    text = Text(lines, dialect, source, settled=decimal is not None)
    block = clean_block(text, file.content)
    if block is None:
        lines = list(lines)
        if dialect.delimiter is None and not touching:
            lines, touching = apart(lines)
            dialect = sniff(lines, source, delimiter, decimal) if touching else dialect
        if touching:
            words = f"columns that touch are separated: {touching} lines"
            notes.append(Note(Code.FILE_FORMAT, words))
        text = dataclasses.replace(text, lines=lines, dialect=dialect)
        block = careful_block(text, [split(line, dialect.delimiter) for line in lines])
    return text, block, [*notes, Note(Code.FILE_FORMAT, dialect.words())]


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


def _with_whole_names(lines: Sequence[str]) -> Sequence[str]:
    """The lines; a name that is quoted over several of the first ones stands in the last of these, and the others are blank.

    Names that are written for LaTeX are plain.
    """
    if any("\\" in line or "$" in line for line in lines[:ABOVE]):
        lines = [*map(without_latex, lines[:ABOVE]), *lines[ABOVE:]]
    if not any(line.count('"') % 2 for line in lines[:ABOVE]):
        return lines
    lines, start = list(lines), 0
    while start < min(len(lines), ABOVE):
        end = start
        if lines[start].count('"') % 2:
            end = next((k for k in range(start + 1, min(start + 10, len(lines))) if lines[k].count('"') % 2), start)
            if end > start:
                lines[end] = " ".join(lines[start : end + 1])
                lines[start:end] = [""] * (end - start)
        start = end + 1
    return lines


def table_of_block(
    text: Text, block: Block, sha256: str | None, notes: Sequence[Note], header: Header | None = None
) -> Table:
    """The table of a block of numbers and the lines around it.

    Args:
        header: as for `plain_text`; found above the numbers where it is None or has another number of columns.
    """
    lines, dialect, index = text.lines, text.dialect, block.index
    notes = [*notes, *block.notes]
    problems, doubts = ({}, []) if text.settled else _check_thousands(text, block)
    notes += doubts
    clocks = _clocks(block.cells, dialect)
    if header is None or len(header.names) != dialect.width:
        header = header_of(text, block, [k for extra in clocks.values() for k in extra])
    names, units, named = header.names, header.units, any(header.names)
    above = lines[: int(index[0])]
    metadata = sample_properties(above if header.apart else above[: len(above) - header.used], names)
    stated = stated_in(above, decimal=dialect.decimal)
    others = left_out(text, block, header)
    notes += others.notes
    if metadata:
        properties = ", ".join(f"{key} {value}" for key, value in metadata.items())
        notes.append(Note(Code.FILE_FORMAT, f"properties of the sample in the header: {properties}"))
    shown = [name or f"column {k}" for k, name in enumerate(names)]
    numbers, labels, stamps, more, unclear = _columns(text, block, clocks, shown, units)
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
        parts=(Part(stated=stated),) if stated else (),
        problems=problems | unclear,
        interval=stated_interval(with_next(above)),
        over=header.over,
    )


def _columns(
    text: Text, block: Block, clocks: dict[int, tuple[int, ...]], names: Sequence[str], units: Sequence[str]
) -> tuple[list[np.ndarray], dict[int, np.ndarray], set[int], list[Note], dict[int, str]]:
    """Numbers of every column, text by position, positions of time stamps, notes, and stamps that cannot be read, by position.

    `clocks` has the positions of the time of day that belongs to the date in a column, by the position of the date.
    """
    stamps, labels, numbers = set(), {}, []
    notes: list[Note] = []
    problems: dict[int, str] = {}
    for position, kind in enumerate(text.dialect.kinds):
        parsed = block.values[position]
        column = np.full(block.index.size, np.nan) if parsed is None else parsed
        date = next((k for k, extra in clocks.items() if position in extra), None)
        if kind == cells.STAMP and date is None:
            parts = [block.cells[k] for k in (position, *clocks.get(position, ()))]
            stamped = [" ".join(part) for part in zip(*parts, strict=True)] if len(parts) > 1 else parts[0]
            stamps.add(position)
            try:
                column, assumed = cells.seconds(stamped, f"{text.source}, {names[position]!r}")
            except DataError as error:
                problems[position] = str(error)
                numbers.append(column)
                continue
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
            unit = cells.unit_of_epoch(np.nanmin(column), np.nanmax(column))
            if whole is not None and unit and not units[position]:
                column = whole / cells.EPOCH_UNITS[unit]
                stamps.add(position)
                words = f"{names[position]!r}: {unit} since 1970 converted to seconds from the first one"
                notes.append(Note(Code.FILE_FORMAT, words))
            elif whole is not None:
                column = whole
                words = f"too large for a double, stored as differences to {block.cells[position][0]}"
                notes.append(Note(Code.FILE_FORMAT, f"{names[position]!r}: {words}"))
        numbers.append(column)
    empty = [k for k, column in enumerate(numbers) if k not in labels and np.isnan(column).all()]
    if empty:
        numbered = listed([*map(str, empty)])
        notes.append(Note(Code.LEFT_OUT, f"empty columns are not used: {numbered} (numbered from 0)"))
    return numbers, labels, stamps, notes, problems


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
    top, *below = [split(text.lines[k], text.dialect.delimiter) for k in block.index[:50]]
    decimals = lambda row: sum(text.dialect.decimal in cell for cell in row)
    if (
        any(first)
        and decimals(top) == 0
        and all(decimals(row) >= len(numbers) - 1 and decimals(row) > 0 for row in below)
    ):
        words = "the first row holds whole numbers and the others decimals; it was read as data: delete it if it is a header"
        return [warn(Code.FILE_FORMAT, words)]
    return []


def _clocks(columns: Sequence[Sequence[str]], dialect: Dialect) -> dict[int, tuple[int, ...]]:
    """Columns that hold the time of day, and AM or PM, of the date in the column before, by the position of the date."""
    found: dict[int, tuple[int, ...]] = {}
    for k, kind in enumerate(dialect.kinds):
        if kind != cells.STAMP or k + 1 >= dialect.width or dialect.kinds[k + 1] not in (cells.STAMP, cells.TEXT):
            continue
        if not cells.are_dates(columns[k]) or not cells.are_clocks(columns[k + 1]):
            continue
        halves = k + 2 < dialect.width and {cells.clean(cell).upper() for cell in columns[k + 2]} <= {"AM", "PM"}
        found[k] = (k + 1, k + 2) if halves else (k + 1,)
    return found


def _check_thousands(text: Text, block: Block) -> tuple[dict[int, str], list[Note]]:
    """Columns whose marks could separate thousands, by position, and notes; none for clean rows, whose decimal mark showed itself."""
    dialect, columns = text.dialect, block.cells
    numbers = [k for k, kind in enumerate(dialect.kinds) if kind == cells.NUMBER] if columns else []
    evidence = {k: cells.thousands(columns[k], dialect.decimal) for k in numbers}
    proven = any(marks[2] for marks in evidence.values())
    certain = any(marks[3] for marks in evidence.values())
    doubtful = [k for k, marks in evidence.items() if marks[0] or (marks[1] and not certain)]
    other = "," if dialect.decimal == "." else "."
    if not doubtful:
        return {}, _doubtful_dots([columns[k] for k in numbers], dialect)
    # A point that no thousands have before it, as in 0.140, is the decimal mark of the whole file.
    points = (cells.clean(cell) for k in numbers if k not in doubtful for cell in columns[k] if "." in cell)
    pointed = dialect.decimal == "." and any(not cells.may_be_thousands(cell, ".") for cell in points)
    proven |= pointed and all(_only_above_thousand(columns[k]) for k in doubtful)
    problems = {}
    for k in doubtful:
        mark = other if evidence[k][0] else dialect.decimal
        row = next(row for row, cell in enumerate(columns[k]) if mark in cell)
        cell = columns[k][row].strip()
        if proven:
            words = (
                f"the {other!r} separates thousands, as in {cell!r}; if it is the decimal mark give decimal={other!r}"
            )
            return {}, [Note(Code.FILE_FORMAT, f"{words} (--decimal {other})")]
        problems[k] = (
            f"{text.source}, line {block.index[row] + 1}: ambiguous: in {cell!r} the {mark!r} could be "
            "the decimal mark or separate thousands; give decimal='.' or decimal=',' (--decimal, decimal=)"
        )
    return problems, []


def _only_above_thousand(column: Sequence[str]) -> bool:
    """Whether the whole numbers of a column have a comma from one thousand on, and only there."""
    plain = [cells.clean(cell).lstrip("+-") for cell in column if "," not in cell]
    return bool(plain) and all(re.fullmatch(r"\d{0,3}", cell) for cell in plain)


def _doubtful_dots(columns: Sequence[Sequence[str]], dialect: Dialect) -> list[Note]:
    """A warning where every decimal point could separate thousands, as in 12.345 between semicolons."""
    if dialect.decimal != "." or not cells.dots_are_doubtful(dialect.delimiter):
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
    """Number of the block that each row is in, between blank lines or lines of words: the end of a section and the head of the next.

    A single comment is a head where several differ in their numbers alone, one of them above the first row: "# loop at 50 A/m".
    """
    curve = np.zeros(index.size, dtype=int)
    gaps = np.flatnonzero(np.diff(index) > 1)
    heads = heads_of_sections(lines, index)
    for k in gaps:
        between = lines[index[k] + 1 : index[k + 1]]
        section = len(between) >= _SECTION and all(map(_WORDS.match, between))
        if section or heads.intersection(between) or any(not line.strip(" \t,;|") for line in between):
            curve[k + 1] = 1
    curve = np.cumsum(curve)
    if curve[-1] > 1 and curve[-1] == index.size - 1:
        notes.append(Note(Code.CURVES, "blank lines between all rows are double spacing and do not separate curves"))
        return np.zeros(index.size, dtype=int)
    return curve
