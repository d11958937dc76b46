"""Reading files as laboratories write them: each read right, or refused with a message that says what to do."""

from __future__ import annotations

import hashlib
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hystfit.data import Dataset, Record
from hystfit.errors import DataError
from hystfit.outcome.note import Code, Severity, has
from hystfit.quality.reversal_curves import recognize_family
from hystfit.reading import read
from hystfit.reading.names.column_names import column_quantity
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.read import table_of
from hystfit.results.saved import load_records, save_records

T = [0.0, 0.5, 1.0, 1.5]
U = [0.0, 1.25, -2.5, 1000.5]
Y = [10.0, -0.125, 3.0, 4.75]


def _rows(mark: str, columns: Any = None, end: str = "", point: str = ".") -> str:
    rows = zip(*(columns or [T, U, Y]), strict=True)
    return "".join(mark.join(f"{v:g}".replace(".", point) for v in row) + end + "\n" for row in rows)


# name: (content, arguments, what must be found: t, u, y, units, or names)
GOOD: dict[str, tuple[str | bytes, dict[str, Any], dict[str, Any]]] = {
    "plain": ("t_s,u_V,y_um\n" + _rows(","), {}, {"units": ("s", "V", "um")}),
    "no header": (_rows(","), {}, {}),
    "first row of whole numbers is no header": ("0 0 10\n0.5 1.25 -0.125\n1 -2.5 3\n1.5 1000.5 4.75\n", {}, {}),
    "semicolons and decimal commas": ("t;u;y\n" + _rows(";", point=","), {}, {}),
    "thousands dots beside decimal commas": (
        "t;u;y\n0;0;10\n0,5;1,25;-0,125\n1;-2,5;3\n1,5;1.000,50;4,75\n",
        {},
        {},
    ),
    "thousands spaces": ("t;u;y\n0;0;10\n0,5;1,25;-0,125\n1;-2,5;3\n1,5;1 000,5;4,75\n", {}, {}),
    "thousands commas in quotes": (
        '"t","u","y"\n"0","0","10"\n"0.5","1.25","-0.125"\n"1","-2.5","3"\n"1.5","1,000.5","4.75"\n',
        {},
        {},
    ),
    "tabs with trailing tabs": ("t\tu\ty\t\n" + _rows("\t", end="\t"), {}, {}),
    "trailing commas": ("t,u,y,,\n" + _rows(",", end=",,"), {}, {}),
    "trailing commas below the header only": ("t,u,y\n" + _rows(",", end=","), {}, {}),
    "aligned white space": ("  t      u     y\n" + _rows("   ").replace("\n", "\n   "), {}, {}),
    "units row": ("time,voltage,disp\ns,V,um\n" + _rows(","), {}, {"units": ("s", "V", "um")}),
    "units row in brackets": ("time;voltage;disp\n[s];[V];[um]\n" + _rows(";"), {}, {"units": ("s", "V", "um")}),
    "units in the names": (
        "Time (s),Voltage [V],Displacement / um\n" + _rows(","),
        {},
        {"units": ("s", "V", "um")},
    ),
    "two header rows": (
        "Clock,Stage,Sensor\nt,x,x\ns,um,um\n" + _rows(","),
        {"input": "Stage x", "output": 2},
        {"units": ("s", "um", "um")},
    ),
    "metadata lines": ("Operator: Kim\nDate,2024-01-02\nGain = 3\nRate,200\n\nt,u,y\n" + _rows(","), {}, {}),
    "header in a comment": ("# saved by numpy\n# t_s u_V y_um\n" + _rows(" "), {}, {"units": ("s", "V", "um")}),
    "header with its own delimiter": ("t, u, y\n" + _rows("\t"), {}, {}),
    "bracketed units between spaces": ("t (s)   u (V)   y (um)\n" + _rows("  "), {}, {"units": ("s", "V", "um")}),
    "quoted numbers": ('"t","u","y"\n' + '"' + _rows('","', end='"').replace("\n", '\n"')[:-1], {}, {}),
    "quoted decimal commas": (
        't,u,y\n"0,0","0,0","10,0"\n"0,5","1,25","-0,125"\n1,"-2,5",3\n"1,5","1000,5","4,75"\n',
        {},
        {},
    ),
    "byte-order mark": (b"\xef\xbb\xbft_s,u_V,y_um\n" + _rows(",").encode(), {"time": "t_s"}, {}),
    "UTF-16": (("t_s\tu_V\ty_µm\n" + _rows("\t")).encode("utf-16"), {}, {"units": ("s", "V", "µm")}),
    "UTF-16 without a mark": (("t,u,y\n" + _rows(",")).encode("utf-16-le"), {}, {}),
    "cp1252": (("t_s;Spannung_V;y_µm\n" + _rows(";")).encode("cp1252"), {}, {"units": ("s", "V", "µm")}),
    "bytes that only latin-1 has": (b"t,u,y\n" + _rows(",").encode() + b"# \x81\x8d end\n", {}, {}),
    "old Mac line ends": ("t,u,y\n" + _rows(",")).replace("\n", "\r"),
    "doubled line ends": ("t,u,y\n" + _rows(",")).replace("\n", "\r\r\n").encode(),
    "NUL padding at the end": ("t,u,y\n" + _rows(",") + "\0" * 64, {}, {}),
    "empty first column": (",t,u,y\n" + "".join("," + row + "\n" for row in _rows(",").splitlines()), {}, {}),
    "row numbers first": (
        ",t,u,y\n" + "".join(f"{k},{row}\n" for k, row in enumerate(_rows(",").splitlines())),
        {},
        {},
    ),
    "row numbers without a name": (
        "t,u,y\n" + "".join(f"{k},{row}\n" for k, row in enumerate(_rows(",").splitlines(), 1)),
        {"time": 1, "input": 2, "output": 3},
        {},
    ),
    "repeated header while time goes on": (
        "t,u,y\n0,0,10\n0.5,1.25,-0.125\nt,u,y\n1,-2.5,3\n1.5,1000.5,4.75\n",
        {},
        {},
    ),
    "footer lines": ("t,u,y\n" + _rows(",") + "\nEnd of test,,\nChecksum: 4711\n", {}, {}),
    "ragged row": ("t,u,y\n0,0,10\n0.5,1.25,-0.125\n0.7,1\n1,-2.5,3\n1.5,1000.5,4.75\n", {}, {}),
    "truncated last line": ("t,u,y\n" + _rows(",") + "2,10", {}, {}),
    "exponent D": ("0D0 0D0 1D1\n5.0D-01 1.25d0 -0.125D+00\n1.0D0 -0.25D1 3D0\n1.5D0 1.0005D+03 4.75D0\n", {}, {}),
    "Unicode minus": ("t;u;y\n" + _rows(";").replace("-", "\u2212"), {}, {}),
    "ISO time stamps": (
        "".join(f"2024-03-31T23:59:{59 + t:06.3f},{u},{y}\n" for t, u, y in zip(T[:2], U, Y, strict=False))
        + "".join(f"2024-04-01T00:00:{t - 1:06.3f},{u},{y}\n" for t, u, y in zip(T[2:], U[2:], Y[2:], strict=True)),
        {},
        {"units": ("s", "", "")},
    ),
    "time of day over midnight": (
        "clock,u,y\n23:59:59.0,0,10\n23:59:59.5,1.25,-0.125\n00:00:00.0,-2.5,3\n00:00:00.5,1000.5,4.75\n",
        {},
        {},
    ),
    "German dates": (
        "Zeit;Spannung;Weg\n31.12.2024 23:59:59,0;0;10\n31.12.2024 23:59:59,5;1,25;-0,125\n"
        "01.01.2025 00:00:00,0;-2,5;3\n01.01.2025 00:00:00,5;1000,5;4,75\n",
        {},
        {},
    ),
    "date and time in two columns": (
        "date time u y\n2024-01-02 10:00:00.0 0 10\n2024-01-02 10:00:00.5 1.25 -0.125\n"
        "2024-01-02 10:00:01.0 -2.5 3\n2024-01-02 10:00:01.5 1000.5 4.75\n",
        {"time": "time"},
        {},
    ),
    "nanoseconds since 1970": (
        "t_ns,u_V,y\n1700000000000000000,0,10\n1700000000000000001,1.25,-0.125\n1700000000000000002,-2.5,3\n1700000000000000003,1000.5,4.75\n",
        {},
        {"t": [0, 1, 2, 3], "units": ("ns", "V", "")},
    ),
    "output first": ("Force [kN],Displacment [mm]\n" + _rows(",", [Y, U]), {}, {"t": None, "units": ("s", "mm", "kN")}),
    "y before x": ("y,x\n" + _rows(",", [Y, U]), {}, {"t": None}),
    "stress before strain": ("sigma_MPa,eps\n" + _rows(",", [Y, U]), {}, {"t": None, "units": ("s", "", "MPa")}),
    "induction before field": ("B_T,H_A_per_m\n" + _rows(",", [Y, U]), {}, {"t": None, "units": ("s", "A/m", "T")}),
    "polarization over field, henry and joule": (
        "H_A_per_m,J_T\n" + _rows(",", [U, Y]),
        {},
        {"t": None, "units": ("s", "A/m", "T")},
    ),
    "displacement before voltage": ("Position (um),Voltage (V)\n" + _rows(",", [Y, U]), {}, {"t": None}),
    "velocity beside displacement": ("t_s,x,v,F\n" + _rows(",", [T, U, [1, 2, 4, 3], Y]), {}, {}),
    "constant columns": ("\n".join(f"{u} 0 0 {y} -317.2" for u, y in zip(U, Y, strict=True)), {}, {"t": None}),
    "columns by number as text": (
        _rows(",", [Y, [7, 7, 8, 9], U]),
        {"input": "2", "output": "0", "time": False},
        {"t": None},
    ),
    "names without units or case": (
        "T_s,Drive_V,Sense_um\n" + _rows(","),
        {"time": "t", "input": "drive", "output": "SENSE"},
        {},
    ),
    "two columns of one name": ("t,u,y,y\n" + _rows(",", [T, U, [1, 2, 4, 3], Y]), {"output": 3}, {}),
    "missing outputs": (
        "t,u,y\n0,0,10\n0.5,1.25,#N/A\n1,-2.5,--\n1.5,1000.5,4.75\n",
        {},
        {"y": [10, np.nan, np.nan, 4.75]},
    ),
    "infinite output": (
        "t,u,y\n0,0,10\n0.5,1.25,inf\n1,-2.5,nan\n1.5,1000.5,4.75\n",
        {},
        {"y": [10, np.nan, np.nan, 4.75]},
    ),
    "input missing at the ends": ("t,u,y\n-1,,5\n" + _rows(",") + "2,nan,6\n3,,7\n", {}, {}),
    "repeated time stamps": (
        "t,u,y\n0,0,10\n0.5,1.25,-0.125\n0.5,-2.5,3\n1.5,1000.5,4.75\n",
        {},
        {"t": [0, 0.5, 0.5, 1.5]},
    ),
    "double spacing": ("t,u,y\n\n" + _rows(",").replace("\n", "\n\n"), {}, {}),
    "tagged rows": (
        "SetupTitle, test\nSize, 4, 4, 4\nNames, t, u, y\n"
        + "".join(f"Value, {row}\n" for row in _rows(", ").splitlines()),
        {},
        {},
    ),
    "decimal comma given": (
        "1,234;1,500\n2,345;2,500\n",
        {"decimal": ","},
        {"t": None, "u": [1.234, 2.345], "y": [1.5, 2.5]},
    ),
    "thousands given": (
        "1,234;1,500\n2,345;2,500\n",
        {"decimal": "."},
        {"t": None, "u": [1234, 2345], "y": [1500, 2500]},
    ),
    "row names without a header": (
        '"t" "u" "y"\n' + "".join(f'"{k}" {r}\n' for k, r in enumerate(_rows(" ").splitlines(), 1)),
        {},
        {},
    ),
    "header of a comment column without cells": ("X_Value\tVoltage\tWeg\tComment\n" + _rows("\t"), {}, {}),
    "separator line of a spreadsheet": ("sep=;\nt;u;y\n" + _rows(";", point=","), {}, {}),
    "comment that is no header": ("# loop1\n" + _rows(" ", [U, Y]), {"input": "column 0"}, {"t": None}),
    "temperature beside": (
        "t_s,Temp_C,Cmd_V,Pos_um\n" + _rows(",", [T, [20, 21, 22, 23], U, Y]),
        {},
        {"units": ("s", "V", "um")},
    ),
    "text column beside": (
        "t,state,u,y\n"
        + "".join(f"{t},{w},{u},{y}\n" for t, w, u, y in zip(T, ["on", "on", "off", "on"], U, Y, strict=True)),
        {},
        {},
    ),
    "delimiter given": (_rows(":"), {"delimiter": ":"}, {}),
}


