"""Tables that give the unit of a column in a column of its own, in every row: `pressure` beside `pressure_units`."""

from __future__ import annotations

import dataclasses

from hystfit.reading.header import unit_key
from hystfit.reading.names_with_units import is_unit
from hystfit.reading.raw_table import Table


def with_unit_columns(table: Table) -> Table | None:
    """The table with the units that columns of one word state; None where there are none."""
    constant = {k: str(label[0]) for k, label in table.labels.items() if (label == label[0]).all()}
    stated = {unit_key(table.names[k]): unit for k, unit in constant.items() if is_unit(unit)}
    units = tuple(unit or stated.get(name.lower(), "") for name, unit in zip(table.names, table.units, strict=True))
    return None if units == table.units else dataclasses.replace(table, units=units)
