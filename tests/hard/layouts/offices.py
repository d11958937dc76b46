"""Tables with much beside the loop: test software of Zwick and HBM, and bench tables with dates, counters, flags and set values."""

from __future__ import annotations

import numpy as np

from .documents import measured
from .drawing import Draw
from .physics import rubbing, wave
from .registry import kind
from .slow import any_dialect, stamps
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, table


@kind("bench table with dates, counters and flags")
def bench(draw: Draw) -> Layout:
    n = draw.whole(150, 700)
    t, u, y = measured(draw, n)
    before = [
        Column("Date", stamps(draw, n, 1.0)),
        Column(draw.pick("No", "Index", "Sample"), 1.0 + np.arange(n), "", ".0f"),
        t,
    ]
    beside = [
        Column("Setpoint temperature", np.full(n, 25.0), "degC", ".1f", "degC"),
        Column("Room temperature", 25 + draw.rng.normal(0, 0.1, n), "degC", ".2f", "degC"),
        Column("Status", np.zeros(n), "", ".0f"),
        Column("Flag", draw.pick(np.full(n, "ok"), np.full(n, "A"))),
        Column("Cycle", 1 + np.floor(np.arange(n) * 3 / n), "", ".0f"),
        Column("Humidity", 40 + np.linspace(0, 1, n), "", ".2f", "%RH"),
        Column("Gain", np.full(n, 10.0), "", ".1f"),
    ]
    chosen = [c for c in before if draw.chance(0.5)]
    others = [c for c in beside if draw.chance(0.35)]
    pair = [u, y] if draw.chance(0.7) else [y, u]
    columns = [*chosen, *pair, *others] if draw.chance(0.6) else [*chosen, *others, *pair]
    clock = t if t in chosen and before[0] not in chosen else None
    lines = table(draw, columns, any_dialect(draw))
    return Layout("", {draw.pick("bench.csv", "log 12.txt", "run3"): packed(draw, lines)}, loops(loop(u, y, clock)))


@kind("raw beside corrected columns")
def corrected(draw: Draw) -> Layout:
    t, u, y = measured(draw, draw.whole(150, 600))
    word = draw.pick("corrected", "adjusted")
    slope = 0.2 * np.ptp(y.values) * u.values / np.ptp(u.values)
    fixed = Column(
        draw.pick(f"{y.name} {word}", f"{word.capitalize()} {y.name}", f"{y.name}_{word}"),
        y.values + slope,
        y.unit,
        y.form,
    )
    columns = [*([t] if draw.chance(0.5) else []), u, *draw.pick([y, fixed], [fixed, y])]
    lines = table(draw, columns, Dialect(draw.pick(",", "\t", ";"), style=draw.pick("parentheses", "brackets", "row")))
    # Raw by default; what the owner corrected is as good where the reader says that there are both.
    return Layout(
        "",
        {draw.pick("corrected.csv", "vsm loop.txt"): packed(draw, lines)},
        loops(loop(u, y), loop(u, fixed)),
        may_ask=True,
    )


def _machine(draw: Draw) -> tuple[Column, Column, Column]:
    """Time, displacement and force of a machine."""
    cycles = draw.whole(1, 5)
    n = cycles * draw.whole(60, 200)
    x = wave(draw, n, cycles)
    f = draw.noise(rubbing(draw, x), 2e-3)
    return (
        Column("Zeit", np.arange(n) * 0.02, "s", ".4f", "s"),
        Column("Weg", 8 * x, "mm", ".6f", "mm"),
        Column("Kraft", 450 * f, "N", ".5f", "N"),
    )


@kind("Zwick testXpert")
def zwick(draw: Draw) -> Layout:
    t, d, p = _machine(draw)
    names = draw.pick(
        ("Prüfzeit", "Standardweg", "Standardkraft"),
        ("Zeit", "Traversenweg", "Kraft"),
        ("Test time", "Standard travel", "Standard force"),
    )
    t, d, p = (c.renamed(name) for c, name in zip((t, d, p), names, strict=True))
    columns = draw.pick([t, d, p], [t, p, d], [d, p])
    above = ['"Prüfergebnis";"Probe 3"', '"Vorkraft";0,5;"N"', ""][: draw.pick(0, 3)]
    quoted = draw.chance(0.5)
    lines = above + table(draw, columns, Dialect(";", ",", draw.pick("row", "parentheses"), quoted=quoted))
    clock = t if t in columns else None
    return Layout(
        "",
        {draw.pick("Probe3.TRA", "zwick.csv"): packed(draw, lines, ("cp1252", "utf-8-sig"))},
        loops(loop(d, p, clock)),
    )


@kind("HBM catman text")
def catman(draw: Draw) -> Layout:
    t, d, p = _machine(draw)
    t = t.renamed(draw.pick("Zeit  1 - Standardmessrate", "Time  1 - default sample rate"))
    d, p = (
        d.renamed(draw.pick("Weg_WA50", "Weg MX840_CH 1", "Displacement CH 1")),
        p.renamed(draw.pick("Kraft U9C", "Kraft MX840_CH 2", "Force CH 2")),
    )
    columns = [t, d, p] if draw.chance(0.5) else [t, p, d]
    above = ["HBM_CATMAN_DATAFILE_40", f"DATASETS\t{len(d.values)}", "CHANNELS\t3", "T0\t02.03.2020 14:05:11"][
        : draw.pick(0, 4)
    ]
    lines = above + table(draw, columns, Dialect("\t", draw.pick(".", ","), draw.pick("brackets", "row")))
    return Layout(
        "",
        {draw.pick("catman.ASC", "Job3_2020_03_02.txt"): packed(draw, lines, ("cp1252", "utf-8"))},
        loops(loop(d, p, t)),
    )


@kind("one branch only")
def one_branch(draw: Draw) -> Layout:
    _, u, y = measured(draw, draw.whole(300, 900))
    low, high = sorted((int(np.argmin(u.values)), int(np.argmax(u.values))))
    part = slice(low, high + 1)
    u, y = (Column(c.name, c.values[part], c.unit, c.form) for c in (u, y))
    lines = table(draw, [u, y], any_dialect(draw))
    return Layout("", {draw.pick("branch.csv", "descending.txt"): packed(draw, lines)}, loops(loop(u, y)))
