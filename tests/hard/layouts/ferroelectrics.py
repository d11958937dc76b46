"""Ferroelectric testers and PFM: aixACCT, Radiant, Keysight EasyEXPERT, switching loops."""

from __future__ import annotations

import numpy as np

from .drawing import Draw
from .physics import lagging, saturating, sine, triangle
from .registry import kind
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, rows, table


def aix_number(value: float) -> str:
    """A number as aixPlorer writes it: an exponent of three digits."""
    mantissa, _, power = f"{value:.6e}".partition("e")
    return f"{mantissa}e{power[0]}{int(power[1:]):03d}"


@kind("aixACCT tables")
def aixacct(draw: Draw) -> Layout:
    count, strain, second = draw.whole(1, 4), draw.chance(0.4), draw.chance(0.5)
    lines, truth, summary = [], [], []
    for k in range(count):
        n, volts = draw.whole(100, 300), draw.size(1, 3000)
        u = volts * triangle(n, 1, 0.0)
        y = draw.noise(draw.size(1, 60) * saturating(draw, u / volts, begin=draw.pick(-1, 0, 1)), 1e-3)
        t = Column("Time", np.linspace(0, draw.pick(1e-3, 1e-2, 1.0), n), "s", aix_number)
        v, p = Column("V+", u, "V", aix_number), Column("P1", y, "uC/cm2", aix_number)
        columns = [t, v, Column("V-", 0 * u, "V", aix_number), Column("I1", np.gradient(y), "A", aix_number), p]
        columns += [Column("P2", y + 0.01 * np.ptp(y), "uC/cm2", aix_number)] if second else []
        columns += [Column("D1", 100 * np.abs(lagging(draw, u / volts)), "nm", aix_number)] if strain else []
        stated = [Column(c.name, c.values, c.unit, c.form, c.unit) for c in columns]
        lines += [
            f"Table {k + 1}",
            "Timestamp: 08/23/2019 14:17:12",
            "Waveform: triangle",
            "SampleName: PZT_7",
            "Area [mm2]: 0.01",
        ]
        lines += [
            "Thickness [nm]: 200",
            f"Hysteresis Amplitude [V]: {volts:g}",
            f"Vc+ [V]: {0.2 * volts:g}",
            "Measurement Status: 0",
        ]
        lines += [*table(draw, stated, Dialect("\t", style="brackets", trailing=True)), ""]
        summary.append("\t".join(map(aix_number, (k + 1, 0.2 * volts, -0.2 * volts, y.max(), y.min(), 1e3))))
        truth.append(loop(v, p))
    head = [
        "DynamicHysteresisResult",
        "",
        "Table 1",
        "Table No [#]\tVc+ [V]\tVc- [V]\tPr+ [uC/cm2]\tPr- [uC/cm2]\tWloss [uJ/cm2]",
    ]
    head += [
        *summary,
        "",
        "DynamicHysteresis",
        "Program: aixPlorer Software version 3.0.44.0",
        "TfaModule: DHM",
        "TfaVersion: 4.11.0",
        "",
    ]
    name = draw.pick("pzt_DHM.dat", "capacitor 7.dat", "fatigue.txt")
    return Layout("", {name: packed(draw, head + lines, ("cp1252",))}, (tuple(truth),))


@kind("Radiant Precision")
def radiant(draw: Draw) -> Layout:
    n, volts = draw.whole(101, 401), draw.size(3, 500)
    u = volts * triangle(n, 1)
    y = draw.noise(draw.size(2, 50) * saturating(draw, u / volts, begin=draw.pick(-1, 0)), 1e-3)
    by_field = draw.chance(0.4)
    v = Column("Drive Voltage", u, "V", ".4f")
    e = Column("Field", u / 2, "kV/cm", ".4f")
    p = Column(draw.pick("Measured Polarization", "Polarization"), y, "uC/cm2", ".6f")
    point = Column("Point", 1.0 + np.arange(n), "", ".0f")
    t = Column("Time", np.arange(n) * draw.pick(0.01, 0.1, 1.0), "ms", ".4f")
    columns = [point, t, e if by_field else v, p]
    columns = [c for c in columns if c is not t or draw.chance(0.7)]
    above = [
        "Hysteresis Version: 4.8.0 - Radiant Technologies, Inc., 1999",
        "Sample Name: PNZT 4/20/80",
        f"Volts:\t{volts}",
    ]
    above += [
        "Period (ms):\t10.0",
        "Sample Area (cm2):\t0.0001",
        "Sample Thickness (um):\t0.255",
        "Preset Loop: Yes",
        "",
    ]
    lines = (
        above + table(draw, columns, Dialect("\t", style="parentheses")) + draw.pick([], ["", "PMax: 21.3", "Pr: 12.1"])
    )
    return Layout(
        "",
        {draw.pick("Hysteresis.txt", "PNZT 9V") + "": packed(draw, lines, ("cp1252", "utf-8"))},
        loops(loop(e if by_field else v, p)),
    )


