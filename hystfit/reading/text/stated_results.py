"""Results that an instrument writes beside its loop, from lines such as "Coercivity  +16.3E-03" and "Vc+ [V]: 1119.65"."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from hystfit.data.record import Stated
from hystfit.params.units import quantity as kind_of
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.text import cells
from hystfit.reading.text.header import setting_of

# Names of results by the quantity of `hystfit.results.measured.quantities` that they are.
_NAMES = {
    "coercive_input": r"coerciv(?:e|ity)(?: (?:field|force|voltage|\(remanent\)))?|[HVE]c[bij]?|[bij]Hc",
    "remanence": r"remanence|remanent (?:magneti[sz]ation|polari[sz]ation|induction|moment)|[MPBJ]r",
    "saturation": r"saturation(?: (?:magneti[sz]ation|polari[sz]ation|induction|moment))?|[MPBJ]s(?:at)?",
    "offset_input": r"[VE]_?c_?shift|imprint(?: (?:voltage|field))?",
    "remanence_start": r"Prrel",
    "polarization_tip": r"P_?v?max",
    "switched_polarization": r"Psw",
    "loop_area": r"(?:hysteresis |energy )?loss|W_?loss|loop area",
    "": r"initial slope|slope correction|squareness|S\*|\(?BH\)?[_ ]?max",
}
_RESULT = re.compile(
    "|".join(f"(?P<q{k}>{pattern})" for k, pattern in enumerate(_NAMES.values())).join((r"[±+-]?\s*(?:", r")\s*[+-]?")),
    re.IGNORECASE,
)
_VALUE = re.compile(r"\s*(?P<number>[+-]?[\d.,]*\d[.,]?(?:[eE][+-]?\d+)?)\s*(?P<unit>[^\d\s,;]\S{0,11})?\s*", re.ASCII)


def result_of(title: str, text: str, units: Mapping[str, str] | None = None, decimal: str = ".") -> Stated | None:
    """The result of a name and a number; None where the name is no result, or no number follows.

    Args:
        units: unit of each quantity, where neither name nor number has one.
        decimal: mark of the numbers of the file.
    """
    label, unit = split_unit(cells.clean(title))
    name, value = _RESULT.fullmatch(label.strip()), _VALUE.fullmatch(text)
    number = None if name is None or value is None else cells.number(value["number"], decimal)
    if name is None or value is None or number is None:
        return None
    quantity = list(_NAMES)[int(str(name.lastgroup)[1:])]
    unit = unit or (value["unit"] or "").strip("[]()") or (units or {}).get(quantity, "")
    return Stated(label.strip(), number, unit, "" if kind_of(unit) == "heat flow" else quantity)  # Ps in W/kg is a loss


def stated_in(lines: Iterable[str], units: Mapping[str, str] | None = None, decimal: str = ".") -> tuple[Stated, ...]:
    """The results among the settings of a header, each once."""
    pairs = (pair for line in lines if (pair := setting_of(line)) is not None)
    found = (result_of(key, value, units, decimal) for key, value in pairs)
    return tuple({one.label: one for one in found if one is not None}.values())
