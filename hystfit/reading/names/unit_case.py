"""Units in the wrong case: "force_kn", "Stress (mpa)", "H (KA/M)", "torque_nm".

The quantity that a name states tells which unit is meant.
"""

from __future__ import annotations

import functools
import re

from hystfit.params.units import quantity
from hystfit.reading.names.branch_words import words_of
from hystfit.reading.names.vocabulary import WORDS

# Symbols of units in lower case, and how they are written.
_SYMBOLS = {
    symbol.lower(): symbol
    for symbol in "N kN Pa hPa kPa MPa GPa V mV kV A uA mA kA Oe kOe Gs kGs T mT uT Hz kHz C uC nC K F Nm kNm Ah mAh emu Wb mWb".split()
    + "m mm cm um s ms us g kg rad deg".split()
} | {
    "am2": "Am2", "percent": "%", "ue": "ustrain", "degc": "degC", "am": "A/m", "kam": "kA/m", "kvcm": "kV/cm", "uccm2": "uC/cm2",
    "kgcm": "kgf*cm", "kgfcm": "kgf*cm", "kgm": "kgf*m",
}  # fmt: skip
_POWERS = {f"{unit}{power}": f"{unit}{power}" for unit in ("m", "mm", "cm") for power in (2, 3)}
_OVER = _SYMBOLS | {"mv": "MV"}  # of a strong electric field
# Quantities in a name for which a unit of another quantity stands.
_STATED = {
    "stress": {"pressure"},
    "field": {"magnetization"},
    "induction": {"field", "magnetization", "polarization"},
    "electric field": {"field", "strain"},  # E is also the symbol of a strain
    "state of charge": {"charge"},
    "polarization": {"charge", "displacement"},  # D
    "charge": {"temperature", "polarization"},  # C for degrees Celsius
    "capacitance": {"temperature"},
    "magnetization": {"moment"},
    "moment": {"magnetization"},
    "flux": {"induction"},
}
_SYMBOLS_OF = {"v": "voltage", "u": "voltage", "i": "current", "h": "field", "b": "induction", "tension": "force"}
# Voltages and currents of terminals: vg, vds, id.
_TERMINAL = re.compile(r"([uvi])(?:[gds]|[gd][sdb]|in|out|rms|cell|meas|set)?\d?")
_TORQUE = frozenset({"torque", "moment", "torsion", "couple", "drehmoment", "tau"})
_MOMENTS = {"n/m": "N*m", "kn/m": "kN*m", "n/mm": "N*mm", "kn/mm": "kN*mm"}  # of names whose underscores join factors
_SURE = frozenset("kpa mpa gpa hpa oe koe khz ka/m kv/cm kv/mm uc/cm2 knm".split())  # whatever the name
# Units that no loop is measured in, of columns whose names are in capitals or whose unit has a capital as a sentence has.
_HUGE = frozenset({"MA", "MV", "MT"})


@functools.lru_cache(maxsize=4096)
def in_case(name: str, unit: str) -> str:
    """A unit as it is written, for one in the wrong case of a column with this name; "" where it is no such unit."""
    plain = unit.replace("µ", "u").replace("μ", "u").lower()
    torque = plain == "nm" and not _TORQUE.isdisjoint(words_of(name))
    huge = unit == "Mm" or (unit in _HUGE and len(name) > 1 and name.isupper())
    if quantity(unit) and not (torque or huge):
        return ""
    over, slash, under = plain.partition("/")
    written = (_OVER if slash else _SYMBOLS).get(over, "")
    if slash:
        below = (_SYMBOLS | _POWERS).get(under, "")
        written = f"{written}/{below}" if written and below else ""
    if not written or written == unit:
        return ""
    return written if _agrees(name, written) or plain in _SURE else ""


def is_symbol(text: str) -> bool:
    """Whether a text is a unit, whatever its case; a single letter is also an index: of the phases i_a, i_b, of the normal force f_n."""
    return len(text) > 1 and text.lower() in _SYMBOLS


def split_in_case(name: str) -> tuple[str, str] | None:
    """Name and unit of "force_kn", "field_ka_m" and "e_kv_per_cm"; None for other names."""
    parts = name.split("_")
    for count in (3, 2, 1):
        base, unit = "_".join(parts[:-count]), parts[-count:]
        if not base or (count == 3 and unit[1].lower() != "per"):
            continue
        if count == 1 == len(unit[0]) and len(base) == 1 and base.lower() not in _SYMBOLS_OF:
            continue
        text = unit[0] if count == 1 else f"{unit[0]}/{unit[-1]}"
        if count == 2 and text.lower() in _MOMENTS and not _TORQUE.isdisjoint(words_of(base)):
            return base, _MOMENTS[text.lower()]
        if written := in_case(base, text):
            return base, written
    return None


def _agrees(name: str, unit: str) -> bool:
    """Whether the quantity of a unit is one that the name states."""
    kinds, words = _kinds(name), words_of(name)
    if unit == "%":
        return len(name) > 1
    if unit.endswith(("Nm", "kgf*cm", "kgf*m")):
        return not _TORQUE.isdisjoint(words)
    of_unit = quantity(unit)
    return bool(kinds & ({of_unit} | _STATED.get(of_unit, set())))


def _kinds(name: str) -> set[str]:
    """Quantities that the words of a name state."""
    words = [*words_of(name), name.strip().lower().replace(" ", "_")]
    if terminal := _TERMINAL.fullmatch(name.lower().replace("_", "")):
        words.append(terminal[1])
    return {kind for word in words for kind in (WORDS.get(word), _SYMBOLS_OF.get(word)) if kind}
