"""Units with a factor before them, as in "M (10^-3 emu)", "Field (×10⁴ A/m)" and "Force (500 × mN)": the numbers are multiplied by it.

So are those of a field whose name has a minus sign, -H (kOe), as in tables of demagnetization curves.
"""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.table.raw_table import Table

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺−", "0123456789-+-")
_FACTOR = re.compile(
    r"(?:[x×*·]\s*)?(?:10\s*(?:(?:\^|\*\*)\s*\{?(?P<power>[+−-]?\d{1,2})\}?|(?P<raised>[⁻⁺]?[⁰¹²³⁴-⁹]{1,2})|(?P<flat>[+−-]\d))"
    r"|1[eE](?P<exponent>[+-]?\d{1,2}))\s*[x×*·]?\s*(?=[^\d\s]|$)"
)
_NUMBER = r"\d{1,9}(?:\.\d{1,9})?(?:[eE][+-]?\d{1,2})?"
_TIMES = re.compile(rf"(?:(?P<number>{_NUMBER})\s*[x×*·]|[x×*·]\s*(?P<after>{_NUMBER}))\s*(?=[^\W\d])")

_NEGATED = re.compile(r"[-−–]\s*(?=(?:[µμ]_?[0₀]?)?H\b|[Ff]ield|[Ff]eld)")


def factor_of(unit: str) -> tuple[float, str]:
    """The factor before a unit, and the unit without it; 1 where there is none. "10-3" has lost its superscript."""
    if match := _FACTOR.match(unit):
        power = next(filter(None, match.groups())).translate(_SUPERSCRIPTS)
        return float(f"1e{power}"), unit[match.end() :].strip()
    if match := _TIMES.match(unit):
        return float(match["number"] or match["after"]), unit[match.end() :].strip()
    return 1.0, unit


def _named_with(name: str, unit: str, other: str) -> str:
    """A name with another unit in the place of its own; without the brackets around it where the other one is none."""
    return name.replace(unit, other) if other else re.sub(rf"\s*[\[(]?{re.escape(unit)}[\])]?", "", name)


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
