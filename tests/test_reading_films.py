"""Tables of films, cells, calorimeters and catchments, in which a set value, a condition or a mark looks like a loop."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Dataset
from hystfit.errors import DataError
from hystfit.reading import read

from .loop_files import N, U, Y, is_pair, one, rows, written

T = np.round(0.1 * np.arange(N), 1)
NOISE = np.random.default_rng(5).standard_normal(N).round(3)
SWEEP = np.round((U - 40) / 8, 4)  # between -1 and 1
SIGNAL = np.round((Y - 30) / 7, 4)
RAMP = np.concatenate([np.arange(N // 2), np.arange(N // 2, 0, -1)]).astype(float)


def test_charges_of_rows_are_summed_and_the_charge_itself_comes_first(tmp_path: Path) -> None:
    """GITT of BioLogic: dq is the charge since the row before, and alternates with the current of the pulses."""
    steps = np.tile([0.25, 0.5, 0.0], N // 3) * np.where(np.arange(N) < N // 2, 1.0, -1.0)
    charge = np.cumsum(steps)
    volts = np.round(3.3 + np.tanh(charge / 5) + 0.05 * np.sign(steps), 5)
    for names, columns in (
        ("dq/mA.h\tEwe/V\t(Q-Qo)/mA.h", (steps, volts, charge)),
        ("dq/mA.h\tEwe/V", (steps, volts)),
    ):
        record = one(tmp_path, f"time/s\t{names}\n" + rows("\t", 60 * np.arange(N), *columns))
        is_pair(record, charge, volts)
        assert record.u_unit == "mA.h"


def test_a_row_of_zeros_ends_each_branch_of_an_isotherm(tmp_path: Path) -> None:
    """BELSORP: the saturation pressure beside the loop is never 0, so that the rows are no measurements at an evacuated sample."""
    half = N // 2
    pressure, loading = np.sort(U[:half]) - 31.9, np.sort(Y[:half]) - 22.9
    head = '====\n {} data\n====\n"No."\t"Pe/kPa"\t"P0/kPa"\t"Vd/ml"\t"V/ml(STP) g-1"\t\n'
    columns = lambda p, v: (np.arange(half) + 1, p, np.full(half, 101.3), 17.3 + 0.001 * p, v)
    branch = lambda p, v: (rows("\t", *columns(p, v)) + "0\t0\t0\t0\t0\n").replace("\n", "\t\n")
    text = head.format("Adsorption") + branch(pressure, loading)
    text += head.format("Desorption") + branch(pressure[::-1], loading[::-1] + 0.5)
    record = one(tmp_path, text, "isotherm.DAT")
    is_pair(record, np.append(pressure, pressure[::-1]), np.append(loading, loading[::-1] + 0.5))


def test_a_burst_of_noise_has_lost_no_decimal_marks(tmp_path: Path) -> None:
    """Barkhausen noise: some samples are a tenth of those around them by chance, as others are a fifth."""
    rng, count = np.random.default_rng(0), 20_000
    u = np.round(2 * np.sin(np.arange(count) * np.pi / 1000), 5)
    burst = 0.3 * np.exp(-(((u - 0.5) / 0.3) ** 2)) + 0.01
    y = np.round(burst * rng.standard_normal(count), 6)
    record = one(tmp_path, "Time (s),Excitation (V),Pickup (V)\n" + rows(",", np.arange(count) / 1e5, u, y))
    is_pair(record, u, y)
    y = 100 + np.round(8 * np.sin(np.arange(400) / 20), 2)
    y[[30, 90, 200, 333]] /= 10
    with pytest.raises(DataError, match="decimal marks were lost"):
        one(tmp_path, "u,y\n" + rows(",", u[:400], y))


def test_the_phase_tells_the_sign_of_an_amplitude(tmp_path: Path) -> None:
    size, phase = np.abs(SIGNAL) * 60 + 2, np.where(SIGNAL > 0, -53.0, 127.0) + 2 * NOISE
    signed = np.where(SIGNAL > 0, size, -size)
    for unit, degrees in (("deg", phase), ("", phase), ("rad", np.radians(phase))):
        text = f"Bias(V),Amp(pm),Phase({unit}),Q\n" + rows(",", 8 * SWEEP, size, degrees, 80 + NOISE)
        record = one(tmp_path, text)
        is_pair(record, 8 * SWEEP, signed)
        assert record.y_unit == "pm"
    held = rows(",", 8 * SWEEP, size, -53 + 2 * NOISE)  # of one domain
    is_pair(one(tmp_path, "Bias(V),Amp(pm),Phase(deg)\n" + held), 8 * SWEEP, size)


@pytest.mark.parametrize("names", ["V_bias [V],Cp [F],D []", "Vg (V),C (F),Q ()"])
def test_the_loss_beside_a_capacitance_is_no_polarization(names: str, tmp_path: Path) -> None:
    record = one(tmp_path, names + "\n" + rows(",", SWEEP, 1e-12 * (5 + SIGNAL), 0.01 + 1e-4 * NOISE))
    is_pair(record, SWEEP, 1e-12 * (5 + SIGNAL))


def test_heat_flow_over_temperature_is_one_loop_although_it_jumps_at_the_turn(tmp_path: Path) -> None:
    """NETZSCH: segments of one test, in which the heat flow changes its sign; the sensitivity of the sensor follows the temperature."""
    kelvin, way = 20 + 3 * RAMP, np.where(np.arange(N) < N // 2, -1.0, 1.0)
    flow = np.round(way * (1 + np.exp(-(((RAMP - 15) / 4) ** 2))), 5)
    head = "#DECIMAL:;COMMA\n#SEPARATOR:;SEMICOLON\n##Temp./°C;Time/min;DSC/(mW/mg);Sensit./(uV/mW);Segment\n"
    text = head + rows(";", kelvin, T, flow, np.round(3.4 - 2e-3 * kelvin, 4), 1 + (way > 0)).replace(".", ",")
    record = one(tmp_path, text.encode("cp1252"), "ExpDat.txt")
    is_pair(record, kelvin, flow)
    assert not any(note.option for note in record.notes)  # a segment alone is no loop


def test_nitrate_over_the_discharge_of_a_river(tmp_path: Path) -> None:
    stamps = np.array([f"2019-04-02 {k // 4:02d}:{15 * (k % 4):02d}" for k in range(N)])
    text = "datetime,Q_cms,NO3_mgL,SC_uScm,Temp_C\n" + rows(",", stamps, U, Y, 400 - U + NOISE, 9 + 0.1 * NOISE)
    record = one(tmp_path, text)
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("m3/s", "mg/L")


def test_a_hall_resistance_rather_than_the_voltage_it_was_computed_from(tmp_path: Path) -> None:
    names = "Rxx (ohm),Rxy (ohm),Vxx (mV),Vxy (mV),Magnetic Field (T),T sample (K),DC current (mA)"
    hall, along = np.round(SIGNAL, 5), np.round(41 + 0.01 * NOISE, 5)
    record = one(
        tmp_path, names + "\n" + rows(",", along, hall, along / 10, hall / 10, SWEEP, 2 + 1e-3 * NOISE, 0 * U + 0.1)
    )
    is_pair(record, SWEEP, hall)


@pytest.mark.parametrize("relative", [False, True])
def test_a_resistance_that_changes_little_responds_to_the_field_that_was_set(relative: bool, tmp_path: Path) -> None:
    """The loop of a film of 112 Ohm is 0.5 % high: no condition, and no copy of the field; its change in percent comes after it."""
    ohms = np.round(112 + 0.3 * SIGNAL, 4)
    names, more = ("\tMR(%)", [np.round(100 * (ohms / 112 - 1), 4)]) if relative else ("", [])
    measured = np.round(0.3 * SWEEP + 2e-4 * NOISE, 6)
    columns = (0.3 * SWEEP, measured, ohms, *more, 300 + 0.01 * NOISE)
    record = one(tmp_path, f"B_set(T)\tB_meas(T)\tR_2pt(Ohm){names}\tT_stage(K)\n" + rows("\t", *columns))
    is_pair(record, measured, ohms)


def test_a_detector_rather_than_the_probe_of_the_field_that_was_set(tmp_path: Path) -> None:
    field, light = np.round(30.3 * SWEEP + 0.02 * NOISE, 3), np.round(1.2 - 0.011 * SIGNAL, 5)
    names = "nCycle\tB_set[mT]\tB_Hall[mT]\tPD_sum[V]\tPD_diff[V]"
    columns = (1 + (np.arange(N) >= N // 2), 30 * SWEEP, field, 2.3 + 1e-3 * NOISE, light)
    is_pair(one(tmp_path, names + "\n" + rows("\t", *columns)), field, light)


def test_a_heater_drives_the_temperature_and_nothing_else(tmp_path: Path) -> None:
    kelvin = np.round(280 + 3 * RAMP, 2)
    ohms = np.round(1e4 * (2 - np.tanh((kelvin - 320 - 8 * (np.arange(N) < N // 2)) / 8)), 2)
    names = "Time(s)\tT_A(K)\tR1_VO2(Ohm)\tHeater(%)"
    is_pair(one(tmp_path, names + "\n" + rows("\t", T, kelvin, ohms, 40 + RAMP)), kelvin, ohms)
    record = one(tmp_path, "Time(s)\tHeater(%)\tT_A(K)\n" + rows("\t", T, 40 + RAMP, kelvin + NOISE))
    is_pair(record, 40 + RAMP, kelvin + NOISE)


def test_sap_flow_over_the_deficit_of_vapor_pressure(tmp_path: Path) -> None:
    stamps = np.array([f"2015-01-{1 + k // 24:02d}T{k % 24:02d}:00:00Z" for k in range(N)])
    text = "TIMESTAMP,sapf_data,vpd,ta,rh,sw_in,ws\n"
    text += rows(",", stamps, Y, U / 20, 14 + U / 5 + NOISE, 90 - U + NOISE, 20 * Y + 30 * NOISE, 1 + 0.1 * NOISE)
    is_pair(one(tmp_path, text), U / 20, Y)


def test_words_for_on_and_off_are_the_state_of_a_relay(tmp_path: Path) -> None:
    state = np.where(np.diff(U, prepend=U[0]) < 0, "heating", "idle")
    text = "last_updated,current_temperature,hvac_action,humidity\n"
    record = one(tmp_path, text + rows(",", T, U / 2, state, 55 + NOISE))
    is_pair(record, U / 2, (state == "heating").astype(float))


def test_algae_over_the_phosphorus_of_a_lake(tmp_path: Path) -> None:
    text = "phase,TP_ugL,Chla_ugL,Secchi_m\n"
    phases = np.where(np.arange(N) < N // 2, "eutrophication", "restoration")
    is_pair(one(tmp_path, text + rows(",", phases, U, Y, np.round(6 / (1 + Y / 8), 3))))


def test_rows_of_samples_of_one_signal_are_half_of_a_pair(tmp_path: Path) -> None:
    """Waveforms of the flux of a core, a row each, whose fields are in another file."""
    waves = np.outer(1 + np.arange(12), np.sin(2 * np.pi * np.arange(128) / 128 + 0.1)).round(6)
    with pytest.raises(DataError, match=r"rows holds 128 samples.*INPUT_FILE"):
        read(written(tmp_path, rows(",", *waves.T), "B_Field.csv"))


def test_branches_of_several_pixels_side_by_side_are_a_record_each(tmp_path: Path) -> None:
    volts = np.round(np.linspace(-0.1, 1.2, N), 3)
    curve = lambda k, shift: np.round(20 - k - np.exp(8 * (volts - 1 + shift)), 4)
    names = "".join(f";Pixel {p} forward [mA/cm²];Pixel {p} reverse [mA/cm²]" for p in "ABC")
    columns = [curve(k, shift) for k in range(3) for shift in (0.05, 0.0)]
    data = read(written(tmp_path, f"Voltage [V]{names}\n" + rows(";", volts, *columns), "jv.csv"))
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == ["Pixel A", "Pixel B", "Pixel C"]
    for k, record in enumerate(data):
        np.testing.assert_allclose(record.y[:N], curve(k, 0.05))
        np.testing.assert_allclose(record.y[N:], curve(k, 0.0)[::-1])


def test_branches_of_one_loop_are_no_records(tmp_path: Path) -> None:
    """A virgin curve and two branches are numbered; each cycle of an experiment may be read alone."""
    field = np.concatenate([np.arange(20), np.arange(19, -21, -1), np.arange(-19, 20)]).astype(float)
    moment = np.tanh((field - 3 * np.sign(np.gradient(field))) / 5)
    segment = np.repeat([1, 2, 3], [20, 40, 39])
    text = "Segment,Field [Oe],Moment [emu],Time Stamp [s]\n" + rows(",", segment, field, moment, np.arange(99))
    assert not any(note.option for note in one(tmp_path, text).notes)
    cycles = np.repeat([1, 2], N // 2)
    record = one(tmp_path, "Cycle,Field [Oe],Moment [emu]\n" + rows(",", cycles, SWEEP, SIGNAL))
    assert any(note.option == ("by", "Cycle") for note in record.notes)


def test_results_with_the_decimal_comma_of_their_file(tmp_path: Path) -> None:
    text = "Probe:\tM400-50A\nPs [W/kg]:\t3,21\nHc [A/m]:\t61,2\nH [A/m]\tJ [T]\n"
    record = one(tmp_path, text + rows("\t", 100 * SWEEP, SIGNAL).replace(".", ","))
    found = {result.label: (result.value, result.unit, result.quantity) for result in record.stated}
    assert found == {"Ps": (3.21, "W/kg", ""), "Hc": (61.2, "A/m", "coercive_input")}


def test_the_unit_of_a_column_that_has_no_other_name_is_a_symbol(tmp_path: Path) -> None:
    record = one(tmp_path, "TestTime\tVolts\tAmps\tES\n" + rows("\t", T, SWEEP, 1e-3 * SIGNAL, 1 + 0 * U))
    assert (record.u_name, record.y_name) == ("Volts", "Amps")
    assert (record.u_unit, record.y_unit) == ("V", "A")


def test_pulses_that_switch_a_film_charge_no_cell(tmp_path: Path) -> None:
    """Most of the current is the small one of the capacitance, and that of a cell at constant currents is not."""
    pulse = np.concatenate([np.zeros(10), 1 - np.abs(np.linspace(-1, 1, 81)), np.zeros(10)])
    volts = 3 * np.concatenate([-pulse, pulse, pulse, -pulse, -pulse])
    bump = np.exp(-(((np.arange(pulse.size) - 35) / 3) ** 2))
    switching = np.concatenate([-bump, bump, 0 * bump, -bump, 0 * bump])
    current = np.round(1e-3 * switching + 2e-5 * np.gradient(volts) / 0.075, 8)
    noise = 1e-3 * np.random.default_rng(1).standard_normal(volts.size).round(3)
    times = 1e-6 * np.arange(volts.size)
    is_pair(one(tmp_path, "time,V_meas,I_meas\n" + rows(",", times, volts + noise, current)), volts + noise, current)


def test_a_density_of_current_rather_than_the_power_computed_from_it(tmp_path: Path) -> None:
    ways = np.where(np.arange(N) < N // 2, "Reverse", "Forward")
    density = np.round(22 - np.exp(3 * SWEEP) + SIGNAL, 4)
    names = "Scan Direction,Voltage (V),Current Density (mA/cm^2),Power Density (mW/cm^2)\n"
    record = one(tmp_path, names + rows(",", ways, SWEEP, density, np.round(density * SWEEP, 4)))
    is_pair(record, SWEEP, density)


def test_quoted_names_behind_a_mark_of_comments(tmp_path: Path) -> None:
    text = '# dac_ch1\tcurr\n# "Gate voltage"\t"Drain current"\n# 60\n' + rows("\t", SWEEP, SIGNAL)
    record = one(tmp_path, text, "sweep.dat")
    is_pair(record, SWEEP, SIGNAL)
    assert (record.u_name, record.y_name) == ("Gate voltage", "Drain current")


@pytest.mark.parametrize(
    ("names", "pair"),
    [
        ("E_set(V);E_meas(V);I(mA)", (1, 2)),  # a potentiostat
        ("Set_T (C);T_meas (C);Resistance (Ohm)", (1, 2)),  # C is no coulomb
        ("SetTemp;SampleTemp;Moment", (1, 2)),
        ("Field_set[mT];Field[mT];Lockin_R[V];Lockin_theta[deg]", (1, 2)),
    ],
)
def test_what_a_source_reached_drives_rather_than_follows_its_set_value(names, pair, tmp_path: Path) -> None:
    reached = np.round(40 * SWEEP + 0.03 * NOISE, 3)
    columns = [np.round(40 * SWEEP, 1), reached, 0.2 + 0.1 * SIGNAL, 12 + 0.3 * SIGNAL + 0.01 * NOISE]
    count = names.count(";") + 1
    record = one(tmp_path, names + "\n" + rows(";", *columns[:count]))
    is_pair(record, columns[pair[0]], columns[pair[1]])
