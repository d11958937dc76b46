"""Columns whose cells are lists of as many numbers each, "[0.1, 0.2]", as a message of ROS with a value for each joint is written."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.limits import LONGEST
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.number_lists import is_list, numbers_of


def with_list_columns(table: Table) -> Table | None:
    """The table with the numbers of the lists as columns, the first in place of the lists, position[0], and the others behind all columns.

    None for other tables.
    """
    found = {k: values for k, label in table.labels.items() if (values := _values(label)) is not None}
    if not found:
        return None
    named = lambda k, place: f"{table.names[k]}[{place}]" if found[k].shape[1] > 1 else table.names[k]
    read = dataclasses.replace(
        table,
        names=tuple(named(k, 0) if k in found else name for k, name in enumerate(table.names)),
        columns=tuple(found[k][:, 0] if k in found else values for k, values in enumerate(table.columns)),
        labels={k: label for k, label in table.labels.items() if k not in found},
    )
    for k, values in found.items():
        for place in range(1, values.shape[1]):
            read = read.beside(named(k, place), values[:, place])
    listed = ", ".join(repr(table.names[k]) for k in found)
    text = f"lists of numbers in the cells of {listed}, a column for each of their places"
    return read.noted(Note(Code.FILE_FORMAT, text))


def _values(label: np.ndarray) -> np.ndarray | None:
    """The numbers of cells that hold lists, shape (rows, places); None where a cell is none, or has another number of them."""
    if not all(len(cell) < LONGEST and is_list(cell) for cell in label):
        return None
    try:
        rows = [numbers_of(cell) for cell in label]
    except ValueError:  # dates: [2019-11-02]
        return None
    return np.stack(rows) if rows[0].size and len({row.size for row in rows}) == 1 else None
