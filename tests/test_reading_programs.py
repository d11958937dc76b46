"""Files that programs write (logs, source text, HTML, XML, structures), headers that a line ends, and groups of columns side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from hystfit.data import Dataset, Record
from hystfit.errors import DataError
from hystfit.outcome import Code, Severity
from hystfit.reading import read
from hystfit.reading.text.stated_interval import stated_interval

N = 80
T = np.round(0.05 * np.arange(N), 2)
U = np.round(20 * np.sin(np.arange(N) / 6.0), 3)
Y = np.round(U - 0.4 * np.gradient(U), 3)


def written(folder: Path, content: str, name: str = "loop.txt") -> Path:
    path = folder / name
    path.write_text(content, encoding="utf-8")
    return path


def one(path: Path, **options: object) -> Record:
    data = read(path, **options)  # type: ignore[arg-type]
    assert isinstance(data, Record), [record.name for record in data]
    return data


def is_pair(record: Record, u: np.ndarray = U, y: np.ndarray = Y, units: tuple[str, str] | None = None) -> None:
    np.testing.assert_array_equal(record.u, u)
    np.testing.assert_array_equal(record.y, y)
    if units is not None:
        assert (record.u_unit, record.y_unit) == units


def rows(mark: str, *columns: np.ndarray) -> str:
    return "".join(mark.join(map(str, row)) + "\n" for row in zip(*columns, strict=True))


# Logs of names and numbers ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "units"),
    [
        ("t={} disp={} force={}\n", ("", "")),
        ("t: {} s, disp: {} mm, force: {} kN\n", ("mm", "kN")),
        ("INFO loop: t={};disp={}mm;force={}kN\n", ("mm", "kN")),
        ("t={}\ndisp={}\nforce={}\n", ("", "")),
    ],
)
def test_logs_of_names_and_numbers(line: str, units: tuple[str, str], tmp_path: Path) -> None:
    content = "".join(line.format(*row) for row in zip(T, U, Y, strict=True))
    record = one(written(tmp_path, content, "run.log"))
    is_pair(record, units=units)
    np.testing.assert_allclose(record.t, T)


def test_a_log_keeps_the_stamps_of_its_lines_and_names_the_lines_left_out(tmp_path: Path) -> None:
    lines = [f"2024-03-01 10:00:{t:06.3f} V={u} x={y}" for t, u, y in zip(T, U, Y, strict=True)]
    is_pair(stamped := one(written(tmp_path, "\n".join(lines))))
    np.testing.assert_allclose(stamped.t, T, atol=1e-9)
    short = one(written(tmp_path, "\n".join([*lines[:40], "restart", *lines[40:]]), "b.txt"))
    is_pair(short)
    assert any("1 lines without" in note.text for note in short.notes if note.code is Code.LEFT_OUT)


def test_settings_above_a_table_are_no_log(tmp_path: Path) -> None:
    settings = "".join(f"setting{k} = {k}.5\n" for k in range(30))
    is_pair(one(written(tmp_path, settings + "\ndisp_mm,force_kN\n" + rows(",", U, Y))), units=("mm", "kN"))


# Arrays in the text of programs -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "form",
    ["{} = [{}];\n", "{} = np.array([{}])\n", "static double {}[80] = {{{}}};\n", "{} <- c({})\n"],
)
def test_arrays_in_the_text_of_programs(form: str, tmp_path: Path) -> None:
    content = "".join(form.format(name, ", ".join(map(str, v))) for name, v in (("disp", U), ("force", Y)))
    is_pair(one(written(tmp_path, content)))


def test_matrices_of_matlab_and_lists_of_yaml(tmp_path: Path) -> None:
    is_pair(one(written(tmp_path, "data = [\n" + rows(" ", U, Y).replace("\n", ";\n") + "];\n")))
    is_pair(one(written(tmp_path, "data = [[" + rows(", ", U, Y).strip().replace("\n", "], [") + "]]\n", "b.py")))
    lists = "".join(
        f"{name}:\n" + "".join(f"  - {v}\n" for v in values) for name, values in (("disp", U), ("force", Y))
    )
    is_pair(one(written(tmp_path, lists, "c.yaml")))


# Markup -------------------------------------------------------------------------------------------------------------------------


def test_tables_in_html(tmp_path: Path) -> None:
    row = lambda tag, cells: "<tr>" + "".join(f"<{tag}>{cell}</{tag}>" for cell in cells) + "</tr>\n"
    body = row("th", ["Time (s)", "Disp (mm)", "Force (kN)"]) + "".join(row("td", r) for r in zip(T, U, Y, strict=True))
    is_pair(one(written(tmp_path, f"<html><table>{body}</table></html>", "export.xls")), units=("mm", "kN"))
    with pytest.raises(DataError, match="web page without a table"):
        read(written(tmp_path, "<!DOCTYPE html><html><body>Not found</body></html>", "raw.csv"))


@pytest.mark.parametrize(
    "row",
    [
        '<p t="{}" disp="{}" force="{}"/>',
        "<row><t>{}</t><disp>{}</disp><force>{}</force></row>",
        "<r><t><value>{}</value></t><disp><value>{}</value></disp><force><value>{}</value></force></r>",
    ],
)
def test_rows_of_xml(row: str, tmp_path: Path) -> None:
    body = "".join(row.format(*cells) for cells in zip(T, U, Y, strict=True))
    record = one(
        written(tmp_path, f'<?xml version="1.0"?>\n<test xmlns="urn:x"><info><date>1</date></info>{body}</test>')
    )
    is_pair(record)
    np.testing.assert_allclose(record.t, T)


def test_xml_is_read_without_definitions(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="definitions"):
        read(written(tmp_path, '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "1">]><a><p x="1" y="&b;"/></a>'))
    with pytest.raises(DataError, match="begins as XML"):
        read(written(tmp_path, "<?xml version='1.0'?><a><b></a>"))


# Structures ---------------------------------------------------------------------------------------------------------------------


def test_structures_of_matlab(tmp_path: Path) -> None:
    fields = {"t": T, "disp": U, "force": Y}
    channel = lambda name, unit: {"Name": name, "Unit": unit, "Data": fields[name]}
    scipy.io.savemat(tmp_path / "nested.mat", {"test": {"info": {"by": "x"}, "data": fields}})
    scipy.io.savemat(tmp_path / "several.mat", {"tests": np.array([fields, fields | {"force": 2 * Y}], dtype=object)})
    channels = {"X": channel("t", "s"), "Y": np.array([channel("disp", "mm"), channel("force", "kN")], dtype=object)}
    scipy.io.savemat(tmp_path / "capture.mat", {"capture": channels})
    nested = one(tmp_path / "nested.mat")
    is_pair(nested)
    np.testing.assert_array_equal(nested.t, T)
    several = Dataset.of(read(tmp_path / "several.mat"))
    is_pair(several[0])
    is_pair(several[1], y=2 * Y)
    is_pair(one(tmp_path / "capture.mat"), units=("mm", "kN"))


def test_sheets_of_the_same_columns_are_records(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["Project", "walls"])
    for title, scale in (("W1", 1.0), ("W2", 2.0)):
        page = book.create_sheet(title)
        for row in (["Disp (mm)", "Force (kN)"], *zip(U.tolist(), (scale * Y).tolist(), strict=True)):
            page.append([*row])
    book.save(tmp_path / "walls.xlsx")
    data = Dataset.of(read(tmp_path / "walls.xlsx"))
    assert [record.name for record in data] == ["W1", "W2"]
    is_pair(data[0])
    is_pair(data[1], y=2 * Y)
    is_pair(one(tmp_path / "walls.xlsx", sheet="W2"), y=2 * Y)


# Headers ------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "header",
    [
        "Samples\t80\t80\nX0\t0\t0\nDelta_X\t0.05\t0.05\n***End_of_Header***\nDisp (mm)\tForce (kN)\n",
        "Sampling rate: 20 Hz\nDisp (mm)   Force (kN)\n***DATA***\n",
        "# SAMPLE_TIME = 0.05\n# NAME0 = Disp (mm)\n# NAME1 = Force (kN)\n# END_HEADER\n",
        "@relation loop\n@attribute 'Disp (mm)' numeric\n@attribute 'Force (kN)' real\n@data\n",
        "Column 00: Disp [mm]\nColumn 01: Force [kN]\n@@Data\n",
        "Disp\tForce\nunit_string\tmm\tkN\n",
    ],
)
def test_headers_that_a_line_ends(header: str, tmp_path: Path) -> None:
    record = one(written(tmp_path, header + rows("\t", U, Y)))
    is_pair(record, units=("mm", "kN"))
    if "0.05" in header or "20 Hz" in header:
        np.testing.assert_allclose(record.t, T)
        assert one(written(tmp_path, header + rows("\t", U, Y)), time=False).t is None


@pytest.mark.parametrize(
    ("line", "interval"),
    [
        ("Sampling rate: 20 kHz", 5e-5),
        ("Sample Rate (Hz),1000", 1e-3),
        ("# dt = 0.01 s", 0.01),
        ("Abtastintervall [ms];5", 0.005),
        ("Delta_X\t0,001\t0,001", 0.001),
        ("Delta_X\t0.001\t0.002", None),
        ("Scan rate 20 mV/s", None),
        ("Sample Interval (V) = 0.005", None),
        ("Sample time: 2019-03-02", None),
        ("Recording time: 30 s", None),
    ],
)
def test_stated_intervals(line: str, interval: float | None) -> None:
    assert stated_interval([line]) == (None if interval is None else pytest.approx(interval, rel=1e-12))


def test_two_different_intervals_tell_nothing() -> None:
    assert stated_interval(["Sample rate: 10 Hz", "Sample rate: 20 Hz"]) is None


# Groups of columns --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("clock", [False, True])
@pytest.mark.parametrize("gap", [False, True])
def test_specimens_side_by_side_have_the_names_above_them(clock: bool, gap: bool, tmp_path: Path) -> None:
    group = [*(["t (s)"] if clock else []), "Disp (mm)", "Force (kN)", *([""] if gap else [])]
    over = [["W1", *[""] * (len(group) - 1)], ["W2", *[""] * (len(group) - 1)]]
    lines = [",".join(over[0] + over[1]), ",".join(group * 2)]
    for k in range(N):
        cells = [[*([T[k]] if clock else []), U[k], scale * Y[k], *([""] if gap else [])] for scale in (1, 2)]
        cells[1] = cells[1] if k < 60 else [""] * len(group)
        lines.append(",".join(map(str, cells[0] + cells[1])))
    data = Dataset.of(read(written(tmp_path, "\n".join(lines))))
    assert [record.name for record in data] == ["W1", "W2"]
    is_pair(data[0], units=("mm", "kN"))
    is_pair(data[1], u=U[:60], y=2 * Y[:60])
    assert (data[0].t is not None) == clock


@pytest.mark.parametrize(
    ("names", "titles"),
    [
        ("d_300K (mm),F_300K (kN),d_77K (mm),F_77K (kN)", ["300K", "77K"]),
        ("Wall A - Disp (mm),Wall A - Force (kN),Wall B - Disp (mm),Wall B - Force (kN)", ["Wall A", "Wall B"]),
    ],
)
def test_the_words_of_a_group_name_its_record(names: str, titles: list[str], tmp_path: Path) -> None:
    data = Dataset.of(read(written(tmp_path, names + "\n" + rows(",", U, Y, 2 * U, 3 * Y))))
    assert [record.name for record in data] == titles
    is_pair(data[0], units=("mm", "kN"))
    is_pair(data[1], 2 * U, 3 * Y)


def test_numbered_loops_that_close_are_no_branches(tmp_path: Path) -> None:
    """Two loops that begin and end at rest would meet at their ends as branches do."""
    k = np.arange(120)
    u = np.round(np.sin(2 * np.pi * k / 120), 4)
    y = np.round(u - 0.3 * np.cos(2 * np.pi * k / 120) * np.sin(np.pi * k / 120), 4)
    data = Dataset.of(read(written(tmp_path, "d1,F1,d2,F2\n" + rows(",", u, y, 2 * u, 2 * y))))
    assert [len(record) for record in data] == [120, 120]


def test_pulses_side_by_side_are_one_record(tmp_path: Path) -> None:
    """Their times follow each other, and each begins where the one before ended."""
    pulse = 1 - np.abs(np.linspace(-1, 1, 41))
    u = np.concatenate([pulse, pulse, -pulse])
    y = np.concatenate([0.5 * pulse + np.linspace(-1, 1, 41), 0.5 * pulse + 1, -0.5 * pulse + np.linspace(1, -1, 41)])
    t = np.concatenate([k + np.linspace(0, 0.1, 41) for k in range(3)])
    groups = [values[k * 41 : (k + 1) * 41] for k in range(3) for values in (t, u, y)]
    head = "Psw [uC/cm2]: 17.5\nWloss [uJ/cm2]: 69.8\n" + "\t".join(["Time [s]\tV [V]\tP [uC/cm2]"] * 3)
    record = one(written(tmp_path, head + "\n" + rows("\t", *groups), "pund.dat"))
    np.testing.assert_allclose(record.u, u, atol=1e-6)
    np.testing.assert_allclose(record.t, t, atol=1e-6)
    assert not record.stated  # of pulses, not of a loop


def test_conditions_in_brackets_are_no_units(tmp_path: Path) -> None:
    data = Dataset.of(read(written(tmp_path, "H (Oe),M (300 K),M (77K)\n" + rows(",", U, Y, 2 * Y))))
    assert [(record.name, record.y_unit) for record in data] == [("300 K", ""), ("77 K", "")]
    assert one(written(tmp_path, "I1(135deg) X\n" + rows(" ", U, Y), "b.dat")).u_unit == ""


def test_letters_of_phases_are_no_units(tmp_path: Path) -> None:
    content = "Disp_A,Force_A,Disp_B,Force_B\n" + rows(",", U, Y, 2 * U, 2 * Y)
    data = Dataset.of(read(written(tmp_path, content)))
    assert [(record.name, record.u_unit) for record in data] == [("A", ""), ("B", "")]
    alone = one(written(tmp_path, "disp_mm,I_A\n" + rows(",", U, Y), "b.csv"), input="disp_mm")
    assert alone.y_unit == "A"


def test_sensors_with_words_of_their_own_share_a_record(tmp_path: Path) -> None:
    """Two sensors of a device are no groups: only one of them has a displacement."""
    record = one(
        written(tmp_path, "Left disp,Left force,Right strain,Right force\n" + rows(",", U, Y, 0.1 * U, 0.5 * Y))
    )
    is_pair(record)


@pytest.mark.parametrize("kind", ["one block", "a block for each value", "several nodes", "captions"])
def test_blocks_of_a_simulation_for_each_time(kind: str, tmp_path: Path) -> None:
    """Data files and the log of FEBio, and those of CalculiX: settings or a caption above the rows of nodes, for every time."""
    steps = []
    for k, (t, u, y) in enumerate(zip(T, U, Y, strict=True), 1):
        begin = f"*Step  = {k}\n*Time  = {t}\n*Data  = "
        if kind == "one block":
            steps.append(f"{begin}ux;Rx\n7 {u} {y}\n")
        elif kind == "captions":
            end = f" for set TOP and time  {t:.7E}\n\n        12  "
            steps.append(f"\n displacements (vx,vy,vz){end}{u} 0.0 0.0\n\n forces (fx,fy,fz){end}{y} 1.0E-6 0.0\n")
        elif kind == "several nodes":
            steps.append(f"{begin}ux;Rx\n1,0,{y}\n2,{u},0\n")
        else:
            log = f"===== beginning time step {k} : {t} =====\n convergence norms : 1.0 2.0\n\n"
            plain = begin.replace("*", "")
            steps.append(
                f"{log}Data Record #1\n{plain}x-displacement\n7 {u}\n\nData Record #2\n{plain}x reaction force\n1 {y}\n\n"
            )
    record = one(written(tmp_path, "".join(steps), "run.log"))
    is_pair(record)
    assert record.t is not None
    np.testing.assert_array_equal(record.t, T)


@pytest.mark.parametrize("answers", [("R1", "D1"), ("stress", "strain")])
def test_columns_that_elements_above_a_matrix_name(answers: tuple[str, str], tmp_path: Path) -> None:
    """Recorders of OpenSees write the answers of each column in elements before the numbers."""
    head = "".join(
        f'<Output nodeTag="{k}" coord1="0">\n<ResponseType>{answer}</ResponseType>\n</Output>\n'
        for k, answer in enumerate(("time", *answers))
    )
    start = '<?xml version="1.0"?>\n<OpenSees xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">\n'
    record = one(written(tmp_path, f"{start}{head}<Data>\n{rows(' ', T, Y, U)}</Data>\n</OpenSees>\n", "node.xml"))
    is_pair(record)
    assert record.t is not None
    np.testing.assert_array_equal(record.t, T)


def test_a_row_for_each_change_of_a_value(tmp_path: Path) -> None:
    """The history of home automation: each entity writes where it changes, one after the other, and words of a switch among numbers."""
    level, way = np.round(20 + np.arange(N) % 16 / 10, 1), np.arange(N) // 8 % 2 == 0
    stamp = lambda k: f"2024-03-01T{k // 60:02d}:{k % 60:02d}:00.000Z"
    lines = [f"sensor.room_temperature,{value},{stamp(k)}\n" for k, value in enumerate(level)]
    lines.insert(5, f"sensor.room_temperature,unavailable,{stamp(4)}\n")
    lines += [
        f"switch.heater,{'on' if way[k] else 'off'},{stamp(k)}\n" for k in range(N) if k == 0 or way[k] != way[k - 1]
    ]
    record = one(written(tmp_path, "entity_id,state,last_changed\n" + "".join(lines)))
    assert (record.u_name, record.y_name) == ("switch.heater", "sensor.room_temperature")
    is_pair(record, u=way.astype(float), y=level)
    assert record.t is not None
    np.testing.assert_array_equal(record.t, 60.0 * np.arange(N))


def test_a_row_for_each_value_of_each_sensor(tmp_path: Path) -> None:
    lines = "".join(f"{t},disp [mm],{u}\n{t},force [kN],{y}\n" for t, u, y in zip(T, U, Y, strict=True))
    record = one(written(tmp_path, "time,sensor,value\n" + lines))
    is_pair(record, units=("mm", "kN"))
    np.testing.assert_array_equal(record.t, T)


def test_reversal_curves_are_told_apart_by_their_reversal_field(tmp_path: Path) -> None:
    fields, ends = np.linspace(-1, 1, 40), np.array([0.8, 0.4, 0.0, -0.4])
    table = np.array(
        [(end, h, np.tanh(2 * h) - 0.1 * (1 - h) * (1 - end)) for end in ends for h in fields[fields >= end]]
    )
    data = Dataset.of(read(written(tmp_path, "Ha (T),Hb (T),M (A/m)\n" + rows(",", *np.round(table.T, 5)))))
    assert [record.name for record in data] == ["Ha=0.8", "Ha=0.4", "Ha=0", "Ha=-0.4"]
    assert data[2].u_name == "Hb (T)"
    np.testing.assert_allclose(data[2].u, fields[fields >= 0], atol=1e-5)


def test_adsorbed_and_desorbed_are_the_branches_of_an_isotherm(tmp_path: Path) -> None:
    p = np.round(np.linspace(0.01, 0.99, 30), 4)
    content = "P/P0,Adsorbed (cm3/g),Desorbed (cm3/g)\n" + rows(
        ",", p, np.round(50 * p**2, 3), np.round(50 * p**1.5, 3)
    )
    record = one(written(tmp_path, content))
    assert len(record) == 60
    assert record.y_name == "Adsorbed (cm3/g)"


def test_numbers_of_nodes_are_no_units(tmp_path: Path) -> None:
    record = one(written(tmp_path, "U1_N5,RF1_N5\n" + rows(",", U, Y)))
    assert (record.u_name, record.u_unit, record.y_unit) == ("U1_N5", "", "")


def test_milliseconds_behind_a_colon(tmp_path: Path) -> None:
    stamps = [f"03/04/2020 10:00:{k // 20:02d}:{50 * (k % 20):03d}" for k in range(N)]
    record = one(
        written(tmp_path, "Time,disp,force\n" + "".join(f"{s},{u},{y}\n" for s, u, y in zip(stamps, U, Y, strict=True)))
    )
    np.testing.assert_allclose(record.t, T, atol=1e-9)


def test_numbered_rows_beside_specimens(tmp_path: Path) -> None:
    content = "No,Disp,Force,Disp,Force\n" + rows(",", 1 + np.arange(N), U, Y, U, 2 * Y)
    data = Dataset.of(read(written(tmp_path, content)))
    is_pair(data[1], y=2 * Y)


def test_what_an_actuator_reached_drives_the_force(tmp_path: Path) -> None:
    """And not what it was told, though the name of that states the input; where there is no other, that is the input."""
    told = np.round(1.001 * U, 4)
    content = "Time (s),Displacement Command (mm),Force (kN),Displacement (mm)\n"
    is_pair(one(written(tmp_path, content + rows(",", T, told, Y, U))))
    far = one(
        written(tmp_path, content.replace("Displacement (mm)", "Gap (mm)") + rows(",", T, told, Y, 0.3 * U), "b.csv")
    )
    is_pair(far, u=told)


def test_the_displacement_of_the_whole_device_drives_its_force(tmp_path: Path) -> None:
    content = "Load (kN),Uplift (mm),Slip (mm),Top (mm)\n"
    record = one(written(tmp_path, content + rows(",", Y, np.round(0.02 * U, 4), np.round(0.1 * U, 4), U)))
    is_pair(record)


# Time ---------------------------------------------------------------------------------------------------------------------------


def test_rows_from_the_last_to_the_first(tmp_path: Path) -> None:
    record = one(written(tmp_path, "t_s,disp_mm,force_kN\n" + rows(",", T[::-1], U[::-1], Y[::-1])))
    is_pair(record)
    np.testing.assert_array_equal(record.t, T)
    assert any("from the last to the first" in note.text for note in record.notes)


def test_a_time_that_goes_on_before_one_that_starts_again(tmp_path: Path) -> None:
    content = "Step Time (s),Total Time (s),disp_mm,force_kN\n" + rows(",", T % 1.0, T, U, Y)
    np.testing.assert_array_equal(one(written(tmp_path, content)).t, T)


def test_runs_whose_time_starts_again_are_records(tmp_path: Path) -> None:
    """Unless a half cycle goes on where it starts, as it does from step to step of a test."""
    angle = 2 * np.pi * np.arange(100) / 100
    x, f = np.round(np.sin(angle), 4), np.round(np.sin(angle) - 0.3 * np.cos(angle), 4)
    header = "t_s,disp_mm,force_kN\n"
    runs = rows(",", np.tile(T[:50], 4), np.tile(x, 2), np.r_[f, 2 * f])
    with pytest.raises(DataError, match="time decreases"):
        read(written(tmp_path, header + runs))
    time = np.round(0.05 * np.arange(100), 2)
    data = Dataset.of(
        read(written(tmp_path, header + rows(",", np.tile(time, 2), np.r_[x, 2 * x], np.r_[f, 1.2 * f]), "b.csv"))
    )
    is_pair(data[0], x, f)
    is_pair(data[1], 2 * x, 1.2 * f)
    set_of = "run_label,t_s,disp_mm,force_kN\n" + rows(
        ",", np.repeat([3, 8], 100), np.tile(time, 2), np.r_[x, 2 * x], np.r_[f, 3 * f]
    )
    named = Dataset.of(read(written(tmp_path, set_of, "c.csv")))
    assert [record.name for record in named] == ["run_label=3", "run_label=8"]


def test_milliseconds_since_1970(tmp_path: Path) -> None:
    stamps = 1_700_000_000_000 + 50 * np.arange(N)
    assert one(written(tmp_path, "timestamp,disp,force\n" + rows(",", stamps, U, Y))).t_unit == "ms"
    assert (
        one(written(tmp_path, "timestamp,disp,force\n" + rows(",", 1_700_000_000 + np.arange(N), U, Y), "b.csv")).t_unit
        == "s"
    )


@pytest.mark.parametrize(
    "header",
    ["Время, с;Перемещение, мм;Усилие, кН", "Temps;Déplacement (mm);Effort (kN)", "Tempo;Spostamento [mm];Forza [kN]"],
)
def test_headings_of_other_languages(header: str, tmp_path: Path) -> None:
    record = one(written(tmp_path, header + "\n" + rows(";", T, U, Y).replace(".", ",")))
    is_pair(record, units=("mm", "kN"))
    np.testing.assert_array_equal(record.t, T)


def test_an_output_that_saturates_in_small_cycles_belongs_to_its_input(tmp_path: Path) -> None:
    """Where the amplitude grows, the force passes through its range in every cycle and the displacement in the last one."""
    u = np.concatenate([a * np.sin(2 * np.pi * np.arange(50) / 50) for a in (2, 4, 6, 8, 10, 40)])
    force = np.clip(u, -2, 2) + 0.01 * u
    drift = np.linspace(0, 1, u.size) + 0.2 * np.sin(np.arange(u.size) / 40)
    content = "Gap (mm),Disp (mm),Force (kN)\n" + rows(",", np.round(drift, 4), np.round(u, 4), np.round(force, 4))
    assert one(written(tmp_path, content)).u_name == "Disp (mm)"


def test_the_components_along_the_field_are_the_loop(tmp_path: Path) -> None:
    """OOMMF gives all components of field and magnetization behind the names of the parts of the program, and the size of the field."""
    m = 0.9 * np.tanh(Y / np.abs(Y).max() * 2)
    across = np.sqrt(1 - m**2)
    field = {"Bx": 0.02 * U, "By": U, "B": np.hypot(U, 0.02 * U)}
    vector = {"mx": across, "my": m, "mz": 0.1 * across * np.sin(3 * m)}
    columns = {"Oxs_CGEvolve::Total energy": -m * U}
    columns |= {f"Oxs_UZeeman::{name}": values for name, values in field.items()}
    columns |= {f"Oxs_MinDriver::{name}": values for name, values in vector.items()}
    names = " ".join(f"{{{name}}}" if " " in name else name for name in columns)
    above = f"# ODT 1.0\n# Table Start\n# Columns: {names}\n# Units: J mT mT mT {{}} {{}} {{}}\n"
    record = one(written(tmp_path, above + rows(" ", *columns.values()) + "# Table End\n", "loop.odt"))
    assert (record.u_name, record.y_name, record.u_unit) == ("Oxs_UZeeman::By", "Oxs_MinDriver::my", "mT")


@pytest.mark.parametrize("loops", [(5,), (5, 300)])
def test_a_sweep_of_the_temperature_is_no_part_of_the_loops_beside_it(loops: tuple[int, ...], tmp_path: Path) -> None:
    """A sequence of a magnetometer: warming in a small field that is held, then a loop at each temperature."""
    warm = np.linspace(5, 300, 200)
    field, temperature, moment = [np.full(200, 99.9)], [warm], [3e-4 * np.exp(-warm / 80)]
    share = np.concatenate([np.linspace(1, -1, 81), np.linspace(-1, 1, 81)[1:]])
    for held in loops:
        field.append(7e4 * share)
        temperature.append(np.full(share.size, float(held)))
        moment.append(np.tanh(5 * share - 0.5 * np.sign(np.gradient(share))) / held)
    columns = [np.concatenate(parts) for parts in (temperature, field, moment)]
    content = "Temperature (K),Magnetic Field (Oe),Moment (emu)\n" + rows(",", *columns)
    records = Dataset.of(read(written(tmp_path, content)))
    assert [record.u.size for record in records] == [161] * len(loops)
    assert all(np.ptp(record.u) == 1.4e5 for record in records)
    assert not any(note.code is Code.CONDITIONS for record in records for note in record.notes)


def _loops_of_a_magnetometer(kelvins: tuple[float, ...]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Columns and loops of a sequence that rises from zero field once and measures a loop at each temperature, with its clock going on."""
    rng, share = np.random.default_rng(5), np.concatenate([np.linspace(1, -1, 57), np.linspace(-1, 1, 57)[1:]])
    field, temperature = [], []
    for k, kelvin in enumerate(kelvins):
        field.append(7e4 * np.concatenate([np.linspace(0, 1, 20)[:-1], share]) if k == 0 else 7e4 * share)
        temperature.append(kelvin + rng.normal(0, 1e-3, field[-1].size))
    moments = [np.tanh(u / 1e4 + 2 * np.sign(np.gradient(u)) / k) for u, k in zip(field, kelvins, strict=True)]
    kelvin, u, y = (np.concatenate(parts) for parts in (temperature, field, moments))
    time = 1e6 + np.cumsum(rng.uniform(28, 30, u.size))
    return [time, kelvin, u, y, kelvin + 0.01, kelvin - 0.02], field


