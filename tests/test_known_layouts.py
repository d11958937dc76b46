"""Texts of a known layout: their tables are those of reading in full, and texts that differ in anything are read in full."""

import dataclasses

import numpy as np
import pytest

from hystfit.errors import DataError
from hystfit.reading import registry
from hystfit.reading.files.file_bytes import FileBytes
from hystfit.reading.files.text_file import Opening
from hystfit.reading.layouts import known_layouts
from hystfit.reading.table.raw_table import Table

ROWS, AS_IT_IS = 240, Opening()
CHANGED = list(b'0123456789+-.eE,;\t\n\r nx"#')


def rows(seed: int, count: int = ROWS, mark: str = ",", end: str = "\n", form: str = "%.7g") -> str:
    """Rows of a loop, from a random start."""
    rng, t = np.random.default_rng(seed), np.arange(count) / 50
    u = 3 * np.sin(2 * np.pi * t + rng.uniform(0, 6))
    columns = np.column_stack([t, u, np.tanh(u) + 0.01 * rng.standard_normal(count)])
    return "".join(mark.join(form % value for value in row) + end for row in columns)


HEADER = "time [s],voltage [V],displacement [um]\n"
KINDS = {
    "comma": lambda seed: (HEADER + rows(seed)).encode(),
    "metadata": lambda seed: ("Sample: 7\nMass: 2 mg\n# operator\n" + HEADER + rows(seed)).encode(),
    "units": lambda seed: ("t;V;x\ns;V;µm\n" + rows(seed, mark=";")).encode(),
    "legacy": lambda seed: ("t;V;x\ns;V;µm\n" + rows(seed, mark=";")).encode("cp1252"),
    "tab": lambda seed: ("t_s\tu_V\ty_um\r\n" + rows(seed, mark="\t", end="\r\n", form="%.6e")).encode(),
    "no names": lambda seed: rows(seed).encode(),
    "blanks": lambda seed: (HEADER + rows(seed, mark=", ")).encode(),
    "numbers above": lambda seed: ("channel,1,2\nrate,50,50\n" + HEADER + rows(seed)).encode(),
    "whole numbers": lambda seed: ("u_V,y_V\n" + "".join(f"{k % 9},{(k + seed) % 7}\n" for k in range(ROWS))).encode(),
    "mac": lambda seed: (HEADER + rows(seed)).replace("\n", "\r").encode(),
    "wide": lambda seed: (HEADER + rows(seed)).encode("utf-16"),
}
DAMAGE = {
    "a word": lambda text: text.replace(b"\n0.2,", b"\nOVF,", 1),
    "a missing cell": lambda text: text.replace(b"\n0.2,", b"\n,", 1),
    "not a number": lambda text: text.replace(b"\n0.2,", b"\nnan,", 1),
    "a cell more": lambda text: text.replace(b"\n0.2,", b"\n0.2,7,", 1),
    "a cell more in all": lambda text: text.replace(b"\n", b",1\n"),
    "cut off": lambda text: text[:-9],
    "cut off at a mark": lambda text: text[: text.rindex(b",")],
    "another name": lambda text: text.replace(b"voltage", b"current"),
    "another unit": lambda text: text.replace(b"[um]", b"[nm]"),
    "a unit of time": lambda text: text.replace(b"[s]", b"[ms]"),
    "a blank line": lambda text: text.replace(b"\n0.2,", b"\n\n0.2,", 1),
    "a header between": lambda text: text.replace(b"\n0.2,", b"\n" + HEADER.encode() + b"0.2,", 1),
    "a comment": lambda text: text.replace(b"\n0.2,", b"\n# pause\n0.2,", 1),
    "a date": lambda text: text.replace(b"\n0.2,", b"\n2024-03-01,", 1),
    "a large number": lambda text: text.replace(b"\n0.2,", b"\n12345678901234567890,", 1),
    "a line more above": lambda text: b"remark\n" + text,
    "fewer rows": lambda text: b"".join(text.splitlines(keepends=True)[:150]),
    "more rows": lambda text: text + rows(9, 17).encode(),
    "one row": lambda text: b"".join(text.splitlines(keepends=True)[:2]),
    "no row": lambda text: HEADER.encode(),
    "a NUL": lambda text: text.replace(b"\n0.2,", b"\n0.2\x00,", 1),
    "other line ends": lambda text: text.replace(b"\n", b"\r\n"),
    "one other line end": lambda text: text.replace(b"\n0.2,", b"\r0.2,", 1),
    "blanks at the end": lambda text: text + b"\n\n",
    "a sign": lambda text: text.replace(b"\n0.2,", b"\n+0.2,", 1),
    "two signs": lambda text: text.replace(b"\n0.2,", b"\n0.2-,", 1),
    "another mark": lambda text: text.replace(b",", b";"),
    "a decimal comma": lambda text: text.replace(b",", b";").replace(b".", b","),
    "thousands": lambda text: text.replace(b"\n0.2,", b'\n"1,234",', 1),
}


