"""Text of the command line at the width of a terminal: no line of prose, and no table, is wider; commands stay whole."""

from __future__ import annotations

import os
import pty
import struct
import subprocess
import sys
import termios
from fcntl import ioctl

import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.outcome import Column, Table
from hystfit.outcome.wrapping import NAMED, listed, within
from hystfit.params.units import with_unit

from .conftest import ROOT


def test_prose_goes_on_below_its_own_beginning():
    assert within("  - one two three four", 12) == "  - one two\n    three\n    four"
    assert within("  yes  lag: one two three", 20) == "  yes  lag: one two\n       three"
    assert within("note: one two three four", 15) == "note: one two\n  three four"


def test_a_long_list_names_the_first_and_counts_the_others():
    names = [f"w[{k}]" for k in range(NAMED + 2)]
    assert listed(names[:NAMED]) == ", ".join(names[:NAMED])
    assert listed(names) == ", ".join(names[:NAMED]) + " and 2 more"


def test_every_word_is_kept_and_short_lines_stay():
    text = "Findings\n\n  - " + "word " * 40 + "end\n    a  b\n"
    shown = within(text, 50)
    assert shown.split() == text.split()
    assert max(map(len, shown.split("\n"))) <= 50
    assert within(shown, 50) == shown


@pytest.mark.parametrize(
    "line",
    ["      hystfit predict fit NEW_LOOP --by=loop --time=0", "hystfit fit a.csv --out b", "  cc -O2 a.c b.c -lm -o a"],
)
def test_commands_stay_whole(line):
    assert within(line, 20) == line


def test_a_wide_table_is_shown_in_parts_beside_its_first_column():
    columns = [Column("model"), *(Column(f"number {k}") for k in range(6))]
    table = Table(columns, [["duhem", *range(6)], ["preisach", *range(10, 16)]])
    lines = table.lines("  ", 40)
    assert max(map(len, lines)) <= 40
    assert [line.split()[0] for line in lines if line] == ["model", "duhem", "preisach"] * 2
    assert [cell for line in lines if line.startswith("  duhem") for cell in line.split()[1:]] == list("012345")
    assert table.lines("  ", 200) == table.lines("  ")


def test_unknown_units_keep_their_own_brackets():
    assert [with_unit("k", unit) for unit in ("", "um/V", "[y]/[u]", "1/[u]")] == [
        "k",
        "k [um/V]",
        "k [y]/[u]",
        "k 1/[u]",
    ]


@pytest.fixture(scope="module")
def record(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("record") / "loop.csv"
    path.write_text("\n".join((ROOT / "data" / "stage_sweep.csv").read_text().splitlines()[:300]) + "\n")
    return str(path)


def on_terminal(columns: int, *words: str) -> str:
    """What a command writes to a terminal of this many columns."""
    master, slave = pty.openpty()
    ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    environment = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}
    command = [sys.executable, "-m", "hystfit", *words]
    process = subprocess.Popen(command, stdout=slave, stderr=subprocess.DEVNULL, env=environment)
    os.close(slave)
    parts = []
    while True:
        try:
            part = os.read(master, 65536)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        parts.append(part)
    os.close(master)
    assert process.wait(120) == 0
    return b"".join(parts).decode().replace("\r\n", "\n")


def test_check_fits_the_terminal_and_is_one_line_a_note_elsewhere(record, capsys):
    words = "check", record, "--data-only"
    shown = on_terminal(80, *words)
    wide = [line for line in shown.split("\n") if len(line) > 80 and not line.startswith("hystfit ")]
    assert wide == []
    assert run([*words]) == 0
    piped = capsys.readouterr().out
    assert piped.split() == shown.split()
    assert max(map(len, piped.split("\n"))) > 80


def test_a_report_without_units_says_what_their_place_means():
    from hystfit.results.report import text_report

    known = hf.datasets.load("stage-sine").window(0.0, 2.0)
    unknown = known.replace(u_unit="", y_unit="")
    words = "[u] and [y]: unit of the input and output, which the data do not name"
    for record, expected in ((known, False), (unknown, True)):
        text = text_report(hf.fit("bouc-wen", record, starts=1))
        assert (words in text) is expected
