"""Files of testing machines, gauges and cyclers whose headers state more than the names of columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Record
from hystfit.reading import read

N = 120
U = np.round(np.concatenate([np.linspace(0, 4, N // 2), np.linspace(4, 0, N // 2)]), 3)
Y = np.round(30 + 5 * U + np.where(np.arange(N) < N // 2, 6, -6), 2)
MARKS = [",", "\t", ";"]


def one(folder: Path, head: str, *columns: object, mark: str = ",", name: str = "test.csv") -> Record:
    rows = (mark.join(map(str, row)) for row in zip(*columns, strict=True))
    path = folder / name
    path.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
    data = read(path)
    assert isinstance(data, Record), [record.name for record in data]
    return data


def is_pair(record: Record, units: tuple[str, str]) -> None:
    np.testing.assert_allclose(record.u, U)
    np.testing.assert_allclose(record.y, Y)
    assert (record.u_unit, record.y_unit) == units


@pytest.mark.parametrize("mark", MARKS)
def test_a_line_of_units_above_columns_without_names_tells_the_force(mark: str, tmp_path: Path) -> None:
    head = f"MAX FORCE = 56.0{mark}4.0\nUNIT = gf{mark}mm\nDATA COUNT = {N}{mark}\nCOMMENT = {mark}\n"
    record = one(tmp_path, head, Y, U, mark=mark)
    is_pair(record, ("mm", "gf"))
    assert not any("are the columns exchanged" in note.text for note in record.notes)


@pytest.mark.parametrize("mark", MARKS)
def test_names_and_units_of_channels_behind_their_words(mark: str, tmp_path: Path) -> None:
    names, units = mark.join(["Zeit", "Kraft", "Weg"]), mark.join(["s", "kN", "mm"])
    record = one(
        tmp_path, f"T0 = 12.06.2018\nCHANNELNAME = {names}\nUNIT = {units}\n", np.arange(N) / 5, Y, U, mark=mark
    )
    is_pair(record, ("mm", "kN"))
    assert (record.u_name, record.y_name) == ("Weg", "Kraft")
    np.testing.assert_allclose(record.t, np.arange(N) / 5)


@pytest.mark.parametrize(
    "days", ["{}d {:02d}:{:02d}:{:02d}.50", "{} days {:02d}:{:02d}:{:02d}", '"{} day, {:d}:{:02d}:{:02d}"']
)
def test_days_that_passed_are_a_time(days: str, tmp_path: Path) -> None:
    """As cyclers, pandas and Python write a duration."""
    clock = [days.format(s // 86400, s // 3600 % 24, s // 60 % 60, s % 60) for s in range(0, 2500 * N, 2500)]
    record = one(tmp_path, "Time,Position (mm),Force (N)\n", clock, U, Y)
    is_pair(record, ("mm", "N"))
    np.testing.assert_allclose(record.t, 2500.0 * np.arange(N))


@pytest.mark.parametrize("turbid_first", [False, True])
def test_codes_of_columns_mean_what_the_comments_say(turbid_first: bool, tmp_path: Path) -> None:
    """As tables of river gauges, in which the discharge is the first or the second column."""
    words = ["Discharge, cubic feet per second", "Turbidity, water, unfiltered, formazin nephelometric units (FNU)"]
    codes, columns = ["69928_00060", "69938_63680"], [U, Y]
    order = [1, 0] if turbid_first else [0, 1]
    head = "# Data provided for site 01646500\n#        TS   parameter     Description\n"
    head += "".join(f"#     {codes[k].replace('_', '       ')}     {words[k]}\n" for k in order)
    head += "datetime\t" + "\t".join(codes[k] for k in order) + "\n20d\t14n\t14n\n"
    stamps = [f"2021-09-01 {k // 4 % 24:02d}:{15 * (k % 4):02d}" for k in range(96)]
    stamps += [f"2021-09-02 {k // 4:02d}:{15 * (k % 4):02d}" for k in range(N - 96)]
    record = one(tmp_path, head, stamps, *(columns[k] for k in order), mark="\t", name="gauge.txt")
    is_pair(record, ("ft3/s", ""))
    assert (record.u_name, record.y_name) == ("Discharge", "Turbidity")


def test_the_size_of_a_specimen_comes_after_its_displacement(tmp_path: Path) -> None:
    record = one(tmp_path, "Time_S,Size_mm,Displacement_mm,Force_N\n", np.arange(N), 10 + U, U, Y)
    is_pair(record, ("mm", "N"))


def test_numbers_of_samples_and_settings_are_no_properties_of_the_sample(tmp_path: Path) -> None:
    head = "Samples: 120\nStep size: 0.5\nheightMultiplier: 0.7\nSample height (mm): 12.5\n\nPosition (mm),Force (N)\n"
    record = one(tmp_path, head, U, Y)
    assert record.metadata == {"Sample height (mm)": "12.5"}


def test_control_bandwidth_and_limits_are_no_properties_of_the_sample(tmp_path: Path) -> None:
    head = "Temperature control: on\nTemperature max: 70 degC\nSample bandwidth: 1\nSample height (mm): 12.5\n\nPosition (mm),Force (N)\n"
    assert one(tmp_path, head, U, Y).metadata == {"Sample height (mm)": "12.5"}


@pytest.mark.parametrize("mark", [",", "\t"])
def test_a_charge_that_falls_as_well_as_grows_is_the_charge_that_passed(mark: str, tmp_path: Path) -> None:
    """Beside it stand the charge and energy of the cycle, which look like branches side by side."""
    charge = np.concatenate([np.linspace(0, -2, 80), np.linspace(-2, 0, 80)])
    volts = 3.6 + 0.3 * charge + 0.1 * np.repeat([-1, 1], 80) + 0.02 * charge**2
    passed = np.abs(np.concatenate([charge[:80], charge[80:] + 2]))
    number = np.arange(charge.size)
    cycle = ["Ah-Cyc-Charge", "Ah-Cyc-Discharge", "Ah-Cyc-Charge-0", "Ah-Cyc-Discharge-0"]
    names = mark.join(["~Time[s]", "DataSet", "t-Set[s]", "Line", "U[V]", "I[A]", "Ah[Ah]", *cycle])
    up, down = np.where(number < 80, 0, passed), np.where(number < 80, passed, 2)
    columns = (
        60 * number,
        number + 1,
        60 * number,
        0 * up + 3,
        volts,
        np.repeat([-1, 1], 80),
        charge,
        up,
        down,
        up,
        down,
    )
    rows = [(*(f"{value:.6f}" for value in row),) for row in zip(*columns, strict=True)]
    record = one(tmp_path, names + "\n", *zip(*rows, strict=True), mark=mark)
    np.testing.assert_allclose(record.u, charge, atol=1e-6)
    np.testing.assert_allclose(record.y, volts, atol=1e-6)
    assert (record.u_unit, record.y_unit) == ("Ah", "V")


def test_a_diagram_of_points_that_are_printed_twice_is_driven_by_its_coordinate(tmp_path: Path) -> None:
    """Neither column has a name, and the curve goes up and down: a coordinate that only grows is no output."""
    place = np.repeat(np.linspace(0, 8, 100), 2)
    moment = np.interp(place, [0, 3, 8], [0, -63000, 45000]) + 500 * np.sin(place)
    record = one(tmp_path, "", np.round(place, 6), np.round(moment, 2))
    assert np.ptp(record.u) == pytest.approx(8)
    assert np.ptp(record.y) > 1e5


@pytest.mark.parametrize("mark", MARKS)
def test_a_transducer_is_named_by_its_number(mark: str, tmp_path: Path) -> None:
    """The rows above the numbers have names, some of them serial numbers, and units; a day is no unit of the software."""
    names, units = mark.join(["Day", "Force", "Disp", "128106", "215"]), mark.join(["d", "kN", "mm", "mm", "mm"])
    columns = (np.full(N, 42032), Y, U, np.round(0.01 * Y, 4), np.round(0.02 * Y, 4))
    record = one(tmp_path, f"{names}\n{units}\n", *columns, mark=mark)
    is_pair(record, ("mm", "kN"))
    assert (record.u_name, record.y_name) == ("Disp", "Force")


@pytest.mark.parametrize("decimal", [".", ","])
def test_the_largest_values_below_a_test_in_other_columns_are_no_record(decimal: str, tmp_path: Path) -> None:
    """A testing machine writes its acquisition and then the largest and smallest values, with the channels in another order."""
    head = "Acquisition\t\tTime:\t%s\ts\n"
    rows = [f"{k / 5}\t{y}\t{u}\t{0.01 * y:.3f}" for k, (y, u) in enumerate(zip(Y, U, strict=True))]
    test = f"{head % 12.5}Time\tForce\tPosition\tGauge A\ns\tkN\tmm\tmm\n" + "\n".join(rows)
    peaks = f"{head % 24.5}Time\tPosition\tForce\tGauge A\tGauge B\ns\tmm\tkN\tmm\tmm\n"
    peaks += "23.8\t0.0\t24.0\t0.1\t0.2\n11.8\t4.0\t56.0\t0.3\t0.4\n"
    path = tmp_path / "specimen.dat"
    path.write_text(f"{test}\n\n{peaks}".replace(".", decimal), encoding="utf-8")
    data = read(path)
    assert isinstance(data, Record), [record.name for record in data]
    is_pair(data, ("mm", "kN"))
    np.testing.assert_allclose(data.t, np.arange(N) / 5)


def test_the_titles_of_tables_have_no_tabs(tmp_path: Path) -> None:
    names = "Time\tPosition\tForce\ns\tmm\tkN\n"
    text = ""
    for run in (5, 6):
        rows = "\n".join(f"{k / 5}\t{u}\t{run * y:.2f}" for k, (u, y) in enumerate(zip(U, Y, strict=True)))
        text += f"Run\t\tForce:\t{run}\tkN\n{names}{rows}\n\n"
    path = tmp_path / "runs.dat"
    path.write_text(text, encoding="utf-8")
    assert [record.name for record in read(path)] == ["Run Force: 5 kN", "Run Force: 6 kN"]
