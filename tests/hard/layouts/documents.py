"""Tables that people write themselves: JSON, spreadsheets with decimal commas, a % header, several specimens below each other."""

from __future__ import annotations

import json

import numpy as np

from .drawing import Draw
from .physics import lagging, rubbing, saturating, wave
from .registry import kind
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, rows, table, titles

# Names, units and amplitude of an input and an output, and the device between them.
_PAIRS = (
    ("Voltage", "V", 100.0, "Displacement", "um", 15.0, lagging),
    ("Field", "Oe", 5000.0, "Moment", "emu", 0.02, saturating),
    ("Displacement", "mm", 20.0, "Force", "kN", 80.0, rubbing),
    ("Strain", "%", 2.0, "Stress", "MPa", 400.0, rubbing),
    ("H", "A/m", 800.0, "B", "T", 1.4, saturating),
    ("Current", "A", 2.0, "Displacement", "mm", 0.5, lagging),
)
_GERMAN = {
    "Voltage": "Spannung",
    "Displacement": "Weg",
    "Force": "Kraft",
    "Strain": "Dehnung",
    "Field": "Feld",
    "Current": "Strom",
    "Time": "Zeit",
}


def measured(draw: Draw, n: int) -> list[Column]:
    """Time, input and output of one of the usual pairs."""
    u_name, u_unit, u_size, y_name, y_unit, y_size, device = draw.pick(*_PAIRS)
    u = wave(draw, n, draw.whole(1, 4))
    y = draw.noise(device(draw, u), 1e-3)
    t = Column("Time", np.arange(n) * draw.pick(0.001, 0.01, 0.1), "s", ".4f")
    return [t, Column(u_name, u_size * u, u_unit, ".6g"), Column(y_name, y_size * y, y_unit, ".6g")]


@kind("JSON of arrays")
def json_arrays(draw: Draw) -> Layout:
    t, u, y = measured(draw, draw.whole(100, 600))
    with_time = [t] if draw.chance(0.6) else []
    style = draw.pick("{name} ({unit})", "{name}_{unit}", "{name} [{unit}]")
    key = lambda c: style.format(name=c.name, unit=c.unit)
    arrays = {key(c): c.written.tolist() for c in [*with_time, u, y]}
    content = draw.pick(arrays, {"sample": "S3", "operator": "Kim", "data": arrays}, {"data": arrays, "gain": 3.0})
    return Layout(
        "",
        {draw.pick("loop.json", "data.JSON", "run7"): json.dumps(content).encode()},
        loops(loop(u, y, t if with_time else None)),
    )


@kind("JSON of records")
def json_records(draw: Draw) -> Layout:
    t, u, y = measured(draw, draw.whole(100, 400))
    columns = [t, u, y] if draw.chance(0.6) else [u, y]
    key = lambda c: f"{c.name}_{c.unit}"
    records = [
        dict(zip(map(key, columns), row, strict=True))
        for row in zip(*(c.written.tolist() for c in columns), strict=True)
    ]
    if draw.chance(0.4):
        text = "\n".join(json.dumps(record) for record in records)
    else:
        text = json.dumps(draw.pick(records, {"records": records}), indent=draw.pick(None, 2))
    return Layout(
        "", {draw.pick("loop.json", "points.jsonl"): text.encode()}, loops(loop(u, y, t if len(columns) > 2 else None))
    )


@kind("table under a % header")
def percent_header(draw: Draw) -> Layout:
    t, u, y = measured(draw, draw.whole(100, 800))
    columns = [t, u, y] if draw.chance(0.7) else [u, y]
    gap = draw.pick("  ", "\t", " ")
    style = draw.pick("tight", "row", "underscore", "none")
    lines = draw.pick([], ["% exported from Matlab", "% 02-Mar-2020 14:05:11"]) + table(
        draw, columns, Dialect(gap, style=style, lead="% ")
    )
    if style == "none":
        u, y = (Column(c.name, c.values, "", c.form) for c in (u, y))
    return Layout(
        "",
        {draw.pick("loop.txt", "data.asc", "x.dat"): packed(draw, lines, ("utf-8",))},
        loops(loop(u, y, t if len(columns) > 2 else None)),
    )


@kind("spreadsheet with decimal commas")
def spreadsheet(draw: Draw) -> Layout:
    t, u, y = measured(draw, draw.whole(100, 800))
    t, u, y = (c.renamed(_GERMAN.get(c.name, c.name) if draw.chance(0.8) else c.name) for c in (t, u, y))
    columns = [t, u, y] if draw.chance(0.7) else [u, y]
    number = Column("Nr.", 1.0 + np.arange(len(u.values)), "", ".0f")
    columns = [number, *columns] if draw.chance(0.3) else columns
    style = draw.pick("brackets", "parentheses", "row", "in", "slash", "row in brackets")
    above = ["Messung;3", "Datum;02.03.2020", "Prüfer;Kim", ""][: draw.pick(0, 0, 4)]
    lines = above + table(draw, columns, Dialect(";", ",", style, trailing=draw.chance(0.2)))
    return Layout(
        "",
        {draw.pick("Messung 3.csv", "export.CSV"): packed(draw, lines)},
        loops(loop(u, y, t if t in columns else None)),
    )


@kind("specimens below each other")
def stacked(draw: Draw) -> Layout:
    count, parts = draw.whole(2, 5), []
    state = draw.rng.bit_generator.state
    for k in range(count):
        n = draw.whole(60, 200)
        draw.rng.bit_generator.state = state  # the same pair of quantities
        t, u, y = measured(draw, n)
        y = Column(y.name, y.values * (1 + 0.1 * k), y.unit, y.form)
        parts.append((np.full(n, draw.pick("S{}", "coupon {}").format(k + 1)), t, u, y))
    merged = [
        Column(c.name, np.concatenate([part[j].values for part in parts]), c.unit, c.form)
        for j, c in list(enumerate(parts[0]))[1:]
    ]
    label = Column(
        draw.pick("Specimen", "Sample", "Test ID", "specimen_name"), np.concatenate([part[0] for part in parts])
    )
    columns = [label, *(merged if draw.chance(0.6) else merged[1:])]
    dialect = Dialect(draw.pick(",", "\t", ";"), style=draw.pick("parentheses", "brackets", "underscore"))
    truth = [loop(u, y) for _, _, u, y in parts]
    return Layout(
        "", {draw.pick("all specimens.csv", "batch.txt"): packed(draw, table(draw, columns, dialect))}, loops(truth)
    )


@kind("curves apart by blank lines")
def blank_lines(draw: Draw) -> Layout:
    lines, truth = [], []
    state = draw.rng.bit_generator.state
    dialect = Dialect(draw.pick(",", "\t"), style=draw.pick("parentheses", "brackets"))
    repeated = draw.chance(0.4)
    count = draw.whole(2, 4)
    for k in range(count):
        draw.rng.bit_generator.state = state
        _, u, y = measured(draw, 150)
        u, y = (
            Column(u.name, u.values * (1 - 0.15 * k), u.unit, u.form, u.unit),
            Column(y.name, y.values * (1 - 0.2 * k), y.unit, y.form, y.unit),
        )
        lines += (
            (titles([u, y], dialect) if repeated or not k else [])
            + rows([u, y], dialect)
            + ([""] if k < count - 1 else [])
        )
        truth.append(loop(u, y))
    return Layout("", {draw.pick("levels.csv", "amplitudes.txt"): packed(draw, lines, ("utf-8",))}, loops(truth))
