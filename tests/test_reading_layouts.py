"""Files of single instruments and layouts, found by their content: each file is made here, and its numbers are known."""

from __future__ import annotations

import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Dataset, Record
from hystfit.data.circulation import circulation
from hystfit.errors import DataError
from hystfit.outcome import Code, Severity
from hystfit.params.units import conversion
from hystfit.reading import read

ANGLE = np.linspace(np.pi / 2, np.pi / 2 + 2 * np.pi, 81)
FIELD = np.sin(ANGLE)  # from positive saturation down and up again
MOMENT = np.tanh(3 * FIELD - 0.9 * np.sign(np.append(-1, np.diff(FIELD))) * (1 - FIELD**2))


def written(folder: Path, content: str | bytes, name: str = "loop.dat") -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode("cp1252" if "²" in content else "utf-8"))
    return path


def one(path: Path, **options: object) -> Record:
    data = read(path, **options)  # type: ignore[arg-type]
    assert isinstance(data, Record), [record.name for record in data]
    return data


def is_loop(record: Record, u: np.ndarray = FIELD, y: np.ndarray = MOMENT) -> None:
    np.testing.assert_allclose(record.u, u, rtol=2e-6, atol=1e-9)
    np.testing.assert_allclose(record.y, y, rtol=2e-6, atol=1e-9)


# Magnetometers of MicroMag and Lake Shore ---------------------------------------------------------------------------------------

SECTIONS = """INSTRUMENT
Configuration                   VSM
Units of measure                {system}
Temperature in                  Kelvin

SAMPLE
Mass                           +12.50000E-03
Volume                          N/A

PROCESSING
Slope correction               -225.0917E-06

CHARACTERIZATION
Initial slope                   N/A
Saturation                     +443.9182E-06
Remanence                      +75.31752E-06
Coercivity                     +16.31905E-03

SCRIPT
Number of segments              {count}

"""
SEGMENTS = {
    15: "Segment   Averaging       Field                      Initial        Final      Final\n"
    " Number      Time       Increment       Pause         Field         Field      Index\n",
    16: "Segment   Averaging      Initial        Field         Final                    Final \n"
    " Number      Time         Field       Increment       Field         Pause      Index \n"
    "             (s)           (T)           (T)           (T)           (s)     \n",
}


def segment(series: int, number: int, initial: float, final: float, index: int) -> str:
    order = (0.1, 0.05, 1.0, initial, final) if series == 15 else (0.1, initial, 0.05, final, 1.0)
    return f"{number:07d}," + ",".join(f"{value:+.6E}" for value in order) + f",{index:07d}\n"


def magnetometer(
    series: int, *, adjusted: bool, units: bool, extra: bool, system: str = "Hybrid SI", first: bool = True
) -> str:
    """A loop of three segments, of which the first has no data."""
    names = ["Field", "Moment", *["Temperature"] * extra, *["Field", "Moment"] * adjusted]
    columns = [FIELD, MOMENT + 0.4 * FIELD, *[np.full(81, 295.0)] * extra, *[FIELD, MOMENT] * adjusted]
    upper = ["Raw", "Raw"] * (series == 15) + ["Adjusted", "Adjusted"]
    symbols = {"Field": "(T)", "Moment": "(Am\u00b2)", "Temperature": "(K)"}
    text = "MicroMag 2900/3900 Data File (Series 0016.002)\nDirect moment vs. field; Hysteresis loop\n\n" * first
    text += SECTIONS.format(system=system, count=3) + SEGMENTS[series]
    text += segment(series, 1, 0, 1, 0) + segment(series, 2, 1, -1, 41) + segment(series, 3, -1, 1, 81) + "\n"
    if adjusted:
        text += " " * 14 * (len(names) - len(upper)) + "".join(f"{word:>14}" for word in upper) + "\n"
    text += "".join(f"{name:>14}" for name in names) + "\n"
    text += ("".join(f"{symbols[name]:>14}" for name in names) + "\n") * units
    rows = [",".join(f"{value:+.6E}" for value in row) + "\n" for row in zip(*columns, strict=True)]
    return text + "".join([*rows[:41], "\n" * (series == 16), *rows[41:]]) + "\nMicroMag 2900/3900 Data File ends\n"


@pytest.mark.parametrize("name", ["a.hys", "a.loop", "a.000", "a.agm", "a"])
@pytest.mark.parametrize(
    ("series", "units", "extra", "first"), [(15, False, False, True), (16, True, True, True), (16, True, False, False)]
)
def test_a_magnetometer_writes_one_loop_raw_and_adjusted(
    name: str, series: int, units: bool, extra: bool, first: bool, tmp_path: Path
) -> None:
    path = written(tmp_path, magnetometer(series, adjusted=True, units=units, extra=extra, first=first), name)
    record = one(path)
    is_loop(record, FIELD, MOMENT + 0.4 * FIELD)
    assert (record.u_name, record.y_name, record.u_unit, record.y_unit) == ("Field", "Moment", "T", "Am2")
    assert any("--adjusted" in note.text for note in record.notes)
    stated = {one.quantity: (one.value, one.unit) for one in record.stated if one.quantity}
    assert stated["saturation"] == (443.9182e-6, "Am2")
    assert stated["remanence"] == (75.31752e-6, "Am2")
    assert stated["coercive_input"] == (16.31905e-3, "T")
    assert record.metadata == {"Mass": "+12.50000E-03"} | ({"Temperature": "295"} if extra else {})
    is_loop(one(path, input="Field", output="Adjusted Moment"))
    record = one(path, adjusted=True)
    is_loop(record)
    assert (record.u_name, record.y_name, record.reading["adjusted"]) == ("Adjusted Field", "Adjusted Moment", "true")


@pytest.mark.parametrize("digits", [7, 13])
def test_the_table_of_segments_and_the_last_line_are_no_rows(digits: int, tmp_path: Path) -> None:
    text = magnetometer(16, adjusted=True, units=False, extra=False)
    text = re.sub(r"^0{6}(\d),", rf"{0:0{digits - 1}d}\1,", text, flags=re.MULTILINE)
    text = text.replace("PROCESSING\n", "Gradient demagnetize?   Yes\nTemperature control     No\n\nPROCESSING\n")
    record = one(written(tmp_path, text, "a.hys"))
    is_loop(record, FIELD, MOMENT + 0.4 * FIELD)
    assert (record.u_unit, record.y_unit) == ("T", "Am2")
    assert not any("with text where numbers are expected" in note.text for note in record.notes)
    assert record.metadata == {"Mass": "+12.50000E-03"}


def test_reversal_curves_of_a_balance_have_units_of_its_settings(tmp_path: Path) -> None:
    """The file of a VFTB: settings of a MicroMag file, of which most are missing, then blocks of numbers without names."""
    head = "VFTB FORC Data File\nFirst-order reversal curves\nUnits of measure:  cgs\nN/A  N/A\n\nHSat = N/A\nNCrv = N/A\n\n"
    rising = [np.linspace(a, 900.0, 12 + 2 * k) for k, a in enumerate(np.linspace(850.0, -900.0, 12))]
    lines = [[f"{u:+.6E},{np.tanh(u / 300 - 0.01 * k):+.6E}\n" for u in field] for k, field in enumerate(rising)]
    blocks = "\n".join("+9.000000E+02,+9.950000E-01\n\n" + "".join(block) for block in lines)
    data = Dataset.of(read(written(tmp_path, head + blocks, "a.frc")))
    assert len(data) == len(rising)
    assert {(record.u_name, record.u_unit, record.y_name, record.y_unit) for record in data} == {
        ("Field", "Oe", "Moment", "emu")
    }


