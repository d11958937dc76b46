r"""Names that are written for LaTeX or Origin, as labels of axes are: "$\mu_0 H$ (T)" is "µ_0 H (T)", and "C/cm\+(2)" is "C/cm2"."""

from __future__ import annotations

import re

_MARKED = re.compile(r"\$[^$]*\$|\\(?:mathrm|mathit|mathbf|text|textrm|si|unit)\b")
_FONTS = re.compile(r"\\(?:mathrm|mathit|mathbf|text|textrm|textit|rm|it|bf|left|right|si|unit)\b\s*")
_LETTERS = {
    "mu": "µ", "Omega": "Ω", "lambda": "λ", "Delta": "Δ", "circ": "°", "degree": "°", "times": "×", "cdot": "·", "varepsilon": "epsilon",
    "micro": "µ", "ohm": "Ω", "per": "/", "kilo": "k", "milli": "m", "nano": "n", "mega": "M", "centi": "c", "ampere": "A", "metre": "m",
    "meter": "m", "tesla": "T", "newton": "N", "pascal": "Pa", "volt": "V", "second": "s", "coulomb": "C", "celsius": "°C", "kelvin": "K",
    "degreeCelsius": "°C", "percent": "%",
}  # fmt: skip
_COMMAND = re.compile(r"\\([A-Za-z]+)\s*")
# Of Origin: \g(m) is the Greek letter of m, \+(2) is raised, \-(c) lowered, and \b(), \i() and \u() are fonts.
_OF_ORIGIN = re.compile(r"(?:(?<![\w:])\\[biu]|\\(?P<way>[g+-]))\((?P<text>[^()]*)\)")
_GREEK = str.maketrans("abgdehqklmnpqrstfcywDFWS", "αβγδεηθκλµνπθρστφχψωΔΦΩΣ")
_SPACES = re.compile(r"(?:\\[,;:! ]|~)+")


def without_latex(line: str) -> str:
    r"""A line of a header without its commands: "$\mathrm{A\,m^{-1}}$" is "A m^-1"; a line without any as it is."""
    line = _OF_ORIGIN.sub(_plain, line)
    if _MARKED.search(line) is None:
        return line
    plain = _SPACES.sub(" ", _FONTS.sub("", line))
    plain = _COMMAND.sub(lambda match: _LETTERS.get(match[1], match[1]), plain)
    plain = re.sub(r"[{}$]", "", re.sub(r"\\([%_#&])", r"\1", plain)).replace("^°", "°")
    return re.sub(r"([(\[]) +| +([)\]])", r"\1\2", plain)


def _plain(match: re.Match[str]) -> str:
    """A part of a name between brackets, to which Origin gives another font or height."""
    way, text = match["way"], match["text"]
    if way == "g":
        return text.translate(_GREEK)
    return f"_{text}" if way == "-" and not text.isdigit() else text
