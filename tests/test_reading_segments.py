"""Files in which segments, pages, sensors and specimens stand below or beside each other, and names that need their groups."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Record
from hystfit.data.dataset import Dataset
from hystfit.errors import DataError
from hystfit.outcome import Code
from hystfit.reading import read
from hystfit.reading.names.column_names import column_quantity
from hystfit.reading.text.header import read_header
from tests.loop_files import U, Y, written

ROWS = 240
PLACE = np.arange(ROWS)
RNG = np.random.default_rng(41)
X = 5 * np.sin(2 * np.pi * PLACE / 80)


def sticking(x: np.ndarray, force: float, gap: float) -> np.ndarray:
    """A force that turns over a distance, after every reversal of a displacement."""
    z = np.zeros(x.size)
    for k in range(1, x.size):
        z[k] = np.clip(z[k - 1] + force * (x[k] - x[k - 1]) / gap, -force, force)
    return z


F = sticking(X, 12.0, 0.8) + 2 * X


def table(*columns: object, mark: str = ",") -> str:
    return "".join(mark.join(f"{v:.6g}" for v in row) + "\n" for row in zip(*columns, strict=True))


def read_text(folder: Path, text: str, name: str = "a.csv") -> Record | Dataset:
    (folder / name).write_text(text, encoding="utf-8")
    return read(folder / name)


def pair(data: Record | Dataset) -> tuple[str, str]:
    record = data if isinstance(data, Record) else data[0]
    return record.u_name, record.y_name


def interval(number: int, time: np.ndarray, rate: np.ndarray, stress: np.ndarray) -> str:
    head = (
        f"Interval and data points:\t{number}\t{time.size}\nInterval data:\tPoint No.\tTime\tShear Rate\tShear Stress\n"
    )
    rows = (f"\t{k + 1}\t{a:g}\t{b:g}\t{c:.5g}\n" for k, (a, b, c) in enumerate(zip(time, rate, stress, strict=True)))
    return head + "\t\t\t\t\n\t\t[s]\t[1/s]\t[Pa]\n" + "".join(rows) + "\n"


@pytest.mark.parametrize(("pause", "records"), [(0.0, 1), (300.0, 2)])
def test_branches_in_tables_of_which_the_clock_goes_on_are_one_loop(tmp_path: Path, pause: float, records: int) -> None:
    """A flow curve of a thixotropic gel, up and down in an interval each; after a pause they are two measurements."""
    up = np.linspace(1, 100, 40)
    stress = 12 + 1.2 * up**0.6, (12 + 1.2 * up**0.6 - 4 * (1 - np.exp((up - 100) / 15)))[::-1]
    time = np.arange(40) * 2.0
    text = "Project:\tGel\nTest:\tLoop\nResult:\tLoop 1\n\n" + interval(1, time, up, stress[0])
    data = read_text(tmp_path, text + interval(2, time + 80 + pause, up[::-1], stress[1]))
    assert pair(data) == ("Shear Rate", "Shear Stress")
    assert (1 if isinstance(data, Record) else len(data)) == records
    if isinstance(data, Record):
        assert data.u.size == 80


@pytest.mark.parametrize("rows", [12, 40])
def test_branches_between_blank_lines_are_one_loop(tmp_path: Path, rows: int) -> None:
    """The second one begins a step after the end of the first, however long the steps are; curves that both rise are two."""
    angle = np.pi * np.arange(2 * rows) / rows
    field, moment = -np.cos(angle), -np.cos(angle - 0.3)
    up, down = (table(field[part], moment[part]) for part in (slice(rows), slice(rows, None)))
    loop = read_text(tmp_path, f"H (Oe),M (emu)\n{up}\n{down}")
    assert isinstance(loop, Record)
    np.testing.assert_allclose(loop.u, field, atol=1e-5)
    assert len(Dataset.of(read_text(tmp_path, f"H (Oe),M (emu)\n{up}\n{up.replace('0', '1')}"))) == 2


@pytest.mark.parametrize(("numbered", "records"), [(True, 1), (False, 5)])
def test_pages_of_a_print_of_numbered_samples_are_one_record(tmp_path: Path, numbered: bool, records: int) -> None:
    """A scan number that goes on over the heads of pages; without one, blank lines separate curves."""
    head = "\nSTRUCTURES LAB    PAGE\n\n" + "    SCAN" * numbered + "    DISPL.      LOAD    STRAIN\n"
    head += " " * 8 * numbered + "        MM        KN        UE\n\n"
    text = ""
    for k, (x, f) in enumerate(zip(X, F, strict=True)):
        text += head if k % 55 == 0 else ""
        text += f"{k + 1:8d}" * numbered + f"{x:10.3f}{f:10.2f}{6 * f:10.1f}\n"
    data = read_text(tmp_path, text, "a.prn")
    assert pair(data) == ("DISPL.", "LOAD")
    assert (1 if isinstance(data, Record) else len(data)) == records


@pytest.mark.parametrize("label", ["id", "joint"])
def test_sensors_that_take_turns_by_number_are_records(tmp_path: Path, label: str) -> None:
    rows = [
        f"{0.05 * k:.3f},{sensor},{x + sensor:.4f},{f:.4f}"
        for k, (x, f) in enumerate(zip(X, F, strict=True))
        for sensor in (0, 1)
    ]
    data = read_text(tmp_path, f"time,{label},position,torque\n" + "\n".join(rows) + "\n")
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == [f"{label}=0", f"{label}=1"]
    np.testing.assert_allclose(data[1].u - data[0].u, 1.0, atol=2e-4)
    assert data[0].t is not None


@pytest.mark.parametrize("key", ["data", "values", "rows"])
@pytest.mark.parametrize("nested", [False, True])
def test_rows_beside_the_names_of_their_columns(tmp_path: Path, key: str, nested: bool) -> None:
    """The answer of a data base of time series, with time stamps in text."""
    stamps = [f"2023-02-11T10:{k // 60:02d}:{k % 60:02d}Z" for k in range(ROWS)]
    rows = [list(row) for row in zip(stamps, X.tolist(), F.tolist(), strict=True)]
    series = {"name": "valve", "columns": ["time", "stroke_mm", "force_N"], key: rows}
    data = read_text(
        tmp_path, json.dumps({"results": [{"statement_id": 0, "series": [series]}]} if nested else series), "a.json"
    )
    assert isinstance(data, Record)
    np.testing.assert_array_equal(data.u, X)
    np.testing.assert_array_equal(data.y, F)
    assert data.t is not None
    np.testing.assert_array_equal(data.t, PLACE)


def test_time_stamps_in_arrays_of_text(tmp_path: Path) -> None:
    stamps = np.array([f"2023-02-11 10:{k // 60:02d}:{k % 60:02d}.5" for k in range(ROWS)])
    np.savez(tmp_path / "a.npz", time=stamps, stroke_mm=X, force_N=F)
    data = read(tmp_path / "a.npz")
    assert isinstance(data, Record)
    assert data.t is not None
    np.testing.assert_allclose(data.t, PLACE)


@pytest.mark.parametrize(
    "head", ["SpecimenA_kN,SpecimenB_kN", "Specimen_A,Specimen_B", "Sample1,Sample2", "Specimen A,Specimen B"]
)
def test_outputs_of_several_specimens_over_one_input(tmp_path: Path, head: str) -> None:
    data = read_text(tmp_path, f"Displacement_mm,{head}\n" + table(X, F, 2 * F))
    assert isinstance(data, Dataset)
    first = "Sample 1" if "Sample1" in head else "Specimen A"
    assert (len(data), data[0].name) == (2, first)
    np.testing.assert_allclose(data[1].y, 2 * data[0].y, rtol=1e-4)


@pytest.mark.parametrize("over", ["disp,disp,force,force", "disp,,force,"])
def test_statistics_below_the_names_of_their_columns(tmp_path: Path, over: str) -> None:
    """Columns of two lines of names, as pandas writes them: a mean and a deviation of each quantity."""
    data = read_text(tmp_path, f"{over}\nmean,std,mean,std\n" + table(X, 0 * X + 0.01, F, 0 * X + 0.1))
    assert pair(data) == ("disp mean", "force mean")


def test_names_with_the_number_of_a_cycle(tmp_path: Path) -> None:
    cycles = (1, 10, 100)
    head = ",".join(f"N={k} strain (%),N={k} stress (MPa)" for k in cycles)
    columns = list(itertools.chain.from_iterable((X, F / k) for k in cycles))
    data = read_text(tmp_path, head + "\n" + table(*columns))
    assert isinstance(data, Dataset)
    assert (pair(data), data[0].u_unit, data[0].y_unit) == (("strain", "stress"), "%", "MPa")
    assert [record.name for record in data] == ["N 1", "N 10", "N 100"]


@pytest.mark.parametrize(
    ("line", "used"), [("T=300 K,f=2 Hz", 0), ("Time:,10:20", 0), ("T=5 K moment,T=9 K moment", 1)]
)
def test_settings_above_the_numbers_are_no_names(line: str, used: int) -> None:
    assert read_header([line], 2, ",", ".", {})[2] == used


def test_the_joint_of_a_robot_that_moves_by_its_signals(tmp_path: Path) -> None:
    """Arrays of positions and torques, of which joint 2 moves."""
    moves = [X if k == 2 else 1e-3 * RNG.normal(size=ROWS) for k in range(4)]
    torques = [F if k == 2 else np.cos(PLACE / 30 + k) + 0.05 * RNG.normal(size=ROWS) for k in range(4)]
    head = ",".join(["time", *(f"q[{k}]" for k in range(4)), *(f"tau_J[{k}]" for k in range(4))])
    data = read_text(tmp_path, head + "\n" + table(PLACE * 0.01, *moves, *torques))
    assert pair(data) == ("q[2]", "tau_J[2]")


def test_a_set_value_without_unit_is_that_of_the_column_that_follows_it(tmp_path: Path) -> None:
    """A testing machine that writes its set value, and the displacement and force that it reaches."""
    steps = np.concatenate([np.linspace(0, 6, 60), np.linspace(6, -6, 120), np.linspace(-6, 0, 60)])
    force = sticking(steps, 30.0, 2.0)
    reached = steps + force / 400 + 1e-3 * RNG.normal(size=ROWS)
    head = "C_1_Temps[s];C_1_Force[kN];C_1_Valeur de consigne[];C_1_Déplacement[mm]\n"
    data = read_text(
        tmp_path, head + table(PLACE * 0.1, force + 0.05 * RNG.normal(size=ROWS), steps, reached, mark=";")
    )
    assert pair(data) == ("C_1_Déplacement[mm]", "C_1_Force[kN]")


def has_levels(data: Record | Dataset) -> bool:
    record = data if isinstance(data, Record) else data[0]
    return any(note.code is Code.CURVES for note in record.notes)


@pytest.mark.parametrize(("size", "warned"), [(80, False), (160, True)])
def test_a_number_of_each_cycle_is_no_further_input(tmp_path: Path, size: int, warned: bool) -> None:
    """A column that goes up by one with every cycle numbers them; one that holds for two cycles may be a setting."""
    x = np.tile(X, 2)
    number = np.arange(x.size) // size + 1
    data = read_text(
        tmp_path, "t (s),Zyklusnummer,x (mm),F (N)\n" + table(np.arange(x.size), number, x, sticking(x, 12.0, 0.8))
    )
    assert has_levels(data) is warned


def test_the_words_in_brackets_are_a_remark() -> None:
    assert column_quantity("Total Cycle Count(Linear|Digital Position)") == "index"
    assert column_quantity("Load(Linear|Missus) (N)") == "force"
    assert column_quantity("Laser(Displacement Sensor)") == "displacement"


def test_a_load_held_at_levels_is_a_further_input_beside_a_force(tmp_path: Path) -> None:
    """A tire at three vertical loads: its lateral force over its slip angle."""
    slip = np.tile(X, 3)
    load = np.repeat([220.0, 660.0, 1100.0], ROWS) + 4 * RNG.normal(size=3 * ROWS)
    lateral = load / 5 * sticking(slip, 12.0, 2.0) + 0.05 * RNG.normal(size=3 * ROWS)
    data = read_text(tmp_path, "SA (deg),FY (N),FZ (N)\n" + table(slip, lateral, load))
    assert pair(data) == ("SA (deg)", "FY (N)")
    assert has_levels(data)


def test_a_name_loses_the_brackets_of_a_factor_without_unit(tmp_path: Path) -> None:
    data = read_text(tmp_path, "sigma (MPa),eps_ax(1E-3)\n" + table(F, X))
    record = data if isinstance(data, Record) else data[0]
    assert record.u_name == "eps_ax"
    np.testing.assert_allclose(record.u, 1e-3 * X, atol=1e-8)


def test_one_array_of_several_columns_is_no_pair(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", B=np.stack([X, F, X * 0.5], axis=1))
    with pytest.raises(DataError):
        read(tmp_path / "a.npz")


@pytest.mark.parametrize("words", ['ZONE T="specimen {}"', "Run {}", "# loop {}"])
def test_lines_of_words_that_differ_in_their_numbers_begin_records(tmp_path: Path, words: str) -> None:
    """Zones of Tecplot, and runs below their numbers; one of these lines is a remark."""
    head = "Displacement (mm) Load (N)\n".replace(" (", "(")
    data = read_text(tmp_path, head + "".join(words.format(k) + "\n" + table(X, k * F, mark=" ") for k in (1, 2, 3)))
    assert isinstance(data, Dataset)
    assert [record.u.size for record in data] == [ROWS] * 3
    np.testing.assert_allclose(data[2].y, 3 * F, rtol=1e-4)


def test_steps_of_a_simulation_whose_numbers_have_prefixes_are_records(tmp_path: Path) -> None:
    """A waveform that a circuit simulator exports for each value of a parameter: its time begins again below a line of words."""
    u, text = np.sin(np.linspace(0, 4 * np.pi, ROWS)), "time\tV(h)\tV(b)\n"
    for k, value in enumerate(("400m", "1.2K", "5e-06", "2Meg"), start=1):
        text += f"Step Information: Ipk={value}  (Step: {k}/4)\n" + table(1e-3 * X, k * u, k * F, mark="\t")
    data = read_text(tmp_path, text)
    assert isinstance(data, Dataset)
    for k, record in enumerate(data, start=1):
        np.testing.assert_allclose(record.u, k * u, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(record.y, k * F, rtol=1e-4, atol=1e-5)


def test_a_remark_between_rows_begins_no_record(tmp_path: Path) -> None:
    text = "x(mm) F(N)\n" + table(X[:90], F[:90], mark=" ") + "valve 3 opened\n" + table(X[90:], F[90:], mark=" ")
    data = read_text(tmp_path, text)
    assert isinstance(data, Record)
    assert data.u.size == ROWS


def interval_of(data: Record | Dataset) -> float:
    record = data if isinstance(data, Record) else data[0]
    assert record.t is not None
    return float(np.median(np.diff(record.t)))


@pytest.mark.parametrize(
    ("key", "value"), [("fs", 50), ("sample_rate_hz", 50), ("dt", 0.02), ("dt_ms", 20), ("SampleFrequency", 50.0)]
)
def test_the_rate_beside_arrays_gives_the_time(tmp_path: Path, key: str, value: float) -> None:
    channels = [
        {"name": "stroke", "unit": "mm", "data": X.tolist()},
        {"name": "force", "unit": "N", "data": F.tolist()},
    ]
    assert interval_of(read_text(tmp_path, json.dumps({key: value, "channels": channels}), "a.json")) == pytest.approx(
        0.02
    )
    np.savez(tmp_path / "a.npz", stroke=X, force=F, **{key: np.array(value)})
    assert interval_of(read(tmp_path / "a.npz")) == pytest.approx(0.02)


def test_the_names_of_columns_in_an_attribute(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        data = file.create_dataset("data", data=np.column_stack([PLACE * 0.02, X, F]))
        data.attrs["columns"] = ["time_s", "stroke_mm", "load_N"]
    record = read(tmp_path / "a.h5")
    assert isinstance(record, Record)
    assert (*pair(record), record.u_unit, record.y_unit) == ("data/stroke_mm", "data/load_N", "mm", "N")
    np.testing.assert_array_equal(record.y, F)


@pytest.mark.parametrize("stamped", [True, False])
def test_groups_with_a_clock_and_a_signal_each(tmp_path: Path, stamped: bool) -> None:
    """Signals of a control loop that are logged at times of their own: each value holds until the next one."""
    h5py = pytest.importorskip("h5py")
    seconds = {"OP": PLACE, "PV": PLACE[::2]}
    stamps = lambda at: [f"2017-10-06 12:{k // 60:02d}:{k % 60:02d}.5".encode() for k in at]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, at in seconds.items():
            group = file.create_group(name)
            group["Time"] = stamps(at) if stamped else at.astype(float)
            group["Values"] = (X if name == "OP" else F)[at]
            group["Quality"] = np.full(at.size, 192)
    record = read(tmp_path / "a.h5")
    assert isinstance(record, Record)
    assert pair(record) == ("OP", "PV")
    np.testing.assert_array_equal(record.u, X)
    np.testing.assert_array_equal(record.y, np.repeat(F[::2], 2))
    assert record.t is not None
    np.testing.assert_allclose(record.t - record.t[0], PLACE)


FIELD = np.linspace(10_000.0, -10_000.0, 101)
FALLING = 1.8 * np.tanh((FIELD + 320) / 900)


def sections(starts: tuple[float, ...], scale: tuple[float, ...]) -> str:
    """Sections of a vibrating sample magnetometer: the field down in one and up in the next, from these times on."""
    columns = "Time since start, Time [s]", "Applied Field, Applied Field [Oe]", "Signal X direction, Moment [memu]"
    text = "@@Columns\n" + "".join(f"Column {k}: {name}\n" for k, name in enumerate(columns))
    text += "@@END Columns\n@@End of Header.\n@@Data\n"
    for k, (start, factor) in enumerate(zip(starts, scale, strict=True)):
        time, sign = start + 2.0 * np.arange(FIELD.size), (-1) ** k
        text += f"New Section: Section {k % 2}:\n" + table(time, sign * FIELD, sign * factor * FALLING, mark=" ")
    return text + "@@END Data.\n"


def test_branches_after_a_short_pause_are_one_loop(tmp_path: Path) -> None:
    data = read_text(tmp_path, sections((1.0, 207.0), (1.0, 1.0)), "loop.VHD")
    assert isinstance(data, Record)
    np.testing.assert_allclose(data.u, np.r_[FIELD, -FIELD])
    np.testing.assert_allclose(data.y, np.r_[FALLING, -FALLING], rtol=1e-5)
    assert data.t is not None
    assert data.t[101] - data.t[100] == 6.0


def test_loops_of_two_sections_are_told_apart_where_the_clock_starts_again(tmp_path: Path) -> None:
    data = read_text(tmp_path, sections((1.0, 207.0, 1.0, 207.0), (1.0, 1.0, 1.02, 1.02)), "loops.VHD")
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == ["loop=0", "loop=1"]
    for record, factor in zip(data, (1.0, 1.02), strict=True):
        np.testing.assert_allclose(record.u, np.r_[FIELD, -FIELD])
        np.testing.assert_allclose(record.y, factor * np.r_[FALLING, -FALLING], rtol=1e-5)


@pytest.mark.parametrize(("second", "names"), [(40.0, ["Sample=20", "Sample=40"]), (20.1, ["a"])])
def test_isotherms_at_two_temperatures_are_two_loops(tmp_path: Path, second: float, names: list[str]) -> None:
    """A sorption balance writes a table of each scan, of which the first sample has not settled."""
    pressure, text = np.linspace(0, 2700, 30), ""
    for number, warm in enumerate((20.0, second)):
        adsorbed = 2 * pressure / (pressure + 1500)
        for course, order, wet in (("Sorption", 1, 0.0), ("Desorption", -1, 0.25)):
            amount = adsorbed + (wet - 0.05 * number) * np.sin(np.pi * pressure / 2700)
            rows = zip(pressure[::order], amount[::order], strict=True)
            text += f"\nExperiment No   {number + 1}\nCourse          {course}\n\n"
            text += (
                "Pressure   Excess       Sample\n           Adsorption         \n(mbar)     (mmol/g)     (°C)\n"
                + "-" * 30
                + "\n"
            )
            text += "".join(f"{p:<11.1f}{q:<13.4f}{warm + 7 * (k == 0):<6.2f}\n" for k, (p, q) in enumerate(rows))
            text += "-" * 30 + "\n"
    data = read_text(tmp_path, text, "a.txt")
    assert [record.name for record in Dataset.of(data)] == names
    assert {record.u.size for record in Dataset.of(data)} == {120 // len(names)}
    assert pair(data) == ("Pressure (mbar)", "Excess Adsorption (mmol/g)")
    assert not any("Adsorption" in value for record in Dataset.of(data) for value in record.metadata.values())


def test_tables_are_named_by_what_was_set_and_not_by_what_was_measured(tmp_path: Path) -> None:
    """A core at three inductions: the loss that a tester computes stands below the setting."""
    parts = []
    for level in (0.1, 0.2, 0.3):
        table = "\n".join(f"{level * u:.4f}\t{level * y:.5f}" for u, y in zip(U, Y, strict=True))
        loss = f"{8361.2 * level**2.4:.3f}"
        parts.append(f"Bm = {level} T\nf = 50 kHz\nPcv = {loss} kW/m3\nH(A/m)\tB(T)\n{table}\n\n")
    data = read(written(tmp_path, "".join(parts), "core.txt"))
    assert [record.name for record in data] == ["Bm = 0.1 T", "Bm = 0.2 T", "Bm = 0.3 T"]
