"""Instruments whose header is the difficulty: simulators of magnets, waves of Igor Pro, settings and names behind a label, unit rows."""

from __future__ import annotations

import numpy as np

from .documents import measured
from .drawing import Draw
from .physics import growing, lagging, major_loop, rubbing, saturating, triangle, wave
from .registry import kind
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, rows


def _magnetized(draw: Draw) -> tuple[list[Column], list[Column]]:
    """Components of a field, and of the magnetization that follows the first of them."""
    n = 2 * draw.whole(60, 150)
    x = major_loop(n)
    size = draw.size(20, 400)
    field = [
        Column("x", size * x, "mT", ".9g"),
        Column("y", 0.01 * size * x, "mT", ".9g"),
        Column("z", 0 * x, "mT", ".9g"),
    ]
    m = [saturating(draw, x, begin=1), 0.01 * x + draw.rng.normal(0, 1e-5, n), draw.rng.normal(0, 1e-6, n)]
    return field, [Column(axis, values, "", ".9g") for axis, values in zip("xyz", m, strict=True)]


@kind("simulator of magnets")
def simulator(draw: Draw) -> Layout:
    field, m = _magnetized(draw)
    n = m[0].values.size
    if draw.chance(0.5):
        names = [
            "{Oxs_MinDriver::Iteration}",
            "{Oxs_CGEvolve::Total energy}",
            *(f"{{Oxs_UZeeman::B{c.name}}}" for c in field),
        ]
        names += [f"{{Oxs_MinDriver::m{c.name}}}" for c in m]
        steps = Column("steps", 10.0 + np.cumsum(draw.rng.integers(1, 50, n)), "", ".0f")
        energy = Column("energy", 1e-19 * draw.rng.normal(size=n), "J", ".9g")
        lines = [
            "# ODT 1.0",
            "# Table Start",
            f"# Columns: {' '.join(names)}",
            "# Units: {} {J} {mT} {mT} {mT} {} {} {}",
        ]
        lines += [" " + row for row in rows([steps, energy, *field, *m], Dialect("   "))] + ["# Table End"]
        return Layout("", {"hysteresis.odt": packed(draw, lines)}, loops(loop(field[0], m[0])))
    t = Column("t", 1e-9 * np.arange(n), "s", ".6g")
    names = ["# t (s)", *(f"m{c.name} ()" for c in m), *(f"B_ext{c.name} (mT)" for c in field)]
    lines = ["\t".join(names), *rows([t, *m, *field], Dialect("\t"))]
    return Layout("", {"table.txt": packed(draw, lines)}, loops(loop(field[0], m[0])))


@kind("waves of Igor Pro")
def igor(draw: Draw) -> Layout:
    _, u, y = measured(draw, draw.whole(100, 400))
    units = draw.chance(0.7)
    if draw.chance(0.5):
        lines = [
            "IGOR",
            f"WAVES/D\t{u.name}, {y.name}",
            "BEGIN",
            *("\t" + row for row in rows([u, y], Dialect("\t"))),
            "END",
        ]
    else:
        lines = ["IGOR"]
        for column in (u, y):
            lines += [
                f"WAVES/D/N=({len(column.cells)})\t'{column.name}'",
                "BEGIN",
                *(f"\t{cell}" for cell in column.cells),
                "END",
            ]
    for column in (u, y) if units else ():
        lines.append(f'X SetScale d 0,0,"{column.unit}", {column.name}')
    bare = [Column(c.name, c.values, "", c.form) for c in (u, y)]
    return Layout(
        "", {draw.pick("loop.itx", "waves.txt"): packed(draw, lines)}, loops(loop(u, y) if units else loop(*bare))
    )


@kind("settings and names behind a label")
def labeled(draw: Draw) -> Layout:
    """Dynamic strain recorders and oscilloscopes: a word before the settings, the names and the units of the channels."""
    n = 4 * draw.whole(40, 120)
    x = growing(n, 4)
    u, y = Column("CH-2", 20 * x, "mm", ".4f"), Column("CH-1", 80 * draw.noise(rubbing(draw, x), 2e-3), "kN", ".4f")
    t = Column("", 0.01 * np.arange(n), "s", ".4f")
    if draw.chance(0.5):
        head = [
            '"ID","DCS-100A"',
            f'"Data",{n}',
            '"CH名称","CH-1","CH-2"',
            '"CHNo","1","2"',
            '"Range","5000","5000"',
            '"Coef","0.01","0.02"',
        ]
        lines = [*head, '"単位(sec)","kN","mm"', *rows([t, y, u], Dialect(","))]
        return Layout("", {"strain.csv": packed(draw, lines, ("utf-8", "cp932"))}, loops(loop(u, y, t)))
    names = draw.pick(("Displacement", "Force"), ("disp", "load"))
    u, y = u.renamed(names[0]), y.renamed(names[1])
    head = [f'"TraceName","{u.name}","{y.name}"', '"BlockNumber",1,1', '"VUnit","mm","kN"', f'"BlockSize",{n},{n}']
    head += ['"HResolution",1.0E-02,1.0E-02', '"HUnit","s","s"', '"Date","2017/01/02","2017/01/02"', ""]
    lines = ['"//ASCII FILE FORMAT"', *head, *("," + row for row in rows([u, y], Dialect(",")))]
    return Layout("", {"wave.csv": packed(draw, lines)}, loops(loop(u, y)))


