"""Tables in long format, a row for each value of each sensor: the sensors become columns."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.column_names import column_quantity
from hystfit.reading.names_with_units import split_unit
from hystfit.reading.raw_table import Table

_MOST = 12  # sensors
_FEWEST = 8  # values of each


def widened(table: Table) -> Table | None:
    """A row for each value of each sensor (time, sensor, value): a column for each sensor; None for other tables."""
    clocks = [k for k in range(len(table.names)) if k in table.stamps or _kind(table, k) == "time"]
    numbers = [
        k
        for k in range(len(table.names))
        if k not in (*clocks, *table.labels) and not table.constant(k) and _kind(table, k) != "index"
    ]
    texts = [k for k, labels in table.labels.items() if 1 < len({*labels.tolist()}) <= _MOST]
    if len(numbers) != 1 or len(texts) != 1 or len(clocks) > 1 or table.part is not None or not table.named:
        return None
    labels = table.labels[texts[0]]
    rows = {name: np.flatnonzero(labels == name) for name in dict.fromkeys(labels.tolist()) if name}
    counts = {chosen.size for chosen in rows.values()}
    times = [table.columns[clocks[0]][chosen] for chosen in rows.values()] if clocks else []
    if len(counts) != 1 or min(counts) < _FEWEST or any(not np.array_equal(times[0], time) for time in times):
        return None
    first = next(iter(rows.values()))
    kept = table.take(first)
    return dataclasses.replace(
        kept,
        names=(*(table.names[k] for k in clocks), *rows),
        units=(*(table.units[k] for k in clocks), *(split_unit(name)[1] for name in rows)),
        columns=(*(kept.columns[k] for k in clocks), *(table.columns[numbers[0]][chosen] for chosen in rows.values())),
        labels={},
        stamps=frozenset(range(len(clocks))) if table.stamps else frozenset(),
        curve=np.zeros(first.size, dtype=int),
        problems={},
        over=(),
    ).noted(
        Note(
            Code.FILE_FORMAT,
            f"a row for each value: {len(rows)} columns by {table.names[texts[0]]!r}: {', '.join(rows)}",
        )
    )


def _kind(table: Table, position: int) -> str:
    return column_quantity(table.names[position], table.units[position])
