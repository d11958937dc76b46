"""Column names and units: from header rows, unit rows and names that carry their unit."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hystfit.params.units import quantity
from hystfit.reading import cells

_BASE = (
    r"(?:[pnuµμmckMG]?(?:s|V|A|m|N|Pa|T|G|Oe|C|Hz|W|J|g|Wb|rad|[oO]hms?|Ω|Ω|K|bar|emu|Am2|Am|Nm|Ncm|Nmm|[sS]ec|psi|gf|lbf))|[uµμm]strain"
    r"|in|inch|ft|lb|lbs|kips?|kgf|ksi|min|h|hr|deg|degC|°C|°|%|rpm|counts|volts?|newtons?|meters?|seconds?|erg|cc|cm3|dB"
)
_POWER = r"(?:\^?[-⁻]?[\d¹²³])?"
_UNIT = re.compile(rf"(?:{_BASE}){_POWER}(?:\s*[/*·.⋅ ]\s*(?:{_BASE}){_POWER})*")
# Quotients whose slash is an underscore in a name: numerator_denominator.
_JOINED = re.compile(
    r"(.+)_(?:([kM]?V)_([cmuµ]?m)|([mkM]?A)_(c?m2?)|([pnuµm]?C)_(c?m2|g|kg)|([mu]?emu)_(g|cm3|cc|mol|cm2)|(Am2)_(k?g)"
    r"|([mkM]?N)_([cm]?m2?)|([nuµmc]?m|m?rad|deg)_(s2?)|(pm)_(V)|(k?J|J|erg)_(c?m3|k?g|cc)|(k?g)_(c?m3)"
    r"|([kM]?Pa|k?Oe|m?T|K|degC)_(s|min))"
)
_WIDE = str.maketrans("（）［］【】／", "()[][]/")  # of Chinese and Japanese text
_LENGTHS = frozenset({"x", "y", "z", "d", "pos", "position", "disp", "displacement", "length"})
_BARE_TIMES = frozenset({"ms", "us", "µs", "μs", "ns"})  # names of columns that are no more than the unit of time
_NOT_SUFFIX = frozenset({"min", "h", "counts"})  # x_min is a minimum, not minutes
_NEVER_INCH = frozenset({"v", "u", "i", "p", "t", "q", "volt", "voltage", "signal", "sig", "cmd", "file", "data"})
_SAMPLE = re.compile(
    r"(?!.*(?:rate|interval|freq|period|number|record|block|buffer|window|file))"
    r".*(?:mass|weight|volume|size|length|width|height|thickness|area|diameter|radius|gauge|density|mole|shape|material|sample"
    r"|specimen|demagnet|质量|厚度|面积|試料|样品|尺寸)",
    re.IGNORECASE,
)
_NO_VALUE = frozenset({"", "n/a", "na", "none", "no", "-", "--", "unknown"})
_SETTINGS = (
    re.compile(r"(?:INFO)\s*,\s*(?P<value>.*),\s*(?P<key>[A-Za-z][A-Za-z0-9_ ]*)"),  # Quantum Design
    re.compile(r"(?P<key>[^:=,;\t]{2,40}?)\s*(?:[:=,;\t]|\s{3,})\s*(?P<value>.{1,100}?)[,;\s]*"),
)
_MOST_METADATA = 40
_LONGEST_NAME = 200  # characters
_LONGEST_SETTING = 1000  # characters of a line

_COMMENT = r"(?:[#%!*]+|//|--)"
_CLOCKS = frozenset({"t", "time", "times", "zeit", "temps", "tiempo"})
_LEADING = re.compile(r"^(?:[#%!*;']+|//|--|REM\b)\s*(?=\S)")  # before the first name of a header in a comment


def is_unit(text: str) -> bool:
    """Whether a text is a unit as laboratories write them."""
    return bool(_UNIT.fullmatch(text))


def split_unit(name: str, siblings: Sequence[str] = ()) -> tuple[str, str]:
    """Name and unit of a column header such as "t_s", "H_A_per_m", "P_uC_cm2", "v_m/s", "Force [kN]", "Force (kN)", "Force / kN"."""
    name = name.strip().translate(_WIDE)
    if len(name) > _LONGEST_NAME:
        return name, ""
    if name in _BARE_TIMES:
        return name, name
    if name.endswith(("]", ")", ">")) and (start := max(name.rfind(mark) for mark in "[(<")) > 0:
        base, unit = name[:start].rstrip(" \t_"), name[start + 1 : -1].strip()
        closed = not re.search(r"[\])>]", unit)
        if base and closed and (is_unit(unit) or (re.search(r"[A-Za-z%°]", unit) and len(unit) <= 12)):
            return base, unit
        if base and closed and unit in ("-", "1", "") and not re.search(r"\w\[1\]$", name):  # x[1]: column of a matrix
            return base, ""
    if match := re.fullmatch(r"(.+?)_([A-Za-zµμ]+)_per_([A-Za-z]+\d?)", name):
        return match[1], f"{match[2]}/{match[3]}"
    if match := _JOINED.fullmatch(name):
        over, under = filter(None, match.groups()[1:])
        if not (match[1].lower() in _LENGTHS and over in ("A", "V", "C")):  # x_A_m is the position of A
            return match[1], f"{over}/{under}"
    # H_kA/m is H in kA/m; of a quotient that is no quantity, the first part belongs to the name: U_A/V is U_A in V.
    if (match := re.fullmatch(r"([^/]+)_([^_/]+/[^_/]+)", name)) and is_unit(match[2]) and quantity(match[2]):
        return match[1], match[2]
    if (match := re.fullmatch(r"(.+?)(?:\s*/\s*|\s*,\s*|\s+in\s+)([^\s/,]+(?:/[^\s/,]+)?)", name)) and is_unit(
        match[2]
    ):
        return match[1].strip(), match[2]
    if (match := re.fullmatch(r"(.+)_([^_]+)", name)) and is_unit(match[2]) and match[2] not in _NOT_SUFFIX:
        base, unit = match[1], match[2]
        if unit == "in" and (base.lower() in _NEVER_INCH or f"{base}_out" in siblings):
            return name, ""  # v_in is an input voltage
        return base, unit
    return name, ""


def setting_of(line: str) -> tuple[str, str] | None:
    """Name and value in a line of a header; None where it has none."""
    if len(line) > _LONGEST_SETTING:
        return None
    text = re.sub(rf"^\s*{_COMMENT}\s*", "", line).strip()
    match = next((m for pattern in _SETTINGS if (m := pattern.fullmatch(text))), None)
    return None if match is None else (match["key"].strip(), match["value"])


def sample_properties(lines: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Size, mass and other properties of the sample, by their name in the header, as text."""
    known: dict[str, str] = {}
    for line in lines:
        key, text = setting_of(line) or ("", "")
        if not _SAMPLE.match(key) or "sampl" in text.lower():
            continue
        value = cells.clean(text)
        column = {key, value}.intersection(names)
        if not column and value.lower() not in _NO_VALUE and len(known) < _MOST_METADATA:
            known.setdefault(key, value)
    return known