def _write(folder: Path, content: str | bytes, name: str = "file.csv") -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize("case", GOOD)
def test_odd_file_is_read_right(case: str, tmp_path: Path) -> None:
    entry = GOOD[case]
    content, arguments, expected = entry if isinstance(entry, tuple) else (entry, {}, {})
    path = _write(tmp_path, content)
    record = read(path, **arguments)
    assert isinstance(record, Record)
    np.testing.assert_array_equal(record.u, expected.get("u", U))
    np.testing.assert_array_equal(record.y, expected.get("y", Y))
    if expected.get("t", T) is None:
        assert record.t is None
    else:
        np.testing.assert_allclose(record.t, expected.get("t", T), rtol=0, atol=1e-11)
    if "units" in expected:
        assert (record.t_unit, record.u_unit, record.y_unit) == expected["units"]
    assert record.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert record.name == "file"


BAD: dict[str, tuple[str | bytes, dict[str, Any], str]] = {
    "empty": (b"", {}, "is empty"),
    "blank lines": ("\n \n\n", {}, "blank lines"),
    "text only": ("this is\na letter\nto nobody\n", {}, "no row of numbers.*delimiter="),
    "header only": ("t,u,y\n", {}, "no row of numbers"),
    "one row": ("t,u,y\n1,2,3\n", {}, "only 1 row"),
    "single column": ("u\n1.5\n2.5\n3.5\n", {}, "input and an output.*1 column"),
    "one changing column": ("t,u,y\n0,1,0\n1,1,2\n2,1,1\n", {}, "input and an output"),
    "binary": (bytes(range(256)) * 8, {}, "binary or damaged"),
    "NUL within": ("t,u,y\n1,2,3\n2,\0 3,4\n", {}, "line 3.*NUL"),
    "Excel named as text": (b"PK\x03\x04" + b"\0" * 99, {}, "Excel.*xlsx"),
    "wrong encoding given": ("t,u,µ\n1,2,3\n2,3,4\n".encode("cp1252"), {"encoding": "utf-8"}, "not text in utf-8"),
    "unknown encoding given": ("1,2\n2,3\n", {"encoding": "klingon"}, "no encoding 'klingon'"),
    "thousands or decimals (comma)": ("1,234;1,500\n2,345;2,500\n", {}, "ambiguous.*decimal="),
    "thousands or decimals (quoted)": ('"1,234","1,500"\n"2,345","2,500"\n', {}, "ambiguous.*decimal="),
    "thousands or decimals (dot)": ("1.234;0,5\n2.345;0,7\n", {}, "line 1.*ambiguous.*decimal="),
    "comma twice, by the names": ("t,y\n0,10,1,20\n0,20,1,35\n0,30,1,41\n", {}, "ambiguous.*delimiter="),
    "comma twice, by zeros": ("0,05,1,20\n0,10,1,35\n0,15,1,41\n", {}, "ambiguous.*delimiter="),
    "comma twice, by spaces": ("0,5, 1,20\n0,6, 1,35\n0,7, 1,41\n", {}, "ambiguous.*delimiter="),
    "day or month": ("01/02/2024 10:00:00,1,2\n01/03/2024 10:00:00,2,3\n", {"time": 0}, "ambiguous.*day or month"),
    "no such day": ("2024-02-30 10:00:00,1,2\n2024-02-31 10:00:00,2,3\n", {"time": 0}, "not a valid date"),
    "two tables": ("1,2,3\n" * 10 + "1,2,3,4\n" * 6, {}, "line 11: 6 rows do not have the 3 cells"),
    "time runs back": ("t,u,y\n0,1,2\n1,2,3\n0.5,3,4\n2,4,5\n", {}, "line 4: time decreases from 1 to 0.5.*by="),
    "time stands still": ("t,u,y\n1,1,2\n1,2,3\n1,3,4\n", {"time": "t"}, "time is constant"),
    "input missing within": ("t,u,y\n0,1,2\n1,,3\n2,3,4\n", {}, r"missing in 1 rows.*line 3.*gaps='split'"),
    "infinite input": ("t,u,y\n0,1,2\n1,inf,3\n2,3,4\n", {}, "line 3"),
    "no input at all": ("t,u,y,z\n0,,2,1\n1,,3,2\n2,,1,3\n", {"input": "u"}, "'u' for input is empty"),
    "unknown column": ("t,u,y\n0,1,2\n1,2,3\n", {"input": "voltage"}, "no column 'voltage' for input.*0: 't'"),
    "number too high": ("t,u,y\n0,1,2\n1,2,3\n", {"output": 7}, "output column 7.*there are 3"),
    "name given twice in the file": (
        "t,u,y,y\n0,1,2,4\n1,2,3,3\n",
        {"output": "y"},
        "2 columns.*numbers 2, 3.*by number",
    ),
    "text column as input": ("t,k,y\n0,a,2\n1,b,3\n", {"input": "k"}, "'k' for input is text \\('a'\\)"),
    "header without measurements": (
        "MicroMag 2900/3900 Data File (Series 0016.002)\n\nSETTINGS\nHb1   -60.0E-03\nHb2   +60.0E-03\nHNcr   +8.0E-03\nHSat   +1.7E+00\n",
        {},
        "for input is text \\('Hb1'\\)",
    ),
    "same column twice": ("t,u,y\n0,1,2\n1,2,3\n", {"input": "u", "output": "u"}, "same column"),
    "time is also input": (
        "t,u,y\n0,1,2\n1,2,3\n",
        {"input": "t", "time": "t", "output": "y"},
        "cannot be time and input",
    ),
    "wrong delimiter given": ("t,u,y\n0,1,2\n1,2,3\n", {"delimiter": ";"}, "no row of numbers"),
    "wrong decimal given": ("0,1\n1,2\n", {"decimal": "x"}, "decimal mark must be"),
    "gaps unknown": ("0,1\n1,2\n", {"gaps": "fill"}, "gaps must be"),
    "only without curves": ("0,1\n1,2\n", {"only": "0"}, "one curve.*by="),
    "by without such a column": ("0,1\n1,2\n", {"by": "loop"}, "no column 'loop' for by"),
    "sheet of a text": ("0,1\n1,2\n", {"sheet": 0}, "no sheets"),
    "where finds nothing": ("k,u,y\na,1,2\na,2,3\n", {"where": "k=b"}, "no row has k = 'b'.*a"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_file_is_refused_with_advice(case: str, tmp_path: Path) -> None:
    content, arguments, message = BAD[case]
    path = _write(tmp_path, content)
    with pytest.raises(DataError, match=rf"(?s){message}"):
        read(path, **arguments)


def test_files_are_recognized_by_content_and_missing_or_damaged_ones_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        read(tmp_path / "nothing.csv")
    with pytest.raises(DataError, match="is a folder"):
        read(tmp_path)
    for suffix in (".docx", ".hys", ".000", ".mat", ".npz", ".npy", ".xlsx", ".h5", ""):
        assert len(read(_write(tmp_path, "0,1\n1,2\n", "a" + suffix))) == 2  # the ending of a text does not matter
        with pytest.raises(DataError, match=r"damaged|cannot be read"):
            read(_write(tmp_path, b"\x89HDF" + bytes(range(64)), "a" + suffix))
        with pytest.raises(DataError, match="empty"):
            read(_write(tmp_path, b"", "a" + suffix))


def test_everything_left_out_is_counted(tmp_path: Path) -> None:
    text = "made by hand\nt,u,y\n0,1,2\n# pause\n1,2,nan\n2,3\nt,u,y\n3,4,5\n3,5,6\nthe end\n"
    table = table_of(_write(tmp_path, text))
    assert table.left_out == {
        "metadata": 1,
        "comment line": 1,
        "row with another number of cells than 3": 1,
        "repeated header": 1,
        "line with text where numbers are expected": 1,
    }
    assert table.line.tolist() == [3, 5, 8, 9]
    assert table.rows + sum(table.left_out.values()) + 1 == len(text.splitlines())
    notes = read(tmp_path / "file.csv").notes  # type: ignore[union-attr]
    assert sum(note.code is Code.LEFT_OUT for note in notes) == 4
    assert sum(note.code is Code.COLUMN_CHOICE for note in notes) == 3
    assert next(note.text for note in notes if note.code is Code.TIME_STEPS).endswith("line 9; kept")
    assert has(notes, Code.MISSING_VALUES)
    plain = read(_write(tmp_path, "t,u,y\n" + _rows(","), "plain.csv"))
    assert not has(plain.notes, Code.LEFT_OUT, Code.TIME_STEPS, Code.MISSING_VALUES, Code.CURVES)  # type: ignore[union-attr]


CURVES = "loop,kind,u,y\n1,up,0,1\n1,up,1,2\n1,down,0.5,3\n2,up,0,4\n2,up,2,5\n5,up,0,6\n5,down,3,7\n9,up,1,1\n"


def test_curves_by_a_column(tmp_path: Path) -> None:
    path = _write(tmp_path, CURVES)
    data = read(path, by="loop")
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == ["loop=1", "loop=2", "loop=5"]
    assert [record.u.tolist() for record in data] == [[0, 1, 0.5], [0, 2], [0, 3]]
    assert sum("loop=9" in note.text for note in data[0].notes if note.code is Code.LEFT_OUT) == 1
    assert [r.name for r in read(path, by="loop", only="5,1")] == ["loop=5", "loop=1"]  # type: ignore[union-attr]
    assert [r.name for r in read(path, by="loop", only=[2.0])] == ["loop=2"]  # type: ignore[union-attr]
    assert [r.name for r in read(path, by=0, only="1::2")] == ["loop=2"]  # type: ignore[union-attr]
    assert [r.name for r in read(path, by="kind")] == ["kind=up", "kind=down"]  # type: ignore[union-attr]
    up = read(path, by="loop", where={"kind": "up"})
    assert [r.y.tolist() for r in up] == [[1, 2], [4, 5]]  # type: ignore[union-attr]
    assert has(read(path).notes, Code.CURVES)  # type: ignore[union-attr]
    for only, message in (("3", "no curve 3; there are 1, 2, 5"), ("7:", "chooses none of 3"), ("::0", "step")):
        with pytest.raises(DataError, match=message):
            read(path, by="loop", only=only)


def test_single_rows_between_blank_lines_are_calibration_points(tmp_path: Path) -> None:
    path = _write(tmp_path, "H,M\n9,1.5\n\n0,1\n1,2\n\n9,1.25\n\n0,3\n2,4\n3,5\n")
    data = read(path)
    assert isinstance(data, Dataset)
    assert [record.u.tolist() for record in data] == [[9, 0, 1], [9, 0, 2, 3]]
    assert [record.weight.tolist() for record in data] == [[0, 1, 1], [0, 1, 1, 1]]
    assert sum(note.code is Code.CURVES for note in data["curve=1"].notes) == 2  # the curves, and their calibration
    assert [len(record) for record in read(path, only="1")] == [4]  # type: ignore[union-attr]
    apart = read(_write(tmp_path, "H,M\n9,1.5\n\n0,1\n1,2\n\n1,1.25\n\n0,3\n2,4\n3,5\n"))  # at no common input
    assert [record.u.tolist() for record in apart] == [[0, 1], [0, 2, 3]]  # type: ignore[union-attr]


def _reversal_rows(curves: int = 6) -> list[tuple[int, str, float, float]]:
    """Number, kind, field and moment of the rows of reversal curves, a calibration point at 100 before each."""
    rows = []
    for k in range(curves):
        rows.append((k + 1, "cal", 100.0 + 0.1 * (k % 2), 5.0 + 0.01 * k))
        rows += [
            (k + 1, "forc", field, 0.01 * field - 0.1 * k)
            for field in np.linspace(40.0 - 9 * k, 60.0 + 2 * k, 12).round(3)
        ]
    return rows


MICROMAG = """MicroMag 2900/3900 Data File (Series 0015)
First-order reversal curves
Configuration   :  VSM
Units of measure:  {system}
Temperature in  :  Kelvin

HCal           = +1.000000E+02
NCrv           = 6

"""
NEW_MICROMAG = """MicroMag 2900/3900 Data File (Series 0016.002)
First-order reversal curves

INSTRUMENT
Configuration                   VSM
Units of measure                Hybrid SI

SAMPLE
Mass                           +12.50000E-03
Volume                          N/A

    Field        Moment
     (T)         (A\u00b7m\u00b2)

"""


def _reversal_file(layout: str) -> tuple[str, str]:
    """Name and content of a file of reversal curves."""
    rows, blocks = _reversal_rows(), []
    for _, curve in itertools.groupby(rows, key=lambda row: row[:2]):
        blocks.append("".join(f"{u:+.6E},{y:+.6E}\n" for _, _, u, y in curve))
    if layout in ("a.forc", "a.frc", "a"):
        return layout, MICROMAG.format(system="cgs") + "\n".join(blocks) + "\nMicroMag 2900/3900 Data File ends\n"
    if layout == "new.frc":
        return layout, NEW_MICROMAG + "\n".join(blocks) + "\nMicroMag 2900/3900 Data File ends\n"
    lines = {
        "kinds and numbers": ["curve,kind,H_Oe,M_emu"] + [f"{k},{kind},{u},{y}" for k, kind, u, y in rows],
        "kinds": ["kind,H_Oe,M_emu"]
        + [f"{'Calibration' if kind == 'cal' else 'curve'},{u},{y}" for _, kind, u, y in rows],
        "flags": ["H_Oe,M_emu,is_cal"] + [f"{u},{y},{int(kind == 'cal')}" for _, kind, u, y in rows],
        "no marks": ["H_Oe,M_emu"] + [f"{u},{y}" for _, _, u, y in rows],
    }[layout]
    return "file.csv", "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("layout", "units"),
    [(name, ("Oe", "emu")) for name in ("a.forc", "a.frc", "a", "kinds and numbers", "kinds", "flags", "no marks")]
    + [("new.frc", ("T", "Am2"))],
)
def test_reversal_curves_with_calibration_points_in_every_layout(
    layout: str, units: tuple[str, str], tmp_path: Path
) -> None:
    name, content = _reversal_file(layout)
    data = read(_write(tmp_path, content.encode("cp1252"), name))
    assert isinstance(data, Dataset)
    rows = _reversal_rows()
    assert len(data) == 6
    for number, record in enumerate(data, 1):
        expected = np.array([row[2:] for row in rows if row[0] == number])
        np.testing.assert_allclose(np.column_stack([record.u, record.y]), expected, rtol=1e-6)
        assert record.weight.tolist() == [0.0] + [1.0] * 12
        assert (record.u_unit, record.y_unit) == units
        assert sum(note.code is Code.CURVES for note in record.notes) <= 3
    assert all(record.notes == data[0].notes for record in data)  # no note for each curve
    assert recognize_family(data) is not None
    if layout == "kinds and numbers":
        assert [record.name for record in data] == [f"curve={k}" for k in range(1, 7)]
        assert [len(record) for record in read(tmp_path / name, where="kind=forc", by="curve")] == [12] * 6  # type: ignore[union-attr]
    if layout == "new.frc":
        assert data[0].metadata == {"Mass": "+12.50000E-03"}


def test_a_loop_with_a_text_column_of_states_has_no_calibration_points(tmp_path: Path) -> None:
    lines = ["state,H,M"] + [
        f"{'sat' if k < 20 else 'sweep'},{u:.3f},{u:.3f}" for k, u in enumerate(np.sin(np.arange(60) / 4))
    ]
    assert isinstance(read(_write(tmp_path, "\n".join(lines))), Record)
    noisy = np.random.default_rng(0).normal(size=(60, 2)).round(4).tolist()
    assert isinstance(read(_write(tmp_path, "H,M\n" + "".join(f"{u},{y}\n" for u, y in noisy))), Record)


SECTIONS = """[Header]
; a magnetometer
TITLE,film 7
INFO,12.5,SAMPLE_MASS
INFO,,SAMPLE_MATERIAL
INFO,"(1.0, 2.0, 0.5)",SAMPLE_SIZE
DATATYPE,TIME,2
[Data]
Comment,Time Stamp (sec),Temperature (K),Magnetic Field (Oe),Moment (emu),M. Std. Err. (emu),Coil Signal (mV)
touchdown,0,300.1,,,,
,1,300.2,-2,0.25,0.001,3.5
,2,300.1,1,0.5,0.002,3.75
new range,3,300.3,,,,
,4,300.1,2.5,,,3.25
,5,300.1,3,0.75,0.001,4.5
,6,300.0,,,,
"""


def test_files_of_sections_keep_sizes_and_masses_and_omit_rows_without_a_measurement(tmp_path: Path) -> None:
    record = read(_write(tmp_path, SECTIONS, "a.dat"))
    assert isinstance(record, Record)
    np.testing.assert_array_equal(record.u, [-2, 1, 2.5, 3])
    np.testing.assert_array_equal(record.y, [0.25, 0.5, np.nan, 0.75])
    assert (record.u_unit, record.y_unit) == ("Oe", "emu")
    assert record.metadata == {"SAMPLE_MASS": "12.5", "SAMPLE_SIZE": "(1.0, 2.0, 0.5)"}
    save_records(tmp_path / "records.npz", Dataset.of(record))
    assert load_records(tmp_path / "records.npz")[0].metadata == record.metadata
    assert all(note.severity is Severity.INFO for note in record.notes)
    assert sum("without input and output" in note.text for note in record.notes) == 1
    other = read(_write(tmp_path, "# Gauge length: 25 mm\n# Sample rate: 200\nwidth,height\n1,2\n2,3\n1,4\n", "b.csv"))
    assert other.metadata == {"Gauge length": "25 mm"}  # type: ignore[union-attr]
    plain = SECTIONS.partition("[Data]\n")[2]  # without sections only rows with a comment are no samples
    with pytest.raises(DataError, match="missing"):
        read(_write(tmp_path, plain.replace("new range", "")))


HEADERS = {  # encoding: headers of a time, an input and an output
    "gbk": [
        "时间(s),电压(V),位移(μm)",
        "时间（秒）,输入电压（V）,输出位移（μm）",
        "时间,磁场强度(Oe),磁矩(emu)",
        "t_s,位移(mm),力(kN)",
    ],
    "shift_jis": [
        "時間(s),電圧(V),変位(μm)",
        "時間[秒],ひずみ,応力[MPa]",
        "t_s,変位[mm],荷重[kN]",
        "t_s,x_mm,力[N]",
        "ﾃﾞｰﾀ時間,電圧,変位",
    ],
    "big5": ["時間(s),電壓(V),位移(mm)", "時間,應變,應力"],
    "euc_kr": ["시간(s),전압(V),변위(mm)"],
    "euc_jp": ["時間(s),電圧(V),変位(μm)"],
    "cp1251": ["Время (с);Напряжение (В);Перемещение (мкм)", "время;ход;сила"],
    "utf-16-le": ["时间(s),电压(V),位移(μm)", "時間一二三四五六七八九十十一十二十三,電圧,変位"],
    "utf-16-be": ["時間(s),電圧(V),変位(μm)"],
    "cp1252": ["t_s;Spannung_V;y_µm", "Größe (s),Kraft (N),Höhe (mm)", "Temps (s),Déplacement (µm),Température (°C)"],
}


@pytest.mark.parametrize("encoding", HEADERS)
@pytest.mark.parametrize("rows", [3, 40, 2000])
def test_encodings_are_recognized_from_short_headers(encoding: str, rows: int, tmp_path: Path) -> None:
    values = np.column_stack([np.arange(rows) * 0.5, np.sin(np.arange(rows)), np.cos(np.arange(rows) / 3.0)]).round(6)
    for header in HEADERS[encoding]:
        mark = ";" if ";" in header else ","
        text = header + "\n" + "".join(mark.join(map(repr, row)) + "\n" for row in values.tolist())
        table = table_of(_write(tmp_path, text.encode(encoding)))
        assert list(table.names) == header.split(mark)
        assert sum("encoding" in note.text for note in table.notes) == 1
        np.testing.assert_array_equal(np.column_stack(table.columns), values)


def test_an_encoding_that_cannot_be_recognized_is_refused_and_can_be_given(tmp_path: Path) -> None:
    path = _write(tmp_path, "编组甲,编组乙\n1,2\n2,3\n3,1\n".encode("gbk"))
    with pytest.raises(DataError, match="--encoding"):
        read(path)
    assert read(path, encoding="gbk").u_name == "编组甲"  # type: ignore[union-attr]


def test_header_repeated_where_time_starts_again_begins_a_curve(tmp_path: Path) -> None:
    data = read(_write(tmp_path, "t,u,y\n0,1,2\n1,2,3\nt,u,y\n0,4,5\n1,5,6\n"))
    assert [record.u.tolist() for record in data] == [[1, 2], [4, 5]]  # type: ignore[union-attr]


def test_gaps_split_into_pieces(tmp_path: Path) -> None:
    data = read(_write(tmp_path, "t,u,y\n0,1,2\n1,2,3\n2,,4\n3,4,5\n4,5,nan\n5,,7\n6,1,1\n"), gaps="split")
    assert isinstance(data, Dataset)
    assert [record.t.tolist() for record in data] == [[0, 1], [3, 4]]
    assert sum(note.code is Code.LEFT_OUT for note in data[0].notes) == 2  # rows without input, a piece of one row


def test_units_of_the_user_are_no_assumption(tmp_path: Path) -> None:
    rows = np.column_stack([np.sin(np.arange(40.0)), np.cos(np.arange(40.0))])
    np.savetxt(tmp_path / "loop.csv", rows, delimiter=",")
    record = read(tmp_path / "loop.csv", units="V,um")
    assert (record.u_unit, record.y_unit) == ("V", "um")
    assert np.array_equal(record.u, rows[:, 0])
    texts = [note.text for note in record.notes if note.code is Code.UNITS]
    assert len(texts) == 2
    assert all("chosen by the user" in text and "assumed" not in text for text in texts)


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("t_s", ("t", "s")),
        ("H_A_per_m", ("H", "A/m")),
        ("Sigma_true", ("Sigma_true", "")),
        ("x_min", ("x_min", "")),
        ("v_in", ("v_in", "")),
        ("x_in", ("x", "in")),
        ("Load in kN", ("Load", "kN")),
        ("1-1(位移/mm)", ("1-1 位移", "mm")),
        ("Ewe (V vs. SCE)", ("Ewe", "V vs. SCE")),
        ("Kraft / kN", ("Kraft", "kN")),
        ("x[0]", ("x[0]", "")),
        ("x[1]", ("x[1]", "")),
        ("strain [1]", ("strain", "")),
        ("电压（V）", ("电压", "V")),
        ("変位 [μm]", ("変位", "μm")),
        ("P (µC/cm^2)", ("P", "µC/cm^2")),
        ("P_uC_cm2", ("P", "uC/cm2")),
        ("H_kA_m", ("H", "kA/m")),
        ("H_A_m", ("H", "A/m")),
        ("E_kV_cm", ("E", "kV/cm")),
        ("M_emu_g", ("M", "emu/g")),
        ("M_emu_cm3", ("M", "emu/cm3")),
        ("sigma_Am2_kg", ("sigma", "Am2/kg")),
        ("J_A_m2", ("J", "A/m2")),
        ("d33_pm_V", ("d33", "pm/V")),
        ("v_mm_s", ("v", "mm/s")),
        ("tau_N_mm2", ("tau", "N/mm2")),
        ("x_um", ("x", "um")),
        ("H_kA/m", ("H", "kA/m")),
        ("Velocity_m/s", ("Velocity", "m/s")),
        ("P_µC/cm²", ("P", "µC/cm²")),
        ("M_emu/g", ("M", "emu/g")),
        ("U_A/V", ("U_A", "V")),
        ("F_max/N", ("F_max", "N")),
        ("x_A_m", ("x_A", "m")),
        ("loop_id_a", ("loop_id_a", "")),
        ("stage_a_b", ("stage_a_b", "")),
        ("Moment (A·m²)", ("Moment", "A·m²")),
    ],
)
def test_units_in_names(header: str, expected: tuple[str, str]) -> None:
    assert split_unit(header) == expected


