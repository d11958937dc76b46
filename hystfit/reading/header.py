"""Column names and units: from header rows, unit rows and names that carry their unit."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hystfit.reading import cells

_BASE = (
    r"(?:[pnuµμmckMG]?(?:s|V|A|m|N|Pa|T|G|Oe|C|Hz|W|J|g|Wb|rad|[oO]hms?|Ω|Ω|K|bar|emu|Am2|Am|Nm|Ncm|Nmm|sec|psi|gf|lbf))|[uµμm]strain"
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
_NOT_SUFFIX = frozenset({"min", "h", "counts"})  # x_min is a minimum, not minutes
_NEVER_INCH = frozenset({"v", "u", "i", "p", "t", "q", "volt", "voltage", "signal", "sig", "cmd", "file", "data"})


_COMMENT = r"(?:[#%!*]+|//|--)"


def is_unit(text: str) -> bool:
    """Whether a text is a unit as laboratories write them."""
    return bool(_UNIT.fullmatch(text))


def split_unit(name: str, siblings: Sequence[str] = ()) -> tuple[str, str]:
    """Name and unit of a column header such as "t_s", "H_A_per_m", "P_uC_cm2", "Force [kN]", "Force (kN)", "Force / kN"."""
    name = name.strip().translate(_WIDE)
    if match := re.fullmatch(r"(.*?)[\s_]*[\[(<]\s*([^\[\]()<>]*?)\s*[\])>]", name):
        unit = match[2]
        if match[1] and (is_unit(unit) or (re.search(r"[A-Za-z%°]", unit) and len(unit) <= 12)):
            return match[1], unit
        if match[1] and unit in ("-", "1", "") and not re.search(r"\w\[1\]$", name):  # x[1] is a column of a matrix
            return match[1], ""
    if match := re.fullmatch(r"(.+?)_([A-Za-zµμ]+)_per_([A-Za-z]+\d?)", name):
        return match[1], f"{match[2]}/{match[3]}"
    if match := _JOINED.fullmatch(name):
        over, under = filter(None, match.groups()[1:])
        if not (match[1].lower() in _LENGTHS and over in ("A", "V", "C")):  # x_A_m is the position of A
            return match[1], f"{over}/{under}"
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


def _fields(line: str, width: int, delimiter: str | None) -> list[str] | None:
    """Split a header line into `width` cells, by the delimiter of the data or by another one; None if none does."""
    for text in (line, re.sub(rf"^\s*{_COMMENT}\s*", "", line)):
        for mark in (delimiter, ",", ";", "\t", "|", "  ", None):
            parts = _cut(text, mark)
            while len(parts) > width and not parts[-1]:
                parts.pop()
            if len(parts) == width and any(parts) and not re.fullmatch(_COMMENT, parts[0]):
                return parts
    return None


def _cut(text: str, mark: str | None) -> list[str]:
    if mark is None:  # a bracketed unit belongs to the word before it
        text = re.sub(r"\s+(?=[\[(])", "", text.strip())
        parts = re.findall(r"\"[^\"]*\"|[^\s\[(]*[\[(][^\])]*[\])]\S*|\S+", text)
    elif mark == "  ":
        parts = re.split(r"\s{2,}|\t", text.strip())
    else:
        parts = text.split(mark)
    return [cells.clean(part) for part in parts]


def _is_header(parts: list[str], decimal: str) -> bool:
    kinds = [cells.kind(part, decimal) for part in parts]
    if cells.NUMBER in kinds or cells.STAMP in kinds or cells.TEXT not in kinds:
        return False
    return not any("=" in part or part.endswith(":") for part in parts)  # those are settings


def read_header(
    above: Sequence[str], width: int, delimiter: str | None, decimal: str, split: dict[int, list[str]]
) -> tuple[list[str], list[str], int]:
    """Names and units from the lines above the numbers, and how many of those lines they took.

    Args:
        above: lines above the first row of numbers, the nearest last.
        width: number of columns.
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
        if parts is None or not _is_header(parts := [cells.clean(part) for part in parts], decimal):
            break
        headers.append((position, parts))
    if not headers:
        return [""] * width, [""] * width, 0
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
