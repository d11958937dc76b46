"""Isotherms as instruments and the programs around them write them: AIF, marked branches, series of a balance, units under the names."""

from __future__ import annotations

import json

import numpy as np

from .drawing import Draw
from .physics import lagging, triangle
from .registry import kind
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, rows, table


def _isotherm(draw: Draw) -> tuple[int, np.ndarray, np.ndarray]:
    """Rows of the adsorption branch, relative pressure, and amount adsorbed of both branches."""
    half = draw.whole(30, 80)
    p = (1 + 0.98 * triangle(2 * half, 1, 0.75)) / 2
    q = draw.size(2, 500) * (0.3 * p**0.2 + 0.5 * (1 + np.tanh(3 * lagging(draw, 2 * p - 1, 0.6))) / 2)
    top = int(np.argmax(p)) + 1
    return top, p, draw.noise(q, 5e-4)


@kind("adsorption information file")
def aif(draw: Draw) -> Layout:
    top, p, q = _isotherm(draw)
    unit, size = draw.pick(("kPa", 101.3), ("bar", 1.013), ("Pa", 101300.0))
    amount = draw.pick("mmol/g", "cm3/g", "ml(STP) g-1", "cm^3(STP)/g", "mg/g")
    u, y = Column("pressure", size * p, unit, ".6g"), Column("amount", q, amount, ".6g", amount)
    saturated = draw.chance(0.6)
    lines = [
        "data_raw2aif",
        "_audit_aif_version 1.0",
        "_exptl_operator 'A. Chemist'",
        "_exptl_adsorptive N2",
        "_exptl_temperature 77.3",
        f"_units_pressure {unit}",
        f"_units_loading '{amount}'",
    ]
    for branch, part in (("adsorp", slice(0, top)), ("desorp", slice(top, None))):
        columns = [u, Column("p0", np.full(p.size, size), unit, ".6g"), y] if saturated else [u, y]
        cut = [Column(one.name, one.values[part], one.unit, one.form) for one in columns]
        lines += ["", "loop_", *(f"_{branch}_{one.name}" for one in columns), *rows(cut, Dialect(" "))]
    return Layout("", {draw.pick("sample.aif", "N2_77K.cif"): packed(draw, lines, ("utf-8",))}, loops(loop(u, y)))


@kind("isotherm with marked branches")
def marked(draw: Draw) -> Layout:
    """A line of one word before each branch, and the pressure of every step of dosing beside that of equilibrium."""
    top, p, q = _isotherm(draw)
    number = Column("No", np.append(np.arange(1.0, top + 1), np.arange(1.0, p.size - top + 1)), "", ".0f")
    dosed = Column("pi", 100 * (p + 0.02 * draw.rng.uniform(size=p.size)), "kPa", ".5g", "kPa")
    reached = Column("pe", 100 * p, "kPa", ".5g", "kPa")
    constant = Column("p0", np.full(p.size, 100.0), "kPa", ".3f", "kPa")
    u = Column("p/p0", p, "", ".6f")
    amount = draw.pick("cm^3(STP) g^-1", "mol g^-1", "cm3(STP) g-1")
    y = Column(draw.pick("Va", "na"), q, amount, ".5g", amount)
    columns = [number, dosed, reached, constant, u, y]
    lines = table(draw, columns, Dialect(",", style="slash"))
    head = [
        "File Name,C 3.DAT",
        "Sample weight,8.1300E-02,[g]",
        "Adsorptive,N2",
        f"Number of data points :,{p.size}",
        "",
    ]
    lines = [*head, lines[0].replace(" / ", "/"), "ADS", *lines[1 : top + 1], "DES", *lines[top + 1 :]]
    return Layout("", {draw.pick("belsorp.csv", "C 3.DAT"): packed(draw, lines)}, loops(loop(u, y), loop(reached, y)))


@kind("units under the names of columns")
def stated(draw: Draw) -> Layout:
    """The settings above a table, or beside the arrays of a JSON, give the unit of each column by its name."""
    _, p, q = _isotherm(draw)
    unit = draw.pick("bar", "kPa", "mbar")
    u, y = Column("pressure", p, unit, ".6g"), Column("loading", q, "mmol", ".6g", "mmol")
    if draw.chance(0.5):
        points = [{"loading": float(f"{b:.6g}"), "pressure": float(f"{a:.6g}")} for a, b in zip(p, q, strict=True)]
        ending = draw.pick("_unit", "_units", "Units")
        content = {"material": "MCM-41", "isotherm_data": points, f"pressure{ending}": unit, f"loading{ending}": "mmol"}
        lines = json.dumps(content, indent=4).splitlines()
        return Layout("", {"isotherm.json": packed(draw, lines, ("utf-8",))}, loops(loop(u, y)))
    order = draw.shuffled([u, y])
    head = [f"pressure_unit,{unit}", "loading_unit,mmol", "material_name,MCM-41", "t_iso,77.0"]
    lines = [*draw.shuffled(head), ",".join(one.name for one in order), *rows(order, Dialect(","))]
    return Layout("", {"isotherm.csv": packed(draw, lines)}, loops(loop(u, y)))


@kind("series of a sorption balance")
def series(draw: Draw) -> Layout:
    """A report for each temperature, in aligned columns under rules: names over two lines, and units below most of them."""
    wide, text, records = draw.whole(12, 14), [], []
    for number in range(1, draw.whole(1, 3) + 1):
        _, p, q = _isotherm(draw)
        p = draw.noise(p, 5e-4)  # as the sensor reads it
        u, y = Column("Pressure", 900 * p, "mbar", ".1f"), Column("Excess Adsorption", q, "mmol/g", ".4f")
        columns = [
            (("Pressure", "", "(mbar)"), u.cells),
            (("Gas", "Density", "(g/cc)"), [f"{1e-3 * x:.6f}" for x in p]),
            (("p/p0", "", ""), [f"{x:.3f}" for x in 0.01 * p]),
            (("Excess", "Adsorption", "(mmol/g)"), y.cells),
            (("Sample", "", "(degC)"), [f"{x:.2f}" for x in 20 * number + draw.rng.normal(0, 0.01, p.size)]),
        ]
        line = lambda cells: "".join(cell.ljust(wide) for cell in cells)
        rule = "-" * (5 * wide)
        text += [
            rule,
            "S E R I E S   D A T A".center(5 * wide),
            rule,
            "",
            f"Experiment No          {number:03d}",
            "Scan                   1",
            "",
        ]
        text += [line(names[k] for names, _ in columns) for k in range(3)]
        text += [rule, *(line(row) for row in zip(*(cells for _, cells in columns), strict=True)), rule, ""]
        text += [f"Scan Ends              0{number}:36:36 on 16 January 2020", "", ""]
        records.append(loop(u, y))
    return Layout("", {draw.pick("IGA.txt", "series.dat"): packed(draw, text, ("utf-8",))}, loops(records))