@pytest.mark.parametrize(
    ("header", "kind"),
    [("V", "voltage"), ("v_in_per_s", "velocity"), ("BmeasT", "induction"), ("Lead Actuator Displacment", "displacement"),
     ("e_true", "strain"), ("MeasResult1_time", "time"), ("loop", "index"), ("foo", ""),
     ("Magnetic Field (Oe)", "field"), ("Moment (emu)", "moment"), ("Moment (kNm)", "force"), ("M. Std. Err. (emu)", "error"),
     ("Coil Signal' (mV)", "voltage"), ("Position (V)", "displacement"), ("M_kA_m", "magnetization"), ("mu0 H field (T)", "field"),
     ("H_T", "field"), ("P_uC_cm2", "polarization"), ("E_kV_cm", "electric field"), ("Frequency (Hz)", "frequency"),
     ("Temp_C", "temperature"), ("电压 (V)", "voltage"), ("荷重[kN]", "force"), ("напряжение_кВ", "voltage"),
     ("VSM Status (code)", "status")],
)  # fmt: skip
def test_quantities_of_names(header: str, kind: str) -> None:
    assert column_quantity(header) == kind


ASKED = ("CH0,CH1,CH2", "t_s,channel 1,channel 2,channel 3", "sensor1,sensor2,sensor3")


