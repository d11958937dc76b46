"""Columns that only their signals tell apart: rates of fluxes and charges, set values, switched heaters, raw sensors, limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hystfit as hf
from hystfit.errors import DataError
from hystfit.outcome import Code
from hystfit.params.units import quantity
from tests.conftest import examined
from tests.loop_files import N, U, Y, is_pair, one, rows

NOISE = np.random.default_rng(11).normal(size=(4, 600))
PHASE = np.linspace(0, 6 * np.pi, 600)
T = 1e-4 * np.arange(600)


def loop(drive: np.ndarray, width: float, knee: float) -> np.ndarray:
    """The mean of saturated backlashes up to a width."""
    positions = []
    for half in np.linspace(0, width, 15):
        place, path = drive[0], []
        for value in drive:
            place = min(max(place, value - half), value + half)
            path.append(place)
        positions.append(np.tanh(np.array(path) / knee))
    return np.mean(positions, axis=0)


def integral_over_time(record: hf.Record) -> bool:
    """Whether `check` says to integrate the output first."""
    notes = examined(record).findings
    return any(note.option == ("integrate", "true") for note in notes if note.code is Code.RATE)


# Channels of one unit -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("names", ["Ch1,V\tCh2,V", "Left probe (V)\tRight probe (V)"])
def test_an_output_of_few_steps_is_no_command(names: str, tmp_path: Path) -> None:
    """A triangle at a tester whose second channel has 50 steps: the noise of both is that of the converter."""
    drive = np.interp(np.arange(100), [0, 50, 99], [0.0, -3.0, 0.0]) + 2e-4 * NOISE[0, :100]
    charge = np.round((0.015 * loop(drive, 0.5, 2.0) + 2e-4 * NOISE[1, :100]) / 3e-4) * 3e-4
    table = f"R,Ohm\tC,pF\n0000\t0100\n{names}\tTime,s\n"
    record = one(tmp_path, table + rows("\t", np.round(drive, 4), np.round(charge, 4), 1e-3 * np.arange(100)))
    assert np.ptp(record.u) == pytest.approx(3.0, rel=0.01)
    named = [note.text for note in record.notes if note.code is Code.COLUMN_CHOICE]
    question = next(text for text in named if "drives the device" in text)
    assert f"input='{record.y_name}' and output='{record.u_name}'" in question


@pytest.mark.parametrize("both_ways", [False, True])
def test_values_that_are_set_again_on_each_branch_drive(both_ways: bool, tmp_path: Path) -> None:
    """A table written by hand at uneven values, with the reading first and without names."""
    levels = np.array([0, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.4, 2, 3, 4, 5, 6, 8, 10.0])
    path = np.concatenate([levels, levels[::-1]])
    path = np.concatenate([path, -path[1:], levels[1:]]) if both_ways else path
    response = np.round(loop(path, 1.5, 2.5) + 0.004 * NOISE[0, : path.size], 3)
    np.testing.assert_array_equal(one(tmp_path, rows("\t", response, path)).u, path)
    np.testing.assert_array_equal(one(tmp_path, rows("\t", path, response)).u, path)


@pytest.mark.parametrize("lost", [False, True], ids=["whole", "a value is missing"])
def test_columns_that_all_run_one_way_hold_no_time(tmp_path: Path, lost: bool) -> None:
    """The currents of a transistor at both terminals, and the voltage of its gate."""
    gate = np.linspace(-0.3, 0.6, 19)
    current = 1e-5 * np.log1p(np.exp(gate / 0.05)) ** 2
    gate[7] = np.nan if lost else gate[7]
    with pytest.raises(DataError, match=r"--input"):
        one(tmp_path, rows(" ", np.full(19, 0.65), current, -(1 + 0.02 * gate) * current, gate))


def test_an_output_of_few_digits_is_not_set_again(tmp_path: Path) -> None:
    """It takes the same values while it rises and while it falls, as a table of settings does, but rests at them."""
    time = np.arange(0.0, 32.0, 2.0)
    u = np.array([-0.4, 15.6, 35.7, 50.4, 63.3, 72.5, 76.9, 81.5, 76.4, 71.1, 57.0, 46.6, 29.1, 11.2, -7.3, -23.9])
    y = np.array([-0.1, 0.0, 0.0, 0.1, 0.1, 0.2, 0.2, 0.2, 0.3, 0.3, 0.2, 0.2, 0.2, 0.1, 0.1, 0.0])
    record = one(tmp_path, rows("\t", time, u, y))
    np.testing.assert_array_equal(record.u, u)


# Oscilloscopes ------------------------------------------------------------------------------------------------------------------


def test_empty_labels_of_an_oscilloscope_are_no_names(tmp_path: Path) -> None:
    header = "Model,MSO44\nWaveform Type,ANALOG\nVertical Units,V,V\nSample Interval,0.1\n,,\nLabel,,\nTIME,CH1,CH2\n"
    record = one(tmp_path, header + rows(",", 0.1 * np.arange(N), U, Y))
    is_pair(record)
    assert (record.u_name, record.y_name, record.dt) == ("CH1", "CH2", pytest.approx(0.1))


def test_settings_beyond_rows_that_end_in_one_empty_cell(tmp_path: Path) -> None:
    header = "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-3.0e-02,5.0e-05\n"
    record = one(tmp_path, header + rows(",", np.arange(N), U, Y, np.full(N, "")))
    is_pair(record)
    assert (record.u_name, record.y_name, record.u_unit) == ("CH1", "CH2", "Volt")
    assert record.dt == pytest.approx(5e-5)


@pytest.mark.parametrize("later", [0.004, 0.01])
def test_channels_with_times_of_their_own_in_one_table(later: float, tmp_path: Path) -> None:
    """Of each row one channel is empty, as where the messages of two sensors are joined by their times."""
    t = 0.02 * np.arange(400)
    u, y = 60 * np.sin(2 * t), 9 * np.sin(2 * (t + later) - 0.2)
    lines = [f"{a:.3f},{b:.5f},\n{a + later:.3f},,{c:.5f}\n" for a, b, c in zip(t, u, y, strict=True)]
    path = tmp_path / "joined.csv"
    path.write_text("t,u_V,x_um\n" + "".join(lines), encoding="utf-8")
    record = hf.read(path)
    assert len(record) == 799  # behind the last input there is none to interpolate
    at = np.isfinite(record.y)
    assert at.sum() == 399
    np.testing.assert_allclose(record.u[at], 60 * np.sin(2 * record.t[at]), atol=60 * (2 * 0.02) ** 2 / 8 + 1e-4)
    np.testing.assert_allclose(record.u[~at], u, atol=1e-5)


# Rates of a flux and of a charge ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("header", ["time;u_sek [V];i_prim [A]", "time;V(n001,n002);I(L1)"])
def test_a_current_drives_the_voltage_that_its_flux_induces(header: str, sign: int, tmp_path: Path) -> None:
    current = 2 * np.sin(PHASE)
    flux = loop(current, 0.8, 0.6)
    voltage = sign * np.gradient(flux, T) + 5 * NOISE[0]
    record = one(tmp_path, f"{header}\n" + rows(";", T, voltage, current + 0.002 * NOISE[1]))
    assert (record.u_unit, record.y_unit) == ("A", "V")
    assert integral_over_time(record)
    assert quantity(record.integrated().y_unit) == "flux"


def test_a_voltage_drives_the_current_that_its_charge_takes(tmp_path: Path) -> None:
    voltage = 10 * np.sin(PHASE)
    charge = loop(voltage, 6.0, 1.5)
    current = np.gradient(charge, T) + 5 * NOISE[0]
    record = one(tmp_path, "time,I (mA),U (V)\n" + rows(",", T, current, voltage + 0.01 * NOISE[1]))
    assert (record.u_unit, record.y_unit) == ("V", "mA")
    assert integral_over_time(record)


def test_a_voltage_that_lags_far_behind_a_field_is_no_rate(tmp_path: Path) -> None:
    """A magnet whose coercivity is 0.8 of the largest field, by a sensor in volts."""
    field = 100 * np.sin(PHASE)
    signal = np.array(np.sign(field - 80 * np.sign(np.gradient(field)))) + 0.01 * NOISE[0]
    record = one(tmp_path, "H (kA/m),Hall (V)\n" + rows(",", field, signal))
    assert (record.u_unit, record.y_unit) == ("kA/m", "V")
    assert not integral_over_time(record.sampled(dt=0.01))


# Columns beside the loop --------------------------------------------------------------------------------------------------------


def test_a_thermometer_and_not_the_set_temperature_drives(tmp_path: Path) -> None:
    """A second thermometer beside the set value is no response to it."""
    warm = np.concatenate([np.linspace(300, 370, 30), np.linspace(370, 300, 30)])
    resistance = 1e5 / (1 + np.exp((warm - np.where(np.arange(N) < 30, 343, 335)) / 2))
    text = "TempA(K)\tTempB(K)\tSetpoint(K)\tR(Ohm)\n"
    columns = warm + 0.03 * NOISE[0, :N], warm - 1.2 + 0.03 * NOISE[1, :N], np.round(warm), resistance
    record = one(tmp_path, text + rows("\t", *columns))
    assert (record.u_name, record.y_name) == ("TempA(K)", "R(Ohm)")


def test_a_charge_and_not_a_sensor_in_volts_answers(tmp_path: Path) -> None:
    text = "Time (ms)\tHV monitor (V)\tI monitor (V)\tCharge (uC)\tStrain sensor (V)\n"
    sensor = 0.3 + 0.001 * (Y - 30) ** 2
    record = one(tmp_path, text + rows("\t", np.arange(N), U, np.gradient(Y), Y, sensor))
    is_pair(record)
    alone = one(tmp_path, "HV monitor (V)\tStrain sensor (V)\n" + rows("\t", U, sensor))
    assert alone.y_name == "Strain sensor (V)"


def test_a_heater_that_is_switched_follows_the_temperature(tmp_path: Path) -> None:
    """Its power has noise where it is on; the temperature varies by two degrees and answers the power as any heated thing does."""
    warm, power, on = [20.0], [0.0], True
    for k in range(N - 1):
        on = warm[-1] < 20.5 if not on else warm[-1] < 22.5
        warm.append(warm[-1] + (0.35 if on else -0.25))
        power.append(on * (1500 + 3 * NOISE[0, k]))
    text = "Time (min),Heater power (W),Room temperature (°C),Outdoor temperature (°C)\n"
    record = one(tmp_path, text + rows(",", 5 * np.arange(N), np.round(power), warm, 8 + 0.02 * NOISE[1, :N]))
    is_pair(record, np.array(warm), np.round(power))


def test_a_heater_that_is_varied_drives_the_temperature(tmp_path: Path) -> None:
    is_pair(one(tmp_path, "Time (min),Heater power (W),Temperature (°C)\n" + rows(",", np.arange(N), U, Y)))


def test_the_strain_of_the_specimen_and_not_the_crosshead_drives(tmp_path: Path) -> None:
    text = "Zeit [s];Kraft [kN];eps_yy (DIC) [%];eps_xx (DIC) [%];Traverse [mm]\n"
    columns = np.arange(N), Y, U, 10 - 0.3 * U + 0.01 * NOISE[0, :N], 0.5 * U + 0.002 * Y
    record = one(tmp_path, text + rows(";", *columns))
    assert (record.u_name, record.y_name) == ("eps_yy (DIC) [%]", "Kraft [kN]")


def test_a_flow_is_the_rate_of_a_volume_with_noise(tmp_path: Path) -> None:
    pressure = 20 - 20 * np.cos(np.linspace(0, 2 * np.pi, N))
    volume = 1 - np.cos(np.linspace(-0.4, 2 * np.pi - 0.4, N))
    text = "Paw [cmH2O],Volume [L],Flow [L/s]\n"
    record = one(tmp_path, text + rows(",", pressure, volume + 0.02 * NOISE[0, :N], np.gradient(volume)))
    assert (record.u_name, record.y_name) == ("Paw [cmH2O]", "Volume [L]")


def test_the_stage_of_a_river_drives_its_discharge_in_german(tmp_path: Path) -> None:
    record = one(tmp_path, "Wasserstand [cm];Abfluss [m³/s];Qualität\n" + rows(";", U, Y, np.full(N, "gut")))
    is_pair(record)


# Sweeps of a lock-in amplifier --------------------------------------------------------------------------------------------------


def test_runs_of_a_table_on_its_side_are_one_loop(tmp_path: Path) -> None:
    """A line for each quantity of each run, behind its settings, padded to the longest: a sweep up and one down."""
    up = np.linspace(-1, 1, N)
    down = up[::-1]
    lines = ["chunk;timestamp;size;fieldname"]
    for run, (drive, signal) in enumerate([(up, np.tanh(4 * up - 1)), (down, np.tanh(4 * down + 1))]):
        small = 1e-3 * NOISE[run, :N]
        columns = {"bandwidth": np.full(N, 9.5), "grid": drive, "r": np.hypot(signal, small), "x": signal, "y": small}
        lines += [f"{run};81{run};{N};{name};{';'.join(map(str, values))};nan" for name, values in columns.items()]
    record = one(tmp_path, "\n".join(lines) + "\n", "dev1234_demods_0_sample_00000.csv")
    is_pair(record, np.append(up, down), np.append(np.tanh(4 * up - 1), np.tanh(4 * down + 1)))
    assert (record.u_name, record.y_name) == ("grid", "x")


def test_curves_are_named_by_the_measured_condition_that_differs(tmp_path: Path) -> None:
    """The current of a damper, with the noise of its sensor, in runs whose time starts again; the temperature drifts."""
    currents = np.repeat([0.0, 1.5, 0.5], N) + 0.002 * NOISE.ravel()[: 3 * N]
    text = "time_s,disp_mm,force_N,temp_C,current_A\n"
    table = (
        np.tile(T[:N], 3),
        np.tile(U, 3),
        np.concatenate([Y - 30, 1.2 * (Y - 30), 1.1 * (Y - 30)]),
        20 + np.linspace(0, 3, 3 * N),
        currents,
    )
    path = tmp_path / "damper.csv"
    path.write_text(text + rows(",", *table), encoding="utf-8")
    assert [record.name for record in hf.Dataset.of(hf.read(path))] == ["current=0", "current=1.5", "current=0.5"]
    only = hf.Dataset.of(hf.read(path, only="1.5"))
    np.testing.assert_allclose(only[0].y, 1.2 * (Y - 30))


def test_a_force_that_saturates_with_the_velocity_is_no_rate(tmp_path: Path) -> None:
    """Its sums are nearly the displacement."""
    place, speed = np.sin(PHASE), np.cos(PHASE)
    force = np.tanh(4 * speed)
    record = one(tmp_path, "one,two,three\n" + rows(",", place, speed, force))
    assert (record.u_name, record.y_name) == ("one", "three")


def test_a_reference_beside_the_drive_answers(tmp_path: Path) -> None:
    """The voltages of a circuit by Sawyer and Tower: of the source, across the reference capacitor, and of both elements."""
    record = one(tmp_path, "Vin [V],V_ref [V],V_total [V]\n" + rows(",", U, Y, U + Y))
    is_pair(record)
    alone = one(tmp_path, "Vref [V],Vout [V]\n" + rows(",", U, Y))
    is_pair(alone)


@pytest.mark.parametrize("counter", ["i", "k", "f"])
def test_the_number_of_a_row_is_no_output_beside_a_signal_that_is_text(counter: str, tmp_path: Path) -> None:
    path = tmp_path / "complex.csv"
    lines = [f"{k},{u:.5f},{y:.5f}+0j" for k, (u, y) in enumerate(zip(U, Y, strict=True))]
    path.write_text("\n".join([f"{counter},u,y", *lines]) + "\n", encoding="utf-8")
    with pytest.raises(DataError, match="found 1 column"):
        hf.read(path)


def test_the_angle_of_a_wing_drives_coefficients_with_a_bracket_for_their_unit(tmp_path: Path) -> None:
    """A wing that pitches as a sine: its loads are noisy, and the angle is not."""
    names = "CL [-]  CD [-]  CM [-]"
    angle = np.round(10 + 8 * np.sin(PHASE), 4)
    lift = np.round(0.1 * angle + 0.25 * np.sin(PHASE - 0.6) + 0.01 * NOISE[0], 4)
    drag, moment = 0.02 + 0.002 * angle + 0.002 * NOISE[1], -0.05 - 0.01 * lift + 0.003 * NOISE[2]
    pressure = 240 + 0.5 * NOISE[3]
    record = one(
        tmp_path, f"# t [s]  alpha [deg]  {names}  q [Pa]\n" + rows("  ", T, angle, lift, drag, moment, pressure)
    )
    is_pair(record, angle, lift)


def test_numbered_trials_over_one_input_are_records(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("Pressure (kPa),Trial 1 (deg),Trial 2 (deg)\n" + rows(",", U, Y, 1.01 * Y), encoding="utf-8")
    data = hf.read(path)
    assert isinstance(data, hf.Dataset)
    assert [record.name for record in data] == ["Trial 1", "Trial 2"]
    is_pair(data[1], U, 1.01 * Y)


def test_a_dichroism_is_read_rather_than_the_two_signals_that_it_is_the_difference_of(tmp_path: Path) -> None:
    one_way, other = 1.2 + 0.01 * Y, 1.2 - 0.01 * Y
    record = one(tmp_path, "# Field(T)  TEY_cp(a.u.)  TEY_cm(a.u.)  XMCD(a.u.)\n" + rows("  ", U, one_way, other, Y))
    is_pair(record)
