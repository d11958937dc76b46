"""What was once read wrong in silence: stamps in two fields, comment headers, words and codes for missing values, and more."""

from __future__ import annotations

import unicodedata
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystfit.data import Dataset, Record
from hystfit.errors import DataError
from hystfit.outcome import Code, Severity
from hystfit.outcome.note import has
from hystfit.reading import read
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.text import dialect

T = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
U = [0.0, 1.25, -2.5, 3.5, -1.75, 0.5]
Y = [10.0, -0.125, 3.0, 4.75, 6.0, 7.0]
NAN = float("nan")


def _rows(mark: str, *columns: list[Any]) -> str:
    shown = lambda value: value if isinstance(value, str) else f"{value:g}"
    return "".join(mark.join(map(shown, row)) + "\n" for row in zip(*(columns or (T, U, Y)), strict=True))


def _read(folder: Path, content: str | bytes, name: str = "file.csv", **arguments: Any) -> Record:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    record = read(path, **arguments)
    assert isinstance(record, Record)
    return record


def _check(record: Record, t: Any = T, u: Any = U, y: Any = Y) -> None:
    if t is None:
        assert record.t is None
    else:
        np.testing.assert_allclose(record.t, t, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(record.u, u)
    np.testing.assert_array_equal(record.y, y)


def _warned(record: Record, code: Code) -> bool:
    return any(note.code is code and note.severity is Severity.WARNING for note in record.notes)


# -- date and time of day ----------------------------------------------------------------------------------------------

DAYS = ["2024-01-02"] * 2 + ["2024-01-03"] * 4
CLOCKS = ["23:59:59.0", "23:59:59.5", "00:00:00.0", "00:00:00.5", "00:00:01.0", "00:00:01.5"]


@pytest.mark.parametrize("mark", ["\t", " ", "   ", ";", ","])
@pytest.mark.parametrize("names", [["date", "time", "u", "y"], ["time", "u", "y"], ["u", "y"], []])
def test_date_and_time_in_two_fields_over_midnight(mark: str, names: list[str], tmp_path: Path) -> None:
    header = mark.join(names) + "\n" if names else ""
    _check(_read(tmp_path, header + _rows(mark, DAYS, CLOCKS, U, Y)))


@pytest.mark.parametrize("mark", ["\t", " ", ";"])
def test_hours_and_minutes_beside_a_date(mark: str, tmp_path: Path) -> None:
    clocks = ["23:58", "23:59", "00:00", "00:01", "00:02", "00:03"]
    text = mark.join(["date", "time", "u", "y"]) + "\n" + _rows(mark, DAYS, clocks, U, Y)
    _check(_read(tmp_path, text), t=60 * np.arange(6))


def test_halves_of_the_day_in_a_third_field(tmp_path: Path) -> None:
    clocks = ["11:59:59.0 AM", "11:59:59.5 AM", "12:00:00.0 PM", "12:00:00.5 PM", "12:00:01.0 PM", "12:00:01.5 PM"]
    _check(_read(tmp_path, _rows(" ", ["2024-01-02"] * 6, clocks, U, Y)))


def test_stamps_of_two_zones_are_times_of_one_clock(tmp_path: Path) -> None:
    """Summer time begins after the second row."""
    stamps = [
        "2024-03-31T01:59:58+01:00",
        "2024-03-31T01:59:59+01:00",
        "2024-03-31T03:00:00+02:00",
        "2024-03-30T23:00:01-02:00",
    ]
    values = zip(stamps, [0.0, 1.0, 3.0, -1.0], [0.1, 1.2, 2.8, -0.4], strict=True)
    record = _read(tmp_path, "time,u,y\n" + "".join(f"{stamp},{u},{y}\n" for stamp, u, y in values))
    np.testing.assert_allclose(record.t, [0, 1, 2, 3])


def test_stamps_are_neither_input_nor_output(tmp_path: Path) -> None:
    text = "date time x\n" + _rows(" ", DAYS, CLOCKS, U)
    with pytest.raises(DataError, match="an input and an output"):
        _read(tmp_path, text)


# -- headers -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mark", [",", " ", "\t", ";"])
@pytest.mark.parametrize(
    "header",
    [
        "%t,u,y",
        "# t,u,y",
        "#t,u,y",
        "#t u y",
        "# t\tu\ty",
        "//t,u,y",
        "!t u y",
        ";t,u,y",
        "#t, u, y",
        "#t;u;y",
        "REM t,u,y",
    ],
)
def test_headers_behind_a_comment_mark(header: str, mark: str, tmp_path: Path) -> None:
    record = _read(tmp_path, header + "\n" + _rows(mark))
    _check(record)
    assert (record.u_name, record.y_name) == ("u", "y")


def test_a_unit_row_that_begins_with_percent_is_no_comment(tmp_path: Path) -> None:
    record = _read(tmp_path, "strain Temperature stress\n% - MPa\n" + _rows(" ", U, T, Y))
    _check(record, t=None)
    assert (record.u_unit, record.y_unit) == ("%", "MPa")


def test_output_first_behind_a_comment_mark(tmp_path: Path) -> None:
    _check(_read(tmp_path, "#y,u\n" + _rows(",", Y, U)), t=None)


@pytest.mark.parametrize("above", ["1,2,3", "0,1,2\n0,0,0", "0.5,1.5,2.5"])
def test_numbers_above_the_header_are_not_data(above: str, tmp_path: Path) -> None:
    record = _read(tmp_path, above + "\nt,y,u\n" + _rows(",", T, Y, U))
    _check(record)
    assert has(record.notes, Code.LEFT_OUT)


def test_numbers_as_names(tmp_path: Path) -> None:
    record = _read(tmp_path, "t,10,20\n" + _rows(","), output="10", input="20")
    _check(record, u=Y, y=U)


def test_a_first_row_that_may_be_a_header_is_noted(tmp_path: Path) -> None:
    decimals = [[f"{v:.3f}" for v in column] for column in (T, U, Y)]
    for first in ("-1,10,20", "1,2,3"):
        record = _read(tmp_path, first + "\n" + _rows(",", *decimals), time=False, input=1, output=2)
        assert _warned(record, Code.FILE_FORMAT)
    assert not _warned(_read(tmp_path, _rows(",", *decimals)), Code.FILE_FORMAT)


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_names_quoted_over_two_lines(mark: str, tmp_path: Path) -> None:
    header = mark.join(['"Weg\n[um]"', '"Spannung\n[V]"', '"Zeit\n[s]"'])
    record = _read(tmp_path, header + "\n" + _rows(mark, Y, U, T))
    _check(record)
    assert (record.u_unit, record.y_unit, record.t_unit) == ("V", "um", "s")


@pytest.mark.parametrize("forms", [("NFC", "NFD"), ("NFD", "NFC")])
def test_names_with_accents_in_either_form(forms: tuple[str, str], tmp_path: Path) -> None:
    header = unicodedata.normalize(forms[0], "t,Eingr\u00f6\u00dfe_V,Ausgr\u00f6\u00dfe \u00b5m\n")
    chosen = {"input": "Eingr\u00f6\u00dfe", "output": "Ausgr\u00f6\u00dfe \u03bcm"}
    arguments = {role: unicodedata.normalize(forms[1], name) for role, name in chosen.items()}
    _check(_read(tmp_path, header + _rows(","), **arguments))


@pytest.mark.parametrize("name", ["Temperature", "T_degC", "Tstage", "T_sample", "Temp (K)"])
def test_temperature_is_not_the_input(name: str, tmp_path: Path) -> None:
    warm = [20, 21, 22, 21, 20, 20.5]
    for names in (["Signal", "Response"], ["chA", "chB"], ["u", "y"]):
        header = ",".join(["t", name, *names]) + "\n"
        _check(_read(tmp_path, header + _rows(",", T, warm, U, Y)))
    record = _read(tmp_path, f"t,{name},y\n" + _rows(",", T, warm, Y))  # nothing else drives it
    _check(record, u=warm)


# -- numbers -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["({})", "{}-", "( {} )"])
@pytest.mark.parametrize("digits", [".2f", ".3e"])
def test_negative_numbers_of_accounts(form: str, digits: str, tmp_path: Path) -> None:
    written = lambda v: form.format(f"{-v:{digits}}") if v < 0 else f"{v:{digits}}"
    text = "t;u;y\n" + _rows(";", T, [written(v) for v in U], [written(v * 8) for v in Y])
    _check(_read(tmp_path, text), y=8 * np.array(Y))


@pytest.mark.parametrize("separator", [" ", "\t", ","])
def test_a_negative_number_of_accounts_at_the_start_is_no_row_in_brackets(separator: str, tmp_path: Path) -> None:
    written = lambda v: f"({-v:.3e})" if v < 0 else f"{v:.3e}"
    u, y = -np.array(U[1:], float), 8 * np.array(Y[1:], float)
    record = _read(tmp_path, _rows(separator, [written(v) for v in u], [written(v) for v in y]))
    np.testing.assert_allclose(record.u, u)
    np.testing.assert_allclose(record.y, y)


@pytest.mark.parametrize(
    "word",
    [
        "OVF",
        "OL",
        "+OL",
        "-OVER",
        "OVERRANGE",
        "---.--",
        "#####",
        "n.d.",
        "sat",
        "Err_3",
        "?!",
        "x",
        "9.91e37",
        "9.9E+37",
        "1e99",
    ],
)
def test_a_word_in_the_output_keeps_the_input(word: str, tmp_path: Path) -> None:
    record = _read(tmp_path, "t,u,y\n" + _rows(",", T, U, [10, -0.125, word, 4.75, 6, 7]))
    _check(record, y=[10, -0.125, NAN, 4.75, 6, 7])
    assert has(record.notes, Code.MISSING_VALUES)


def test_a_word_in_the_input_is_a_gap(tmp_path: Path) -> None:
    text = "t,u,y\n" + _rows(",", T, [0, 1.25, "OVF", 3.5, -1.75, 0.5], Y)
    with pytest.raises(DataError, match=r"line 4.*gaps='drop'"):
        _read(tmp_path, text)
    dropped = _read(tmp_path, text, gaps="drop")
    _check(dropped, t=np.delete(T, 2), u=np.delete(U, 2), y=np.delete(Y, 2))
    assert _warned(dropped, Code.LEFT_OUT)
    assert len(read(tmp_path / "file.csv", gaps="split")) == 2


def test_commas_of_thousands_in_bare_numbers_do_not_fill_an_empty_column(tmp_path: Path) -> None:
    bare = [f"1,{k}00.5-,{k}.25," for k in range(1, 5)]
    rows = [f'"1,{k}00.5",{k}.25,' for k in range(1, 9)] + bare
    with pytest.raises(DataError, match="4 rows do not have the 3 cells"):
        _read(tmp_path, "u,y,\n" + "\n".join(rows))
    # As many bare numbers as quoted ones: the other rows are no metadata above these.
    with pytest.raises(DataError, match="4 rows do not have the 4 cells"):
        _read(tmp_path, "u,y,\n" + "\n".join(rows[:4] + bare))


def test_comments_do_not_part_rows_of_different_states(tmp_path: Path) -> None:
    rows = _rows(";", T, ["off"] * 2 + ["on"] * 4, U, Y).splitlines()
    text = "\n".join(["t;state;u;y", rows[0], "% note", rows[1], "// checked", *rows[2:]])
    _check(_read(tmp_path, text))


def test_many_rows_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    rows = [f"{0.1 * k:.1f},{k % 7},{k % 5}" for k in range(200)]
    for count, refused in ((2, False), (3, True)):
        spoiled = [*rows]
        for k in range(count):
            spoiled[50 * (k + 1)] = f"not a time at all,{k},2"
        text = "t,u,y\n" + "\n".join(spoiled)
        if refused:
            with pytest.raises(DataError, match=r"3 rows of numbers cannot be read.*gaps='drop'"):
                _read(tmp_path, text)
        record = _read(tmp_path, text, gaps="drop") if refused else _read(tmp_path, text)
        assert len(record) == 200 - count
        assert has(record.notes, Code.LEFT_OUT)


@pytest.mark.parametrize("code", ["-9999", "-9999.0", "-999.25", "9999", "999999", "-99999"])
def test_codes_far_from_all_values_are_missing(code: str, tmp_path: Path) -> None:
    record = _read(tmp_path, "t,u,y\n" + _rows(",", T, U, [10, -0.125, code, 4.75, 6, 7]))
    _check(record, y=[10, -0.125, NAN, 4.75, 6, 7])
    assert _warned(record, Code.MISSING_VALUES)


def test_one_code_that_cannot_be_a_value_makes_all_of_them_missing(tmp_path: Path) -> None:
    """9999 is near the values about it at the peak, and far from them at the foot of the loop."""
    y = 9000 - 500 * np.abs(np.arange(80) % 40 - 20.0)
    coded = y.copy()
    coded[[20, 40]] = 9999.0
    rows = "".join(f"{k},{k % 40},{value}\n" for k, value in enumerate(coded))
    record = _read(tmp_path, f"t,u,y\n{rows}")
    assert np.flatnonzero(~record.used).tolist() == [20, 40]
    peak = np.where(np.arange(80) == 20, 9999.0, y)
    rows = "".join(f"{k},{k % 40},{value}\n" for k, value in enumerate(peak))
    assert _read(tmp_path, f"t,u,y\n{rows}").used.all()


def test_codes_within_the_values_are_measurements(tmp_path: Path) -> None:
    y = [-20000.0, -9999.0, 0.0, 9999.0, 20000.0, 30000.0]
    record = _read(tmp_path, "t,u,y\n" + _rows(",", T, U, y))
    _check(record, y=y)
    assert not has(record.notes, Code.MISSING_VALUES)
    noisy = [5000.0, -9000.0, 9000.0, -9999.0, 8000.0, -7000.0]
    record = _read(tmp_path, "t,u,y\n" + _rows(",", T, U, noisy))
    _check(record, y=noisy)
    assert _warned(record, Code.MISSING_VALUES)  # which says that it was kept


def test_a_code_in_the_input_is_a_gap(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="input or time is missing"):
        _read(tmp_path, "t,u,y\n" + _rows(",", T, [0, 1.25, "9.91e37", 3.5, -1.75, 0.5], Y))


@pytest.mark.parametrize("header", ["", "  t       u       y\n"])
def test_columns_of_fixed_width_that_touch(header: str, tmp_path: Path) -> None:
    y = [-v for v in Y]
    text = header + "".join(f"{a:7.4f}{b:8.4f}{c:8.4f}\n" for a, b, c in zip(T, [v - 20 for v in U], y, strict=True))
    record = _read(tmp_path, text.replace("    ", "  ").replace("  -", "-").replace(" -", "-"))
    _check(record, u=[v - 20 for v in U], y=y)
    assert has(record.notes, Code.FILE_FORMAT)


def test_columns_that_all_touch(tmp_path: Path) -> None:
    _check(
        _read(tmp_path, "u y\n1.2345-2.3456\n-1.3345-2.1456\n1.4345e-2-2.2456\n"),
        None,
        [1.2345, -1.3345, 0.014345],
        [-2.3456, -2.1456, -2.2456],
    )


def test_dots_that_may_separate_thousands_are_noted(tmp_path: Path) -> None:
    doubtful = _read(tmp_path, "t;u;y\n0;12.345;1\n1;13.456;2\n2;14.567;3\n")
    _check(doubtful, [0, 1, 2], [12.345, 13.456, 14.567], [1, 2, 3])
    assert _warned(doubtful, Code.FILE_FORMAT)
    proven = _read(tmp_path, "t;u;y\n0;12.345;1\n1;0.456;2\n2;14.567;3\n")
    assert not _warned(proven, Code.FILE_FORMAT)
    thousands = _read(tmp_path, "t;u;y\n0;12.345;1.234,5\n1;13.456;2.345,5\n2;14.567;3,5\n")
    _check(thousands, [0, 1, 2], [12345, 13456, 14567], [1234.5, 2345.5, 3.5])
    assert sum("thousands" in note.text for note in thousands.notes) == 1


def test_decimal_commas_before_exponents(tmp_path: Path) -> None:
    _check(_read(tmp_path, "1,141e+00 2,500e+00\n1,250e+00 3,125e-01\n"), None, [1.141, 1.25], [2.5, 0.3125])


def test_numbers_beyond_all_doubles(tmp_path: Path) -> None:
    text = "n,u,y\n" + _rows(",", ["1" + "0" * 20, "1" * 400, *["9" * 30] * 4], U, Y)
    _check(_read(tmp_path, text), t=None)
    record = _read(tmp_path, "t,u,y\n" + _rows(",", T, U, ["1" + "0" * 400, *Y[1:]]))
    _check(record, y=[NAN, *Y[1:]])


def test_a_code_among_decimal_commas(tmp_path: Path) -> None:
    comma = lambda column: [f"{v:.3f}".replace(".", ",") for v in column]
    y = comma(Y)
    y[2] = "9.91e37"
    _check(_read(tmp_path, "t;u;y\n" + _rows(";", comma(T), comma(U), y)), y=[10, -0.125, NAN, 4.75, 6, 7])


def test_words_that_are_no_header_do_not_hide_the_time(tmp_path: Path) -> None:
    _check(_read(tmp_path, "made by hand\n" + _rows(" ")))


def test_stamps_cannot_be_chosen_as_the_input(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="holds time stamps"):
        _read(tmp_path, _rows(" ", DAYS, CLOCKS, U, Y), input=1, output=3)


def test_names_above_trailing_delimiters(tmp_path: Path) -> None:
    text = "#y,u\n" + _rows(",", Y, U).replace("\n", ",\n")
    _check(_read(tmp_path, text), t=None)


# -- arrays ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", ["ms", "us", "ns", "D", "10ms"])
@pytest.mark.parametrize("kind", ["datetime64", "timedelta64"])
def test_dates_of_numpy_are_the_time(unit: str, kind: str, tmp_path: Path) -> None:
    counts = np.arange(5, 11).astype(f"{kind}[{unit}]")
    np.savez(tmp_path / "a.npz", when=counts, u=U, y=Y)
    record = read(tmp_path / "a.npz")
    scale = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9, "D": 86400.0, "10ms": 1e-2}[unit]
    np.testing.assert_allclose(record.t, np.arange(6) * scale, rtol=1e-12)  # type: ignore[union-attr]
    _check(record, t=record.t)  # type: ignore[arg-type, union-attr]