@pytest.mark.parametrize("header", ASKED)
def test_channels_that_nothing_tells_apart_are_a_question(header: str, tmp_path: Path) -> None:
    """Three channels without names: the error has two readings to copy."""
    rng, count = np.random.default_rng(0), header.count(",") + 1
    table = rng.normal(size=(40, count))
    if header.startswith("t_s"):
        table[:, 0] = np.arange(40)
    path = _write(tmp_path, header + "\n" + "\n".join(",".join(f"{v:.5f}" for v in row) for row in table) + "\n")
    with pytest.raises(DataError) as asked:
        read(path)
    assert str(asked.value).count("--input") == str(asked.value).count("--output") == 2


@pytest.mark.parametrize(
    "header", ["Force (V),Force (N),Displacement (V),Displacement (mm)", "x (V),x (mm),F (V),F (N)"]
)
def test_physical_units_come_before_the_volts_of_their_sensors(header: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = "\n".join(",".join(f"{v:.5f}" for v in row) for row in rng.normal(size=(40, 4)))
    record = read(_write(tmp_path, f"{header}\n{rows}\n"))
    assert (record.u_unit, record.y_unit) == ("mm", "N")  # type: ignore[union-attr]


@pytest.mark.parametrize("swapped", [False, True])
def test_of_two_columns_without_names_the_clean_wave_drives(swapped: bool, tmp_path: Path) -> None:
    x = np.linspace(0, 6 * np.pi, 600)
    columns = [np.sin(x), np.tanh(4 * np.sin(x - 0.4))]
    rows = "\n".join(f"{a:.6f},{b:.6f}" for a, b in zip(*columns[:: -1 if swapped else 1], strict=True))
    record = read(_write(tmp_path, rows + "\n"))
    np.testing.assert_allclose(record.u, columns[0], atol=1e-6)  # type: ignore[union-attr]


def test_a_loop_of_unnamed_columns_that_leads_is_named(tmp_path: Path) -> None:
    """Plays over their input lag; exchanged, the loop runs the other way."""
    x = np.linspace(0, 4 * np.pi, 60)
    for columns, leads in (((np.sin(x), np.sin(x - 0.5)), False), ((np.sin(x - 0.5), np.sin(x)), True)):
        rows = "\n".join(f"{a:.6f},{b:.6f}" for a, b in zip(*columns, strict=True))
        record = read(_write(tmp_path, rows + "\n"))
        warned = [
            note for note in record.notes if note.code is Code.COLUMN_CHOICE and note.severity is Severity.WARNING
        ]  # type: ignore[union-attr]
        assert bool(warned) == leads


def test_loops_at_several_temperatures_or_in_two_modes_are_named(tmp_path: Path) -> None:
    """A magnetometer changes its temperature between loops or within one, or its way of extracting the moment."""
    x = np.linspace(0, 4 * np.pi, 200)
    field, moment, steady = 1e4 * np.cos(x), np.tanh(3 * np.cos(x - 0.3)), 300 + 0.01 * np.sin(9 * x)
    late = x > 2 * np.pi

    def named(temperature: np.ndarray, modes: bool) -> list[str]:
        one = [f"{value:.6f}" if not (modes and other) else "" for value, other in zip(moment, late, strict=True)]
        two = [f"{value:.6f}" if modes and other else "" for value, other in zip(moment, late, strict=True)]
        rows = zip(temperature, field, one, two, strict=True)
        head = "Temperature (K),Field (Oe),DC Moment Fixed Ctr (emu),DC Moment Free Ctr (emu)\n"
        data = Dataset.of(read(_write(tmp_path, head + "".join(f"{t:.3f},{h:.3f},{a},{b}\n" for t, h, a, b in rows))))
        told = [note.text for record in data for note in record.notes if note.code is Code.CONDITIONS]
        return told or [record.name for record in data if len(data) > 1]

    assert not named(steady, modes=False)
    assert not named(300 + 3 * np.random.default_rng(0).standard_normal(200), modes=False)  # noise of a thermostat
    assert named(np.where(late, steady - 250, steady), modes=False) == ["Temperature=300", "Temperature=50"]
    (text,) = named(np.linspace(50, 300, 200), modes=False)
    assert "to 300 K within" in text
    (text,) = named(steady, modes=True)
    assert text.startswith("100 rows hold 'DC Moment ")


COLUMNS = {  # header: (input, output) among all columns of changing numbers
    "Coil (mV),Field (Oe),Moment (emu)": (1, 2),
    "T_K,M_emu,H_Oe,M. Std. Err. (emu)": (2, 1),
    "Min. Field (Oe),Field (Oe),M. Raw' (emu),Moment (emu)": (1, 3),
    "Frequency (Hz),Field (Oe),DC Moment Fixed Ctr (emu),DC Moment Free Ctr (emu)": (1, 2),
    "sequence,T_degC,B_T,H_A_m,known": (3, 2),
    "E_kV_cm,P_uC_cm2,I_mA": (0, 1),
    "I_mA,P_uC_cm2,U_V": (2, 1),
    "F_kN,x_mm,eps,sigma_MPa": (2, 3),
    "F_kN,T_degC,x_mm": (2, 0),
    "Position (V),Voltage (V)": (1, 0),
    "Temp_C,Status,Voltage (V),Displacement (um)": (2, 3),
    "I_A,x_mm,F_N": (1, 2),
    "I_A,B_T": (0, 1),
    "Velocity_m/s,Force_N": (0, 1),
    "B_mT,H_kA/m": (1, 0),
    "theta (m3/m3),suction (kPa)": (1, 0),
    "OCV_V,SOC_%": (1, 0),
    "Voltage (V),Capacity (mAh)": (1, 0),
    "Voltage(V),Q(Ah)": (1, 0),
    "温度（℃）,位移（μm）,电压（V）": (2, 1),
    "荷重(kN),変位(mm)": (1, 0),
    "y,x": (1, 0),
    "foo,bar": (0, 1),
    "T_degC,foo,bar": (1, 2),
}


@pytest.mark.parametrize("header", COLUMNS)
def test_columns_are_guessed_by_their_quantities(header: str, tmp_path: Path) -> None:
    count = header.count(",") + 1
    rows = np.random.default_rng(1).normal(size=(20, count)).round(6).tolist()
    record = read(_write(tmp_path, header + "\n" + "".join(",".join(map(str, row)) + "\n" for row in rows)))
    chosen = COLUMNS[header]
    np.testing.assert_array_equal(np.column_stack([record.u, record.y]), np.array(rows)[:, chosen])  # type: ignore[union-attr]
    assert sum(note.code is Code.COLUMN_CHOICE for note in record.notes) == 2  # type: ignore[union-attr]
    other = read(tmp_path / "file.csv", input=chosen[1], output=chosen[0], time=False)
    np.testing.assert_array_equal(np.column_stack([other.u, other.y]), np.array(rows)[:, chosen[::-1]])  # type: ignore[union-attr]


def test_columns_of_one_matrix_are_guessed_like_columns_without_names(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "a.mat", {"data": np.column_stack([T, U, Y])})
    record = read(tmp_path / "a.mat")
    np.testing.assert_array_equal(np.stack([record.t, record.u, record.y]), [T, U, Y])  # type: ignore[union-attr]


def test_a_column_that_is_the_rate_of_the_input_is_not_taken_for_the_output(tmp_path: Path) -> None:
    t = np.linspace(0.0, 4.0, 201)
    x, v, f = np.sin(t**2), 2 * t * np.cos(t**2), np.sin(t**2 - 0.4) + 0.3 * np.cos(t**2)
    np.savetxt(tmp_path / "a.txt", np.column_stack([t, x, v, f]))
    record = read(tmp_path / "a.txt")
    np.testing.assert_array_equal(np.stack([record.t, record.u, record.y]), [t, x, f])  # type: ignore[union-attr]


def test_a_column_without_a_name_that_repeats_the_input_is_not_taken_for_the_output(tmp_path: Path) -> None:
    """A log of a controller: the command, its last turning value (the command itself on half of the way), the sensor."""
    command = np.abs((np.arange(240) * 0.05) % 6 - 3)
    kept = np.where(np.diff(command, prepend=command[0]) <= 0, command, 3.0)
    sensor = np.interp(command, [0, 3], [10, 40]) + 4 * np.sign(np.gradient(command))
    np.savetxt(
        tmp_path / "log.dat", np.column_stack([command, kept, kept, 0 * command, sensor]), fmt="%.4f", delimiter="\t"
    )
    record = read(tmp_path / "log.dat")
    np.testing.assert_allclose(np.stack([record.u, record.y]), [command, sensor], atol=1e-4)  # type: ignore[union-attr]
    assert any("column 2 repeats column" in note.text for note in record.notes)  # type: ignore[union-attr]


def test_binary_formats_hold_the_same_record(tmp_path: Path) -> None:
    import h5py
    import openpyxl

    t, u, y = (np.array(values) for values in (T, U, Y))
    np.savez(tmp_path / "a.npz", t_s=t, u_V=u, y_um=y, gain=np.array(3.0), other=np.arange(7.0))
    np.save(tmp_path / "a.npy", np.column_stack([t, u, y]))
    scipy.io.savemat(tmp_path / "a.mat", {"data": {"t_s": t, "u_V": u, "y_um": y}, "who": "Kim"})
    for name in ("a.h5", "b.mat"):
        with h5py.File(tmp_path / name, "w", userblock_size=512 if name == "b.mat" else 0) as file:
            for key, values in (("t_s", t), ("u_V", u), ("y_um", y)):
                file[key] = values[:, None].T  # MATLAB 7.3 stores a column as (1, N)
    with open(tmp_path / "b.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(128))
    book = openpyxl.Workbook()
    book.active.title = "about"  # type: ignore[union-attr]
    book.active["A1"] = "made by hand"  # type: ignore[index]
    page = book.create_sheet("run 1")
    for row in (["my loop"], ["t", "u", "y"], ["s", "V", "um"], *zip(T, U, Y, strict=True)):
        page.append(list(row))
    book.save(tmp_path / "a.xlsx")
    for name in ("a.npz", "a.mat", "a.h5", "b.mat", "a.xlsx"):
        record = read(tmp_path / name)
        assert isinstance(record, Record)
        np.testing.assert_array_equal(np.stack([record.t, record.u, record.y]), [T, U, Y])  # type: ignore[arg-type]
        assert (record.t_unit, record.u_unit, record.y_unit) == ("s", "V", "um")
    array = read(tmp_path / "a.npy")
    np.testing.assert_array_equal(np.stack([array.t, array.u, array.y]), [T, U, Y])  # type: ignore[union-attr]
    assert has(read(tmp_path / "a.npz").notes, Code.LEFT_OUT)  # type: ignore[union-attr]
    with pytest.raises(DataError, match="no sheet 'run 2'; there are about, run 1"):
        read(tmp_path / "a.xlsx", sheet="run 2")
    with pytest.raises(DataError, match="no rows of numbers in 'about'"):
        read(tmp_path / "a.xlsx", sheet=0)
    np.savez(tmp_path / "c.npz", B=np.ones((9, 3)) * np.arange(9.0)[:, None] ** [1, 2, 3])
    with pytest.raises(DataError, match="every column is 'B'"):
        read(tmp_path / "c.npz")


def test_many_rows_are_read_to_the_last_digit(tmp_path: Path) -> None:
    rows = np.column_stack([np.arange(200_000) * 0.005, np.random.default_rng(0).normal(size=(200_000, 2))])
    path = tmp_path / "long.csv"
    path.write_text("t_s,u_V,y_um\n" + "".join(f"{a:.3f},{b!r},{c!r}\n" for a, b, c in rows.tolist()))
    record = read(path)
    np.testing.assert_array_equal(record.u, rows[:, 1])  # type: ignore[union-attr]
    np.testing.assert_array_equal(record.y, rows[:, 2])  # type: ignore[union-attr]


NUMBERS = st.floats(allow_nan=False, allow_infinity=False, width=64)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS), min_size=3, max_size=30),
    mark=st.sampled_from([",", ";", "\t", "|", "  "]),
    comma=st.booleans(),
    header=st.sampled_from(["", "names", "names and units", "metadata"]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
    quoted=st.booleans(),
    end=st.sampled_from(["\n", "\r\n"]),
)
def test_what_is_written_is_read_back(
    tmp_path: Path, rows: list, mark: str, comma: bool, header: str, encoding: str, quoted: bool, end: str
) -> None:
    comma, quoted = comma and mark != ",", quoted and mark not in ("  ",)
    point = "," if comma else "."
    cell = lambda v: f"{v:.17e}".replace(".", point)
    lines = [mark.join(f'"{cell(v)}"' if quoted else cell(v) for v in row) for row in rows]
    head = {
        "": [],
        "names": [mark.join(["one", "two", "three"])],
        "names and units": [mark.join(["one", "two", "three"]), mark.join(["mm", "kN", "µm"])],
        "metadata": ["Prüfstand 4", "Gain = 12.5", "", mark.join(["one", "two", "three"])],
    }[header]
    path = tmp_path / "file.dat"
    path.write_bytes((end.join(head + lines) + end).encode(encoding))
    table = table_of(path)
    np.testing.assert_array_equal(np.column_stack(table.columns), np.array(rows))
    assert table.names == (("one", "two", "three") if header else ("column 0", "column 1", "column 2"))
    assert table.units == (("mm", "kN", "µm") if header == "names and units" else ("", "", ""))


