"""Magnetometers: MicroMag loops, segments and reversal curves, Lake Shore, Quantum Design, MagIC tables and MOKE."""

from __future__ import annotations

import numpy as np

from .drawing import Draw
from .physics import magnet, saturating, triangle
from .registry import kind
from .truth import Layout, Loop, loops
from .writing import Column, Dialect, engineering, loop, packed, rows, table, titles

_SYSTEMS = {"Hybrid SI": ("T", "A*m^2", 1.0, 1e-6), "cgs": ("Oe", "emu", 1e4, 1e-3)}


def major_loop(draw: Draw, n: int) -> np.ndarray:
    """A field of amplitude 1 from positive saturation down and up again, shape (n,)."""
    return triangle(n, 1, start=0.25)


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
    field = draw.size(0.1, 2) * large * major_loop(draw, n)
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
    field = draw.size(1000, 20000) * major_loop(draw, n)
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


@kind("Lake Shore 8600 CSV")
def lake_shore(draw: Draw) -> Layout:
    n = 2 * draw.whole(80, 300)
    field = draw.size(2000, 20000) * major_loop(draw, n)
    m = draw.noise(draw.size(1e-4, 10) * saturating(draw, field / field.max(), begin=1), 1e-3)
    h, m = Column("Field", field, "Oe", ".6f"), Column("Moment (m)", m, "emu", ".8e")
    t = Column("Time Stamp", 0.5 * np.arange(n) + draw.rng.uniform(0, 0.01, n), "s", ".4f")
    beside = [
        Column("Step", np.ones(n), "", ".0f"),
        Column("Iteration", np.ones(n), "", ".0f"),
        Column("Segment", 1.0 + (np.arange(n) >= n // 2), "", ".0f"),
    ]
    more = [
        Column("Temperature", 295 + draw.rng.normal(0, 0.02, n), "K", ".3f"),
        Column("Field Status", np.full(n, "Locked")),
    ]
    columns = [*beside[: draw.whole(0, 3)], *([t] if draw.chance(0.7) else []), h, m, *more[: draw.whole(0, 2)]]
    above = [
        "##HEADER",
        "Lake Shore 8600 Series VSM",
        "Start Time: 5/12/2021 10:12:13 AM",
        "Sample ID: film 12",
        "##DATA TABLE",
    ]
    lines = above[: draw.pick(0, 5)] + table(draw, columns, Dialect(",", style=draw.pick("brackets", "parentheses")))
    return Layout("", {draw.pick("loop.csv", "FILM12 MvsH.csv"): packed(draw, lines)}, loops(loop(h, m)))


@kind("Quantum Design .dat")
def quantum_design(draw: Draw) -> Layout:
    n = 4 * draw.whole(40, 150)
    field = draw.size(5000, 70000) * triangle(n, 1.25)
    moment = (
        draw.noise(draw.size(1e-6, 1) * saturating(draw, field / field.max()), 1e-3) - draw.pick(0, 0, 1e-7) * field
    )
    temperature = (
        draw.pick(2.0, 5.0, 10.0, 300.0) + draw.rng.normal(0, 0.003, n) + draw.pick(0, 0.02) * np.linspace(0, 1, n)
    )
    h, m = Column("Magnetic Field", field, "Oe", ".5f"), Column("Moment", moment, "emu", ".9E")
    t = Column("Time Stamp", 3.6e9 + np.cumsum(draw.rng.uniform(2, 6, n)), "sec", ".3f")
    dialect = Dialect(",", style=draw.pick("parentheses", "parentheses", "parentheses"))
    error = Column("M. Std. Err.", np.abs(draw.rng.normal(0, 1e-8, n)), "emu", ".4E")
    filler = [
        Column("Transport Action", np.ones(n), "", ".0f"),
        Column("Averaging Time", np.ones(n), "sec", ".0f"),
        Column("Frequency", np.full(n, 40.0), "Hz", ".0f"),
        Column("Peak Amplitude", 2 + draw.rng.normal(0, 1e-4, n), "mm", ".6f"),
        Column("Center Position", 34.5 + draw.rng.normal(0, 1e-3, n), "mm", ".4f"),
        Column("Min. Temperature", temperature - 0.01, "K", ".5f"),
        Column("Max. Temperature", temperature + 0.01, "K", ".5f"),
        Column("Min. Field", field - 0.2, "Oe", ".5f"),
        Column("Max. Field", field + 0.2, "Oe", ".5f"),
        Column("Mass", np.full(n, np.nan), "grams", ".1f"),
        Column("Pressure", 5 + draw.rng.normal(0, 0.1, n), "Torr", ".3f"),
    ]
    chosen = [column for column in filler if draw.chance(0.6)]
    columns = [
        Column("Comment", np.full(n, "")),
        t,
        Column("Temperature", temperature, "K", ".5f"),
        h,
        m,
        error,
        *chosen,
    ]
    lines = [
        "[Header]",
        "TITLE," + draw.pick("ACMS Data", "VSM Data File", "film 7"),
        "BYAPP," + draw.pick("VSM,1.48", "MPMS3,1.0", "MPMS MultiVu,1.60"),
        "INFO,PPMS serial number 512,APPNAME",
        "INFO," + draw.pick("3.2,SAMPLE_MASS", "none,SAMPLE_MATERIAL"),
        "FIELDGROUP,TEST,1,2",
        "DATATYPE,TIME,2",
        "[Data]",
        *table(draw, [Column(c.name, c.values, c.unit, c.form, c.unit) for c in columns], dialect),
    ]
    h = Column(h.name, h.values, "Oe", h.form)
    return Layout(
        "", {draw.pick("MvsH_300K.dat", "film7.DAT"): packed(draw, lines, ("utf-8", "cp1252"))}, loops(loop(h, m))
    )


def _magic(draw: Draw, first: str, names: dict[str, str], title: str) -> Layout:
    """A table of specimens, in one of the two data models."""
    truth, lines, count = [], [], draw.whole(1, 4)
    per_mass = draw.chance(0.4)
    unit = "Am2/kg" if per_mass else "A*m^2"
    for k in range(count):
        n = 2 * draw.whole(30, 120)
        field = draw.between(0.3, 1.5) * major_loop(draw, n)
        h = Column(names["field"], field, "T", ".4e")
        moment = draw.noise(draw.size(1e-8, 1e-4) * saturating(draw, field / field.max(), begin=1), 1e-3)
        m = Column(names["mass" if per_mass else "moment"], moment, unit, ".4e")
        specimen = f"IS{k + 1:02d}a-{k + 1}"
        columns = [
            Column(names["specimen"], np.full(n, specimen)),
            Column(names["experiment"], np.full(n, f"{specimen}:LP-HYS")),
            Column(names["method"], np.full(n, "LP-HYS")),
            Column(names["number"], 1.0 + np.arange(n), "", ".0f"),
            h,
            m,
            Column(names["temperature"], np.full(n, 273.0), "", ".0f"),
            Column(names["flag"], np.full(n, "g")),
        ]
        truth.append(loop(h, m))
        dialect = Dialect("\t", style="none")
        lines += (titles(columns, dialect) if not lines else []) + rows(columns, dialect)
    lines = [f"{first}\t{title}", *lines]
    if draw.chance(0.3):
        lines += [">>>>>>>>>>", f"{first}\t{draw.pick('sites', 'er_sites')}", "site\tlat\tlon", "IS\t31.0\t35.1"]
    return Layout(
        "", {draw.pick("measurements.txt", "magic.dat", "hysteresis"): packed(draw, lines, ("utf-8",))}, (tuple(truth),)
    )


@kind("MagIC 3 table")
def magic_3(draw: Draw) -> Layout:
    names = {"field": "meas_field_dc", "moment": "magn_moment", "mass": "magn_mass", "specimen": "specimen"}
    names |= {"experiment": "experiment", "method": "method_codes", "number": "measurement", "flag": "quality"}
    return _magic(draw, draw.pick("tab", "tab delimited", "tab "), names | {"temperature": "meas_temp"}, "measurements")


@kind("MagIC 2 table")
def magic_2(draw: Draw) -> Layout:
    names = {"field": "measurement_lab_field_dc", "moment": "measurement_magn_moment", "mass": "measurement_magn_mass"}
    names |= {"specimen": "er_specimen_name", "experiment": "magic_experiment_name", "method": "magic_method_codes"}
    names |= {"number": "measurement_number", "flag": "measurement_flag", "temperature": "treatment_temp"}
    return _magic(draw, draw.pick("tab", "tab "), names, "magic_measurements")


@kind("MOKE")
def moke(draw: Draw) -> Layout:
    n, unit = 2 * draw.whole(80, 300), draw.pick("mT", "Oe", "T", "kA/m")
    size = {"mT": 1.0, "Oe": 10.0, "T": 1e-3, "kA/m": 1.0}[unit]
    field = draw.size(5, 500) * size * draw.pick(1, -1) * triangle(n, draw.whole(1, 2), 0.25)
    signal = draw.pick(1, -1) * saturating(draw, field / np.abs(field).max(), begin=np.sign(field[0]))
    out = draw.pick(
        ("Kerr Signal", "mV"),
        ("Intensity", "mV"),
        ("Kerr rotation", "mdeg"),
        ("MOKE signal", "V"),
        ("Kerr intensity", ""),
    )
    offset = draw.between(-5, 5)
    h = Column(draw.pick("Field", "Magnetic field", "H", "B", "Applied field"), draw.noise(field, 5e-4), unit, ".5g")
    if h.name == "B" and unit not in ("mT", "T"):
        h = h.renamed("H")
    y = Column(out[0], draw.noise(offset + draw.size(0.1, 5) * signal, 1e-2), out[1], ".5f")
    beside = [Column("Point", 1.0 + np.arange(n), "", ".0f"), Column("Magnet current", field / size / 50, "A", ".4f")]
    columns = [*beside[:1], h, y] if draw.chance(0.4) else [h, y]
    columns += beside[1:] if draw.chance(0.3) else []
    style = draw.pick("parentheses", "brackets", "underscore", "row", "slash")
    above = ["MOKE longitudinal", "Sample: Py 20 nm", "Averages: 16"] if draw.chance(0.5) else []
    lines = above + table(draw, columns, Dialect(draw.pick("\t", ",", ";"), style=style))
    return Layout("", {draw.pick("py20.txt", "loop_03.dat", "kerr.csv"): packed(draw, lines)}, loops(loop(h, y)))


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
