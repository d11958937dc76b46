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
from hystfit.reading.clean_rows import clean_columns
from hystfit.reading.encodings import decode
from hystfit.reading.file_bytes import load
from hystfit.reading.header import sample_properties
from hystfit.reading.instruments import micromag_columns
from hystfit.reading.layout import Layout, apart, check_lengths, sniff, split
from hystfit.reading.other_lines import OtherLines, is_comment
from hystfit.reading.raw_table import Table

_HEAD = 200  # lines in which clean rows must begin
_MOST_COLUMNS = 5000
_FEW = 3  # rows of numbers above a header


@dataclasses.dataclass(frozen=True)
class _Block:
    """The rows of numbers.

    Attributes:
        index: numbers of their lines, shape (rows,).
        values: numbers of every column, shape (rows,); None for text and stamps.
        cells: of every column, where they are needed; else empty.
        rows: cells of the lines, at least of those above and at the first row.
        ragged: numbers of lines of another width.
        notes: on cells that are no numbers.
    """

    index: np.ndarray
    values: list[np.ndarray | None]
    cells: list[list[str]]
    rows: list[list[str]]
    ragged: list[int]
    notes: tuple[Note, ...] = ()


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
    file, source = load(path), str(path)
    text, notes = decode(file.raw, source, encoding)
    notes = [*file.notes, *notes]
    lines = text.split("\n")
    if lines and not lines[-1]:
        lines.pop()
    check_lengths(lines, source)
    _join_quoted(lines)
    lines, layout, touching = _sniffed(lines, source, delimiter, decimal)
    if layout.width > _MOST_COLUMNS:
        raise DataError(
            f"{source}: {layout.width} columns, and {_MOST_COLUMNS} are the most; write one sample in a line"
        )
    settled = decimal is not None
    clean = _clean_block(text, lines, layout, settled=settled)
    if clean is not None:
        notes.append(Note(Code.FILE_FORMAT, layout.words()))
        return _table(clean, lines, layout, source, file.sha256, notes, settled=settled)
    if layout.delimiter is None and not touching:
        separated = apart(lines)
        touching = sum(a != b for a, b in zip(lines, separated, strict=True))
        lines, layout = (separated, sniff(separated, source, delimiter, decimal)) if touching else (lines, layout)
    if touching:
        text = f"columns that touch are separated before the minus sign: {touching} lines"
        notes.append(Note(Code.FILE_FORMAT, text))
    notes.append(Note(Code.FILE_FORMAT, layout.words()))
    with _without_collection():
        rows = [split(line, layout.delimiter) for line in lines]
        return tabulate(rows, lines, layout, source, file.sha256, notes, settled=settled)


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


def _sniffed(
    lines: list[str], source: str, delimiter: str | None, decimal: str | None
) -> tuple[list[str], Layout, int]:
    """Lines, their layout, and in how many touching columns had to be separated to find it.

    Args:
        lines: of the text.
        source: its path, for messages.
        delimiter, decimal: chosen by the user; detected where None.
    """
    try:
        return lines, sniff(lines, source, delimiter, decimal), 0
    except DataError:
        separated = apart(lines)
        touching = sum(a != b for a, b in zip(lines, separated, strict=True))
        if delimiter is not None or not touching:
            raise
    return separated, sniff(separated, source, delimiter, decimal), touching


def _join_quoted(lines: list[str]) -> None:
    """Put names that are quoted over several of the first lines into the last of these, and leave the others blank."""
    start = 0
    while start < min(len(lines), 30):
        end = start
        if lines[start].count('"') % 2:
            end = next((k for k in range(start + 1, min(start + 10, len(lines))) if lines[k].count('"') % 2), start)
            if end > start:
                lines[end] = " ".join(lines[start : end + 1])
                lines[start:end] = [""] * (end - start)
        start = end + 1


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
    block = _careful_block(rows, lines, layout, source)
    return _table(block, lines, layout, source, sha256, notes, settled=settled)


