"""Exports of test benches, tires, soils, stages and controllers, whose names and headers tell their columns in a way of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from hystfit.data import Dataset
from hystfit.errors import DataError
from hystfit.params.units import conversion
from hystfit.reading import read

from .loop_files import N, U, Y, is_pair, one, rows


def test_units_before_the_label_of_a_run(tmp_path: Path) -> None:
    names = '"Time (s) Run #1","Position (m) Run #1","Force (N) Run #1"\n'
    record = one(tmp_path, names + rows(",", 0.05 * np.arange(N), U, Y))
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("m", "N")


def test_of_components_of_a_force_that_which_moves(tmp_path: Path) -> None:
    """A slip angle is swept: the drag is a hundredth of the lateral force and goes up and down with it."""
    drag = np.round(0.01 * Y + 0.03, 5)
    table = rows("\t", 0.01 * np.arange(N), U, drag, Y, -1000 + 0.0 * U + drag)
    record = one(tmp_path, "ET\tSA\tFX\tFY\tFZ\nsec\tdeg\tN\tN\tN\n" + table, "tire.dat")
    is_pair(record)
    assert (record.u_name, record.y_name) == ("SA", "FY")


def test_water_content_answers_suction(tmp_path: Path) -> None:
    record = one(tmp_path, "TS,VWC_Avg,MPS6_kPa_Avg\n" + rows(",", 1800 * np.arange(N), Y / 100, -U))
    is_pair(record, -U, Y / 100)


def test_friction_of_rock_answers_the_slip(tmp_path: Path) -> None:
    gouge = np.round(0.1 * np.cos(np.linspace(0, 4 * np.pi, N)), 4)
    names = "time_s\tmu\tvdcdt_um\thdcdt_um\trecnum\n"
    record = one(tmp_path, names + rows("\t", 0.1 * np.arange(N), Y, U, gouge, np.arange(N)), "p4342.txt")
    is_pair(record)


def test_voltage_of_an_output_channel_drives_the_stage(tmp_path: Path) -> None:
    head = "# REM E-727\n# SAMPLE_TIME = 0.0005\n# NAME0 = Target Position of axis 1\n# NAME1 = Current Position of axis 1\n"
    head += "# NAME2 = Voltage of output chan 1\n# END_HEADER\n"
    target = Y + np.random.default_rng(3).normal(0, 0.01, N).round(4)
    record = one(tmp_path, head + rows(" ", target, Y, U), "recorder.dat")
    is_pair(record)


def test_units_and_interval_of_channels_with_a_clock_each(tmp_path: Path) -> None:
    """A scope of a controller repeats every key before the value of every channel, and states the interval with its unit there."""
    head = "Name;Scope\nStarttime of export;132537312345678901\n\nName;Axis1.ActPos;Name;Axis1.ActTorque\n"
    head += "Data-Type;REAL64;Data-Type;REAL64\n"
    head += "SampleTime[ms];10;SampleTime[ms];10\nUnit;deg;Unit;Nm\nScaleFactor;1;ScaleFactor;1\n\n"
    clock = 10 * np.arange(N)
    record = one(tmp_path, head + rows(";", clock, U, clock, Y))
    is_pair(record)
    assert (record.u_unit, record.y_unit, record.t_unit) == ("deg", "Nm", "ms")


def test_cycles_with_fractions_are_a_count(tmp_path: Path) -> None:
    water = np.round(np.linspace(0, 40, N), 3)
    names = "N,ea(%),q(kPa),p(kPa),u(kPa)\n"
    record = one(tmp_path, names + rows(",", np.arange(N) / 30, U, Y, 100 - water, water))
    is_pair(record)


def test_row_numbers_beside_a_clock_are_no_input(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="INPUT_FILE"):
        one(tmp_path, ",Time [s],Fz [N]\n" + rows(",", np.arange(N), 0.01 * np.arange(N), Y))


def test_liters_and_decanewtons(tmp_path: Path) -> None:
    head = "Interval=\t0.005 s\nChannelTitle=\tLV Pressure\tLV Volume\nRange=\t200 mmHg\t10 V\nUnitName=\tmmHg\tuL\n"
    record = one(tmp_path, head + rows("\t", 0.005 * np.arange(N), Y, U), "heart.txt")
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("uL", "mmHg")
    assert (conversion("uL", "mm3"), conversion("daN", "N"), conversion("mils", "um")) == (1.0, 10.0, 25.4)


def test_the_current_of_a_motor_answers_its_motion(tmp_path: Path) -> None:
    speed = np.round(np.gradient(U), 3)
    names = "time,position_rad,velocity_rad_s,current_A,temperature_C\n"
    record = one(tmp_path, names + rows(",", 0.01 * np.arange(N), U, speed, Y, 35 + 0.001 * np.arange(N)))
    is_pair(record)


def test_an_angle_that_rises_evenly_is_a_clock(tmp_path: Path) -> None:
    """The crank angle of an indicator diagram, beside a pressure that rises and falls once."""
    angle = np.arange(-360, 360, 12)
    volume, pressure = (
        np.round(300 - 250 * np.cos(np.radians(angle)), 3),
        np.round(1 + 40 * np.exp(-(((angle - 10) / 80) ** 2)), 4),
    )
    record = one(tmp_path, "crank_angle_deg,volume_cc,pressure_bar\n" + rows(",", angle, volume, pressure))
    assert {record.u_name, record.y_name} == {"volume_cc", "pressure_bar"}


def test_units_below_names_behind_a_number_sign(tmp_path: Path) -> None:
    record = one(tmp_path, "#Point\tDisp\tForce\n#\t[mm]\t[N]\n" + rows("\t", np.arange(N), U, Y), "gui.dat")
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("mm", "N")


@pytest.mark.parametrize("lengths", [(N, N), (N, N - 7)])
def test_a_trial_in_each_cell_of_matlab(lengths: tuple[int, ...], tmp_path: Path) -> None:
    cells = {name: np.empty((1, 2), dtype=object) for name in ("Disp", "Load")}
    for k, length in enumerate(lengths):
        cells["Disp"][0, k], cells["Load"][0, k] = U[:length, None], Y[:length, None] + k
    scipy.io.savemat(tmp_path / "trials.mat", cells)
    data = read(tmp_path / "trials.mat")
    assert isinstance(data, Dataset)
    for k, (record, length) in enumerate(zip(data, lengths, strict=True)):
        is_pair(record, U[:length], Y[:length] + k)
