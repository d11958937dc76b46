"""`hystfit run`: the steps of a run file, each in a folder of its own, and a table of how each ended."""

from __future__ import annotations

import contextlib
import datetime
import glob
import json as json_text
import shlex
import shutil
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hystfit.cli.interrupts import INTERRUPTED
from hystfit.cli.study import Step, Study
from hystfit.cli.write import show
from hystfit.errors import DataError
from hystfit.outcome import Column, Table
from hystfit.registry import file_digest
from hystfit.version import version_of

_STATE = "run.json"
_SCHEMA = "hystfit.run/1"
_FINISHED = (0, 1)  # exit statuses of a step that has a result
_WORDS = {0: "usable", 1: "not usable", 2: "failed", INTERRUPTED: "interrupted", None: "not run"}


def run(study: Path, /, *, dry_run: bool = False, json: bool = False) -> int:
    """Run the steps of a study from one file, except those whose inputs have not changed.

    Relative paths are relative to the file. Exit status: that of the worst step; a step whose input failed is not run.

    Args:
        study: TOML file. [steps.NAME] calls the verb NAME (or verb = "...") with its options as keys, without dashes; positional
            arguments are loops, fitdir, reference, what; "{NAME}" in a value is the folder of another step. Above the steps:
            out (folder of all steps; default: the name of the file), seed (for verbs that take one), and [sha256] with
            "FILE" = "DIGEST", which is checked before the first step.
        dry_run: check the file and print the commands.
        json: print run.json instead of the text.
    """
    if not study.parent.is_dir():
        raise DataError(f"no run file {str(study)!r}")
    with contextlib.chdir(study.parent):
        plan = Study.read(Path(study.name))
        plan.check_pins()
        if dry_run:
            print("\n".join(_command(step) for step in plan.steps))
            return 0
        from hystfit.results.saving.folders import alone

        with alone(plan.out):
            state = _State.of(plan)
            for step in plan.steps:
                state.run(step, sys.stderr if json else sys.stdout)
                if state.rows[step.name]["exit_status"] == INTERRUPTED:
                    break
            content = state.write()
    show(f"\n{_table(content).text()}\nWritten to {study.parent / plan.out / _STATE}", content, json)
    return content["exit_status"]


def _command(step: Step) -> str:
    return shlex.join(["hystfit", *step.arguments])


