"""Tables whose cells hold whole signals, "[0.1, 0.2, ...]", as pandas writes a column of lists: a row for each loop."""

from __future__ import annotations

import csv

from hystfit.outcome import Code, Note
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.layouts.array_table import table_of_arrays
from hystfit.reading.limits import FEWEST
from hystfit.reading.table.raw_table import Part, Table, below_each_other
from hystfit.reading.text.number_lists import is_list, numbers_of

_LONGEST = 100_000_000  # characters of a cell: ten million numbers


def read_list_cells(text: TextFile) -> Table | None:
    """One loop a row, whose cells hold the samples of a signal each; None for other text.

    A record has the text in the first other cell of its row, where these differ from row to row, else its number.
    """
    mark = next((mark for mark in ",;\t" if f'{mark}"[' in text.content or f'{mark}"(' in text.content), None)
    if mark is None:
        return None
    csv.field_size_limit(_LONGEST)
    names, *rows = [row for row in csv.reader(text.content.splitlines(keepends=True), delimiter=mark) if any(row)]
    if not rows or any(len(row) != len(names) for row in rows):
        return None
    signals = [k for k in range(len(names)) if all(is_list(row[k]) for row in rows)]
    if len(signals) < 2:
        return None
    arrays = [{names[k]: numbers_of(row[k]) for k in signals} for row in rows]
    if any(len({array.size for array in one.values()}) > 1 or len(next(iter(one.values()))) < FEWEST for one in arrays):
        return None
    others = (([row[k] for row in rows]) for k in range(len(names)) if k not in signals)
    titles = next((cells for cells in others if len({*cells}) == len(rows)), [f"row {k}" for k in range(len(rows))])
    note = Note(Code.FILE_FORMAT, f"one loop a row: {len(rows)} row{'s' * (len(rows) > 1)} with lists")
    tables = [table_of_arrays(one, text.source, text.sha256, (*text.notes, note)) for one in arrays]
    return tables[0] if len(tables) == 1 else below_each_other(tables, [*map(Part, titles)])
