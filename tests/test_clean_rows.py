"""Clean rows are read by a parser in C: the same numbers and notes as cell by cell, and many times faster."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hystfit.errors import DataError
from hystfit.reading.read import table_of
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text import clean_rows, plain_text

PARSERS = {"numpy": clean_rows._by_numpy, "pandas": clean_rows._by_pandas}


def _table(path: Path, monkeypatch: pytest.MonkeyPatch, parser: str | None) -> Table | str:
    """The table as read by a parser, or cell by cell without one; the message where the file is refused."""
    with monkeypatch.context() as patch:
        if parser is None:
            patch.setattr(plain_text, "clean_block", lambda *_, **__: None)
        else:
            patch.setattr(clean_rows, "_parsed", PARSERS[parser])
        try:
            return table_of(path)
        except DataError as error:
            return str(error)


def _same(one: Table | str, other: Table | str) -> None:
    if isinstance(one, str) or isinstance(other, str):
        assert one == other
        return
    for field in dataclasses.fields(Table):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if field.name == "columns":
            for left, right in zip(a, b, strict=True):
                np.testing.assert_array_equal(left.view(np.int64), right.view(np.int64))
        elif isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b)
        elif field.name == "labels":
            assert a.keys() == b.keys()
        else:
            assert a == b, field.name


NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.floats(-1e4, 1e4).map(lambda v: f"{v:.3f}"),
    st.floats(-1e4, 1e4).map(lambda v: f"{v:.17e}"),
    st.integers(-(10**6), 10**6).map(str),
    st.integers(0, 10**25).map(str),
    st.sampled_from(["1.", ".5", "+2", "-0", "00.5", "1e5", "1E-400", "5e-324", "12.345", "1.000", "-9999"]),
)
ODD = st.sampled_from(
    [
        "",
        "nan",
        "inf",
        "-",
        "1_0",
        "0x10",
        "1d5",
        "1e",
        "e5",
        "--1",
        "1.2.3",
        "1.5-2.5",
        "(1)",
        "1-",
        "True",
        "\u0663",
        "OVF",
        "1,5",
        "# 3",
    ]
)
MARKS = st.sampled_from([",", ";", "\t", " ", "  ", ", ", "|"])


@pytest.mark.parametrize("parser", PARSERS)
@given(
    rows=st.integers(2, 12).flatmap(
        lambda n: st.lists(st.lists(NUMBERS, min_size=3, max_size=3), min_size=n, max_size=n)
    ),
    mark=MARKS,
    comma=st.booleans(),
    header=st.sampled_from(["", "t,u,y\n", "# made\n\nt u y\n", "a;b;c\n", "1 2\n"]),
    odd=st.one_of(st.none(), st.tuples(st.integers(0, 11), st.integers(0, 2), ODD)),
    end=st.sampled_from(["", "\n", "\n\n", "\nend\n", "\n,,\n", " ", ";"]),
)
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_both_ways_agree(
    parser: str, rows: list, mark: str, comma: bool, header: str, odd: tuple | None, end: str, tmp_path: Path, monkeypatch
) -> None:  # fmt: skip
    if parser == "pandas":
        pytest.importorskip("pandas")
    if odd is not None and odd[0] < len(rows):
        rows[odd[0]][odd[1]] = odd[2]
    lines = [mark.join(cell.replace(".", ",") if comma and "," not in mark else cell for cell in row) for row in rows]
    path = tmp_path / "file.csv"
    path.write_text(header + "\n".join(lines) + end)
    _same(_table(path, monkeypatch, parser), _table(path, monkeypatch, None))


def test_clean_files_take_the_fast_way(tmp_path: Path) -> None:
    rows = np.random.default_rng(0).normal(size=(500, 3))
    for mark, decimal in ((",", "."), (";", ","), ("\t", "."), ("  ", "."), (" ", ",")):
        body = "\n".join(mark.join(f"{v:.4f}".replace(".", decimal) for v in row) for row in rows)
        lines = body.split("\n")
        layout = plain_text.sniff(lines, "file", None, None)
        for parser in PARSERS.values():
            if parser is PARSERS["pandas"]:
                pytest.importorskip("pandas")
            parsed = parser(body, layout)
            assert parsed is not None
            np.testing.assert_array_equal(parsed, np.round(rows, 4))
        assert clean_rows.clean_columns("a b c\n" + body, ["a b c", *lines], 1, layout, settled=False) is not None


def test_numpy_reads_where_pandas_is_not_in_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    used = []
    monkeypatch.setattr(clean_rows, "_by_numpy", lambda *arguments: used.append("numpy"))
    monkeypatch.setattr(clean_rows, "_by_pandas", lambda *arguments: used.append("pandas"))
    layout = plain_text.sniff(["1,2", "2,3"], "file", None, None)
    monkeypatch.delitem(sys.modules, "pandas", raising=False)
    clean_rows._parsed("1,2\n2,3", layout)
    monkeypatch.setitem(sys.modules, "pandas", sys)
    clean_rows._parsed("1,2\n2,3", layout)
    assert used == ["numpy", "pandas"]
