"""Conditions of a measurement that change within a record: its temperature, and the mode in which the output was measured."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hystfit.outcome.note import Code, Note, warn
from hystfit.reading.column_names import column_quantity
from hystfit.reading.pair_score import HEATED
from hystfit.reading.raw_table import Table


def changed_conditions(table: Table, used: tuple[int | None, ...], output: int) -> Iterator[Note]:
    """Warnings of what makes several measurements of one record.

    Args:
        table: rows of the record.
        used: columns of the record.
        output: that of the output.
    """
    others = [k for k in range(len(table.names)) if table.named and k not in used]
    for k in others:
        values = table.columns[k][np.isfinite(table.columns[k])]
        if column_quantity(table.names[k], table.units[k]) == "temperature" and values.size and np.ptp(values) > HEATED:
            yield warn(
                Code.CONDITIONS,
                f"the temperature ({table.names[k]!r}) changes from {values.min():.4g} to {values.max():.4g} {table.units[k]} within this "
                "record: its loops are of different states; read those of one temperature (where=), or fit a part (window=)",
            )
    present = np.isfinite(table.columns[output])
    for k in others:
        own = np.isfinite(table.columns[k])
        if column_quantity(table.names[k], table.units[k]) == "error":
            continue
        if table.units[k] and table.units[k] == table.units[output] and own.any() and not (own & present).any():
            yield warn(
                Code.CONDITIONS,
                f"{int(own.sum())} rows hold {table.names[k]!r} in place of {table.names[output]!r}: they are of another mode, and "
                f"count as samples without output (output={table.names[k]!r} reads them alone)",
            )
