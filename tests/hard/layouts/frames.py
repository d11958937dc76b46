"""Test frames: MTS, Instron, TA and Bose DMA, rheometers: displacement or strain that drives force or stress."""

from __future__ import annotations

import numpy as np

from .drawing import Draw
from .physics import growing, rubbing, sine, wave
from .registry import kind
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, rows, table, titles


def specimen(draw: Draw, n: int, cycles: int) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and force of amplitude about 1, shape (n,) each."""
    x = growing(n, cycles) if draw.chance(0.5) and cycles > 1 else wave(draw, n, cycles)
    return x, draw.noise(rubbing(draw, x, draw.rng.uniform(0.4, 0.8)), 2e-3)


@kind("MTS text export")
def mts(draw: Draw) -> Layout:
    cycles = draw.whole(1, 5)
    n = cycles * draw.whole(60, 200)
    x, f = specimen(draw, n, cycles)
    clock = Column(
        draw.pick("Running Time", "Time", "Elapsed Time"), np.arange(n) * draw.pick(0.01, 0.1, 0.5), "s", ".4f", "sec"
    )
    sizes = draw.pick(("mm", "kN", 20, 100), ("in", "kip", 2, 20), ("mm", "N", 5, 900), ("in", "lbf", 0.5, 2000))
    side = draw.pick("Axial ", "Axial ", "Lateral ", "")
    d = Column(f"{side}Displacement", sizes[2] * x, sizes[0], ".6f", sizes[0])
    p = Column(f"{side}{draw.pick('Force', 'Load')}", sizes[3] * f, sizes[1], ".6f", sizes[1])
    count = Column(f"{side}Count".strip(), np.floor(np.arange(n) / (n / cycles) * 2) / 2, "segments", ".1f", "segments")
    command = Column(f"{side}Displacement Command", sizes[2] * x, sizes[0], ".6f", sizes[0])
    columns = [clock, d, p]
    columns += [count] if draw.chance(0.5) else []
    columns = draw.pick(columns, [columns[0], columns[2], columns[1], *columns[3:]])
    columns += [command] if draw.chance(0.2) else []
    dialect = Dialect("\t", style="row", trailing=draw.chance(0.3))
    lines = [
        "MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A",
        "",
        f"Data Acquisition: Cyclic\t\t\tTime: {n / 10:.4f} sec\t3/2/2020 2:05:11 PM",
    ]
    lines += table(draw, columns, dialect)
    return Layout(
        "",
        {draw.pick("specimen.dat", "Specimen 3.txt", "daq_cyclic"): packed(draw, lines, ("utf-8", "cp1252"))},
        loops(loop(d, p, clock)),
    )


@kind("MTS blocks of cycles")
def mts_blocks(draw: Draw) -> Layout:
    cycles = draw.whole(2, 6)
    each = draw.whole(50, 150)
    n = cycles * each
    x, f = specimen(draw, n, cycles)
    clock = Column("Running Time", np.arange(n) * draw.pick(0.01, 0.1), "s", ".4f", "Sec")
    d, p = Column("Axial Displacement", 12 * x, "mm", ".6f", "mm"), Column("Axial Force", 50 * f, "kN", ".6f", "kN")
    lines, dialect = ["MTS793|BTW|ENU|1|2|.|/|:|1|0|0|A"], Dialect("\t", style="row")
    for k in range(cycles):
        part = slice(k * each, (k + 1) * each)
        block = [Column(c.name, c.values[part], c.unit, c.form, c.spelled) for c in (clock, d, p)]
        lines += [
            "",
            f"Data Acquisition: Timed\tStored at: {k + 1} cycle\tPoints: {each}",
            *titles(block, dialect),
            *rows(block, dialect),
        ]
    parts = [np.arange(k * each, (k + 1) * each) for k in range(cycles)]
    # Time goes on from block to block: one record, or one for each block.
    truths = loops(loop(d, p, clock), [loop(d, p, clock, rows=part) for part in parts])
    return Layout("", {draw.pick("blocks.dat", "specimen"): packed(draw, lines, ("utf-8", "cp1252"))}, truths)


@kind("Instron CSV")
def instron(draw: Draw) -> Layout:
    cycles = draw.whole(1, 4)
    n = cycles * draw.whole(80, 200)
    x, f = specimen(draw, n, cycles)
    clock = Column("Time", np.arange(n) * 0.1, "s", ".4f", "s")
    stroke, load = draw.pick(("mm", "N"), ("mm", "kN"), ("in", "lbf"))
    d = Column(draw.pick("Extension", "Displacement", "Compressive extension"), 10 * x, stroke, ".5f", stroke)
    p = Column(draw.pick("Load", "Force", "Compressive load"), 300 * f, load, ".5f", load)
    strain = Column("Tensile strain", 10 * x / 50, "%", ".5f", "%")
    stress = Column("Tensile stress", 3 * f, "MPa", ".5f", "MPa")
    columns, truths = [clock, d, p], loops(loop(d, p, clock))
    if draw.chance(0.3):
        columns = [clock, d, p, strain, stress]
        truths = loops(loop(d, p, clock), loop(strain, stress, clock))
    cycle = Column("Total Cycle Count", 1 + np.floor(np.arange(n) / (n / cycles)), "", ".0f")
    columns += [cycle] if draw.chance(0.4) else []
    comma = draw.chance(0.25)
    dialect = Dialect(
        ";" if comma else ",",
        "," if comma else ".",
        draw.pick("row in parentheses", "parentheses"),
        quoted=draw.chance(0.5),
    )
    above = ['"Test type","Cyclic"', '"Specimen label","S3"', '"Width","12.5","mm"', ""][: draw.pick(0, 4)]
    lines = [line.replace(",", dialect.delimiter) for line in above] + table(draw, columns, dialect)
    files = {draw.pick("Specimen_RawData_1.csv", "is_cyclic.csv"): packed(draw, lines)}
    return Layout("", files, truths, may_ask=len(truths) > 1)


@kind("DMA of TA and Bose")
def dma(draw: Draw) -> Layout:
    n = draw.whole(200, 800)
    x = sine(n, draw.whole(2, 6))
    f = draw.noise(rubbing(draw, x, 0.5), 2e-3)
    clock = Column(
        draw.pick("Elapsed Time", "Time", "Time on test"),
        np.arange(n) * 0.005,
        "s",
        ".5f",
        draw.pick("Sec", "s", "sec"),
    )
    d, p = Column("Disp", 0.5 * x, "mm", ".6f", "mm"), Column("Load", 8 * f, "N", ".6f", "N")
    scan = Column(draw.pick("Scan", "Points"), 1.0 + np.arange(n), "", ".0f", draw.pick("", "#"))
    columns = [scan, clock, d, p] if draw.chance(0.6) else [clock, p, d]
    dialect = Dialect(draw.pick(",", "\t"), style=draw.pick("row", "parentheses", "row in parentheses"))
    above = ["ElectroForce WinTest", "Test Date: 3/2/2020", ""][: draw.pick(0, 3)]
    return Layout(
        "",
        {draw.pick("TIMED1.CSV", "dma_sweep.txt"): packed(draw, above + table(draw, columns, dialect))},
        loops(loop(d, p, clock)),
    )


@kind("rheometer LAOS")
def laos(draw: Draw) -> Layout:
    n, cycles = draw.whole(128, 512), draw.whole(1, 3)
    x = sine(n, cycles)
    stress = draw.noise(rubbing(draw, x, 0.7), 2e-3)
    size = draw.size(1, 500)
    rate = np.gradient(x, 2 * np.pi * cycles / n) * size / 100
    t = Column("Time", np.arange(n) * 0.01, "s", ".4f", "s")
    g = Column(draw.pick("Shear Strain", "Strain", "Raw strain"), size * x, "%", ".5g", "%")
    s = Column(draw.pick("Shear Stress", "Stress"), draw.size(1, 900) * stress, "Pa", ".5g", "Pa")
    r = Column("Shear Rate", rate, "1/s", ".5g", "1/s")
    point = Column(draw.pick("Point No.", "Meas. Pts."), 1.0 + np.arange(n), "", ".0f", "")
    columns = [t, *draw.shuffled([g, s, r])]
    columns = [point, *columns] if draw.chance(0.5) else columns
    dialect = Dialect(draw.pick("\t", ";", ","), style=draw.pick("row in brackets", "row", "brackets"))
    above = ["Test:;LAOS 1 rad/s", "Sample:;gel 2 %", ""] if draw.chance(0.5) else []
    return Layout(
        "",
        {draw.pick("laos_100.csv", "LAOS.txt"): packed(draw, above + table(draw, columns, dialect))},
        loops(loop(g, s, t)),
    )
