"""Tables with a loop in each row, whose samples stand beside each other: u_0, u_1, ..., y_0, y_1, ..."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.arrangements.side_by_side import numbered, runs_along_rows
from hystfit.reading.limits import FEWEST, OF_RECORD
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Part, Table


def with_row_loops(table: Table) -> Table | None:
    """The samples of each row below each other, a record for each row; None for other tables.

    There are more samples in a row than rows, along which they run unless the rows are too few for samples. A column beside the samples
    that has another value in every row names the records; the others are their properties.
    """
    runs = _runs(table)
    if len(runs) < 2 or len({len(run) for run in runs.values()}) > 1:
        return None
    signals = [np.column_stack([table.columns[k] for k in run]) for run in runs.values()]
    rows, length = signals[0].shape
    complete = all(np.isfinite(signal).all() for signal in signals)
    if not complete or rows >= length or (rows >= FEWEST and not runs_along_rows(*signals)):
        return None
    others = [k for k in table.positions if not any(k in run for run in runs.values())]
    texts = {k: _texts(table, k) for k in others}
    name = next((k for k in others if len({*texts[k]}) == rows > 1), None)
    told = "" if name is None or name in table.labels else f"{table.names[name]} "
    titles = [""] * rows if name is None else [told + text for text in texts[name]]
    base = table.whole
    properties = [base.metadata | {table.names[k]: texts[k][row] for k in others if k != name} for row in range(rows)]
    number = np.repeat(np.arange(rows), length)
    loops = dataclasses.replace(
        table.select([run[0] for run in runs.values()]).take(number),
        names=tuple(runs),
        columns=tuple(map(np.ravel, signals)),
        curve=number,
        part=number,
        parts=tuple(Part(title, own) for title, own in zip(titles, properties, strict=True)),
    )
    return loops.noted(Note(Code.CURVES, f"{rows} loops of {length} samples, one in each row"))


def _texts(table: Table, position: int) -> list[str]:
    """The cells of a column."""
    if position in table.labels:
        return [*map(str, table.labels[position])]
    return [f"{value:g}" for value in table.columns[position]]


def _runs(table: Table) -> dict[str, list[int]]:
    """Positions of the columns of each name that differ in a number alone, which goes up by one; with the unit in the name."""
    found: dict[str, list[tuple[int, int]]] = {}
    for position, name in enumerate(table.names if table.named else ()):
        (base, number), unit = numbered(name), split_unit(name)[1]
        if number is not None and position not in table.labels:
            found.setdefault(f"{base} [{unit}]" if unit else base, []).append((number, position))
    long = {base: run for base, run in found.items() if len(run) >= OF_RECORD}
    counted = all([number for number, _ in run] == [*range(run[0][0], run[0][0] + len(run))] for run in long.values())
    return {base: [position for _, position in run] for base, run in long.items()} if counted else {}
