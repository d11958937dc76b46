"""Files of friction rigs, drives, dampers and actuators: names and units of their own, references that are followed, and further inputs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Record
from hystfit.data.dataset import Dataset
from hystfit.errors import DataError
from hystfit.outcome import Severity
from hystfit.params.units import Scales, loop_energy, quantity
from hystfit.reading import read
from hystfit.reading.names.column_names import column_quantity
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.held_levels import held_labels, held_levels
from hystfit.results.measured.loop_kinds import LoopKind
from hystfit.results.measured.loop_values import quantities
from hystfit.results.measured.steady_loops import Excitation

T = np.arange(400) * 0.01
X = 5 * np.sin(2 * np.pi * 0.5 * T)
RNG = np.random.default_rng(3)


def friction(x: np.ndarray, force: float, gap: float) -> np.ndarray:
    """A force that turns over a distance, after every reversal of a displacement."""
    z = np.zeros(x.size)
    for k in range(1, x.size):
        z[k] = np.clip(z[k - 1] + force * (x[k] - x[k - 1]) / gap, -force, force)
    return z


F = friction(X, 12.0, 0.8) + RNG.normal(0, 0.02, X.size)


def read_table(folder: Path, head: str, *columns: object, mark: str = ",", name: str = "rig.csv") -> Record | Dataset:
    path = folder / name
    rows = (mark.join(f"{v:.9g}" for v in row) for row in zip(*columns, strict=True))
    path.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
    return read(path)


def pair(data: Record | Dataset) -> tuple[str, str]:
    record = data if isinstance(data, Record) else data[0]
    return record.u_name, record.y_name


def test_a_word_before_a_unit_is_no_inch(tmp_path: Path) -> None:
    assert split_unit("Laser (in mm)") == ("Laser", "mm")
    assert quantity(split_unit("Torque (in lb)")[1]) == "force"  # an inch and a pound
    head = "Time (in ms),Laser (in V),Pressure (in V),Laser (in mm),Pressure (in bar)\n"
    laser, pressure = 6 + X + 0.3 * F / 12, 0.8 + 0.15 * X
    record = read_table(tmp_path, head, 1000 * T, 0.4 * laser, 2 * pressure, laser, pressure)
    assert isinstance(record, Record)
    assert (*pair(record), record.u_unit, record.y_unit) == ("Pressure (in bar)", "Laser (in mm)", "bar", "mm")
    assert record.t_unit == "ms"


def test_a_name_that_ends_like_a_unit_is_none() -> None:
    assert split_unit("sstrain") == ("sstrain", "")
    assert quantity("microstrain") == quantity("ustrain") == "strain"


def test_a_time_that_starts_again_with_every_block_of_rows(tmp_path: Path) -> None:
    """Steps of a tribometer: T in seconds, each with its own head and zero."""
    path = tmp_path / "run.csv"
    head = "Step No. {}\n\nSet Force = -1000\nData Count = {}\n\nFx,Fz,Y,T\ng,g,mm,sec\n\n"
    text = "Created by a viewer\nTotal number of steps = 2\n"
    for step, rows in enumerate((slice(0, 100), slice(100, 400)), start=1):
        text += head.format(step, rows.stop - rows.start)
        text += "".join(
            f"{f:.4f},{-1000 + f / 50:.3f},{x:.4f},{t:.3f}\n"
            for f, x, t in zip(F[rows], X[rows], T[rows] - T[rows.start], strict=True)
        )
        text += "\n\n"
    path.write_text(text)
    data = read(path)
    assert isinstance(data, Dataset)
    assert pair(data) == ("Y", "Fx")
    for record, rows in zip(data, (slice(0, 100), slice(100, 400)), strict=True):
        assert record.t is not None
        np.testing.assert_allclose(record.t - record.t[0], T[rows] - T[rows.start], atol=1e-9)


@pytest.mark.parametrize("mark", ["\t", ",", ";"])
def test_channels_of_twincat_scope(mark: str, tmp_path: Path) -> None:
    """A column of time before each group, properties of every channel in rows, and a channel of another sampling interval."""
    keys = {
        "Name": ["torque", "angle", "slow"], "SymbolComment": ["", "", ""], "Data-Type": ["REAL64"] * 3,
        "SampleTime[ms]": ["10", "10", "50"], "BitMask": ["0xff"] * 3, "Unit": ["Nm (Torque)", "deg (Angle)", "(None)"],
    }  # fmt: skip
    lines = [f"Name{mark}project", f"File{mark}run.csv", f"Starttime of export{mark}132959733843760000", "", ""]
    lines += [mark.join([key, *cells[:2], key, cells[2]]) for key, cells in keys.items()] + [""]
    for k, (t, f, x) in enumerate(zip(T, F, X, strict=True)):
        row = [f"{1000 * t:g}", f"{f:.5f}", f"{x:.5f}"]
        lines.append(mark.join([*row, f"{50 * k}", "1"] if k < 80 else row))
    path = tmp_path / "scope.csv"
    path.write_text("\n".join(lines) + "\n")
    record = read(path)
    assert isinstance(record, Record)
    assert (*pair(record), record.u_unit, record.y_unit) == ("angle [deg]", "torque [Nm]", "deg", "Nm")
    assert record.t is not None
    assert record.t_unit == "ms"
    np.testing.assert_allclose(record.t, 1000 * T, atol=1e-9)
    np.testing.assert_allclose(record.u, X, atol=1e-5)
    assert any("slow" in note.text for note in record.notes if note.severity is Severity.WARNING)


def test_without_names_the_column_that_goes_by_even_steps_drives(tmp_path: Path) -> None:
    """The recorder of a section: pseudo time, strain, curvature, a constant force and a moment. Which of two answers is meant is asked."""
    levels = [0.2, -0.2, 0.5, -0.5, 1.0, -1.0, 0.0]
    ends = zip([0.0, *levels], levels, strict=False)
    curvature = np.concatenate([np.linspace(a, b, 41)[1:] for a, b in ends]) * 1e-4
    moment, strain = (
        friction(curvature, 3e8, 4e-5),
        -2e-4 + 0.4 * np.abs(curvature) + RNG.normal(0, 1e-7, curvature.size),
    )
    columns = (np.arange(1.0, curvature.size + 1), strain, curvature, np.full(curvature.size, -8e5), moment)
    with pytest.raises(DataError, match=r"--input 2 .*--input 2 "):
        read_table(tmp_path, "", *columns, mark=" ", name="section.out")


def test_units_of_a_system_belong_to_the_columns_of_their_quantities(tmp_path: Path) -> None:
    """What was measured drives, beside what was targeted."""
    head = "# units: in, kip, sec\n# step targDisp measDisp measForce\n"
    reached = X + RNG.normal(0, 0.004, X.size)
    record = read_table(tmp_path, head, np.arange(1.0, 401), X, reached, F, mark=" ", name="ctrl.out")
    assert isinstance(record, Record)
    assert (*pair(record), record.u_unit, record.y_unit) == ("measDisp", "measForce", "in", "kip")


def test_a_voltage_in_millivolts_is_that_of_a_sensor(tmp_path: Path) -> None:
    signal = 1200 + 40 * X + 2 * F
    assert pair(read_table(tmp_path, "t_s,imu_angle_deg,band_mV\n", T, 9 * X, signal)) == ("imu_angle_deg", "band_mV")
    assert pair(read_table(tmp_path, "t_s,drive_mV,x_um\n", T, 9 * X, signal)) == ("drive_mV", "x_um")
    assert pair(read_table(tmp_path, "t_s,V,x_um\n", T, 9 * X, signal)) == ("V", "x_um")


def test_a_reference_that_is_followed_is_no_input(tmp_path: Path) -> None:
    """The effort of a controller is read over the position, not the speed over the reference."""
    angle = X / 8
    speed, effort = np.gradient(angle, T), friction(angle, 2.0, 0.05) + RNG.normal(0, 0.01, X.size)
    columns = (T, angle, angle + RNG.normal(0, 2e-4, X.size), speed + RNG.normal(0, 2e-3, X.size), effort)
    assert pair(read_table(tmp_path, "time,ref,theta,omega,u\n", *columns)) == ("theta", "u")


def test_a_temperature_that_explains_the_stroke_is_the_input_beside_the_current_of_a_heater(tmp_path: Path) -> None:
    t = np.arange(1200) * 0.1
    current = 0.45 * (np.sin(2 * np.pi * t / 30) > 0) * (0.6 + 0.4 * np.sin(2 * np.pi * t / 120))
    warm = np.full(t.size, 24.0)
    for k in range(1, t.size):
        warm[k] = warm[k - 1] + 0.1 * (68 * current[k] ** 2 - (warm[k - 1] - 24) / 7)
    stroke = 2.5 + 2.5 * np.tanh((warm - 60 - friction(warm, 6.0, 6.0)) / 12)
    ohm = 3 + 0.001 * warm + RNG.normal(0, 0.003, t.size)
    columns = (t, current, current * ohm, warm + RNG.normal(0, 0.1, t.size), stroke)
    assert pair(read_table(tmp_path, "Time [s],I [A],U [V],Temp [C],Disp [mm]\n", *columns)) == (
        "Temp [C]",
        "Disp [mm]",
    )


def test_a_moment_over_a_curvature_is_driven_by_a_displacement(tmp_path: Path) -> None:
    assert column_quantity("κ [1/m]", "1/m") == column_quantity("K(cm-1)", "cm-1") == "displacement"
    assert column_quantity("γ(t) [-]") == "strain"
    assert loop_energy("1/m", "Nm") == ("J/m", 1.0)
    record = read_table(tmp_path, "κ [1/m],M [Nm],T [kN]\n", X, F, 20 + 0.01 * X)
    assert LoopKind.of(Dataset.of(record)) is LoopKind.DISPLACEMENT_DRIVEN
    stiffness = next(one for values in quantities(record).rows.values() for one in values if "stiffness" in one.name)
    assert (stiffness.unit, Scales(u_unit="1/m", y_unit="Nm").label("y/u")) == ("Nm/(1/m)", "Nm/(1/m)")


def test_a_force_per_length_has_a_stiffness(tmp_path: Path) -> None:
    record = read_table(tmp_path, "y (mm),p (kN/m)\n", X, F)
    assert LoopKind.of(Dataset.of(record)) is LoopKind.DISPLACEMENT_DRIVEN


@pytest.mark.parametrize("measured", [False, True])
def test_levels_of_a_measured_condition_are_a_further_input(measured: bool, tmp_path: Path) -> None:
    """A current that follows random set values, and prestresses in turn; not a temperature that rises by its last digit."""
    n = 3000
    t = np.arange(n) * 0.005
    x = np.convolve(RNG.normal(0, 1, n + 200), np.hanning(90), "same")[100:-100]
    level = np.repeat(np.array([0.5, 1, 0, 0.5, 0, 1, 0.5, 0, 1, 0.5]), n // 10)
    current = level.copy()
    for k in range(1, n if measured else 1):
        current[k] = current[k - 1] + 0.12 * (level[k] - current[k - 1])
    current += measured * RNG.normal(0, 0.003, n)
    force = (90 + 600 * current) * np.tanh(np.gradient(x, t) / 30) + RNG.normal(0, 5, n)
    data = read_table(tmp_path, "t_s,x_mm,F_N,I_A,T_degC\n", t, x, force, current, np.round(24 + 0.02 * t, 1))
    notes = [note for record in Dataset.of(data) for note in record.notes if note.severity is Severity.WARNING]
    assert any("'I_A'" in note.text for note in notes)
    assert not any("'T_degC'" in note.text for note in notes)


def test_a_current_that_is_held_at_one_level_after_the_other_divides_a_record(tmp_path: Path) -> None:
    """That of a damper, of which the force tells it: the largest force of each cycle is that of its current."""
    t = 0.002 * np.arange(6000)
    current = np.repeat([0.0, 0.4, 0.8, 1.2], 1500) + RNG.normal(0, 0.003, t.size)
    x, v = 15 * np.sin(4 * np.pi * t), 60 * np.pi * np.cos(4 * np.pi * t)
    force = (80 + 700 * current) * np.tanh(v / 25 + x / 40) + 0.6 * v + RNG.normal(0, 4, t.size)
    names = "t_s,x_mm,F_N,I_A\n"
    (note,) = (note for note in Dataset.of(read_table(tmp_path, names, t, x, force, current))[0].notes if note.option)
    assert note.option == ("by", "I_A")
    data = Dataset.of(read(tmp_path / "rig.csv", by="I_A"))
    assert [record.name for record in data] == ["I=0", "I=0.4", "I=0.8", "I=1.2"]


@pytest.mark.parametrize(
    "levels", [[1.8, 4.2, 300], [2, 5, 10, 20, 50, 100, 300], [300, 77, 2, 1.8], [2, 290, 300], range(100, 301, 20)]
)
def test_temperatures_over_decades_are_levels_of_their_own(levels: Sequence[float]) -> None:
    """Those of a cryostat: 2 and 5 K are as far apart as 200 and 500 K are."""
    values = np.repeat(np.array(levels), 180) * (1 + RNG.normal(0, 3e-4, 180 * len(levels)))
    labels = held_labels(values)
    assert labels is not None
    assert labels.tolist() == np.repeat([f"{level:g}" for level in levels], 180).tolist()


def test_ramps_between_temperatures_are_no_levels() -> None:
    """The last rows of a ramp are within a fiftieth of the temperature that it goes to."""
    held = [np.repeat(level, 120) for level in (300.0, 50, 5)]
    ramp = lambda first, last: np.geomspace(first, last, 40)[1:-1]
    values = np.concatenate([held[0], ramp(300, 50), held[1], ramp(50, 5), held[2]])
    labels = held_labels(values)
    assert labels is not None
    assert {level: np.ptp(values[labels == level]) / float(level) < 0.04 for level in labels if level} == dict.fromkeys(
        ["300", "50", "5"], True
    )
    assert np.count_nonzero(labels == "") > 68


@pytest.mark.parametrize("noise", [0.003, 0.01, 0.02])
def test_levels_of_a_load_are_held_through_the_noise_of_its_control(noise: float) -> None:
    """Noise as a part of the distance from the least load to the largest."""
    loads = np.repeat([-220.0, -660, -1100], 400)
    found = held_levels(loads + 880 * noise * RNG.normal(size=loads.size))
    np.testing.assert_allclose([level for level, _, _ in found], [-1100, -660, -220], atol=10)
    np.testing.assert_allclose(
        [(first, stop) for _, first, stop in found], [(800, 1200), (400, 800), (0, 400)], atol=25
    )


def test_held_levels_of_signals() -> None:
    steps = np.repeat([-49.0, -35, -21, -7], 300) + RNG.normal(0, 0.02, 1200)
    found = held_levels(steps)
    np.testing.assert_allclose([level for level, _, _ in found], [-49, -35, -21, -7], atol=0.01)
    assert [(first, stop) for _, first, stop in found] == [(0, 300), (300, 600), (600, 900), (900, 1200)]
    t = np.linspace(0, 20, 4000)
    for other in (np.sin(t), np.abs((t % 2) - 1), t, RNG.normal(0, 1, t.size), np.full(t.size, 3.0)):
        assert held_levels(other) == []


def test_the_cycle_of_records_with_one_cycle_each_lasts_as_long_as_theirs() -> None:
    """Stored cycles of a testing machine begin in the middle, and a stroke to the end and back is one too."""
    t = np.arange(50) * 0.002
    stored = [
        Record(u=np.sin(2 * np.pi * 10 * t), y=np.cos(2 * np.pi * 10 * t), t=t + start, name=f"{start}")
        for start in (0, 5)
    ]
    excitation = Excitation.of(Dataset.of(stored))
    assert excitation.points * excitation.interval == pytest.approx(0.1, rel=0.03)
    assert excitation.sine
    stroke = np.concatenate([np.linspace(0, 1, 101), np.linspace(1, 0, 101)[1:]])
    once = Excitation.of(Dataset.of(Record(u=stroke, y=stroke, t=np.arange(201) * 0.01)))
    assert once.points * once.interval == pytest.approx(2.0, rel=0.03)
    assert not once.sine


def test_tables_are_named_by_the_settings_above_them(tmp_path: Path) -> None:
    """Loops of a rubber mount: a line with frequency and amplitude above each, which differs from table to table."""
    text = "# Rubber mount M12, preload 500 N\n"
    names = [f"Frequency: {f} Hz, Amplitude: {a} mm" for f in (1, 5) for a in (0.2, 0.5)]
    for k, name in enumerate(names):
        rows = (f"{t:.3f}\t{(k + 1) * x:.4f}\t{(k + 2) * y:.4f}" for t, x, y in zip(T, X, F, strict=True))
        text += f"# {name}\nTime [s]\tDisplacement [mm]\tForce [N]\n" + "\n".join(rows) + "\n\n"
    (tmp_path / "mount.txt").write_text(text)
    data = read(tmp_path / "mount.txt")
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == names
    chosen = read(tmp_path / "mount.txt", only=names[1])
    (record,) = Dataset.of(chosen)
    np.testing.assert_allclose(record.u, 2 * X, atol=1e-4)


def test_torques_of_both_directions_of_a_speed_are_a_curve_and_no_loop(tmp_path: Path) -> None:
    """A Stribeck table states the size of the speed; what goes up and down with it is a loop."""
    speed = np.array([1.0, 2, 5, 10, 20, 40, 60, 100, 150, 200, 300, 400])
    forth, back = 2.1 + 1.3 * np.exp(-speed / 18), -2.2 - 1.2 * np.exp(-speed / 18)
    record = read_table(tmp_path, "Speed (rpm),Torque pos (Nm),Torque neg (Nm)\n", speed, forth, back)
    assert isinstance(record, Record)
    np.testing.assert_allclose(record.u, np.concatenate([-speed[::-1], speed]))
    np.testing.assert_allclose(record.y, np.concatenate([back[::-1], forth]))
    loop = read_table(tmp_path, "Speed (rpm),Torque up (Nm),Torque down (Nm)\n", speed, forth, forth + 0.1)
    assert isinstance(loop, Record)
    np.testing.assert_allclose(loop.u, np.concatenate([speed, speed[::-1]]))


def test_the_question_about_columns_without_names_begins_with_the_pair_that_belongs_together(tmp_path: Path) -> None:
    """Regulated pressure, stroke and friction of a cylinder: the stroke and its direction explain the force, but not the pressure."""
    count = 600
    stroke = np.round(39 - 39 * np.cos(np.linspace(0, 8 * np.pi, count)), 3)
    noise = np.random.default_rng(5).normal(size=(2, count))
    pressure = np.round(1.02 + 0.003 * noise[0], 3)
    force = np.round(49 + 6 * np.sign(np.gradient(stroke)) + 0.05 * stroke + 0.05 * noise[1], 3)
    path = tmp_path / "friction.txt"
    np.savetxt(path, np.column_stack([pressure, stroke, force]), fmt="%.3f", delimiter="\t")
    with pytest.raises(DataError, match="choose, such as --input 1 --output 2 or --input 2 --output 1"):
        read(path)


@pytest.mark.parametrize(
    ("u", "y", "unit"),
    [
        ("Volts", "Volts", "V^2"),
        ("Amps", "pounds", "lbf A"),
        ("V", "um", "um V"),
        ("V vs. Ref.", "mA", "mA V"),
        ("Kelvin", "Degrees", "deg K"),
        ("V", "", ""),
        ("kN", "mV/V", "mV/V kN"),  # a calibration: the signal of a bridge is no strain
    ],
)
def test_the_unit_of_an_area_has_symbols(u: str, y: str, unit: str) -> None:
    assert loop_energy(u, y) == (unit, 1.0)
