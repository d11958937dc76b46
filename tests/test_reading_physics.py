"""Files of magnetometers, soil laboratories, oscilloscopes and digitizers of plots: their headers, units, conditions and orders of rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Record
from hystfit.outcome import Code
from hystfit.outcome.note import has
from hystfit.reading import read

N = 120
FIELD = np.concatenate([np.linspace(1e4, -1e4, N // 2), np.linspace(-1e4, 1e4, N // 2)])
WAY = np.where(np.arange(N) < N // 2, -1.0, 1.0)
RESISTANCE = 0.4 / (1 + np.exp(-(np.abs(FIELD - 300 * WAY) - 5000) / 600)) + 0.05
CHANNELS = (False, True)


def one(folder: Path, head: str, *columns: object, mark: str = ",") -> Record:
    path = folder / "measured.dat"
    rows = (mark.join(map(str, row)) for row in zip(*columns, strict=True))
    path.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
    data = read(path)
    assert isinstance(data, Record), [record.name for record in data]
    return data


def test_names_beyond_the_last_number_of_the_rows_leave_the_others_their_names(tmp_path: Path) -> None:
    """A cryostat names the columns of options that are not installed; its rows end before them."""
    head = (
        "[Header]\nTITLE, film 3, bridge 1\n[Data]\nComment,Time Stamp (sec),Temperature (K),Magnetic Field (Oe),"
        "Bridge 1 Resistivity (Ohm),Bridge 1 Excitation (uA),Signal 1 Vin (V),Digital Inputs (code),Map 20 (),Map 21 ()\n"
    )
    times = 60.0 * np.arange(N)
    record = one(tmp_path, head, [""] * N, times, [2.0] * N, FIELD, RESISTANCE, [19.98] * N)
    np.testing.assert_allclose(record.u, FIELD)
    np.testing.assert_allclose(record.y, RESISTANCE)
    assert (record.u_unit, record.y_unit) == ("Oe", "Ohm")
    assert record.dt == pytest.approx(60.0)


def test_a_unit_of_its_own_beside_a_name_is_no_name_beyond_the_rows(tmp_path: Path) -> None:
    record = one(tmp_path, "Field, Oe, Moment, emu, Range, 1\n", FIELD, RESISTANCE, np.zeros(N))
    assert "Oe" not in (record.u_name, record.y_name)


@pytest.mark.parametrize("second", CHANNELS)
def test_channels_that_are_measured_in_turn_are_no_pair(second: bool, tmp_path: Path) -> None:
    """The voltage of one channel has no value where the other was measured; the resistivity counts before its own voltage."""
    head = "Time (s),Magnetic Field (Oe),Drive Signal ch1 (V),Drive Signal ch2 (V),Volts ch1,Volts ch2,"
    head += "Res. ch1 (ohm-cm),Res. ch2 (ohm-cm)\n"
    turn = np.tile([True, False], N)
    field, resistance = np.repeat(FIELD, 2), np.repeat(RESISTANCE, 2)
    given = lambda values, mine: [
        f"{value:.9g}" if own == mine else "" for value, own in zip(values, turn, strict=True)
    ]
    first, other = [resistance, 2 * resistance**2][:: -1 if second else 1]
    columns = [
        given(values * size, mine) for size in (0.11, 0.1, 1.0) for values, mine in ((first, True), (other, False))
    ]
    record = one(tmp_path, head, np.arange(2.0 * N), field, *columns)
    assert (record.u_name, record.y_name) == ("Magnetic Field (Oe)", "Res. ch1 (ohm-cm)")
    np.testing.assert_allclose(record.y[np.isfinite(record.y)], first[turn], rtol=1e-8)


def test_resistivities_are_resistances(tmp_path: Path) -> None:
    record = one(tmp_path, "T (K),Signal (uOhm cm),Heater\n", 300 + FIELD / 100, RESISTANCE, np.cos(np.arange(N)))
    assert (record.u_unit, record.y_unit) == ("K", "uOhm cm")


@pytest.mark.parametrize("names", ["s,Sr", "Sr,s", "kpa,vwc", "vwc,kpa", "psi (kPa),VWC"])
def test_the_suction_of_a_soil_drives_its_water(names: str, tmp_path: Path) -> None:
    suction, water = np.abs(FIELD) / 100, 1 / (1 + (np.abs(FIELD) / 3000) ** 2) + 0.05 * WAY
    drives = names.split(",")[0] in ("s", "kpa", "psi (kPa)")
    record = one(tmp_path, f"{names}\n", *((suction, water) if drives else (water, suction)))
    np.testing.assert_allclose(record.u, suction)
    np.testing.assert_allclose(record.y, water)


@pytest.mark.parametrize("names", ["s,w", "h,theta", "p_eff_kPa,VoidRatio"])
@pytest.mark.parametrize("drives", CHANNELS)
def test_symbols_of_suction_and_water_and_void_ratios(names: str, drives: bool, tmp_path: Path) -> None:
    """A branch of drainage, or the steps of an oedometer: each load or suction is a multiple of the one before."""
    suction = 3.0 * 1.7 ** np.arange(14)
    water = 0.45 / (1 + (suction / 400) ** 0.7)
    order = 1 if drives else -1
    record = one(tmp_path, ",".join(names.split(",")[::order]) + "\n", *(suction, water)[::order])
    np.testing.assert_allclose(record.u, suction)
    np.testing.assert_allclose(record.y, water)


def test_levels_in_decibels_are_no_forces(tmp_path: Path) -> None:
    """A detector is calibrated by the gain of a transmitter, of which the letters RF are part of the name."""
    gain = 2.0 * np.arange(24)
    volts = 1.46 - 0.0215 * gain + 0.25 * np.exp((gain - 46) / 5)
    power = (volts - 0.5) / -0.025
    record = one(tmp_path, "HackRF_TX_dB,Detector_Voltage_V,Power_dBm\n", gain, volts, power)
    assert (record.u_name, record.y_name) == ("HackRF_TX_dB", "Detector_Voltage_V")


def test_names_of_suction_and_water_are_others_where_the_numbers_are_no_parts(tmp_path: Path) -> None:
    record = one(tmp_path, "theta,h\n", 90 * WAY, FIELD)
    assert (record.u_name, record.y_name) == ("h", "theta")
    record = one(tmp_path, "w,s\n", FIELD, RESISTANCE + FIELD / 1e4)
    assert (record.u_name, record.y_name) == ("w", "s")


def test_pixels_of_a_digitized_plot_are_no_quantity_and_its_abscissa_no_time(tmp_path: Path) -> None:
    x = np.linspace(3.0, 97.0, N)
    y = np.sin(x / 30)
    record = one(
        tmp_path, "# x_min=0.0\nX_value,Y_value,Pixel_X,Pixel_Y\n", x, y, 90 + 2.9 * x + 0.01 * y, 400 - 55 * y
    )
    np.testing.assert_allclose(record.u, x)
    np.testing.assert_allclose(record.y, y)
    assert record.t is None


def test_channels_of_an_oscilloscope_have_their_numbers(tmp_path: Path) -> None:
    t = 5e-4 * np.arange(N) - 4
    record = one(tmp_path, "x-axis,1,2\nsecond,Volt,Volt\n", t, np.sin(t * 200), np.cos(t * 200))
    assert (record.u_name, record.y_name, record.y_unit) == ("CH1", "CH2", "Volt")
    assert record.dt == pytest.approx(5e-4)


def test_the_axis_of_a_lock_in_amplifier_is_no_displacement(tmp_path: Path) -> None:
    head = "Time\tMagnet_I_(A)\tB_(T)\tmoment_(emu)\tlock-in_X\tlock-in_Y\n"
    rng = np.random.default_rng(3)
    moment = np.tanh((FIELD - 900 * WAY) / 2000) + rng.normal(0, 0.01, N)
    field = FIELD / 1e4 + np.cumsum(rng.normal(0, 1e-4, N))
    record = one(
        tmp_path, head, np.arange(N), 11.8 * field, field, moment, 5e-3 * moment, rng.normal(0, 1e-5, N), mark="\t"
    )
    assert (record.u_unit, record.y_unit) == ("T", "emu")


def _isotherms(folder: Path, *temperatures: float) -> object:
    path, rising = folder / "isotherms.csv", np.linspace(0.02, 1.0, 40)
    rows = [
        f"{k},{temperature},{p:.4f},{(30 - k) * p + (4 if falls else 0) * p * (1 - p):.4f}"
        for k, temperature in enumerate(temperatures)
        for falls, pressures in ((False, rising), (True, rising[::-1]))
        for p in pressures
    ]
    path.write_text("run_id,temperature,pressure,adsorption (mg)\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return read(path)


def test_loops_at_temperatures_of_their_own_are_records(tmp_path: Path) -> None:
    data = _isotherms(tmp_path, 116.68, 124.65, 131.47)
    assert [len(record.u) for record in data] == [80, 80, 80]  # type: ignore[attr-defined]


def test_a_temperature_that_goes_up_by_steps_is_the_input(tmp_path: Path) -> None:
    temperature = np.repeat(np.linspace(20, 90, 12), 10)
    record = one(tmp_path, "temperature (degC),strain (%)\n", temperature, np.tanh((temperature - 60) / 9))
    np.testing.assert_allclose(record.u, temperature)


def _loop(field: np.ndarray, way: np.ndarray) -> np.ndarray:
    return np.tanh((field - 60 * way) / 40)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("rows", [120, 400])
def test_the_branches_of_a_loop_in_the_order_of_its_input_are_told_apart(
    sign: float, rows: int, tmp_path: Path
) -> None:
    """Points of a digitized plot, sorted: the truth of each is known here, and a falling response lags too."""
    rng = np.random.default_rng(5)
    field, way = rng.uniform(-400, 400, rows), rng.choice([-1.0, 1.0], rows)
    order = np.argsort(field)
    field, way = field[order], way[order]
    output = sign * _loop(field, way) + rng.normal(0, 0.004, rows)
    record = one(tmp_path, "H (Oe),M (emu)\n", field, output)
    turn = int(np.argmax(record.u))
    assert (np.diff(record.u[: turn + 1]) >= 0).all()
    assert (np.diff(record.u[turn:]) <= 0).all()
    going = np.where(np.arange(rows) <= turn, 1.0, -1.0)
    apart = np.abs(_loop(record.u, 1.0 * np.ones(rows)) - _loop(record.u, -np.ones(rows))) > 0.05
    assert apart.sum() > rows / 4
    np.testing.assert_allclose(record.y[apart], sign * _loop(record.u, going)[apart], atol=0.03)
    assert any(note.code is Code.CURVES for note in record.notes)


def test_the_force_of_a_sorted_loop_is_larger_on_the_way_out(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    travel, way = np.sort(rng.uniform(-40, 40, 300)), rng.choice([-1.0, 1.0], 300)
    record = one(
        tmp_path,
        "Displacement (mm),Force (kN)\n",
        travel,
        travel + 30 * np.clip(way * (41 - np.abs(travel)) / 8, -1, 1),
    )
    turn = int(np.argmax(record.u))
    middle = lambda part: float(
        np.interp(0.0, *(values[np.argsort(record.u[part])] for values in (record.u[part], record.y[part])))
    )
    assert middle(slice(None, turn)) > 20 > -20 > middle(slice(turn, None))


@pytest.mark.parametrize("noise", [0.003, 0.1, 0.5])
@pytest.mark.parametrize("rows", [60, 200])
def test_a_noisy_curve_has_no_branches(noise: float, rows: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    field = np.sort(rng.uniform(-400, 400, rows))
    record = one(tmp_path, "H (Oe),M (emu)\n", field, np.tanh(field / 90) + rng.normal(0, noise, rows))
    np.testing.assert_allclose(record.u, field)


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("name", "slope"), [("B_T", 1.2566e-3), ("J_T", 0.0)])
def test_a_demagnetization_curve_without_the_sign_of_its_field(
    tmp_path: Path, name: str, slope: float, way: int
) -> None:
    """The catalog of a magnet states the field as a number: the induction falls from the remanence to zero at the coercivity."""
    field = np.linspace(0, 1080, 60)
    polarization = 1.24 * (1 - 1 / (1 + np.exp((1030 - field) / 9))) - 2e-5 * field
    record = one(tmp_path, f"H_kA_per_m,{name}\n", field[::way], (polarization - slope * field)[::way])
    np.testing.assert_allclose(record.u, -field[::way], atol=1e-4)
    assert has(record.notes, Code.PREPARED)


@pytest.mark.parametrize("remanence", [0.0, 0.4])
def test_a_field_keeps_its_sign_where_its_output_grows_or_begins_at_zero(tmp_path: Path, remanence: float) -> None:
    """The first magnetization of iron, and the moment of a superconductor."""
    field = np.linspace(0, 1080, 60)
    moment = remanence + 0.8 * np.tanh(field / 300) if remanence else -0.8 * np.tanh(field / 300)
    record = one(tmp_path, "H_kA_per_m,M_emu\n", field, moment)
    np.testing.assert_allclose(record.u, field, atol=1e-4)
