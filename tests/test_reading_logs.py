"""Tables as loggers and mail programs leave them: units in cells, remarks between rows, archives, few samples beside each other."""

from __future__ import annotations

import datetime
import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Dataset, Record
from hystfit.errors import DataError
from hystfit.outcome import Severity
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
    with pytest.raises(DataError, match="no file that may hold a measurement"):
        one(tmp_path, _zipped(**{"a.png": "1"}), "none.zip")
    with pytest.raises(DataError, match=r"save the numbers as a spreadsheet"):
        one(tmp_path, _zipped(**{"mimetype": "text", "content.xml": "<a/>"}), "a.odt")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("a.csv", bytes(2**26 + 2**20))
    with pytest.raises(DataError, match="many times its size"):
        one(tmp_path, stream.getvalue(), "bomb.zip")


def test_every_measurement_in_an_archive_is_a_record(tmp_path: Path) -> None:
    members = {"run/a10.csv": TABLE, "run/a9.csv": TABLE.replace("0.", "1."), "run/meta.json": '{"by": "x"}'}
    (tmp_path / "all.zip").write_bytes(_zipped(**members))
    data = read(tmp_path / "all.zip")
    assert [record.name for record in Dataset.of(data)] == ["a9", "a10"]
    is_loop(data[1])
    assert any("meta.json" in note.text for note in data[0].notes if note.severity is Severity.WARNING)
    is_loop(Dataset.of(read(f"{tmp_path}/all.zip/run/a10.csv"))[0])
    with pytest.raises(DataError, match=r"all\.zip.b\.csv"):
        read(f"{tmp_path}/all.zip/b.csv")


def _open_document(*rows: str) -> bytes:
    spaces = " ".join(
        f'xmlns:{name}="urn:oasis:names:tc:opendocument:xmlns:{name}:1.0"' for name in ("office", "table", "text")
    )
    sheet = f'<table:table table:name="S1">{"".join(rows)}</table:table>'
    body = f"<office:body><office:spreadsheet>{sheet}</office:spreadsheet></office:body>"
    content = f"<office:document-content {spaces}>{body}</office:document-content>"
    manifest = '<m:manifest xmlns:m="urn:oasis:names:tc:opendocument:xmlns:manifest:1.0"/>'
    kind = "application/vnd.oasis.opendocument.spreadsheet"
    return _zipped(mimetype=kind, **{"META-INF/manifest.xml": manifest, "content.xml": content})


def test_sheets_of_an_open_document(tmp_path: Path) -> None:
    cells = lambda row: "".join(
        f'<table:table-cell office:value-type="string"><text:p>{cell}</text:p></table:table-cell>'
        for cell in row.split(",")
    )
    rows = [f"<table:table-row>{cells(row)}</table:table-row>" for row in TABLE.splitlines()]
    empty = '<table:table-row table:number-rows-repeated="99999"><table:table-cell/></table:table-row>'
    is_loop(one(tmp_path, _open_document(*rows, empty), "loop.ods"))
    cell = '<table:table-cell table:number-columns-repeated="1000" office:value-type="float" office:value="1"/>'
    with pytest.raises(DataError, match=r"bomb\.ods"):
        one(
            tmp_path,
            _open_document(f'<table:table-row table:number-rows-repeated="1000000">{cell}</table:table-row>'),
            "bomb.ods",
        )


def _old_excel(**sheets: list[list[object]]) -> bytes:
    book, stream = pytest.importorskip("xlwt").Workbook(), io.BytesIO()
    when = pytest.importorskip("xlwt").XFStyle()
    when.num_format_str = "YYYY-MM-DD HH:MM:SS"
    for title, rows in sheets.items():
        page = book.add_sheet(title)
        for k, row in enumerate(rows):
            for j, cell in enumerate(row):
                page.write(k, j, cell, *([when] if isinstance(cell, datetime.datetime) else []))
    book.save(stream)
    return stream.getvalue()