def test_loops_at_temperatures_that_are_held_are_records_of_their_own(tmp_path: Path) -> None:
    """The first loop alone begins at zero field, and the clock goes on from each to the next."""
    columns, loops = _loops_of_a_magnetometer((2.0, 4.0, 6.0))
    names = "Time (s),Temperature (K),Magnetic Field (Oe),Moment (emu),Sensor Temp (K),Chamber Temp (K)\n"
    data = Dataset.of(read(written(tmp_path, names + rows(",", *columns))))
    assert [record.name for record in data] == ["Temperature=2", "Temperature=4", "Temperature=6"]
    for record, u in zip(data, loops, strict=True):
        np.testing.assert_allclose(record.u, u, rtol=1e-6, atol=1e-6)
    (note,) = (note for note in data[0].notes if note.severity is Severity.WARNING)
    assert note.option == ("only", "2")


def test_rows_in_which_the_temperature_changes_between_loops_are_left_out(tmp_path: Path) -> None:
    """The field is read back with noise at zero while the cryostat cools, and each loop begins and ends there."""
    rng, share = np.random.default_rng(7), np.sin(np.linspace(0, 2 * np.pi, 201))
    field, temperature = [5e3 * share], [300 + rng.normal(0, 0.02, 201)]
    for warm, cold in ((300, 200), (200, 100)):
        field += [rng.normal(2, 0.4, 60), 5e3 * share]
        temperature += [np.linspace(warm, cold, 62)[1:-1], cold + rng.normal(0, 0.02, 201)]
    u, kelvin = np.concatenate(field), np.concatenate(temperature)
    columns = (np.arange(u.size), kelvin, u, np.tanh(u / 900 + np.sign(np.gradient(u)) * 60 / kelvin))
    data = Dataset.of(
        read(written(tmp_path, "Time (s),Temperature (K),Field (Oe),Moment (emu)\n" + rows(",", *columns)))
    )
    assert [record.name for record in data] == ["Temperature=300", "Temperature=200", "Temperature=100"]
    assert all(201 <= len(record) < 210 for record in data)


