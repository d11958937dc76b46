"""Headers of loggers, oscilloscopes and simulators whose names, units or columns were read wrong, and archives at the shell."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from hystfit.cli import run
from hystfit.errors import DataError
from hystfit.reading import read
from hystfit.reading.names.column_names import column_quantity, column_role
from hystfit.reading.text.stated_interval import stated_interval
from tests.loop_files import N, U, Y, is_pair, one, rows, written

T = np.round(0.1 * np.arange(N), 1)


def named(record, u: str, y: str, units: tuple[str, str]) -> bool:
    """Whether a record has these names and units."""
    return (record.u_name, record.y_name, record.u_unit, record.y_unit) == (u, y, *units)


@pytest.mark.parametrize(
    ("header", "u", "y"),
    [  # HOBO: the number of the row is "#", and a comma stands before each unit
        (
            '"Plot Title: 7"\n"#","Time, s","Potential, kPa (LGR S/N: 2012)","Water Content, m3/m3 (LGR S/N: 2012)"\n',
            2,
            3,
        ),
        ('"File","0312.MEM"\n"Title","DEA test"\n"#","Time (s)","CH1-1[V]","CH1-2[mm]"\n', 2, 3),  # HIOKI
    ],
)
def test_quoted_names_are_whole(header: str, u: int, y: int, tmp_path: Path) -> None:
    names = header.splitlines()[-1][1:-1].split('","')
    units = ("kPa", "m3/m3") if "kPa" in header else ("V", "mm")
    record = one(tmp_path, header + rows(",", np.arange(1, N + 1), T, U, Y))
    is_pair(record)
    assert named(record, names[u], names[y], units)


def test_names_with_commas_between_blanks(tmp_path: Path) -> None:
    """The table of a probe in COMSOL, of three columns and two commas."""
    header = "% Time (s)      Magnetic field, Hx (A/m)      Magnetic flux density, Bx (T)\n"
    record = one(tmp_path, header + rows("   ", T, U, Y))
    is_pair(record)
    assert named(record, "Magnetic field, Hx (A/m)", "Magnetic flux density, Bx (T)", ("A/m", "T"))


def test_units_below_channels_beside_number_and_time(tmp_path: Path) -> None:
    """The rows of a Graphtec logger end in the states of its alarms."""
    header = "Number,Clock,ms,CH1,CH2,Alarm1-10,AlarmOut\nNO.,Time,ms,mm,kN,A1234567890,A1234\n"
    flags = np.array(["LLLL"] * N)
    record = one(tmp_path, header + rows(",", np.arange(N), T, 100 * (np.arange(N) % 10), U, Y, flags, flags))
    is_pair(record)
    assert named(record, "CH1", "CH2", ("mm", "kN"))


def test_a_bar_before_the_unit(tmp_path: Path) -> None:
    record = one(tmp_path, "Time|s,LVDT_1|mm,LoadCell|kN\n" + rows(",", T, U, Y))
    assert (record.u_unit, record.y_unit, record.t_unit) == ("mm", "kN", "s")


@pytest.mark.parametrize(
    ("line", "interval"),
    [
        ('"SampleRate",1.0000E+03,1.0000E+03', 1e-3),  # of two channels
        ("Sample Rate,1000,1000", 1e-3),
        ("SampleRate,1.0E+03,2.0E+03", None),
        ("dt = 0,002 s", 2e-3),
        ("#tInc=1e-05", 1e-5),
    ],
)
def test_intervals_of_several_channels(line: str, interval: float | None) -> None:
    assert stated_interval([line, "CH1,CH2"]) == (interval and pytest.approx(interval))


def test_values_of_ngspice(tmp_path: Path) -> None:
    head = "Title: core\nPlotname: Transient Analysis\nFlags: real\nNo. Variables: 3\nNo. Points: 9\nVariables:\n"
    head += "\t0\ttime\ttime\n\t1\tv(in)\tvoltage\n\t2\tv(out)\tvoltage\nValues:\n"
    samples = "".join(f" {k}\t{t}\n\t{u}\n\t{y}\n\n" for k, (t, u, y) in enumerate(zip(T, U, Y, strict=True)))
    record = one(tmp_path, head + samples, "core.raw")
    is_pair(record)
    assert named(record, "v(in)", "v(out)", ("V", "V"))
    np.testing.assert_allclose(record.t, T)


def test_columns_of_modelica(tmp_path: Path) -> None:
    """The position s of a mass is known by its velocity v, and a source drives what it is connected to."""
    s = np.sin(T)
    force = np.sign(np.cos(T)) + s
    names = '"time","mass.s","mass.v","friction.f","source.y"\n'
    record = one(tmp_path, names + rows(",", T, s, np.cos(T), force, 10 * s))
    is_pair(record, s, force)
    assert column_role("source.y") == "input"


def test_the_current_of_a_winding_drives_its_flux(tmp_path: Path) -> None:
    names = '"Time [ms]","Current(W1) [A]","FluxLinkage(W1) [mWb]","InducedVoltage(W1) [V]"\n'
    record = one(tmp_path, names + rows(",", T, U, Y, np.gradient(Y)))
    is_pair(record)


def test_a_backward_sweep_beside_columns_without_a_word(tmp_path: Path) -> None:
    """Spectroscopy of Nanonis: the bias and a current and a height on the way there, and both on the way back."""
    bias = np.linspace(-2, 2, N)
    there, back = bias + 1 - (bias / 2) ** 2, bias - 1 + (bias / 2) ** 2
    names = "Bias calc (V)\tCurrent (A)\tZ (m)\tCurrent [bwd] (A)\tZ [bwd] (m)\n"
    record = one(tmp_path, names + rows("\t", bias, there, 0 * bias, back, 0 * bias))
    is_pair(record, np.r_[bias, bias[::-1]], np.r_[there, back[::-1]])


def test_branches_of_water_in_soil_side_by_side(tmp_path: Path) -> None:
    psi, theta = np.geomspace(1, 1000, N), np.linspace(0.45, 0.1, N)
    names = "psi_kPa_drying,theta_drying,psi_kPa_wetting,theta_wetting\n"
    record = one(tmp_path, names + rows(",", psi, theta, psi[::-1], 0.9 * theta[::-1]))
    assert record.u_unit == "kPa"
    np.testing.assert_allclose(record.u, np.r_[psi, psi[::-1]])


def test_set_values_and_gauges_by_name(tmp_path: Path) -> None:
    """A set height is no output beside the measured one, and a Hall gauge measures the field that is applied."""
    noise = 0.01 * np.random.default_rng(4).standard_normal(N)
    record = one(tmp_path, "Height set (nm),Height measured (nm),Drive (V)\n" + rows(",", Y, Y + noise, U))
    is_pair(record, U, Y + noise)
    assert [column_role(name) for name in ("B_hall(mT)", "V_hall")] == ["", "output"]


def test_times_that_run_back_are_no_time(tmp_path: Path) -> None:
    """Tensions at both ends of a sheath beside the time t."""
    record = one(tmp_path, "t,T_in,T_out\n" + rows(",", T, U, Y))
    is_pair(record)
    assert column_quantity("cyc") == "index"


@pytest.mark.usefixtures("findings_alone")
def test_archives_of_several_files_at_the_shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "tests.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("a.csv", "b.csv"):
            archive.writestr(name, "x_mm,F_kN\n" + rows(",", U, Y))
        archive.writestr("protocol.txt", "measured on a rig without a name\n")
    assert run(["check", str(path)]) == 0
    assert "Data quality: a, b" in capsys.readouterr().out


def test_files_of_programs_name_the_export(tmp_path: Path) -> None:
    path = tmp_path / "cell.ndax"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("Step.xml", "<steps/>")
        archive.writestr("data.ndc", b"\x01\x00\x02")
    with pytest.raises(DataError, match="Neware"):
        read(path)
    parts = ["".join(f'<Item ID="{k}" {name}="{k}"/>' for k in range(9)) for name in "abcd"]
    xml = "<doc>" + "".join(f"<part>{part}</part>" for part in parts) + "</doc>"
    with pytest.raises(DataError, match="export"):
        read(written(tmp_path, xml, "isotherm.jwgbt"))


def test_the_numbers_of_the_rows_are_called_by_their_sign(tmp_path: Path) -> None:
    """ "#" and a tab before the names is the name of the first column where every column has one, and else the mark of a comment."""
    u = np.round(10 * np.sin(np.linspace(0, 12, 90)), 3)
    y = np.round(0.4 * u + 0.5 * np.sign(np.gradient(u)), 3)
    for head, columns in (("#\tangle_deg\ttorque_Nm", (np.arange(1, 91), u, y)), ("#\tangle_deg\ttorque_Nm", (u, y))):
        path = tmp_path / f"drive{len(columns)}.tsv"
        rows = ("\t".join(map(str, row)) for row in zip(*columns, strict=True))
        path.write_text(head + "\n" + "\n".join(rows) + "\n", encoding="utf-8")
        record = read(path)
        assert (record.u_name, record.y_name) == ("angle_deg", "torque_Nm")
        np.testing.assert_allclose(record.u, u)


@pytest.mark.parametrize("mark", ["", "# "])
def test_units_behind_the_word_in_where_blanks_part_the_columns(mark: str, tmp_path: Path) -> None:
    """A notebook of a laboratory course: the response first, and tabs beside blanks."""
    table = [f"{y} \t{u}" if k % 3 else f"{y}    {u}" for k, (u, y) in enumerate(zip(U, Y, strict=True))]
    record = one(tmp_path, f"{mark}B in mT Stromstärke in A\n" + "\n".join(table) + "\n", "course.txt")
    is_pair(record)
    assert named(record, "Stromstärke in A", "B in mT", ("A", "mT"))
    record = one(tmp_path, "x in mm F in kN\n" + rows(" ", U, Y), "steel.txt")
    assert named(record, "x in mm", "F in kN", ("mm", "kN"))


def test_a_property_that_is_not_specified_is_no_property(tmp_path: Path) -> None:
    head = "Sample Mass   10.2 mg\nSample Geometry   Not Specified\nPressure (mbar)   Uptake (mg)\n"
    record = one(tmp_path, head + rows("   ", U, Y), "sorption.txt")
    shown = next(note.text for note in record.notes if "properties of the sample" in note.text)
    assert "10.2 mg" in shown
    assert "Geometry" not in shown