@pytest.mark.parametrize("apart", [False, True])
def test_heating_and_cooling_below_each_other_are_one_loop(apart: bool, tmp_path: Path) -> None:
    """Two tables with titles, of which the second goes on where the first ends, or does not."""
    heating, cooling = np.linspace(25, 700, 50), np.linspace(700, 30, 48)
    magnetization = lambda x: np.tanh((650 - x) / 90)
    below = 1e-6 * (700 - cooling) * (cooling - 30) + apart
    tables = [(heating, magnetization(heating)), (cooling, magnetization(cooling) - below)]
    text = "sample 20080702\n" + "".join(
        f"Set {k}:\ntemp / centigrade\tmag / emu / g\n"
        + "".join(f"{u:.2f}\t{y:.5f}\n" for u, y in zip(*table, strict=True))
        for k, table in enumerate(tables, 1)
    )
    data = Dataset.of(read(written(tmp_path, text, "a.rmp")))
    assert [len(record) for record in data] == ([50, 48] if apart else [98])
    assert (data[0].u_unit, data[0].y_unit) == ("centigrade", "emu / g")
    assert sum(note.code is Code.CURVES for note in data[0].notes) == 1


def test_remanence_curves_keep_what_the_magnetometer_states(tmp_path: Path) -> None:
    """An acquisition and a demagnetization curve, each from zero field, in two segments."""
    field = np.linspace(0, 1, 41)
    sections = SECTIONS.replace("Coercivity           ", "Coercivity (remanent)")
    text = "MicroMag 2900/3900 Data File (Series 0016.002)\nRemanence curves:  IRM + DCD\n\n"
    text += sections.format(system="Hybrid SI", count=2) + SEGMENTS[16]
    text += segment(16, 1, 0, 1, 41) + segment(16, 2, 0, -1, 82) + f"\n{'Field':>14}{'Remanence':>14}\n"
    both = np.concatenate([field, -field]), np.concatenate([field**2, 1 - 2 * field**2])
    text += "".join(f"{u:+.6E},{y:+.6E}\n" for u, y in zip(*both, strict=True))
    data = Dataset.of(read(written(tmp_path, text, "dcd.001")))
    assert [len(record) for record in data] == [41, 41]
    stated = {one.quantity: one.value for one in data[1].stated}
    assert stated["coercive_input"] == 16.31905e-3
    assert data[1].y_name == "Remanence"


def test_a_magnetometer_without_adjusted_columns(tmp_path: Path) -> None:
    path = written(tmp_path, magnetometer(16, adjusted=False, units=False, extra=False, system="cgs"), "a.hys")
    record = one(path)
    is_loop(record, FIELD, MOMENT + 0.4 * FIELD)
    assert (record.u_unit, record.y_unit) == ("Oe", "emu")
    with pytest.raises(DataError, match=r"no adjusted columns.*--adjusted"):
        read(path, adjusted=True)


def test_an_old_magnetometer_has_its_settings_in_one_line(tmp_path: Path) -> None:
    rows = "".join(f"{1e4 * u:+.6E},{3e4 * y:+.6E}\n" for u, y in zip(FIELD, MOMENT, strict=True))
    record = one(
        written(
            tmp_path, f'"Model 2900 ASCII Data File",7,-1,+5.0E-01,0,142\n{rows}"Model 2900 Data File ends"\n', "a.agm"
        )
    )
    is_loop(record, 1e4 * FIELD, 3e4 * MOMENT)
    assert (record.u_name, record.u_unit, record.y_unit) == ("Field", "Oe", "")
    rows = "".join(
        f"{-300 * k:+.6E},{0.03 - 0.01 * k:+.6E},{-0.01:+.6E}\n" for k in range(40)
    )  # remanence after each field
    text = f'"Model 2900 ASCII Data File",7,-1,"TG045"\n\n{rows}"Model 2900 Data File ends"\n'
    record = one(written(tmp_path, text, "a.irm"))
    assert (record.u_name, record.u_unit, record.y_name) == ("Field", "Oe", "Moment")


def test_a_ramp_that_returns_to_where_it_began_parts_curves(tmp_path: Path) -> None:
    """Two sweeps from the same field, between which the magnetometer saturates the sample without measuring."""
    down = np.linspace(0.5, -0.5, 21)
    table = [(0.5, -0.5, 21), (-0.5, 1.0, 21), (1.0, -0.5, 21), (-0.5, 0.5, 42)]
    text = "MicroMag 2900/3900 Data File (Series 0016.002)\nDirect moment vs. field; Multiple segments\n\n"
    text += SECTIONS.format(system="Hybrid SI", count=4) + SEGMENTS[16]
    text += "".join(segment(16, k, *row) for k, row in enumerate(table, 1)) + f"\n{'Field':>14}{'Moment':>14}\n"
    text += "".join(f"{u:+.6E},{np.tanh(3 * u):+.6E}\n" for u in (*down, *down[::-1]))
    assert [record.u.tolist() for record in Dataset.of(read(written(tmp_path, text, "a.001")))] == [
        pytest.approx(down.tolist()), pytest.approx(down[::-1].tolist())
    ]  # fmt: skip


def test_ramps_that_a_magnetometer_does_not_measure_part_reversal_curves(tmp_path: Path) -> None:
    rows, table, truth, number = [], [], [], itertools.count(1)
    for reversal in (0.5, 0.1, -0.4):
        rising = np.linspace(reversal, 1.0, 4 + int(10 * (1 - reversal)))
        truth.append(np.concatenate([[1.0], rising]))
        rows.append([1.0])
        table.append(segment(16, next(number), 1.0, 1.0, sum(map(len, rows))))
        table.append(segment(16, next(number), 1.0, reversal, sum(map(len, rows))))
        rows.append(rising.tolist())
        table.append(segment(16, next(number), reversal, 1.0, sum(map(len, rows))))
    text = "MicroMag 2900/3900 Data File (Series 0016.002)\nDirect moment vs. field; Multiple segments\n\n"
    text += (
        SECTIONS.format(system="Hybrid SI", count=9)
        + SEGMENTS[16]
        + "".join(table)
        + "\n    Field         Moment   \n     (T)          (Am\u00b2)    \n"
    )
    text += "\n".join("".join(f"{u:+.6E},{np.tanh(u):+.6E}\n" for u in block) for block in rows)
    data = read(written(tmp_path, text, "a.irforc"))
    assert isinstance(data, Dataset)
    assert len(data) == 3
    for record, u in zip(data, truth, strict=True):
        is_loop(record, u, np.tanh(u))
        assert record.weight.tolist() == [0.0] + [1.0] * (
            u.size - 1
        )  # the point at saturation, from which the ramp starts


# Tables after each other ---------------------------------------------------------------------------------------------------------


def aixacct(*, above: bool) -> str:
    """Three measurements, the results in a summary alone or also above each table."""
    lines = ["DynamicHysteresisResult", "", "Table 1", "Table No [#]\tVc+ [V]\tVc- [V]\tPr+ [uC/cm2]\tWloss [uJ/cm2]\t"]
    lines += [f"{k}.0e+000\t{0.1 * k:e}\t{-0.1 * k:e}\t{k:e}\t{7 * k:e}\t" for k in (1, 2, 3)]
    lines += ["", "DynamicHysteresis", "Program: aixPlorer", "TfaVersion: 4.11.0", ""]
    for k in (1, 2, 3):
        lines += [f"Table {k}", "Timestamp: 08/23/2019 14:17:12", f"SampleName: S{k}", "Area [mm2]: 60"]
        lines += [f"Vc+ [V]: {0.1 * k}", f"Vc- [V]: {-0.1 * k}"] * above
        lines.append("Time [s]\tV+ [V]\tI1 [A]\tP1 [uC/cm2]\t")
        lines += [f"{j / 80:e}\t{k * u:e}\t0\t{k * y:e}\t" for j, (u, y) in enumerate(zip(FIELD, MOMENT, strict=True))]
        lines.append("")
    return "\n".join(lines)


@pytest.mark.parametrize("above", [True, False])
def test_tables_after_a_summary_are_records_with_their_results(above: bool, tmp_path: Path) -> None:
    data = read(written(tmp_path, aixacct(above=above)))
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == ["Table 1", "Table 2", "Table 3"]
    for k, record in enumerate(data, 1):
        is_loop(record, k * FIELD, k * MOMENT)
        assert record.t is not None
        assert (record.u_unit, record.y_unit) == ("V", "uC/cm2")
        stated = {one.label: one for one in record.stated}
        assert stated["Vc+"].value == pytest.approx(0.1 * k)
        assert (stated["Vc-"].quantity, stated["Vc-"].unit) == ("coercive_input", "V")
        assert (stated["Wloss"].quantity, stated["Wloss"].value) == ("loop_area", pytest.approx(7 * k))
        assert record.metadata["SampleName"] == f"S{k}"