def _plain(path: Path) -> np.ndarray:
    return np.loadtxt(path, delimiter=",", skiprows=1)


def test_measured_piezo(measured: Path) -> None:
    for raw, tidy in (("Model_Vi_Do", "model"), ("Test_Vi_Do_Di", "test")):
        record = read(measured / "piezo_dbo" / f"{raw}.dat", input=0, output=4)
        told = _plain(measured / "tidy" / f"piezo_dbo_{tidy}.csv")
        np.testing.assert_array_equal(np.column_stack([record.u, record.y]), told[:, 1:])  # type: ignore[union-attr]
        again = read(measured / "tidy" / f"piezo_dbo_{tidy}.csv")
        np.testing.assert_array_equal(np.column_stack([again.t, again.u, again.y]), told)  # type: ignore[union-attr]
    guessed = read(measured / "piezo_dbo" / "Model_Vi_Do.dat")
    assert (guessed.u_name, guessed.y_name) == ("column 0", "column 4")  # type: ignore[union-attr]


def test_measured_magnetics(measured: Path) -> None:
    lines = (measured / "tidy" / "mag_forc_FeCo.csv").read_text().splitlines()[1:]
    rows = [line.split(",") for line in lines]
    curves: dict[str, list[list[float]]] = {}
    for curve, kind, field, moment in rows:
        if kind == "forc":
            curves.setdefault(curve, []).append([float(field), float(moment)])
    raw = read(measured / "mag_forc_pyforc" / "hchb_forc")
    tidy = read(measured / "tidy" / "mag_forc_FeCo.csv")
    chosen = read(measured / "tidy" / "mag_forc_FeCo.csv", by="curve", where="kind=forc")
    for data in (raw, tidy, chosen):
        assert isinstance(data, Dataset)
        assert len(data) == len(curves) == 152
        assert all(len(record) == record.used.sum() + (data is not chosen) for record in data)
        for record, points in zip(data, curves.values(), strict=True):
            np.testing.assert_array_equal(np.column_stack([record.u, record.y])[record.used], points)
            assert (record.u_unit, record.y_unit) == ("Oe", "emu")
    assert has(raw[0].notes, Code.CURVES)  # type: ignore[union-attr]
    for name in ("M130_27s", "MnZn_ferrite", "MnZn_HP_ferrite"):
        data = read(measured / "tidy" / f"mag_bh_{name}.csv", by="loop")
        for position, record in enumerate(data):
            for symbol, values in (("H", record.u), ("B", record.y)):
                path = measured / "mag_ja_bh" / f"{symbol}_{name}.mat"
                columns = scipy.io.loadmat(path)[f"{symbol}measT"]
                match = [
                    k for k in range(columns.shape[1]) if np.allclose(columns[:, k], values, rtol=1e-9, atol=1e-12)
                ]
                assert match, (name, position, symbol)
        with pytest.raises(DataError, match="input= and output="):
            read(measured / "mag_ja_bh" / f"H_{name}.mat")
        two = read(measured / "mag_ja_bh" / f"H_{name}.mat", input=0, output="HmeasT[1]")
        found = scipy.io.loadmat(measured / "mag_ja_bh" / f"H_{name}.mat")["HmeasT"]
        np.testing.assert_array_equal(two.y, found[:, 1])  # type: ignore[union-attr]