@kind("units of some columns below the names")
def some_units(draw: Draw) -> Layout:
    """Loggers and potentiostats: a row of units in which a reference electrode, an alarm or a number has none."""
    n = 2 * draw.whole(80, 200)
    if draw.chance(0.5):
        x = triangle(n, 2)
        t, u = Column("T", 0.1 * np.arange(n), "s", ".4f"), Column("Vf", 1.2 * x, "V", ".5E")
        y = Column("Im", 1e-3 * saturating(draw, x), "A", ".5E")
        point, vu = Column("Pt", np.arange(n), "", ".0f"), Column("Vu", 0 * x, "V", ".1f")
        lines = ["EXPLAIN", "TAG\tCV", "CURVE1\tTABLE", "\tPt\tT\tVf\tIm\tVu\tOver", "\t#\ts\tV vs. Ref.\tA\tV\tbits"]
        lines += [f"\t{row}\t..........." for row in rows([point, t, u, y, vu], Dialect("\t"))]
        return Layout("", {"cv.DTA": packed(draw, lines)}, loops(loop(u, y, t)))
    x = (1 + wave(draw, n, 3)) / 2
    u, y = Column("drive", 10 * x, "V", "+.3f"), Column("gap", 3 * draw.noise(lagging(draw, x), 1e-3), "mm", "+.4f")
    number = Column("Number", 1.0 + np.arange(n), "", ".0f")
    stamps = np.array([f"2016/04/27 13:{k // 60:02d}:{k % 60:02d}" for k in range(n)])
    columns = [
        number,
        Column("Date&Time", stamps),
        Column("ms", np.full(n, "000")),
        u,
        y,
        Column("Alarm", np.full(n, "LLLL")),
    ]
    lines = [
        "Vendor,Maker",
        f"Total data points,{n}",
        "Data",
        "Number,Date&Time,ms,drive,gap,Alarm",
        "NO.,Time,ms,V,mm,A1234",
    ]
    lines += rows(columns, Dialect(","))
    return Layout("", {"logger.CSV": packed(draw, lines)}, loops(loop(u, y)))


@kind("header of another shape than its rows")
def misshapen(draw: Draw) -> Layout:
    """Formats below the units, cells set apart by two tabs, names of rows, results in a longer first row."""
    n = 2 * draw.whole(60, 200)
    field = draw.size(0.1, 2) * major_loop(n)
    h = Column("Field", field, "T", ".6f")
    m = Column(
        "Moment", draw.noise(draw.size(1e-4, 1) * saturating(draw, field / field.max(), begin=1), 1e-3), "emu", ".6e"
    )
    bare = Dialect("\t", style="none")
    body = rows([h, m], bare)
    names = [f"{c.name} ({c.unit})" for c in (h, m)]
    shape = draw.pick("formats", "tabs", "names of rows", "first row")
    if shape == "formats":
        head = ["Fri Dec 02 14:06:15 2011", "", "  No,  Field,  Moment", "  -,  T,  emu", "", "  6:0  6:0  6:0"]
        lines = head + [f"{k} " + row.replace("\t", " ") for k, row in enumerate(body)]
    elif shape == "tabs":
        lines = [
            "# Loop\t" + "\t".join(names) + "\t",
            *(f"1\t\t{row}".replace("\t\t", "\t").replace("\t", "\t\t") for row in body),
        ]
    elif shape == "names of rows":
        lines = ["\t".join(names), *(f"s{k}\t{row}" for k, row in enumerate(body))]
    else:
        lines = ["\t".join(["Time (s)", *names, "Level", "Ratio"]), "0.5\t0\t0\t#REF\t33.8"]
        lines += [f"{1 + k}\t{row}\t" for k, row in enumerate(body)]
    return Layout("", {draw.pick("loop.fld", "loop.txt"): packed(draw, lines)}, loops(loop(h, m)))