def test_a_single_table_after_a_summary(tmp_path: Path) -> None:
    """The summary has as many columns as the measurement, and its header stands above its row."""
    text = "DynamicHysteresisResult\n\nTable No [#]\tVc+ [V]\tPr+ [uC/cm2]\n1\t0.5\t3\n\nTable [1]\nTime [s]\tV+ [V]\tP1 [uC/cm2]\n"
    text += "".join(f"{j / 80:e}\t{u:e}\t{y:e}\n" for j, (u, y) in enumerate(zip(FIELD, MOMENT, strict=True)))
    record = one(written(tmp_path, text))
    is_loop(record)
    assert [(one.label, one.value) for one in record.stated] == [("Vc+", 0.5), ("Pr+", 3.0)]


def test_titles_of_tables_name_records_unless_time_goes_on(tmp_path: Path) -> None:
    table = lambda k: "x_mm F_N\n" + "".join(f"{k * u:.6f} {k * y:.6f}\n" for u, y in zip(FIELD, MOMENT, strict=True))
    data = read(written(tmp_path, "\n".join(f"Cycle {k}\n{table(k)}" for k in (1, 2, 3))))
    assert [record.name for record in Dataset.of(data)] == ["Cycle 1", "Cycle 2", "Cycle 3"]
    page = lambda k: "t_s,x_mm,F_N\n" + "".join(f"{81 * k + j},{FIELD[j]:.6f},{MOMENT[j]:.6f}\n" for j in range(81))
    assert len(one(written(tmp_path, "".join(f"page {k}\n{page(k)}" for k in (0, 1))))) == 162


def test_names_above_a_line_that_is_no_row(tmp_path: Path) -> None:
    rows = "".join(f"{j}\t{u}\t{y}\n" for j, (u, y) in enumerate(zip(FIELD, MOMENT, strict=True)))
    record = one(
        written(
            tmp_path,
            f"@Operator Kim\nTime\tApplied Field\tSignal\n[s]\t[Oe]\t[emu]\n@@Data\nNew Section: 0\n{rows}@@END\n",
        )
    )
    is_loop(record)
    assert (record.u_name, record.u_unit, record.y_unit) == ("Applied Field", "Oe", "emu")


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_the_table_with_most_rows_is_read_of_those_with_other_columns(mark: str, tmp_path: Path) -> None:
    text = f"Calibration\nload_N{mark}signal_V\n" + "".join(f"{k}{mark}{2 * k + 0.5}\n" for k in range(6))
    text += f"\nMeasurement\nH (A/m){mark}B (T)\n" + "".join(
        f"{u}{mark}{y}\n" for u, y in zip(FIELD, MOMENT, strict=True)
    )
    record = one(written(tmp_path, text))
    is_loop(record)
    assert (record.u_unit, record.y_unit) == ("A/m", "T")
    assert any(note.code is Code.LEFT_OUT and "line 3" in note.text for note in record.notes)


# MagIC, and specimens below each other -------------------------------------------------------------------------------------------


def magic(version: int) -> str:
    fields = "er_specimen_name magic_method_codes measurement_flag measurement_lab_field_dc measurement_magn_moment treatment_dc_field"
    names = (fields if version == 2 else "specimen method_codes quality meas_field_dc magn_mass treat_dc_field").split()
    lines = ["tab \tmagic_measurements" if version == 2 else "tab delimited\tmeasurements", "\t".join(names)]
    for k, name in enumerate(("IS06a-1", "IS06a-2", "IS06a-3", "IS06a-4"), 1):  # the last without a loop
        lines += [f"{name}\tLP-HYS\tg\t{u:e}\t{k * y:e}\t" for u, y in zip(FIELD, MOMENT, strict=True) if k < 4]
        lines += [f"{name}\tLP-IRM-DCD\tg\t\t{y:e}\t{-y:e}" for y in np.linspace(0.1, 1, 20)]
    if version == 3:
        lines = [
            "tab delimited\tspecimens",
            "specimen\tsample",
            "IS06a-1\tIS06a",
            "IS06a-2\tIS06a",
            ">>>>>>>>>>",
            *lines,
        ]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("version", [2, 3])
def test_every_specimen_of_a_magic_file_is_a_record(version: int, tmp_path: Path) -> None:
    data = read(written(tmp_path, magic(version), "a.magic"))
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == ["IS06a-1", "IS06a-2", "IS06a-3"]
    for k, record in enumerate(data, 1):
        is_loop(record, FIELD, k * MOMENT)
        assert (record.u_unit, record.y_unit) == ("T", "Am2" if version == 2 else "Am2/kg")
        assert any("80 rows" in note.text and "no loop of IS06a-4" in note.text for note in record.notes)


SECTIONED = magnetometer(16, adjusted=True, units=True, extra=False)
IGOR = "IGOR\nWAVES/D H, B\nBEGIN\n" + "".join(f"\t{u}\t{y}\n" for u, y in zip(FIELD, MOMENT, strict=True)) + "END\n"
OLD_LOOP = '"Model 2900 ASCII Data File",7,-1,0\n' + "".join(
    f"{1e4 * u},{y}\n" for u, y in zip(FIELD, MOMENT, strict=True)
)


@pytest.mark.parametrize("text", [magic(2), magic(3), SECTIONED, IGOR, OLD_LOOP, "H,B\n1,2\n3,4\n5,6\n7,9\n3,8\n1,0"])
@pytest.mark.parametrize(("above", "below"), [("\n", ""), (" \n\n", "\n"), ("", "\x1a"), ("", "\x1a\x1a\x00")])
def test_blank_lines_above_a_file_and_the_end_mark_of_dos_change_nothing(
    text: str, above: str, below: str, tmp_path: Path
) -> None:
    plain, changed = (
        Dataset.of(read(written(tmp_path, t, n))) for t, n in ((text, "a.dat"), (above + text + below, "b.dat"))
    )
    assert len(plain) == len(changed)
    for before, after in zip(plain, changed, strict=True):
        assert (before.u_unit, before.y_unit, before.stated) == (after.u_unit, after.y_unit, after.stated)
        np.testing.assert_array_equal(before.u, after.u)
        np.testing.assert_array_equal(before.y, after.y)


def stacked(title: str, values: list[str], *, clock: bool = False) -> str:
    names = [title, *["time_s"] * clock, "H_A_per_m", "B_T"]
    rows = [
        [value, *[f"{0.1 * (81 * k + j)}"] * clock, str((k + 1) * u), str((k + 1) * y)]
        for k, value in enumerate(values)
        for j, (u, y) in enumerate(zip(FIELD, MOMENT, strict=True))
    ]
    return "\n".join(",".join(row) for row in [names, *rows]) + "\n"


@pytest.mark.parametrize("title", ["specimen", "Sample name", "Test", "Probe", "heat treatment"])
def test_text_that_is_constant_over_long_runs_divides_and_names_records(title: str, tmp_path: Path) -> None:
    data = read(written(tmp_path, stacked(title, ["S-1", "S-2", "S-3"])))
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == ["S-1", "S-2", "S-3"]
    for k, record in enumerate(data, 1):
        is_loop(record, k * FIELD, k * MOMENT)
    assert len(one_of(read(tmp_path / "loop.dat", only="S-2"))) == 81


def test_numbers_of_specimens_divide_records(tmp_path: Path) -> None:
    data = read(written(tmp_path, stacked("Specimen", ["3", "7"])))
    assert [record.name for record in Dataset.of(data)] == ["Specimen=3", "Specimen=7"]


def test_blanks_in_text_between_tabs_part_no_columns(tmp_path: Path) -> None:
    text = stacked("specimen", ["batch 1 a", "batch 2 b"]).replace(",", "\t")
    assert [record.name for record in Dataset.of(read(written(tmp_path, text)))] == ["batch 1 a", "batch 2 b"]


def one_of(data: Record | Dataset) -> Record:
    (record,) = Dataset.of(data)
    return record


