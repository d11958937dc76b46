"""Unusual ways to write numbers and names: powers of ten in units, SI prefixes, exponents without their letter, LaTeX, wrapped lines."""

from __future__ import annotations

import dataclasses

import numpy as np

from .documents import measured
from .drawing import Draw
from .physics import growing, major_loop, rubbing, saturating
from .registry import kind
from .truth import Layout, Loop, loops
from .writing import Column, Dialect, loop, packed, rows, table


def _scaled(column: Column, power: int) -> Column:
    """The column as it is meant, where the numbers that are written are in 10^power of its unit."""
    return dataclasses.replace(column, values=10.0**power * column.written, form=".12e")


@kind("powers of ten in units")
def powers(draw: Draw) -> Layout:
    _, u, y = measured(draw, draw.whole(100, 400))
    forms = ("10^{}", "x10^{}", "×10^{}", "10**{}", "10^{{{}}}", "1e{}")
    found = []
    for column in (u, y):
        power = draw.pick(-6, -3, 3, 4)
        raised = str(power).translate(str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻"))
        factor = draw.pick(*(form.format(power) for form in forms), f"10{raised}", f"×10{raised}")
        found.append((dataclasses.replace(column, spelled=f"{factor} {column.unit}"), _scaled(column, power)))
    style = draw.pick("parentheses", "brackets", "row")
    lines = table(draw, [written for written, _ in found], Dialect(draw.pick(",", "\t", ";"), style=style))
    truth = loop(*(meant for _, meant in found))
    return Layout("", {draw.pick("scaled.csv", "fig2.txt"): packed(draw, lines, ("utf-8",))}, loops(truth))


def _prefixed(value: float) -> str:
    """A number with an SI prefix, of six digits."""
    prefixes = (("k", 1e3), ("", 1.0), ("m", 1e-3), ("u", 1e-6))
    prefix, size = next((one for one in prefixes if abs(value) >= one[1]), prefixes[-1])
    return f"{value / size:.6g}{prefix}"


@kind("SI prefixes in cells")
def prefixes(draw: Draw) -> Layout:
    n = 2 * draw.whole(80, 200)
    x = major_loop(n)
    pair = (draw.size(1500, 9000) * x, draw.size(0.01, 0.05) * draw.noise(saturating(draw, x, begin=1), 1e-3))
    size = {"k": 1e3, "m": 1e-3, "u": 1e-6}
    cells = [[_prefixed(value) for value in values] for values in pair]
    meant = [np.array([float(c.rstrip("kmu")) * size.get(c[-1], 1.0) for c in column]) for column in cells]
    mark = draw.pick(",", "\t", ";")
    lines = [mark.join(("Field (Oe)", "Moment (emu)")), *(mark.join(row) for row in zip(*cells, strict=True))]
    return Layout("", {"meter.csv": packed(draw, lines)}, loops(Loop(meant[0], meant[1], "Oe", "emu")))


@kind("exponents without their letter")
def fortran(draw: Draw) -> Layout:
    """Fortran leaves the E out before three digits: in the few numbers that are that small, which are read as zeros."""
    n = 2 * draw.whole(80, 200)
    x = major_loop(n)
    y = saturating(draw, x, begin=1) * 1e-3
    y[np.abs(x) < 0.1] *= 1e-100
    u = Column("H", 800 * x, "A/m", ".4f")
    y = Column("M", y, "A/m", ".6E")
    short = [cell.replace("E-1", "-1") if len(cell.partition("E")[2]) > 3 else cell for cell in y.cells]
    lines = ["H [A/m]  M [A/m]", *(f"{a:>14}  {b:>14}" for a, b in zip(u.cells, short, strict=True))]
    return Layout("", {draw.pick("fort.10", "out.dat"): packed(draw, lines)}, loops(loop(u, y)))


_LATEX = {
    "um": "\\mathrm{\\mu m}", "A/m": "\\mathrm{A\\,m^{-1}}", "%": "\\%", "uC/cm2": "\\mathrm{\\mu C/cm^2}", "MPa": "\\mathrm{MPa}",
}  # fmt: skip


@kind("names for LaTeX")
def latex(draw: Draw) -> Layout:
    _, u, y = measured(draw, draw.whole(100, 400))
    symbols = {"Voltage": "V", "Displacement": "x", "Field": "H", "Moment": "m", "Force": "F", "Strain": "\\varepsilon",
               "Stress": "\\sigma", "H": "H", "B": "B", "Current": "I"}  # fmt: skip
    form = draw.pick("${name}$ ({unit})", "${name}$ [{unit}]", "${name}\\,(\\mathrm{{{unit}}})$", "{title} $({unit})$")
    mark = draw.pick(",", "\t", ";")
    names = [
        form.format(
            name=symbols[c.name], title=c.name, unit=f"${_LATEX[c.unit]}$" if c.unit in _LATEX else c.unit
        ).replace("$$", "")
        if form.startswith("${name}$")
        else form.format(name=symbols[c.name], title=c.name, unit=_LATEX.get(c.unit, c.unit))
        for c in (u, y)
    ]
    lines = [mark.join(names), *rows([u, y], Dialect(mark))]
    return Layout("", {draw.pick("fig3.csv", "figure_4a.txt"): packed(draw, lines, ("utf-8",))}, loops(loop(u, y)))


@kind("signals wrapped over lines")
def wrapped(draw: Draw) -> Layout:
    n, wide = draw.whole(100, 500), draw.pick(5, 6, 8)
    x = growing(n, draw.whole(2, 4))
    u = Column("DISPLACEMENT", 20 * x, "mm", "10.4f")
    y = Column("FORCE", 80 * draw.noise(rubbing(draw, x), 2e-3), "kN", "10.4f")
    lines = draw.pick([], ["Cyclic test of wall W3"])
    for column in (u, y):
        stated = draw.pick(f"NPTS= {n}, DT= 0.01 SEC", f"{n} points", f"{n} 0.01")
        lines += [f"{column.name} ({column.unit})", stated]
        lines += ["".join(column.cells[k : k + wide]) for k in range(0, n, wide)]
    return Layout("", {draw.pick("wall.txt", "W3.dat"): packed(draw, lines)}, loops(loop(u, y)))


@kind("console with the time of day")
def console(draw: Draw) -> Layout:
    _, u, y = measured(draw, draw.whole(100, 400))
    seconds = np.arange(len(u.cells)) * 0.1
    clock = [f"10:{20 + int(s) // 60:02d}:{int(s) % 60:02d}.{round(1000 * s) % 1000:03d}" for s in seconds]
    mark = draw.pick(",", "\t", ";", " ")
    lines = [f"{stamp} -> {row}" for stamp, row in zip(clock, rows([u, y], Dialect(mark)), strict=True)]
    if draw.chance(0.7):
        lines.insert(0, f"10:19:59.900 -> {u.name}{mark}{y.name}")
        truth = Loop(u.written, y.written, t=seconds)
        return Layout("", {"serial.txt": packed(draw, lines)}, loops(truth))
    truth = Loop(u.written, y.written, t=seconds)
    return Layout("", {"putty.log": packed(draw, lines)}, loops(truth), either_order=True)


@kind("text of an old Macintosh")
def macintosh(draw: Draw) -> Layout:
    t, u, y = measured(draw, draw.whole(100, 400))
    room = Column("Température", 23 + draw.rng.normal(0, 0.05, len(u.cells)), "degC", ".2f", "°C")
    columns = [dataclasses.replace(c, spelled="µm") if c.unit == "um" else c for c in (t, u, y)]
    lines = table(draw, [*columns, room], Dialect("\t"))
    return Layout("", {"loop.txt": ("\r".join(lines) + "\r").encode("mac_roman")}, loops(loop(u, y, t)))