def test_rows_at_one_level_of_a_measured_condition(tmp_path: Path) -> None:
    columns, _ = _loops_of_a_magnetometer((2.0, 4.0, 6.0))
    names = "Time (s),Temperature (K),Magnetic Field (Oe),Moment (emu),Sensor Temp (K),Chamber Temp (K)\n"
    path = written(tmp_path, names + rows(",", *columns))
    assert len(Dataset.of(read(path, by="Temperature (K)"))) == 3
    record = one(path, where="Temperature (K)=4")
    np.testing.assert_allclose(record.u, columns[2][np.abs(columns[1] - 4) < 1])
    with pytest.raises(DataError, match="2, 4, 6"):
        read(path, where="Temperature (K)=5")


def test_several_thermometers_make_one_warning(tmp_path: Path) -> None:
    (time, _, u, y, *_), _ = _loops_of_a_magnetometer((2.0, 4.0, 6.0))
    drift = np.linspace(0, 60, u.size)
    names = "Time (s),Temperature (K),Magnetic Field (Oe),Moment (emu),Sensor Temp (K),Chamber Temp (K)\n"
    columns = (time, 250 + drift, u, y, 250 + drift + 0.01, 251 + drift)
    record = one(written(tmp_path, names + rows(",", *columns)))
    assert sum(note.code is Code.CONDITIONS for note in record.notes) == 1