def test_measured_structures_and_steel(measured: Path) -> None:
    folder = measured / "struct_slotboom"
    for path in sorted(folder.glob("*.csv")):
        lines = [line.split(",") for line in path.read_text().splitlines()]
        numbers = np.array(
            [[float(c) for c in row] for row in lines if row[0].strip(" -").replace(".", "")[:1].isdigit()]
        )
        record = read(path)
        order = [1, 0] if path.name == "SPC1.csv" else [0, 1]
        np.testing.assert_array_equal(np.column_stack([record.u, record.y]), numbers[:, order])  # type: ignore[union-attr]
    record = read(folder / "SPC1.csv")
    assert (record.u_unit, record.y_unit) == ("mm", "kN")  # type: ignore[union-attr]
    for number in (1, 2, 3):
        path = measured / "steel_resspylab" / f"example_{number}.csv"
        record, told = read(path), _plain(path)
        np.testing.assert_array_equal(np.column_stack([record.u, record.y]), told[:, [0, -1]])  # type: ignore[union-attr]
        assert (record.t is not None) == (number == 3)  # type: ignore[union-attr]


def test_measured_dampers(measured: Path) -> None:
    for number in ("4.1", "4.2"):
        tidy = _plain(measured / "tidy" / f"mr_labcontrol_{number}.csv")
        record = read(measured / "tidy" / f"mr_labcontrol_{number}.csv")
        np.testing.assert_array_equal(np.column_stack([record.t, record.u, record.y]), tidy[:, [0, 1, 3]])  # type: ignore[union-attr]
        raw = read(
            measured / "mr_labcontrol" / f"data_simulation_{number}_MRdamper.mat",
            input="x_F[0]",
            output="x_F[2]",
            time="Tout",
        )
        np.testing.assert_allclose(np.column_stack([raw.u, raw.y]), tidy[:, [1, 3]], rtol=1e-12)  # type: ignore[union-attr]
    for path in sorted((measured / "mr_labcontrol").glob("*.mat")):
        arrays = scipy.io.loadmat(path)
        name = "x_FS" if "4.4" in path.name else "x_F"
        record = read(path, input=f"{name}[0]", output=f"{name}[2]", time=False)
        np.testing.assert_array_equal(np.column_stack([record.u, record.y]), arrays[name][:, [0, 2]])  # type: ignore[union-attr]
    for path in sorted((measured / "tidy").glob("friction_brfd_*.csv")):
        record = read(path)
        np.testing.assert_array_equal(np.column_stack([record.t, record.u, record.y]), _plain(path)[:, :3])  # type: ignore[union-attr]
        assert (record.t_unit, record.u_unit, record.y_unit) == ("s", "in", "kip")  # type: ignore[union-attr]