def _clean_block(text: str, lines: Sequence[str], layout: Layout, *, settled: bool) -> _Block | None:
    """The rows of numbers where nothing but plain numbers follows the first of them; None elsewhere."""
    rows = [split(line, layout.delimiter) for line in lines[:_HEAD]]
    candidates, _ = _of_width(rows, layout)
    if not candidates:
        return None
    _, fits, _ = _parse_columns(list(zip(*[rows[k] for k in candidates], strict=True)), layout)
    if not fits.any():
        return None
    first = candidates[int(np.argmax(fits))]
    columns = clean_columns(text, lines, first, layout, settled=settled)
    if columns is None:
        return None
    return _Block(first + np.arange(columns[0].size), [*columns], [], rows, [])


def _careful_block(rows: list[list[str]], lines: Sequence[str], layout: Layout, source: str) -> _Block:
    """The rows of numbers, cell by cell.

    Raises:
        DataError: there are fewer than two.
    """
    candidates, ragged = _of_width(rows, layout)
    columns = list(zip(*[rows[k] for k in candidates], strict=True))
    if not columns:
        raise DataError(f"{source}: no row of numbers found; a loop needs at least two")
    values, fits, spoiled = _parse_columns(columns, layout)
    spoiled &= np.array([not is_comment(lines[k]) for k in candidates])
    keep = fits | spoiled
    index = np.array(candidates)[keep]
    keep[keep] = _main_runs(rows, index, layout, lines)
    index, above = np.array(candidates)[keep], 0
    if index.size:
        above = _above_header(rows, lines, index, layout)
        keep[np.flatnonzero(keep)[:above]] = False
        index = index[above:]
    if index.size < 2:
        raise DataError(f"{source}: only {index.size} row of numbers found; a loop needs at least two")
    kept = np.flatnonzero(keep)
    chosen = [[column[k] for k in kept] for column in columns]
    notes = _spoiled_notes(rows, np.array(candidates)[keep & spoiled], layout)
    if above:
        notes.append(warn(Code.LEFT_OUT, f"left out: {above} rows of numbers above the header"))
    return _Block(index, [v if v is None else v[keep] for v in values], chosen, rows, ragged, tuple(notes))


def _table(
    block: _Block,
    lines: Sequence[str],
    layout: Layout,
    source: str,
    sha256: str,
    notes: list[Note],
    *,
    settled: bool,
) -> Table:
    """The table of a block of numbers and the lines around it; arguments as for `tabulate`."""
    index = block.index
    notes = [*notes, *block.notes]
    if not settled:
        notes += _check_thousands(block.cells, layout, index, source)
    clocks = _clocks(block.cells, layout)
    account = OtherLines(block.rows, lines, block.ragged, layout, source)
    names, units, named = account.header(int(index[0]), [k for extra in clocks.values() for k in extra])
    above = lines[: int(index[0])]
    metadata = sample_properties(above, names)
    if not named and (micromag := micromag_columns(above)) and len(names) == len(micromag):
        (names, units), named = zip(*micromag, strict=True), True
    left_out = account.left_out(index)
    notes += left_out.notes
    if metadata:
        listed = ", ".join(f"{key} {value}" for key, value in metadata.items())
        notes.append(Note(Code.FILE_FORMAT, f"properties of the sample in the header: {listed}"))
    shown = [name or f"column {k}" for k, name in enumerate(names)]
    numbers, labels, stamps, more = _columns(block, layout, clocks, shown, source)
    notes += more
    notes += _doubtful_first_row(block, lines, layout, numbers, labels, named=named)
    return Table(
        names=tuple(shown),
        units=tuple("s" if k in stamps else unit for k, unit in enumerate(units)),
        columns=tuple(numbers),
        labels=labels,
        curve=_curves(index, lines, notes),
        section=left_out.section,
        line=index + 1,
        source=source,
        sha256=sha256,
        named=named,
        stamps=frozenset(stamps),
        notes=tuple(notes),
        left_out=left_out.count,
        unread=left_out.unread,
        metadata=metadata,
        sectioned=any(line.strip(" ,;\t").lower() == "[data]" for line in above),
    )