def test_sheets_of_old_excel(tmp_path: Path) -> None:
    midnight = datetime.datetime(2024, 5, 1)
    start = [midnight + datetime.timedelta(seconds=k) for k in range(U.size)]  # the first is a day in the file
    rows = [["Time", "V (V)", "x (um)"], *([t, u, y] for t, u, y in zip(start, U.tolist(), Y.tolist(), strict=True))]
    raw = _old_excel(Summary=[["Operator", "A. B."], ["Gain", 20.0]], Data=[["Test of an actuator"], [], *rows])
    record = one(tmp_path, raw, "loop.xls")
    is_loop(record)
    np.testing.assert_allclose(np.asarray(record.t) - np.asarray(record.t)[0], np.arange(U.size), atol=1e-4)
    is_loop(one(tmp_path, raw, "loop.dat"))
    for damaged in (raw[:1500], raw[:8] + bytes(4000)):
        with pytest.raises(DataError, match="cannot be read as a workbook"):
            one(tmp_path, damaged, "damaged.xls")
    far = _old_excel(Data=[[0.0, 1.0], [1.0, 2.0], *[[]] * 20000, [*[""] * 250, 1.0]])
    with pytest.raises(DataError, match="4000000 cells"):
        one(tmp_path, far, "far.xls")


@pytest.mark.parametrize("mark", ["/", "."])
def test_groups_of_arrays_are_records(mark: str, tmp_path: Path) -> None:
    arrays = {f"test{mark}S{k}{mark}{name}": k * v for k in (1, 2) for name, v in (("disp_mm", U), ("force_kN", Y))}
    np.savez(tmp_path / "tests.npz", **arrays)
    data = Dataset.of(read(tmp_path / "tests.npz"))
    assert [record.name for record in data] == ["S1", "S2"]
    np.testing.assert_array_equal(data[1].u, 2 * U)
    assert (data[1].u_unit, data[1].y_unit) == ("mm", "kN")
    channels = {
        f"{channel}{mark}{name}": v
        for channel in ("a", "b")
        for name, v in (("time", np.arange(U.size)), ("force_kN", Y))
    }
    np.savez(tmp_path / "channels.npz", **channels, disp_mm=U)  # each channel has its time: no loops of their own
    assert isinstance(read(tmp_path / "channels.npz", input="disp_mm", output=f"a{mark}force_kN"), Record)


