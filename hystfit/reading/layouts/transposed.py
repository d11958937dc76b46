"""Tables on their side: a line for each quantity, which begins with its name."""

import re
from collections.abc import Sequence

from hystfit.reading.files.text_file import TextFile
from hystfit.reading.limits import FEWEST
from hystfit.reading.names.column_names import column_quantity
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.cells import is_missing
from hystfit.reading.text.plain_text import plain_text

_MOST_LINES = 50  # lines that name a quantity; the samples stand beside each other
_FEWEST_SAMPLES = 20  # numbers after the name, as many as a loop needs
_NUMBER = re.compile(r"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?")


def read_transposed(text: TextFile) -> Table | None:
    """A table whose rows are quantities; None for text of another layout."""
    lines = [line for line in text.head if line.strip()]
    for delimiter in (text.opening.delimiter,) if text.opening.delimiter else (";", "\t", ","):
        rows = [[cell.strip() for cell in line.rstrip(f"\r{delimiter}").split(delimiter)] for line in lines]
        columns = _of_runs(rows)
        if columns is None and len(lines) <= _MOST_LINES:
            columns = turned(rows)
        if columns is not None:
            return plain_text(text.of("\n".join(map(delimiter.join, columns))))
    return None


def turned(rows: Sequence[list[str]]) -> list[tuple[str, ...]] | None:
    """The rows of a table on its side, from its lines; None for other tables.

    A first line may count the samples, from the column behind the names, and settings stand before the names in the rows below it.
    """
    if rows and len(counted := [k for k, cell in enumerate(rows[0]) if cell == "0"]) == 1 and (first := counted[0]):
        if rows[0][first:] == [str(k) for k in range(len(rows[0]) - first)]:
            rows = [row[first - 1 :] for row in rows[1:]]
    quantities = [row for row in rows if row and _is_quantity(row)]
    width = {len(row) for row in quantities}
    headed = any(
        len(row) in width and row not in quantities for row in rows
    )  # rows of an ordinary table below their names
    if len(width) != 1 or not 1 < len(quantities) < min(width) or headed:
        return None
    return list(zip(*quantities, strict=True))


def _of_runs(rows: Sequence[list[str]]) -> list[tuple[str, ...]] | None:
    """The rows of several tables on their side, below each other, with the number of each; None for other lines.

    A first line names the settings before the names in the rows below it, the last one those themselves: "chunk;timestamp;size;fieldname"
    of the sweeps of a lock-in amplifier.
    """
    titles, *lines = rows or [[""]]
    place = len(titles) - 1
    if place < 1 or len(lines) < 2 or not all(map(str.isidentifier, titles)):
        return None
    if not all(len(line) > len(titles) and _NUMBER.fullmatch(line[0]) and _is_quantity(line[place:]) for line in lines):
        return None
    runs: dict[str, list[list[str]]] = {}
    for line in lines:
        runs.setdefault(line[0], []).append(line[place:])
    names = [[line[0] for line in run] for run in runs.values()]
    if len(names[0]) < 2 or len({*names[0]}) < len(names[0]) or any(one != names[0] for one in names):
        return None
    if any(len({*map(len, run)}) > 1 for run in runs.values()):
        return None
    samples = [(*sample, number) for number, run in runs.items() for sample in list(zip(*run, strict=True))[1:]]
    return [(*names[0], titles[0]), *samples]


def _is_quantity(row: list[str]) -> bool:
    """Whether a line is a name and the numbers of a column, of which some may be missing."""
    name, *cells = row
    numbers = sum(_NUMBER.fullmatch(cell) is not None for cell in cells)
    complete = all(is_missing(cell) or _NUMBER.fullmatch(cell) for cell in cells)
    fewest = FEWEST if column_quantity(name) else _FEWEST_SAMPLES
    return not is_missing(name) and not _NUMBER.fullmatch(name) and numbers >= fewest and complete