def _columns(
    block: _Block, layout: Layout, clocks: dict[int, tuple[int, ...]], names: Sequence[str], source: str
) -> tuple[list[np.ndarray], dict[int, np.ndarray], set[int], list[Note]]:
    """Numbers of every column, text by position, positions of time stamps, and notes.

    Args:
        block: the rows.
        layout: of the rows.
        clocks: positions of the time of day that belongs to the date in a column, by the position of the date.
        names: of the columns.
        source: path, for messages.
    """
    stamps, labels, numbers = set(), {}, []
    notes: list[Note] = []
    for position, kind in enumerate(layout.kinds):
        parsed = block.values[position]
        column = np.full(block.index.size, np.nan) if parsed is None else parsed
        date = next((k for k, extra in clocks.items() if position in extra), None)
        if kind == cells.STAMP and date is None:
            parts = [block.cells[k] for k in (position, *clocks.get(position, ()))]
            stamped = [" ".join(part) for part in zip(*parts, strict=True)] if len(parts) > 1 else parts[0]
            column, assumed = cells.seconds(stamped, f"{source}, {names[position]!r}")
            stamps.add(position)
            text = f"{names[position]!r}: time stamps converted to seconds from the first one"
            beside = "; the time of day is in the next column" if len(parts) > 1 else ""
            notes += [Note(Code.FILE_FORMAT, text + beside), *assumed]
        elif date is not None:
            column = numbers[date]
            stamps.add(position)
        elif kind == cells.TEXT:
            labels[position] = np.array([cells.clean(cell) for cell in block.cells[position]])
        elif np.nanmax(np.abs(column), initial=0.0) > 2.0**53 and block.cells:
            whole = cells.whole_from_first(block.cells[position])
            if whole is not None:
                column = whole
                text = f"too large for a double, stored as differences to {block.cells[position][0]}"
                notes.append(Note(Code.FILE_FORMAT, f"{names[position]!r}: {text}"))
        numbers.append(column)
    empty = [k for k, column in enumerate(numbers) if k not in labels and np.isnan(column).all()]
    if empty:
        numbered = ", ".join(map(str, empty))
        notes.append(Note(Code.LEFT_OUT, f"empty columns are not used: {numbered} (numbered from 0)"))
    return numbers, labels, stamps, notes


