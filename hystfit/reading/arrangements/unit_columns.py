"""Tables that give the unit of a column in a column of its own, in every row: `pressure_units`, or `Unit` behind `Reading`."""

from __future__ import annotations

import dataclasses
import re

from hystfit.reading.names.names_with_units import is_unit
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.stated_units import unit_key

_UNIT = frozenset({"unit", "units", "einheit"})  # names of the column behind that of which it states the unit
_COUPLING = re.compile(r" [AD]C$")  # "Volt DC"


def with_unit_columns(table: Table) -> Table | None:
    """The table with the units that columns of one word state; None where there are none."""
    constant = {k: _COUPLING.sub("", str(label[0])) for k, label in table.labels.items() if (label == label[0]).all()}
    stated = {unit_key(table.names[k]): unit for k, unit in constant.items() if is_unit(unit)}
    behind = {k - 1: unit for k, unit in constant.items() if table.names[k].lower() in _UNIT and is_unit(unit)}
    named = enumerate(zip(table.names, table.units, strict=True))
    units = tuple(unit or behind.get(k, "") or stated.get(name.lower(), "") for k, (name, unit) in named)
    return None if units == table.units else dataclasses.replace(table, units=units)
