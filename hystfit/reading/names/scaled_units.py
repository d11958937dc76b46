"""Units with a factor before them, as in "M (10^-3 emu)", "Field (×10⁴ A/m)" and "Force (500 × mN)"."""

from __future__ import annotations

import re

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺−", "0123456789-+-")
_FACTOR = re.compile(
    r"(?:[x×*·]\s*)?(?:10\s*(?:(?:\^|\*\*)\s*\{?(?P<power>[+−-]?\d{1,2})\}?|(?P<raised>[⁻⁺]?[⁰¹²³⁴-⁹]{1,2})|(?P<flat>[+−-]\d))"
    r"|1[eE](?P<exponent>[+-]?\d{1,2}))\s*[x×*·]?\s*(?=[^\d\s]|$)"
)
_NUMBER = r"\d{1,9}(?:\.\d{1,9})?(?:[eE][+-]?\d{1,2})?"
_TIMES = re.compile(rf"(?:(?P<number>{_NUMBER})\s*[x×*·]|[x×*·]\s*(?P<after>{_NUMBER}))\s*(?=[^\W\d])")


def factor_of(unit: str) -> tuple[float, str]:
    """The factor before a unit, and the unit without it; 1 where there is none. "10-3" has lost its superscript."""
    if match := _FACTOR.match(unit):
        power = next(filter(None, match.groups())).translate(_SUPERSCRIPTS)
        return float(f"1e{power}"), unit[match.end() :].strip()
    if match := _TIMES.match(unit):
        return float(match["number"] or match["after"]), unit[match.end() :].strip()
    return 1.0, unit