def test_words_of_units_behind_the_numbers_of_a_simulator(tmp_path: Path) -> None:
    """A motor turned by even steps, which its program numbers."""
    torque = 12 * np.sin(2 * np.pi * np.arange(36) / 35)
    lines = [f"{k + 1},{10 * k}deg,{value:.9g}NewtonMeter\n" for k, value in enumerate(torque)]
    record = one(written(tmp_path, "Variation,rotation_phase,rotor_torque: None\n" + "".join(lines)))
    np.testing.assert_allclose(record.u, 10.0 * np.arange(36))
    np.testing.assert_allclose(record.y, torque, rtol=1e-8)
    assert (record.u_unit, record.y_unit) == ("deg", "NewtonMeter")


@pytest.mark.parametrize("starts", [1, 3])
def test_a_time_that_starts_again_makes_no_clockwise_loop(starts: int, tmp_path: Path) -> None:
    """A logger of one signal writes the time of each run from zero."""
    t = np.tile(np.arange(60) / 10, starts)
    data = read(written(tmp_path, rows(",", t, 98 + 12 * np.exp(-t))))
    notes = (data if isinstance(data, Record) else data[0]).notes
    assert not any(note.severity is Severity.WARNING for note in notes if note.code is Code.COLUMN_CHOICE)


