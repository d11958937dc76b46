"""Tables as loggers and mail programs leave them: units in cells, remarks between rows, archives, few samples beside each other."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Record
from hystfit.errors import DataError
from hystfit.reading import read

U = np.round(80 * np.sin(np.linspace(0, 4 * np.pi, 60)), 3)
Y = np.round(12 * np.sin(np.linspace(-0.4, 4 * np.pi - 0.4, 60)), 3)
TABLE = "V (V),x (um)\n" + "".join(f"{u},{y}\n" for u, y in zip(U, Y, strict=True))


def one(folder: Path, content: str | bytes, name: str = "loop.csv") -> Record:
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    data = read(folder / name)
    assert isinstance(data, Record)
    return data


def is_loop(record: Record, units: tuple[str, str] = ("V", "um")) -> None:
    np.testing.assert_allclose(record.u, U, rtol=1e-12)
    np.testing.assert_allclose(record.y, Y, rtol=1e-12)
    assert (record.u_unit, record.y_unit) == units


@pytest.mark.parametrize(
    ("mark", "decimal", "blank"), [(",", ".", " "), (";", ",", " "), ("\t", ".", ""), (" ", ".", "")]
)
def test_units_in_cells(mark: str, decimal: str, blank: str, tmp_path: Path) -> None:
    cell = lambda value, unit: f"{value}{blank}{unit}".replace(".", decimal)
    rows = [mark.join([cell(u, "V"), cell(y, "um")]) for u, y in zip(U, Y, strict=True)]
    is_loop(one(tmp_path, "\n".join([f"Voltage{mark}Displacement", *rows])))


def test_units_in_cells_that_change_with_the_range(tmp_path: Path) -> None:
    rows = [f"{1e3 * u:.0f} mV;{y} um" if k % 3 else f"{u} V;{y} um" for k, (u, y) in enumerate(zip(U, Y, strict=True))]
    is_loop(one(tmp_path, "\n".join(["Voltage;Displacement", *rows])))


@pytest.mark.parametrize("remark", ["# resumed at 12:30", "% operator pause", "the level was changed"])
def test_remarks_between_rows_part_no_tables(remark: str, tmp_path: Path) -> None:
    header, *rows = TABLE.splitlines()
    is_loop(one(tmp_path, "\n".join([header, *rows[:20], "# pause", *rows[20:45], remark, *rows[45:]])))


def _zipped(**members: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        for name, content in members.items():
            file.writestr(name, content)
    return stream.getvalue()


def test_an_archive_of_one_file_is_read(tmp_path: Path) -> None:
    record = one(tmp_path, _zipped(**{"__MACOSX/._a.csv": "\0", "README.md": "a", "run/a.csv": TABLE}), "a.zip")
    is_loop(record)
    assert record.name == "a"
    with pytest.raises(DataError, match=r"2 files \('a.csv', 'b.csv'\); unpack it"):
        one(tmp_path, _zipped(**{"a.csv": TABLE, "b.csv": TABLE}), "two.zip")
    with pytest.raises(DataError, match="no file that may hold a measurement"):
        one(tmp_path, _zipped(**{"a.png": "1"}), "none.zip")
    with pytest.raises(DataError, match=r"save a spreadsheet as \.xlsx"):
        one(tmp_path, _zipped(**{"mimetype": "x", "content.xml": "<a/>"}), "a.ods")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("a.csv", bytes(2**26 + 2**20))
    with pytest.raises(DataError, match="many times its size"):
        one(tmp_path, stream.getvalue(), "bomb.zip")


def test_few_samples_beside_each_other(tmp_path: Path) -> None:
    u, y = U[:14], Y[:14]
    record = one(tmp_path, "V (V)," + ",".join(map(str, u)) + "\nx (um)," + ",".join(map(str, y)))
    np.testing.assert_array_equal(record.u, u)
    np.testing.assert_array_equal(record.y, y)
    labeled = one(
        tmp_path, "point,V (V),x (um)\n" + "".join(f"p{k},{a},{b}\n" for k, (a, b) in enumerate(zip(u, y, strict=True)))
    )
    np.testing.assert_array_equal(labeled.y, y)


def test_lists_of_yaml_behind_their_names(tmp_path: Path) -> None:
    text = f"sample: A\nV_V: {U.tolist()}\nx_um: {Y.tolist()}\n"
    is_loop(one(tmp_path, text, "a.yaml"))


def test_json_list_of_one_record(tmp_path: Path) -> None:
    content = {"data": [{"name": "trace", "V_V": U.tolist(), "x_um": Y.tolist()}], "layout": {"title": {"text": "a"}}}
    is_loop(one(tmp_path, json.dumps(content), "a.json"))
