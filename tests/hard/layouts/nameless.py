"""Files without names: two columns, and loggers of more channels, whose owner has to be asked."""

from __future__ import annotations

import numpy as np

from .drawing import Draw
from .physics import lagging, rubbing, saturating, wave
from .registry import kind
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, rows, table


@kind("two columns without names")
def two_columns(draw: Draw) -> Layout:
    n = draw.whole(150, 600)
    u = draw.pick(1.0, 10.0, 150.0, 2000.0) * wave(draw, n, draw.whole(1, 4)) + draw.pick(0, 0, 1)
    top = np.abs(u).max()
    device = draw.pick(lagging, saturating, rubbing)
    y = draw.noise(draw.size(0.01, 1000) * device(draw, u / top), 1e-3)
    a, b = Column("a", u, "", draw.pick(".6g", ".5f", ".4e")), Column("b", y, "", ".5e")
    marks = draw.pick((",", "."), ("\t", "."), (" ", "."), (";", ","), (";", "."), ("   ", "."))
    lines = draw.pick([], ["% loop"], ["# exported 2020-03-02"]) + rows([a, b], Dialect(*marks))
    return Layout(
        "",
        {draw.pick("loop.txt", "data.dat", "xy", "curve.csv"): packed(draw, lines, ("utf-8",))},
        loops(loop(a, b)),
        either_order=True,
    )


def _channels(draw: Draw, n: int) -> list[Column]:
    """Three analog channels that may each be anything."""
    u = wave(draw, n, draw.whole(2, 5))
    one, two = draw.noise(u, 2e-3), draw.noise(lagging(draw, u), 2e-3)
    three = draw.noise(rubbing(draw, u), 2e-3)
    sizes = [draw.size(0.2, 9) for _ in range(3)]
    return [
        Column("", size * values, "", ".4f")
        for size, values in zip(sizes, draw.shuffled([one, two, three]), strict=True)
    ]


@kind("logger of three unnamed channels")
def unnamed_logger(draw: Draw) -> Layout:
    n = draw.whole(200, 800)
    names = draw.pick(["CHANNEL{}"] * 3, ["CH{}"] * 3, ["AI{}"] * 3, ["Channel {}"] * 3)
    channels = [c.renamed(name.format(k)) for k, (c, name) in enumerate(zip(_channels(draw, n), names, strict=True))]
    number = Column("Sample Number", 1.0 + np.arange(n), "", ".0f")
    columns = [number, *channels] if draw.chance(0.5) else channels
    above = ["Header Size:  7", "Version:  2", "Sampling Rate:  1000", f"Sample Count:  {n}"][: draw.pick(0, 4)]
    lines = above + table(draw, columns, Dialect(draw.pick(", ", ",", "\t"), style="none"))
    answer = {"input": channels[0].name, "output": channels[1].name}
    return Layout(
        "",
        {draw.pick("daq.txt", "log001.csv"): packed(draw, lines)},
        loops(loop(channels[0], channels[1])),
        ask=True,
        answer=answer,
    )