@pytest.mark.parametrize(
    ("title", "values"), [("state", ["ramp", "hold"]), ("direction", ["up", "down"]), ("cycle", ["first", "second"])]
)
def test_text_that_names_the_steps_of_one_experiment_does_not_divide_it(
    title: str, values: list[str], tmp_path: Path
) -> None:
    assert len(one(written(tmp_path, stacked(title, values, clock=True)))) == 162


# Data loggers and columns that nobody uses ---------------------------------------------------------------------------------------


def test_a_logger_writes_a_preamble_a_counter_dates_and_events(tmp_path: Path) -> None:
    text = "Header Size:  7\nVersion:  2\nSampling Rate:  1000\nSample Count:  81\n"
    text += "Sample Number, Date/Time, Force (N), Position (mm), Events\n"
    text += "".join(
        f"   {k},  06/29/2022 04:08:{40 + k / 100:06.3f} PM, {y:.6f}, {u:.6f}{', DAQ Start' * (k == 1)}\n"
        for k, (u, y) in enumerate(zip(FIELD, MOMENT, strict=True), 1)
    )
    record = one(written(tmp_path, text))
    np.testing.assert_allclose(record.u, FIELD, atol=1e-6)
    assert (record.u_name, record.y_unit) == ("Position (mm)", "N")
    assert record.t is not None
    np.testing.assert_allclose(record.t, np.arange(81) / 100, atol=1e-9)


def logged(dates: list[str], *, clock: bool = True) -> str:
    rows = zip(itertools.count(), itertools.cycle(dates), FIELD, MOMENT, strict=False)
    text = "".join([f"{0.1 * k}," * clock + f"{date},{u},{y}\n" for k, date, u, y in rows])
    return "Test_Time(s)," * clock + "Date,Displacement (mm),Force (N)\n" + text


def test_an_ambiguous_date_that_nobody_uses_does_not_block_a_file(tmp_path: Path) -> None:
    path = written(tmp_path, logged(["11/1/2013", "11/2/2013"]))
    record = one(path)
    is_loop(record)
    assert record.t is not None
    assert record.t[-1] == pytest.approx(8.0)
    with pytest.raises(DataError, match=r"11/1 are ambiguous.*--time none"):
        read(path, time="Date")
    record = one(written(tmp_path, logged(["11/1/2013", "11/2/2013"], clock=False)))
    is_loop(record)
    assert record.t is None
    assert any(note.severity is Severity.WARNING and "ambiguous" in note.text for note in record.notes)


def test_dates_go_on_as_the_clock_does(tmp_path: Path) -> None:
    stamps = [
        f"11/{1 + k // 41}/2013 {'23:59' if k < 41 else '00:00'}:{(19 + k) if k < 41 else k - 41:02d}"
        for k in range(81)
    ]
    record = one(written(tmp_path, logged(stamps, clock=False)))
    assert record.t is not None
    np.testing.assert_array_equal(record.t, np.arange(81.0))


def test_marks_that_may_separate_thousands_block_only_their_own_column(tmp_path: Path) -> None:
    text = "x_mm;F_N;count\n" + "".join(
        f"{u:.6f};{y:.6f};1,{100 + k}\n" for k, (u, y) in enumerate(zip(FIELD, MOMENT, strict=True))
    )
    path = written(tmp_path, text)
    np.testing.assert_allclose(one(path).u, FIELD, atol=1e-6)
    with pytest.raises(DataError, match=r"ambiguous.*decimal="):
        read(path, output="count")


def test_commas_from_one_thousand_on_separate_thousands_beside_points(tmp_path: Path) -> None:
    field = np.arange(-2000, 2001, 200)
    lines = "".join(f"{h:,} & {1.4 * np.tanh(h / 700):.3f} \\\\\n" for h in field)
    table = "\\begin{tabular}{rr}\n$H$ (A/m) & $B$ (T) \\\\\n\\hline\n" + lines + "\\end{tabular}\n"
    np.testing.assert_array_equal(one(written(tmp_path, table, "table.tex")).u, field)


@pytest.mark.parametrize(
    "comments", [("", "300 K", "", "5 K"), ("A", "A", "B", "B"), ("", "raw data", "", "corrected data")]
)
def test_comments_below_the_units_name_loops_side_by_side(comments: tuple[str, ...], tmp_path: Path) -> None:
    lines = ["\t".join(("Field", "Moment") * 2), "\t".join(("Oe", "emu") * 2), "\t".join(comments)]
    lines += [f"{h:.6g}\t{m:.6g}\t{h:.6g}\t{0.7 * m:.6g}" for h, m in zip(FIELD, MOMENT, strict=True)]
    data = read(written(tmp_path, "\n".join(lines) + "\n"))
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == list(dict.fromkeys(filter(None, comments)))
    for record, factor in zip(data, (1.0, 0.7), strict=True):
        assert (record.u_name, record.u_unit, record.y_name, record.y_unit) == ("Field", "Oe", "Moment", "emu")
        np.testing.assert_allclose(record.y, factor * MOMENT, rtol=1e-5)


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize(("names", "leads"), [("T,mAm2/kg", False), ("x (mm),F (kN)", True)])
def test_branches_below_each_other_that_are_mirrored_are_a_loop(
    names: str, leads: bool, swapped: bool, tmp_path: Path
) -> None:
    """Both are listed from the lowest field on, under a title, as far as each was measured."""
    low, high = np.linspace(-0.32, 0.26, 59), np.linspace(-0.26, 0.32, 59)
    upper = [f"{h:.4f},{m:.4f}" for h, m in zip(low, np.tanh(9 * low + 0.3) + low, strict=True)]
    lower = [f"{h:.4f},{m:.4f}" for h, m in zip(high, np.tanh(9 * high - 0.3) + high, strict=True)]
    blocks = [["Upper hysteresis branch", *upper], ["Lower hysteresis branch", *lower]]
    lines = ["Corrected hysteresis", "", names, "", *blocks[swapped], "", *blocks[not swapped]]
    record = one(written(tmp_path, "\n".join(lines) + "\n", "loop.hys"))
    falls, rises = (high, low) if leads else (low, high)
    np.testing.assert_allclose(record.u, np.r_[falls[::-1], rises], atol=1e-4)
    assert (circulation(record.u, record.y) < 0) == leads


def test_two_curves_that_are_not_mirrored_stay_two(tmp_path: Path) -> None:
    field = np.linspace(-0.3, 0.3, 61)
    curves = ["".join(f"{h:.4f},{np.tanh(9 * h - c):.4f}\n" for h in field) for c in (0.3, 0.9)]
    assert len(Dataset.of(read(written(tmp_path, "T,mAm2/kg\n" + "\n".join(curves), "two.csv")))) == 2


# Battery cyclers -----------------------------------------------------------------------------------------------------------------

CHARGE = np.concatenate([np.linspace(0, 2, 60), np.full(4, 2.0)]), np.concatenate([np.zeros(62), [0.01, 0.02]])
VOLTS = 3.2 + 0.1 * CHARGE[0]


def cycler(kind: str, *, charging: bool) -> str:
    """Half a cycle as a cycler writes it."""
    grown = CHARGE[0]
    voltage = VOLTS if charging else VOLTS[::-1] - 0.05
    up, down = (grown, 0 * grown) if charging else (0 * grown, grown)
    sign = "" if charging else "-"
    step = "CC_Chg" if charging else "CC_DChg"
    names, columns = {
        "arbin": ("Data_Point,Test_Time(s),Step_Index,Current(A),Voltage(V),Charge_Capacity(Ah),Discharge_Capacity(Ah),Charge_Energy(Wh)",
                  [voltage, up, down, up * 3.3]),
        "biologic": ("N,time/s,Ns,control/mA,Ewe/V,Q charge/mA.h,Q discharge/mA.h,Energy/W.h", [voltage, up, down, up]),
        "neware": ("Record,Time(s),Step,Current(A),Voltage(V),Capacity(Ah),Energy(Wh),Chg", [voltage, grown, grown * 3.3, 0 * grown]),
        "chinese": ("数据序号,时间(s),工步,电流(A),电压(V),充电容量(Ah),放电容量(Ah),能量(Wh)", [voltage, up, down, up]),
        "bdf": ("test_index,test_time_second,step_index,current_ampere,voltage_volt,charging_capacity_ah,discharging_capacity_ah,power",
                [voltage, up, down, up]),
        "signed": ("N,time/s,Ns,control/mA,Ewe/V,(Q-Qo)/mA.h,x,Energy/W.h", [voltage, up - down, 0 * up, up]),
        "maccor": ("Rec#,Test (Sec),Step,Amps,Volts,Amp-hr,Watt-hr,Temp 1", [voltage, grown, grown * 3.3, 0 * grown + 25]),
    }[kind]  # fmt: skip
    names = names.replace("Chg", "Aux") + ",Status"
    current = "0.1" if kind == "maccor" else f"{sign}0.1"
    rows = [
        f"{k + 1},{60.0 * k},3,{current}," + ",".join(f"{v:.6f}" for v in row) + f",{step}\n"
        for k, row in enumerate(zip(*columns, strict=True))
    ]
    return names + "\n" + "".join(rows)


