"""Oscilloscopes and battery cyclers."""

from __future__ import annotations

import numpy as np

from .drawing import Draw
from .physics import lagging, saturating, sine, triangle
from .registry import kind
from .truth import Layout, Loop, loops
from .writing import Column, Dialect, loop, packed, table


def _traces(draw: Draw, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Voltages of a clean sine that drives a device and of the bent wave of its sensor."""
    u = sine(n, draw.whole(2, 5), draw.rng.uniform(0, 1))
    return draw.size(0.5, 20) * draw.noise(u, 1e-3), draw.size(0.05, 5) * draw.noise(
        saturating(draw, u, coercive=0.3), 4e-3
    )


def _scope(draw: Draw, head: list[str], names: tuple[str, str, str], lead: list[str], unit: str, name: str) -> Layout:
    """A file of time and two channels, of which the first or the second is the drive."""
    n = draw.whole(300, 1200)
    u, y = _traces(draw, n)
    step = draw.pick(1e-6, 4e-6, 2e-5, 1e-4)
    first = draw.chance(0.7)
    a, b = (u, y) if first else (y, u)
    t = Column(names[0], (np.arange(n) - n // 2) * step, "", ".6e")
    one, two = Column(names[1], a, unit, ".5g", ""), Column(names[2], b, unit, ".5g", "")
    lines = head + table(draw, [t, one, two], Dialect(",", style="none", trailing=draw.chance(0.2)))
    lines[len(head) + 1 : len(head) + 1] = lead
    drive, sensor = (one, two) if first else (two, one)
    answer = {"input": drive.name, "output": sensor.name}
    return Layout("", {name: packed(draw, lines, ("utf-8",))}, loops(loop(drive, sensor)), may_ask=True, answer=answer)


@kind("interval beside the units of an oscilloscope")
def numbered(draw: Draw) -> Layout:
    """Samples by their number; the first instant and the interval stand in the line of units."""
    n = draw.whole(300, 1200)
    u, y = _traces(draw, n)
    step = draw.pick(1e-6, 4e-6, 2e-5, 1e-4)
    one, two = Column("CH1", u, "Volt", ".5e", ""), Column("CH2", y, "Volt", ".5e", "")
    cells = zip(range(n), one.cells, two.cells, strict=True)
    lines = ["X,CH1,CH2,Start,Increment,", f"Sequence,Volt,Volt,{-step * n / 2:.6e},{step:.6e}"]
    lines += [f"{k},{a},{b},," for k, a, b in cells]
    t = Column("t", step * np.arange(n), "s", ".9e")
    answer = {"input": "CH1", "output": "CH2"}
    return Layout(
        "",
        {draw.pick("NewFile1.csv", "DS0003.CSV"): packed(draw, lines)},
        loops(loop(one, two, t)),
        may_ask=True,
        answer=answer,
    )


@kind("Tektronix CSV")
def tektronix(draw: Draw) -> Layout:
    head = [
        "Model,MSO24",
        "Firmware Version,1.28.7",
        "",
        "Waveform Type,ANALOG,",
        "Point Format,Y,",
        "Horizontal Units,s,",
    ]
    head += [
        "Horizontal Scale,0.002,",
        "Sample Interval,4e-06,",
        "Record Length,1000,",
        "Probe Attenuation,10,1",
        "Vertical Units,V,V",
        "Vertical Offset,0,0",
        "",
        "",
    ]
    return _scope(draw, head, ("TIME", "CH1", "CH2"), [], "V", draw.pick("tek0001ALL.csv", "T0012.CSV"))


@kind("channels with their settings to the left")
def pasted(draw: Draw) -> Layout:
    """Files of single channels of a Tektronix TDS, beside each other."""
    n = 10 * draw.whole(50, 200)
    u = draw.size(0.1, 5) * sine(n, draw.pick(1, 2))
    one = Column("CH1", u, "", ".6f")
    other = Column("CH2", draw.noise(draw.size(0.1, 5) * saturating(draw, u / u.max()), 1e-3), "", ".6f")
    step = draw.pick(1e-5, 4e-6)
    t = Column("t", step * np.arange(n), "s", ".7E")
    settings = [
        f"Record Length,{n},Points",
        f"Sample Interval,{step},s",
        "Source,CH,",
        "Vertical Units,V,",
        "Probe Atten,1.0,",
    ]
    beside = [*settings, *[",,"] * (n - len(settings))]
    lines = [
        ",,".join(f"{mark},{clock},{value}" for value in values)
        for mark, clock, *values in zip(beside, t.cells, one.cells, other.cells, strict=True)
    ]
    answer = {"input": 4, "output": 10}
    return Layout(
        "",
        {"F0000ALL.CSV": packed(draw, lines)},
        loops(loop(one, other, t)),
        either_order=True,
        may_ask=True,
        answer=answer,
    )


@kind("Rigol CSV")
def rigol(draw: Draw) -> Layout:
    style = draw.pick(("Time(s)", "CH1(V)", "CH2(V)"), ("Time(s)", "CH1V", "CH2V"), ("X", "CH1", "CH2"))
    lead = ["Second,Volt,Volt"] if style[0] == "X" else []
    return _scope(draw, [], style, lead, "V" if style[1] != "CH1V" else "", draw.pick("NewFile1.csv", "RigolDS0.csv"))


@kind("LeCroy ASCII")
def lecroy(draw: Draw) -> Layout:
    head = [
        "LECROYWS434,10001,Waveform",
        "Segments,1,SegmentSize,1002",
        "Segment,TrigTime,TimeSinceSegment1",
        "#1,19-Oct-2020 15:21:54,0",
    ]
    return _scope(draw, head, ("Time", "C1", "C2"), [], "", draw.pick("C1C2Trace00000.txt", "Trace00003.csv"))


def _cell(draw: Draw, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Charge [Ah] of cycles between empty and full, open-circuit voltage with a gap, and current [A]; shape (n,) each."""
    cycles = draw.whole(1, 2)
    state = triangle(n, cycles, 0.75)
    charge = draw.size(0.5, 5) * (1 + state) / 2
    lag = lagging(draw, state, 0.2)
    volts = 3.3 + 0.25 * np.tanh(2 * lag) + 0.08 * np.sign(np.gradient(state)) + 0.1 * lag
    return charge, draw.noise(volts, 2e-4), np.sign(np.gradient(state)) * charge.max() / 20


def _throughput(charge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Charge that passed in and out, growing, from a state."""
    steps = np.diff(charge, prepend=charge[0])
    return np.cumsum(np.maximum(steps, 0)), np.cumsum(np.maximum(-steps, 0))


@kind("Arbin cycler")
def arbin(draw: Draw) -> Layout:
    n = 2 * draw.whole(80, 300)
    charge, volts, amps = _cell(draw, n)
    into, out = (
        Column(f"{way}_Capacity", q, "Ah", ".9g", "Ah")
        for way, q in zip(("Charge", "Discharge"), _throughput(charge), strict=True)
    )
    v = Column("Voltage", volts, "V", ".9g", "V")
    clock = Column("Test_Time", 60.0 * np.arange(n), "s", ".7g", "s")
    columns = [
        Column("Data_Point", 1.0 + np.arange(n), "", ".0f"),
        clock,
        Column("Step_Index", 1.0 + (amps < 0), "", ".0f"),
    ]
    columns += [Column("Cycle_Index", np.ones(n), "", ".0f"), Column("Current", amps, "A", ".6g", "A"), v, into, out]
    columns += [
        Column("Internal_Resistance", np.zeros(n), "Ohm", ".0f", "Ohm"),
        Column("Is_FC_Data", np.zeros(n), "", ".0f"),
    ][: draw.whole(0, 2)]
    lines = table(draw, columns, Dialect(draw.pick(",", "\t"), style="tight"))
    truth = Loop(into.written - out.written, v.written, "Ah", "V", slack=1e-6)
    return Layout("", {draw.pick("A123_cell.csv", "Channel_1-008.csv"): packed(draw, lines)}, loops(truth))


@kind("Maccor cycler")
def maccor(draw: Draw) -> Layout:
    n = 2 * draw.whole(80, 300)
    charge, volts, amps = _cell(draw, n)
    way = np.where(amps > 0, 1, -1)
    number = np.cumsum(np.abs(np.diff(way, prepend=way[0])) > 0)
    passed = np.abs(np.diff(charge, prepend=charge[0]))
    capacity = np.concatenate([np.cumsum(passed[number == k]) for k in range(number[-1] + 1)])
    q, v = Column("Amp-hr", capacity, "", ".9f"), Column("Volts", volts, "V", ".6f", "")
    columns = [
        Column("Rec#", 1.0 + np.arange(n), "", ".0f"),
        Column("Cyc#", np.ones(n), "", ".0f"),
        Column("Step", 1.0 + number, "", ".0f"),
    ]
    columns += [
        Column("Test (Sec)", 60.0 * np.arange(n), "", ".2f"),
        Column("Step (Sec)", 60.0 * np.arange(n), "", ".2f"),
        q,
    ]
    columns += [
        Column("Watt-hr", capacity * 3.3, "", ".9f"),
        Column("Amps", np.abs(amps), "", ".6f"),
        v,
        Column("State", np.where(way > 0, "C", "D")),
    ]
    above = ["Today's Date\t03/02/2020\tDate of Test:\t02/25/2020\tFilename:\tcell7.074"] if draw.chance(0.7) else []
    lines = above + table(draw, columns, Dialect("\t", style="none"))
    truth = Loop(np.cumsum(way * passed), v.written, "Ah", "V", slack=5e-3)
    return Layout(
        "", {draw.pick("cell7.074.txt", "cell7.txt", "cell7.074"): packed(draw, lines, ("cp1252",))}, loops(truth)
    )


@kind("BioLogic .mpt")
def biologic(draw: Draw) -> Layout:
    n = 2 * draw.whole(80, 300)
    charge, volts, amps = _cell(draw, n)
    comma = draw.chance(0.3)
    form = lambda v: f"{v:.15E}"
    q, v = Column("(Q-Qo)/mA.h", 1e3 * (charge - charge[0]), "mAh", form, ""), Column("Ecell/V", volts, "V", form, "")
    t = Column("time/s", 60.0 * np.arange(n), "", form)
    columns = [
        Column("mode", np.ones(n), "", ".0f"),
        Column("ox/red", 1.0 * (amps > 0), "", ".0f"),
        Column("error", np.zeros(n), "", ".0f"),
        t,
    ]
    columns += (
        [v, Column("<I>/mA", 1e3 * amps, "", form), q]
        if draw.chance(0.5)
        else [q, Column("control/V/mA", amps, "", form), v]
    )
    head = [
        "EC-Lab ASCII FILE",
        "Nb header lines : 6                         ",
        "",
        "Galvanostatic Cycling with Potential Limitation",
        "",
    ]
    lines = head + table(draw, columns, Dialect("\t", "," if comma else ".", "none", trailing=True))
    return Layout("", {draw.pick("GCPL_C20.mpt", "cell.mpt.txt"): packed(draw, lines, ("cp1252",))}, loops(loop(q, v)))


@kind("cell at constant currents, without capacities")
def uncounted(draw: Draw) -> Layout:
    n = 2 * draw.whole(80, 300)
    charge, volts, _ = _cell(draw, n)
    amps = 60.0 * np.diff(charge, prepend=charge[0])  # a row a minute
    time, current, voltage = draw.pick(
        ("time /s", "I /mA", "E /V"), ("time/s", "I/mA", "Ewe/V"), ("Test_Time(s)", "Current(mA)", "Voltage(V)")
    )
    i, v = Column(current, 1e3 * amps, "", ".12g", ""), Column(voltage, volts, "V", ".6f", "")
    lines = table(draw, [Column(time, 60.0 * np.arange(n), "", ".3f"), i, v], Dialect("\t", style="none"))
    truth = Loop(1e3 * (charge - charge[0]), v.written, "mAh", "V", slack=1e-6)
    return Layout("", {draw.pick("3.9V_10cyc.txt", "cell 12.txt"): packed(draw, lines)}, loops(truth))


@kind("Neware report of cycles, steps and records")
def neware(draw: Draw) -> Layout:
    """The records of a step are set in below it, and the steps below their cycle."""
    n, size = draw.whole(40, 150), draw.size(100, 5000)
    q = np.round(np.linspace(0, size, n), 3)
    down = np.round(4.1 - 0.7 * q / size - draw.between(0.01, 0.05), 4)
    up = np.round(3.4 + 0.7 * q / size + draw.between(0.01, 0.05), 4)
    mark, pad = draw.pick(",", "\t"), draw.chance(0.5)
    rows = [["Cycle ID", "Cap_Chg(mAh)", "Cap_DChg(mAh)"], ["", "Step ID", "Step Name", "Step Time"]]
    rows += [["", "", "Record ID", "Time(h:min:s.ms)", "Voltage(V)", "Current(mA)", "Capacity(mAh)"]]
    rows += [["1", f"{size:.3f}", f"{size:.3f}"]]
    for step, (name, sign, volts) in enumerate([("CC_DChg", -1, down), ("CC_Chg", 1, up)], start=1):
        rows += [["", str(step), name, f"{n // 12:02d}:{n % 12 * 5:02d}:00"]]
        for k, (charge, volt) in enumerate(zip(q, volts, strict=True)):
            clock = f"{k // 12:02d}:{k % 12 * 5:02d}:00.000"
            rows += [["", "", str(k + 1 + (step - 1) * n), clock, f"{volt:.4f}", f"{sign * 100.0}", f"{charge:.3f}"]]
    lines = [mark.join(row + [""] * (7 - len(row) if pad else 0)) for row in rows]
    passed = np.append(-q, q - size)
    truth = Loop(passed, np.append(down, up), "mAh", "V")
    return Layout("", {draw.pick("cell 4.csv", "report.txt"): packed(draw, lines, ("utf-8",))}, loops(truth))
