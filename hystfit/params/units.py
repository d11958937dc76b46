"""Units: of parameters, as expressions in the units of the data ("y/u" is um/V on a piezo record), and of measured columns.

One expression gives both the printed unit and the natural size of a parameter: with u in V over 100 V and y in um
over 10 um, "y/u" prints as "um/V" and scales as 0.1. Symbols: u input, y output, s time; "1" has no unit. A unit in brackets, such
as [degC], is that of another quantity: it prints as it is, with the size 1.

The units of columns are a table of sizes and dimensions. General packages treat Oe and emu as units of another system, which they
do not convert to A/m and A m^2, and those are the units of magnetic loops.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import re
import unicodedata

from hystfit.errors import DataError, ParameterError

_FACTOR = re.compile(r"^(?P<symbol>1|u|y|s|sample|\[\w+\])(?:\^(?P<power>-?\d+(?:\.\d+)?))?$")


def exponents(unit: str) -> dict[str, float]:
    """Powers of the symbols in a unit expression such as "y/u^2" or "u*s/y"."""
    powers: dict[str, float] = {}
    for sign, part in _parts(unit):
        match = _FACTOR.match(part)
        if match is None:
            raise ParameterError(
                f"unit {unit!r}: expected factors 1, u, y, s or sample joined by * and /, found {part!r}"
            )
        if match["symbol"] != "1":
            power = sign * float(match["power"] or 1.0)
            powers[match["symbol"]] = powers.get(match["symbol"], 0.0) + power
    return {symbol: power for symbol, power in powers.items() if power}


def _parts(unit: str) -> list[tuple[int, str]]:
    pieces = re.split(r"([*/])", unit.replace(" ", "") or "1")
    signs = [1] + [1 if mark == "*" else -1 for mark in pieces[1::2]]
    return list(zip(signs, pieces[0::2], strict=True))


@dataclasses.dataclass(frozen=True)
class Scales:
    """Natural sizes of input, output and time in a set of data, and their units."""

    # u, y, s: sizes (half the range of input and output, median sampling interval times 100 or so for time)
    u: float = 1.0
    y: float = 1.0
    s: float = 1.0
    u_unit: str = ""  # u_unit, y_unit, s_unit: units as printed; "" where unknown
    y_unit: str = ""
    s_unit: str = "s"

    def size(self, unit: str) -> float:
        """Natural size of a parameter of this unit."""
        sizes = {"u": self.u, "y": self.y, "s": self.s, "sample": 1.0}
        return math.prod((sizes.get(symbol, 1.0) ** power for symbol, power in exponents(unit).items()), start=1.0)

    def label(self, unit: str) -> str:
        """The unit as printed, for example "um/V"; "" for a number without unit, symbols kept where a unit is unknown."""
        labels = {"u": self.u_unit or "[u]", "y": self.y_unit or "[y]", "s": self.s_unit or "s", "sample": "samples"}
        over, under = [], []
        for symbol, power in exponents(unit).items():
            text = labels.get(symbol, symbol.strip("[]"))
            if abs(power) != 1:
                text = f"{text}^{abs(power):g}"
            (over if power > 0 else under).append(text)
        if not over and not under:
            return ""
        return "*".join(over or ["1"]) + "".join(f"/({text})" if "/" in text else f"/{text}" for text in under)


def axis_label(name: str, unit: str) -> str:
    """Name and unit of an axis; a unit at the end of the name is removed, and unknown units keep their own brackets."""
    if not unit or "[" in unit:
        return with_unit(name, unit)
    return with_unit(without_unit(name, unit), unit)


def without_unit(name: str, unit: str) -> str:
    """Name without a unit at its end, behind a space, an underscore or a slash, or in brackets."""
    return re.sub(rf"(?:\s*/\s*|[\s_]+|[\s_]*[\[(（［]){re.escape(unit)}[\])）］]?$", "", name) or name


def with_unit(name: str, unit: str) -> str:
    """Name and unit as a heading; unknown units, such as [y]/[u], keep their own brackets."""
    if not unit:
        return name
    return f"{name} {unit}" if "[" in unit else f"{name} [{unit}]"


@dataclasses.dataclass(frozen=True)
class Unit:
    """A unit of a measured column: its size in SI base units, and their powers, sorted by name."""

    factor: float
    powers: tuple[tuple[str, float], ...]

    @property
    def quantity(self) -> str:
        """The physical quantity, such as "voltage"; the base units where it has no name."""
        return _named().get(self.powers) or "*".join(f"{base}^{power:g}" for base, power in self.powers) or "a number"


# Size in the units behind it, and whether SI prefixes are put before it.
_SYMBOLS: dict[str, tuple[float, str, bool]] = {
    "m": (1.0, "", True), "g": (1e-3, "kg", True), "s": (1.0, "", True), "A": (1.0, "", True), "mol": (1.0, "", True),
    "K": (1.0, "", True), "degC": (1.0, "", False), "degF": (1.0, "", False), "rad": (1.0, "", True),
    "counts": (1.0, "", False), "strain": (1.0, "1", True), "%": (1e-2, "1", False),
    "N": (1.0, "kg*m/s^2", True), "Pa": (1.0, "N/m^2", True), "J": (1.0, "N*m", True), "W": (1.0, "J/s", True),
    "C": (1.0, "A*s", True), "V": (1.0, "W/A", True), "Ohm": (1.0, "V/A", True), "F": (1.0, "C/V", True),
    "H": (1.0, "V*s/A", True), "Wb": (1.0, "V*s", True), "T": (1.0, "V*s/m^2", True), "Hz": (1.0, "1/s", True),
    "G": (1e-4, "T", True), "Gs": (1e-4, "T", True), "Oe": (1e3 / (4 * math.pi), "A/m", True), "emu": (1e-3, "A*m^2", True),
    "erg": (1e-7, "J", False), "cc": (1e-6, "m^3", False), "bar": (1e5, "Pa", True), "hPa": (100.0, "Pa", False),
    "Torr": (133.322368421053, "Pa", True), "min": (60.0, "s", False), "h": (3600.0, "s", False),
    "day": (86400.0, "s", False), "year": (31557600.0, "s", False),
    "deg": (math.pi / 180, "rad", True), "rpm": (math.pi / 30, "rad/s", False), "in": (0.0254, "m", False),
    "ft": (0.3048, "m", False), "Angstrom": (1e-10, "m", False), "gf": (9.80665e-3, "N", True),
    "lbf": (4.4482216152605, "N", False), "kip": (4448.2216152605, "N", False), "psi": (6894.757293168, "Pa", False),
    "ksi": (6894757.293168, "Pa", False), "kpsi": (6894757.293168, "Pa", False), "mmHg": (101325 / 760, "Pa", False),
    "inHg": (3386.38815789, "Pa", False), "atm": (101325.0, "Pa", False), "dyn": (1e-5, "N", False),
    "oz": (0.278013850953781, "N", False), "klbf": (4448.2216152605, "N", False), "tonf": (9806.65, "N", False),
    "daN": (10.0, "N", False), "psf": (47.8802589803358, "Pa", False), "ksf": (47880.2589803358, "Pa", False),
    "mil": (2.54e-5, "m", False), "L": (1e-3, "m^3", True), "l": (1e-3, "m^3", False), "ppm": (1e-6, "1", False),
    "Ah": (3600.0, "A*s", True), "Nm": (1.0, "N*m", True), "Ncm": (1e-2, "N*m", True), "Nmm": (1e-3, "N*m", True),
    "Vs": (1.0, "V*s", True), "arcmin": (math.pi / 10800, "rad", False), "arcsec": (math.pi / 648000, "rad", False),
}  # fmt: skip
_SPELLINGS = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "hr": "h", "inch": "in", "°": "deg", "°C": "degC", "°F": "degF",
    "volt": "V", "volts": "V", "amp": "A", "amps": "A", "ampere": "A", "amperes": "A", "newton": "N", "newtons": "N",
    "meter": "m", "meters": "m", "kelvin": "K", "Kelvin": "K", "tesla": "T", "gauss": "G", "torr": "Torr", "ohm": "Ohm",
    "ohms": "Ohm", "Ohms": "Ohm", "lb": "lbf", "lbs": "lbf", "kips": "kip", "angstrom": "Angstrom",
    "count": "counts", "msec": "ms", "metre": "m", "metres": "m", "oersted": "Oe", "oersteds": "Oe", "pascal": "Pa", "pascals": "Pa",
    "joule": "J", "joules": "J", "watt": "W", "watts": "W", "hertz": "Hz", "coulomb": "C", "coulombs": "C", "gram": "g",
    "grams": "g", "gramme": "g", "henry": "H", "farad": "F", "weber": "Wb", "degree": "deg", "degrees": "deg", "radian": "rad",
    "radians": "rad", "inches": "in", "foot": "ft", "feet": "ft", "minute": "min", "minutes": "min", "hour": "h", "hours": "h",
    "days": "day", "years": "year", "yr": "year", "centigrade": "degC",
    "celsius": "degC", "degc": "degC", "fahrenheit": "degF", "degf": "degF", "kgf": "kgf", "pound": "lbf", "pounds": "lbf",
    "mils": "mil", "thou": "mil", "micron": "um", "microns": "um", "percent": "%", "hrs": "h", "mins": "min", "teslas": "T",
    "dyne": "dyn", "dynes": "dyn", "bars": "bar", "atmospheres": "atm",
    "ounce": "oz", "ounces": "oz", "usec": "us", "nsec": "ns", "KN": "kN", "KPa": "kPa", "Kpa": "kPa", "Mpa": "MPa",
    "millis": "ms", "micros": "us", "Vdc": "V", "VDC": "V", "Vrms": "V", "Vpp": "V", "ml": "cc", "mL": "cc", "pct": "%",
}  # fmt: skip
# Words before the name of a unit: "millitesla", "kiloamperes".
_WORDS = {"pico": "p", "nano": "n", "micro": "u", "milli": "m", "centi": "c", "kilo": "k", "mega": "M", "giga": "G"}
_CAPITALS = frozenset({"mm", "cm", "in", "ft"})  # written so by test frames
_PREFIXES = {"p": 1e-12, "n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3, "M": 1e6, "G": 1e9}
_QUANTITIES = {
    "time": "s", "frequency": "Hz", "voltage": "V", "electric field": "V/m", "field": "A/m", "current": "A",
    "current density": "A/m^2", "displacement": "m", "angle": "rad", "velocity": "m/s", "angular velocity": "rad/s",
    "acceleration": "m/s^2", "force": "N", "torque": "N*m", "stiffness": "N/m", "stress": "Pa", "power": "W", "mass": "kg",
    "moment": "A*m^2", "magnetization": "A*m^2/kg", "molar moment": "A*m^2/mol", "induction": "T", "flux": "Wb",
    "charge": "C", "polarization": "C/m^2", "resistance": "Ohm", "resistivity": "Ohm*m",
    "capacitance": "F", "inductance": "H", "temperature": "K",
    "temperature in degC": "degC", "temperature in degF": "degF", "counts": "counts", "amount": "mol", "molar loading": "mol/kg",
    "specific volume": "m^3/kg", "flow": "m^3/s", "specific power": "W/kg", "power density": "W/m^2", "curvature": "1/m",
    "volume": "m^3", "loss density": "W/m^3",
}  # fmt: skip
# What a column with such a unit is, where that is more or less than the dimension says.
_AS_COLUMN = {
    "angle": "displacement", "curvature": "displacement", "angular velocity": "velocity", "acceleration": "velocity", "torque": "force",
    "resistivity": "resistance",
    "molar moment": "magnetization", "amount": "loading", "molar loading": "loading", "specific volume": "loading",
    "specific power": "heat flow", "power density": "radiation",
    "temperature in degC": "temperature", "temperature in degF": "temperature",
}  # fmt: skip
_BY_SYMBOL = {
    r"emu/.*": "magnetization",
    r"m?Ah(/.*)?": "state of charge",
    r"m?bar|psi|[tT]orr|hPa|(cm|mm|in) ?H2O": "pressure",
    r"[mun]?(g|mol)/[lL]|[mun]?g/m\^?3|[uF]?N[FT]U": "concentration",
    r"(?:[mun]|micro|milli|nano)?[ _-]?strains?|([mun]?m)/m?m|in/in": "strain",
}
# Units that are one character of Chinese and Japanese text, such as ℃ and ㎜, in the letters of others.
ONE_CHARACTER = {code: unicodedata.normalize("NFKC", chr(code)) for code in (0x2103, 0x2109, *range(0x3380, 0x33DE))}
_MARKS = str.maketrans("\u00b5\u03bc\u00b7\u22c5\u00b2\u00b3\u00b9\u207b", "uu**231-") | {
    **dict.fromkeys(map(ord, "\u2126\u03a9"), "Ohm"),
    ord("\u03b5"): "strain",
}
_LONGEST = 100  # characters of a unit
_REFERENCE = re.compile(r"\s+vs\b.*")  # of a voltage, against which it is measured: V vs. Ag/AgCl
_HIGHEST = 12  # power of a symbol in any unit, beyond which a text is none
# Two units joined by a hyphen, as in kN-m and ft-lb; a digit after it is a power.
_HYPHEN = re.compile(r"(?<=[A-Za-z])-(?=[A-Za-z])")
_TERM = re.compile(r"(?P<mark>[/*.\s]*)(?P<symbol>1|[A-Za-z\u03a9%°]+)(?:(?:\^|\*\*)?(?P<power>-?\d+))?")


def _plain(text: str) -> str:
    """A unit in ASCII where it can be: "um" for "µm", and "A*m2" for "Am²"."""
    if len(text) > _LONGEST:
        return text
    plain = _REFERENCE.sub("", text.strip().rstrip("."))
    plain = re.sub(r"(?<=A)m(?=\^?2)", "*m", plain.translate(ONE_CHARACTER).translate(_MARKS))
    plain = re.sub(r"[ _(]+STP\b\)?", "", plain)  # of gas at standard temperature and pressure
    plain = re.sub(r"\b[dD]eg[ _.]*([CF])\b", r"deg\1", plain)
    plain = _HYPHEN.sub("*", re.sub(r"[ _]+[pP]er[ _]+", "/", plain))
    plain = re.sub(r"([A-Za-z]{3,})[ _]squared?\b", r"\1^2", plain)
    return re.sub(r"(?<=[A-Za-z0-9])_(?=[A-Za-z])", "*", plain) if "/" in plain or "_" in plain else plain


@functools.cache
def parse_unit(text: str) -> Unit | None:
    """The unit of a column, such as "um", "kA/m", "emu/g" or "lb" (here a force, as in load cells); None if it is not known."""
    return _product(_plain(text)) or _product(_plain(re.sub(r"(?<=[a-z])(?=[A-Z][a-z]{2})", "_", text)))  # NewtonMeter


def _product(plain: str) -> Unit | None:
    """The unit of a plain text; None if it is not known."""
    factor, powers, place = 1.0, dict[str, float](), 0
    while place < len(plain):
        term = _TERM.match(plain, place)
        if term is None or (part := _symbol(term["symbol"])) is None:
            return None
        mark = term["mark"].strip()
        if mark not in ("", "*", "/", ".") or (place == 0) != (term["mark"] == ""):
            return None
        power = (-1 if mark == "/" else 1) * int(term["power"] or 1)
        if abs(power) > _HIGHEST:
            return None
        factor *= part.factor**power
        for base, exponent in part.powers:
            powers[base] = powers.get(base, 0.0) + power * exponent
        place = term.end()
    return Unit(factor, tuple(sorted((b, p) for b, p in powers.items() if p))) if plain else None


def _symbol(symbol: str) -> Unit | None:
    """One symbol with or without a prefix."""
    symbol = symbol_of(symbol)
    if symbol in ("1", "kg"):
        return Unit(1.0, (("kg", 1.0),) if symbol == "kg" else ())
    size, base = 1.0, symbol
    if symbol not in _SYMBOLS:
        size, base = _PREFIXES.get(symbol[0], 0.0), symbol[1:]
        if not size or base not in _SYMBOLS or not _SYMBOLS[base][2] or (base == "s" and size > 1.0):
            return None  # Ms is a saturation
    factor, behind, _ = _SYMBOLS[base]
    if not behind:
        return Unit(size * factor, ((base, 1.0),))
    inner = parse_unit(behind)
    return None if inner is None else Unit(size * factor * inner.factor, inner.powers)


def symbol_of(symbol: str) -> str:
    """The symbol of a unit that is written as one word or in capital letters: V for Volts, mA for milliamps; other texts as they are."""
    if symbol in _SYMBOLS or symbol in _SPELLINGS:
        return _SPELLINGS.get(symbol, symbol)
    word = symbol.lower()
    if symbol.isupper() and word in _CAPITALS:
        return word
    if len(word) > 2 and (word in _SPELLINGS or word in _SYMBOLS):
        return _SPELLINGS.get(word, word)
    prefixes = [*_WORDS.items(), *((prefix, prefix) for prefix in _PREFIXES)]
    for prefix, mark in prefixes:  # kilogauss, kGauss
        rest = word[len(prefix) :] if (symbol if len(prefix) == 1 else word).startswith(prefix) else ""
        if len(rest) > 2 and (rest in _SPELLINGS or rest in _SYMBOLS):
            return mark + _SPELLINGS.get(rest, rest)
    return symbol


@functools.cache
def _named() -> dict[tuple[tuple[str, float], ...], str]:
    """Quantities by the dimension of their unit."""
    units = {name: parse_unit(unit) for name, unit in _QUANTITIES.items()}
    return {unit.powers: name for name, unit in units.items() if unit is not None}


@functools.cache
def quantity(unit: str) -> str:
    """Physical quantity of a column with this unit: "field" for "kA/m", "polarization" for "uC/cm2", ...; "" if unknown."""
    for pattern, name in _BY_SYMBOL.items():
        if re.fullmatch(pattern, _plain(unit)):
            return name
    known = parse_unit(unit)
    name = "" if known is None else _named().get(known.powers, "")
    return _AS_COLUMN.get(name, name)


def conversion(source: str, target: str) -> float | None:
    """Factor from values in one unit to values in another; None where the units differ and one of them is not known."""
    if source == target:
        return 1.0
    one, other = parse_unit(source), parse_unit(target)
    if one is None or other is None:
        return None
    if one.powers != other.powers:
        raise DataError(f"{source!r} is a unit of {one.quantity}, and {target!r} a unit of {other.quantity}")
    return float(f"{one.factor / other.factor:.15g}")


def size_in(unit: str, *targets: str) -> tuple[str, float] | None:
    """The first of these units that is of the same quantity, and the size of `unit` in it; None where there is none."""
    one = parse_unit(unit)
    others = ((text, parse_unit(text)) for text in targets)
    alike = ((text, one.factor / o.factor) for text, o in others if one and o and o.powers == one.powers)
    return next(alike, None)


OF_BRIDGES = ("mV/V", "µV/V", "μV/V")  # signals of strain gauges, over the voltage that feeds their bridge: no strains
_ENERGIES = ("J", "J/m2", "J/m3", "J/kg", "J/m")
MU0 = 4e-7 * math.pi  # [T m/A]; a field times a moment is an energy after multiplication by it


def loop_energy(one: str, other: str) -> tuple[str, float]:
    """Unit of an area over two columns as an energy or energy density, and the factor to it; the product of both elsewhere.

    Empty where one column has no unit: that of the other alone is not the unit of the area.
    """
    one, other = (_REFERENCE.sub("", unit) for unit in (one, other))
    first, second = parse_unit(one), parse_unit(other)
    alike = symbol_of(one) == symbol_of(other) and one.isalpha()
    plain = "" if not (one and other) else f"{symbol_of(one)}^2" if alike else f"{symbol_of(other)} {symbol_of(one)}"
    if first is None or second is None or {one, other}.intersection(OF_BRIDGES):
        return plain, 1.0
    powers = dict(first.powers)
    for base, power in second.powers:
        powers[base] = powers.get(base, 0.0) + power
    turned = "rad" in powers  # a torque times an angle is an energy, and a force times an angle none per length
    vacuum = {"kg": 1.0, "m": 1.0, "s": -2.0, "A": -2.0}
    for extra, factor in (({}, 1.0), (vacuum, MU0)):
        total = {base: powers.get(base, 0.0) + extra.get(base, 0.0) for base in {*powers, *extra} - {"rad"}}
        key = tuple(sorted((base, power) for base, power in total.items() if power))
        for unit in _ENERGIES:
            known = parse_unit(unit)
            if known is not None and known.powers == key and not (turned and unit == "J/m"):
                return unit, factor * first.factor * second.factor
    return plain, 1.0


def is_energy(unit: str) -> bool:
    """Whether the unit of an area by `loop_energy` is that of an energy or energy density."""
    return unit in _ENERGIES


def stiffness_unit(force: str, path: str) -> tuple[str, float]:
    """Unit of a force over a path, and the factor to it: that of a stress over a strain is the stress's; empty where one is missing."""
    known = parse_unit(path)
    if known is not None and not known.powers and force:
        return force, 1.0 / known.factor
    return (f"{force}/({path})" if "/" in path else f"{force}/{path}") if force and path else "", 1.0


def integral_unit(unit: str) -> str:
    """Unit of the integral over seconds: "uC/cm2" for "uA/cm2", "J/g" for "W/g", else the unit times s; "" if unknown."""
    if match := re.match(r"([pnuµμmk]?)([AW])(?![A-Za-z])", unit):
        return match[1] + {"A": "C", "W": "J"}[match[2]] + unit[match.end() :]
    return unit and f"{unit}*s"
