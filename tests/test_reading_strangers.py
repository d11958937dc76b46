"""Files of instruments and repositories that were read wrong, refused, or read without their names."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Dataset
from hystfit.errors import DataError
from hystfit.outcome import Code
from hystfit.params.units import conversion
from hystfit.reading import read

from .conftest import examined
from .loop_files import N, U, Y, is_pair, one, rows, written

T = np.round(0.1 * np.arange(N), 1)


# Encodings ----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("header", "names"),
    [
        ("Badanie próbki;Józef Żółć\nCzas [s];Przemieszczenie [mm];Siła [kN]\n", ("Przemieszczenie [mm]", "Siła [kN]")),
        ("Měření\nČas (s);Posun (mm);Zatížení (kN);Řízení (V)\n", ("Posun (mm)", "Zatížení (kN)")),
        ("Idő [s];Elmozdulás [mm];Erő [kN]\n", ("Elmozdulás [mm]", "Erő [kN]")),
    ],
)
def test_central_european_text(header: str, names: tuple[str, str], tmp_path: Path) -> None:
    columns = (T, U, Y, U) if "Řízení" in header else (T, U, Y)
    record = one(tmp_path, (header + rows(";", *columns)).encode("cp1250"))
    is_pair(record)
    assert (record.u_name, record.y_name) == names


def test_japanese_text_without_a_known_word(tmp_path: Path) -> None:
    """Paths of a university and degrees in half-width signs are the only text beyond ASCII in the header of a magnetometer."""
    header = "seq filename=,C:\\東北大学_2\\a.seq\ntemperature=,-300,(ﾟC)\nDate,H(Oe),M(emu)\n"
    stamps = [f"2022/12/15 15:32:{k:02d}" for k in range(N)]
    record = one(tmp_path, (header + rows(",", np.array(stamps), U, Y)).encode("cp932"), "loop.VSM")
    is_pair(record)
    assert any("encoding cp932" in note.text for note in record.notes)


# Times --------------------------------------------------------------------------------------------------------------------------


def test_stamps_that_run_back_are_not_the_time_beside_one_that_does_not(tmp_path: Path) -> None:
    """Stamps of a data logger that counts hundredths down within each second, as in the files of steel coupons."""
    stamps = [f"2020-09-10 17:01:{49 + k // 5:02d}.{900 - 200 * (k % 5):03d}" for k in range(N)]
    record = one(
        tmp_path, "S/No,System Date,Time[s],e_true,Sigma_true\n" + rows(",", np.arange(N), np.array(stamps), T, U, Y)
    )
    is_pair(record)
    np.testing.assert_allclose(record.t, T)


def test_a_column_in_milliseconds_is_the_time_whatever_its_name(tmp_path: Path) -> None:
    """PicoScope writes "Frequency" over the times where its window showed a spectrum last."""
    record = one(tmp_path, "Frequency,Channel A,Channel B\n(ms),(V),(V)\n\n" + rows(",", T, U, Y))
    is_pair(record)
    np.testing.assert_allclose(record.t, T)
    assert record.t_unit == "ms"


# Columns ------------------------------------------------------------------------------------------------------------------------


def test_two_numbered_gauges_over_a_count_of_rows_are_no_branches(tmp_path: Path) -> None:
    u = np.round(np.sin(np.linspace(0, 4 * np.pi, N)), 4)
    header = "Title\tElapsed Seconds\tSG1\tSG2\tAct Disp\tAct Load\nUnits\tSeconds\tµe\tµe\tin\tkips\n"
    content = header + rows("\t", np.arange(1, N + 1), T, np.round(210 * u), np.round(-190 * u), u, Y)
    record = one(tmp_path, content)
    is_pair(record, u)


def test_the_signed_charge_of_a_cycler_drives_the_voltage(tmp_path: Path) -> None:
    current = np.repeat([-0.15, 0.15], N // 2)
    charge = np.round(np.cumsum(current) / 12, 5)
    columns = (
        T,
        np.round(3 + charge, 4),
        current,
        charge,
        np.maximum(charge, 0),
        -np.minimum(charge, 0),
        np.round(charge * 3.6, 4),
    )
    header = "Prog.Zeit;Spannung;Strom;AhAkku;AhLad;AhEla;WhAkku\ns;V;A;Ah;Ah;Ah;Wh\n"
    record = one(tmp_path, header + rows(";", *columns))
    np.testing.assert_allclose(record.u, charge)
    assert (record.u_unit, record.y_name) == ("Ah", "Spannung")


@pytest.mark.parametrize(
    "names", [("CA left [°]", "CA right [°]", "CA mean [°]"), ("CA(L) [°]", "CA(R) [°]", "CA(M) [°]")]
)
def test_the_mean_of_two_sides_is_the_output(names: tuple[str, str, str], tmp_path: Path) -> None:
    header = f"Age [s];Volume [µL];{';'.join(names)};Base diameter [mm]\n"
    record = one(tmp_path, header + rows(";", T, U, Y - 1, Y + 1, Y, np.round(U / 9, 3)))
    is_pair(record)
    assert record.y_name == names[2]


# Headers ------------------------------------------------------------------------------------------------------------------------


def test_a_ratio_of_pressures_stands_in_a_row_of_units(tmp_path: Path) -> None:
    header = "     Relative Pressure          Volume @ STP\n          P/Po                      cc/g\n\n"
    record = one(tmp_path, header + rows("    ", U / 60, Y), "iso.txt")
    is_pair(record, U / 60)
    assert (record.u_name, record.y_name, record.y_unit) == ("Relative Pressure", "Volume @ STP", "cc/g")


def test_units_behind_a_german_word(tmp_path: Path) -> None:
    header = "[Kanäle]\nName\tZeit\tWeg\tKraft\nEinheit\ts\tmm\tkN\nKommentar\t\tTraverse\tKMD 50kN\n[Daten]\n"
    record = one(tmp_path, header + rows("\t", np.arange(1, N + 1), T, U, Y))
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("mm", "kN")


def test_names_and_units_of_columns_that_no_row_has(tmp_path: Path) -> None:
    """The strain of a creep test beside its time, below names of a stress and a temperature that the file leaves out."""
    with pytest.raises(DataError, match=r"1 column.* of changing numbers beside the time"):
        read(written(tmp_path, "stress=10;T=150\nt\tstrain\tstress\tT\ns\t-\tPa\tC\n" + rows("\t", T, Y), "a.creep"))


@pytest.mark.parametrize(("rate", "dt"), [("500 kSa/s", 2e-6), ("2 MSa/s", 5e-7), ("1 ksps", 1e-3), ("100 Sa/s", 0.01)])
def test_samples_per_second_with_prefixes(rate: str, dt: float, tmp_path: Path) -> None:
    record = one(tmp_path, f"Sample Rate: {rate}\nCH1(V),CH2(V)\n" + rows(",", U, Y))
    assert record.dt == pytest.approx(dt)


def test_cycles_that_a_testing_machine_stores(tmp_path: Path) -> None:
    """Every hundredth cycle, each below its head: the names begin a record although the clock goes on."""
    head = "Cyclic Acquisition\t\t\t\tTime:\t{}\tSec\nStored at: \t{}\tcycle\nPoints: \t51\nTime\tAxial Fuerza\tAxial Weg\nSec\tkgf\tmm\n"
    cycles = [head.format(100 * k, 100 * k) + rows("\t", T + 100 * k, U, Y) + "\n" for k in range(1, 4)]
    data = Dataset.of(read(written(tmp_path, "MTS***|MPT|**|*|*\n\n" + "".join(cycles), "cycles.dat")))
    assert len(data) == 3
    texts = [note.text for note in data[0].notes]
    assert not any("do not begin a curve" in text for text in texts), texts


def test_loops_that_an_index_tells_apart(tmp_path: Path) -> None:
    """Tables of piezoresponse microscopes: the loops follow each other, and each may be read alone."""
    loops = np.repeat([1, 2], [N // 2, N - N // 2])
    record = one(tmp_path, "Loop index\tWrite Volt (V)\tPiezoresponse (pm)\n" + rows("\t", loops, U, Y))
    is_pair(record)
    assert any("by='Loop index'" in note.text for note in record.notes)


@pytest.mark.parametrize("before", ["", "0;123456789;400;"])
def test_rows_of_samples_that_are_counted(before: str, tmp_path: Path) -> None:
    """Lock-in amplifiers and transposed frames: a first line counts the samples, and each other one begins with its quantity."""
    lines = [("chunk;timestamp;size;fieldname" if before else "") + "".join(f";{k}" for k in range(N))]
    lines += [
        f"{before}{name};" + ";".join(map(str, values)) for name, values in (("voltage_V", U), ("position_um", Y))
    ]
    record = one(tmp_path, "\n".join(lines) + "\n")
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("V", "um")


@pytest.mark.parametrize(
    "names", ["time /s\tI /mA\tE /V", "time/s\tI/mA\tEwe/V", "Test_Time(s)\tCurrent(mA)\tVoltage(V)"]
)
def test_the_charge_of_a_cell_at_constant_currents(names: str, tmp_path: Path) -> None:
    current = np.repeat([0.085, -0.085] * 2, 100)
    time = 60.0 * np.arange(current.size)
    charge = np.cumsum(current) / 60.0
    voltage = np.round(3.0 + np.tanh(charge) + np.sign(current) * 0.1, 4)
    record = one(tmp_path, names + "\n" + rows("\t", time, current, voltage))
    np.testing.assert_allclose(record.u, charge - charge[0], atol=1e-12)
    np.testing.assert_array_equal(record.y, voltage)
    assert (record.u_unit, record.y_unit) == ("mAh", "V")


def test_the_charge_of_a_current_in_a_spelled_unit_is_in_its_symbol(tmp_path: Path) -> None:
    current = np.where(np.arange(N) % 60 < 30, 0.5, -0.5)
    voltage = 3.4 + 0.01 * np.cumsum(current) + 0.05 * current
    record = one(tmp_path, "t (s),U (volts),I (milliampere)\n" + rows(",", 60 * np.arange(N), voltage, current))
    assert record.u_unit == "mAh"
    np.testing.assert_allclose(np.diff(record.u), current[1:] / 60, atol=1e-12)


@pytest.mark.parametrize("behind", ["", ",,"])
@pytest.mark.parametrize("quote", ["", '""'])
def test_rows_that_are_quoted_as_one_cell_each_are_read(quote: str, behind: str, tmp_path: Path) -> None:
    """A file of a cycler that a spreadsheet took for one column: the lines above the numbers are quoted where they hold a comma."""
    table = rows(",", T, U, Y).splitlines()
    names = f"{quote}Time (s){quote},{quote}Voltage (V){quote},{quote}Travel (um){quote}"
    lines = ["[Summary]", "Bench 3", '"   [Hold, then ramp]"', "[Data]", *(f'"{line}"' for line in [names, *table])]
    record = one(tmp_path, "\n".join(line + behind for line in lines) + "\n")
    is_pair(record)
    assert (record.u_name, record.y_unit) == ("Voltage (V)", "um")


@pytest.mark.parametrize("error", ["Deviation %", "Abweichung [%]", "Error (%)"])
def test_the_deviation_from_the_set_value_is_not_the_output(error: str, tmp_path: Path) -> None:
    """The protocol of a valve positioner: the signal, the travel and how far that is from the signal."""
    signal = np.concatenate([np.linspace(4, 20, 33), np.linspace(19.5, 4, 32)])
    travel = np.round(
        100 / 16 * (signal - 4 + np.where(np.arange(65) < 33, -0.3, 0.3)) + 0.05 * np.sin(7.0 * np.arange(65)), 2
    )
    aim = np.round(100 / 16 * (signal - 4), 2)
    record = one(
        tmp_path, f"Step,Signal mA,Travel %,{error}\n" + rows(",", np.arange(65), signal, travel, travel - aim)
    )
    np.testing.assert_allclose(record.u, signal)
    np.testing.assert_allclose(record.y, travel)
    assert (record.u_unit, record.y_name, record.y_unit) == ("mA", "Travel %", "%")


def test_infinities_in_the_log_of_a_cell(tmp_path: Path) -> None:
    charge = np.where(np.arange(N) % 50 < 2, np.inf, 1e-3 * np.arange(N))
    path = written(tmp_path, "Time(s),Voltage(V),Current(A),Capacity(Ah)\n" + rows(",", T, U, Y, charge), "cell.csv")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(path, input="Voltage(V)", output="Current(A)")


def test_a_voltage_that_is_swept_drives_a_current_of_two_values(tmp_path: Path) -> None:
    """Cyclic voltammetry of a capacitor, of which the current is a rectangle."""
    voltage = np.round(0.01 * np.concatenate([np.arange(100), np.arange(100, -100, -1), np.arange(-100, 0)]), 2)
    current = np.round(np.sign(np.gradient(voltage)) * 0.002 + 1e-6 * voltage, 8)
    text = "Time (s),Potential applied (V),WE(1).Current (A)\n"
    is_pair(one(tmp_path, text + rows(",", 0.02 * np.arange(voltage.size), voltage, current)), voltage, current)


def test_a_voltage_that_is_swept_drives_its_current_beside_a_charge(tmp_path: Path) -> None:
    """Cyclic voltammetry by a program for cells, which writes the charge that passed as well."""
    voltage = np.tile(np.concatenate([np.arange(80), np.arange(80, 0, -1)]) / 100, 2)
    time, way = 0.2 * np.arange(320), np.where(np.arange(320) % 160 < 80, 1.0, -1.0)
    current = np.round(way * (2 - 2 * np.exp(-(np.arange(320) % 80) / 6)) + 0.3 * voltage, 6)
    charge = np.round(np.cumsum(current) * 2e-4, 8)
    measured = np.round(voltage + 1e-4 * np.sin(37 * np.arange(320)), 6)
    names = "time/s\tcontrol/V\tEwe/V\t<I>/mA\t(Q-Qo)/C\n"
    record = one(tmp_path, names + rows("\t", time, voltage, measured, current, charge), "a.mpt")
    is_pair(record, measured, current)


# Tables of rock magnetism ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "unit"), [("magn_mass", "Am2/kg"), ("susc_chi_mass", "m3/kg")])
def test_magic_tables_of_a_temperature(name: str, unit: str, tmp_path: Path) -> None:
    lines = [f"tab\tmeasurements\nspecimen\texperiment\tmethod_codes\tmeas_temp\tmeas_field_dc\t{name}\n"]
    for code in ("LP-FC", "LP-ZFC"):
        lines += [f"A73\tA73-{code}\t{code}\t{u}\t0.0025\t{y}\n" for u, y in zip(U, Y + len(code), strict=True)]
    data = read(written(tmp_path, "".join(lines), "mpms.txt"))
    assert isinstance(data, Dataset)
    assert len(data) == 2
    for record, code in zip(data, ("LP-FC", "LP-ZFC"), strict=True):
        is_pair(record, U, Y + len(code))
        assert (record.u_unit, record.y_unit) == ("K", unit)


def test_records_of_json_are_named_by_what_tells_them_apart(tmp_path: Path) -> None:
    tests = [{"lab": "X", "specimen": f"W{k}", "drift": (k * U).tolist(), "shear": Y.tolist()} for k in (1, 2)]
    data = read(written(tmp_path, json.dumps({"tests": tests}), "walls.json"))
    assert [record.name for record in Dataset.of(data)] == ["W1", "W2"]


# Columns without names ----------------------------------------------------------------------------------------------------------

S = 0.01 * np.arange(600)
STROKE = np.clip(19.0 - 19.0 * np.cos(np.pi * np.arange(600) / 150.0), 0.0, 38.0)  # [mm], four of them


def _friction(position: np.ndarray) -> np.ndarray:
    """Force [N] of an elastic bristle that slips at 6 N, as a plain loop."""
    force, values = 0.0, []
    for step in np.diff(position, prepend=position[0]):
        force = min(max(force + 12.0 * step, -6.0), 6.0)
        values.append(50.0 + force)
    return np.array(values)


def test_signals_in_volts_beside_the_same_in_their_units_are_no_further_columns(tmp_path: Path) -> None:
    """A logger without names writes each sensor as it was sampled and as it was calibrated, both with three decimals."""
    force = _friction(STROKE)
    columns = (1000.0 * S, 4.563 + STROKE / 13.33, force / 46.16, STROKE, force)
    record = one(tmp_path, "\n".join("\t".join(f"{x:.3f}" for x in row) for row in zip(*columns, strict=True)))
    np.testing.assert_allclose(record.u, STROKE, atol=1e-3)
    np.testing.assert_allclose(record.y, force, atol=1e-3)


def test_a_narrow_loop_over_coarse_steps_is_no_copy_of_its_input(tmp_path: Path) -> None:
    """A piezo actuator of which the loop is less than a step of its voltage wide, beside the drift of a second sensor."""
    volts = np.concatenate([np.arange(0.0, 100.0), np.arange(100.0, -1.0, -1.0)] * 2)
    drive = np.diff(volts, prepend=0.0)
    stroke = 0.12 * volts + 0.1 * np.sin(np.pi * volts / 100.0) * (drive < 0)
    columns = (0.1 * np.arange(volts.size), volts, stroke, 3.0 + 0.5 * np.sin(0.1 * np.arange(volts.size)))
    record = one(tmp_path, "\n".join(",".join(f"{x:.4f}" for x in row) for row in zip(*columns, strict=True)))
    np.testing.assert_allclose(record.y, stroke, atol=1e-4)


def test_rows_under_a_key_have_no_more_names_than_rows_alone(tmp_path: Path) -> None:
    """Channels of a damper at 1000 samples per s: time, displacement, force and its two load cells."""
    force = _friction(STROKE) - 50.0
    rows_ = np.column_stack([S, STROKE, force, 22.0 - 0.56 * force, 6.0 + 0.44 * force + 0.01 * np.sin(S)]).tolist()
    for content in (rows_, {"data": rows_}):
        (tmp_path / "damper.json").write_text(json.dumps(content))
        with pytest.raises(DataError, match="--input 1 --output 2 or --input 2 --output 1"):
            read(tmp_path / "damper.json")


def test_a_clock_is_no_output_of_the_signal_beside_it(tmp_path: Path) -> None:
    """The recorder of a node writes the time of the analysis and a displacement: half of a pair, and no loop."""
    record = one(tmp_path, rows(" ", S, STROKE), "Disp.out")
    np.testing.assert_allclose(record.u, S)
    assert any(note.code is Code.NO_LOOP for note in examined(record).findings)


@pytest.mark.parametrize(
    ("head", "units"),
    [("T(℃),L(㎜)\n", ("°C", "mm")), ("温度,変位\n℃,㎜\n", ("degC", "mm")), ("T [℃],ΔL [㎛]\n", ("°C", "μm"))],
)
def test_units_of_one_character(head: str, units: tuple[str, str], tmp_path: Path) -> None:
    record = one(tmp_path, head + rows(",", U, Y))
    is_pair(record)
    assert all(conversion(own, unit) == 1.0 for own, unit in zip((record.u_unit, record.y_unit), units, strict=True))


@pytest.mark.parametrize("comment", ["", "\tPZT 1 Hz\n"])
def test_names_and_units_that_origin_exports(comment: str, tmp_path: Path) -> None:
    """Long names, units with marks for Greek letters and powers, and the comments of the columns."""
    head = "A(X)\tB(Y)\nElectric Field \\i(E)\tPolarization\nkV cm\\+(-1)\t\\g(m)C/cm\\+(2)\n" + comment
    record = one(tmp_path, head + rows("\t", U, Y), "loop.dat")
    is_pair(record)
    assert (record.u_name, record.y_name) == ("Electric Field E", "Polarization")
    assert (record.u_unit, record.y_unit) == ("kV cm-1", "µC/cm2")


def test_paths_in_a_header_have_no_marks_of_origin(tmp_path: Path) -> None:
    record = one(tmp_path, "Sample: D:\\film\\b(2)\nField (Oe),Moment (emu)\n" + rows(",", U, Y))
    is_pair(record)
    assert record.metadata["Sample"] == "D:\\film\\b(2)"
