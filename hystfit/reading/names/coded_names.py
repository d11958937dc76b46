"""Names of columns that are codes, as of the tables of river gauges (RDB): comments above the numbers say what each code means."""

from __future__ import annotations

import re
from collections.abc import Sequence

_CODES = re.compile(r"\d{2,}(?:_\d{2,})+")  # 69928_00060: a series and a parameter
_UNITS = {"cubic feet per second": "ft3/s", "cubic meters per second": "m3/s", "feet": "ft", "meters": "m"}


def with_meanings(names: Sequence[str], above: Sequence[str]) -> tuple[list[str], list[str]]:
    """The names and units of columns, where a line above the numbers has the codes of a name and then the quantity and its unit.

    "69928 00060 Discharge, cubic feet per second" explains 69928_00060. Other names stay, without a unit.
    """
    found, units = list(names), [""] * len(names)
    for k, name in enumerate(names):
        codes = name.split("_") if _CODES.fullmatch(name) else []
        for words in (line.strip("#% \t\r\n").split(None, len(codes)) for line in above if codes):
            if words[:-1] == codes:
                meaning, *more = re.sub(r"\s*\([^()]*\)$", "", words[-1]).split(", ")
                found[k], units[k] = meaning, _UNITS.get(more[-1].lower(), "") if more else ""
    repeated = {name for name in found if found.count(name) > 1}
    return [name if new in repeated else new for name, new in zip(names, found, strict=True)], units
