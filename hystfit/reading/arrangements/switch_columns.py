"""Columns of text that say whether something is on or off: the state of a relay or a heater, as 1 and 0."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.cells import SWITCH

_ON = frozenset("active running enabled heating cooling heat".split()) | {
    word for word, state in SWITCH.items() if state
}
_OFF = frozenset("inactive stopped disabled idle standby".split()) | {
    word for word, state in SWITCH.items() if not state
}


def with_switches(table: Table) -> Table | None:
    """The table with every column of a word for on and a word for off as 1 and 0; None where there is none."""
    columns, notes, labels = [*table.columns], [], {**table.labels}
    for position, label in table.labels.items():
        words = np.char.lower(label.astype(str))
        on = np.isin(words, [*_ON])
        if np.unique(words).size == 2 and 0 < on.sum() < on.size and np.isin(words[~on], [*_OFF]).all():
            columns[position] = on.astype(float)
            del labels[position]
            text = f"column {table.names[position]!r}: 1 where it is {label[on][0]}, 0 where it is {label[~on][0]}"
            notes.append(Note(Code.FILE_FORMAT, text))
    return dataclasses.replace(table, columns=tuple(columns), labels=labels).noted(*notes) if notes else None
