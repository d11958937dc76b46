"""Files of data loggers, recorders and testers: dates in whole numbers, conditions in names, and signals whose partner is elsewhere."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Dataset, Record
from hystfit.errors import DataError
from hystfit.outcome import Code
from hystfit.reading import read
from hystfit.reading.names.names_with_units import split_unit

from .loop_files import N, U, Y, is_pair, one, rows, written

T = np.round(0.1 * np.arange(N), 1)
X = np.round(20 * np.cos(np.linspace(0, 4 * np.pi, N)), 3)


# Times --------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["%Y%m%d%H%M", "%Y%m%d%H%M%S", "%Y%m%d"])
def test_dates_in_whole_numbers(form: str, tmp_path: Path) -> None:
    """Half hours over midnight and the end of a month, as eddy covariance and weather stations write them."""
    step = np.timedelta64(1, "D") if form == "%Y%m%d" else np.timedelta64(30, "m")
    stamps = np.datetime64("2019-10-31T20:00:00") + step * np.arange(N)
    written_as = np.array([stamp.astype(object).strftime(form) for stamp in stamps])
    record = one(tmp_path, "TIMESTAMP_START,TS_F_MDS_1,RECO_NT_VUT_REF\n" + rows(",", written_as, U, Y))
    is_pair(record)
    assert record.t is not None
    np.testing.assert_array_equal(record.t, (step / np.timedelta64(1, "s")) * np.arange(N))
    assert record.t_unit == "s"


def test_whole_numbers_that_are_no_dates_stay_times(tmp_path: Path) -> None:
    counts = 20_191_040 + 7 * np.arange(N)  # the 40th of October is none
    record = one(tmp_path, "time,disp,force\n" + rows(",", counts, U, Y))
    is_pair(record)
    assert record.t is not None
    np.testing.assert_array_equal(record.t, counts)


def test_a_signal_over_an_even_column_has_no_partner(tmp_path: Path) -> None:
    """The recorder of a structural program writes the pseudo-time and one response, without names."""
    response = np.sin(np.linspace(0, 8 * np.pi, N))
    with pytest.raises(DataError, match=r"INPUT_FILE\+"):
        read(written(tmp_path, rows(" ", np.round(0.01 * np.arange(N), 2), response), "disp.out"))


# Columns ------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("other", ["", "\tIg (A)"])
def test_outputs_at_conditions_before_a_further_column(other: str, tmp_path: Path) -> None:
    """Transfer curves of a transistor at two drain voltages, and its gate current behind them."""
    columns = [U, Y, np.round(10 * Y, 2), np.round(1e-3 * np.cos(U), 7)][: 4 if other else 3]
    data = read(written(tmp_path, f"Vg (V)\tId (A) Vd=0.1V\tId (A) Vd=1V{other}\n" + rows("\t", *columns), "loop.txt"))
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == ["0.1 V", "1 V"]
    is_pair(data[0])
    is_pair(data[1], U, columns[2])
    assert any(note.code == Code.LEFT_OUT and "Ig" in note.text for note in data[0].notes) == bool(other)


def test_branches_by_their_signs(tmp_path: Path) -> None:
    field = np.round(np.linspace(-100, 100, N), 3)
    rising = np.round(np.tanh((field - 20) / 12), 5)
    record = one(tmp_path, "H (A/m),B+ (T),B- (T)\n" + rows(",", field, rising, -rising[::-1]))
    is_pair(record, np.append(field, field[::-1]), np.append(rising, -rising))


@pytest.mark.parametrize(
    "beside", ["Secondary voltage (V)", "Primary current (A)", "Primary current (A),Secondary voltage (V)"]
)
@pytest.mark.parametrize("first", [True, False])
def test_the_field_and_the_induction_go_before_the_windings(beside: str, first: bool, tmp_path: Path) -> None:
    phase = np.linspace(0, 2 * np.pi, 200)
    field, induction = np.round(1000 * np.cos(phase), 3), np.round(np.tanh(2 * np.cos(phase - 0.3)), 5)
    windings = {"Primary": field / 500, "Secondary": np.round(40 * np.gradient(induction), 5)}
    more = [windings[name.split()[0]] for name in beside.split(",")]
    names, columns = ["H (A/m),B (T)", beside], [[field, induction], more]
    order = (1, 0) if first else (0, 1)
    text = ",".join(names[k] for k in order) + "\n" + rows(",", *(column for k in order for column in columns[k]))
    is_pair(one(tmp_path, text), field, induction)


@pytest.mark.parametrize(
    ("names", "pair"),
    [
        ("VG,VD,ID,IG", ("VG", "ID")),
        ("Time (h),Plasma concentration (ng/mL),Effect (% inhibition)", (None, "Effect (% inhibition)")),
        ("millis,fsr_raw,loadcell_g", ("loadcell_g", "fsr_raw")),
        ("E (kV/cm),S (%)", ("E (kV/cm)", "S (%)")),
        ("flow_lpm,pressure_cmH2O,volume_ml", ("pressure_cmH2O", "volume_ml")),
        ("v_primary (V),i_primary (A),v_secondary (V)", ("i_primary (A)", "v_secondary (V)")),
    ],
)
def test_names_of_drives_and_responses(names: str, pair: tuple[str | None, str], tmp_path: Path) -> None:
    first = T if names.lower().startswith(("time", "millis")) else np.round(1.05 * Y, 3) if "v_p" in names else X
    columns = {
        4: (U, np.full(N, 0.5), Y, np.round(1e-3 * U, 6)),
        3: (first, Y if "raw" in names else U, U if "raw" in names else Y),
        2: (U, Y),
    }
    record = one(tmp_path, f"{names}\n" + rows(",", *columns[names.count(",") + 1]))
    is_pair(record)
    assert record.y_name == pair[1]
    assert pair[0] is None or record.u_name == pair[0]


def test_strain_in_percent_beside_an_electric_field_is_no_stress(tmp_path: Path) -> None:
    record = one(tmp_path, "E (kV/cm),S (%)\n" + rows(",", U, Y))
    assert any("S (%)" in note.text and "(strain)" in note.text for note in record.notes)


def test_the_temperature_of_a_heated_wire_drives_it(tmp_path: Path) -> None:
    """The current of the heater is no input where the temperature that it makes is measured."""
    warm = np.concatenate([np.linspace(30, 90, N // 2), np.linspace(90, 30, N // 2)])
    current = np.round(np.sqrt((warm - 30) / 60), 3)
    moved = np.round(3 / (1 + np.exp((warm - np.repeat([70, 60], N // 2)) / 2)), 4)
    record = one(
        tmp_path,
        "Time (s),Heater current (A),Temperature (°C),Displacement (mm)\n"
        + rows(",", T, current, np.round(warm, 2), moved),
    )
    is_pair(record, np.round(warm, 2), moved)


def test_an_input_in_a_group_of_a_file_is_no_unit(tmp_path: Path) -> None:
    """V_in of the group run_001 is a voltage in volts, as its attribute states, and not a quantity in V_in."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "runs.h5", "w") as file:
        for times, group in enumerate(("run_001", "run_002"), 1):
            for name, values, unit in (("time", T, "s"), ("V_in", U, "V"), ("disp", Y, "um")):
                file.create_dataset(f"{group}/{name}", data=times * values).attrs["unit"] = unit
    data = Dataset.of(read(tmp_path / "runs.h5"))
    assert [record.name for record in data] == ["run_001", "run_002"]
    assert {(record.u_unit, record.y_unit, record.t_unit) for record in data} == {("V", "um", "s")}