@pytest.mark.parametrize("kind", ["arbin", "biologic", "neware", "maccor", "chinese", "signed", "bdf"])
def test_the_charge_that_passed_drives_the_voltage_of_a_cell(kind: str, tmp_path: Path) -> None:
    files = [
        written(tmp_path, cycler(kind, charging=charging), f"{name}.csv")
        for name, charging in (("discharge", False), ("charge", True))
    ]
    loop = read(files)
    assert isinstance(loop, Record)
    np.testing.assert_allclose(loop.u, np.concatenate([-CHARGE[0], CHARGE[0] - 2]), atol=2e-6)
    np.testing.assert_allclose(loop.y, np.concatenate([VOLTS[::-1] - 0.05, VOLTS]), atol=1e-6)
    half = one(files[0])
    np.testing.assert_allclose(half.u, -CHARGE[0], atol=2e-6)
    warnings = lambda record: [n.text for n in record.notes if n.code is Code.CURVES and n.severity is Severity.WARNING]
    warned = warnings(half)
    assert not warnings(loop)
    assert any("half a cycle" in text and "A.csv B.csv" in text for text in warned)


def test_files_of_the_steps_between_a_discharge_and_a_charge_are_parts_of_one_loop(tmp_path: Path) -> None:
    """A test of a cell in four scripts: discharge, rest with pulses of either sign, charge, and the same at the other end."""
    pulses = 0.02 * np.abs(np.sin(np.linspace(0, 3 * np.pi, 30)))

    def between(level: float, *, charging: bool) -> str:
        grown, back = (np.cumsum(np.maximum(np.diff(sign * pulses, prepend=0.0), 0.0)) for sign in (1, -1))
        up, down = (grown, back) if charging else (back, grown)
        rows = [
            f"{k + 1},{60.0 * k},1,0.1,{level:.6f},{a:.6f},{b:.6f}\n"
            for k, (a, b) in enumerate(zip(up, down, strict=True))
        ]
        return (
            "Data_Point,Test_Time(s),Step_Index,Current(A),Voltage(V),Charge_Capacity(Ah),Discharge_Capacity(Ah)\n"
            + "".join(rows)
        )

    whole = [cycler("arbin", charging=charging) for charging in (False, True)]
    pauses = [between(level, charging=charging) for level, charging in ((VOLTS[0], False), (VOLTS[-1], True))]
    texts = [whole[0], pauses[0], whole[1], pauses[1]]
    loop = read([written(tmp_path, text, f"cell_S{k}.csv") for k, text in enumerate(texts, 1)])
    assert isinstance(loop, Record)
    discharged = -CHARGE[0]
    parts = [discharged, discharged[-1] - pulses, discharged[-1] - pulses[-1] + CHARGE[0]]
    np.testing.assert_allclose(loop.u, np.concatenate([*parts, parts[-1][-1] + pulses]), atol=2e-5)


# Branches side by side -----------------------------------------------------------------------------------------------------------

DOWN, UP = slice(0, 41), slice(40, 81)
LOOP = np.concatenate([FIELD[UP], FIELD[DOWN]]), np.concatenate([MOMENT[UP], MOMENT[DOWN]])


@pytest.mark.parametrize(
    "words", [("up", "down"), ("asc", "desc"), ("loading", "unloading"), ("inc", "dec"), ("1", "2")]
)
@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize("ascending", [True, False])
def test_branches_side_by_side_are_one_loop(words: tuple[str, str], own: bool, ascending: bool, tmp_path: Path) -> None:
    u, up, down = FIELD[UP], MOMENT[UP], MOMENT[DOWN][::-1]
    order = 1 if ascending or words[0] == "1" else -1
    columns = {
        f"B_{words[0]} (T)": up,
        f"B_{words[1]} (T)": down,
        "comment": np.full(41, 3.0),
        "temperature": np.linspace(20, 21, 41),
    }
    inputs = {f"H_{word} (A/m)": u for word in words} if own else {"H (A/m)": u}
    for names in (list({**inputs, **columns}), list({**columns, **inputs}), list({**columns, **inputs})[::-1]):
        table = {name: {**inputs, **columns}[name][::order] for name in names}
        lines = [",".join(names), *(",".join(f"{v:.9g}" for v in row) for row in zip(*table.values(), strict=True))]
        record = one(written(tmp_path, "\n".join(lines) + "\n"))
        is_loop(record, *LOOP)
        assert (record.u_name, record.y_name, record.u_unit) == ("H (A/m)", "B (T)", "A/m")


def test_branches_of_their_own_lengths_and_directions(tmp_path: Path) -> None:
    forward, reverse = (FIELD[DOWN], MOMENT[DOWN]), (FIELD[UP][:38], MOMENT[UP][:38])
    lines = ["H_forward,B_forward,H_reverse,B_reverse"]
    for k in range(41):
        cells = [f"{forward[0][k]},{forward[1][k]}", f"{reverse[0][k]},{reverse[1][k]}" if k < 38 else ","]
        lines.append(",".join(cells))
    record = one(written(tmp_path, "\n".join(lines) + "\n"))
    is_loop(record, np.concatenate([forward[0], reverse[0]]), np.concatenate([forward[1], reverse[1]]))


def test_a_branch_whose_name_reads_like_that_of_a_channel(tmp_path: Path) -> None:
    """Trace A and trace B are channels of an oscilloscope; here trace is the way up, and retrace the way down."""
    lines = ["retrace H (A/m),retrace B (T),trace H (A/m),trace B (T)"]
    u, up, down = FIELD[UP], MOMENT[UP], MOMENT[DOWN][::-1]
    lines += [",".join(f"{v:.9g}" for v in row) for row in zip(u, down, u, up, strict=True)]
    is_loop(one(written(tmp_path, "\n".join(lines) + "\n")), *LOOP)


def test_numbered_loops_and_sensors_are_no_branches(tmp_path: Path) -> None:
    lines = ["H1,B1,H2,B2", *(f"{u},{y},{2 * u},{2 * y}" for u, y in zip(FIELD, MOMENT, strict=True))]
    assert len(read(written(tmp_path, "\n".join(lines) + "\n"))) == 2  # two loops
    lines = ["H,B1,B2", *(f"{u},{y},{0.7 * y}" for u, y in zip(FIELD[UP], MOMENT[UP], strict=True))]
    assert len(one(written(tmp_path, "\n".join(lines) + "\n"))) == 41  # two sensors


# JSON ----------------------------------------------------------------------------------------------------------------------------

U, Y = FIELD.tolist(), MOMENT.tolist()
ROWS = [{"displacement": u, "force": y} for u, y in zip(U, Y, strict=True)]
JSON = {
    "arrays": {"displacement": U, "force": Y},
    "nested": {"source": [{"year": 2014, "units": ["mm", "kN"]}, {"year": 2015}], "test": {"force": Y, "displacement": U, "name": "c33"}},
    "records": ROWS,
    "records within": {"meta": {"operator": "Kim"}, "data": ROWS},
    "rows": {"columns": ["force", "displacement"], "index": list(range(81)), "data": [list(row) for row in zip(Y, U, strict=True)]},
    "table with names": [["displacement", "force"], *([u, y] for u, y in zip(U, Y, strict=True))],
    "columns by row number": {"displacement": {str(k): u for k, u in enumerate(U)}, "force": {str(k): y for k, y in enumerate(Y)}},
    "rows by row number": {str(k): row for k, row in enumerate(ROWS)},
}  # fmt: skip


