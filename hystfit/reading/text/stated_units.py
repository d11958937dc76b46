"""Units of columns in lines of the header that are called so, apart from the names."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hystfit.params.units import quantity
from hystfit.reading.names.column_names import column_quantity
from hystfit.reading.names.names_with_units import is_unit
from hystfit.reading.text import cells
from hystfit.reading.text.header import UNIT_CELL, setting_of
from hystfit.reading.text.listed_names import behind_words

_UNIT_KEY = re.compile(r"units?[ _](?:of[ _])?(?P<by>\w+)|(?P<of>\w+?)[ _]?units?", re.IGNORECASE)
_PER_VOLT = re.compile(r"(?:scale|slope|gain|sensitivity)\W.*(?:units?|eu)/v(?:olt)?s?\b")


def unit_key(name: str) -> str:
    """The column whose unit a setting or a column of this name states ("loading_unit", "Units of force"), in lower case; "" for others."""
    match = _UNIT_KEY.fullmatch(name.strip("_"))
    return "" if match is None else (match["of"] or match["by"]).lower()


def stated_units(above: Sequence[str], names: Sequence[str], delimiter: str | None) -> list[str]:
    """Units in lines of the header that are called so.

    They are those of a column by its name ("loading_unit", "Units of force"), those of all columns ("UNIT = gf,mm"), or those of the
    columns after the first ("Y_Unit_Label", "VUnit", not "HUnit").
    """
    width = len(names)
    if width > 1 and (all_of_them := behind_words(above, width).get(True)) and all(map(is_unit, all_of_them)):
        return all_of_them
    settings = [pair for line in above if (pair := setting_of(line)) is not None]
    known = {unit_key(key): unit for key, unit in settings}
    known = _below_title(above) | known
    if any(listed := _by_quantity(settings, names)):
        return listed
    if any(named := [unit if name and is_unit(unit := known.get(name.lower(), "")) else "" for name in names]):
        return named
    for line in reversed(above):
        title, *units = [cells.clean(cell) for cell in line.rstrip(" \t;,").split(delimiter)] or [""]
        units = ["" if unit in ("*", "-", title) else unit for unit in units]  # the title again, above each clock
        known = [unit for unit in units if is_unit(unit)]  # "TTL" is that of no quantity
        enough = len(known) > 1 and 2 * len(known) >= len([*filter(None, units)])
        if (re.search("unit", title, re.IGNORECASE) or UNIT_CELL.fullmatch(title)) and enough and len(units) < width:
            units = [unit if unit in known else "" for unit in units]
            if all(quantity(unit) == "time" for unit in known):
                continue
            return ["", *_of_volts(units, above, delimiter), *[""] * (width - 1 - len(units))]
    return [""] * width


def _below_title(above: Sequence[str]) -> dict[str, str]:
    """Units by the names of their columns, in lower case, in lines that are set in below one that says "units:", as in YAML."""
    found: dict[str, str] = {}
    depth: int | None = None  # of the title, while lines are set in below it
    for line in above:
        text = line.lstrip("#%! ")
        inside = len(line) - len(text)
        if text.strip().lower() in ("unit:", "units:"):
            depth = inside
        elif depth is not None and inside > depth and (pair := setting_of(text)) is not None:
            found[pair[0].lower()] = pair[1]
        else:
            depth = None
    return found


def _by_quantity(settings: Sequence[tuple[str, str]], names: Sequence[str]) -> list[str]:
    """Units of a system, one for each quantity, in a line such as "units: in, kip, sec", for the columns of these quantities."""
    for key, value in settings:
        units = [unit for unit in re.split(r"[\s,;]+", value) if unit]
        kinds = [quantity(unit) for unit in units]
        if key.lower() in ("unit", "units") and len(units) > 1 and all(kinds) and len({*kinds}) == len(kinds):
            known = dict(zip(kinds, units, strict=True))
            return [known.get(column_quantity(name), "") for name in names]
    return [""] * len(names)


def _of_volts(units: list[str], above: Sequence[str], delimiter: str | None) -> list[str]:
    """Units of channels with the scale of each, where the header states one per volt; "V" where zeros of sensors are stated too."""
    rows = [[cells.clean(cell) for cell in line.rstrip(" \t;,").split(delimiter)] for line in above]
    numbers = {
        row[0].lower(): [cells.number(cell, ".") for cell in row[1:]] for row in rows if len(row) == len(units) + 1
    }
    scales = next((values for title, values in numbers.items() if _PER_VOLT.match(title)), None)
    if scales is None or None in scales:
        return units
    zeros = next((values for title, values in numbers.items() if title.startswith(("offset", "zero"))), [0.0])
    if any(zeros):
        return ["V"] * len(units)
    return [
        unit if scale == 1.0 or not unit else f"{scale:g} × {unit}" for scale, unit in zip(scales, units, strict=True)
    ]
