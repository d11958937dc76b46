"""The quick form of the hard tests (`make hard` runs the full one), and proof that they find what they search for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Record
from hystfit.errors import DataError
from hystfit.outcome import Code, Severity

from .hard import reading
from .hard.dialects import case_of
from .hard.layouts import ASKED, HALF, RIGHT, SILENT, USELESS, layout_of, score, survey
from .hard.layouts import scorer as layout_scorer
from .hard.layouts.truth import Layout, Loop, loops

FILES, MUTATIONS, LAYOUTS = range(300), range(210), range(300)


def test_generated_files_are_read_right_or_not_in_silence() -> None:
    counts, bad = reading.run("files", FILES)
    assert bad == []
    assert sum(counts.values()) == len(FILES)
    assert counts["right"] > 0.9 * len(FILES)


def test_damaged_files_are_refused_or_read() -> None:
    counts, bad = reading.run("mutations", MUTATIONS)
    assert bad == []
    assert counts["read"] > 0.1 * len(MUTATIONS)
    assert counts["refused"] > 0.1 * len(MUTATIONS)


def test_runs_resume(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, seeds = tmp_path / "out.json", []
    monkeypatch.setitem(reading.RUNS, "files", lambda seed, folder: (seeds.append(seed), ("right", ""))[1])
    assert reading.run("files", range(5), out)[0]["right"] == 5
    assert reading.run("files", range(5), out)[0]["right"] == 5
    assert seeds == [0, 1, 2, 3, 4]


def test_wrong_reads_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that swaps columns, loses a sample or the time, or fails, does not pass."""
    seed = next(seed for seed in range(99) if case_of(seed).t is not None and np.isfinite(case_of(seed).y).all())
    case = case_of(seed)
    readers = {
        "right": lambda *_, **__: Record(case.u, case.y, case.t),
        "wrong": lambda *_, **__: Record(case.y, case.u, case.t),
        "crashed": lambda *_, **__: 1 / 0,
    }
    for outcome, reader in readers.items():
        monkeypatch.setattr(reading, "read", reader)
        assert reading.outcome_of_file(seed, tmp_path)[0] == outcome
    for record in (Record(case.u, case.y), Record(case.u[1:], case.y[1:], case.t[1:])):  # type: ignore[index]
        monkeypatch.setattr(reading, "read", lambda *_, record=record, **__: record)
        assert reading.outcome_of_file(seed, tmp_path)[0] == "wrong"


def test_files_as_instruments_write_them_are_read_right() -> None:
    """At least 98 of 100 without any option, none wrong in silence; the others name the remedy or leave a unit open."""
    found = survey(LAYOUTS)
    assert sum(found.total.values()) == len(LAYOUTS)
    assert all(counts.total() for counts in found.counts.values())
    silent = [f"{seed} {kind}: {details}" for kind, seed, outcome, details in found.failures if outcome == SILENT]
    assert not silent, "\n".join(silent)
    assert found.total[RIGHT] >= 0.98 * len(LAYOUTS), found.table()


def test_layouts_are_the_same_for_a_seed() -> None:
    assert all(layout_of(seed).files == layout_of(seed).files for seed in range(0, 63, 9))


def _outcome(
    monkeypatch: pytest.MonkeyPatch, folder: Path, layout: Layout, answers: dict[tuple[str, ...], Record | str]
) -> str:
    """Outcome where the reader gives a record, or an error of this text, for the values of the options."""

    def reader(_path: Path, **options: object) -> Record:
        answer = answers[tuple(str(value) for value in options.values())]
        if isinstance(answer, str):
            raise DataError(answer)
        return answer

    monkeypatch.setattr(layout_scorer, "read", reader)
    return score(layout, folder)[0]


def test_layout_outcomes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scorer tells a right reading from exchanged columns, other units, lost samples and errors with and without a remedy."""
    u, y = np.sin(np.arange(50.0)), np.cos(np.arange(50.0))
    layout = Layout("", {"file.txt": b""}, loops(Loop(u, y, "T", "um")))
    right = Record(u, y, u_unit="T", y_unit="um")
    exchanged = Record(y, u, u_unit="um", y_unit="T")
    outcome = lambda record, of=layout, **more: _outcome(
        monkeypatch, tmp_path, of, {(): record, **more.get("others", {})}
    )
    assert outcome(right) == RIGHT
    assert outcome(Record(1e3 * u, y / 1e3, u_unit="mT", y_unit="mm")) == RIGHT
    assert outcome(Record(u, y)) == HALF
    assert outcome(exchanged) == SILENT
    assert outcome(exchanged.noted(Code.COLUMN_CHOICE, "exchanged?", Severity.WARNING)) == ASKED
    assert outcome(exchanged.noted(Code.LEFT_OUT, "a row is left out", Severity.WARNING)) == SILENT
    assert outcome(Record(u, y, u_unit="mT", y_unit="um")) == SILENT
    assert outcome(Record(u[1:], y[1:], u_unit="T", y_unit="um")) == SILENT
    question, remedy = "choose, such as --input B --output x", {("B", "x"): right, ("B",): right, ("x",): right}
    assert outcome(question, others=remedy) == ASKED
    assert outcome(question, others=dict.fromkeys(remedy, exchanged)) == USELESS
    assert outcome("the file is odd") == USELESS
    asked = Layout("", layout.files, layout.truths, ask=True, answer={"input": "B", "output": "x"})
    assert outcome(question, asked, others=remedy) == RIGHT
    assert outcome(right, asked) == SILENT
