"""Piezo actuators: controllers of PI and Thorlabs, dSPACE, LabVIEW and oscilloscope exports."""

from __future__ import annotations

import numpy as np

from .drawing import Draw
from .physics import growing, lagging, wave
from .registry import kind
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, rows, table


def actuator(draw: Draw, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, voltage of 0 to a top value, and displacement, shape (n,) each."""
    cycles = draw.whole(1, 6)
    shape = growing(n, cycles) if draw.chance(0.3) and cycles > 2 else wave(draw, n, cycles, 0.75)
    top, stroke = draw.pick(10.0, 75.0, 100.0, 120.0, 150.0), draw.size(1, 200)
    y = draw.noise(stroke * (1 + lagging(draw, shape)) / 2, 5e-4)
    return np.arange(n) * draw.pick(1e-4, 1e-3, 2e-3, 0.01), top * (1 + shape) / 2, y + draw.pick(0, 0, 1) * stroke


@kind("PI piezo controller")
def pi_controller(draw: Draw) -> Layout:
    n = draw.whole(150, 900)
    t, u, y = actuator(draw, n)
    clock = Column("TIME", t, "s", ".5f")
    v = Column(draw.pick("Output Voltage of Channel 1", "Output Voltage", "Control Value"), u, "V", ".4f")
    x = Column(draw.pick("Current Position of Axis 1", "Current Position", "Sensor Position"), y, "um", ".5f")
    columns = [clock, v, x] if draw.chance(0.5) else [clock, x, v]
    lines = ["# REM E-727 data recorder", "# VERSION = 1", f"# DIM = {len(columns)}", f"# NDATA = {n}"][
        : draw.pick(0, 4)
    ]
    lines += table(draw, columns, Dialect(draw.pick("\t", ",", ";"), style=draw.pick("parentheses", "brackets", "row")))
    return Layout(
        "", {draw.pick("rec1.csv", "PI_record.txt", "drr.dat"): packed(draw, lines)}, loops(loop(v, x, clock))
    )


@kind("Thorlabs piezo controller")
def thorlabs(draw: Draw) -> Layout:
    n = draw.whole(150, 800)
    t, u, y = actuator(draw, n)
    clock = Column("Time", t, "s", ".5f")
    v = Column(draw.pick("Output Voltage", "Piezo Voltage", "Drive voltage"), u, "V", ".3f")
    x = Column(draw.pick("Position", "Displacement", "Position Y"), y, "um", ".4f")
    monitor = Column(draw.pick("Monitor", "Monitor Output"), draw.noise(u / 15, 1e-3), "V", ".4f")
    columns = [clock, v, x, monitor] if draw.chance(0.5) else [clock, v, monitor, x]
    columns = columns if draw.chance(0.7) else columns[1:]
    lines = ["Thorlabs Kinesis KPZ101 S/N 29500123", ""][: draw.pick(0, 2)]
    lines += table(
        draw, columns, Dialect(draw.pick(",", ";", "\t"), style=draw.pick("parentheses", "brackets", "row", "slash"))
    )
    with_time = clock if columns[0] is clock else None
    return Layout("", {draw.pick("kpz.csv", "PK4 loop.txt"): packed(draw, lines)}, loops(loop(v, x, with_time)))


@kind("dSPACE ControlDesk CSV")
def control_desk(draw: Draw) -> Layout:
    n = draw.whole(200, 900)
    t, u, y = actuator(draw, n)
    clock = Column("time", t, "s", ".6f")
    v, x = Column("u", u, "", ".6f"), Column("y", y, "", ".6f")
    path_u, path_y = draw.pick(
        ("Model Root/DAC voltage/Out1", "Model Root/Displacement/Out1"), ("Model Root/u/Out1", "Model Root/y/Out1")
    )
    columns = [clock, v.renamed(path_u), x.renamed(path_y)]
    lines = ["descriptor;;", "format;CSV;", "version;1.0", "measurementName;meas1", "trace_values"][: draw.pick(0, 5)]
    marks = draw.pick((";", "."), (";", ","), (",", "."))
    lines += table(draw, columns, Dialect(*marks, style="none"))
    return Layout("", {draw.pick("rec001.csv", "Measurement 3.csv"): packed(draw, lines)}, loops(loop(v, x, clock)))


def _lvm(draw: Draw, columns: list[Column], clock: Column) -> list[str]:
    """Lines of a LabVIEW measurement file of two channels."""
    count = len(columns)
    fill = lambda key, values: "\t".join([key, *values, ""])
    head = [
        "LabVIEW Measurement\t",
        "Writer_Version\t2",
        "Reader_Version\t2",
        "Separator\tTab",
        "Decimal_Separator\t.",
        "Multi_Headings\tNo",
    ]
    head += [
        "X_Columns\tOne",
        "Time_Pref\tRelative",
        "Operator\tlab",
        "Date\t2020/03/02",
        "Time\t14:05:11.1",
        "***End_of_Header***\t",
        "\t",
    ]
    head += [
        fill("Channels", [str(count)]),
        fill("Samples", [str(len(clock.values))] * count),
        fill("Date", ["2020/03/02"] * count),
    ]
    head += [
        fill("Y_Unit_Label", [c.unit for c in columns]),
        fill("X_Dimension", ["Time"] * count),
        fill("X0", ["0.0E+0"] * count),
    ]
    head += [
        fill("Delta_X", ["1.0E-3"] * count),
        "***End_of_Header***\t",
        "\t".join(["X_Value", *(c.name for c in columns), "Comment"]),
    ]
    return head + rows([clock, *columns], Dialect("\t", trailing=draw.chance(0.5)))


@kind("LabVIEW .lvm")
def lvm(draw: Draw) -> Layout:
    t, u, y = actuator(draw, draw.whole(150, 800))
    clock = Column("X_Value", t, "s", ".6f")
    v = Column(draw.pick("Voltage", "Drive voltage", "Voltage_0"), u, "V", ".6f")
    x = Column(draw.pick("Displacement", "Position", "Laser displacement"), y, "um", ".6f")
    columns = [v, x] if draw.chance(0.7) else [x, v]
    columns += (
        [Column("Temperature", 22 + draw.rng.normal(0, 0.05, len(t)), "degC", ".4f", "Deg C")]
        if draw.chance(0.3)
        else []
    )
    return Layout(
        "",
        {
            draw.pick("test_01.lvm", "piezo.lvm", "run3.txt"): packed(
                draw, _lvm(draw, columns, clock), ("utf-8", "cp1252")
            )
        },
        loops(loop(v, x, clock)),
    )


@kind("TDMS exported as text")
def tdms_text(draw: Draw) -> Layout:
    t, u, y = actuator(draw, draw.whole(150, 800))
    clock = Column("Time", t, "s", ".6f")
    v, x = Column("Voltage", u, "V", ".6f"), Column("Displacement", y, "um", ".6f")
    group = draw.pick("Untitled", "Group", "Measurement 1", "")
    named = [c.renamed(f"{group}/{c.name}" if group else c.name) for c in (clock, v, x)]
    lines = ["Root name:,piezo run", "Group name:,Untitled", f"wf_increment,{t[1]:g}", ""][: draw.pick(0, 4)]
    lines += table(draw, named, Dialect(draw.pick(",", "\t", ";"), style=draw.pick("parentheses", "brackets", "row")))
    return Layout("", {draw.pick("run_tdms.csv", "export.txt"): packed(draw, lines)}, loops(loop(v, x, clock)))