# Rows --------------------------------------------------------------------------------------------------------------------------


def test_names_over_samples_of_which_nothing_was_measured(tmp_path: Path) -> None:
    body = [f"{u},{y},300\n" for u, y in zip(U, Y, strict=True)]
    body[40:40] = body[0:0] = ["NaN,NaN,NaN\n"]
    record = one(tmp_path, "Field(T),Moment(emu/g),Temp\n" + "".join(body))
    is_pair(record)
    assert (record.u_name, record.y_unit) == ("Field(T)", "emu/g")
    assert any(note.code == Code.LEFT_OUT and "1 x row of missing values" in note.text for note in record.notes)


def test_an_array_of_zeros_that_a_record_fills_in_part(tmp_path: Path) -> None:
    zeros = np.zeros(12)
    columns = (np.append(values, zeros) for values in (T[1:], U[1:], Y[1:]))
    record = one(tmp_path, "time_s,voltage_V,disp_um\n" + rows(",", *columns))
    is_pair(record, U[1:], Y[1:])
    assert any(note.code == Code.LEFT_OUT and "12 rows at the end" in note.text for note in record.notes)


# Clocks in parts ----------------------------------------------------------------------------------------------------------------


def is_timed(record: Record, step: float, unit: str = "s") -> None:
    assert record.t is not None
    np.testing.assert_allclose(record.t - record.t[0], step * np.arange(N), atol=1e-6)
    assert record.t_unit == unit


