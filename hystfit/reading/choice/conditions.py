"""Conditions of a measurement that change within a record: its temperature, and the mode in which the output was measured."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from hystfit.outcome.note import Code, Note, warn
from hystfit.reading.choice.column_facts import HEATED
from hystfit.reading.table.raw_table import Table

# Parts of a record whose medians are compared, so that the noise of a temperature, 2 to 25 K in molecular dynamics, is no change.
_PARTS = 32


def without_turns(table: Table, output: int, notes: list[Note]) -> Table:
    """The table without the rows in which other channels were measured in turn with the output, which are empty cells there."""
    others = _in_its_place(table, [k for k in table.positions if table.named and k != output], output)
    elsewhere = (
        np.any([np.isfinite(table.columns[k]) for k in others], axis=0) if others else np.zeros(table.rows, bool)
    )
    stretches = [sum(1 for _ in rows) for empty, rows in itertools.groupby(elsewhere.tolist()) if empty]
    if len(stretches) < 2 or max(stretches) > len(others):
        return table
    first = table.names[others[0]]
    text = f"left out: {int(elsewhere.sum())} rows in which other channels are measured in turn (output={first!r} reads one of them)"
    notes.append(Note(Code.LEFT_OUT, text))
    return table.take(~elsewhere)


def _in_its_place(table: Table, columns: list[int], output: int) -> list[int]:
    """Those of the columns that hold numbers of the output's unit, in rows where it has none alone."""
    present, unit = np.isfinite(table.columns[output]), table.units[output]
    filled = lambda own: own.any() and not (own & present).any()
    alike = (k for k in columns if unit and table.units[k] == unit and filled(np.isfinite(table.columns[k])))
    return [k for k in alike if table.quantity(k) != "error"]


def _change(values: np.ndarray) -> float:
    """Range of a condition over a record, without its noise: that of the medians of equal parts."""
    parts = np.array_split(values, min(values.size, _PARTS))
    return float(np.ptp([np.median(part) for part in parts]))


def changed_conditions(table: Table, used: tuple[int | None, ...], output: int) -> Iterator[Note]:
    """Warnings of what makes several measurements of one record.

    Args:
        table: rows of the record.
        used: columns of the record.
        output: that of the output.
    """
    others = [k for k in table.positions if table.named and k not in used]
    heated = any(table.quantity(k) == "temperature" for k in used if k is not None)  # it is no condition but the input
    for k in [] if heated else others:
        values = table.columns[k][np.isfinite(table.columns[k])]
        if table.quantity(k) == "temperature" and values.size and _change(values) > HEATED:
            yield warn(
                Code.CONDITIONS,
                f"the temperature ({table.names[k]!r}) changes from {values.min():.4g} to {values.max():.4g} {table.units[k]} within this "
                "record: its loops are of different states; read those of one temperature (where=), or fit a part (window=)",
            )
            break  # other thermometers say the same
    for k in _in_its_place(table, others, output):
        yield warn(
            Code.CONDITIONS,
            f"{int(np.isfinite(table.columns[k]).sum())} rows hold {table.names[k]!r} in place of {table.names[output]!r}: they are of "
            f"another mode, and count as samples without output (output={table.names[k]!r} reads them alone)",
        )
