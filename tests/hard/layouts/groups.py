"""Specimens side by side in groups of columns, commands beside measurements, marked headers, times that run back or start again."""

from __future__ import annotations

import dataclasses
import datetime

import numpy as np

from .drawing import Draw
from .physics import growing, lagging, rubbing, sine
from .registry import kind
from .truth import Layout, Loop, loops
from .writing import Column, Dialect, loop, packed, rows, table, titles


def _specimen(draw: Draw, n: int) -> tuple[Column, Column, Column]:
    x = growing(n, draw.whole(2, 4))
    clock = Column("Time", np.arange(n) * 0.05, "s", ".2f")
    return (
        clock,
        Column("Disp", 20 * x, "mm", ".5f"),
        Column("Force", 60 * draw.noise(rubbing(draw, x), 2e-3), "kN", ".4f"),
    )


@kind("specimens side by side")
def side_by_side(draw: Draw) -> Layout:
    clocks, gap, count = draw.chance(0.4), draw.chance(0.4), draw.whole(2, 4)
    names = draw.pick(["W1", "W2", "W3", "W4"], ["Specimen A", "Specimen B", "Specimen C", "Specimen D"], [""] * 4)[
        :count
    ]
    columns, over, truth = [], [], []
    for name in names:
        t, x, f = _specimen(draw, draw.whole(60, 150))
        group = [t, x, f] if clocks else [x, f]
        columns += [*group, *([Column("", np.full(1, np.nan))] if gap else [])]
        over += [name, *[""] * (len(group) - 1 + gap)]
        truth.append(loop(x, f, t if clocks else None))
    dialect = Dialect(draw.pick(",", "\t", ";"), style=draw.pick("parentheses", "brackets", "row"))
    lines = [dialect.delimiter.join(over)] if any(over) else []
    return Layout(
        "", {draw.pick("specimens.csv", "walls.txt"): packed(draw, lines + table(draw, columns, dialect))}, loops(truth)
    )


@kind("command beside measurement")
def commanded(draw: Draw) -> Layout:
    """The displacement that an actuator reached, not the one that it was told, is the input of a force."""
    n = draw.whole(200, 600)
    t, x, f = _specimen(draw, n)
    told = draw.pick("Command", "Setpoint", "Target")
    size = np.ptp(x.values)
    command = Column(f"Actuator {told}", x.values + 0.01 * size * sine(n, 2), "mm", ".5f")
    reached = Column(
        draw.pick("Actuator Position", "Actuator Displacement"),
        x.values + draw.rng.normal(0, 3e-4 * size, n),
        "mm",
        ".5f",
    )
    load = Column("Actuator Force", f.values, "kN", ".4f")
    gauges = [
        Column(f"SG{k}", 500 * draw.noise(f.values / np.ptp(f.values), 0.3), "V", ".2f")
        for k in range(draw.whole(0, 4))
    ]
    columns = [t, *draw.shuffled([*draw.pick([command, reached], [reached, command]), load]), *gauges]
    lines = table(draw, columns, Dialect(draw.pick(",", "\t"), style=draw.pick("parentheses", "row")))
    return Layout("", {draw.pick("actuator.csv", "daq.txt"): packed(draw, lines)}, loops(loop(reached, load, t)))


@kind("header that a line ends")
def marked(draw: Draw) -> Layout:
    n = draw.whole(150, 500)
    u = (1 + sine(n, 3)) / 2
    step = draw.pick(0.001, 0.0002, 0.01)
    v = Column("Voltage", 100 * u, "V", ".5f")
    x = Column("Position", 9 * draw.noise(lagging(draw, u), 1e-3), "um", ".5f")
    t = Column("t", np.arange(n) * step, "s", ".9g")
    head, mark = draw.pick(
        ([f"# SAMPLE_TIME = {step:f}", f"# NDATA = {n}"], "# END_HEADER"),
        ([f"Samples\t{n}\t{n}", "X0\t0\t0", f"Delta_X\t{step}\t{step}"], "***End_of_Header***"),
        ([f"Sampling rate: {1 / step:g} Hz", "Operator: x"], "***DATA***"),
    )
    names_below = draw.chance(0.5)
    header, dialect = titles([v, x], Dialect("\t")), Dialect("\t")
    body = [mark, *header] if names_below else [*header, mark]
    return Layout(
        "",
        {draw.pick("scan.dat", "record.txt"): packed(draw, head + body + rows([v, x], dialect))},
        loops(loop(v, x, t)),
    )


@kind("time that runs back or starts again")
def restarted(draw: Draw) -> Layout:
    n = draw.whole(100, 400)
    t, x, f = _specimen(draw, n)
    dialect = Dialect(draw.pick(",", ";"))
    if draw.chance(0.5):
        back = [Column(c.name, c.values[::-1], c.unit, c.form) for c in (t, x, f)]
        return Layout("", {"newest_first.csv": packed(draw, table(draw, back, dialect))}, loops(loop(x, f, t)))
    each = n // draw.whole(2, 5)
    step = Column("Step Time", (np.arange(n) % each) * 0.05, "s", ".2f")
    total = t.renamed("Total Time")
    lines = table(draw, [step, total, x, f], dialect)
    return Layout("", {"steps.csv": packed(draw, lines)}, loops(loop(x, f, total)))