def test_seconds_and_nanoseconds_are_one_time(tmp_path: Path) -> None:
    nanos = 900_000_000 + 40_000_000 * np.arange(N)
    parts = (1_650_000_000 + nanos // 1_000_000_000, nanos % 1_000_000_000)
    record = one(tmp_path, "header.stamp.sec,header.stamp.nanosec,voltage,position\n" + rows(",", *parts, U, Y))
    is_pair(record)
    is_timed(record, 0.04)


def test_a_time_of_day_in_columns_over_midnight(tmp_path: Path) -> None:
    stamps = np.datetime64("2021-12-31T23:59:50") + np.timedelta64(1, "s") * np.arange(N)
    parts = [np.array([getattr(s.astype(object), word) for s in stamps]) for word in WORDS]
    record = one(tmp_path, f"{','.join(WORDS)},pressure_kPa,disp_mm\n" + rows(",", *parts, U, Y))
    is_pair(record)
    is_timed(record, 1.0)


WORDS = ("year", "month", "day", "hour", "minute", "second")


@pytest.mark.parametrize(("name", "first"), [("Date", 43831.0), ("t_datenum", 737791.0)])
def test_days_of_a_spreadsheet_and_of_matlab(name: str, first: float, tmp_path: Path) -> None:
    days = np.array([f"{first + 2 * k / 86400:.12f}" for k in range(N)])
    record = one(tmp_path, f"{name},Disp,Load\n" + rows(",", days, U, Y))
    is_pair(record)
    assert record.t is not None
    np.testing.assert_allclose(record.t, 2.0 * np.arange(N), atol=1e-4)
    assert record.t_unit == "s"


def test_elapsed_times_whose_seconds_have_one_digit(tmp_path: Path) -> None:
    """As battery testers write them: the first nine seconds of a minute, and whole ones of none."""
    seconds = np.round(86395 + 0.25 * np.arange(N), 2)
    clocks = [
        f"{s // 86400:.0f}d {s % 86400 // 3600:02.0f}:{s % 3600 // 60:02.0f}:{round(s % 60, 2):g}" for s in seconds
    ]
    assert {"0d 23:59:55", "1d 00:00:0", "1d 00:00:0.25"} <= set(clocks)
    record = one(tmp_path, "TestTime,Disp,Load\n" + rows(",", np.array(clocks), U, Y))
    is_pair(record)
    assert record.t is not None
    np.testing.assert_allclose(record.t, seconds - seconds[0], atol=1e-9)


# Lists in cells -----------------------------------------------------------------------------------------------------------------


def test_a_message_with_a_list_for_each_joint(tmp_path: Path) -> None:
    lines = [f'{t},"[\'j1\', \'j2\']","[{u}, 0.5]","[{y}, 0.1]"\n' for t, u, y in zip(T, U, Y, strict=True)]
    record = one(tmp_path, "time,name,position,effort\n" + "".join(lines))
    is_pair(record)
    assert (record.u_name, record.y_name) == ("position[0]", "effort[0]")


def test_a_row_for_each_loop(tmp_path: Path) -> None:
    lines = [f'{name},"{(k * U).tolist()}","{(k * Y).tolist()}"\n' for k, name in enumerate(("A1", "B2"), 1)]
    data = Dataset.of(read(written(tmp_path, "specimen,H (Oe),M (emu)\n" + "".join(lines), "loops.csv")))
    assert [record.name for record in data] == ["A1", "B2"]
    is_pair(data[0])
    is_pair(data[1], 2 * U, 2 * Y)


def test_process_variables_of_an_archive_are_channels(tmp_path: Path) -> None:
    clock = {"secs": [1_600_000_000 + k // 4 for k in range(N)], "nanos": [250_000_000 * (k % 4) for k in range(N)]}
    variables = {"stage:VOLT": clock | {"val": U.tolist()}, "stage:POS": clock | {"val": Y.tolist()}}
    record = one(tmp_path, json.dumps(variables), "archive.json")
    is_pair(record)
    is_timed(record, 0.25)


# Text of programs ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["table", "coordinates"])
def test_curves_of_a_picture_in_latex(kind: str, tmp_path: Path) -> None:
    pairs = zip(U, Y, strict=True)
    body = rows(" ", U, Y) if kind == "table" else "".join(f"({u},{y})\n" for u, y in pairs)
    plot = f"\\addplot[blue] {kind} {{\n{body}}};\n\\addlegendentry{{300 K}}\n"
    head = "\\begin{axis}[xlabel={$H$ [A/m]}, ylabel={$B$ [T]}]\n"
    record = one(tmp_path, f"{head}{plot}\\end{{axis}}\n", "loop.tex")
    is_pair(record)
    assert (record.u_name, record.u_unit, record.y_unit) == ("H [A/m]", "A/m", "T")
    two = read(
        written(tmp_path, f"{head}{plot}{plot.replace('300', '77').replace('4', '5')}\\end{{axis}}\n", "two.tex")
    )
    assert [one.name for one in Dataset.of(two)] == ["300 K", "77 K"]


def test_an_array_of_matlab_that_goes_on_in_the_next_line(tmp_path: Path) -> None:
    body = " ...\n".join(" ".join(map(str, U[k : k + 10])) for k in range(0, N, 10))
    is_pair(one(tmp_path, f"% loop\nH = [ ...\n{body} ...\n];\nM = {[*map(float, Y)]};\n", "loop.m"))


# Headers ------------------------------------------------------------------------------------------------------------------------


def test_names_and_intervals_below_their_titles(tmp_path: Path) -> None:
    """SignalExpress of National Instruments."""
    stamp = "01/05/2021 12:00:00.1"
    head = f"channel names:\nDev1_Load\tDev1_Disp\nstart times:\n{stamp}\t{stamp}\ndt:\n0.004\t0.004\ndata:\n"
    record = one(tmp_path, head + rows("\t", Y, U), "daq.txt")
    is_pair(record)
    assert (record.u_name, record.y_name) == ("Dev1_Disp", "Dev1_Load")
    is_timed(record, 0.004)


def test_the_signal_of_a_load_cell_beside_its_load_in_cycles(tmp_path: Path) -> None:
    head = "Cycle 1,,Cycle 2,\nLoad (N),mV/V,Load (N),mV/V\n"
    data = Dataset.of(read(written(tmp_path, head + rows(",", U, Y, U, 2 * Y), "cell.csv")))
    assert [record.name for record in data] == ["Cycle 1", "Cycle 2"]
    is_pair(data[1], U, 2 * Y)
    assert (data[0].u_unit, data[0].y_unit) == ("N", "mV/V")


def test_a_unit_of_one_letter_behind_the_name_of_its_quantity() -> None:
    names = ("Time", "Force N", "Travel mm")
    assert [split_unit(name, names)[1] for name in names] == ["", "N", "mm"]
    phases = ("Current A", "Current B", "Current C")
    assert [split_unit(name, phases)[1] for name in phases] == ["", "", ""]
