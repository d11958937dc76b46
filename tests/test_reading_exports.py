"""Exports whose names, roles or order tell less than those of other files: what is read, and when the user is asked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hystfit.errors import DataError
from hystfit.reading import read
from hystfit.reading.table.signal_evidence import roughness
from tests.loop_files import N, U, Y, is_pair, one, rows, written

T = np.round(0.1 * np.arange(N), 1)
NOISE = np.random.default_rng(5).normal(size=(4, N))


# Lines around the names ---------------------------------------------------------------------------------------------------------


def test_a_remark_below_the_names_is_no_name(tmp_path: Path) -> None:
    """The log of a magnetometer has its comments in the rows of the table, the first of them before any number."""
    names = "Comment,Time Stamp (sec),Temperature (K),Magnetic Field (Oe),Moment (emu),M. Std. Err. (emu)"
    table = rows(",", np.full(N, ""), T, np.full(N, 300.0), U, Y, np.full(N, 1e-6))
    record = one(
        tmp_path, f"[Header]\nTITLE,film\n[Data]\n{names}\nMoment against field at 300 K,,,,,\n{table}", "loop.dat"
    )
    is_pair(record)
    assert (record.u_name, record.y_name) == ("Magnetic Field (Oe)", "Moment (emu)")


def test_the_name_of_the_first_column_alone_below_the_units(tmp_path: Path) -> None:
    """As pandas writes columns of two levels and their index."""
    record = one(tmp_path, "sensor,lvdt1,loadcell\nunit,mm,kN\ntime,,\n" + rows(",", T, U, Y))
    is_pair(record)
    assert (record.u_name, record.u_unit, record.y_name, record.y_unit) == ("lvdt1", "mm", "loadcell", "kN")


def test_names_behind_a_word_among_other_lines(tmp_path: Path) -> None:
    header = "trace_names,time,u_amp,x_sensor\ntrace_paths,,Root/DAC/In,Root/ADC/Out\ntrace_units,s,V,um\n"
    record = one(tmp_path, header + rows(",", np.full(N, "trace_values"), T, U, Y))
    is_pair(record)
    assert (record.u_name, record.y_name) == ("u_amp", "x_sensor")


def test_names_that_are_centered_over_their_columns(tmp_path: Path) -> None:
    pressure = np.round(np.concatenate([np.linspace(0.05, 0.95, N // 2), np.linspace(0.95, 0.05, N // 2)]), 4)
    header = "Relative         Volume @ STP\n   Pressure\n     P/Po              [cc/g]\n\n"
    record = one(
        tmp_path, header + "".join(f"  {p:9.4f}     {q:12.4f}\n" for p, q in zip(pressure, Y, strict=True)), "a.txt"
    )
    is_pair(record, pressure)
    assert (record.y_name, record.y_unit) == ("Volume @ STP [cc/g]", "cc/g")


def test_units_in_brackets_with_blanks(tmp_path: Path) -> None:
    record = one(tmp_path, "Time\tReference 1\tDisplacement\n[ s ]\t[ V ]\t[ m ]\n" + rows("\t", T, U, Y), "vib.txt")
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("V", "m")


def test_labels_and_units_of_channels_in_the_settings_of_an_oscilloscope(tmp_path: Path) -> None:
    record = one(tmp_path, "Model,X54\nSample Interval,0.1\nLabel,Iprim,Vint\nTIME,CH1,CH2\n" + rows(",", T, U, Y))
    is_pair(record)
    assert (record.u_name, record.y_name) == ("Iprim", "Vint")
    settings = "Vertical Units,V,A\nHorizontal Units,s\nSource,CH1,CH2\nSecond,Value,Value\n"
    assert one(tmp_path, settings + rows(",", T, U, Y)).u_unit == "V"


def test_a_field_whose_name_has_a_minus_sign(tmp_path: Path) -> None:
    """Tables of demagnetization curves have the size of the field."""
    field = np.linspace(0, 14, N).round(3)
    record = one(
        tmp_path, "-H [kOe]\tJ [kG]\n" + rows("\t", field, np.round(12.8 * np.tanh(13.5 - field), 4)), "demag.txt"
    )
    np.testing.assert_allclose(record.u, -field)
    assert record.u_name == "H [kOe]"


# Roles --------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("names", ["x,y,r,phase", "X (V),Y (V),R (V),Theta (deg)"])
def test_components_of_a_signal_are_no_displacement(names: str, tmp_path: Path) -> None:
    x, y = 1e-4 * (Y - 30), 1e-6 * NOISE[0]
    columns = [np.round(column, 12) for column in (x, y, np.hypot(x, y), np.degrees(np.arctan2(y, x)))]
    record = one(tmp_path, f"time (s),auxin0,{names}\n" + rows(",", T, U, *columns))
    is_pair(record, y=columns[0])


def test_a_component_beside_a_field(tmp_path: Path) -> None:
    columns = [U - 40, np.round(1e-5 * (Y - 30), 10), np.round(1e-8 * NOISE[0], 12)]
    is_pair(one(tmp_path, "B_hall(mT)\tX(V)\tY(V)\n" + rows("\t", *columns), "kerr.dat"), columns[0], columns[1])


def test_a_pressure_that_is_measured_moves(tmp_path: Path) -> None:
    command = np.round(U + 0.1 * NOISE[0], 3)
    record = one(
        tmp_path, "t\tp_cmd\tp_meas\tcontraction\ns\tkPa\tkPa\tmm\n" + rows("\t", T, command, U, Y), "muscle.tsv"
    )
    is_pair(record)


def test_a_ratio_of_pressures_comes_before_those_that_it_is_computed_from(tmp_path: Path) -> None:
    ratio = np.round(U / 101.3, 6)
    names = "No\tPi/kPa\tPe/kPa\tPe/P0\tV/ml(STP) g-1\n"
    record = one(tmp_path, names + rows("\t", np.arange(1, N + 1), np.round(U + 0.4, 3), U, ratio, Y), "sorption.dat")
    is_pair(record, ratio)


def test_steps_of_a_converter_are_no_noise() -> None:
    """Channels of one oscilloscope at different scales, of which one has steps of a power of ten."""
    wave = np.sin(np.linspace(0, 8 * np.pi, 2000))
    assert roughness(np.round(wave / 0.025) * 0.025) == roughness(np.round(wave, 2)) == 0.0
    assert roughness(wave + 0.01 * np.resize(NOISE, 2000)) > 1e-3


# Questions ----------------------------------------------------------------------------------------------------------------------


def test_three_columns_without_a_meaning_are_asked_for(tmp_path: Path) -> None:
    """The log of an optical spectrum analyzer: any of them may drive, and what drives may not be there."""
    stamps = [f"2022-03-01T10:00:{k:02d}" for k in range(N)]
    columns = [1550.12 + 1e-3 * NOISE[0], 0.21 + 0.004 * NOISE[1], 1.3 + 0.02 * NOISE[2], 40 + NOISE[3]]
    table = "Timestamp,Peak Center,Peak Width,Peak Area,Peak SNR\n" + rows(",", np.array(stamps), *columns)
    with pytest.raises(DataError, match=r"--input .* or --input"):
        read(written(tmp_path, table, "osa.csv"))


def test_an_output_alone_does_not_tell_which_of_two_columns_drives(tmp_path: Path) -> None:
    columns = [
        np.array([f"2022-03-01T10:00:{k:02d}" for k in range(N)]),
        4.2 + 0.1 * NOISE[0],
        0.19 + 0.01 * NOISE[1],
        39 + NOISE[2],
    ]
    with pytest.raises(DataError, match=r"--output Intensity or --input \w+ --output Intensity"):
        read(written(tmp_path, "Timestamp,FWHM,Intensity,OSNR\n" + rows(",", *columns), "osa.csv"))


def test_a_number_of_results_is_no_input(tmp_path: Path) -> None:
    table = "Index\tParameter\tValue (µC/cm2)\n" + "".join(f"{k}\tP{k}\t{30 - 7 * k}\n" for k in range(8))
    with pytest.raises(DataError, match=r"found 1 column\(s\)"):
        read(written(tmp_path, table, "pund.txt"))


def test_a_table_of_results_before_the_samples(tmp_path: Path) -> None:
    """As a testing machine exports them: the names of the results, of which the first column has none, are not those of the samples."""
    results = "Results Table 1\n,Maximum Load,Extension at Max\n,(kN),(mm)\n1,40.21,15.00\n\n"
    names = "Results Table 2\nTime,Extension,Load\n(s),(mm),(kN)\n"
    record = one(tmp_path, results + names + rows(",", T, U, Y))
    is_pair(record)
    assert (record.u_name, record.y_name, record.t is not None) == ("Extension", "Load", True)


def test_a_name_and_a_unit_of_each_channel_in_the_settings(tmp_path: Path) -> None:
    header = "[General]\nDevice=X\n[Channel1]\nName=Stroke\nUnit=mm\n[Channel2]\nName=Load\nUnit=kN\n[Data]\n"
    record = one(tmp_path, header + rows("\t", U, Y), "log.txt")
    is_pair(record)
    assert (record.u_name, record.u_unit, record.y_name, record.y_unit) == ("Stroke", "mm", "Load", "kN")


def test_a_unit_below_one_name_alone(tmp_path: Path) -> None:
    record = one(
        tmp_path, "Suction\tWater content\tPath\nkPa\t\t\n" + rows("\t", U, Y, np.full(N, "drying")), "swrc.csv"
    )
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("kPa", "")