@pytest.mark.parametrize("kind", [*JSON, "lines"])
@pytest.mark.parametrize("indent", [None, 2])
def test_json_of_every_orientation(kind: str, indent: int | None, tmp_path: Path) -> None:
    text = "\n".join(map(json.dumps, ROWS)) if kind == "lines" else json.dumps(JSON[kind], indent=indent)
    record = one(written(tmp_path, text, "a.txt"))
    is_loop(record)
    assert "displacement" in record.u_name
    if kind == "nested":
        assert (record.metadata, record.u_unit, record.y_unit) == ({"test.name": "c33"}, "mm", "kN")


def test_json_lists_of_rows_and_of_records(tmp_path: Path) -> None:
    for rows in ([[u, y] for u, y in zip(U, Y, strict=True)], [U, Y]):
        is_loop(one(written(tmp_path, json.dumps(rows), "a.json")))
    loops = [{"name": f"loop {k}", "Hc": 0.3 * k, "x_mm": (k * FIELD).tolist(), "F_N": Y} for k in (1, 2)]
    for content in (loops, {one["name"]: one for one in loops}):
        data = read(written(tmp_path, json.dumps(content), "a.json"))
        assert [record.name for record in Dataset.of(data)] == ["loop 1", "loop 2"]
        is_loop(list(Dataset.of(data))[1], 2 * FIELD)
        assert [one.value for one in list(Dataset.of(data))[1].stated] == [0.6]
    described = {"x": {"label": "H", "unit": "A/m", "values": U}, "y": {"label": "B", "unit": "T", "values": Y}}
    series = {"series": [{"name": "H (A/m)", "data": U}, {"name": "B (T)", "data": Y}]}
    for content in (described, series, {"units": {"H": "A/m", "B": "T"}, "data": {"B": Y, "H": U}}):
        record = one(written(tmp_path, json.dumps(content), "a.json"))
        is_loop(record)
        assert (record.u_unit, record.y_unit) == ("A/m", "T")
    with pytest.raises(DataError, match="no arrays of numbers"):
        read(written(tmp_path, '{"a": 1}', "a.json"))
    with pytest.raises(DataError, match="begins as JSON"):
        read(written(tmp_path, '{"a": [1, 2', "a.json"))


# Headers ------------------------------------------------------------------------------------------------------------------------

T = np.arange(81) * 0.01
HEADERS = {  # lines above time, an input in volts and an output in micrometers
    "units beside words": "Elapsed Time,Drive Voltage,Axial Displacement\nsec,V,segments",
    "averages below units": '"TS","Drive Voltage","Position"\n"sec","V","um"\n"","Avg","Avg"',
    "units in a line called so": "Title\nY_Unit_Label,V,um\nDelta_X,0.01,0.01\nX_Value,Drive voltage,Position",
    "names that are units": "Seconds,Volts,microns",
    "units in words after a slash": "Time / Seconds,Voltage / Volt,Position / micron",
    "units after a blank": "Time Sec,Piezo Voltage mV,Axial Position um",
}


@pytest.mark.parametrize("kind", HEADERS)
def test_units_of_headers(kind: str, tmp_path: Path) -> None:
    rows = "\n".join(f"{t:.2f},{u:.8f},{y:.8f}" for t, u, y in zip(T, FIELD, MOMENT, strict=True))
    record = one(written(tmp_path, f"{HEADERS[kind]}\n{rows}\n"))
    is_loop(record)
    assert record.t is not None
    input_unit = "mV" if "mV" in HEADERS[kind] else "V"
    assert conversion(record.u_unit, input_unit) == 1.0
    assert record.y_unit == "" if "segments" in HEADERS[kind] else conversion(record.y_unit, "um") == 1.0


def test_degrees_without_their_sign_are_those_of_a_temperature(tmp_path: Path) -> None:
    rows = "\n".join(f"{60 + 40 * u:.8f},{y:.8f}" for u, y in zip(FIELD, MOMENT, strict=True))
    record = one(written(tmp_path, f"Temperature (C),Strain (%)\n{rows}\n"))
    assert (record.u_unit, record.y_unit) == ("degC", "%")


def test_percents_and_degrees_in_every_cell(tmp_path: Path) -> None:
    rows = "\n".join(f"{u:.8f}%;{y:.8f}°" for u, y in zip(FIELD, MOMENT, strict=True))
    record = one(written(tmp_path, f"PWM (%);Angle (°)\n{rows}\n"))
    is_loop(record)
    assert (record.u_unit, record.y_unit) == ("%", "°")


@pytest.mark.parametrize("words", [("up", "down"), ("inc", "dec")])
def test_branches_whose_word_is_glued_to_the_name(words: tuple[str, str], tmp_path: Path) -> None:
    """Hup, Mup, Hdown, Mdown: the rising branch first."""
    up, down = slice(40, 81), slice(0, 41)
    header = ",".join(f"{name}{word} {unit}" for word in words for name, unit in (("H", "[Oe]"), ("M", "[emu]")))
    columns = (FIELD[up], MOMENT[up], FIELD[down], MOMENT[down])
    rows = "\n".join(",".join(f"{v:.8f}" for v in row) for row in zip(*columns, strict=True))
    is_loop(
        one(written(tmp_path, f"{header}\n{rows}\n")),
        np.concatenate([FIELD[up], FIELD[down]]),
        np.concatenate([MOMENT[up], MOMENT[down]]),
    )


# Columns ------------------------------------------------------------------------------------------------------------------------

RNG = np.random.default_rng(0)
NOISE = RNG.standard_normal(81)
COLUMNS = {  # names, and the columns: the output of a source is an input, a monitor and a condition are neither
    "output of a source": ("Position (um),Output Voltage (V)", (MOMENT, FIELD)),
    "monitor": ("Output Voltage (V),Monitor Output (V),Position (um)", (FIELD, 0.1 * FIELD + 1e-4 * NOISE, MOMENT)),
    "held": ("Temperature (K),Field (Oe),Moment (emu)", (300 + 0.02 * NOISE, FIELD, MOMENT)),
    "unrelated": ("Gauge pressure (kPa),Field (Oe),Signal,Detector", (1 + 0.5 * NOISE, FIELD, MOMENT, NOISE)),
    "scans": ("Scan,Displacement (mm),Load (kN)", (np.arange(81.0), FIELD, MOMENT)),
    "command of a field": ("source_output,field_calibrated,detector_voltage", (0.01 * FIELD, FIELD, MOMENT)),
    "shunt": ("voltage (V),current (A),polarization (uC/cm2),applied voltage (V)", (5 * NOISE, NOISE, MOMENT, FIELD)),
    "lock-in amplifier": ("Field (Oe),Voltage Ampl (V),Resistance (Ohms)", (FIELD, 0.1 * MOMENT, MOMENT)),
    "units behind a blank": ("Time s,Vplus V,I1 A,P1 uC_per_cm2", (np.arange(81.0), FIELD, NOISE, MOMENT)),
}


@pytest.mark.parametrize("kind", COLUMNS)
def test_columns_beside_the_loop_are_not_taken(kind: str, tmp_path: Path) -> None:
    header, columns = COLUMNS[kind]
    rows = "\n".join(",".join(f"{v:.8f}" for v in row) for row in zip(*columns, strict=True))
    is_loop(one(written(tmp_path, f"{header}\n{rows}\n")))


def test_a_column_in_another_unit_is_left_out_of_columns_without_names(tmp_path: Path) -> None:
    """The field of a coil beside its current leaves one pair."""
    rows = "\n".join(f"{u:.8f} {701.8 * u:.4f} {y:.8f}" for u, y in zip(FIELD, MOMENT, strict=True))
    record = one(written(tmp_path, rows + "\n"))
    is_loop(record)
    assert "column 1 is column 0 in another unit and is not used" in [note.text for note in record.notes]