@kind("Keysight EasyEXPERT")
def easyexpert(draw: Draw) -> Layout:
    n, volts = draw.whole(101, 401), draw.size(1, 20)
    u = draw.noise(volts * triangle(n, draw.whole(1, 2)), 1e-5)
    current = draw.noise(draw.size(1e-9, 1e-3) * np.sinh(2.5 * saturating(draw, u / volts)) * (1.0 + 0.0 * u), 1e-3)
    name_v, name_i = draw.pick(("V1", "I1"), ("Vg", "Id"), ("Vtop", "Itop"), ("VBias", "IBias"))
    v, i = Column(name_v, u, "V", ".6g"), Column(name_i, current, "A", ".6g")
    t = Column("Time", np.arange(n) * 0.01, "s", ".5g")
    columns = [t, v, i] if draw.chance(0.5) else [v, i]
    named = [f"DataName, {', '.join(c.name for c in columns)}"]
    lines = [f"DataValue, {row}" for row in rows(columns, Dialect(", "))]
    above = ["SetupTitle, I/V Sweep", "PrimitiveTest, I/V Sweep", "TestParameter, Channel.UnitType, SMU, SMU"]
    above += [
        "MetaData, TestRecord.RecordTime, 03/02/2020 16:03:00",
        f"Dimension1, {', '.join([str(n)] * len(columns))}",
    ]
    # The units of DataName follow from the letters: a voltage and a current.
    v, i = Column(name_v, u, "", ".6g"), Column(name_i, current, "", ".6g")
    return Layout(
        "",
        {"IV Sweep [memristor(3) ; 3_2_2020 4_03_00 PM].csv": packed(draw, above + named + lines)},
        loops(loop(v, i)),
    )


@kind("PFM switching loop")
def pfm(draw: Draw) -> Layout:
    cycles = draw.whole(1, 4)
    n, volts = cycles * draw.whole(60, 150), draw.size(2, 40)
    u = volts * triangle(n, cycles)
    state = saturating(draw, u / volts, begin=draw.pick(-1, 0, 1))
    amplitude = Column("Amplitude", draw.noise(80 * np.abs(state) + 3, 1e-2), draw.pick("pm", "mV"), ".5f")
    degrees = 90 - 88 * np.tanh(8 * state)
    degrees = np.where(
        state >= 0, np.minimum(degrees, 80), np.maximum(degrees, 100)
    )  # the phase of no domain is in between
    phase = Column("Phase", draw.noise(degrees, 5e-3), "deg", ".4f")
    response = Column("Piezoresponse", draw.noise(80 * state, 1e-2), draw.pick("pm", "mV", "a.u."), ".5f")
    bias = Column(draw.pick("Bias", "Tip Bias", "DC Bias", "Sample bias"), u, "V", ".5f")
    outputs = draw.pick([response], [amplitude, phase], [response, amplitude])
    t = Column("Time", np.arange(n) * 0.025, "s", ".4f")
    columns = [*([t] if draw.chance(0.4) else []), bias, *outputs]
    lines = table(draw, columns, Dialect(draw.pick("\t", ","), style=draw.pick("parentheses", "brackets")))
    truths = loops(*(loop(bias, out) for out in outputs))
    if outputs[1:] == [phase]:  # which tells the sign of the amplitude
        signed = Column("Piezoresponse", np.where(phase.values < 90, 1, -1) * amplitude.values, amplitude.unit, ".5f")
        truths = (*truths, *loops(loop(bias, signed)))
    return Layout("", {draw.pick("ss-pfm_loop.txt", "SSPFM0003.csv"): packed(draw, ["# Mode: SS-PFM", *lines])}, truths)