def test_missing_dates_of_numpy_are_gaps(tmp_path: Path) -> None:
    when = np.arange(6).astype("datetime64[s]")
    when[3] = "NaT"
    np.savez(tmp_path / "a.npz", when=when, u=U, y=Y)
    with pytest.raises(DataError, match="input or time is missing"):
        read(tmp_path / "a.npz")


def test_a_row_of_numbers_of_another_width_above_the_others_is_left_out_and_named(tmp_path):
    """A thousands separator splits a cell of the first row: it was counted as metadata, in silence."""
    rows = [
        "% Time,No,Voltage,Displacement",
        "0.000,1,0.04,1,460.87-",
        '0.005,2,0.33-,"1,087.89"',
        "0.010,3,0.56,702.75-",
    ]
    rows += ["0.015,4,0.88-,309.75", "0.020,5,1.15,86.71", "0.025,6,1.32-,482.20-", "0.030,7,1.64,872.30"]
    path = tmp_path / "loop.csv"
    path.write_text("\n".join(rows))
    record = next(iter(Dataset.of(read(path))))
    (note,) = [note for note in record.notes if note.code is Code.LEFT_OUT and "cells" in note.text]
    assert "line 2" in note.text
    assert "1 x row with another number of cells than 4" in note.text


def test_plain_rows_below_a_header_of_many_words_are_recognized_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sample of a long text holds each line of its header once; no other mark is tried where all rows are plain."""
    header = [f"note {k}: measured by hand, twice" for k in range(9)] + ["time [s],voltage [V],displacement [um]"]
    lines = [*header, *(f"{0.1 * k:.4g},{k % 7 - 3.5},{-0.25 * k:.6g}" for k in range(2000))]
    assert not set(header) & set(dialect._sample(lines)[len(header) :])
    tried, of = [], dialect.dialect_of
    monkeypatch.setattr(dialect, "dialect_of", lambda rows, *marks: tried.append(marks) or of(rows, *marks))
    found = dialect.sniff(lines, "file", None, None)
    assert (found.delimiter, found.decimal, found.kinds) == (",", ".", "NNN")
    assert tried == [(",", ".")]


def test_rows_in_which_the_input_alone_reads_zero_are_left_out(tmp_path) -> None:
    """A field meter that failed for two samples; what passes zero, and pulses that the output follows, stay."""
    h = np.round(np.concatenate([np.linspace(50, -50, 81), np.linspace(-48.75, 50, 80)]), 2)
    way = np.where(np.arange(h.size) < 81, 1.0, -1.0)
    m = np.tanh((h + 10 * way) / 20)
    failed = h.copy()
    failed[[12, 60]] = 0.0
    save = lambda name, u, y: np.savetxt(
        tmp_path / name, np.c_[u, y], "%.8g", ",", header="H (Oe),M (emu)", comments=""
    )
    save("failed.csv", failed, m)
    record = read(tmp_path / "failed.csv")
    assert np.array_equal(record.u, np.delete(h, [12, 60]))
    assert np.allclose(record.y, np.delete(m, [12, 60]), atol=1e-7)
    assert any(
        "2 rows in which the input alone reads 0" in note.text and "14, 62" in note.text for note in record.notes
    )
    pulsed = np.where(np.arange(h.size) % 20 == 10, 0.0, 60.0 + h / 10)
    save("pulsed.csv", pulsed, 0.01 * pulsed + 1e-4 * np.arange(h.size))
    save("loop.csv", h, m)
    assert len(read(tmp_path / "pulsed.csv")) == len(read(tmp_path / "loop.csv")) == h.size


@pytest.mark.parametrize("last", [0.0, 40.0])
def test_a_last_row_of_zeros_far_from_the_loop_is_an_end_mark(tmp_path: Path, last: float) -> None:
    h = np.concatenate([np.linspace(-50, 50, 80), np.linspace(49, last, 60)])
    m = 3.0 + np.tanh(h / 20)
    marked = np.append(h, 0.0), np.append(m, 0.0)
    np.savetxt(tmp_path / "loop.csv", np.c_[marked], "%.8g", ",")
    record = read(tmp_path / "loop.csv")
    ends = last != 0.0  # a loop that ended near zero is left as it is
    assert len(record) == h.size + (not ends)
    assert any("end mark" in note.text for note in record.notes) == ends


@pytest.mark.parametrize(
    ("names", "units"),
    [
        ("time_s,displacement_mm,force_kn", ("mm", "kN")),
        ("time_s,strain_percent,stress_mpa", ("%", "MPa")),
        ("time_s,pressure_kpa,displacement_um", ("kPa", "um")),
        ("time_s,rotation_rad,moment_knm", ("rad", "kNm")),
        ("time_s,voltage_mv,current_ua", ("mV", "uA")),
        ("time_s,field_ka_m,polarization_mt", ("kA/m", "mT")),
        ("time_s,field_oe,moment_emu", ("Oe", "emu")),
        ("time_s,efield_kv_per_cm,polarization_uc_cm2", ("kV/cm", "uC/cm2")),
        ("time_s,angle_deg,torque_nm", ("deg", "Nm")),
        ("time_s,rotation_rad,moment_kN_m", ("rad", "kN*m")),
        ("time_s,curvature_1_m,moment_knm", ("1/m", "kNm")),
        ("time_s,vds_v,ids_ua", ("V", "uA")),
        ("time_s,current_a,flux_mwb", ("A", "mWb")),
        ("time_s,bfield_mt,kerr_mdeg", ("mT", "mdeg")),
        ("time_s,extension_mm,tension_n", ("mm", "N")),
        ("time_s,valve_cmd_pct,flow_lpm", ("pct", "L/min")),
        ("time_s,pressure_bar,uptake_mmol_g", ("bar", "mmol/g")),
        ("time_s,p_p0,n_ads_cm3_g", ("", "cm3/g")),
        ("Time (S),Displacement (Mm),LOAD (Kn)", ("mm", "kN")),
        ("time (s),v (v),i (ma)", ("V", "mA")),
        ("TIME (MS),VOLTAGE (MV),CURRENT (MA)", ("mV", "mA")),
        ("time s,disp mm,force kn", ("mm", "kN")),
        ("time,disp,force\ns,mm,kn", ("mm", "kN")),
        ("time,voltage,current\ns,v,ma", ("V", "mA")),
    ],
)
def test_units_may_be_written_in_the_wrong_case(tmp_path: Path, names: str, units: tuple[str, str]) -> None:
    t = np.arange(200) * 0.05
    file = tmp_path / "loop.csv"
    rows = "".join(f"{a:.2f},{np.sin(a):.5f},{3 * np.sin(a - 0.3):.5f}\n" for a in t)
    file.write_text(f"{names}\n{rows}")
    record = read(file)
    assert isinstance(record, Record)
    assert (record.u_unit, record.y_unit) == units


def test_letters_that_are_indices_are_no_units_in_lower_case() -> None:
    phases = ["i_a", "i_b", "i_c"]
    assert [split_unit(name, phases) for name in phases] == [(name, "") for name in phases]
    forces = ["force_n", "force_t"]
    assert split_unit("force_n", forces) == ("force_n", "")
    assert split_unit("force_n", ["disp_mm", "force_n"]) == ("force", "N")
    assert split_unit("price_ma") == ("price_ma", "")
    assert split_unit("speed_kn") == ("speed_kn", "")
    assert split_unit("Height (nm)") == ("Height", "nm")
    assert split_unit("I (MA)") == ("I", "MA")


@pytest.mark.parametrize(
    "form", ["np.float64({})", "numpy.float32({})", "tensor({})", "tensor({}, dtype=torch.float64)", "Decimal('{}')"]
)
def test_numbers_may_have_the_name_of_their_type(tmp_path: Path, form: str) -> None:
    if "," in form:
        rows = "".join(f"{u};{form.format(y)}\n" for u, y in zip(U, Y, strict=True))
        text = f"voltage_V;strain\n{rows}"
    else:
        rows = "".join(f"{u},{form.format(y)}\n" for u, y in zip(U, Y, strict=True))
        text = f"voltage_V,strain\n{rows}"
    record = _read(tmp_path, text)
    np.testing.assert_array_equal(record.u, U)
    np.testing.assert_array_equal(record.y, Y)
    assert has(record.notes, Code.FILE_FORMAT)


def test_names_of_many_rows_are_no_table_of_results(tmp_path: Path) -> None:
    t = np.arange(400) * 0.05
    rows = lambda n: "".join(f"id-{k},{np.sin(a):.5f},{np.sin(a - 0.3):.5f}\n" for k, a in enumerate(t[:n]))
    told = [
        any("table of results" in note.text for note in _read(tmp_path, f"uid,x,force\n{rows(n)}").notes)
        for n in (30, 400)
    ]
    assert told == [True, False]
