"""Columns whose unit has a factor, "M (10^-3 emu)", or whose name has a minus sign, -H (kOe), as in tables of demagnetization curves."""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.names.scaled_units import factor_of
from hystfit.reading.table.raw_table import Table

_NEGATED = re.compile(r"[-−–]\s*(?=(?:[µμ]_?[0₀]?)?H\b|[Ff]ield|[Ff]eld)")


def unscaled(table: Table) -> Table | None:
    """The columns in their units without the factors that these are written with; None where there is none."""
    found = {k: factor_of(unit) for k, unit in enumerate(table.units)}
    sign = lambda k: -1.0 if _NEGATED.match(table.names[k]) and np.nanmin(table.columns[k], initial=0.0) >= 0 else 1.0
    found = {k: (sign(k) * factor, unit) for k, (factor, unit) in found.items() if k not in table.labels}
    scaled = {k: (factor, unit) for k, (factor, unit) in found.items() if factor != 1.0}
    if not scaled:
        return None
    replaced = lambda values, of: tuple(of(k) if k in scaled else value for k, value in enumerate(values))
    listed = ", ".join(f"{table.names[k]!r} by {factor:g}" for k, (factor, _) in scaled.items())
    return dataclasses.replace(
        table,
        names=replaced(
            table.names, lambda k: _NEGATED.sub("", _named_with(table.names[k], table.units[k], scaled[k][1]), 1)
        ),
        units=replaced(table.units, lambda k: scaled[k][1]),
        columns=replaced(table.columns, lambda k: scaled[k][0] * table.columns[k]),
    ).noted(
        Note(
            Code.UNITS,
            f"the unit has a factor, or the name a minus sign, by which the numbers are multiplied: {listed}",
        )
    )


def _named_with(name: str, unit: str, other: str) -> str:
    """A name with another unit in the place of its own; without the brackets around it where the other one is none."""
    return name.replace(unit, other) if other else re.sub(rf"\s*[\[(]?{re.escape(unit)}[\])]?", "", name)
