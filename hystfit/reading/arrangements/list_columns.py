"""Columns whose cells are lists of as many numbers each, "[0.1, 0.2]", as a message of ROS with a value for each joint is written."""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.limits import LONGEST
from hystfit.reading.table.raw_table import Table

_CELL = re.compile(r"\s*[\[(][\d\s,;.eE+-]*\d[\d\s,;.eE+-]*[\])]\s*")


def with_list_columns(table: Table) -> Table | None:
    """The table with a column for each number of the lists behind the others, as position[0] and position[1]; None for other tables."""
    found = {k: values for k, label in table.labels.items() if (values := _values(label)) is not None}
    if not found:
        return None
    for k, values in found.items():
        for place, column in enumerate(values.T):
            table = table.beside(f"{table.names[k]}[{place}]" if values.shape[1] > 1 else table.names[k], column)
    listed = ", ".join(repr(table.names[k]) for k in found)
    hidden = tuple("" if k in found else name for k, name in enumerate(table.names))
    return dataclasses.replace(table, names=hidden).noted(
        Note(Code.FILE_FORMAT, f"lists of numbers in the cells of {listed}, a column for each of their places")
    )


def _values(label: np.ndarray) -> np.ndarray | None:
    """The numbers of cells that hold lists, shape (rows, places); None where a cell is none, or has another number of them."""
    if not all(len(cell) < LONGEST and _CELL.fullmatch(cell) for cell in label):
        return None
    rows = [re.sub(r"[\[\](),;]", " ", cell).split() for cell in label]
    if len({len(row) for row in rows}) > 1:
        return None
    try:
        return np.array(rows, dtype=float)
    except ValueError:
        return None
