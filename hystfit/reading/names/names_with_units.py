"""Units in the names of columns: "t_s", "H_A_per_m", "Force [kN]", "Moment / A m2"."""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence

from hystfit.params.units import ONE_CHARACTER, parse_unit, quantity
from hystfit.reading.limits import LONGEST
from hystfit.reading.names.scaled_units import factor_of
from hystfit.reading.names.unit_case import in_case, split_in_case
from hystfit.reading.names.vocabulary import WORDS

_BASE = (
    r"(?:[pnuµμm]?s|[pnuµμmckMG]?(?:Gs|V|A|m|N|Pa|T|G|Oe|C|Hz|W|J|g|Wb|rad|[oO]hms?|Ω|Ω|K|bar|emu|Am2|Am|Nm|Ncm|Nmm|[sS]ec|psi|gf|lbf))|[uµμm]strain"
    r"|in|inch|ft|lb|lbs|kips?|kgf|ksi|min|h|hr|deg|degC|°C|°|%|rpm|counts|volts?|newtons?|meters?|seconds?|erg|cc|cm3|dB"
)
_POWER = r"(?:\^?[-⁻]?[1-4¹²³])?"
_UNIT = re.compile(rf"(?:{_BASE}){_POWER}(?:\s*[/*·.⋅ ]\s*(?:{_BASE}){_POWER})*")
# Quotients whose slash is an underscore in a name: numerator_denominator.
_JOINED = re.compile(
    r"(.+)_(?:([kM]?V)_([cmuµ]?m)|([mkM]?A)_(c?m2?)|([pnuµm]?C)_(c?m2|g|kg)|([mu]?emu)_(g|cm3|cc|mol|cm2)|(Am2)_(k?g)"
    r"|([mkM]?N)_([cm]?m2?)|([nuµmc]?m|m?rad|deg)_(s2?)|(pm)_(V)|(k?J|J|erg)_(c?m3|k?g|cc)|(k?g)_(c?m3)"
    r"|([kM]?Pa|k?Oe|m?T|K|degC)_(s|min)|(Nm)_(kg)|([kmM]?W)_(c?m2)"
    r"|([mun]?mol|mg|c?m3|cc|m[lL])_(k?g)|([mun]?g|[mu]?mol)_?([lL])|(1)_([cm]?m))"
)
# Flows and fluxes: Q_m3s, Q_mL_min, sapflow_cm3_cm2_h, nee_umol_m2_s.
_FLOW = re.compile(r"(.+?)[_ ](c?m3|ft3|[mu]?[Ll])[_/]?(s|min|h)")
_FLOWS = {"cms": "m3/s", "cfs": "ft3/s", "lpm": "L/min", "slpm": "L/min", "sccm": "cm3/min", "gpm": "gal/min"}
_FLUX = re.compile(r"(.+?)_([mnuµ]?mol|c?m3|[mk]?g|[MkmW]?J|m?L)_(c?m2|k?g)_(s|min|h|hr|d|day)")
_WIDE = str.maketrans("（）［］【】／", "()[][]/") | ONE_CHARACTER  # of Chinese and Japanese text
_CYRILLIC = dict(
    zip(
        "мм см м мкм нм Н кН Па кПа МПа с сек мс В кВ мВ А мА Тл мТл Э кЭ А/м кА/м Гц мин ч".split(),
        "mm cm m um nm N kN Pa kPa MPa s s ms V kV mV A mA T mT Oe kOe A/m kA/m Hz min h".split(),
        strict=True,
    )
)
_ELECTRIC = {"V": "voltage", "I": "current"}  # symbols whose one-letter index is no unit of another quantity: V_G, I_C
_CLOCKS = {"millis": "ms", "micros": "us"}  # of Arduino
# Words in brackets that tell how a column was processed or where it was measured.
_NO_UNIT = re.compile(r"[a-z]+ed|raw|avg|mean|left|right|top|bottom", re.IGNORECASE)
_LENGTHS = frozenset({"x", "y", "z", "d", "pos", "position", "disp", "displacement", "length"})
# Names of columns that are no more than a unit, and that unit.
_BARE_UNITS = {
    unit: unit
    for unit in "day ms us µs μs ns mT µT uT Oe kOe emu mV kV mA µA uA nA µm um nm kN MPa kPa hPa mV/V µV/V".split()
} | {"kpa": "kPa"}
_ARBITRARY = frozenset(
    {"a.u.", "a.u", "arb. units", "arb.u.", "arb. unit", "arb", "adu", "p/p0"}
)  # units that are no quantity
_NAMES_TOO = frozenset({"strain", "count", "angle", "percent", "at"})  # names of columns besides units
# Of a torque, "in lb"; before other units "in" is a word, as in "in V".
_OVER_INCHES = frozenset({"lb", "lbs", "lbf", "oz", "ozf", "kip", "kips", "klbf"})
_NOT_SUFFIX = frozenset(
    {"min", "h", "counts", "second", "minute", "hour", "degree", "foot"}
)  # x_min is a minimum, not minutes
_NODE = re.compile(
    r"[NVAWJKGTL](?:\d|_in)"
)  # number of a node, an element or a channel, or its input: U1_N5, I(V1), run1/V_in
# Names before the "in" that is an inch: x_in, stroke_in; that of v_in, air_in and sw_in is the way in.
_INCHES = re.compile(
    r"x|y|z|d|l|(?:.*[_ ])?(?:\w*(?:pos|disp|dist|drift|defl|stroke|travel|slip|lift|gap|width|length|height|elong|ext|lvdt|pot)\w*)",
    re.IGNORECASE,
)
_OF_CIRCUITS = re.compile(
    r"(V)|I[a-z]?", re.IGNORECASE
)  # voltage of a node, V(out), and current of an element, I(L1), Ic(Q1), in tables of SPICE
RATIO = re.compile(r"([A-Za-z])/\1_?\w+")  # of a quantity to its own saturation or start: M/M_s, B/Bs, R/R0
_WORD = 4  # letters from which a unit is written as a word


