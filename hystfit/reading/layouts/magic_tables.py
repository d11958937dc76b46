"""MagIC 2 and 3 files of rock magnetism: a line with the name of a table, a row of names, and rows of every specimen.

Numbers are in SI units. Source: MagIC data models 2.5 and 3.0, https://earthref.org/MagIC/data-models.
"""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text

_FIRST_LINE = re.compile(r"\s*(?:tab(?: delimited)?)\s*\t\s*(\w+)\s*", re.IGNORECASE)
_END = ">>>>>>>>>>"
_FIELDS = {"meas_field_dc": "T", "measurement_lab_field_dc": "T", "treat_dc_field": "T", "treatment_dc_field": "T"}
_MOMENTS = {
    "magn_moment": "Am2",
    "measurement_magn_moment": "Am2",
    "magn_mass": "Am2/kg",
    "measurement_magn_mass": "Am2/kg",
    "magn_volume": "A/m",
    "measurement_magn_volume": "A/m",
    "susc_chi_mass": "m3/kg",
    "susc_chi_volume": "",
}
_TEMPERATURES = {"meas_temp": "K", "measurement_temp": "K"}  # the input where the field is held
_EXPERIMENTS = ("experiment", "magic_experiment_names")
_LOOPS = re.compile(r"\bLP-HYS\b")  # method code of hysteresis loops; others are remanence in zero field


def read_magic(text: TextFile) -> Table | None:
    """MagIC 2 and 3: the measurements of the file, a record for each specimen."""
    first = next((line for line in text.head if not line.startswith(_END)), "")
    if not _FIRST_LINE.fullmatch(first):
        return None
    tables = _tables(text)
    name, rows = max(tables, key=lambda table: ("measurements" in table[0], len(table[1])))
    inside = set(rows)
    table = plain_text(text.without(k for k in range(len(text.lines)) if k not in inside))
    table = _loops_of(table)
    if len(tables) > 1:
        others = ", ".join(other for other, _ in tables if other != name)
        table = table.noted(Note(Code.FILE_FORMAT, f"the MagIC table {name!r} is read; beside it: {others}"))
    drive, temperature, moment = (_best(table, names) for names in (_FIELDS, _TEMPERATURES, _MOMENTS))
    known = _FIELDS | _TEMPERATURES | _MOMENTS
    units = [known.get(name, unit) for name, unit in zip(table.names, table.units, strict=True)]
    drive = temperature if drive is None else drive
    pair = None if drive is None or moment is None else (drive, moment)
    return dataclasses.replace(table, units=tuple(units), pair=pair)


def _tables(text: TextFile) -> list[tuple[str, range]]:
    """Name and lines of every table, from its row of names on."""
    lines = text.lines
    starts = [0, *(k + 1 for k, line in enumerate(lines) if line.startswith(_END))]
    found = []
    for start, stop in zip(starts, [*(k - 1 for k in starts[1:]), len(lines)], strict=True):
        if start < len(lines) and (title := _FIRST_LINE.fullmatch(lines[start])):
            found.append((title[1], range(start + 1, stop)))
    return found


def _loops_of(table: Table) -> Table:
    """The rows of hysteresis loops, where method codes say which they are."""
    for position in sorted(table.labels, key=lambda k: ("method" not in table.names[k], k)):
        codes = table.labels[position]
        loops = np.array([bool(_LOOPS.search(code)) for code in codes])
        if loops.any():
            if loops.all():
                return table
            others = ", ".join(dict.fromkeys(codes[~loops].tolist()))
            text = f"left out: {int((~loops).sum())} rows of other experiments ({others})"
            if without := _without_loops(table, loops):
                text += f"; no loop of {', '.join(without)}"
            return table.take(loops).noted(Note(Code.LEFT_OUT, text))
    return table


def _without_loops(table: Table, loops: np.ndarray) -> list[str]:
    """Specimens that have rows, and none of a loop."""
    position = next((k for k in table.labels if table.names[k] in ("specimen", "er_specimen_name")), None)
    if position is None:
        return []
    with_loops = set(table.labels[position][loops].tolist())
    return [name for name in dict.fromkeys(table.labels[position].tolist()) if name not in with_loops]


def _best(table: Table, names: dict[str, str]) -> int | None:
    """Position of the column with most numbers among those of these names that vary within an experiment; None without one."""
    held = max((len({*table.labels[k]}) for k in table.labels if table.names[k] in _EXPERIMENTS), default=1)
    numbers = {k: table.columns[k] for k, name in enumerate(table.names) if name in names and k not in table.labels}
    finite = {k: column[np.isfinite(column)] for k, column in numbers.items()}
    varied = {k: column.size for k, column in finite.items() if np.unique(column).size > held}
    return max(varied, key=lambda k: varied[k], default=None)