def read(content: bytes, number: int, opening: Opening = AS_IT_IS) -> Table | str:
    """The table of a text, or why it is refused."""
    try:
        return registry.table_of_file(FileBytes(content, f"{number:064x}", f"loop {number}.csv"), opening)
    except DataError as error:
        return str(error)


def check(texts: list[bytes], monkeypatch: pytest.MonkeyPatch, opening: Opening = AS_IT_IS) -> int:
    """Read texts one after another, and each of them as the first one, and compare all of the tables; how many had a known layout."""
    known = 0
    monkeypatch.setattr(registry, "_LAYOUTS", layouts := known_layouts.KnownLayouts())
    together = []
    for number, text in enumerate(texts):
        try:
            known += layouts.read(FileBytes(text, "", f"loop {number}.csv"), opening) is not None
        except DataError:
            pass  # both ways refuse it
        together.append(read(text, number, opening))
    for number, (text, found) in enumerate(zip(texts, together, strict=True)):
        monkeypatch.setattr(registry, "_LAYOUTS", known_layouts.KnownLayouts())
        alone = read(text, number, opening)
        if isinstance(alone, str) or isinstance(found, str):
            assert alone == found
            continue
        for field in dataclasses.fields(Table):
            one, other = getattr(alone, field.name), getattr(found, field.name)
            if field.name in ("columns", "curve", "section", "line"):
                np.testing.assert_array_equal(one, other, err_msg=field.name)
                assert np.asarray(one).dtype == np.asarray(other).dtype
            else:
                np.testing.assert_equal(one, other, err_msg=field.name)
    return known


@pytest.mark.parametrize(
    ("kind", "used"),
    [
        *((kind, 2) for kind in ("comma", "metadata", "units", "legacy", "tab")),
        *((kind, 0) for kind in ("no names", "blanks", "whole numbers", "mac", "wide")),
        ("numbers above", 2),
    ],
)
def test_the_third_file_of_a_layout_and_later_ones_are_read_by_it(
    kind: str, used: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert check([KINDS[kind](seed) for seed in range(4)], monkeypatch) == used


def test_files_that_differ_in_anything_are_read_in_full(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = [KINDS["comma"](seed) for seed in range(3)]
    damaged = [damage(KINDS["comma"](10 + k)) for k, damage in enumerate(DAMAGE.values())]
    known = check([*plain, *damaged, KINDS["comma"](99)], monkeypatch)
    assert known == 6  # the third, the last, and those with more rows, other line ends, blanks at the end, a sign


def test_bytes_changed_at_random_give_the_tables_of_reading_in_full(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    texts = [(HEADER + rows(seed, 30)).encode() for seed in range(2)]
    for seed in range(80):
        text = bytearray((HEADER + rows(seed, 30)).encode())
        for place in rng.integers(0, len(text), rng.integers(1, 3)):
            text[place : place + rng.integers(0, 2)] = bytes([rng.choice(CHANGED)])
        texts.append(bytes(text))
    assert check(texts, monkeypatch) > 10


def test_options_for_opening_are_part_of_a_layout(monkeypatch: pytest.MonkeyPatch) -> None:
    texts = [KINDS["comma"](seed) for seed in range(4)]
    assert check(texts, monkeypatch, Opening(delimiter=",", decimal=".")) == 2
    layouts = known_layouts.KnownLayouts()
    monkeypatch.setattr(registry, "_LAYOUTS", layouts)
    for number, text in enumerate(texts):
        read(text, number)
    file = FileBytes(texts[0], "", "loop.csv")
    assert layouts.read(file, Opening()) is not None
    assert layouts.read(file, Opening(delimiter=";")) is None
    assert layouts.read(dataclasses.replace(file, source="loop.mat"), Opening()) is None


def test_arrays_are_not_shared_between_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_LAYOUTS", known_layouts.KnownLayouts())
    *_, one, other = (read(KINDS["comma"](seed), seed) for seed in range(4))
    assert isinstance(one, Table)
    assert isinstance(other, Table)
    one.curve[:], one.section[:], one.line[:] = 5, 5, 5
    assert other.curve.max() == other.section.max() == 0
    assert other.line[0] == 2
