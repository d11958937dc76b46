"""MicroMag magnetometers: loops, segments and reversal curves."""

from __future__ import annotations

import numpy as np

from .drawing import Draw
from .physics import magnet, major_loop, saturating
from .registry import kind
from .truth import Layout, Loop, loops
from .writing import Column, Dialect, engineering, loop, packed, rows

_SYSTEMS = {"Hybrid SI": ("T", "A*m^2", 1.0, 1e-6), "cgs": ("Oe", "emu", 1e4, 1e-3)}


def _sections(draw: Draw, system: str, measured: str, script: dict[str, str]) -> list[str]:
    """The header of a MicroMag file."""
    series = draw.pick("Series 0015", "Series 0016.002")
    date = f"{draw.whole(1, 12):02d}/{draw.whole(1, 28):02d}/{draw.whole(2004, 2019)}"
    say = lambda key, value: f"{key:<32}{value}"
    none = draw.pick("N/A", "N/A", engineering(draw.size(1e-6, 1e-2)))
    return [
        f"MicroMag 2900/3900 Data File ({series})",
        measured,
        "",
        "INSTRUMENT",
        say("Configuration", draw.pick("VSM", "AGM")),
        say("Temperature control", draw.pick("None", "LHe Cryostat", "Furnace")),
        say("Hardware version", "0004"),
        say("Software version", date),
        say("Units of measure", system),
        say("Temperature in", draw.pick("Kelvin", "Celsius")),
        "",
        "SAMPLE",
        say("Mass", none),
        say("Volume", "N/A"),
        say("Demagnetizing factor", "N/A"),
        "",
        "SETTINGS",
        say("Field range", engineering(1.0)),
        say("Moment range", engineering(2e-6)),
        say("Averaging time", engineering(draw.pick(0.1, 0.2, 0.5))),
        say("Orientation", draw.pick("+90.00000E+00", "0.000000E+00", "N/A")),
        say("Sweep mode", draw.pick("Discrete", "Continuous", "Automatic")),
        "",
        "MEASUREMENT",
        say("Description", f'"{draw.pick("", "PIOX", "tg 12, chip", "MSM33-60")}"'),
        say("Averages (completed)", draw.pick("1", "5", "N/A")),
        say("Measured on", f"{date}  {draw.whole(8, 19):02d}:{draw.whole(10, 59)}"),
        say("Elapsed time", engineering(draw.between(50, 900))),
        "",
        "PROCESSING",
        say("Background subtraction", "No"),
        say("Slope correction", draw.pick("No", engineering(-2e-4))),
        "",
        "SCRIPT",
        *(say(key, value) for key, value in script.items()),
    ]


def _segments(fields: list[tuple[float, float, int]]) -> list[str]:
    """The table of segments: initial and final field and last row of each."""
    lines = [
        "",
        "Segment   Averaging      Initial        Field         Final                    Final ",
        " Number      Time         Field       Increment       Field         Pause      Index ",
        "             (s)           (T)           (T)           (T)           (s)     ",
    ]
    for k, (initial, final, last) in enumerate(fields):
        cells = [engineering(v) for v in (0.1, initial, 0.005, final, 1.0)]
        lines.append(f"{k + 1:07d}," + ",".join(cells) + f",{last:07d}")
    return lines


def _heading(units: tuple[str, str], adjusted: bool, symbols: bool) -> list[str]:
    """The lines of names above the numbers."""
    field, moment = f"({units[0]})", f"({'Am²' if units[1].startswith('A') else 'emu'})"
    count = 2 if adjusted else 1
    lines = ["", "     Raw           Raw         Adjusted      Adjusted  "] if adjusted else [""]
    lines.append("    Field         Moment   " * count)
    return lines + (["     " + f"{field:<14}{moment:<10}" * count] if symbols else [])


def _micromag(draw: Draw, lines: list[str], ending: str, truth: tuple[Loop, ...], *more: tuple[Loop, ...]) -> Layout:
    lines = [*lines, "", "MicroMag 2900/3900 Data File ends"]
    name = draw.pick("A4", "sample 12b", "LV23C", "noise.c100", "ODP_1-2") + draw.pick(
        ending, ending, ".000", "", ".txt"
    )
    return Layout("", {name: packed(draw, lines, ("cp1252", "utf-8"))}, (truth, *more))