def is_unit(text: str) -> bool:
    """Whether a text is a unit as laboratories write them, and not more likely a name."""
    text = text.translate(ONE_CHARACTER)
    if text.isdigit() or _NODE.fullmatch(text):  # P_11 is a component
        return False
    if _UNIT.fullmatch(text) or text.lower() in _ARBITRARY:
        return True
    factor, scaled = factor_of(text)
    if factor != 1.0:
        return not scaled or is_unit(scaled)
    return len(text) > 1 and text.lower() not in _NAMES_TOO and (parse_unit(text) is not None or quantity(text) != "")


def split_unit(name: str, siblings: Sequence[str] = ()) -> tuple[str, str]:
    """Name and unit of a column header such as "t_s", "H_A_per_m", "P_uC_cm2", "v_m/s", "Force [kN]", "Force (kN)", "Force / kN"."""
    name = name.strip().translate(_WIDE)
    if len(name) > LONGEST:
        return name, ""
    return _split(name, siblings) if siblings else _split_alone(name)


@functools.lru_cache(maxsize=4096)
def _split_alone(name: str) -> tuple[str, str]:
    return _split(name, ())


def _split(name: str, siblings: Sequence[str]) -> tuple[str, str]:
    if (match := re.fullmatch(r"(.+?[\s,([]+)([А-я/]{1,4})([)\].]*)", name)) and match[2] in _CYRILLIC:
        name = match[1] + _CYRILLIC[match[2]] + match[3]
    if bare := _BARE_UNITS.get(name) or _CLOCKS.get(name.lower()):
        return name, bare
    if RATIO.fullmatch(name):
        return name, ""
    if len(name) >= _WORD and name.isalpha() and is_unit(name):
        return name, name  # Volts
    base, unit = (
        _in_brackets(name)
        or _in_lower_case(name, siblings)
        or _quotient_in_words(name)
        or _behind_mark(name)
        or _behind_blank(name, siblings)
        or _behind_underscore(name, siblings)
        or _before_label(name)
        or (name, "")
    )
    return base, in_case(base, unit) or unit


