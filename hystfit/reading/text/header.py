"""Column names and units in the rows of a header, and settings and properties of the sample above them."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence

from hystfit.reading.limits import FEW, LONGEST
from hystfit.reading.names.column_names import RELATIVE_PRESSURE, column_quantity
from hystfit.reading.names.names_with_units import is_unit, split_unit
from hystfit.reading.names.unit_case import in_case, is_symbol
from hystfit.reading.text import cells
from hystfit.reading.text.dialect import split as cells_of

_SAMPLE = re.compile(  # "Temperature in" has a unit
    r"(?!.*(?:rate|interval|freq|period|number|samples|step|setting|multiplier|offset|record|block|buffer|bin_?size|window|file|array"
    r"|control|bandwidth|\bmax|\bin$))"
    r".*(?:mass|weight|volume|size|length|width|height|thickness|area|diameter|radius|gauge|density|mole|shape|material|sample"
    r"|specimen|demagnet|temperature|preload|humidity|质量|厚度|面积|試料|样品|尺寸)",
    re.IGNORECASE,
)
_NO_VALUE = frozenset({"", "n/a", "na", "none", "no", "yes", "-", "--", "unknown", "not specified"})
_SETTINGS = (
    re.compile(r"(?:INFO)\s*,\s*(?P<value>.*),\s*(?P<key>[A-Za-z][A-Za-z0-9_ ]*)"),  # Quantum Design
    re.compile(r"\"(?P<key>[^\"]{2,40})\"\s*[,;\t]\s*(?P<value>\S.{0,99}?)[,;\s]*"),
    re.compile(
        r"(?P<key>[^:=,;\t]{2,40}?)\s*(?:[:=]?\s*[,;\t]++|[:=](?!\s*[,;\t])|\s{3,})\s*(?P<value>.{1,100}?)[,;\s]*"
    ),
)
MOST_METADATA = 40
_NEXT = re.compile(r"(?:^|\s{3,})\w+\.?(?: \w+\.?){0,3}:(?:\s|$)")  # a further setting in the same line
_LABEL = re.compile(r"^\s*<\w+>:\s*")  # <data>: before the names of columns

# "TraceName", "CH1", "CH2": names behind a cell that says so, and "単位(sec)", "kN", "mm": units behind one.
NAME_CELL = re.compile(
    r"(?:(?:trace|channel|signal|ch|column)[ _]?)?(?:names?|labels?|titles?)[=:]?|CH名称|信号名|通道名称?|Kanalname",
    re.IGNORECASE,
)
UNIT_CELL = re.compile(r"(?:units?|einheit(?:en)?|unités?|単位|单位)\s*(?:[(\[](?P<unit>[^)\]]*)[)\]])?", re.IGNORECASE)
_VALUE = re.compile(r"\S+\s*=\s*[^\s,;]+")  # of a setting in the name of a column
_COMMENT = r"(?:[#%!*]+|//|--)"
_IN = " in "  # between a name of one word and its unit, where blanks part the columns too
_BEGUN = re.compile(r"\d{1,3}:\d\d")  # the only cell of a row: the time at which a report begins
_COUNTED = re.compile(rf"{_COMMENT}\s*\d+")  # how many rows follow
_FORMAT = re.compile(r"\d{1,3}[sdn]")  # of a column of an RDB table: 14 characters of a number, 20 of a date
_CLOCKS = frozenset({"t", "time", "times", "zeit", "temps", "tiempo"})
_LEADING = re.compile(r"^(?:[#%!*;']+|//|--|REM\b)\s*(?=\S)")  # before the first name of a header in a comment


def setting_of(line: str) -> tuple[str, str] | None:
    """Name and value in a line of a header; None where it has none."""
    if len(line) > LONGEST:
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
        value = re.sub(r"\s*,\s*(?=[\[\"])", " ", cells.clean(text)).replace('"', "")  # 0.0813,[g]
        value = _NEXT.split(value, maxsplit=1)[0].strip()
        column = {key, value}.intersection(names)
        if not column and value.lower() not in _NO_VALUE and len(known) < MOST_METADATA:
            known.setdefault(key, value)
    return known


def _fields(line: str, width: int, delimiter: str | None) -> list[str] | None:
    """Split a header line into `width` cells, by the delimiter of the data or by another one; None if none does."""
    for text in (line, re.sub(rf"^\s*{_COMMENT}\s*", "", line), _LABEL.sub("", line)):
        for mark in (delimiter, "  ", ",", ";", "\t", "|", None, _IN):
            parts = cut_cells(text, mark)
            while len(parts) > width and not parts[-1]:
                parts.pop()
            if len(parts) == width and any(parts):
                units = parts[0] in ("%", "#") and _are_units(_bare(parts), parts)
                if units or mark in (",", ";", "\t") or not re.fullmatch(_COMMENT, parts[0]):
                    return parts
    return None


def cut_cells(text: str, mark: str | None) -> list[str]:
    """Clean cells of a line of a header, between marks.

    "  " is two blanks or a tab, None any white space before no bracket, and " in " that after each unit of "B in mT I in A".
    """
    if mark is None:  # a bracketed unit belongs to the word before it
        text = re.sub(r"(?<!\s)\s++(?=[\[(])", "", text.strip())
        parts = re.findall(r"(?:\"[^\"]*\"[^\s\"]*)+|\{[^}]*\}|[^\s\[(]*+[\[(][^\])]{0,40}[\])]\S*|\S+", text)
        parts = [part[1:-1] if part.startswith("{") and part.endswith("}") else part for part in parts]
    elif mark == _IN:
        words = text.split()
        whole = len(words) % 3 == 0 and {*words[1::3]} == {"in"} and all(map(is_unit, words[2::3]))
        parts = [" ".join(words[k : k + 3]) for k in range(0, len(words), 3)] if whole else [text]
    elif mark == "  ":
        parts = re.split(r"\s{2,}|\t", text.strip())
    else:
        parts = cells_of(text, mark)
    return [cells.clean(part) for part in parts]


def _longer(line: str, width: int, delimiter: str | None, below: Sequence[str]) -> list[str] | None:
    """The first `width` names of a line that names further columns, which have no numbers in any row, or their units; None for other lines.

    Args:
        below: cells of the line below, of units.
    """
    parts = cut_cells(line, delimiter) if delimiter else []
    if len(parts) <= width or not all(parts):
        return None
    units = sum(map(is_unit, parts))  # Force, kN
    told = _are_units(parts, parts) and units > 1 if not below else len(below) == len(parts)
    return parts[:width] if told or (width > 2 and len({*parts}) == len(parts) and not units) else None


def _named(parts: list[str]) -> list[str]:
    """Names without the comment mark before the first, and without the commas that follow each where blanks separate them."""
    parts = [cells.clean(part) for part in parts]
    if parts and parts[0] not in ("%", "*", "#"):
        parts[0] = cells.clean(_LEADING.sub("", parts[0], count=1))
    for mark in (",", ";"):
        if len(parts) > 1 and all(part.endswith(mark) for part in parts[:-1]):
            parts = [part.removesuffix(mark) for part in parts]
    return parts


def _is_remark(parts: Sequence[str], over: Sequence[str]) -> bool:
    """Whether a row has a text alone, with the names of columns over it: "Starting M vs H", and not the name of the first of them."""
    filled = [sum(map(bool, row)) for row in (parts, over)]
    return (
        not _are_units(_bare(parts), parts)
        and filled[0] == 1
        and 2 * filled[1] > len(parts) > 2
        and not _mostly_units(_bare(over))
    )


def _is_header(parts: list[str], decimal: str) -> bool:
    kinds = [cells.kind(part, decimal) for part in parts if not re.fullmatch(r"[\[(<][-1][\])>]", part)]
    if cells.NUMBER in kinds or cells.STAMP in kinds or cells.TEXT not in kinds:
        return False
    settings = [part for part in parts if _is_setting(part)]
    keys = {part.partition("=")[0] for part in settings}
    levels = (
        len({*settings}) == len(settings) > len(keys) == 1 and "=" in settings[0]
    )  # a column for each: V, Vg=0 V, Vg=1 V
    return not settings or (levels and len(settings) < len(parts))


def _has_numbered_channels(parts: Sequence[str], decimal: str, below: Sequence[str]) -> bool:
    """Whether a row names most of its columns and a few by the number of a sensor: "Weg", "Kraft", "1281068" over mm, kN, mm.

    Args:
        below: cells of the only row of the header below it.
    """
    words = sum(cells.kind(part, decimal) == cells.TEXT for part in parts)
    return 2 * words > len(parts) and all(parts) and "=" not in "".join(parts) and _mostly_units(_bare(below))


def _is_setting(cell: str) -> bool:
    """Whether a cell is no name of a column but a setting, or the word before one: "T=300 K", "Time:"; not "N=10 strain (%)"."""
    rest = _VALUE.sub("", cell).strip()
    return cell.endswith(":") or ("=" in cell and (is_unit(rest) or not column_quantity(rest)))


def _names_and_units(rows: list[list[str]], bare: list[list[str]]) -> tuple[list[str], list[str] | None, int]:
    """Names, units (None where no line has them), and the number of lines that hold them.

    Args:
        rows: cells of the lines above the numbers, the nearest one first; bare: the same without brackets around a cell.
    """
    # H_A_per_m and J_T alone above the numbers are names with their units, though henry and joule are units too.
    named = len(rows) == 1 and all("_" in cell for cell in bare[0])
    place = None if named else next((k for k, row in enumerate(bare) if _are_units(row, rows[k])), None)
    if place is None and len(rows) > 1:  # a line of units beside words, such as "segments", has names above it
        place = next(
            (k for k, row in enumerate(bare[:-1]) if _mostly_units(row) and not _mostly_units(bare[k + 1])), None
        )
    units = None if place is None else [cell if is_unit(cell) else "" for cell in bare[place]]
    distinct = lambda row: len(set(filter(None, row))) == len(list(filter(None, row)))
    if place == 0:
        of_names, used = min(1, len(rows) - 1), min(2, len(rows))
    elif (
        place == 1
        and len(rows) > 2
        and ((first := bool(rows[0][0]) and not any(rows[0][1:])) or _meanings(rows[2]) > _meanings(rows[0]))
        and (distinct(rows[2]) or _grouped(rows[2]))
    ):
        # The row below the units has comments, the axis of a plot that each is for, or the name of the first column alone.
        rows[2] = [rows[0][0], *rows[2][1:]] if first else rows[2]
        of_names, used = 2, 3
    elif place is None or (place == 1 and distinct(rows[0])):  # units above the names
        of_names, used = 0, 1 if place is None else 2
    elif distinct(rows[0]) or place + 1 == len(rows):
        of_names, used, units = 0, 1, None
    else:  # a line below the units has how each was averaged
        of_names, used = place + 1, place + 2
    titled = (k for k in range(of_names, len(rows)) if NAME_CELL.fullmatch(rows[k][0]) and any(rows[k][1:]))
    of_names = next(titled, of_names)
    names = rows[of_names]
    if not distinct(names) and used < len(rows):  # Force, Force under A, B, and mean, std, mean, std under x, "", F, ""
        over = [*itertools.accumulate(rows[used], lambda before, cell: cell or before)]
        of_over, of_names = ({*map(column_quantity, row)} - {"", "error", "index"} for row in (over, names))
        quantities = len(of_over) > 1 and not of_names
        joined = [f"{one} {two}".strip() for one, two in zip(over, names, strict=True)]
        if distinct(joined) and (quantities or not _grouped(names)):
            names, used = joined, used + 1
    if units is not None and place is not None:
        units = [unit or in_case(name, cell) for unit, name, cell in zip(units, names, bare[place], strict=True)]
    return names, units, used


def _grouped(names: Sequence[str]) -> bool:
    """Whether some names come again and again, two or more of them each time: those of loops side by side."""
    size = next((k for k in range(2, len(names) // 2 + 1) if [*names[:k]] * (len(names) // k) == [*names]), 0)
    return size > 0 and len({*names[:size]}) == size


def _meanings(names: Sequence[str]) -> int:
    """How many of some names are those of a physical quantity."""
    return sum(column_quantity(name) != "" for name in names)


def _bare(parts: Sequence[str]) -> list[str]:
    """Cells without the brackets around each."""
    return [part.strip("[]()<> ") if re.fullmatch(r"[\[(<].*[\])>]", part) else part for part in parts]


def _are_units(bare: Sequence[str], parts: Sequence[str]) -> bool:
    """Whether every cell of a line, given without and with its brackets, is a unit or nothing."""
    nothing = ["", "-", "1", "#"]
    if any("/" in cell and is_unit(cell) for cell in bare):  # P/Po beside cc/g
        nothing += filter(RELATIVE_PRESSURE.fullmatch, bare)
    return all(is_unit(cell) or cell in nothing or cell != part for cell, part in zip(bare, parts, strict=True))


def _mostly_units(bare: Sequence[str]) -> bool:
    """Whether two cells of a line and half of those that are filled are units; "NO." and "Time" count on neither side."""
    if any(cell.endswith((")", "]")) and split_unit(cell)[1] and not is_unit(cell) for cell in bare):
        return False  # Load (N) beside mV/V is the name of a column
    count = sum(is_unit(cell) or is_symbol(cell) for cell in bare)
    others = [cell for cell in bare if cell and (is_unit(cell) or column_quantity(cell) not in ("index", "time"))]
    return count > 1 and 2 * count >= len(others)


def _numbered(line: str, width: int, delimiter: str | None, decimal: str) -> list[str]:
    """Names of a time and of columns with a number each ("t,10,20"); none for other lines."""
    parts = _named(_fields(line, width, delimiter) or [])
    if not parts or split_unit(parts[0])[0].strip().lower() not in _CLOCKS or len(set(parts)) < width:
        return []
    kinds = {cells.kind(part, decimal) for part in parts[1:]}
    return parts if kinds <= {cells.NUMBER, cells.TEXT} and not any("=" in part for part in parts) else []


def _aligned(above: Sequence[str], width: int) -> tuple[list[str], list[str], int] | None:
    """Names over columns of fixed width that go on below, with units below some; None where every line has all columns."""
    rows: list[list[re.Match[str]]] = []
    lines, top = [*above], []
    while lines and (len(top) < width or _are_units(_bare(top), top)) and len(rows) <= FEW:
        line = lines.pop()
        if line.strip(" -="):
            rows.insert(0, [*re.finditer(r"\S+(?: \S+)*", line)])
            top = [cell[0] for cell in rows[0]]
        elif rows and not _are_units(_bare(top), top):
            return None
    units = [cell[0] for cell in rows[-1]] if len(rows) > 1 else []
    bare = [a == b and not RELATIVE_PRESSURE.fullmatch(a) for a, b in zip(_bare(units), units, strict=True)]
    # Without brackets, below fewer columns.
    without = len(units) < width and all(is_unit(cell) or is_symbol(cell) for cell in units)
    more = len(units) < width and not any("=" in cell or cells.kind(cell, ".") == cells.NUMBER for cell in units)
    if not units or (any(bare) and not without and not more) or len(top) != width:
        return None
    names, told = [[name] for name in top], [""] * width
    for row in rows[1:]:
        under = [[k for k, top in enumerate(rows[0]) if _overlap(cell, top)] for cell in row]
        if any(len(places) != 1 for places in under) or len({places[0] for places in under}) < len(row):
            return None
        for cell, (place,) in zip(row, under, strict=True):
            if without and row is rows[-1]:
                told[place] = cell[0]
            else:
                names[place].append(cell[0])
    whole = [" ".join(words) for words in names]
    units = [in_case(name, unit) or unit or split_unit(name, whole)[1] for unit, name in zip(told, whole, strict=True)]
    return whole, units, len(above) - len(lines)


def _overlap(one: re.Match[str], other: re.Match[str]) -> bool:
    """Whether two cells of different lines stand over each other."""
    return one.start() < other.end() and other.start() < one.end()


def read_header(
    above: Sequence[str], width: int, delimiter: str | None, decimal: str, split: dict[int, list[str]]
) -> tuple[list[str], list[str], int]:
    """Names and units from the lines above the numbers, and how many of those lines they took.

    Args:
        delimiter, decimal: those of the data; None is any white space.
        split: cells of lines that are split already (quoted cells), by position in `above`.
    """
    if delimiter is None and (aligned := _aligned(above, width)) is not None:
        return aligned
    headers: list[tuple[int, list[str]]] = []
    longer: list[str] = []
    for position in range(len(above) - 1, max(-1, len(above) - 7), -1):
        if not above[position].strip(" \t,;"):
            if headers and not (above[position].strip("\r\n") and _are_units(_bare(headers[0][1]), headers[0][1])):
                break
            continue
        if not headers and _COUNTED.fullmatch(above[position].strip()):
            continue
        parts = split.get(position)
        if parts is None or len(parts) != width or re.match(_COMMENT, parts[0]):
            apart = any(not line.strip() for line in above[position + 1 :])
            parts = cut_cells(above[position], "  ") if apart else _fields(above[position], width, delimiter)
            if parts is None and len(above) - 1 - position == len(headers) < 2 and bool(longer) == bool(headers):
                parts = _longer(above[position], width, delimiter, longer)
                longer = cut_cells(above[position], delimiter) if parts else []
        if parts and len(parts) == width and _BEGUN.fullmatch("".join(parts)):  # a row that lacks its numbers
            continue
        if parts and not headers and _is_remark(parts, _fields(above[position - 1], width, delimiter) or []):
            continue
        if parts and headers and not headers[-1][1][0] and parts[0].endswith(":") and all(parts):
            parts[0] = ""  # "Interval data:" before the names, above a row of units
        # Channels of an oscilloscope
        if parts and headers and parts[0] == "x-axis" and all(part.isdigit() for part in parts[1:]):
            parts = ["x-axis", *(f"CH{number}" for number in parts[1:])]
        if parts is None or len(parts) != width:
            break
        channels = len(headers) == 1 and _has_numbered_channels(parts, decimal, headers[0][1])
        if not _is_header(parts := _named(parts), decimal) and not channels:
            break
        alike = len(set(parts)) == 1 and not _are_units(_bare(parts), parts)
        if width > 2 and (alike or all(map(_FORMAT.fullmatch, parts))):  # the format of each column
            continue
        headers.append((position, parts))
    if not headers:
        names = _numbered(above[-1] if above else "", width, delimiter, decimal)
        return names or [""] * width, [split_unit(name)[1] for name in names or [""] * width], int(bool(names))
    bare = [_bare(parts) for _, parts in headers]
    for row in bare:
        if match := UNIT_CELL.fullmatch(row[0]):
            row[0] = match["unit"] or ""
    names, of_row, used = _names_and_units([parts for _, parts in headers], bare)
    units = of_row or [""] * width
    of_names = [split_unit(name, names)[1] for name in names]
    units = [unit or of_name for unit, of_name in zip(units, of_names, strict=True)]
    return names, units, used
