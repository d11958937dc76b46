"""Text files of MicroMag, Lake Shore (VSM, AGM) and VFTB magnetometers: sections in capitals, a table of segments, field and moment.

Units of moment and field follow from the line of units, or else from "Units of measure". The segments of a loop, of which the first may
have no data, follow each other and are one record. A segment without data between two others is a ramp that was not measured: the curve
after it is another record, and begins with the point that was held before the ramp.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

import numpy as np

from hystfit.data.circulation import SLACK
from hystfit.data.record import OFFSET, SLOPE, Stated
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.limits import FEW
from hystfit.reading.table.raw_table import Part, Table
from hystfit.reading.text.header import setting_of
from hystfit.reading.text.other_lines import Header
from hystfit.reading.text.plain_text import plain_text
from hystfit.reading.text.stated_results import stated_in

_FIRST_LINE = re.compile(r'"?(?:MicroMag|Model (?:2900|3900|\d+/\d+).*Data File|VFTB.*Data File)', re.IGNORECASE)
_LAST_LINE = re.compile(r'"?(?:MicroMag|Model) [\d/]+ Data File ends"?\s*', re.IGNORECASE)
_SECTIONS = frozenset(
    "INSTRUMENT SAMPLE SETTINGS MEASUREMENT PROCESSING ADJUSTMENTS CHARACTERIZATION VIEWPORT SCRIPT".split()
)
_SYSTEMS = {"cgs": ("Oe", "emu"), "hybrid si": ("T", "Am2"), "si": ("A/m", "Am2")}
_SEGMENT = re.compile(r"\s*\d{7,},")
_DATA = re.compile(r"\s*[+-]?[\d.]+(?:[eE][+-]?\d+)?\s*,")
_SYMBOLS = re.compile(r"\(([^)]*)\)")
_TESLA = 20.0  # largest field of these magnets in T, with a margin: in Oe no loop is as small


def read_micromag(text: TextFile) -> Table | None:
    """MicroMag and Lake Shore magnetometers: field and moment, raw unless `--adjusted`, with the results stated by the instrument."""
    opening = text.head[text.first : text.first + FEW]
    old = bool(opening) and _FIRST_LINE.match(opening[0]) is not None and '",' in opening[0]
    sections = len(_SECTIONS.intersection(line.strip() for line in text.head))
    if not (old or sections >= FEW or any(_FIRST_LINE.match(line) for line in opening)):
        return None
    text = text.without(k for k, line in enumerate(text.lines) if _LAST_LINE.fullmatch(line))
    if old:  # one quoted line with all settings; the field in Oe, the moment in counts of the instrument
        table = plain_text(text.without([text.first]))
        names, units = ("Field", "Moment", *table.names[2:]), ("Oe", "", *table.units[2:])
        return dataclasses.replace(table, names=names, units=units, named=True, pair=(0, 1))
    rows = [k for k, line in enumerate(text.lines) if _SEGMENT.match(line)]
    rows = [k for k in rows if k < len(rows) + rows[0]]  # those below each other
    first = next((k for k in range(rows[-1] + 1 if rows else 0, len(text.lines)) if _DATA.match(text.lines[k])), 0)
    above = text.lines[:first]
    units = _system(above)
    header = _columns(above[rows[-1] + 1 if rows else 0 :], text.lines[first].count(",") + 1, units)
    table = plain_text(text.without(rows), header)
    table = _with_units(dataclasses.replace(table, pair=(0, 1), named=True))
    stated = stated_in(
        above, {"coercive_input": table.units[0], "remanence": table.units[1], "saturation": table.units[1]}
    )
    table = dataclasses.replace(table, parts=(Part(stated=_with_applied_line(table, stated)),))
    return table if not rows else _by_segments(table, text.lines, rows)


def _with_applied_line(table: Table, stated: tuple[Stated, ...]) -> tuple[Stated, ...]:
    """The stated results with the line by which the adjusted moments differ from the raw ones: the header may state another slope."""
    at = {name: table.columns[k] for k, name in enumerate(table.names)}
    if not {"Field", "Moment", "Adjusted Moment"} <= at.keys():
        return stated
    change, field = at["Adjusted Moment"] - at["Moment"], at["Field"]
    known = np.isfinite(change) & np.isfinite(field)
    if known.sum() < 2 or np.ptp(field[known]) == 0:
        return stated
    slope, offset = np.polyfit(field[known], change[known], 1)
    left = np.abs(change[known] - slope * field[known] - offset).max()
    if left > SLACK * np.abs(change[known]).max():
        return stated
    line = Stated(SLOPE, float(slope)), Stated(OFFSET, float(offset))
    return (*line, *(one for one in stated if one.label != SLOPE))


def _system(above: Sequence[str]) -> dict[str, str]:
    """Units of field, moment and temperature by the settings of the instrument."""
    settings = {key.lower(): value.strip() for line in above if (pair := setting_of(line)) for key, value in [pair]}
    field, moment = _SYSTEMS.get(settings.get("units of measure", "").lower(), ("", ""))
    temperature = {"kelvin": "K", "celsius": "degC"}.get(settings.get("temperature in", "").lower(), "")
    return {"Field": field, "Moment": moment, "Temperature": temperature, "Time": "s"}


def _with_units(table: Table) -> Table:
    """The table with units of field and moment; where the file states none they follow from the size of the fields."""
    if any(table.units[:2]) or not np.isfinite(table.columns[0]).any():
        return table
    field = np.abs(table.columns[0])
    units = _SYSTEMS["hybrid si" if np.nanmax(field) < _TESLA else "cgs"]
    text = f"the file states no units: {units[0]} and {units[1]} are assumed from the size of the fields; if wrong give --units (units=)"
    return dataclasses.replace(table, units=(*units, *table.units[2:])).noted(warn(Code.UNITS, text))


def _columns(above: Sequence[str], width: int, system: dict[str, str]) -> Header:
    """Names and units of the columns from lines such as "Adjusted  Adjusted" above "Field  Moment" above "(T)  (Am2)".

    Args:
        above: lines between the segments and the numbers.
        system: unit of each column, where no line of units gives it.
    """
    words = [re.split(r"\s{2,}", line.strip()) if line.strip() else [] for line in above]
    place = next((k for k in range(len(words) - 1, -1, -1) if "Field" in words[k]), None)
    names = ["Field", "Moment", *(f"column {k}" for k in range(2, width))] if place is None else words[place]
    units = [system.get(name, "") for name in names]
    if place is not None:
        symbols = _SYMBOLS.findall(above[place + 1]) if place + 1 < len(above) else []
        symbols = [symbol.replace("·", "").replace("²", "2") for symbol in symbols]
        units = symbols if len(symbols) == len(names) else units
        kinds = words[place - 1] if place else []  # above the last columns
        kinds = kinds if {*kinds} <= {"Raw", "Adjusted"} else []
        kinds = [""] * (len(names) - len(kinds)) + [kind.replace("Raw", "") for kind in kinds]
        names = [f"{kind} {name}".strip() for kind, name in zip(kinds, names, strict=True)]
    return Header(names[:width], units[:width], 1)


def _by_segments(table: Table, lines: Sequence[str], rows: Sequence[int]) -> Table:
    """The table with its curves as the segments divide them.

    Args:
        rows: positions of the lines of the segments.
    """
    titles = _titles(lines[rows[0] - 3 : rows[0]])
    wanted = [
        next((k for k, title in enumerate(titles) if title == name), None) for name in ("initial field", "final field")
    ]
    segments = np.array([[float(cell) for cell in lines[k].split(",")] for k in rows])
    ends = segments[:, -1].astype(int)
    if ends[-1] != table.rows or None in wanted or (np.diff(ends, prepend=0) < 0).any():
        text = f"the {len(rows)} segments in the header do not have the {table.rows} rows of the file, and do not divide it"
        return table.noted(warn(Code.CURVES, text))
    initial, final = (segments[:, k] for k in wanted)
    curve, held = np.zeros(table.rows, dtype=int), np.zeros(table.rows, dtype=bool)
    same = SLACK * np.abs(segments[:, wanted]).max()
    number, last = 0, None
    for k, (start, stop) in enumerate(zip(np.append(0, ends[:-1]), ends, strict=True)):
        if stop == start:
            continue
        ramp = last is not None and last < k - 1 and np.abs(np.diff([*final[last:k]])).max() > same
        if ramp or (last is not None and abs(initial[k] - final[last]) > same):
            number += 1
            if start and initial[last] == final[last]:
                held[start - 1], curve[start - 1] = True, number
        curve[start:stop], last = number, k
    curve = np.maximum.accumulate(curve)
    table = dataclasses.replace(table, curve=np.zeros(table.rows, dtype=int))
    if not number:
        return table
    fields = [table.columns[0][curve == k] for k in range(number + 1)]
    moves = np.array([field.size > 1 and np.ptp(field) > same for field in fields])
    text = f"{moves.sum()} curves: between them, the instrument swept without measuring ({len(rows)} segments)"
    notes = [Note(Code.CURVES, text)]
    if not moves.all():
        notes.append(Note(Code.LEFT_OUT, f"left out: {(~moves).sum()} curves at one field"))
    whole = table.parts[0]
    parts = tuple(dataclasses.replace(whole, name=f"curve={k}") for k in np.flatnonzero(moves))
    part, marked = np.cumsum(moves)[curve] - 1, held if held.any() else None
    table = dataclasses.replace(table, part=part, parts=parts, calibration=marked)
    return table.take(moves[curve]).noted(*notes)


def _titles(above: Sequence[str]) -> list[str]:
    """Titles of the columns of segments, whose words stand above each other over up to three lines."""
    words = [[(m.start(), m.end(), m[0]) for m in re.finditer(r"[A-Za-z]+", line)] for line in above if "(" not in line]
    *upper, lower = [line for line in words if line]
    titles = []
    for start, end, word in lower:
        over = [other for line in upper for a, b, other in line if a < end + 2 and start < b + 2]
        titles.append(" ".join([*over, word]).lower())
    return titles
