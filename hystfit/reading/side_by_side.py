"""Tables in which several loops stand side by side: an input and an output each, named alike but for their numbers."""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.column_names import column_quantity
from hystfit.reading.header import split_unit
from hystfit.reading.raw_table import Table

_NUMBER = re.compile(r"[ _.#-]*\d+$|\[\d+\]$")  # of a loop, at the end of a name: H1, H_2, H.1, and H[1] of a matrix
_FEWEST_ROWS = 4


def stacked(table: Table) -> Table | None:
    """Loops side by side, of an input and an output each (H1, B1, H2, B2), are a record each; None for other tables.

    The pairs of columns have the same two names, and no other column of numbers stands beside them: channels of one experiment, which
    share a time, are no loops of their own. The inputs and the outputs alternate (H1, B1, H2, B2), or the columns of a matrix of inputs
    precede those of a matrix of outputs (H1, H2, B1, B2). Columns may end at different rows.
    """
    count = len(table.names)
    if not table.named or count < 4 or count % 2:
        return None
    bases = [_base(name) for name in table.names]
    for pairs in ([(k, k + 1) for k in range(0, count, 2)], [(k, k + count // 2) for k in range(count // 2)]):
        names = [{bases[pair[side]] for pair in pairs} for side in (0, 1)]
        if len(names[0]) == len(names[1]) == 1 and names[0] != names[1]:
            return _below_each_other(table, pairs)
    return None


def stacked_files(table: Table, inputs: int) -> Table | None:
    """The loops of a file of inputs and a file of outputs, column by column, one below the other; None for other files.

    Args:
        table: the columns of the first file, then those of the second.
        inputs: number of columns of the first.
    """
    bases = [_base(name) if table.named else "" for name in table.names]
    if inputs < 2 or len(bases) != 2 * inputs or any(len(set(side)) > 1 for side in (bases[:inputs], bases[inputs:])):
        return None
    if any((np.diff(table.columns[k]) > 0).all() for k in (0, inputs)):  # a time, which no header names
        return None
    return _below_each_other(table, [(k, k + inputs) for k in range(inputs)])


def _below_each_other(table: Table, pairs: list[tuple[int, int]]) -> Table | None:
    """The loops whose input and output are pairs of columns, one below the other; None where these hold something else."""
    kinds = {column_quantity(name, table.units[k]) for k, name in enumerate(table.names)}
    alike = all(table.units[k] == table.units[first] for pair in pairs for k, first in zip(pair, pairs[0], strict=True))
    if table.labels or table.stamps or not alike or (table.named and kinds & {"time", "index"}):
        return None
    if np.array_equal(*(table.columns[k] for k in pairs[0]), equal_nan=True):  # two channels, each with its time
        return None
    chosen = [np.flatnonzero(np.isfinite(table.columns[i]) & np.isfinite(table.columns[o])) for i, o in pairs]
    if min(rows.size for rows in chosen) < _FEWEST_ROWS:
        return None
    rows = np.concatenate(chosen)
    columns = tuple(
        np.concatenate([table.columns[pair[side]][kept] for pair, kept in zip(pairs, chosen, strict=True)])
        for side in (0, 1)
    )
    text = f"{len(pairs)} loops side by side, each of an input and an output named alike, are read as curves"
    return dataclasses.replace(
        table.take(rows),
        names=tuple(table.names[k] for k in pairs[0]),
        units=tuple(table.units[k] for k in pairs[0]),
        columns=columns,
        curve=np.repeat(np.arange(len(pairs)), [kept.size for kept in chosen]),
        section=np.zeros(rows.size, dtype=int),
        notes=(*table.notes, Note(Code.CURVES, text)),
    )


def _base(name: str) -> str:
    """Name of a column without its unit and its number."""
    return _NUMBER.sub("", split_unit(name)[0].strip()).lower()