@kind("ferroelectric table of a paper")
def published_loop(draw: Draw) -> Layout:
    n = 2 * draw.whole(75, 300)
    size = draw.size(5, 3000)
    u = size * draw.pick(triangle, sine)(n, draw.whole(1, 2))
    y = draw.noise(draw.size(0.5, 70) * saturating(draw, u / size), 2e-3) + draw.pick(0, 1.5)
    drive = draw.pick(
        ("E", "kV/cm"), ("Electric Field", "kV/cm"), ("Field", "kV/cm"), ("Voltage", "V"), ("Electric field", "MV/m")
    )
    sensor = draw.pick(
        ("P", "uC/cm2"), ("Polarization", "uC/cm2"), ("Polarisation", "uC/cm2"), ("D", "C/m2"), ("Charge", "nC")
    )
    e, p = Column(drive[0], u, drive[1], ".5g"), Column(sensor[0], y, sensor[1], ".5g")
    columns = [p, e] if draw.chance(0.2) else [e, p]
    dialect = Dialect(
        draw.pick(",", "\t", ";"), style=draw.pick("parentheses", "brackets", "row", "slash", "underscore", "comma")
    )
    dialect = Dialect("\t", style="comma") if dialect.style == "comma" else dialect
    if dialect.delimiter == ";" and draw.chance(0.7):
        dialect = Dialect(";", ",", dialect.style)
    return Layout(
        "",
        {draw.pick("PE_loop.csv", "Fig3a.txt", "P-E 1Hz.dat", "fig2b"): packed(draw, table(draw, columns, dialect))},
        loops(loop(e, p)),
    )


@kind("pulses side by side")
def pulses(draw: Draw) -> Layout:
    n, volts, rest = draw.whole(50, 400), draw.size(1, 50), draw.pick(0.1, 1.0)
    signs = draw.pick((1, 1, -1, -1, 1), (-1, 1, 1, -1, -1), (1, 1, -1, -1))
    pulse = 1 - np.abs(np.linspace(-1, 1, n))
    u = volts * np.concatenate([sign * pulse for sign in signs])
    y = draw.noise(draw.size(1, 60) * saturating(draw, u / volts), 1e-3)
    place = lambda values, k: values[k * n : (k + 1) * n]
    columns = []
    for k in range(len(signs)):
        t = Column("Time", k * rest + np.linspace(0, 0.01, n), "s", aix_number)
        current = Column("I", np.gradient(place(y, k)), "A", aix_number)
        columns += [t, Column("V", place(u, k), "V", aix_number), current]
        columns += [Column("P", place(y, k), "uC/cm2", aix_number, "uC/cm2")]
    head = [
        "PulseResult",
        "",
        "Pulse",
        "TfaModule: PM",
        "Pulse Points: 401",
        "Area [mm2]: 0.01",
        "Psw [uC/cm2]: 17.5273",
    ]
    lines = head + table(draw, columns, Dialect("\t", style="brackets", trailing=True))
    v, p = Column("V", u, "V", aix_number), Column("P", y, "uC/cm2", aix_number)
    return Layout("", {draw.pick("pund.dat", "PM_5pulses.txt"): packed(draw, lines, ("cp1252",))}, loops(loop(v, p)))


@kind("test bench of a script")
def scripted(draw: Draw) -> Layout:
    """The voltage across a shunt beside the current computed from it and the applied voltage; or units behind a blank."""
    n, volts = 2 * draw.whole(60, 250), draw.size(1, 40)
    u = volts * triangle(n, draw.whole(1, 3))
    y = draw.noise(draw.size(2, 60) * saturating(draw, u / volts), 1e-3)
    current = np.gradient(y) * 1e-6
    t, p = Column("time", np.arange(n) * 1e-5, "s", ".9g"), Column("polarization", y, "uC/cm2", ".9g", "uC/cm^2")
    i, drive = Column("current", current, "A", ".12g"), Column("applied voltage", u, "V", ".9g", "V")
    shunt = Column("voltage", draw.pick(50, 1000, 1e6) * current, "V", ".12g", "V")
    columns, style = [t, shunt, i, p, drive], "parentheses"
    if draw.chance(0.5):
        t, p = t.renamed("Time"), Column("P1", y, "uC/cm2", ".9g", "uC_per_cm2")
        drive, i = drive.renamed("Vplus"), i.renamed("I1")
        columns, style = [t, drive, i, p], "blank"
    lines = table(draw, columns, Dialect(draw.pick(",", "\t"), style=style))
    return Layout(
        "", {draw.pick("0_hysteresis_3p0V.csv", "cap 100Hz 4V Table1.tsv"): packed(draw, lines)}, loops(loop(drive, p))
    )