def test_measured_vibrating_sample_magnetometer(measured: Path) -> None:
    path = measured / "vsm_magmeas" / "VSM_MH.DAT"
    lines = path.read_text(encoding="cp1252").splitlines()
    names = lines[lines.index("[Data]") + 1].split(",")
    field, moment = names.index("Magnetic Field (Oe)"), names.index("Moment (emu)")
    rows = [line.split(",") for line in lines[lines.index("[Data]") + 2 :]]
    record = read(path)
    assert isinstance(record, Record)
    np.testing.assert_array_equal(record.u, [float(row[field]) for row in rows])
    np.testing.assert_array_equal(record.y, [float(row[moment] or "nan") for row in rows])
    assert (record.u_unit, record.y_unit) == ("Oe", "emu")
    # Besides the header, the columns that are the same in every row.
    constant = {names[k] for k in range(len(names)) if len({row[k] for row in rows}) == 1 and rows[0][k]}
    stated = {"SAMPLE_MASS": "54.86", "SAMPLE_SIZE": "(1.98, 1.99, 2.70)"}
    assert stated.items() <= record.metadata.items()
    assert set(record.metadata) - set(stated) <= constant
    assert all(note.severity is Severity.INFO for note in record.notes)


def test_measured_ferroelectric(measured: Path) -> None:
    path = measured / "ferro_hzo_forc" / "FORC_+3V_4m.csv"
    told = [
        line.split(",")[1:]
        for line in path.read_text(encoding="utf-8-sig").splitlines()
        if line.startswith("DataValue")
    ]
    data = read(path)
    assert isinstance(data, Dataset)
    assert [len(record) for record in data] == [5000]  # the instrument writes them twice
    rows, first = np.array(told, dtype=float)[:, :3], data[0]
    np.testing.assert_array_equal(rows[:5000], rows[5000:])
    np.testing.assert_array_equal(np.column_stack([first.u, first.y, first.t]), rows[:5000])  # type: ignore[arg-type]
    assert sum(note.code is Code.LEFT_OUT for note in first.notes) == 5  # kinds of lines, unused columns, the copy


@pytest.mark.parametrize(
    ("header", "pair"),
    [
        ("Wavelength (nm),Force (N)", (1, 0)),
        ("Capacitance (pF),Pressure (kPa)", (1, 0)),
        ("Time (s),Force (N),Resistance (kΩ)", (1, 2)),
        ("Torque (Nm),Output (mV/V)", (0, 1)),
        ("Load (N),Output voltage (mV)", (0, 1)),
        ("Displacement (mm),Output (V)", (0, 1)),
        ("Pressure (bar),Current (mA)", (1, 0)),
        ("Bias (V),Cp (pF),D", (0, 1)),
        ("time,field.header.seq,field.position0,field.effort0", (2, 3)),
        ("Moment (emu),Moment/Mass (emu/g),Field (Oe)", (2, 0)),
    ],
)
def test_what_drives_sensors_converters_and_joints(header: str, pair: tuple[int, int], tmp_path: Path) -> None:
    """By quantities alone, whatever the order of the columns; a column in other units is no second reading."""
    names, k = header.split(","), np.arange(80)
    columns = {pair[0]: 1 + np.sin(0.2 * k), pair[1]: 1500 + np.sin(0.2 * k - 0.3)}
    counted = {j: k for j, name in enumerate(names) if "time" in name.lower() or name.endswith("seq")}
    columns = (
        {j: 0.3 * columns[pair[1]] if "Mass" in name else 0.02 + 0.001 * np.cos(7 * k) for j, name in enumerate(names)}
        | columns
        | counted
    )
    text = "\n".join([header, *(",".join(f"{columns[j][n]:.6f}" for j in range(len(names))) for n in k)])
    record = read(_write(tmp_path, text))
    assert isinstance(record, Record)
    assert (record.u_name, record.y_name) == (names[pair[0]], names[pair[1]])


def test_a_field_that_is_held_is_not_the_input(tmp_path: Path) -> None:
    k = np.arange(80)
    rows = [
        f"{1000 + 0.01 * np.cos(5 * n):.3f},{250 + 60 * np.sin(0.1 * n):.3f},{np.tanh(3 * np.sin(0.1 * n - 0.3)):.5f}"
        for n in k
    ]
    record = read(_write(tmp_path, "\n".join(["Magnetic Field (Oe),Temperature (K),Moment (emu)", *rows])))
    assert isinstance(record, Record)
    assert record.u_name == "Temperature (K)"


def test_the_temperature_of_a_shape_memory_alloy_is_the_input(tmp_path: Path) -> None:
    """Beside its strain and resistance; not a room temperature, and not beside a drive."""
    k = np.arange(60)
    heat, room = 60 + 40 * np.sin(0.2 * k), 21 + 0.01 * k
    strain, ohm = np.cos(0.2 * k), 1 + 0.1 * np.cos(0.2 * k)

    def chosen(header: str, *columns: np.ndarray) -> tuple[str, str]:
        text = header + "\n" + "".join(",".join(f"{v:.5f}" for v in row) + "\n" for row in zip(*columns, strict=True))
        record = read(_write(tmp_path, text))
        assert isinstance(record, Record)
        return record.u_name, record.y_name

    assert chosen("T_degC,R_ohm,Strain_percent", heat, ohm, strain) == ("T_degC", "Strain_percent")
    assert chosen("T_degC,R_ohm,Strain_percent", room, ohm, strain)[0] != "T_degC"
    assert chosen("T_degC,Strain_percent,Stress_MPa", heat, strain, ohm) == ("Strain_percent", "Stress_MPa")
    assert chosen("T_degC,V,Strain_percent", heat, ohm, strain)[0] == "V"


# -- numbered curves -----------------------------------------------------------------------------------------------------


def _numbered(title: str, clock: bool, apart: bool) -> str:
    """Four loops of growing amplitude with their numbers; those that are not apart go on as one signal."""
    rows, time = [f"{'t_s,' * clock}{title},H (A/m),B (T)"], 0.0
    for number in range(4):
        phase = np.linspace(0, 2 * np.pi, 60) + (0.5 * np.pi * number if apart else 0.0)
        for H in (1 + number) * np.sin(phase):
            time += 0.01
            rows.append(f"{f'{time:.2f},' * clock}{number + 1},{H:.6f},{H**3 if apart else H + 0.2 * time:.6f}")
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize("title", ["curve", "Loop", "Schleife", "FORC"])
@pytest.mark.parametrize("clock", [True, False])
def test_numbered_curves_that_jump_are_records_of_their_own(title: str, clock: bool, tmp_path: Path) -> None:
    data = read(_write(tmp_path, _numbered(title, clock, apart=True)))
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == [f"{title}={k}" for k in (1, 2, 3, 4)]
    assert has(data[0].notes, Code.CURVES)


