"""Structures and dampers: walls, shake tables, fasteners, shock absorbers and magnetorheological dampers."""

from __future__ import annotations

import datetime
import json

import numpy as np

from .drawing import Draw
from .physics import damping, growing, pinched, rubbing, sine
from .registry import kind
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, table


@kind("structural wall")
def wall(draw: Draw) -> Layout:
    cycles = draw.whole(4, 9)
    n = cycles * draw.whole(40, 120)
    x = growing(n, cycles, 0.1)
    f = draw.noise(pinched(draw, x), 2e-3)
    length, force, reach, size = draw.pick(("in", "kip", 3, 40), ("mm", "kN", 80, 250), ("in", "lbf", 4, 9000))
    main = draw.pick("Actuator Displacement", "Top Displacement", "Actuator Disp", "Lateral Displacement")
    top = Column(main, draw.noise(reach * x, 2e-4), length, ".5f", length)
    load = Column(
        draw.pick("Actuator Load", "Load", "Lateral Load", "Base Shear", "Actuator Force"),
        size * f,
        force,
        ".5f",
        force,
    )
    drift = Column("Drift", reach * x / (96 if length == "in" else 2400) * 100, "%", ".5f", "%")
    lvdts = [
        Column(
            f"LVDT{k + 1}",
            draw.noise(reach * draw.rng.uniform(0.02, 0.2) * np.abs(f) * draw.pick(1, -1), 5e-3),
            length,
            ".5f",
            length,
        )
        for k in range(draw.whole(0, 6))
    ]
    scan = Column(draw.pick("Scan", "Scan No.", "Point"), 1.0 + np.arange(n), "", ".0f")
    clock = Column("Time", np.arange(n) * 0.5, "s", ".2f", "sec")
    with_drift = [drift] if draw.chance(0.4) else []
    columns = [
        *draw.pick([scan, clock], [clock], [scan], []),
        *draw.pick([top, load], [load, top]),
        *with_drift,
        *lvdts,
    ]
    truths = loops(loop(top, load), *(loop(drift, load) for _ in with_drift))
    dialect = Dialect(
        draw.pick(",", "\t"), style=draw.pick("parentheses", "row", "tight", "brackets", "row in parentheses")
    )
    above = ["Wall W3, protocol CUREE", "Vertical load: 20 kip", ""][: draw.pick(0, 0, 3)]
    return Layout(
        "",
        {draw.pick("W3.csv", "wall 2.txt", "PFM-1.dat"): packed(draw, above + table(draw, columns, dialect))},
        truths,
    )


@kind("shake-table damper")
def shake_table(draw: Draw) -> Layout:
    n = draw.whole(300, 1200)
    steps = draw.rng.normal(0, 1, n + 60)
    x = np.convolve(steps, np.hanning(41) * np.cos(np.arange(41) / 4), "same")[30 : 30 + n]
    x = x * np.sin(np.pi * np.arange(n) / n) ** 0.5 / np.abs(x).max()
    rate = np.gradient(x)
    f = draw.noise(damping(x, rate / np.abs(rate).max(), draw) if draw.chance(0.5) else rubbing(draw, x), 2e-3)
    t = Column("Time", np.arange(n) / draw.pick(100, 200, 256), "s", ".5f")
    d = Column(draw.pick("Damper Disp", "Damper displacement", "Relative displacement"), 40 * x, "mm", ".5f")
    p = Column(draw.pick("Damper Force", "Load cell", "Damper force"), 30 * f, "kN", ".5f")
    a = Column(
        draw.pick("Table Acc", "Table acceleration", "Floor 1 accel"), draw.rng.normal(0, 0.2, n), "g", ".6f", "g"
    )
    columns = [t, *draw.shuffled([d, p, a])] if draw.chance(0.6) else [t, d, p]
    style = draw.pick("parentheses", "brackets", "row", "underscore")
    lines = table(draw, columns, Dialect(draw.pick(",", "\t"), style=style))
    return Layout("", {draw.pick("ElCentro_100.csv", "run12.txt"): packed(draw, lines)}, loops(loop(d, p, t)))


@kind("fastener in JSON")
def fastener(draw: Draw) -> Layout:
    cycles = draw.whole(4, 10)
    n = cycles * draw.whole(40, 120)
    x = growing(n, cycles, 0.1)
    d = Column("displacement", 0.6 * x, "in", ".6g")
    p = Column("force", draw.noise(900 * pinched(draw, x), 2e-3), "lbf", ".6g")
    units = draw.pick(["inches", "lbf"], ["in", "lbf"])
    source = [{"authors": ["Peterman, K.D."], "date": "2014-10-01", "units": units, "notes": "Zeroed data."}]
    parts = {"source": source, "specimen": {"name": "c33g12_1", "screw": "#8", "ply": [0.033, 0.4375]}}
    content = parts | {"test": {"displacement": d.written.tolist(), "force": p.written.tolist()}}
    if draw.chance(0.4):
        content = {"test": content["test"], **parts}
    text = json.dumps(content, indent=draw.pick(None, 4, 1))
    return Layout("", {draw.pick("c33g12_1.json", "fastener.json", "test_8"): text.encode()}, loops(loop(d, p)))