def test_of_curves_that_all_rise_unevenly_none_is_the_time(tmp_path: Path) -> None:
    x = np.arange(12.0)
    rows = "\n".join(f"{700 * np.tanh(k / 4):.1f} {k:.0f} {9e5 * np.tanh(k / 3):.1f}" for k in x)
    with pytest.raises(DataError, match="nothing in the file tells which columns"):
        read(written(tmp_path, rows + "\n"))


def test_the_direction_of_the_sweep_is_no_condition(tmp_path: Path) -> None:
    u, y = np.repeat(FIELD, 2), np.repeat(MOMENT, 2)  # 162 samples
    up = np.where(np.arange(162) < 82, -1, 1)
    rows = "\n".join(f"{a:.8f},{d},{b:.8f}" for a, d, b in zip(u, up, y, strict=True))
    record = one(written(tmp_path, f"Field (Oe),direction,Moment (emu)\n{rows}\n"))
    assert not [note.text for note in record.notes if "levels" in note.text]


def test_frequencies_below_each_other_are_records(tmp_path: Path) -> None:
    """Without a time that goes on from one to the next."""
    loops = {50: 1.0, 100: 1.1, 400: 1.3}
    rows = [f"{u:.8f},{scale * y:.8f},{f}" for f, scale in loops.items() for u, y in zip(FIELD, MOMENT, strict=True)]
    data = read(written(tmp_path, "H (A/m),B (T),Frequency (Hz)\n" + "\n".join(rows) + "\n"))
    assert [record.name for record in Dataset.of(data)] == [f"Frequency={f}" for f in loops]
    for record, scale in zip(Dataset.of(data), loops.values(), strict=True):
        is_loop(record, y=scale * MOMENT)


def test_tables_of_nearly_the_same_columns_are_records_of_one_kind(tmp_path: Path) -> None:
    """An instrument adds a column from the third measurement on."""
    table = lambda names, *columns: (
        f"{names}\n" + "".join("\t".join(f"{v:.8f}" for v in row) + "\n" for row in zip(*columns, strict=True))
    )
    plain = table("Time [s]\tV+ [V]\tI1 [A]\tP1 [uC/cm2]", T, FIELD, NOISE, MOMENT)
    more = table("Time [s]\tV+ [V]\tI1 [A]\tP1 [uC/cm2]\tP2 [uC/cm2]", T, FIELD, NOISE, 3 * MOMENT, 2 * MOMENT)
    twice = table("Time [s]\tV+ [V]\tI1 [A]\tP1 [uC/cm2]", T, FIELD, NOISE, 2 * MOMENT)
    data = Dataset.of(read(written(tmp_path, f"Table 1\n{plain}\nTable 2\n{twice}\nTable 3\n{more}")))
    assert len(data) == 3
    for record, scale in zip(data, (1, 2, 3), strict=True):
        is_loop(record, y=scale * MOMENT)


# Headers that differ in shape from their rows -------------------------------------------------------------------------------------