@dataclass
class _State:
    """How the steps of a study ended, on disk after each step: rows by step, of this run and of an earlier one (`known`)."""

    study: Study
    known: dict[str, dict[str, Any]]
    rows: dict[str, dict[str, Any]] = field(default_factory=dict)

    @classmethod
    def of(cls, study: Study) -> _State:
        """The state on disk, or none."""
        file, known = study.out / _STATE, {}
        if file.exists():
            try:
                known = {row["step"]: row for row in json_text.loads(file.read_text(encoding="utf-8"))["steps"]}
            except (ValueError, KeyError, TypeError) as error:
                raise DataError(f"{str(file)!r} is damaged: remove the folder to run all steps again") from error
        for step in study.steps:
            if step.folder.exists() and step.name not in known:
                raise DataError(
                    f"{str(step.folder)!r} exists and is not from this study: move it away, or set another out in {study.file}"
                )
        return cls(study, known)

    def run(self, step: Step, stream: Any) -> None:
        """Run a step unless it is done; its text goes to `stream`."""
        say = lambda *words: print(*words, file=stream, flush=True)
        say(f"== {step.name}: {_command(step)}")
        failed = [need for need in step.needs if self.rows[need]["exit_status"] not in _FINISHED]
        if failed:
            say(f"not run: step {failed[0]} failed or was not run")
            return self._note(step, exit_status=None, outcome=f"needs {failed[0]}")
        inputs, before = self._inputs(step), self.known.get(step.name, {})
        changed = _changed(before["inputs"], inputs) if "inputs" in before else "no earlier result"
        missing = [name for name in before.get("files", ()) if not (step.folder / name).exists()]
        if before.get("exit_status") in _FINISHED and not changed and not missing:
            say(f"unchanged: not run again ({_WORDS[before['exit_status']]})")
            self.rows[step.name] = before | {"outcome": "unchanged"}
            return None
        if changed:
            shutil.rmtree(step.folder, ignore_errors=True)
        if before:
            say(f"run again: {changed or (f'{missing[0]} is missing' if missing else 'it did not finish')}")
        self._note(step, exit_status=INTERRUPTED, outcome="started", inputs=inputs)  # what a killed process leaves
        return self._call(step, inputs, stream)

    def _call(self, step: Step, inputs: dict[str, Any], stream: Any) -> None:
        from hystfit import cli

        started = time.perf_counter()
        with contextlib.redirect_stdout(stream):
            status = cli.run(step.arguments)
        files = sorted(str(path.relative_to(step.folder)) for path in step.folder.rglob("*") if path.is_file())
        took = round(time.perf_counter() - started, 3)
        self._note(step, exit_status=status, outcome="run", inputs=inputs, files=files, seconds=took)

    def _note(self, step: Step, **row: Any) -> None:
        now = datetime.datetime.now(datetime.UTC).isoformat()
        self.rows[step.name] = {"step": step.name, "command": _command(step), "date": now, **row}
        self.write()

    def _inputs(self, step: Step) -> dict[str, Any]:
        """What a step depends on: its command, the SHA-256 of files, when the steps before it ran, versions."""
        return {
            "command": _command(step),
            "files": {name: file_digest(Path(name)) for name in _files(step)},
            "steps": {need: self.rows[need]["date"] for need in step.needs},
            "version": {name: version_of(name) for name in ("hystfit", "jax")},
        }

    def write(self) -> dict[str, Any]:
        """Write run.json: rows of this run, and earlier ones of steps that it has not come to; returns the content."""
        from hystfit.results.saving.folders import dump_json

        rows = {step.name: self.rows.get(step.name) or self.known.get(step.name) for step in self.study.steps}
        rows = {name: row or {"step": name, "exit_status": None} for name, row in rows.items()}
        worst = max((row["exit_status"] or 0 for row in self.rows.values()), default=0)
        content = {"schema": _SCHEMA, "exit_status": worst, "steps": list(rows.values())}
        scratch = self.study.out / f".{_STATE}"
        dump_json(scratch, content)
        scratch.replace(self.study.out / _STATE)
        return content


def _files(step: Step) -> list[str]:
    """Files that the arguments of a step name: data, pairs, patterns, models of the user's, and those of a folder."""
    found: set[Path] = set()
    for source in step.sources:
        for part in {source, *source.split("+")}:
            name = part.partition(".py:")[0] + ".py" if ".py:" in part else part
            for path in map(Path, [name] if Path(name).exists() else glob.glob(name)):
                found |= {file for file in (path.rglob("*") if path.is_dir() else [path]) if file.is_file()}
    return sorted(str(file) for file in found if not file.is_relative_to(step.folder.parent))


def _changed(before: dict[str, Any], now: dict[str, Any]) -> str:
    """What differs between the inputs of two runs, in words; "" where nothing does."""
    for name in sorted({*before["files"], *now["files"]}):
        if before["files"].get(name) != now["files"].get(name):
            return f"{name} has changed"
    for need, date in now["steps"].items():
        if before["steps"].get(need) != date:
            return f"{need} has run again"
    return next((f"another {kind}" for kind in now if before[kind] != now[kind]), "")


def _table(content: dict[str, Any]) -> Table:
    left = lambda head: Column(head, left=True)
    columns = [left("step"), left("result"), left("this time"), Column("seconds", form=".1f"), left("command")]
    return Table(columns, [
        [row["step"], _WORDS[row["exit_status"]], row.get("outcome"), row.get("seconds"), row.get("command")]
        for row in content["steps"]
    ])  # fmt: skip