def test_numbered_cycles_of_one_experiment_stay_one_record(tmp_path: Path) -> None:
    for clock in (True, False):
        record = read(_write(tmp_path, _numbered("cycle", clock, apart=False)))
        assert isinstance(record, Record)
        assert any(note.option == ("by", "cycle") for note in record.notes)


def test_closed_loops_of_different_strokes_without_time_are_records_of_their_own(tmp_path: Path) -> None:
    phase = np.linspace(0, 2 * np.pi, 81)
    rows = [f"{a},{a * np.sin(p):.5f},{np.sin(p - 0.3):.5f}" for a in (1, 2, 3) for p in phase]
    data = read(_write(tmp_path, "loop,H,B\n" + "\n".join(rows) + "\n"))
    assert isinstance(data, Dataset)
    assert len(data) == 3


def test_closed_loops_of_different_heights_are_of_different_specimens_and_those_of_a_force_of_one(
    tmp_path: Path,
) -> None:
    phase = np.linspace(0, 2 * np.pi, 81)
    rows = [
        f"{k},{np.sin(p):.5f},{a * np.sin(p - 0.3):.5g}" for k, a in enumerate((60, 1e-5, 2e-5, 1.5e-5)) for p in phase
    ]
    data = read(_write(tmp_path, "loop,Field (T),Moment (emu)\n" + "\n".join(rows) + "\n"))
    assert isinstance(data, Dataset)
    assert len(data) == 4
    rows = [f"{k},{np.sin(p):.5f},{a * np.sin(p - 0.3):.5g}" for k, a in enumerate((60, 50, 40, 30)) for p in phase]
    assert isinstance(read(_write(tmp_path, "cycle,Drift (mm),Load (kN)\n" + "\n".join(rows) + "\n")), Record)


def test_a_column_of_the_amplitude_of_the_input_tells_loops_apart_and_is_no_input(tmp_path: Path) -> None:
    phase = np.linspace(0, 2 * np.pi, 81)
    rows = [f"{a},{a * np.sin(p):.5f},{a * np.sin(p - 0.3):.5f}" for a in (10, 20, 30) for p in phase]
    data = read(_write(tmp_path, "Amplitude (kV/cm),E (kV/cm),P (uC/cm2)\n" + "\n".join(rows) + "\n"))
    assert isinstance(data, Dataset)
    assert [float(np.ptp(record.u)) for record in data] == pytest.approx([20, 40, 60])
    # The amplitudes of a structural test are those of one specimen, which damage accumulates in.
    test = read(_write(tmp_path, "Amplitude (mm),Drift (mm),Load (kN)\n" + "\n".join(rows) + "\n"))
    assert isinstance(test, Record)
    assert not [note for note in test.notes if note.severity is Severity.WARNING]


def test_a_column_set_to_levels_is_named(tmp_path: Path) -> None:
    t = np.arange(400) / 100
    rows = [f"{a:.2f},{1.5 * (a // 2):g},{np.sin(9 * a):.5f},{np.cos(9 * a) * (1 + a // 2):.5f}" for a in t]
    record = read(_write(tmp_path, "t_s,current_A,x_mm,F_N\n" + "\n".join(rows) + "\n"))
    assert isinstance(record, Record)
    assert any(note.code is Code.CURVES and note.severity is Severity.WARNING for note in record.notes)
    assert len(read(tmp_path / "file.csv", where="current_A=1.5")) == 200


# -- matrices of loops ---------------------------------------------------------------------------------------------------


def _matrices() -> tuple[np.ndarray, np.ndarray]:
    """Inputs and outputs of three loops, a column each."""
    H = np.outer(np.sin(np.linspace(0, 7, 40)), [1.0, 2.0, 3.0])
    return H, np.tanh(H) + np.outer(np.cos(np.linspace(0, 7, 40)), [0.1, 0.2, 0.3])


def _check_loops(data: Record | Dataset, H: np.ndarray, B: np.ndarray) -> None:
    assert isinstance(data, Dataset)
    assert len(data) == H.shape[1]
    for k, record in enumerate(data):
        np.testing.assert_array_equal(record.u, H[:, k])
        np.testing.assert_array_equal(record.y, B[:, k])
        assert record.t is None


def test_a_matrix_of_inputs_and_one_of_outputs_are_loops_column_by_column(tmp_path: Path) -> None:
    H, B = _matrices()
    scipy.io.savemat(tmp_path / "both.mat", {"H": H, "B": B})
    _check_loops(read(tmp_path / "both.mat"), H, B)
    for name, matrix in (("H", H), ("B", B)):
        scipy.io.savemat(tmp_path / f"{name}.mat", {name: matrix})
        np.savetxt(tmp_path / f"{name}.csv", matrix, delimiter=",", fmt="%.17g")
    for suffix in ("mat", "csv"):
        _check_loops(read(f"{tmp_path}/H.{suffix}+{tmp_path}/B.{suffix}"), H, B)
    names = [f"{symbol}{k} ({unit})" for symbol, unit in (("H", "A/m"), ("B", "T")) for k in (1, 2, 3)]
    np.savetxt(
        tmp_path / "wide.csv", np.hstack([H, B]), delimiter=",", fmt="%.17g", header=",".join(names), comments=""
    )
    _check_loops(read(tmp_path / "wide.csv"), H, B)


def test_waveforms_in_the_rows_of_two_files_are_loops(tmp_path: Path) -> None:
    """As libraries of power magnetics write them: a waveform a line, without names."""
    H, B = _matrices()
    for name, matrix in (("H", H), ("B", B)):
        np.savetxt(tmp_path / f"{name}.csv", matrix.T, delimiter=",", fmt="%.17g")
    _check_loops(read(f"{tmp_path}/H.csv+{tmp_path}/B.csv"), H, B)
    with pytest.raises(DataError, match=r"INPUT_FILE\+OUTPUT_FILE"):
        read(tmp_path / "H.csv")


def test_matrices_with_a_time_are_the_channels_of_one_record(tmp_path: Path) -> None:
    """Two oscilloscope channels, each a matrix of time and voltage; two files of time and signal without names."""
    H, B = _matrices()
    t = np.arange(40) / 100
    scipy.io.savemat(
        tmp_path / "scope.mat", {"CH1": np.column_stack([t, H[:, 0]]), "CH2": np.column_stack([t, B[:, 0]])}
    )
    assert isinstance(read(tmp_path / "scope.mat"), Record)
    for name, matrix in (("u", H), ("y", B)):
        np.savetxt(tmp_path / f"{name}.csv", np.column_stack([t, matrix[:, 0]]), delimiter=",", fmt="%.17g")
    record = read(f"{tmp_path}/u.csv+{tmp_path}/y.csv")
    assert isinstance(record, Record)
    np.testing.assert_array_equal(record.u, H[:, 0])
    np.testing.assert_array_equal(record.y, B[:, 0])


def test_a_curve_written_twice_is_read_once(tmp_path: Path) -> None:
    """An instrument that writes a run and its display: the second curve would halve the variance and test the fit on itself."""
    phase = np.linspace(0, 4 * np.pi, 40)
    rows = [
        f"{0.1 * k:g},{u:.6f},{y:.6f}" for k, (u, y) in enumerate(zip(np.sin(phase), np.sin(phase - 0.3), strict=True))
    ]
    other = [row.replace("0.0", "0.1") for row in rows]
    blocks = ["\n".join(["t_s,u_V,y_um", *block]) for block in (rows, rows, other, rows)]
    (tmp_path / "twice.csv").write_text("\n".join(blocks) + "\n")
    data = read(tmp_path / "twice.csv")
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == ["curve=0", "curve=2"]
    found = [note for note in data[0].notes if note.severity is Severity.WARNING]
    assert [note.code for note in found] == [Code.LEFT_OUT]
    assert not any(note.severity is Severity.WARNING for note in data[1].notes)


def test_the_other_sheets_of_a_workbook_are_named(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for title, name, scale in (("run 1", "y_um", 1.0), ("run 2", "z_um", 2.0)):
        page = book.create_sheet(title)
        for row in (["t_s", "u_V", name], *zip(T, U, [scale * y for y in Y], strict=True)):
            page.append(list(row))
    book.create_sheet("remarks").append(["measured at noon"])
    book.save(tmp_path / "two.xlsx")
    first = read(tmp_path / "two.xlsx")
    (note,) = [note for note in first.notes if note.code is Code.FILE_FORMAT]  # type: ignore[union-attr]
    assert note.severity is Severity.WARNING
    assert "sheet='2'" in note.text  # as an option: --sheet 2
    assert "remarks" not in note.text.partition("other sheets")[2]
    for number, scale in (("1", 1.0), ("2", 2.0)):
        record = read(tmp_path / "two.xlsx", sheet=number)
        np.testing.assert_array_equal(record.y, [scale * y for y in Y])  # type: ignore[union-attr]
        assert all(note.severity is Severity.INFO for note in record.notes)  # type: ignore[union-attr]