def test_units_in_the_attributes_of_a_data_set(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for name, values, unit in (("drive", U, "V"), ("stage_position", Y, b"um")):
            file.create_dataset(f"raw/{name}", data=values).attrs["units"] = unit
    is_loop(read(tmp_path / "run.h5"))  # type: ignore[arg-type]


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


HALF = np.linspace(0, 100, 50)
UP = np.round(0.04 * HALF + np.sin(HALF / 32), 6)
DOWN = np.round(UP + 0.5 * np.sin(np.pi * HALF / 100), 6)
PAIRS = [
    ("trace", "retrace"),
    ("Ex", "Rt"),
    ("auf", "ab"),
    ("Hin", "Rück"),
    ("montée", "descente"),
    ("加载", "卸载"),
    ("press", "release"),
    ("CW", "CCW"),
]


@pytest.mark.parametrize("words", [*PAIRS, ("↑", "↓"), ("north", "south")])
@pytest.mark.parametrize("names", ["Spannung,Weg {},Weg {}", "Weg,Kraft {},Kraft {}"])
def test_branches_under_the_names_of_other_languages(words: tuple[str, str], names: str, tmp_path: Path) -> None:
    """A stroke lags behind its voltage; a force resists the displacement, so that its rising branch lies above."""
    up, down = (UP, DOWN) if "Spannung" in names else (DOWN, UP)
    rows = [f"{u},{a},{b}" for u, a, b in zip(HALF, up, down, strict=True)]
    record = one(tmp_path, "\n".join([names.format(*words), *rows]))
    np.testing.assert_allclose(record.u, np.append(HALF, HALF[::-1]))
    np.testing.assert_allclose(record.y, np.append(up, down[::-1]))
    asked = any(note.severity is Severity.WARNING and "--output" in note.text for note in record.notes)
    assert asked == (words not in PAIRS)


def test_word_of_a_branch_that_ends_another_word(tmp_path: Path) -> None:
    rows = [f"{u},{a},{b}" for u, a, b in zip(HALF, UP, DOWN, strict=True)]
    record = one(tmp_path, "\n".join(["Last (kN),Lauf auf (mV/V),Lauf ab (mV/V)", *rows]))
    assert record.y_name == "Lauf (mV/V)"


def test_sensors_that_end_apart_are_no_branches(tmp_path: Path) -> None:
    rows = [f"{u},{a},{1.3 * a}" for u, a in zip(HALF, UP, strict=True)]
    record = one(tmp_path, "\n".join(["Weg,Kraft north,Kraft south", *rows]))
    np.testing.assert_allclose(record.y, UP)


@pytest.mark.parametrize(
    "names", [["M 5 K (emu)", "M 300 K (emu)"], ["5 K", "77 K", "300 K"], ["B at 50 Hz", "B at 400 Hz"]]
)
def test_outputs_at_several_conditions_are_records(names: list[str], tmp_path: Path) -> None:
    rows = [",".join(map(str, [u, *(k * y for k in range(1, len(names) + 1))])) for u, y in zip(U, Y, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join([",".join(["H (Oe)", *names]), *rows]))
    data = Dataset.of(read(tmp_path / "a.csv"))
    assert len(data) == len(names)
    for k, record in enumerate(data, start=1):
        np.testing.assert_allclose(record.u, U)
        np.testing.assert_allclose(record.y, k * Y)
        assert record.name.split()[0] in names[k - 1]


def test_columns_of_fixed_width_that_touch(tmp_path: Path) -> None:
    u, y = 1000 + U, 2000 + Y
    text = "".join(f"{k / 100:9.3f}{a:8.3f}{b:8.3f}\n" for k, (a, b) in enumerate(zip(u, y, strict=True)))
    record = one(tmp_path, text, "a.dat")
    np.testing.assert_allclose(record.u, u, rtol=1e-12)
    np.testing.assert_allclose(record.y, y, rtol=1e-12)
    other = "".join(f"{k / 100:9.3f}{a:8.3f}{1e4 * b:9.2f}\n" for k, (a, b) in enumerate(zip(u, U, strict=True)))
    with pytest.raises(DataError, match=r"rows of numbers cannot be read|only 1 column|an input and an output"):
        read(_file(tmp_path, other))


def _file(folder: Path, text: str) -> Path:
    (folder / "b.dat").write_text(text)
    return folder / "b.dat"


def test_two_files_of_one_channel_each_ask_for_their_time(tmp_path: Path) -> None:
    for name, values in (("disp.out", U), ("force.out", Y)):
        (tmp_path / name).write_text("".join(f"{k / 10:.1f} {v}\n" for k, v in enumerate(values - values[0])))
    paths = [tmp_path / "disp.out", tmp_path / "force.out"]
    told = [
        note.text for record in Dataset.of(read(paths)) for note in record.notes if note.severity is Severity.WARNING
    ]
    assert all(f"{paths[0]}+{paths[1]} is one record" in text for text in told if "clockwise" not in text)
    assert len(told) >= 2
    record = read(f"{paths[0]}+{paths[1]}")
    assert isinstance(record, Record)
    np.testing.assert_allclose(record.y, Y - Y[0])


@pytest.mark.parametrize("kind", ["held", "jump"])
def test_curves_with_nothing_between_them(kind: str, tmp_path: Path) -> None:
    field, noise = np.linspace(0, 5e4, 20), 0.01 * np.sin(np.arange(20))
    temperatures = [250, 260, 275, 300]
    header = "Temperature (K),Field (Oe),Moment (emu)" if kind == "held" else "Field (Oe),Moment (emu)"
    rows = [
        f"{f'{kelvin + e:.3f},' if kind == 'held' else ''}{u:.6g},{np.tanh(u / (100 * kelvin)):.9f}"
        for kelvin in temperatures
        for u, e in zip(field, noise, strict=True)
    ]
    (tmp_path / "a.csv").write_text("\n".join([header, *rows]))
    data = Dataset.of(read(tmp_path / "a.csv"))
    assert len(data) == 4
    for record, kelvin in zip(data, temperatures, strict=True):
        np.testing.assert_allclose(record.y, np.tanh(field / (100 * kelvin)), rtol=1e-5, atol=1e-9)
    if kind == "held":
        assert [record.name.split("=")[1] for record in data] == ["250", "260", "275", "300"]


def test_reversal_curves_with_nothing_between_them(tmp_path: Path) -> None:
    curves = [np.arange(start, 31.0) + 0.2 * np.sin(np.arange(31 - start)) for start in range(20, -21, -4)]
    rows = "".join(f"{u:.6g},{np.tanh(u / 9 - curve[0] / 99):.9f}\n" for curve in curves for u in curve)
    (tmp_path / "a.csv").write_text("Field (mT),Moment (emu)\n" + rows)
    data = Dataset.of(read(tmp_path / "a.csv"))
    assert [len(record) for record in data] == [curve.size for curve in curves]
    for record, curve in zip(data, curves, strict=True):
        np.testing.assert_allclose(record.u, curve, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("step", [0.5, 0.02])
def test_a_temperature_that_drifts_parts_no_loop(step: float, tmp_path: Path) -> None:
    drift = np.round((25 + 0.02 * np.arange(60)) / step) * step
    rows = [f"{0.01 * k:.2f},{u},{y},{drift[k]:.2f}" for k, (u, y) in enumerate(zip(U, Y, strict=True))]
    is_loop(one(tmp_path, "\n".join(["t (s),V (V),x (um),T (degC)", *rows])))


def test_a_sawtooth_in_time_is_one_record(tmp_path: Path) -> None:
    u = 50 * (np.arange(240) % 60) / 60
    record = one(tmp_path, "t (s),V (V),x (um)\n" + "".join(f"{k / 100},{a},{a**2:.6f}\n" for k, a in enumerate(u)))
    np.testing.assert_allclose(record.u, u)


def test_json_cycles_that_go_on_are_one_record(tmp_path: Path) -> None:
    cycles = [
        {"number": k, "V_V": U[a:b].tolist(), "x_um": Y[a:b].tolist()} for k, (a, b) in enumerate([(0, 20), (20, 60)])
    ]
    is_loop(one(tmp_path, json.dumps({"specimen": "W1", "cycles": cycles}), "a.json"))
    remarks = [cycle | {"remark": ["stable"] * len(cycle["x_um"])} for cycle in cycles]  # texts neither go on nor stop
    is_loop(one(tmp_path, json.dumps({"cycles": remarks}), "d.json"))
    (tmp_path / "b.json").write_text(json.dumps({"specimens": cycles}))
    assert len(Dataset.of(read(tmp_path / "b.json"))) == 2
    apart = [cycles[0], {"number": 1, "V_V": U[30:].tolist(), "x_um": Y[30:].tolist()}]
    (tmp_path / "c.json").write_text(json.dumps({"cycles": apart}))
    assert len(Dataset.of(read(tmp_path / "c.json"))) == 2
    named = [{**cycle, "name": f"loop {k}"} for k, cycle in enumerate(cycles)]
    (tmp_path / "d.json").write_text(json.dumps({"loops": named}))
    assert [record.name for record in Dataset.of(read(tmp_path / "d.json"))] == ["loop 0", "loop 1"]


def _book(**sheets: list[list[object]]) -> bytes:
    openpyxl = pytest.importorskip("openpyxl")
    book, stream = openpyxl.Workbook(), io.BytesIO()
    book.remove(book.active)
    for title, rows in sheets.items():
        page = book.create_sheet(title)
        for row in rows:
            page.append(row)
    book.save(stream)
    return stream.getvalue()


def test_the_sheet_of_the_loop_is_read_behind_a_summary(tmp_path: Path) -> None:
    summary = [["Parameter", "Value", "Error"], ["Hc", 120.5, 1.5], ["Mr", 0.3, 0.1], ["Ms", 0.9, 0.2]]
    rows = [["V (V)", "x (um)"], *map(list, zip(U.tolist(), Y.tolist(), strict=True))]
    is_loop(one(tmp_path, _book(Summary=summary, Data=rows), "a.xlsx"))


def test_numbers_as_text_and_rows_on_their_side_in_a_sheet(tmp_path: Path) -> None:
    text = [[str(value).replace(".", ",") for value in pair] for pair in zip(U, Y, strict=True)]
    is_loop(one(tmp_path, _book(a=[["V (V)", "x (um)"], *text]), "a.xlsx"))
    is_loop(one(tmp_path, _book(a=[["V (V)", *U.tolist()], ["x (um)", *Y.tolist()]]), "b.xlsx"))


def test_formulas_without_values_name_the_remedy(tmp_path: Path) -> None:
    rows = [["V (V)", "x (um)"], *([f"=A1*{u}", y] for u, y in zip(U.tolist(), Y.tolist(), strict=True))]
    with pytest.raises(DataError, match="formulas without their values"):
        one(tmp_path, _book(a=rows), "a.xlsx")


def test_rows_in_brackets(tmp_path: Path) -> None:
    pairs = list(zip(U.tolist(), Y.tolist(), strict=True))
    texts = [
        "\n".join(f"({u}, {y})" for u, y in pairs),
        "[[" + "]\n [".join(f"{u: .4e} {y: .4e}" for u, y in pairs) + "]]",
        "{" + ", ".join(f"{{{u}, {y}}}" for u, y in pairs) + "}",
        "{" + ",\n".join(f"{{{u}, {1e3 * y:.5f}*^-3}}" for u, y in pairs) + "}",
    ]
    for text in texts:
        record = one(tmp_path, text, "a.txt")
        np.testing.assert_allclose(record.u, U, rtol=1e-4, atol=1e-9)
        np.testing.assert_allclose(record.y, Y, rtol=1e-4, atol=1e-9)


HEADERS = {
    "columns in a comment": "# version 3\n# columns: V x\n# units: V um\n# begin\n",
    "columns in a line": "Columns = V (V), x (um)\n\nStart of the run\n",
    "a word before the names": "#fields V_V x_um\n#types double double\n",
}


@pytest.mark.parametrize("kind", HEADERS)
def test_names_behind_a_word(kind: str, tmp_path: Path) -> None:
    is_loop(one(tmp_path, HEADERS[kind] + "".join(f"{u} {y}\n" for u, y in zip(U, Y, strict=True)), "a.txt"))


def test_errors_and_apostrophes_in_cells(tmp_path: Path) -> None:
    is_loop(one(tmp_path, "V (V),x (um)\n" + "".join(f"{u}±0.1,{y} ± 0.02\n" for u, y in zip(U, Y, strict=True))))
    is_loop(one(tmp_path, "V (V),x (um)\n" + "".join(f"'{u},'{y}\n" for u, y in zip(U, Y, strict=True))))


def test_a_file_of_one_signal_asks_for_the_other_one(tmp_path: Path) -> None:
    for name, values in (("u.txt", U), ("y.txt", Y)):
        (tmp_path / name).write_text("\n".join(map(str, values)))
    with pytest.raises(DataError, match=r"INPUT_FILE\+.*y\.txt or .*y\.txt\+OUTPUT_FILE reads both"):
        read(tmp_path / "y.txt")
    record = read(f"{tmp_path / 'u.txt'}+{tmp_path / 'y.txt'}")
    assert isinstance(record, Record)
    np.testing.assert_array_equal(record.y, Y)


@pytest.mark.parametrize("label", ["# Cycle {}", "Cycle,{}"])
def test_names_above_the_label_of_a_cycle(label: str, tmp_path: Path) -> None:
    header, *rows = TABLE.splitlines()
    lines = [header, label.format(1), *rows[:30], label.format(2), *rows[30:]]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    data = Dataset.of(read(tmp_path / "a.csv"))
    np.testing.assert_array_equal(np.concatenate([record.y for record in data]), Y)
    assert {(record.u_unit, record.y_unit) for record in data} == {("V", "um")}


@pytest.mark.parametrize("way", [("-", "–"), ("0123456789.", "０１２３４５６７８９．")])
def test_dashes_and_digits_of_full_width(way: tuple[str, str], tmp_path: Path) -> None:
    header, *rows = TABLE.splitlines()
    is_loop(one(tmp_path, "\n".join([header, *(row.translate(str.maketrans(*way)) for row in rows)])))


def test_a_signal_that_repeats_the_input_is_no_output(tmp_path: Path) -> None:
    """A potentiostat writes the voltage that it commands beside the one that it measures; "Sig" alone could be a stress."""
    above = "EXPLAIN\nTAG\tCV\nTITLE\tLABEL\tScan\nVLIMIT1\tQUANT\t1.0\tVertex\nCURVE1\tTABLE\t60\n"
    head = f"{above}\tPt\tT\tVf\tIm\tSig\tOver\n\t#\ts\tV vs. Ref.\tA\tV\tbits\n"
    rows = (
        f"\t{k}\t{k / 10}\t{u / 80:.5f}\t{y * 1e-6:.5g}\t{u / 80:.4f}\t.........."
        for k, (u, y) in enumerate(zip(U, Y, strict=True))
    )
    record = one(tmp_path, head + "\n".join(rows) + "\n", "cv.DTA")
    np.testing.assert_allclose(record.u, U / 80, atol=1e-5)
    np.testing.assert_allclose(record.y, Y * 1e-6, rtol=1e-4)


def test_how_a_logger_averaged_is_no_name(tmp_path: Path) -> None:
    """Names that mean something above units, and below these how each column was averaged."""
    text = '"TOA5","CR1000","1","table"\n"TIMESTAMP","RECORD","Pressure_Avg","Strain_Avg"\n'
    text += '"TS","RN","kPa","microstrain"\n"","","Avg","Avg"\n'
    for k in range(60):
        text += (
            f'"2021-05-04 09:{30 + k // 60}:{k % 60:02d}",{k},{50 * np.sin(k / 6):.4f},{35 * np.sin(k / 6 - 0.3):.4f}\n'
        )
    path = tmp_path / "Table1.dat"
    path.write_text(text, encoding="utf-8")
    record = read(path)
    assert isinstance(record, Record)
    assert {(record.u_name, record.u_unit), (record.y_name, record.y_unit)} == {
        ("Pressure_Avg", "kPa"),
        ("Strain_Avg", "microstrain"),
    }


def test_the_last_line_of_a_log_may_be_cut_off(tmp_path: Path) -> None:
    """JSON in lines, of a program that was stopped within the last one; a line that is cut off elsewhere is an error."""
    lines = [json.dumps({"drive (V)": u, "x (um)": y}) for u, y in zip(U, Y, strict=True)]
    record = one(tmp_path, "\n".join([*lines, lines[0][:15]]), "log.jsonl")
    is_loop(record, ("V", "um"))
    assert any(note.severity is Severity.WARNING for note in record.notes)
    whole = one(tmp_path, "\n".join(lines), "log.jsonl")
    assert not any(note.severity is Severity.WARNING for note in whole.notes)
    with pytest.raises(DataError, match="is not"):
        one(tmp_path, "\n".join([*lines[:9], lines[9][:15], *lines[10:]]), "log.jsonl")


def test_numbers_whose_squares_are_lost_are_zeros(tmp_path: Path) -> None:
    """Of a model with no units, or of memory that was never written."""
    rows = "".join(f"{1e-300 * u:.6e},{1e-300 * y:.6e}\n" for u, y in zip(U, Y, strict=True))
    with pytest.raises(DataError, match="found 0 column"):
        one(tmp_path, "V (V),x (um)\n" + rows)