def _fields(line: str, width: int, delimiter: str | None) -> list[str] | None:
    """Split a header line into `width` cells, by the delimiter of the data or by another one; None if none does."""
    for text in (line, re.sub(rf"^\s*{_COMMENT}\s*", "", line)):
        for mark in (delimiter, ",", ";", "\t", "|", "  ", None):
            parts = _cut(text, mark)
            while len(parts) > width and not parts[-1]:
                parts.pop()
            if len(parts) == width and any(parts):
                units = parts[0] == "%" and all(is_unit(part) or part in ("", "-", "1") for part in parts)
                if units or not re.fullmatch(_COMMENT, parts[0]):
                    return parts
    return None


def _cut(text: str, mark: str | None) -> list[str]:
    if mark is None:  # a bracketed unit belongs to the word before it
        text = re.sub(r"(?<!\s)\s++(?=[\[(])", "", text.strip())
        parts = re.findall(r"\"[^\"]*\"|[^\s\[(]*+[\[(][^\])]{0,40}[\])]\S*|\S+", text)
    elif mark == "  ":
        parts = re.split(r"\s{2,}|\t", text.strip())
    else:
        parts = text.split(mark)
    return [cells.clean(part) for part in parts]


def _named(parts: list[str]) -> list[str]:
    """Names without the comment mark before the first, and without the commas that follow each where blanks separate them."""
    parts = [cells.clean(part) for part in parts]
    if parts and parts[0] not in ("%", "*"):
        parts[0] = _LEADING.sub("", parts[0], count=1).strip()
    for mark in (",", ";"):
        if len(parts) > 1 and all(part.endswith(mark) for part in parts[:-1]):
            parts = [part.removesuffix(mark) for part in parts]
    return parts


