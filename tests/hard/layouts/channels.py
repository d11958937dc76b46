"""Channels of one instrument: bridges in turn, components of a lock-in amplifier, terminals, sensors, buffers and sections."""

from __future__ import annotations

import numpy as np

from .drawing import Draw
from .physics import lagging, major_loop, saturating
from .registry import kind
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, rows, table


@kind("bridges in turn")
def bridges(draw: Draw) -> Layout:
    """Resistances of several samples, one a row and empty cells for the others, over the temperature or the field."""
    n, count, heats = 2 * draw.whole(60, 200), draw.whole(2, 4), draw.chance(0.5)
    share = np.repeat(major_loop(n), count)[: n * count]
    kelvin = 320 + 45 * share if heats else 300 + draw.rng.normal(0, 0.01, share.size)
    field = draw.rng.normal(0, 0.01, share.size) if heats else draw.size(1000, 90000) * share
    turn = np.arange(share.size) % count
    h, t = Column("Magnetic Field (Oe)", field, "", ".4f", ""), Column("Temperature (K)", kelvin, "", ".4f", "")
    clock = Column("Time Stamp (sec)", 3.7e9 + np.cumsum(draw.rng.uniform(1.9, 2.2, share.size)), "", ".3f", "")
    what = draw.pick("Resistivity", "Resistance")
    measured = []
    for k in range(count):
        ohm = draw.noise(draw.size(1, 1e5) * (1 + 0.3 * saturating(draw, share, begin=1)), 1e-3)
        measured.append(Column(f"Bridge {k + 1} {what} (Ohm)", np.where(turn == k, ohm, np.nan), "", ".6E", ""))
    columns = [Column("Comment", np.full(share.size, ""), "", "", ""), clock, t, h, *measured]
    lines = ["[Header]", "TITLE,Resistivity", "BYAPP,Resistivity,2.0,1.0", "INFO,film A,SAMPLE1_COMMENT", "[Data]"]
    lines += table(draw, columns, Dialect(",", style="none"))
    own = turn == 0
    drive = t if heats else h
    u, y = (
        Column(one.name, one.values[own], unit, one.form)
        for one, unit in ((drive, "K" if heats else "Oe"), (measured[0], "Ohm"))
    )
    return Layout("", {draw.pick("film.dat", "RvsH.DAT"): packed(draw, lines, ("utf-8",))}, loops(loop(u, y)))


@kind("components of a lock-in amplifier")
def lock_in(draw: Draw) -> Layout:
    n = 2 * draw.whole(80, 300)
    field = draw.size(20, 5000) * major_loop(n)
    signal = saturating(draw, field / field.max(), begin=1)
    in_phase = draw.noise(draw.between(-3, 3) + signal, 4e-3)
    beside = draw.between(-3, 3) + draw.between(-0.1, 0.1) * signal + draw.rng.normal(0, 0.01, n)
    turned = draw.chance(0.2)
    unit = draw.pick("", "V", "mV")
    x, y = (
        Column(c, v, unit, ".6f")
        for c, v in zip("XY", (beside, in_phase) if turned else (in_phase, beside), strict=True)
    )
    h = Column(draw.pick("H", "Field", "Magnetic field"), draw.noise(field, 3e-4), "Oe", ".3f")
    phase = Column(draw.pick("DEG", "Phase"), np.degrees(np.arctan2(y.values, x.values)), "", ".4f")
    columns = [h, x, y, *([phase] if draw.chance(0.6) else [])]
    lines = table(draw, columns, Dialect(draw.pick("\t", ","), style=draw.pick("parentheses", "brackets")))
    return Layout(
        "", {draw.pick("kerr.txt", "moke_03.csv"): packed(draw, lines, ("utf-8",))}, loops(loop(h, y if turned else x))
    )