def test_signals_that_simulink_logs(tmp_path: Path) -> None:
    """Structures with time: of a block to the workspace each, of a scope with several signals, within the output of a simulation."""
    signal = lambda values, label: {"values": values[:, None], "dimensions": 1, "label": label}
    logged = lambda signals: {"time": T[:, None], "signals": signals, "blockName": "model/Scope"}
    both = np.array([signal(U, "Voltage [V]"), signal(Y, "Displacement [um]")], dtype=object)
    files = {
        "scope": {"ScopeData": logged(both)},
        "labeled": {"a": logged(signal(U, "Voltage [V]")), "b": logged(signal(Y, "Displacement [um]"))},
        "plain": {"out": {"tout": T[:, None], "voltage": logged(signal(U, "")), "disp": logged(signal(Y, ""))}},
        "alike": {"voltage": logged(signal(U, "s")), "disp": logged(signal(Y, "s"))},
    }
    for name, variables in files.items():
        scipy.io.savemat(tmp_path / f"{name}.mat", variables)
        record = one(tmp_path / f"{name}.mat")
        is_pair(record, units=None if name in ("plain", "alike") else ("V", "um"))
        np.testing.assert_array_equal(record.t, T)


def test_two_lines_of_names_over_fixed_columns(tmp_path: Path) -> None:
    """A listing of ANSYS, of which the number and kind of a variable stand over its name."""
    names = "     TIME         2 UX           3 FX     \n                   UTOP          RBASE   \n"
    title, text = " ***** ANSYS POST26 VARIABLE LISTING *****\n\n", ""
    for first in range(0, N, 40):
        some = zip(T[first : first + 40], U[first : first + 40], Y[first : first + 40], strict=True)
        text += title + names + "".join(f"  {t:11.5E}    {u:12.6f}   {y:12.6f}  \n" for t, u, y in some) + "\n"
    record = one(written(tmp_path, text, "loop.lis"))
    is_pair(record)
    assert (record.u_name, record.y_name) == ("2 UX UTOP", "3 FX RBASE")
    np.testing.assert_allclose(record.t, T)


def test_names_above_the_mark_of_the_data_and_the_title_of_a_section(tmp_path: Path) -> None:
    head = "Operator jk\n@@End of Header.\nTime_since_start Applied_Field Signal\n@@Data\nNew Section: Section 0:\n"
    rows = "".join(f"{t} {u} {y}\n" for t, u, y in zip(T, U, Y, strict=True))
    record = one(written(tmp_path, head + rows + "@@END Data.\n", "loop.vsm"))
    is_pair(record)
    assert (record.u_name, record.y_name) == ("Applied_Field", "Signal")
    np.testing.assert_array_equal(record.t, T)


def test_fractions_of_seconds_since_1970_are_the_time(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", mot=1.6e9 + 0.37 + T, field=U, xmcd=Y)
    record = one(tmp_path / "a.npz")
    is_pair(record)
    assert record.t is not None
    np.testing.assert_allclose(record.t - record.t[0], T, atol=1e-6)
