"""CSV files of Keysight EasyEXPERT: what each channel measured stands among the parameters of the test."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence

from hystfit.reading.files.text_file import TextFile
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text

_MEASURED = {"Vmeas": "V", "Imeas": "A"}  # end of the operation mode of a channel
# Parameters that name what the channels measure
_NAMED = {"Channel.VName": "V", "Channel.IName": "A", "Channel.TName": "s"}


def read_easyexpert(text: TextFile) -> Table | None:
    """CSV of Keysight EasyEXPERT: channels in the unit of their operation mode, or of the parameter that names them."""
    if not any(line.startswith("TestParameter") for line in text.head):
        return None
    table = plain_text(text)
    units = _units(text.lines[: int(table.line[0])], table.names)
    return dataclasses.replace(table, units=tuple(a or b for a, b in zip(table.units, units, strict=True)))


def _units(above: Sequence[str], names: Sequence[str]) -> list[str]:
    """Units of the columns, "" where unknown.

    Args:
        above: lines above the numbers, of which one has the names of the test's parameters and the next one their values.
    """
    rows = [[cell.strip() for cell in line.split(",")] for line in above if line.startswith("TestParameter")]
    titles, values = ([row for row in rows if row[1:2] == [kind]] for kind in ("Name", "Value"))
    modes = dict(zip(titles[0], values[0], strict=False)) if titles and values else {}
    named = {name: _NAMED[row[1]] for row in rows if row[1:2] and row[1] in _NAMED for name in row[2:]}
    return [named.get(name, "") or _unit(name, modes) for name in names]


def _unit(name: str, modes: Mapping[str, str]) -> str:
    """The unit of a column such as MeasResult2_value, given the operation modes of the channels."""
    column = re.fullmatch(r"MeasResult(\d+)_(time|value)", name)
    if column is None:
        return ""
    mode = modes.get(f"OperationMode{column[1]}", "")
    return "s" if column[2] == "time" else next((unit for end, unit in _MEASURED.items() if mode.endswith(end)), "")
