"""Calibrations of sensors, whose input is what others measure, converters of a current to a pressure, and sweeps of a temperature."""

from __future__ import annotations

import numpy as np

from .drawing import Draw
from .physics import lagging, saturating, triangle
from .registry import kind
from .slow import any_dialect
from .truth import Layout, loops
from .writing import Column, loop, packed, table

_INPUTS = (
    ("Force", "N", 100.0), ("Applied load", "N", 500.0), ("Torque", "Nm", 20.0), ("Pressure", "kPa", 200.0), ("Strain", "%", 40.0),
    ("Displacement", "mm", 10.0),
)  # fmt: skip
# Name, unit, zero and range of the signal of a sensor.
_SIGNALS = (
    ("Wavelength", "nm", 1550.0, 0.8), ("Bragg wavelength", "nm", 1310.0, 0.5), ("Wavelength shift", "pm", 0.0, 600.0),
    ("Capacitance", "pF", 12.0, 5.0), ("Sensor output", "mV", 0.0, 20.0), ("Output", "mV/V", 0.0, 2.0), ("Inductance", "uH", 40.0, 9.0),
)  # fmt: skip


@kind("calibration of a sensor")
def calibration(draw: Draw) -> Layout:
    n = 2 * draw.whole(60, 150)
    x = (1 + triangle(n, draw.whole(1, 3), 0.75)) / 2
    (name, unit, size), (signal, of_signal, zero, span) = draw.pick(*_INPUTS), draw.pick(*_SIGNALS)
    u = Column(name, size * x, unit, ".4f")
    y = Column(signal, zero + span * draw.noise(lagging(draw, x, 0.2), 1e-3), of_signal, ".5f")
    t = Column("Time", 0.1 * np.arange(n), "s", ".2f")
    room = Column("Room temperature", 23 + draw.rng.normal(0, 0.05, n), "degC", ".2f", "degC")
    # What is written first among two alone is the drive, where a bare "output" could be that of a source or of a sensor.
    pair = [u, y] if "utput" in signal or draw.chance(0.6) else [y, u]
    columns = [*([t] if draw.chance(0.5) else []), *pair, *([room] if draw.chance(0.3) else [])]
    lines = table(draw, columns, any_dialect(draw))
    return Layout(
        "", {draw.pick("calibration.csv", "FBG 3.txt", "sensor_up_down"): packed(draw, lines)}, loops(loop(u, y))
    )


@kind("current to pressure converter")
def converter(draw: Draw) -> Layout:
    n = 2 * draw.whole(60, 150)
    x = (1 + triangle(n, draw.whole(1, 3), 0.75)) / 2
    names = draw.pick(("Current", "Pressure"), ("Input current", "Output pressure"), ("Loop current", "Pressure"))
    u = Column(names[0], 4 + 16 * x, "mA", ".3f")
    unit, size = draw.pick(("bar", 1.0), ("psi", 15.0), ("kPa", 100.0))
    y = Column(names[1], size * (0.2 + 0.8 * draw.noise(lagging(draw, x, 0.1), 1e-3)), unit, ".4f")
    lines = table(draw, [u, y] if draw.chance(0.6) else [y, u], any_dialect(draw))
    return Layout("", {draw.pick("ip.csv", "converter.txt"): packed(draw, lines)}, loops(loop(u, y)))


@kind("temperature sweep in a held field")
def sweep(draw: Draw) -> Layout:
    """Magnetization over temperature of an alloy that transforms; the field is read back at every point."""
    n = 2 * draw.whole(80, 200)
    x = triangle(n, 1, 0.75)
    u = Column("Temperature", 250 + draw.between(20, 100) * x, "K", ".3f")
    y = Column(
        draw.pick("Moment", "Long Moment"), 1e-3 * (2 - draw.noise(saturating(draw, x, begin=-1), 1e-3)), "emu", ".6e"
    )
    field = Column("Magnetic Field", draw.pick(100.0, 1000.0, 50000.0) * (1 + draw.rng.normal(0, 1e-5, n)), "Oe", ".3f")
    t = Column("Time Stamp", 20.0 * np.arange(n), "s", ".1f", "sec")
    lines = table(draw, [*([t] if draw.chance(0.5) else []), *draw.shuffled([u, field]), y], any_dialect(draw))
    return Layout("", {draw.pick("MvsT.csv", "MT_1kOe.dat"): packed(draw, lines)}, loops(loop(u, y)))


