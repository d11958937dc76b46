"""Tables in long format, a row for each value of each sensor: the sensors become columns."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.limits import MOST_LABELS, OF_RECORD
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Table


def widened(table: Table) -> Table | None:
    """A row for each value of each sensor (time, sensor, value): a column for each sensor; None for other tables.

    Sensors that write a value only where it changes, each at times of its own, hold it until the next one.
    """
    clocks = table.clocks
    numbers = [
        k
        for k in table.positions
        if k not in (*clocks, *table.labels) and not table.constant(k) and table.quantity(k) != "index"
    ]
    texts = [k for k, labels in table.labels.items() if 1 < len({*labels.tolist()}) <= MOST_LABELS]
    if len(numbers) != 1 or len(texts) != 1 or len(clocks) > 1 or table.part is not None or not table.named:
        return None
    labels = table.labels[texts[0]]
    rows = {name: np.flatnonzero(labels == name) for name in dict.fromkeys(labels.tolist()) if name}
    found = _beside(table, numbers[0], clocks, [*rows.values()])
    if found is None:
        return None
    kept, columns, text = found
    return dataclasses.replace(
        kept,
        names=(*(table.names[k] for k in clocks), *rows),
        units=(*(table.units[k] for k in clocks), *(split_unit(name)[1] for name in rows)),
        columns=(*(kept.columns[k] for k in clocks), *columns),
        labels={},
        stamps=frozenset(range(len(clocks))) if table.stamps else frozenset(),
        curve=np.zeros(kept.rows, dtype=int),
        problems={},
        over=(),
    ).noted(Note(Code.FILE_FORMAT, f"{text}: {len(rows)} columns by {table.names[texts[0]]!r}: {', '.join(rows)}"))


def _beside(
    table: Table, value: int, clocks: list[int], rows: list[np.ndarray]
) -> tuple[Table, list[np.ndarray], str] | None:
    """One row of the table for each time, the values of each sensor then, and how they were joined; None where they are no signals.

    Args:
        value: position of the column of values.
        rows: those of each sensor.
    """
    values, times = table.columns[value], [table.columns[clocks[0]][chosen] for chosen in rows] if clocks else []
    sizes = {chosen.size for chosen in rows}
    if len(sizes) == 1 and min(sizes) >= OF_RECORD and all(np.array_equal(times[0], time) for time in times):
        return table.take(rows[0]), [values[chosen] for chosen in rows], "a row for each value"
    if not times or max(sizes) < OF_RECORD or min(sizes) < 2 or any((np.diff(time) < 0).any() for time in times):
        return None
    known = [chosen[np.isfinite(values[chosen])] for chosen in rows]
    if not all(chosen.size for chosen in known):
        return None
    clock = table.columns[clocks[0]]
    order = np.argsort(clock, kind="stable")
    order = order[clock[order] >= max(clock[chosen[0]] for chosen in known)]
    order = order[np.append(np.diff(clock[order]) > 0, True)]  # the last row of each time
    last = [np.searchsorted(clock[chosen], clock[order], side="right") - 1 for chosen in known]
    held = [values[chosen[place]] for chosen, place in zip(known, last, strict=True)]
    return table.take(order), held, "a row for each change of a value, which holds until the next one"
