"""Magnetometers of Lake Shore and Quantum Design, MagIC tables and MOKE."""

from __future__ import annotations

import itertools

import numpy as np

from .drawing import Draw
from .physics import major_loop, saturating, triangle
from .registry import kind
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, rows, table, titles


@kind("Lake Shore 8600 CSV")
def lake_shore(draw: Draw) -> Layout:
    n = 2 * draw.whole(80, 300)
    field = draw.size(2000, 20000) * major_loop(n)
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


@kind("table of a micromagnetic program")
def micromagnetic(draw: Draw) -> Layout:
    """MuMax3 and OOMMF: all components of field and magnetization, of which those along the field are the loop."""
    n = 2 * draw.whole(80, 300)
    share, axis, tilt = major_loop(n), draw.whole(0, 2), draw.rng.uniform(0, 0.1)
    m = 0.98 * saturating(draw, share, begin=1) / 2
    m /= max(1.0, 1.02 * np.abs(m).max())
    across = np.sqrt(1 - m**2)
    free = 0.5 * np.sin(3 * m)
    vector = np.roll([m, across * free, across * np.sqrt(1 - free**2)], axis, axis=0)
    field = np.roll([share, tilt * share, 0 * share], axis, axis=0) * draw.size(0.02, 2)
    if draw.chance(0.5):
        b = [Column(f"B_ext{letter}", values, "T", ".8g") for letter, values in zip("xyz", field, strict=True)]
        reduced = [Column(f"m{letter}", values, "", ".8g") for letter, values in zip("xyz", vector, strict=True)]
        columns = [Column("t", np.zeros(n), "s", ".0f"), *reduced, *b]
        names = "\t".join(f"{column.name} ({column.unit})" for column in columns)
        lines, name = [f"# {names}", *rows(columns, Dialect("\t"))], "table.txt"
    else:
        of_field = [Column(f"Oxs_UZeeman::B{c}", 1e3 * v, "mT", ".12g") for c, v in zip("xyz", field, strict=True)]
        driver = [Column(f"Oxs_MinDriver::m{c}", v, "", ".12g") for c, v in zip("xyz", vector, strict=True)]
        b, reduced = of_field, driver
        size = Column("Oxs_UZeeman::B", np.sqrt(np.sum((1e3 * field) ** 2, axis=0)), "mT", ".12g")
        energy = Column("Oxs_CGEvolve::Total energy", -1e-17 * m * share, "J", ".12g")
        steps = Column("Oxs_MinDriver::Iteration", np.cumsum(draw.rng.integers(20, 400, n)).astype(float), "", ".0f")
        columns = [energy, size, *b, steps, *reduced]
        above = ["# ODT 1.0", "# Table Start", "# Title: mmArchive Data Table"]
        brace = lambda text: f"{{{text}}}" if " " in text or not text else text
        named = "# Columns: " + " ".join(brace(column.name) for column in columns)
        units = "# Units: " + " ".join(brace(column.unit) for column in columns)
        lines, name = [*above, named, units, *rows(columns, Dialect(" ")), "# Table End"], "loop.odt"
    return Layout("", {name: packed(draw, lines)}, loops(loop(b[axis], reduced[axis])))


@kind("columns listed in the preamble")
def listed_columns(draw: Draw) -> Layout:
    """Numbered names below each other, as EasyVSM, Sea-Bird and hand-written comments have them, then rows without names."""
    n = 2 * draw.whole(80, 300)
    field = draw.size(200, 20000) * major_loop(n)
    m = draw.noise(draw.size(1e-4, 10) * saturating(draw, field / field.max(), begin=1), 1e-3)
    h, m = Column("Applied Field", field, "Oe", ".4f"), Column("Moment", m, "emu", ".8e")
    columns = [
        Column("Time since start", 0.5 * np.arange(n) + draw.rng.uniform(0, 0.01, n), "sec", ".2f"),
        Column("Temperature", 295 + draw.rng.normal(0, 0.02, n), "K", ".2f"),
        h,
        Column("Field Angle", np.zeros(n), "deg", ".1f"),
        m,
    ]
    columns = [column for column in columns if column in (h, m) or draw.chance(0.7)]
    first, (opening, closing) = draw.pick(0, 1), draw.pick("[]", "()")
    line = draw.pick("@Column {}: {}", "# {} = {}", "# name {} = {}", "# column {}: {}", "Col{}: {}")
    listed = [line.format(first + k, f"{c.name} {opening}{c.unit}{closing}") for k, c in enumerate(columns)]
    correction = [
        f"{k:.6f}   {1 + 1e-4 * k:.6E}" + 4 * "   0.0E+0" for k in range(draw.pick(0, 12))
    ]  # of the pick-up coils
    above = [
        "VSM record",
        "Operator: abc",
        *correction,
        *listed,
        *["@@Data", "End of header", "*END*"][: draw.whole(0, 1)],
    ]
    lines = above + rows(columns, Dialect(draw.pick("\t", " ", ",")))
    return Layout("", {draw.pick("film.VHD", "cast.cnv", "loop.txt"): packed(draw, lines)}, loops(loop(h, m)))


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
        field = draw.between(0.3, 1.5) * major_loop(n)
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


@kind("curves at held temperatures")
def held(draw: Draw) -> Layout:
    """M(H) at several temperatures below each other, loops or magnetization curves, with nothing between them."""
    n, loops_of = draw.whole(40, 120), draw.chance(0.5)
    top = draw.size(1000, 70000)
    held_at = np.cumsum(draw.rng.uniform(3, 40, draw.whole(2, 8))) + draw.pick(2, 250)
    columns, clock = [], 0.0
    for kelvin in held_at:
        drive = major_loop(2 * n) if loops_of else np.linspace(0, 1, n)
        moment = saturating(draw, drive, begin=1) if loops_of else np.tanh(2 * drive)
        time = clock + draw.rng.uniform(4, 6, drive.size).cumsum()
        clock = time[-1] + 600
        measured = np.clip(kelvin + draw.rng.normal(0, 0.005, drive.size), kelvin - 0.02, kelvin + 0.02)
        columns.append((time, measured, top * drive, draw.noise((1 - kelvin / 700) * moment, 1e-4)))
    time, kelvin, field, moment = (np.concatenate(column) for column in zip(*columns, strict=True))
    h, m = Column("Magnetic Field", field, "Oe", ".5g"), Column("Moment", moment, "emu", ".6e")
    beside = [Column("Time Stamp", time, "sec", ".2f"), Column("Temperature", kelvin, "K", ".3f")]
    lines = table(draw, [*beside[draw.pick(0, 1) :], h, m], Dialect(draw.pick(",", "\t"), style="parentheses"))
    bounds = np.cumsum([0, *(len(column[0]) for column in columns)])
    truth = tuple(loop(h, m, rows=slice(a, b)) for a, b in itertools.pairwise(bounds))
    return Layout("", {draw.pick("MvsH.dat", "mce.csv"): packed(draw, lines, ("utf-8",))}, (truth,))
