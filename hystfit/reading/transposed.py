"""Tables on their side: a line for each quantity, which begins with its name."""

import re
from collections.abc import Sequence

from hystfit.reading.cells import is_missing
from hystfit.reading.column_names import column_quantity
from hystfit.reading.limits import FEWEST
from hystfit.reading.raw_table import Table
from hystfit.reading.text import plain_text
from hystfit.reading.text_file import TextFile

_MOST_LINES = 50  # lines that name a quantity; the samples stand beside each other
_FEWEST_SAMPLES = 20  # numbers after the name, as many as a loop needs
_NUMBER = re.compile(r"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?")


def read_transposed(text: TextFile) -> Table | None:
    """A table whose rows are quantities; None for text of another layout."""
    lines = [line for line in text.head if line.strip()]
    if len(lines) > _MOST_LINES:
        return None
    for delimiter in (text.opening.delimiter,) if text.opening.delimiter else (";", "\t", ","):
        rows = [[cell.strip() for cell in line.rstrip(f"\r{delimiter}").split(delimiter)] for line in lines]
        if (columns := turned(rows)) is not None:
            return plain_text(text.of("\n".join(map(delimiter.join, columns))))
    return None


def turned(rows: Sequence[list[str]]) -> list[tuple[str, ...]] | None:
    """The rows of a table on its side, from its lines; None for other tables.

    A first line may count the samples, from the column behind the names, and settings stand before the names in the rows below it.
    """
    if rows and len(counted := [k for k, cell in enumerate(rows[0]) if cell == "0"]) == 1 and (first := counted[0]):
        if rows[0][first:] == [str(k) for k in range(len(rows[0]) - first)]:
            rows = [row[first - 1 :] for row in rows[1:]]
    quantities = [row for row in rows if _is_quantity(row)]
    width = {len(row) for row in quantities}
    headed = any(
        len(row) in width and row not in quantities for row in rows
    )  # rows of an ordinary table below their names
    if len(width) != 1 or not 1 < len(quantities) < min(width) or headed:
        return None
    return list(zip(*quantities, strict=True))


def _is_quantity(row: list[str]) -> bool:
    """Whether a line is a name and the numbers of a column, of which some may be missing."""
    name, *cells = row
    numbers = sum(_NUMBER.fullmatch(cell) is not None for cell in cells)
    complete = all(is_missing(cell) or _NUMBER.fullmatch(cell) for cell in cells)
    fewest = FEWEST if column_quantity(name) else _FEWEST_SAMPLES
    return not is_missing(name) and not _NUMBER.fullmatch(name) and numbers >= fewest and complete
