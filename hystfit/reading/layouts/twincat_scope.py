"""Exports of TwinCAT Scope: rows of properties, a cell for each channel, and a column of time before each group of channels.

The word that names a property stands above each column of time: "Name", "torque", "angle", "Name", "current".
"""

from __future__ import annotations

import collections
from collections.abc import Sequence

from hystfit.outcome import Code
from hystfit.outcome.note import warn
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.cells import clean
from hystfit.reading.text.dialect import split
from hystfit.reading.text.plain_text import plain_text

_INTERVAL = "SampleTime["  # the property that no other program writes, with the unit of the times
_NO_UNIT = "(None)"


def read_twincat_scope(text: TextFile) -> Table | None:
    """The channels of an export of TwinCAT Scope that were sampled together; None for other text."""
    if (at := next((k for k, line in enumerate(text.head) if line.startswith(_INTERVAL)), None)) is None:
        return None
    key = text.head[at].partition("]")[0] + "]"
    mark = text.opening.delimiter or text.head[at][len(key) :][:1]
    begin = max((k for k in range(at) if text.head[k].startswith("Name" + mark)), default=at)
    end = next((k for k in range(at, len(text.head)) if not text.head[k].strip()), len(text.head))
    rows = {row[0]: row for row in ([clean(cell) for cell in split(line, mark)] for line in text.head[begin:end])}
    if not mark or "Name" not in rows:
        return None
    chosen, others = _sampled_together(rows[key], key)
    names, units = rows["Name"], rows.get("Unit", [])
    titles = [f"Time {key.removeprefix('SampleTime')}", *(_title(names, units, k) for k in chosen[1:])]
    lines = [""] * (end - 1) + [mark.join(titles)]
    for line in text.lines[end:]:
        cells = split(line, mark)
        lines.append(mark.join(cells[k] for k in chosen) if len(cells) > chosen[-1] else "")
    table = plain_text(text.of("\n".join(lines)))
    if others:
        left = ", ".join(repr(names[k]) for k in others if k < len(names))
        table = table.noted(warn(Code.LEFT_OUT, f"channels with another sampling interval are not used: {left}"))
    return table


def _sampled_together(intervals: Sequence[str], key: str) -> tuple[list[int], list[int]]:
    """The first column of time and the channels with the most common sampling interval, and the other channels."""
    channels = [k for k, cell in enumerate(intervals) if cell != key]
    usual = collections.Counter(intervals[k] for k in channels).most_common(1)[0][0]
    chosen = [k for k in channels if intervals[k] == usual]
    clock = max(k for k in range(chosen[0]) if intervals[k] == key)
    return [clock, *chosen], [k for k in channels if k not in chosen]


def _title(names: Sequence[str], units: Sequence[str], k: int) -> str:
    """The name of a channel with its unit: "V (Voltage)" in the row of units."""
    unit = units[k] if k < len(units) and units[k] != _NO_UNIT else ""
    return f"{names[k]} [{unit.partition(' (')[0]}]" if unit else names[k]