@kind("alloy under a held load")
def held_load(draw: Draw) -> Layout:
    """A shape memory alloy is loaded, and then cooled and heated while a machine holds the load."""
    first, n = draw.whole(20, 80), draw.whole(150, 400)
    x = triangle(n, draw.whole(1, 3), draw.pick(0.25, 0.75))
    ramp, rest = np.arange(first) / first, np.ones(n)
    held = draw.size(20, 900)
    load = np.append(held * ramp, held * (rest + draw.rng.normal(0, 5e-4, n)))
    bath = draw.between(40, 90)
    warm = np.append(np.full(first, bath + 40 * x[0]), bath + 40 * x) + draw.rng.normal(0, 0.05, first + n)
    longer = 0.2 + 1.5 * (1 - saturating(draw, x, begin=1)) / 2
    u = Column(draw.pick("Temperature", "Chamber temperature", "Temp"), warm, "degC", ".2f")
    y = Column(draw.pick("Extension", "Displacement", "Crosshead"), np.append(longer[0] * ramp, longer), "mm", ".4f")
    force = Column(draw.pick("Load", "Force"), load, "N", ".3f")
    t = Column("Time", 0.5 * np.arange(first + n), "s", ".1f")
    lines = table(draw, [t, *draw.shuffled([u, y, force])], any_dialect(draw))
    return Layout("", {draw.pick("cftc.txt", "sample89.csv"): packed(draw, lines)}, loops(loop(u, y, t)))


@kind("sensor at set inputs")
def at_set_inputs(draw: Draw) -> Layout:
    """The voltage of a sensor at inputs that are set in equal steps, up and down, some with the output before the input."""
    steps, runs = draw.whole(8, 25), draw.whole(1, 3)
    up = np.arange(steps + 1) / steps
    x = np.concatenate([[0.0], *(np.append(up[1:], up[-2::-1]) for _ in range(runs))])
    name, unit, size = draw.pick(
        ("Position", "mm", 25.0), ("Load", "N", 50.0), ("Pressure", "bar", 10.0), ("Angle", "deg", 90.0)
    )
    u = Column(name, size * x, unit, ".4f")
    sensor = Column(
        draw.pick("Voltage", "Sensor voltage", "Output"), 5 * draw.noise(lagging(draw, x, 0.1), 1e-3), "V", ".5f"
    )
    supply = Column("Supply", 5 + draw.rng.normal(0, 2e-4, x.size), "V", ".4f")
    columns = [*draw.shuffled([u, sensor]), *([supply] if draw.chance(0.3) else [])]
    lines = table(draw, columns, any_dialect(draw))
    return Layout("", {draw.pick("cal.csv", "sensor_17.txt"): packed(draw, lines)}, loops(loop(u, sensor)))


@kind("loop of a process control")
def controller(draw: Draw) -> Layout:
    """Set point, measurement and output of a controller by their tags; the output drives the valve."""
    n = draw.whole(200, 600)
    x = (1 + triangle(n, draw.whole(2, 4), 0.75)) / 2
    mark, tag = (
        draw.pick(".", "/", "_"),
        f"{draw.pick('LIC', 'FIC', 'TIC', 'PIC')}{draw.pick('', '-')}{draw.whole(1, 999)}",
    )
    u = Column(f"{tag}{mark}{draw.pick('OUT', 'OP', 'CO', 'MV')}", 20 + 60 * x, "", ".3f")
    y = Column(f"{tag}{mark}PV", 10 + 70 * draw.noise(lagging(draw, x, 0.15), 2e-3), "", ".3f")
    goal = Column(f"{tag}{mark}SP", np.full(n, 50.0), "", ".1f")
    t = Column("Time", 1.0 * np.arange(n), "s", ".1f")
    lines = table(draw, [t, *draw.shuffled([u, y, goal])], any_dialect(draw))
    return Layout("", {draw.pick("trend.csv", "loop.txt"): packed(draw, lines)}, loops(loop(u, y, t)))