@kind("shock absorber with sensor volts")
def shock_absorber(draw: Draw) -> Layout:
    n, cycles = draw.whole(300, 1000), draw.whole(3, 10)
    x = sine(n, cycles)
    f = draw.noise(damping(x, sine(n, cycles, 0.25), draw), 3e-3)
    step = datetime.timedelta(seconds=draw.pick(0.001, 0.0033, 0.01))
    begin = datetime.datetime(2025, 11, 14, 19, 15, 18, 706515)
    stamp = Column("Timestamp", np.array([str(begin + k * step) for k in range(n)]))
    d, p = draw.noise(12 * x, 1e-3), 400 * f
    mm, newton = Column("Displacement", d, "mm", ".9g", "mm"), Column("Force", p, "N", ".9g", "N")
    pairs = [
        [Column("Force", p / 200, "V", ".9g", "V"), newton],
        [Column("Displacement", d / 10 + 1, "V", ".9g", "V"), mm],
    ]
    warm = 24 + np.linspace(0, 2, n) + draw.rng.normal(0, 0.3, n)
    third = [Column("Temperature", warm / 25, "V", ".9g", "V"), Column("Temperature", warm, "degC", ".9g", "C")]
    pairs = draw.shuffled(pairs) + ([third] if draw.chance(0.7) else [])
    columns = [stamp, *(column for pair in pairs for column in pair)]
    lines = table(draw, columns, Dialect(",", style="parentheses"))
    return Layout(
        "", {draw.pick("damper_s5_50psi.csv", "run.csv"): packed(draw, lines, ("utf-8",))}, loops(loop(mm, newton))
    )


@kind("MR damper at a current")
def mr_damper(draw: Draw) -> Layout:
    n, cycles = draw.whole(300, 900), draw.whole(2, 6)
    x, v = sine(n, cycles), sine(n, cycles, 0.25)
    t = Column("Time", np.arange(n) * 0.002, "s", ".4f")
    d = Column(draw.pick("Displacement", "Disp", "Stroke"), draw.noise(10 * x, 5e-4), "mm", ".5f")
    rate = Column("Velocity", 100 * v, "mm/s", ".4f")
    p = Column("Force", draw.noise(800 * damping(x, v, draw), 3e-3), "N", ".4f")
    level = draw.pick(0.0, 0.5, 1.0, 2.0)
    amps = Column("Current", level + draw.pick(0.0, 0.003) * draw.rng.normal(0, 1, n), "A", ".4f")
    others = [column for column in (rate, amps) if draw.chance(0.7)]
    columns = [t, *draw.shuffled([d, p, *others])]
    truths = loops(loop(d, p, t), *(loop(rate, p, t) for column in others if column is rate))
    style = draw.pick("parentheses", "brackets", "row", "slash", "underscore", "comma")
    lines = table(draw, columns, Dialect("\t" if style == "comma" else draw.pick(",", "\t", ";"), style=style))
    return Layout("", {draw.pick("MR_1A_2Hz.csv", "damper.txt"): packed(draw, lines)}, truths)


@kind("damper under single letters")
def letters(draw: Draw) -> Layout:
    """Displacement, velocity and force as D, V and F without units, maybe with the acceleration and a constant in the first row."""
    n = draw.whole(600, 2000)
    x = growing(n, draw.whole(3, 6))
    v = np.gradient(x) / 0.001
    t, d = Column("t", 0.001 * np.arange(n), "", ".6f"), Column("D", x, "", ".6g")
    rate, force = (
        Column("V", draw.noise(v, 1e-3), "", ".6g"),
        Column("F", 1000 * damping(x, v / np.abs(v).max(), draw), "", ".4f"),
    )
    accelerations = Column("A", draw.noise(np.gradient(v) / 0.001, 1e-2), "", ".5g")
    columns = [t, *([accelerations] if draw.chance(0.5) else []), *draw.pick([d, rate], [rate, d]), force]
    dialect = Dialect(",", quoted=draw.chance(0.5), trailing=draw.chance(0.5))
    return Layout(
        "",
        {draw.pick("ranran_50.csv", "mr.csv"): packed(draw, table(draw, columns, dialect))},
        loops(loop(d, force, t)),
    )