def _in_brackets(name: str) -> tuple[str, str] | None:
    """Force [kN], V(out); None for a name without brackets, and where they hold no unit."""
    if not name.endswith(("]", ")", ">")) or (start := _opening(name)) <= 0:
        return None
    base, unit = name[:start].rstrip(" \t_"), name[start + 1 : -1].strip()
    if (worded := re.fullmatch(r"in\s+(\S+)", unit)) and worded[1] not in _OVER_INCHES and is_unit(worded[1]):
        unit = worded[1]
    known = not _NODE.fullmatch(unit) and bool(is_unit(unit) or in_case(base, unit))
    closed = known or not re.search(r"[\])>]", unit)
    lettered = len(unit) == 1 and unit.islower() and name == f"{base}({unit})" and base in _ELECTRIC
    node = unit == "in" or (lettered and quantity(unit) != _ELECTRIC[base])  # V(h) is no time
    if (of_circuit := _OF_CIRCUITS.fullmatch(base)) and (not known or node):
        return name, "V" if of_circuit[1] else "A"
    if not (base and closed):
        return None
    inner, of_inner = split_unit(unit) if "/" in unit or "," in unit else (unit, "")
    if not is_unit(unit) and not inner.isascii() and is_unit(of_inner):
        return f"{base} {inner}", of_inner  # 1-1(位移/mm)
    if is_unit(unit) or (re.match(r"\D*[A-Za-z%°]", unit) and len(unit) <= 12 and not _NO_UNIT.fullmatch(unit)):
        return base, unit
    if re.match(r"\d+[.,]?\d*\s*[A-Za-z%°]", unit):  # M (300 K): a condition
        return base, ""
    if unit in ("-", "1", "") and not re.search(r"\w\[1\]$", name):  # x[1]: column of a matrix
        return base, ""
    return None


def _before_label(name: str) -> tuple[str, str] | None:
    """Position (m) Run #1, "Temp, degC (LGR S/N: 20)"; None for names without a unit and a label of the run or the sensor behind it."""
    match = re.fullmatch(r"(\w.*?)(?:\s*[(\[]([^()\[\]]+)[)\]](\s.*)|,\s*(\S+)(\s\(.*\)))", name)
    base, unit, label = (match[1], match[2] or match[4], match[3] or match[5]) if match else ("", "", "")
    return (base + label, unit) if is_unit(unit) and (quantity(unit) or "/" in unit) else None


def _quotient_in_words(name: str) -> tuple[str, str] | None:
    """H_A_per_m, Q_m3s, P_uC_cm2; None for other names."""
    if match := re.fullmatch(r"(.+?)[_ ]([A-Za-zµμ]+)_per_([A-Za-z]+\d?)", name) or _FLOW.fullmatch(name):
        return match[1], f"{match[2]}/{match[3]}"
    base, _, unit = name.rpartition("_")
    if base and unit in _FLOWS:
        return base, _FLOWS[unit]
    if match := _FLUX.fullmatch(name):
        return match[1], f"{match[2]}/{match[3]}/{match[4]}"
    if match := _JOINED.fullmatch(name):
        over, under = filter(None, match.groups()[1:])
        if not (match[1].lower() in _LENGTHS and over in ("A", "V", "C")):  # x_A_m is the position of A
            return match[1], f"{over}/{under}"
    return None


