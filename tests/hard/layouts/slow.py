"""Slow processes: sorption, soil suction, heated alloys, muscles, patches, thermostats, and data loggers that name their channels."""

from __future__ import annotations

import datetime

import numpy as np

from .drawing import Draw
from .physics import growing, lagging, saturating, triangle, wave
from .registry import kind
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, table


def any_dialect(draw: Draw) -> Dialect:
    """A dialect of people."""
    style = draw.pick("parentheses", "brackets", "row", "row in brackets", "slash", "comma", "in")
    mark, decimal = draw.pick((",", "."), ("\t", "."), (";", "."), (";", ","), ("\t", ","))
    return Dialect("\t" if style == "comma" else mark, "." if style == "comma" else decimal, style)


def stamps(draw: Draw, n: int, seconds: float) -> np.ndarray:
    """Date and clock of each row as text."""
    begin = datetime.datetime(2021, draw.whole(1, 12), draw.whole(1, 28), 9, 30)
    form = draw.pick("%Y-%m-%d %H:%M:%S", "%d.%m.%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S")
    return np.array([format(begin + datetime.timedelta(seconds=k * seconds), form) for k in range(n)])


@kind("gas sorption isotherm")
def sorption(draw: Draw) -> Layout:
    half = draw.whole(40, 90)
    p = (1 + 0.99 * triangle(2 * half, 1, 0.75)) / 2
    q = draw.size(50, 600) * (0.3 * p**0.2 + 0.5 * (1 + np.tanh((lagging(draw, 2 * p - 1, 0.6)) * 3)) / 2)
    x = Column(draw.pick("Relative Pressure (p/p°)", "p/p0", "Relative Pressure (P/Po)", "P/P0"), p, "", ".6f")
    y = Column(
        draw.pick("Quantity Adsorbed", "Volume Adsorbed", "V ads"),
        draw.noise(q, 5e-4),
        "",
        ".4f",
        draw.pick("cm³/g STP", "cm3/g", "cc/g"),
    )
    absolute = Column("Absolute Pressure", 760 * p, "", ".4f", "mmHg")
    branch = Column("Branch", np.repeat(["adsorption", "desorption"], half)[: 2 * half])
    columns = [*([absolute] if draw.chance(0.3) else []), x, y, *([branch] if draw.chance(0.5) else [])]
    above = ["Sample: SBA-15", "Analysis adsorptive: N2", "Bath temperature: 77.3 K"][: draw.pick(0, 3)]
    lines = above + table(
        draw, columns, Dialect(draw.pick(",", "\t", ";"), style=draw.pick("parentheses", "parentheses", "row"))
    )
    return Layout(
        "", {draw.pick("isotherm.csv", "SBA15_N2.txt"): packed(draw, lines)}, loops(loop(x, y), loop(absolute, y))
    )


@kind("soil suction")
def suction(draw: Draw) -> Layout:
    cycles = draw.whole(1, 3)
    n = cycles * 2 * draw.whole(40, 80)
    state = growing(n, cycles, 0.5) if cycles > 1 else triangle(n, 1, 0.75)
    s = draw.size(20, 900) * (1.01 + state) / 2
    w = 0.42 - 0.25 * (1 + np.tanh(1.5 * lagging(draw, state, 0.6))) / 2
    u = Column(draw.pick("Suction", "Matric suction", "Capillary pressure"), s, "kPa", ".4f", "kPa")
    y = Column(
        draw.pick("Volumetric water content", "Water content", "VWC"),
        draw.noise(w, 1e-3),
        "",
        ".5f",
        draw.pick("m3/m3", "-", ""),
    )
    branch = Column("Path", np.where(np.gradient(s) > 0, "drying", "wetting"))
    when = Column("Date", stamps(draw, n, 600.0))
    columns = [*([when] if draw.chance(0.4) else []), u, y, *([branch] if draw.chance(0.4) else [])]
    lines = table(draw, columns, Dialect(draw.pick(",", ";", "\t"), style=draw.pick("parentheses", "brackets", "row")))
    return Layout("", {draw.pick("swrc.csv", "retention curve.txt"): packed(draw, lines)}, loops(loop(u, y)))


@kind("shape memory alloy over temperature")
def shape_memory(draw: Draw) -> Layout:
    n = 2 * draw.whole(80, 300)
    state = triangle(n, draw.whole(1, 3), 0.75)
    heat = Column(
        draw.pick("Temperature", "Temp", "T sample"),
        draw.noise(60 + 45 * state, 5e-4),
        "degC",
        ".3f",
        draw.pick("°C", "degC", "C"),
    )
    strain = Column(draw.pick("Strain", "Strain"), draw.noise(2.5 - 2 * saturating(draw, state), 1e-3), "%", ".5f", "%")
    if draw.chance(0.3):
        strain = Column("Displacement", strain.values, "mm", ".5f", "mm")
    stress = Column("Stress", draw.pick(50.0, 150.0) + draw.rng.normal(0, 0.05, n), "MPa", ".3f", "MPa")
    t = Column("Time", np.arange(n) * 0.5, "s", ".2f", "s")
    columns = [*([t] if draw.chance(0.6) else []), heat, *([stress] if draw.chance(0.5) else []), strain]
    style = draw.pick("parentheses", "brackets", "row")
    lines = table(draw, columns, Dialect(draw.pick(",", "\t", ";"), style=style))
    return Layout(
        "",
        {draw.pick("NiTi_150MPa.csv", "dsc wire.txt"): packed(draw, lines, ("utf-8", "cp1252"))},
        loops(loop(heat, strain)),
    )


