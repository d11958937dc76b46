"""Logs of a serial console that puts the time of day and an arrow before every line: "10:20:00.123 -> 3.5,2.1"."""

from __future__ import annotations

import re

from hystfit.reading.files.text_file import TextFile
from hystfit.reading.limits import MOST
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text

_STAMPED = re.compile(r"\s*(\d\d:\d\d:\d\d(?:[.,]\d+)?)\s*->\s*(.*)")
_MARKS = (";", "\t", ",", " ")  # between the numbers, the first one of which there are several


def read_console_log(text: TextFile) -> Table | None:
    """Lines of a serial console with the time of day and an arrow before each, as a column of time; None for other text."""
    found = [_STAMPED.fullmatch(line) for line in text.head if line.strip()]
    if not found or sum(match is not None for match in found) < MOST * len(found):
        return None
    last = next(match for match in reversed(found) if match)
    mark = next((mark for mark in _MARKS if mark in last[2].strip()), ",")
    lines = []
    for line in text.lines:
        match = _STAMPED.fullmatch(line)
        numbers = match is not None and re.match(r"[+-]?[.,]?\d", match[2]) is not None
        lines.append(f"{match[1] if numbers else 'time'}{mark}{match[2].strip()}" if match else line)
    return plain_text(text.of("\n".join(lines)))
