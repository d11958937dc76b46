"""Adsorption isotherms as analyzers write them, and what was found beside them: netCDF, relays, sums of loads, cycles in words."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import openpyxl
import pytest
from scipy.io import netcdf_file

from hystfit.errors import DataError
from hystfit.reading import read
from hystfit.reading.files.archive import members_of
from tests.loop_files import N, U, Y, is_pair, one, rows, written

P = np.r_[np.linspace(0.05, 0.95, 20), np.linspace(0.9, 0.1, 15)].round(4)  # relative pressure, up and down
V = np.r_[200 * P[:20], 200 * P[20:] + 20].round(4)  # adsorbed, cm3/g
T = np.round(0.1 * np.arange(N), 1)


def test_an_archive_within_old_excel_is_not_that_of_several_files(tmp_path: Path) -> None:
    """Excel of today keeps the theme of an .xls as a zip archive within it."""
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w") as archive:
        archive.writestr("theme/theme1.xml", "<a/>")
        archive.writestr("[Content_Types].xml", "<a/>")
    raw = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(504) + inner.getvalue()
    assert members_of(written(tmp_path, raw, "report.xls")) == []
    assert len(members_of(written(tmp_path, inner.getvalue(), "report.zip"))) == 2


def test_reports_side_by_side_between_bars(tmp_path: Path) -> None:
    """A sheet with a summary, the isotherm and a plot beside each other, and rows that have the saturation pressure alone."""
    book = openpyxl.Workbook()
    sheet = book.create_sheet("Report")
    names = [
        "Relative Pressure (P/Po)",
        "Quantity Adsorbed (cm³/g STP)",
        "Time Between Points (min)",
        "Saturation (mmHg)",
    ]
    sheet.append(["Summary Report", "", "|", "Isotherm Tabular Report", "", "", "", "|", "BET Report"])
    sheet.append(["Surface Area", "194 m²/g", "|", *names, "|", "Slope:"])
    for k, (p, v) in enumerate(zip(P.tolist(), V.tolist(), strict=True)):
        if k in (5, 9):
            sheet.append(["", "", "|", None, None, None, 736.0 + k, "|"])
        beside = [p, v * (1 - p)] if k < 6 else []
        sheet.append(["", "", "|", p, v, f"{7 + (5 * k) % 11:04d}", 735.0 + 0.1 * k, "|", *beside])
    book.save(tmp_path / "report.xlsx")
    record = read(tmp_path / "report.xlsx")
    is_pair(record, P, V)
    assert record.t is None


def test_the_sheet_of_two_quantities_and_not_the_longer_one_of_a_clock(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    page = book.create_sheet("Isotherm")
    page.append(["ID", "p/p0", "V (cm³/g STP)"])
    for k, (p, v) in enumerate(zip(P.tolist(), V.tolist(), strict=True), 1):
        page.append([k, p, v])
    log = book.create_sheet("Pressure")
    log.append(["Index", "Time(s)", "Pressure(kPa)"])
    for k in range(40 * P.size):
        log.append([k // 20, k % 20, 0.5 + 0.01 * k])
    book.save(tmp_path / "log.xlsx")
    is_pair(read(tmp_path / "log.xlsx"), P, V)


def test_two_tables_with_titles_of_branches_and_an_end_mark_each(tmp_path: Path) -> None:
    """Rows of zeros stand below the numbered ones, and rules around the titles."""
    mark = "\n".join(["=" * 20, " {} data", "=" * 20, '"No."\t"Pe/kPa"\t"P0/kPa"\t"V/ml(STP) g-1"', ""])
    table = lambda p, v: rows("\t", np.arange(1, p.size + 1), p, np.full(p.size, 20.0), v) + "0\t0\t0\t0\n"
    text = mark.format("Adsorption") + table(P[:20], V[:20]) + mark.format("Desorption") + table(P[20:], V[20:])
    is_pair(one(tmp_path, '"Sample weight/g:"\t0.0352\n' + text, "a.DAT"), P, V)


@pytest.mark.parametrize("unit", ["Torr", "mmHg"])
def test_names_and_units_apart_below_each_other(unit: str, tmp_path: Path) -> None:
    """Blank lines around the units of some columns; a volume at standard conditions is an adsorbed amount."""
    cells = lambda *texts: "".join(f"{text:>17}" for text in texts) + "\n"
    text = "Analysis gas:  Nitrogen            CellType:      9mm w/o rod\n\n"
    text += (
        cells("Press ", "P0 ", "Volume @ STP", "Tol", "Equ") + "\n" + cells(f"{unit} ", f"{unit} ", "cc     ") + "\n"
    )
    for p, v in zip(P, V, strict=True):
        text += cells(p, 767.12, v, 2, 3)
    record = one(tmp_path, text, "raw.txt")
    is_pair(record, P, V)
    assert (record.u_name, record.u_unit, record.y_name, record.y_unit) == ("Press", unit, "Volume @ STP", "cc")


def test_classic_netcdf(tmp_path: Path) -> None:
    with netcdf_file(tmp_path / "run.nc", "w") as file:
        file.createDimension("time", N)
        for name, values, unit in (("time", T, "s"), ("voltage", U, "V"), ("displacement", Y, "um")):
            variable = file.createVariable(name, "d", ("time",))
            variable[:] = values
            variable.units = unit
    record = read(tmp_path / "run.nc")
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("V", "um")


def test_a_relay_follows_the_temperature(tmp_path: Path) -> None:
    warm, states = 20 + np.sin(np.arange(N) / 6).round(3), []
    for value in warm:
        states.append(1 if value < 19.6 else 0 if value > 20.4 or not states else states[-1])
    is_pair(one(tmp_path, "Room Temp [°C],Heater Cmd\n" + rows(",", warm, np.array(states))), warm, np.array(states))


def test_a_load_and_not_a_part_of_it(tmp_path: Path) -> None:
    """The cells below a specimen add up to the last column; a commanded load is no part of its measurement."""
    part = (0.4 * Y + 0.01 * np.sin(U)).round(6)
    text = "Disp [mm],Cell N [kN],Cell S [kN],Total Load [kN]\n"
    record = one(tmp_path, text.replace("Cell", "Load Cell") + rows(",", U, part, (Y - part).round(6), Y))
    assert record.y_name == "Total Load [kN]"
    relative = "x_table[mm],x_rel[mm],F_iso[kN]\n"
    record = one(tmp_path, relative + rows(",", 1.1 * U + 0.1 * np.sin(Y), U, Y))
    assert (record.u_name, record.y_name) == ("x_rel[mm]", "F_iso[kN]")


def test_cycles_in_words_are_one_test(tmp_path: Path) -> None:
    cycles = np.array([f"C{1 + 3 * k // N}" for k in range(N)])
    steps = np.where(np.gradient(U) >= 0, "load", "unload")
    is_pair(one(tmp_path, "Cycle,Phase,Strain [%],Stress [MPa]\n" + rows(",", cycles, steps, U, Y)))
    assert len(np.unique(cycles)) == 3


def test_the_gate_of_a_transistor_drives_its_drain(tmp_path: Path) -> None:
    """A drain current with fewer harmonics than the sweep of the gate."""
    gate = np.r_[np.linspace(1.1, -1.1, 65), np.linspace(-1.1, 1.1, 65)].round(4)
    drain = 2e-9 * (
        1.2 + np.cos(np.linspace(0, 2 * np.pi, gate.size)) + 0.1 * np.sin(np.linspace(0, 2 * np.pi, gate.size))
    )
    record = one(tmp_path, "V_G [V],I_D [A]\n" + rows(",", gate, drain))
    assert (record.u_name, record.y_name) == ("V_G [V]", "I_D [A]")


def test_a_column_of_on_and_off_is_a_state(tmp_path: Path) -> None:
    """Beside one column of numbers these are no two sensors that write in turn."""
    warm, states = (4 + 1.5 * np.sin(np.arange(N) / 6)).round(2), []
    for value in warm:
        states.append("ON" if value > 5 else "OFF" if value < 3 or not states else states[-1])
    stamps = 1_600_000_000 + 60 * np.arange(N)
    record = one(tmp_path, "timestamp,temperature_C,compressor\n" + rows(",", stamps, warm, np.array(states)))
    is_pair(record, warm, np.array(states) == "ON")


def test_turkish_text(tmp_path: Path) -> None:
    text = "Zaman (sn);Yerdeğiştirme (mm);Yatay Yük (kN)\n" + rows(";", T, U, Y)
    assert one(tmp_path, text.encode("cp1254")).u_name == "Yerdeğiştirme (mm)"


def test_remarks_right_of_the_names_in_a_sheet(tmp_path: Path) -> None:
    """A summary two columns further right stands in the rows of the names and of their units."""
    book = openpyxl.Workbook()
    page = book.create_sheet("Rig")
    page.append(["Rig", "MTS 810"])
    page.append(["Time", "Stroke", "Load", "", "Fmax", "12.3"])
    page.append(["s", "mm", "kN", "", "Fmin", "-12.1"])
    for k, row in enumerate(zip(T.tolist(), U.tolist(), Y.tolist(), strict=True)):
        page.append([*row, "", f"cycle {k}", 3.3 * k] if k < 5 else row)
    book.save(tmp_path / "rig.xlsx")
    record = read(tmp_path / "rig.xlsx")
    is_pair(record)
    assert (record.u_name, record.y_unit) == ("Stroke", "kN")


def test_a_channel_that_every_fifth_row_has(tmp_path: Path) -> None:
    """A logger writes the force at each row and the displacement at every fifth."""
    force = np.repeat(Y, 5) + np.tile(0.001 * np.arange(5), N)
    cells = "".join(f"{0.02 * k:.2f},{f:.9g},{U[k // 5] if k % 5 == 0 else ''}\n" for k, f in enumerate(force))
    is_pair(one(tmp_path, "t [s],F [N],x [mm]\n" + cells), U, [float(f"{f:.9g}") for f in force[::5]])


def test_the_current_that_makes_the_torque(tmp_path: Path) -> None:
    """That along the other axis of a motor is a small part of it."""
    record = one(tmp_path, "id_A,iq_A,torque_Nm\n" + rows(",", 0.01 * U, U, Y))
    assert (record.u_name, record.y_name) == ("iq_A", "torque_Nm")


@pytest.mark.parametrize(
    ("start", "remedy"), [(b"BIO-LOGIC MODULAR FILE\x1a", "mpt"), (b"NEWARE2020", "CSV"), (b"\x80\x05\x95", "npz")]
)
def test_raw_files_of_programs_are_refused_with_their_remedy(start: bytes, remedy: str, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=remedy):
        read(written(tmp_path, start + bytes(range(256)) * 9, "run.dat"))


def test_an_archive_of_another_ending(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "run.ndax", "w") as archive:
        archive.writestr("data.csv", "V (V),x (um)\n" + rows(",", U, Y))
    is_pair(read(tmp_path / "run.ndax" / "data.csv"))


def test_a_short_sheet_that_cannot_be_read_beside_the_measurement(tmp_path: Path) -> None:
    """The first sheet of a cycler has one row of numbers below names."""
    book = openpyxl.Workbook()
    page = book.create_sheet("Rig")
    page.append(["Channel", "Serial", "Version", "Aux"])
    page.append([11, 206951, 7, 0])
    sheet = book.create_sheet("Channel_11_1")
    sheet.append(["Test_Time(s)", "Voltage(V)", "Displacement(um)"])
    for row in zip(T.tolist(), U.tolist(), Y.tolist(), strict=True):
        sheet.append(row)
    book.save(tmp_path / "channel.xlsx")
    is_pair(read(tmp_path / "channel.xlsx"))


def test_a_second_time_is_no_output(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="found 1 column"):
        one(tmp_path, "time/s,Voltage,I Range,Time\n" + rows(",", T, U, np.full(N, 14), T))


def test_names_in_two_lines_are_no_properties_of_the_sample(tmp_path: Path) -> None:
    """The second line of the names, "Density  Weight", is no density of "Weight"."""
    pressure = np.append(np.linspace(20, 900, 12), np.linspace(850, 20, 11))
    loading = np.append(np.linspace(0.1, 2.2, 12), np.linspace(2.15, 0.3, 11))
    head = "Sample Dry Mass               8.9674 mg\n\n"
    head += "Pressure   Gas        Total      Excess       \n           Density    Weight     Adsorption   \n"
    head += "(mbar)     (g/cc)     (mg)       (mmol/g)     \n" + 45 * "-" + "\n"
    rows = [
        f"{p:<11.1f}{p * 1e-6:<11.6f}{8.97 + a / 100:<11.4f}{a:<13.4f}" for p, a in zip(pressure, loading, strict=True)
    ]
    path = tmp_path / "isotherm.txt"
    path.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
    record = read(path)
    assert record.metadata == {"Sample Dry Mass": "8.9674 mg"}
    assert (record.u_unit, record.y_unit) == ("mbar", "mmol/g")


def test_two_settings_in_a_line_are_one_property_of_the_sample(tmp_path: Path) -> None:
    head = "Sample ID:     BF1_N2_77           Filename:      BF1.QPS\nSample Desc:                       Comment:\n"
    head += "Sample weight: 0.0101 g\n\n"
    path = tmp_path / "isotherm.txt"
    path.write_text(f"{head}Press (mmHg)\tVolume (cc)\n{rows(chr(9), P, V)}", encoding="utf-8")
    assert read(path).metadata == {"Sample ID": "BF1_N2_77", "Sample weight": "0.0101 g"}