@kind("terminals of a transistor")
def transistor(draw: Draw) -> Layout:
    """Sweeps of the gate, there and back or once, named by the letters of the terminals."""
    n, back = 2 * draw.whole(30, 120), draw.chance(0.7)
    share = -major_loop(n) if back else np.linspace(-1, 1, n)
    gate = draw.size(1, 60) * draw.pick(1, -1) * share
    switched = np.exp(draw.between(2, 6) * saturating(draw, share, begin=-1))
    drain = draw.pick(1, -1) * draw.size(1e-9, 1e-4) * draw.noise(switched, 1e-4)
    leak = draw.rng.normal(0, 1e-12, n)
    names = draw.pick(
        ("VG", "VD", "ID", "IG"), ("V_G", "V_D", "I_D", "I_G"), ("Vgs", "Vds", "Ids", "Igs"), ("Vg", "Vd", "Id", "Ig")
    )
    named = draw.chance(0.5)
    volts, amperes = ("V", "A") if named else ("", "")
    g, d = Column(names[0], gate, volts, ".4f"), Column(names[2], drain, amperes, ".6E")
    bias = Column(names[1], np.full(n, draw.pick(-1.0, 0.05, 5.0)), volts, ".2f")
    i = Column(names[3], leak, amperes, ".4E")
    columns = [g, *([bias] if draw.chance(0.6) else []), d, *([i] if draw.chance(0.7) else [])]
    style = draw.pick("parentheses", "brackets") if named else "none"
    lines = table(draw, columns, Dialect(draw.pick(",", "\t"), style=style))
    return Layout("", {draw.pick("IdVg.csv", "device_3.txt"): packed(draw, lines, ("utf-8",))}, loops(loop(g, d)))


@kind("furnace with a setpoint")
def furnace(draw: Draw) -> Layout:
    """A resistance or a strain over the measured temperature, beside the one that was set and a second thermometer."""
    n = 2 * draw.whole(40, 150)
    share = -major_loop(n)
    kelvin = 330 + draw.between(20, 60) * share
    a = Column("Temp A", kelvin + draw.rng.normal(0, 0.03, n), "K", ".3f")
    b = Column("Temp B", 30 + 0.9 * kelvin + draw.rng.normal(0, 0.03, n), "K", ".3f")
    setpoint = Column("Setpoint", kelvin, "K", ".2f")
    out = draw.pick(("Res", "Ohm", 1e3), ("Strain", "%", 1.0))
    y = Column(out[0], draw.noise(out[2] * (2 + lagging(draw, share)), 1e-3), out[1], ".6f")
    clock = Column("time", 2.0 * np.arange(n), "s", ".1f")
    lines = table(draw, [clock, setpoint, a, b, y], Dialect("\t", style=draw.pick("parentheses", "brackets")))
    return Layout("", {draw.pick("vo2.txt", "run.lvm"): packed(draw, lines, ("utf-8",))}, loops(loop(a, y)))


@kind("buffer of a source-measure unit")
def buffer(draw: Draw) -> Layout:
    """Readings and sourced values, each before the column of its unit."""
    n = 2 * draw.whole(50, 150)
    volts = draw.size(0.5, 20) * major_loop(n)
    share = volts / volts.max()
    amperes = draw.size(1e-8, 1e-2) * draw.noise(share + 0.5 * saturating(draw, share, begin=1), 3e-4)
    v, i = Column("Value", volts, "", ".5f"), Column("Reading", amperes, "", ".6E")
    of_i, of_v = Column("Unit", np.full(n, "Amp DC")), Column("Unit", np.full(n, "Volt DC"))
    number = Column("Index", 1.0 + np.arange(n), "", ".0f")
    clock = Column("Relative Time", 0.11 * np.arange(n), "", ".4f")
    columns = [number, i, of_i, v, of_v, *([clock] if draw.chance(0.7) else [])]
    lines = table(draw, columns, Dialect(",", style="none"))
    u, y = (Column(one.name, one.values, unit, one.form) for one, unit in ((v, "V"), (i, "A")))
    return Layout("", {draw.pick("defbuffer1.csv", "sweep.csv"): packed(draw, lines, ("utf-8",))}, loops(loop(u, y)))


@kind("sections under words")
def sections(draw: Draw) -> Layout:
    """Loops of growing amplitude below each other, between lines that end one section and begin the next."""
    n, count = 2 * draw.whole(40, 120), draw.whole(2, 4)
    top = draw.size(500, 20000)
    h, m, lines = [], [], ["@@Columns", "@Column 0: Applied Field [Oe]", "@Column 1: Moment [emu]", "@@END Columns"]
    for k in range(count):
        share = major_loop(n) * (k + 1) / count
        h.append(Column("Applied Field", top * share, "Oe", ".4f"))
        m.append(Column("Moment", 1e-3 * draw.noise(saturating(draw, share, begin=1), 1e-3), "emu", ".6e"))
        lines += ["@@Data", f"New Section: Section {k}", *rows([h[-1], m[-1]], Dialect(" ")), "@@END Data."]
    truth = tuple(loop(field, moment) for field, moment in zip(h, m, strict=True))
    return Layout("", {draw.pick("film.VHD", "minor.txt"): packed(draw, lines, ("utf-8",))}, (truth,))