def _behind_mark(name: str) -> tuple[str, str] | None:
    """H_kA/m, Moment / A m2, "Force, kN", Force|kN, "Field in kA/m"; None for other names."""
    # Of a quotient that is no quantity, the first part belongs to the name: U_A/V is U_A in V.
    if (match := re.fullmatch(r"([^/]+)[_ ]([^_/\s]+/[^_/\s]+)", name)) and is_unit(match[2]) and quantity(match[2]):
        return match[1], match[2]
    if (match := re.fullmatch(r"(.+?)(?:\s*[/,|]\s*|\s+in\s+)(\S(?:.*\S)?)", name)) and is_unit(match[2]):
        return match[1].strip(), match[2]
    return None


def _behind_blank(name: str, siblings: Sequence[str]) -> tuple[str, str] | None:
    """Force kN, Velocity m/s; None for other names.

    A unit of one letter is more likely a part of the name, as in Channel A, unless all columns have one.
    """
    match = re.fullmatch(r"(.*\S) (\S+)", name)
    known = match is not None and (is_unit(match[2]) or (len(match[2]) > 1 and bool(in_case(match[1], match[2]))))
    if not match or not known or match[2] in _NOT_SUFFIX or _is_role(match[1], match[2], siblings):
        return None
    spelled = not (len(match[2]) == 1 and match[2].isalpha()) and re.search(r"[^\W\d_]{2}\.?$", match[1])
    last = WORDS.get(match[1].lower().split()[-1], "")  # Force N, Current A, and not phase A beside phase B
    spelled = spelled or (last == quantity(match[2]) != "" and len(_indices(match[1], siblings, " ")) < 2)
    return (match[1], match[2]) if spelled or _all_have_units(siblings) else None


def _behind_underscore(name: str, siblings: Sequence[str]) -> tuple[str, str] | None:
    """t_s, x_um; None for other names."""
    match = re.fullmatch(r"(.+)_([^_]+)", name)
    if not match or not is_unit(match[2]) or match[2] in _NOT_SUFFIX:
        return None
    labels = len(match[2]) == 1 and any(not is_unit(other) for other in _indices(match[1], siblings))
    terminal = len(match[2]) == 1 and quantity(match[2]) != _ELECTRIC.get(match[1], quantity(match[2]))
    if labels or terminal or _is_role(match[1], match[2], siblings):
        return None  # I_A, I_B, I_C are currents of three phases, V_G the voltage of a gate
    return match[1], match[2]


def _in_lower_case(name: str, siblings: Sequence[str]) -> tuple[str, str] | None:
    """force_kn, field_ka_m; None for other names."""
    found = split_in_case(name) if "_" in name else None
    one = found is not None and len(name) == len(found[0]) + 2
    return None if found is None or (one and len(_indices(found[0], siblings)) > 1) else found


def _indices(base: str, siblings: Sequence[str], mark: str = "_") -> set[str]:
    """Single letters behind a name and a mark: a, b and c of i_a, i_b and i_c."""
    others = {other[len(base) + 1 :] for other in siblings if other.startswith(f"{base}{mark}")}
    return {other for other in others if len(other) == 1}


def _all_have_units(names: Sequence[str]) -> bool:
    """Whether each of several names, none of them twice, has a unit behind it: Time s, Vplus V, I1 A."""
    pairs = [name.strip().rpartition(" ") for name in names]
    bases = {base for base, _, _ in pairs}
    return len(bases) == len(pairs) > 1 and all(base and is_unit(unit) for base, _, unit in pairs)


def _opening(name: str) -> int:
    """Place of the bracket that the last one of a name closes; -1 without one."""
    marks, depth = {"]": "[", ")": "(", ">": "<"}, 0
    for place in range(len(name) - 1, -1, -1):
        depth += (name[place] == name[-1]) - (name[place] == marks[name[-1]])
        if not depth:
            return place
    return -1


def _is_role(base: str, unit: str, siblings: Sequence[str]) -> bool:
    """Whether the "in" after a name is no inch: v_in is an input voltage, beside v_out."""
    beside = any(f"{base}{mark}out".lower() == other.lower() for mark in "_ " for other in siblings)
    return unit.lower() == "in" and (_INCHES.fullmatch(base) is None or beside)
