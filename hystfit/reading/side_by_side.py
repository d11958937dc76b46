"""Tables in which several loops stand side by side: an input and an output each, named alike but for their numbers."""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.column_names import column_quantity
from hystfit.reading.header import split_unit
from hystfit.reading.raw_table import Table

_NUMBER = re.compile(r"[ _.#-]*\d+$")  # of a loop, at the end of a name: H1, H_2, H.1
_FEWEST_ROWS = 4


def stacked(table: Table) -> Table | None:
    """The loops of such a table one below the other, each a curve; None for other tables.

    The pairs of columns have the same two names, and no other column of numbers stands beside them: channels of one experiment, which
    share a time, are no loops of their own. Columns may end at different rows.
    """
    count = len(table.names)
    if not table.named or table.labels or table.stamps or count < 4 or count % 2:
        return None
    bases = [_base(name) for name in table.names]
    kinds = {column_quantity(name, table.units[k]) for k, name in enumerate(table.names)}
    alike = all(bases[k] == bases[k % 2] and table.units[k] == table.units[k % 2] for k in range(count))
    if not alike or bases[0] == bases[1] or kinds & {"time", "index"}:
        return None
    pairs = [
        np.flatnonzero(np.isfinite(table.columns[k]) & np.isfinite(table.columns[k + 1])) for k in range(0, count, 2)
    ]
    if min(rows.size for rows in pairs) < _FEWEST_ROWS:
        return None
    rows = np.concatenate(pairs)
    columns = tuple(
        np.concatenate([table.columns[2 * k + side][chosen] for k, chosen in enumerate(pairs)]) for side in (0, 1)
    )
    text = f"{len(pairs)} loops side by side, each of an input and an output named alike, are read as curves"
    return dataclasses.replace(
        table.take(rows),
        names=table.names[:2],
        units=table.units[:2],
        columns=columns,
        curve=np.repeat(np.arange(len(pairs)), [chosen.size for chosen in pairs]),
        section=np.zeros(rows.size, dtype=int),
        notes=(*table.notes, Note(Code.CURVES, text)),
    )


def _base(name: str) -> str:
    """Name of a column without its unit and its number."""
    return _NUMBER.sub("", split_unit(name)[0].strip()).lower()