@kind("groups told apart by words of their names")
def titled(draw: Draw) -> Layout:
    words = draw.pick(["300K", "77K", "10K"], ["A", "B", "C"], ["S1", "S2", "S3"])[: draw.whole(2, 3)]
    form = draw.pick("{name}_{word}", "{word} {name}", "Sample {word} - {name}", "{name} ({word})")
    columns, truth = [], []
    n = draw.whole(60, 150)
    for word in words:
        _, x, f = _specimen(draw, n)
        group = [c.renamed(form.format(name=c.name, word=word)) for c in (x, f)]
        columns += group
        truth.append(loop(*group))
    dialect = Dialect(draw.pick(",", "\t"), style=draw.pick("brackets", "row"))
    return Layout("", {draw.pick("samples.csv", "all.txt"): packed(draw, table(draw, columns, dialect))}, loops(truth))


@kind("a row for each value of a sensor")
def long_format(draw: Draw) -> Layout:
    t, x, f = _specimen(draw, draw.whole(60, 150))
    mark, lines = draw.pick(",", ";"), []
    for cells in zip(t.cells, x.cells, f.cells, strict=True):
        lines += [
            mark.join((cells[0], f"{c.name} [{c.unit}]", cell)) for c, cell in zip((x, f), cells[1:], strict=True)
        ]
    head = mark.join(draw.pick(("time", "sensor", "value"), ("Time (s)", "channel", "reading")))
    return Layout("", {draw.pick("log.csv", "sensors.csv"): packed(draw, [head, *lines])}, loops(loop(x, f, t)))


@kind("a row for each change of a value")
def history(draw: Draw) -> Layout:
    """The history of a database of states: each entity writes where its value changes, one entity after the other."""
    n = draw.whole(60, 150)
    begin = datetime.datetime(2024, draw.whole(1, 12), draw.whole(1, 28), 5)
    drive = np.round(50 + 40 * sine(n, draw.whole(2, 4)), 1)
    answer = np.round(draw.noise(20 + 8 * lagging(draw, drive / 40), 1e-3), 2)
    entities = (("number.valve_opening", drive), ("sensor.flow_temperature", answer))
    lines = ["entity_id,state,last_changed"]
    for name, values in entities:
        for k in range(n):
            if k == 0 or values[k] != values[k - 1]:
                lines.append(f"{name},{values[k]:g},{(begin + datetime.timedelta(seconds=30 * k)).isoformat()}.000Z")
    changed = np.append(True, (np.diff(drive) != 0) | (np.diff(answer) != 0))
    return Layout(
        "",
        {"history.csv": packed(draw, lines)},
        loops(Loop(drive[changed], answer[changed], t=30.0 * np.flatnonzero(changed))),
    )


@kind("blocks of a simulation")
def blocks(draw: Draw) -> Layout:
    """A block for each time, with settings or a caption above the row of a node."""
    t, x, f = _specimen(draw, draw.whole(40, 100))
    captions, lines = draw.chance(0.5), []
    for k, (time, u, y) in enumerate(zip(t.cells, x.cells, f.cells, strict=True), 1):
        if captions:
            lines += ["", f" displacements (vx,vy,vz) for set TOP and time  {time}", "", f"  12  {u} 0.0 0.0", ""]
            lines += [f" forces (fx,fy,fz) for set TOP and time  {time}", "", f"  12  {y} 0.0 0.0"]
        else:
            lines += [f"*Step  = {k}", f"*Time  = {time}", "*Data  = ux;Rx", f"12 {u} {y}"]
    pair = dataclasses.replace(loop(x, f, t), u_unit="", y_unit="")
    return Layout("", {draw.pick("model.dat", "nodes.txt"): packed(draw, lines)}, loops(pair))


@kind("matrix of a recorder in XML")
def recorder(draw: Draw) -> Layout:
    """The columns of a matrix have their names in elements above it."""
    t, x, f = _specimen(draw, draw.whole(40, 100))
    names = draw.pick(("D1", "R1"), ("strain", "stress"))
    head = ['<?xml version="1.0"?>', "<OpenSees>"]
    for tag, name in enumerate(("time", *names)):
        head += [f'<NodeOutput nodeTag="{tag}">', f"<ResponseType>{name}</ResponseType>", "</NodeOutput>"]
    lines = [*head, "<Data>", *rows([t, x, f], Dialect(" ")), "</Data>", "</OpenSees>"]
    pair = dataclasses.replace(loop(x, f, t), u_unit="", y_unit="")
    return Layout("", {"node.xml": packed(draw, lines)}, loops(pair))


@kind("segments of one test between blank lines")
def segments(draw: Draw) -> Layout:
    """A blank line after each segment of an indentation or a step of a test, while the clock goes on."""
    n = draw.whole(200, 600)
    half = n // 2
    depth = 300 * np.append(np.linspace(0, 1, half) ** 0.5, 1 - 0.3 * np.linspace(0, 1, n - half) ** 0.7)
    force = 9 * np.append(np.linspace(0, 1, half), np.linspace(1, 0, n - half) ** 1.5)
    t = Column("Time", np.arange(n) * 0.01, "s", ".6f", "s")
    x = Column("Depth", draw.noise(depth, 2e-4), "nm", ".6f", "nm")
    f = Column("Load", draw.noise(force, 2e-4), "mN", ".6f", "mN")
    volts = [Column("Depth", -1.9e-4 * x.values, "V", ".6f", "V"), Column("Load", 0.3 * f.values, "V", ".6f", "V")]
    columns = [x, f, t, *(volts if draw.chance(0.5) else [])]
    lines = table(draw, columns, Dialect(draw.pick("\t", ","), style="parentheses"))
    for place in sorted({1, half, draw.whole(half, n - 2)}, reverse=True):
        lines.insert(place + 1, "")
    head = ["Tue Nov 22 15:58:19 2022", "", f"Number of Points = {n}"][: draw.pick(0, 3)]
    return Layout("", {draw.pick("indent_00001.txt", "segments.csv"): packed(draw, head + lines)}, loops(loop(x, f, t)))