@kind("pneumatic muscle")
def muscle(draw: Draw) -> Layout:
    cycles = draw.whole(1, 4)
    n = cycles * draw.whole(80, 250)
    state = wave(draw, n, cycles, 0.75)
    t = Column("Time", np.arange(n) * 0.02, "s", ".3f")
    unit, size = draw.pick(("bar", 6), ("kPa", 600), ("psi", 90), ("MPa", 0.6))
    p = Column(draw.pick("Pressure", "Muscle pressure"), draw.noise(size * (1 + state) / 2, 5e-4), unit, ".5f")
    x = Column(
        draw.pick("Contraction", "Displacement", "Length"),
        draw.noise(15 * lagging(draw, state) + 150, 1e-3),
        "mm",
        ".4f",
    )
    load = Column("Load", 50 + draw.rng.normal(0, 0.2, n), "N", ".3f")
    columns = [*([t] if draw.chance(0.7) else []), p, x, *([load] if draw.chance(0.3) else [])]
    columns = columns if draw.chance(0.7) else [*columns[:-2], columns[-1], columns[-2]]
    clock = t if t in columns else None
    return Layout(
        "",
        {draw.pick("muscle_50N.csv", "DMSP.txt"): packed(draw, table(draw, columns, any_dialect(draw)))},
        loops(loop(p, x, clock)),
    )


@kind("strain of a piezo patch")
def patch(draw: Draw) -> Layout:
    cycles = draw.whole(1, 4)
    n = cycles * draw.whole(80, 250)
    state = wave(draw, n, cycles)
    t = Column("Time", np.arange(n) * 0.01, "s", ".3f")
    v = Column(draw.pick("MFC Voltage", "Voltage", "Applied voltage"), 500 + 1000 * state, "V", ".2f")
    e = Column(
        draw.pick("Strain", "Strain gage 1", "SG1 strain"),
        draw.noise(450 * lagging(draw, state), 2e-3),
        "ustrain",
        ".3f",
        draw.pick("microstrain", "µstrain", "ustrain"),
    )
    gage = Column("Strain gage 2", draw.noise(-0.3 * e.values, 2e-3), "ustrain", ".3f", e.spelled)
    columns = [t, v, e, *([gage] if draw.chance(0.3) and "1" in e.name else [])]
    dialect = Dialect(draw.pick(",", "\t", ";"), style=draw.pick("parentheses", "brackets", "row"))
    return Layout(
        "", {draw.pick("mfc.csv", "P1 patch.txt"): packed(draw, table(draw, columns, dialect))}, loops(loop(v, e, t))
    )


@kind("thermostat and relay")
def relay(draw: Draw) -> Layout:
    n = draw.whole(200, 900)
    state = triangle(n, draw.whole(2, 6)) + 0.02 * draw.rng.normal(0, 1, n)
    on, closed = [], False
    for value in state:
        closed = value > 0.4 or (closed and value > -0.3)
        on.append(float(closed))
    t = Column("Time", np.arange(n) * 1.0, "s", ".1f")
    drive = draw.pick(("Coil voltage", "V", 8, 6), ("Temperature", "degC", 25, 10), ("Pressure", "kPa", 300, 100))
    u = Column(drive[0], drive[2] + drive[3] * state, drive[1], ".4f")
    y = Column(draw.pick("Contact state", "Relay state", "Switch output", "Relay"), np.array(on), "", ".0f")
    dialect = Dialect(draw.pick(",", "\t", ";"), style=draw.pick("parentheses", "brackets"))
    return Layout(
        "",
        {draw.pick("relay.csv", "thermostat log.txt"): packed(draw, table(draw, [t, u, y], dialect))},
        loops(loop(u, y)),
        may_ask=True,
    )


@kind("Campbell TOA5 logger")
def toa5(draw: Draw) -> Layout:
    cycles = draw.whole(1, 4)
    n = cycles * draw.whole(60, 200)
    state = wave(draw, n, cycles, 0.75)
    begin = datetime.datetime(2021, 5, 4, 9, 30)
    stamp = Column(
        "TIMESTAMP", np.array([f'"{begin + datetime.timedelta(seconds=10 * k)}"' for k in range(n)]), "", "", "TS"
    )
    pairs = draw.pick(
        ("Pressure", "kPa", "Strain", "ustrain", "microstrain"),
        ("Load", "kN", "Settlement", "mm", "mm"),
        ("Voltage", "V", "Displacement", "mm", "mm"),
    )
    u = Column(f"{pairs[0]}_Avg", 100 * (1 + state), pairs[1], ".6g", pairs[1])
    y = Column(f"{pairs[2]}_Avg", draw.noise(40 * lagging(draw, state), 1e-3), pairs[3], ".6g", pairs[4])
    record = Column("RECORD", 0.0 + np.arange(n), "", ".0f", "RN")
    battery = Column("BattV_Min", 12.6 + draw.rng.normal(0, 0.01, n), "V", ".4g", "Volts")
    columns = [stamp, record, *([battery] if draw.chance(0.4) else []), u, y]
    kinds = ['""', '""', *(['"Min"'] if battery in columns else []), '"Avg"', '"Avg"']
    lines = table(draw, columns, Dialect(",", style="row", quoted=True))
    lines = [
        '"TOA5","CR1000","CR1000","12345","CR1000.Std.32","CPU:test.CR1","45123","Table1"',
        *lines[:2],
        ",".join(kinds),
        *lines[2:],
    ]
    truths = loops(loop(u, y)) if pairs[0] != "Load" else loops(loop(u, y), loop(y, u))
    return Layout("", {draw.pick("CR1000_Table1.dat", "TOA5_Table1.dat"): packed(draw, lines, ("utf-8",))}, truths)
