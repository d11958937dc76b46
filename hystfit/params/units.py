"""Units of parameters as expressions in the units of the data: "y/u" is um/V on a piezo record; quantities of data units.

One expression gives both the printed unit and the natural size of a parameter: with u in V over 100 V and y in um
over 10 um, "y/u" prints as "um/V" and scales as 0.1. Symbols: u input, y output, s time; "1" has no unit.
"""

from __future__ import annotations

import dataclasses
import math
import re

from hystfit.errors import ParameterError

_FACTOR = re.compile(r"^(?P<symbol>1|u|y|s|sample)(?:\^(?P<power>-?\d+(?:\.\d+)?))?$")

# Physical quantities by the units of their data, as `_plain` writes them. Where a unit serves two quantities, the first is taken.
_QUANTITIES = {
    "time": r"[munp]?s|secs?|seconds?|min|hr?",
    "frequency": r"[kMG]?Hz|rpm",
    "voltage": r"[mukM]?V|volts?",
    "electric field": r"[kM]?V/(?:[cmu]?m)",
    "field": r"[mk]?Oe|[mkM]?A/c?m",
    "current": r"[pnumk]?A|amps?|amperes?",
    "pressure": r"m?bar|psi|[Tt]orr|hPa",
    "displacement": r"[pnumc]?m|[Aa]ngstrom|in|inch|ft|m?rad|deg|°",
    "velocity": r"(?:[numc]?m|in|inch|ft|m?rad|deg|°)/s2?",
    "force": r"[mukM]?N|kips?|lbs?|lbf|k?gf|[mk]?Nc?m?m",
    "stress": r"[kMG]?Pa|ksi|k?N/m?m2",
    "moment": r"[mu]?emu|[mu]?Am2|[mu]?A\*m2|[mu]?J/T|erg/G",
    "magnetization": r"[mu]?emu/(?:g|cm3|cc|mol)|[mk]?Am2/k?g|A\*m2/kg",
    "induction": r"[mu]?T|[mk]?G|gauss|tesla|Wb/m2",
    "charge": r"[pnum]?C",
    "polarization": r"[num]?C/c?m2",
    "strain": r"[mu]?strain|mm/mm|um/m|m/m",
    "temperature": r"°C|degC|K|[kK]elvin|°F",
}


def quantity(unit: str) -> str:
    """Physical quantity of a unit of data such as "kA/m" or "µC/cm^2": "field", "polarization", ...; "" if unknown."""
    plain = _plain(unit)
    return next((name for name, pattern in _QUANTITIES.items() if re.fullmatch(pattern, plain)), "")


def _plain(unit: str) -> str:
    """A unit with u for micro, one slash, powers without marks, and no blanks: "A m^-1" and "A·m⁻¹" are "A/m"."""
    plain = unit.strip().translate(str.maketrans("µμ²³⋅·⁻¹", "uu23**-1")).replace("^", "").replace("**", "*")
    plain = re.sub(r"\s*([*/])\s*", r"\1", plain)
    plain = re.sub(r"[* ]([A-Za-z]+)-(\d)", lambda m: f"/{m[1]}{'' if m[2] == '1' else m[2]}", plain)
    return plain.replace(" ", "*")


def exponents(unit: str) -> dict[str, float]:
    """Powers of the symbols in a unit expression such as "y/u^2" or "u*s/y".

    Raises:
        ParameterError: the expression is not of that form.
    """
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
    """Natural sizes of input, output and time in a set of data, and their units.

    Attributes:
        u, y, s: sizes (half the range of input and output, median sampling interval times 100 or so for time).
        u_unit, y_unit, s_unit: units as printed; "" where unknown.
    """

    u: float = 1.0
    y: float = 1.0
    s: float = 1.0
    u_unit: str = ""
    y_unit: str = ""
    s_unit: str = "s"

    def size(self, unit: str) -> float:
        """Natural size of a parameter of this unit."""
        sizes = {"u": self.u, "y": self.y, "s": self.s, "sample": 1.0}
        return math.prod((sizes[symbol] ** power for symbol, power in exponents(unit).items()), start=1.0)

    def label(self, unit: str) -> str:
        """The unit as printed, for example "um/V"; "" for a number without unit, symbols kept where a unit is unknown."""
        labels = {"u": self.u_unit or "[u]", "y": self.y_unit or "[y]", "s": self.s_unit or "s", "sample": "samples"}
        over, under = [], []
        for symbol, power in exponents(unit).items():
            text = labels[symbol]
            if abs(power) != 1:
                text = f"{text}^{abs(power):g}"
            (over if power > 0 else under).append(text)
        if not over and not under:
            return ""
        return "*".join(over or ["1"]) + "".join(f"/{text}" for text in under)


def axis_label(name: str, unit: str) -> str:
    """Name and unit of an axis; a unit at the end of the name is removed, and unknown units keep their own brackets."""
    if not unit:
        return name
    if unit.startswith("["):
        return f"{name} {unit}"
    base = re.sub(rf"[\s_]*[\[(]?{re.escape(unit)}[\])]?$", "", name) or name
    return f"{base} [{unit}]"
