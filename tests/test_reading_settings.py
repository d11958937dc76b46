"""Settings, commands, counters and comments beside a loop: none of them takes its place or hides its names."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from hystfit.data import Dataset, Record
from hystfit.errors import DataError
from hystfit.outcome import Code
from hystfit.reading import read
from hystfit.reading.table.signal_evidence import has_loop
from tests.loop_files import N, U, Y, is_pair, one, rows, written

SWEEP = np.round((U - 40) / 8, 4)  # between -1 and 1
NOISE = np.random.default_rng(7).standard_normal(N).round(3)
HALF = N // 2
RAMP = np.concatenate([np.linspace(-1, 1, HALF), np.linspace(1, -1, HALF)]).round(4)
LAGGING = np.tanh(3 * (RAMP - 0.3 * np.where(np.arange(N) < HALF, 1, -1))).round(4)


def _step(record: Record) -> float | None:
    """The time from the first sample to the second; None where there is no time."""
    return None if record.t is None else float(record.t[1] - record.t[0])


# Times and sampling intervals ---------------------------------------------------------------------------------------------------


def test_stamps_in_lines_of_json_are_the_time(tmp_path: Path) -> None:
    stamps = [f"2024-03-01T10:00:{k // 10:02d}.{k % 10}00Z" for k in range(N)]
    lines = [{"ts": t, "cmd_V": u, "sensor_um": y} for t, u, y in zip(stamps, U.tolist(), Y.tolist(), strict=True)]
    record = one(tmp_path, "\n".join(map(json.dumps, lines)), "log.jsonl")
    is_pair(record)
    np.testing.assert_allclose(record.t, 0.1 * np.arange(N), atol=1e-9)


def test_ambiguous_dates_that_nobody_needs_do_not_block_json(tmp_path: Path) -> None:
    days = [f"{1 + k % 9}/{1 + k % 7}/2024" for k in range(N)]
    record = one(tmp_path, json.dumps({"day": days, "H_T": U.tolist(), "M_emu": Y.tolist()}), "loop.json")
    is_pair(record)
    assert record.t is None


@pytest.mark.parametrize(("name", "value", "step"), [("Ts", 0.01, 0.01), ("fs", 50, 0.02), ("Ts", 300.2, None)])
def test_a_sampling_time_beside_arrays(name: str, value: float, step: float | None, tmp_path: Path) -> None:
    """Ts is the sampling time of a controller or the temperature of a sample."""
    savemat(tmp_path / "run.mat", {"run": {name: value, "u": U, "y": Y}})
    written(tmp_path, json.dumps({name: value, "u": U.tolist(), "y": Y.tolist()}), "run.json")
    np.savez(tmp_path / "run.npz", **{name: value, "u": U, "y": Y})
    for file in ("run.mat", "run.json", "run.npz"):
        record = read(tmp_path / file)
        is_pair(record)
        assert _step(record) == (step if step is None else pytest.approx(step))


def test_a_sampling_rate_in_the_attributes_of_a_file(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "scope.h5", "w") as file:
        file.attrs.update(sampling_rate=50.0, temperature=300.0)
        file["drive_V"], file["charge_nC"] = U, Y
    record = read(tmp_path / "scope.h5")
    is_pair(record)
    assert _step(record) == pytest.approx(0.02)


def test_step_and_rate_of_a_potential_state_the_interval(tmp_path: Path) -> None:
    head = "Cyclic Voltammetry\nScan Rate (V/s) = 0.05\nSample Interval (V) = 0.004\n\nPotential/V, Current/A\n\n"
    record = one(tmp_path, head + rows(", ", RAMP, LAGGING), "cv.txt")
    is_pair(record, RAMP, LAGGING)
    assert _step(record) == pytest.approx(0.08)


# Names and units ----------------------------------------------------------------------------------------------------------------


def test_units_in_settings_that_begin_with_an_underscore(tmp_path: Path) -> None:
    head = "_parser_version,1.0\n_units_pressure,bar\n_units_loading,mmol\ndata:[pressure,loading]\npressure,loading,branch\n"
    record = one(tmp_path, head + rows(",", U, Y, np.where(np.arange(N) < HALF, "ads", "des")))
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("bar", "mmol")


def test_units_set_in_below_a_title(tmp_path: Path) -> None:
    head = "---\nsample: film\nunits:\n  field: T\n  rotation: mdeg\nlaser: 633\n---\nfield,rotation,reflectivity\n"
    record = one(tmp_path, head + rows(",", SWEEP, Y, 0.7 + 1e-4 * NOISE))
    is_pair(record, SWEEP, Y)
    assert (record.u_unit, record.y_unit) == ("T", "mdeg")


def test_settings_below_the_names_of_rows_that_are_set_in(tmp_path: Path) -> None:
    """As pandas writes a table below a dictionary of settings, whose values are a column called 0."""
    settings = "scan rate (mV/s),160.0,,,\nscan low (V),-1.0,,,\nscan high (V),1.0,,,\nnum scan,1.0,,,\n"
    wave, lagging = np.tile(RAMP, 3), np.tile(LAGGING, 3)
    empty = np.full(wave.size, "")
    table = rows(",", empty, empty, 100.0 * np.arange(wave.size), wave, lagging)
    record = one(tmp_path, f"index,0,time (ms),Voltage (V),Current (mA)\n{settings}{table}")
    is_pair(record, wave, lagging)
    assert (record.u_unit, record.y_unit) == ("V", "mA")


def test_comments_behind_flagged_rows(tmp_path: Path) -> None:
    flags = np.where(np.arange(N) % 9 == 4, "RANGE # autorange of the amplifier", "OK")
    record = one(tmp_path, "H[Oe] M[memu] flag\n" + rows(" ", U, Y, flags), "loop.txt")
    is_pair(record)


# Several records or one ---------------------------------------------------------------------------------------------------------


def test_pages_of_one_loop(tmp_path: Path) -> None:
    field, moment = np.round(8000 * RAMP, 1), np.round(41 * LAGGING, 3)
    page = lambda k: (
        f"Page {k + 1}\nH (Oe);M (emu/g)\n" + rows(";", field[15 * k : 15 * k + 15], moment[15 * k : 15 * k + 15])
    )
    is_pair(one(tmp_path, "".join(map(page, range(4)))), field, moment)
    loops = "".join(f"Loop {k}\nH (Oe);M (emu/g)\n" + rows(";", field, moment) for k in (1, 2))  # each a whole one
    assert isinstance(read(written(tmp_path, loops, "loops.csv")), Dataset)


def test_groups_that_each_begin_with_the_number_of_the_point(tmp_path: Path) -> None:
    names = "\t".join(f"Point\tTime (ms)\tDrive Voltage {k}\tPolarization {k} (uC/cm2)" for k in (1, 2, 3))
    group = [np.arange(N) + 1, 0.5 * np.arange(N)]
    table = rows("\t", *(column for k in (1, 2, 3) for column in (*group, U * k, Y * k)))
    data = read(written(tmp_path, f"{names}\n{table}", "loops.txt"))
    assert isinstance(data, Dataset)
    for k, record in enumerate(data, start=1):
        is_pair(record, U * k, Y * k)


def test_branches_of_three_columns_each(tmp_path: Path) -> None:
    """The voltage of a gate, the current of the drain and the leakage of the gate, forward and backward."""
    names = "GateV_fwd,DrainI_fwd,GateI_fwd,,GateV_bwd,DrainI_bwd,GateI_bwd"
    leak = 1e-12 * NOISE
    columns = (RAMP[:HALF], LAGGING[:HALF], leak[:HALF], np.full(HALF, ""), RAMP[HALF:], LAGGING[HALF:], leak[HALF:])
    is_pair(one(tmp_path, f"{names}\n{rows(',', *columns)}"), RAMP, LAGGING)


@pytest.mark.parametrize("word", ["Cycle", "Zyklus", "cykl"])
def test_numbers_of_cycles_in_any_language_divide_no_record(word: str, tmp_path: Path) -> None:
    many = 4
    wave, lagging = np.tile(RAMP, many), np.tile(LAGGING, many)
    number = np.repeat(np.arange(many) + 1, N)
    record = one(tmp_path, f"{word};H (kA/m);M (kA/m)\n" + rows(";", number, wave, lagging))
    is_pair(record, wave, lagging)


def test_numbers_of_repeats_are_no_further_input(tmp_path: Path) -> None:
    wave, lagging = np.tile(RAMP, 3), np.tile(LAGGING, 3)
    number, time = np.repeat([1, 2, 3], N), 0.02 * np.arange(3 * N)
    record = one(tmp_path, "Repeat,Voltage,Current,Time\n" + rows(",", number, wave, lagging, time))
    is_pair(record, wave, lagging)
    assert Code.CURVES not in {note.code for note in record.notes}


# Which columns are the loop -----------------------------------------------------------------------------------------------------


def test_a_set_value_without_a_quantity_is_that_of_the_field_of_its_name(tmp_path: Path) -> None:
    up = np.arange(-60.0, 61.0, 2.0)
    steps, noise = np.append(up, up[::-1]), np.random.default_rng(3).standard_normal(2 * up.size)
    field = np.round(steps + 0.02 * noise, 3)
    kerr = 0.31 + 0.0012 * np.tanh((steps - np.repeat([14, -14], up.size)) / 5) + 2e-5 * noise[::-1]
    columns = {"coil_1_field": field, "coil_1_setpoint": steps, "coil_2_field": 0.05 * noise, "kerr_signal": kerr}
    text = json.dumps({name: values.tolist() for name, values in columns.items()})
    is_pair(one(tmp_path, text, "moke.json"), field, columns["kerr_signal"])


def test_the_output_of_a_source_is_not_the_input_beside_the_field_of_its_coil(tmp_path: Path) -> None:
    up = np.round(np.linspace(-5, 5, 81), 3)
    steps, noise = np.append(up, up[::-1]), np.random.default_rng(3).standard_normal(2 * up.size)
    field = np.round(102 * steps + 0.4 * noise, 3)
    kerr = np.round(0.5 + 0.2 * np.tanh((field - np.repeat([63, -63], up.size)) / 11) + 0.004 * noise[::-1], 5)
    names = "cycle,direction,source_output,detector_voltage,field_measured (Oe)\n"
    columns = (np.zeros(2 * up.size), np.repeat([1, -1], up.size), steps, kerr, field)
    is_pair(one(tmp_path, names + rows(",", *columns)), field, kerr)


def test_the_input_of_an_open_loop_rather_than_a_reference_that_nothing_follows(tmp_path: Path) -> None:
    is_pair(one(tmp_path, "ref,u,y\n" + rows(",", np.round(U / 3, 4), U, Y)))


def test_a_resistance_over_the_temperature_rather_than_over_its_heater(tmp_path: Path) -> None:
    kelvin = np.round(330 + 30 * RAMP, 3)
    heater = np.round(50 + 40 * RAMP + NOISE, 1)
    names = "T_A(K)\tT_B(K)\tR_2w(Ohm)\tHeater(%)"
    columns = (kelvin, np.round(0.995 * kelvin + 0.02 * NOISE, 3), 100 - 50 * LAGGING, heater)
    is_pair(one(tmp_path, names + "\n" + rows("\t", *columns), "film.dat"), kelvin, columns[2])
    is_pair(one(tmp_path, "Heater(%)\tT_A(K)\n" + rows("\t", heater, kelvin), "oven.dat"), heater, kelvin)


def test_of_outputs_of_one_quantity_the_one_with_a_loop(tmp_path: Path) -> None:
    """Along the current the magnetoresistance is even and without a loop, across it the anomalous Hall resistance has one."""
    along = np.round(3.2 + 0.1 * RAMP**2 + 1e-4 * NOISE, 5)
    record = one(
        tmp_path, "Field [T],Rxx [Ohm],Rxy [mOhm],Temp [K]\n" + rows(",", RAMP, along, LAGGING, 5 + 1e-3 * NOISE)
    )
    is_pair(record, RAMP, LAGGING)
    degrees = np.round(85 + 20 * LAGGING + 0.5 * NOISE, 2)
    volume = np.round(11 + 9 * RAMP, 3)
    height = np.round(volume ** (1 / 3) + 0.01 * NOISE, 4)
    record = one(tmp_path, "Volume [µl],Drop height [mm],CA [°]\n" + rows(",", volume, height, degrees))
    is_pair(record, volume, degrees)


def test_the_question_where_only_the_number_of_a_row_is_known_to_be_no_input(tmp_path: Path) -> None:
    """A calorimeter calls its signal a value, in mW; the temperature of the sample and of the reference remain."""
    kelvin = np.linspace(0, 110, N).round(3)
    names = "Index\tt [s]\tTs [°C]\tTr [°C]\tValue [mW]\n"
    columns = (np.arange(N), 3.0 * np.arange(N), kelvin + 0.01 * NOISE, kelvin, -3 + 0.01 * NOISE)
    with pytest.raises(DataError, match=r"choose, such as --input"):
        read(written(tmp_path, names + rows("\t", *columns), "dsc.txt"))


def test_noise_is_no_loop() -> None:
    part = np.zeros(N)
    straight = [
        has_loop(RAMP, RAMP + size * np.random.default_rng(seed).standard_normal(N), part)
        for seed in range(200)
        for size in (0.0, 0.01, 0.3, 10.0)
    ]
    assert not any(straight)
    assert has_loop(RAMP, LAGGING, part)


# Damaged files ------------------------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("error")
def test_numbers_beyond_a_double_are_missing(tmp_path: Path) -> None:
    lost = np.where(np.arange(N) < N - 5, "1e400", "2")
    with pytest.raises(DataError, match="found 1 column"):
        read(written(tmp_path, "H,M\n" + rows(",", lost, Y), "loop.csv"))


def test_a_pointer_in_place_of_the_file(tmp_path: Path) -> None:
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab2935c943f9e0ff69\nsize 12345\n"
    with pytest.raises(DataError, match="git lfs pull"):
        read(written(tmp_path, pointer, "loop.csv"))


def test_steps_and_cycles_around_the_rows_of_a_cell(tmp_path: Path) -> None:
    """The records of a cycler, each set in below its step, and the steps below their cycle."""
    soc = np.linspace(0, 1, N).round(4)
    volts = np.round(3.3 + 0.3 * soc + 0.05 * np.tanh(9 * soc - 4), 4)
    text = "Cycle,Charge Capacity(mAh),Discharge Capacity(mAh),,,\n,Step,Type,Capacity(mAh),,\n"
    text += ",,Record,Voltage(V),Current(mA),Capacity(mAh)\n"
    for cycle in (1, 2):
        text += f"{cycle},2.5,2.49,,,\n"
        for step, name, way in ((1, "CC Chg", 1), (2, "CC DChg", -1)):
            level = volts[::way] + 0.04 * way
            records = (np.full(N, ""), np.full(N, ""), np.arange(N), level.round(4), np.full(N, 0.5 * way), 2.5 * soc)
            text += f",{step},{name},2.5,,\n" + rows(",", *records)
    record = one(tmp_path, text)
    expected = np.concatenate([2.5 * soc, 2.5 * soc[::-1]])
    np.testing.assert_allclose(record.u, np.tile(expected, 2), atol=1e-9)
    np.testing.assert_allclose(record.y, np.tile(np.append(volts + 0.04, volts[::-1] - 0.04), 2), atol=1e-4)


def test_columns_without_names_are_asked_for_whichever_has_a_loop(tmp_path: Path) -> None:
    """Time, strain, curvature, force and moment of a section: no loop tells which of them drives."""
    columns = (0.1 * np.arange(N), 1e-3 * RAMP**2, RAMP, 2 * RAMP**2 + 1e-3 * NOISE, LAGGING)
    with pytest.raises(DataError, match="choose, such as"):
        read(written(tmp_path, rows(" ", *columns), "section.out"))