def _doubtful_first_row(
    block: _Block,
    lines: Sequence[str],
    layout: Layout,
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
        text = "the first row is 0, 1, ... and was read as data; delete it if it numbers the columns"
        return [warn(Code.FILE_FORMAT, text)]
    top, *below = [split(lines[k], layout.delimiter) for k in block.index[:50]]
    decimals = lambda row: sum(layout.decimal in cell for cell in row)
    if decimals(top) == 0 and all(decimals(row) >= len(numbers) - 1 and decimals(row) > 0 for row in below):
        text = "the first row holds whole numbers and the others decimals; it was read as data: delete it if it is a header"
        return [warn(Code.FILE_FORMAT, text)]
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


def _parse_columns(
    columns: list[tuple[str, ...]], layout: Layout
) -> tuple[list[np.ndarray | None], np.ndarray, np.ndarray]:
    """Numbers of every column (None for text and stamps), which rows are rows of numbers, and which but for a word in a cell."""
    count = len(columns[0])
    stamped, short = np.ones(count, dtype=bool), np.ones(count, dtype=bool)
    any_number, spoiled = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    leading: np.ndarray | None = None
    values: list[np.ndarray | None] = []
    for column, kind in zip(columns, layout.kinds, strict=True):
        numbers = None
        if kind == cells.STAMP:
            stamped &= np.array([cells.is_stamp(cells.clean(cell)) for cell in column])
        elif kind != cells.TEXT:
            numbers, kinds = cells.parse(column, layout.decimal)
            any_number |= kinds == cells.NUMBER
            if kind == cells.NUMBER:
                text = kinds == cells.TEXT
                leading = kinds == cells.NUMBER if leading is None else leading
                spoiled |= text
                short[text] &= np.array([cells.is_word(column[k]) for k in np.flatnonzero(text)], dtype=bool)
        values.append(numbers)
    fits = stamped & any_number & ~spoiled
    below = np.arange(count) > (np.argmax(fits) if fits.any() else count)
    return values, fits, stamped & spoiled & short & below & (np.zeros(count, bool) if leading is None else leading)


def _spoiled_notes(rows: Sequence[Sequence[str]], spoiled: np.ndarray, layout: Layout) -> list[Note]:
    """A note on words in place of numbers.

    Args:
        rows: cells of every line.
        spoiled: numbers of the lines with such words.
        layout: of the rows.
    """
    if not spoiled.size:
        return []
    is_text = lambda cell, kind: kind == cells.NUMBER and cells.kind(cell, layout.decimal) in (cells.TEXT, cells.STAMP)
    first = next(cell for cell, kind in zip(rows[spoiled[0]], layout.kinds, strict=True) if is_text(cell, kind))
    text = f"words in place of numbers are treated as missing values: {spoiled.size} rows, the first with {first.strip()!r}"
    return [warn(Code.MISSING_VALUES, f"{text} in line {spoiled[0] + 1}")]


def _above_header(rows: Sequence[Sequence[str]], lines: Sequence[str], index: np.ndarray, layout: Layout) -> int:
    """Number of rows of numbers that stand above the header, which is followed by many more."""
    if index[0] and lines[index[0] - 1].strip():
        return 0
    top = int(np.argmax(np.diff(index) > 1)) + 1 if (np.diff(index) > 1).any() else index.size
    if top > _FEW or index.size - top <= 2 * top:
        return 0
    between = range(index[top - 1] + 1, index[top])
    if not all(lines[k].strip() for k in between):
        return 0
    is_name = lambda cell: cells.kind(cell, layout.decimal) == cells.TEXT
    headers = [k for k in between if len(rows[k]) == layout.width and all(map(is_name, rows[k]))]
    return top if headers and len(headers) == len(between) else 0


def _main_runs(rows: list[list[str]], index: np.ndarray, layout: Layout, lines: Sequence[str]) -> np.ndarray:
    """Which rows belong with the longest run: a run that shares none of its tags (text cells) does not."""
    tags = [k for k, kind in enumerate(layout.kinds) if kind == cells.TEXT]
    keep = np.ones(index.size, dtype=bool)
    tags = [k for k in tags if index.size and not cells.are_clocks([rows[index[0]][k]])]
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


def _check_thousands(columns: Sequence[Sequence[str]], layout: Layout, index: np.ndarray, source: str) -> list[Note]:
    """Notes on marks that could separate thousands.

    Args:
        columns: cells of every column; none where the decimal mark showed itself.
        layout: of the rows.
        index: numbers of the lines of the rows, shape (rows,).
        source: path, for messages.

    Raises:
        DataError: a mark is either a thousands separator or the decimal mark, and nothing in the file decides.
    """
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
        text = f"the {other!r} separates thousands, as in {cell!r}; if it is the decimal mark give decimal={other!r}"
        return [Note(Code.FILE_FORMAT, f"{text} (--decimal {other})")]
    raise DataError(
        f"{source}, line {index[row] + 1}: ambiguous: in {cell!r} the {mark!r} could be "
        "the decimal mark or set thousands apart; give decimal='.' or decimal=',' (--decimal, decimal=)"
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