def _is_header(parts: list[str], decimal: str) -> bool:
    kinds = [cells.kind(part, decimal) for part in parts if not re.fullmatch(r"[\[(<][-1][\])>]", part)]
    if cells.NUMBER in kinds or cells.STAMP in kinds or cells.TEXT not in kinds:
        return False
    return not any("=" in part or part.endswith(":") for part in parts)  # those are settings


def _numbered(line: str, width: int, delimiter: str | None, decimal: str) -> list[str]:
    """Names of a time and of columns with a number each ("t,10,20"); none for other lines."""
    parts = _named(_fields(line, width, delimiter) or [])
    if not parts or split_unit(parts[0])[0].strip().lower() not in _CLOCKS or len(set(parts)) < width:
        return []
    kinds = {cells.kind(part, decimal) for part in parts[1:]}
    return parts if kinds <= {cells.NUMBER, cells.TEXT} and not any("=" in part for part in parts) else []


def read_header(
    above: Sequence[str], width: int, delimiter: str | None, decimal: str, split: dict[int, list[str]]
) -> tuple[list[str], list[str], int]:
    """Names and units from the lines above the numbers, and how many of those lines they took.

    Args:
        delimiter, decimal: those of the data; None is any white space.
        split: cells of lines that are split already (quoted cells), by position in `above`.
    """
    headers: list[tuple[int, list[str]]] = []
    for position in range(len(above) - 1, max(-1, len(above) - 7), -1):
        if not above[position].strip(" \t,;"):
            if headers:
                break
            continue
        parts = split.get(position)
        if parts is None or len(parts) != width or re.match(_COMMENT, parts[0]):
            if any(not line.strip() for line in above[position + 1 :]):
                break
            parts = _fields(above[position], width, delimiter)
        if parts is None or not _is_header(parts := _named(parts), decimal):
            break
        headers.append((position, parts))
    if not headers:
        names = _numbered(above[-1] if above else "", width, delimiter, decimal)
        return names or [""] * width, [split_unit(name)[1] for name in names or [""] * width], int(bool(names))
    bare = [
        [part.strip("[]()<>") if re.fullmatch(r"[\[(<].*[\])>]", part) else part for part in parts]
        for _, parts in headers
    ]
    unit_row = [
        all(is_unit(cell) or cell in ("", "-", "1") or cell != part for cell, part in zip(row, parts, strict=True))
        for row, (_, parts) in zip(bare, headers, strict=True)
    ]
    used = 1
    names, units = headers[0][1], [""] * width
    if unit_row[0]:
        units = ["" if cell in ("-", "1") else cell for cell in bare[0]]
        if len(headers) > 1:
            names, used = headers[1][1], 2
    named = list(filter(None, names))
    if len(set(named)) < len(named) and len(headers) > used:  # Force, Force under A, B
        upper = headers[used][1]
        if len(set(upper)) == width:
            names, used = [f"{one} {two}".strip() for one, two in zip(upper, names, strict=True)], used + 1
    elif len(headers) > used and unit_row[used] and not unit_row[0]:  # units above the names
        units, used = bare[used], used + 1
    of_names = [split_unit(name, names)[1] for name in names]
    units = [unit or of_name for unit, of_name in zip(units, of_names, strict=True)]
    return names, units, used