@kind("MicroMag loop")
def micromag_loop(draw: Draw) -> Layout:
    system = draw.pick(*_SYSTEMS)
    units, (large, small) = _SYSTEMS[system][:2], _SYSTEMS[system][2:]
    n = 2 * draw.whole(80, 400)
    field = draw.size(0.1, 2) * large * major_loop(n)
    clean = small * draw.size(0.01, 100) * saturating(draw, field / field.max(), begin=1)
    raw = draw.noise(clean, 2e-3) + draw.pick(-1, 1, 0, 0.3) * draw.rng.uniform(0.05, 3) * np.ptp(
        clean
    ) * field / np.ptp(field)
    adjusted = draw.chance(0.5)
    h, m = Column("Field", field, units[0], engineering), Column("Moment", raw, units[1], engineering)
    columns = [h, m, h, Column("Moment", clean, units[1], engineering)] if adjusted else [h, m]
    script = {"Maximum field": engineering(field.max()), "Number of segments": "2", "Number of data": str(n)}
    parts = [(field.max(), -field.max(), n // 2), (-field.max(), field.max(), n)]
    if draw.chance(0.3):  # older software has a first segment without data
        parts.insert(0, (0.0, field.max(), 0))
    lines = _sections(draw, system, "Direct moment vs. field; Hysteresis loop", script)
    lines += _segments(parts) + _heading(units, adjusted, draw.chance(0.6)) + rows(columns, Dialect())
    return _micromag(draw, lines, draw.pick(".hys", ".hyst", ".loop"), (loop(h, m),))


@kind("MicroMag 2900, one header line")
def micromag_old(draw: Draw) -> Layout:
    n = 2 * draw.whole(80, 300)
    field = draw.size(1000, 20000) * major_loop(n)
    counts = draw.noise(4e4 * saturating(draw, field / field.max(), begin=1), 1e-3)
    form = lambda v: f"{v:+.6E}"
    h, m = Column("Field", field, "Oe", form), Column("Moment", counts, "", form)
    settings = ",".join(form(draw.size(1e-3, 1e4)) for _ in range(draw.whole(8, 16)))
    first = (
        f'"Model 2900 ASCII Data File",7,-1,{settings},142,284,3,"tg0{draw.whole(10, 99)}","09/12/2002  18:57",0,0,0,0'
    )
    name = draw.pick("tg010", "A 3") + draw.pick(".agm", ".AGM", ".dat", "")
    return Layout("", {name: packed(draw, [first, "", *rows([h, m], Dialect())], ("cp1252",))}, loops(loop(h, m)))


def reversal_curves(draw: Draw, irregular: bool, box: bool) -> list[tuple[np.ndarray, np.ndarray]]:
    """Fields and moments of curves from reversal fields, amplitude about 1, each from positive saturation.

    Args:
        irregular: steps grow away from zero.
        box: each curve ends at the side of a box of coercivity and interaction fields, before saturation.
    """
    device, curves = magnet(draw, draw.rng.uniform(0.15, 0.3)), []
    step = draw.rng.uniform(0.03, 0.06)
    for back in np.arange(0.25, draw.rng.uniform(-0.7, -0.4), -step):
        top = min(0.9, back + draw.rng.uniform(0.85, 0.95)) if box else 0.9
        field = np.arange(back, top, step)
        if irregular:
            field = np.sign(field) * np.abs(field) ** 1.2
        moment = device(np.r_[1.0, field], 1.0)[1:]
        if field.size > 3:
            curves.append((field, moment))
    return curves


@kind("MicroMag reversal curves")
def micromag_forc(draw: Draw) -> Layout:
    system = draw.pick(*_SYSTEMS)
    units, (large, small) = _SYSTEMS[system][:2], _SYSTEMS[system][2:]
    large, small = large * draw.size(0.1, 1), small * draw.size(0.01, 10)
    curves = reversal_curves(draw, irregular=False, box=draw.chance(0.7))
    script = {"Hb1": engineering(-0.1 * large), "Hc2": engineering(0.5 * large), "HSat": engineering(large)}
    script |= {"NForc": str(len(curves)), "NData": str(sum(f.size for f, _ in curves) + len(curves))}
    lines = _sections(draw, system, "First-order reversal curves", script) + _heading(units, False, draw.chance(0.6))
    truth, with_first = [], []
    for field, moment in curves:
        moment = draw.noise(moment, 2e-3)
        first = [
            Column("Field", np.array([large]), units[0], engineering),
            Column("Moment", np.array([small]), units[1], engineering),
        ]
        curve = [
            Column("Field", field * large, units[0], engineering),
            Column("Moment", moment * small, units[1], engineering),
        ]
        lines += [*rows(first, Dialect()), "", *rows(curve, Dialect()), ""]
        truth.append(loop(*curve))
        with_first.append(
            Loop(*(np.r_[a.written, b.written] for a, b in zip(first, curve, strict=True)), units[0], units[1])
        )
    return _micromag(draw, lines[:-1], draw.pick(".frc", ".forc"), tuple(truth), tuple(with_first))


@kind("MicroMag irregular reversal curves")
def micromag_segments(draw: Draw) -> Layout:
    """Segments: hold at saturation, ramp without data, hold at the reversal field, and the measured sweep."""
    large, small = draw.size(0.1, 1), 1e-6 * draw.size(0.01, 10)
    parts, lines, truth, with_hold, last = [], [], [], [], 0
    held = None
    for field, moment in reversal_curves(draw, irregular=True, box=True):
        moment = draw.noise(moment, 2e-3)
        first = [
            Column("Field", np.array([large]), "T", engineering),
            Column("Moment", np.array([small]), "A*m^2", engineering),
        ]
        curve = [
            Column("Field", field * large, "T", engineering),
            Column("Moment", moment * small, "A*m^2", engineering),
        ]
        lines += rows(first, Dialect()) + rows(curve, Dialect())
        back = curve[0].written[0]
        top = curve[0].written[-1]
        parts += [
            (large, large, last + 1),
            (large, back, last + 1),
            (back, back, last + 2),
            (back, top, last + 1 + field.size),
        ]
        parts += [(top, large, last + 1 + field.size)]
        last += 1 + field.size
        truth.append(loop(*curve))
        held = first
        with_hold.append(Loop(*(np.r_[a.written, b.written] for a, b in zip(held, curve, strict=True)), "T", "A*m^2"))
    script = {"Number of segments": str(len(parts)), "Number of data": str(last)}
    head = _sections(draw, "Hybrid SI", "Direct moment vs. field; Multiple segments", script)
    head += _segments(parts) + _heading(("T", "A*m^2"), False, True)
    return _micromag(draw, head + lines, draw.pick(".irforc", ".seg"), tuple(truth), tuple(with_hold))
