"""Names and units of columns in lines of their own above the numbers: by their numbers, or behind a word that says what they are."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence

from hystfit.reading.names.names_with_units import is_unit, split_unit
from hystfit.reading.text import cells
from hystfit.reading.text.header import NAME_CELL, cut_cells

# "@attribute voltage numeric": a column of an ARFF file, below the one before.
_ATTRIBUTE = re.compile(r"@attribute\s+(?P<name>'[^']+'|\"[^\"]+\"|\S+)\s+\S.*", re.IGNORECASE)
# "@Column 3: Applied Field [Oe]", "# 2 = time (s)", "# first column: time": a column by its number, in the lines above the numbers.
_LISTED = re.compile(
    r"\W*[A-Za-z]{0,12}[\s_#.]*(?P<number>\d{1,3}|(?<![A-Za-z])first)(?: column:\s*|(?:\s*[:=).]\s*|\t\s*)(?!\d))(?P<name>.*[A-Za-z].*)"
)
_TITLED = re.compile(
    r"\W*(?P<word>columns?|fields?|names|channels?(?:[ _]?names?)?|variables|units?)(?:\s*[:=]\s*|(?<=#fields)\s+)(?P<cells>\S.*)",
    re.IGNORECASE,
)
_OF_CHANNEL = re.compile(
    r"\W*(?:(?:ch|channel|kanal|signal|column)[ _.]?\d*[ _.]?)?(name|unit)[ _]?\d*\s*[:=]\s*(\S.*)", re.IGNORECASE
)


def is_listed(line: str) -> bool:
    """Whether a line has the name of one column behind its number."""
    return _LISTED.fullmatch(line.strip()) is not None


def listed_names(above: Sequence[str], width: int) -> list[str]:
    """Names of columns that stand below each other with their numbers, from 0 or 1 on; none for other lines."""
    found = [_LISTED.fullmatch(line.strip()) for line in above]
    for first in range(len(found) - width + 1):
        block = [match for match in found[first : first + width] if match]
        numbers = [int(match["number"].replace("first", "1")) for match in block]
        if width > 1 and [number - numbers[0] for number in numbers] == list(range(width)):
            if numbers[0] in (0, 1):
                return [re.sub(r",?\s+(?=[\[(])", " ", match["name"].strip()) for match in block]
    attributes = [match["name"].strip("'\"") for line in above if (match := _ATTRIBUTE.fullmatch(line.strip()))]
    return attributes if len(attributes) == width else []


def behind_words(above: Sequence[str], width: int) -> dict[bool, list[str]]:
    """The names of all columns (False) and their units (True) in lines that begin with a word for them, the last of several."""
    found = {}
    for match in filter(None, (_TITLED.fullmatch(line.strip()) for line in with_next(above))):
        cut = [cut_cells(match["cells"], mark) for mark in (",", ";", "\t", "|", "  ", None)]
        is_units = match["word"][0].lower() == "u"
        if fitting := next(
            (parts for parts in cut if len(parts) == width and (any(parts) if is_units else all(parts))), None
        ):
            found[is_units] = fitting
    return found


def with_next(lines: Sequence[str]) -> list[str]:
    """The lines, those that end with a colon joined with the next one, "channel names:" above the names."""
    below = itertools.zip_longest(lines, lines[1:], fillvalue="")
    return [f"{line} {after}" if line.rstrip().endswith(":") else line for line, after in below]


def _of_channels(above: Sequence[str], width: int) -> dict[bool, list[str]]:
    """Names (False) and units (True) of as many channels as there are columns, a setting each: "Name=Force", "Channel 2 unit: kN"."""
    settings = [
        (match[1].lower(), match[2].strip()) for line in above if (match := _OF_CHANNEL.fullmatch(line.strip()))
    ]
    found = {word == "unit": [value for key, value in settings if key == word] for word in ("name", "unit")}
    return {key: values for key, values in found.items() if len(values) == width}


def titled_names(above: Sequence[str], width: int, delimiter: str | None) -> tuple[list[str], list[str]]:
    """Names and units behind words that say so ("# columns: height force", "# units: m N"), or of all columns but the first."""
    found = {}
    for line in above if delimiter else ():
        title, *names = cut_cells(line, delimiter)
        if len(names) == width - 1 and NAME_CELL.fullmatch(title) and all(names):
            found[False] = ["", *names]
    found |= _of_channels(above, width) | behind_words(above, width)
    names = found.get(False, [])
    if width < 2 or not names or any(cells.kind(name, ".") == cells.NUMBER for name in names):
        return [], []
    units = found.get(True, [""] * width)
    return names, [
        unit if is_unit(unit) else split_unit(name, names)[1] for name, unit in zip(names, units, strict=True)
    ]
