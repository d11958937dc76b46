"""MagIC 2 and 3 files of rock magnetism: a line with the name of a table, a row of names, and rows of every specimen.

Numbers are in SI units. Source: MagIC data models 2.5 and 3.0, https://earthref.org/MagIC/data-models.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator

import numpy as np

from hystfit.data.record import SLOPE, Stated
from hystfit.outcome import Code, Note
from hystfit.reading.arrangements.specimens import divided
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text import cells
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
_SPECIMENS = ("specimen", "er_specimen_name")
_LOOPS = re.compile(r"\bLP-HYS\b")  # method code of hysteresis loops; others are remanence in zero field
# Results in the rows of a specimen by their quantity; Ms and Mr have the ending of the moment (per mass, per volume) in their names.
_RESULTS = {
    "coercive_input": r"hyst(?:eresis)?_bc",
    "remanence": r"hyst(?:eresis)?_mr_{}",
    "saturation": r"hyst(?:eresis)?_ms_{}",
}
_SUSCEPTIBILITY = re.compile(
    r"hyst(?:eresis)?_xhf(?:_mass)?"
)  # of high fields per mass [m3/kg], which Ms, Mr and Bc are without


def read_magic(text: TextFile) -> Table | None:
    """MagIC 2 and 3: the measurements of the file, a record for each specimen."""
    first = next((line for line in text.head if line.strip() and not line.startswith(_END)), "")
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
    table = dataclasses.replace(table, units=tuple(units), pair=pair)
    return table if pair is None or pair[0] == temperature else _with_results(table, text, tables, table.names[pair[1]])


def _with_results(table: Table, text: TextFile, tables: list[tuple[str, range]], moment: str) -> Table:
    """The loops of the specimens with the results that other tables of the file state of them.

    Args:
        moment: name of the column that is the output.
    """
    position = next((k for k in table.labels if table.names[k] in _SPECIMENS), None)
    found: dict[str, dict[str, str]] = {}
    for title, rows in tables:
        lines = [text.lines[k].split("\t") for k in rows]
        names = lines[0] if lines else []
        column = next((k for k, name in enumerate(names) if name in _SPECIMENS), None)
        if column is None or "measurements" in title:
            continue
        for line in lines[1:]:
            row = {name: cell for name, cell in zip(names, line, strict=False) if cell}
            loops = any(_LOOPS.search(cell) for name, cell in row.items() if "method" in name)
            if loops and names[column] in row:
                found.setdefault(row[names[column]], {}).update(row)
    if position is None or not found:
        return table
    table = divided(table) or table
    named = [part.name for part in table.parts] if table.part is not None else [str(table.labels[position][0])]
    parts = table.parts if table.part is not None else (table.whole,)
    stated = [tuple(_stated(found.get(name, {}), moment)) for name in named]
    return dataclasses.replace(
        table, parts=tuple(dataclasses.replace(p, stated=s) for p, s in zip(parts, stated, strict=True))
    )


def _stated(row: dict[str, str], moment: str) -> Iterator[Stated]:
    """The results of a loop in the row of a specimen, in the units of the field and of the moment."""
    ending = moment.rpartition("_")[2]
    for quantity, pattern in _RESULTS.items():
        for name, cell in row.items():
            if re.fullmatch(pattern.format(ending), name) and (value := cells.number(cell, ".")) is not None:
                yield Stated(name, value, "T" if quantity == "coercive_input" else _MOMENTS[moment], quantity)
    for name, cell in row.items():
        if ending == "mass" and _SUSCEPTIBILITY.fullmatch(name) and (value := cells.number(cell, ".")) is not None:
            yield Stated(SLOPE, -value / (4e-7 * math.pi), "")


def _tables(text: TextFile) -> list[tuple[str, range]]:
    """Name and lines of every table, from its row of names on."""
    lines = text.lines
    starts = [text.first, *(k + 1 for k, line in enumerate(lines) if line.startswith(_END))]
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