PAIRS = [*zip(FIELD, MOMENT, strict=True)]
NAMED_OTHERWISE = {  # file, with the input, the output and the unit of the input as they are named in it
    "formats of the numbers between units and rows": (
        "  Time,   H_vsm,   m\n     s,       T, emu\n\n   6:0      6:0   6:0\n"
        + "".join(f"{k:.1f} {u:.8f} {y:.8f}\n" for k, (u, y) in enumerate(PAIRS)),
        ("H_vsm", "m", "T"),
    ),
    "two tabs between cells and one between names": (
        "# Loop\tRead Volt (V)\tWrite Volt (V)\tAmplitude (a.u)\t\n"
        + "".join(f"1\t\t0.00\t\t{u:.8f}\t\t{y:.8f}\n" for u, y in PAIRS),
        ("Write Volt (V)", "Amplitude (a.u)", "V"),
    ),
    "rows with names of their own": (
        "field,moment,spread\n" + "".join(f"s{k},{u:.8f},{y:.8f},0.01\n" for k, (u, y) in enumerate(PAIRS)),
        ("field", "moment", ""),
    ),
    "results in the first row": (
        "Time\tAI\tAV\tIHRS\tRATIO\n9.5\t1E-3\t0.1\t#REF\t33.8\n"
        + "".join(f"{10 + k}\t{y:.8f}\t{u:.8f}\t\n" for k, (u, y) in enumerate(PAIRS)),
        ("AV", "AI", ""),
    ),
    "current of a coil": ("#strom magnetfeld\n" + "".join(f"{u:.8f} {y:.8f}\n" for u, y in PAIRS), ("strom", "magnetfeld", "")),
    "the same unit of components": (
        "Ha_x\tHa_y\t<M>_x\t<M>_y\nA/m\tA/m\tA/m\tA/m\n\n"
        + "".join(f"{u:.8f}\t0\t{y:.8f}\t{1 - y * y:.6f}\n" for u, y in PAIRS),
        ("Ha_x", "<M>_x", "A/m"),
    ),
    "ratio to the saturation": (
        "$\\mu_0 H$ (mT),$M/M_s$\n" + "".join(f"{u:.8f},{y:.8f}\n" for u, y in PAIRS),
        ("\u00b5_0 H (mT)", "M/M_s", "mT"),
    ),
    "axes of a plot below the units": (
        "Magnetic Field,Moment,M. Std. Err.\nOe,emu,emu\nX,Y,yEr\n"
        + "".join(f"{u:.8f},{y:.8f},{0.001 + 0.001 * y * y:.6f}\n" for u, y in PAIRS),
        ("Magnetic Field", "Moment", "Oe"),
    ),
    "iterator": (
        "iterator\tField Output (T)\tR\n" + "".join(f"{k}\t{u:.8f}\t{y:.8f}\n" for k, (u, y) in enumerate(PAIRS)),
        ("Field Output (T)", "R", "T"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", NAMED_OTHERWISE)
def test_names_of_columns_whatever_the_shape_of_the_header(kind: str, tmp_path: Path) -> None:
    text, names = NAMED_OTHERWISE[kind]
    record = one(written(tmp_path, text))
    is_loop(record)
    assert (record.u_name, record.y_name, record.u_unit) == names


def test_settings_of_an_oscilloscope_beside_the_first_rows(tmp_path: Path) -> None:
    """Two exported channels, each with its settings to the left, pasted beside each other."""
    settings = ["Record Length,810,Points", "Source,{},", "Vertical Units,V,", "Horizontal Units,s,"]
    beside = [*settings, *[",,"] * (10 * 81 - len(settings))]
    cells = lambda k, channel, value: f"{beside[k].format(channel)},{1e-5 * k:.6f},{value:.8f},"
    rows = [
        f"{cells(k, 'CH1', u)},{cells(k, 'CH2', y)}"
        for k, (u, y) in enumerate(zip(np.repeat(FIELD, 10), np.repeat(MOMENT, 10), strict=True))
    ]
    record = one(written(tmp_path, "\n".join(rows) + "\n"))
    is_loop(record, np.repeat(FIELD, 10), np.repeat(MOMENT, 10))
    assert record.dt == pytest.approx(1e-5)
    assert (record.u_name, record.y_name, record.u_unit, record.y_unit) == ("CH1", "CH2", "V", "V")


def test_an_oscilloscope_states_its_interval_beside_the_names(tmp_path: Path) -> None:
    """The first instant and the interval stand in the line of units, below their names, and the rows end in empty cells."""
    text = "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-3.000000e-02,5.0e-05\n"
    record = one(written(tmp_path, text + "".join(f"{k},{u:.8f},{y:.8f},,\n" for k, (u, y) in enumerate(PAIRS))))
    is_loop(record)
    assert (record.u_name, record.y_name, record.u_unit) == ("CH1", "CH2", "Volt")
    assert record.dt == pytest.approx(5e-5)


def test_a_magic_contribution_begins_with_a_rule_and_has_several_experiments(tmp_path: Path) -> None:
    names = "experiment\tspecimen\tmethod_codes\tmeas_field_dc\ttreat_dc_field\tmagn_mass"
    lines = [">>>>>>>>>>", "tab\tsites", "site\tlat", "A\t47.2", ">>>>>>>>>>", "tab\tmeasurements", names]
    for k in (1, 2):
        lines += [f"HYS-{k}\ts1\tLP-HYS\t{u:e}\t\t{k * y:e}" for u, y in PAIRS]
    lines += [f"BCR-3\ts1\tLP-BCR-BF\t\t{-y:e}\t{y:e}" for y in np.linspace(0.1, 1, 20)]
    data = read(written(tmp_path, "\n".join(lines) + "\n", "contribution.txt"))
    assert [record.name for record in Dataset.of(data)] == ["HYS-1", "HYS-2"]
    for k, record in enumerate(Dataset.of(data), 1):
        is_loop(record, FIELD, k * MOMENT)
        assert (record.u_unit, record.y_unit) == ("T", "Am2/kg")


def test_branches_in_two_matrices_of_a_program(tmp_path: Path) -> None:
    up, down = slice(40, 81), slice(0, 41)
    matrix = lambda part: ";\n".join(f"    {u:.8f}, {y:.8f}" for u, y in PAIRS[part])
    text = f"record Steel\n  parameter Real[:,:] tabris=[\n{matrix(up)}];\n  parameter Real[:,:] tabfal=[\n{matrix(down)}];\nend Steel;\n"
    joined = lambda of: np.concatenate([of[up], of[down]])
    is_loop(one(written(tmp_path, text, "Steel.mo")), joined(FIELD), joined(MOMENT))


def test_reversal_curves_after_a_row_of_another_step(tmp_path: Path) -> None:
    """A remanence is measured before the first curve; all curves end at the same field."""
    curves = [np.linspace(start, 500.0, 12) for start in (-50.0, -110.0, -190.0)]
    rows = ["AF,400,0.1", *(f"FORC,{u:.3f},{0.001 * u:.6f}" for curve in curves for u in curve)]
    data = read(written(tmp_path, "step,field,moment\n" + "\n".join(rows) + "\n", "a.rmg"))
    assert [record.u[0] for record in Dataset.of(data)] == [-50.0, -110.0, -190.0]


def test_ratios_of_magnetizations_are_no_times(tmp_path: Path) -> None:
    """Ms is a saturation and no megasecond, and Gs is a gauss."""
    rows = "".join(f"{u:.8f},{y:.8f},{0.5 - 0.1 * u:.8f}\n" for u, y in PAIRS)
    record = one(written(tmp_path, f"H (Gs),M (emu),Mr/Ms\n{rows}"))
    is_loop(record)
    assert record.t is None
    assert conversion("Gs", "mT") == pytest.approx(0.1)


def test_branches_in_files_of_their_own_go_on_from_each_other(tmp_path: Path) -> None:
    """A table for each quarter of a loop of few points, as in a laboratory course; loops in files of their own stay apart."""
    cuts = [0, 21, 41, 61, 81]
    table = lambda rows: "#current induction\n" + "".join(f"{u:.8f} {y:.8f}\n" for u, y in rows)
    quarters = [written(tmp_path, table(PAIRS[a:b]), f"{k}.txt") for k, (a, b) in enumerate(itertools.pairwise(cuts))]
    joined = read(quarters)
    assert isinstance(joined, Record)
    is_loop(joined)
    assert any("0, 1, 2 and 3 are parts of one loop" in note.text for note in joined.notes)
    loops = [written(tmp_path, table(PAIRS), f"loop{k}.txt") for k in range(2)]
    assert len(Dataset.of(read(loops))) == 2
    assert len(Dataset.of(read([quarters[0], quarters[2]]))) == 2


@pytest.mark.parametrize("names", [("up", "down"), ("loop_falling", "loop_rising")])
def test_sorted_branches_in_files_whose_names_tell_their_direction_are_one_loop(
    names: tuple[str, str], tmp_path: Path
) -> None:
    table = lambda rows: "H (A/m),B (T)\n" + "".join(f"{u:.8f},{y:.8f}\n" for u, y in rows)
    rises = {"up": True, "down": False, "loop_falling": False, "loop_rising": True}
    part = lambda name: PAIRS[40:81] if rises[name] else PAIRS[0:41][::-1]
    files = [written(tmp_path, table(part(name)), f"{name}.csv") for name in names]
    record = read(files)
    assert isinstance(record, Record)
    along = [part(name) if rises[name] else part(name)[::-1] for name in names]
    np.testing.assert_allclose(np.column_stack([record.u, record.y]), np.concatenate(along), atol=1e-7)
    files = [written(tmp_path, table(part(name)), f"sample{k}.csv") for k, name in enumerate(names)]
    assert len(Dataset.of(read(files))) == 2


def test_results_of_specimens_are_no_samples_of_a_loop(tmp_path: Path) -> None:
    rows = "".join(f"S-{k},{2 + np.sin(k):.5f},{1 + np.cos(7 * k):.5f}\n" for k in range(20))
    with pytest.raises(
        DataError, match=r"'specimen' of its own: a table of results has no loop; .* --input Ms --output Mr"
    ):
        read(written(tmp_path, f"specimen,Ms,Mr\n{rows}"))


def test_names_of_columns_may_follow_a_label_in_brackets(tmp_path: Path) -> None:
    rows = [f"   {100 * u:<12g}  {y:<12g}\n" for u, y in zip(np.sin(T), np.sin(T - 0.3), strict=True)]
    head = "## Kerr bench\nsaved: 2008/04/15\n\n<line>\nID:l2008\nConfigure:WaveLength=632.8nm;\n"
    file = tmp_path / "kerr.dat"
    file.write_text(f"{head}<data>:   Field(mT)   Rotation(deg)\n{''.join(rows)}</line>\n")
    record = read(file)
    assert isinstance(record, Record)
    assert (record.u_name, record.u_unit) == ("Field(mT)", "mT")
    assert (record.y_name, record.y_unit) == ("Rotation(deg)", "deg")
    np.testing.assert_allclose(record.u, 100 * np.sin(T), rtol=1e-4)


@pytest.mark.parametrize(
    ("names", "records", "output"),
    [
        ("V,Vbias=0 V,Vbias=1 V,Vbias=2 V", ["0 V", "1 V", "2 V"], "output"),
        ("Vg (V),Id_Vd=0V (A),Id_Vd=1V (A),Id_Vd=2V (A)", ["0 V", "1 V", "2 V"], "Id"),
        ("Displacement (mm),P = 1 bar,P = 2 bar,P = 3 bar", ["1 bar", "2 bar", "3 bar"], "output"),
    ],
)
def test_outputs_named_by_what_was_held_are_a_loop_for_each(
    names: str, records: list[str], output: str, tmp_path: Path
) -> None:
    """Names with an equals sign are not settings above the table where each column has its own."""
    outputs = [MOMENT * (1 + 0.1 * k) + 0.003 * np.sin(37 * FIELD + k) for k in range(3)]
    rows = "".join(",".join(f"{value:.6f}" for value in row) + "\n" for row in zip(FIELD, *outputs, strict=True))
    loops = Dataset.of(read(written(tmp_path, f"{names}\n{rows}")))
    assert [loop.name for loop in loops] == records
    assert {loop.y_name for loop in loops} == {output}
    for loop, expected in zip(loops, outputs, strict=True):
        np.testing.assert_allclose(loop.y, expected, atol=1e-6)


def test_a_volume_over_a_pressure_and_a_loss_density_are_told_by_their_units(tmp_path: Path) -> None:
    rows = lambda *columns: "".join(",".join(f"{v:.6f}" for v in row) + "\n" for row in zip(*columns, strict=True))
    lung = one(written(tmp_path, "Paw [cm H2O],V [mL]\n" + rows(15 + FIELD, 500 + 400 * MOMENT), "lung.csv"))
    assert (lung.u_name, lung.y_name) == ("Paw [cm H2O]", "V [mL]")
    core = one(written(tmp_path, "H (A/m),B (T),Pv (W/m3)\n" + rows(FIELD, MOMENT, FIELD * MOMENT), "core.csv"))
    assert (core.u_name, core.y_name) == ("H (A/m)", "B (T)")
