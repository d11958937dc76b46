"""`hystfit run`: the steps of a run file, checked before the first, each in a folder of its own, and a table of how each ended."""

from __future__ import annotations

import contextlib
import datetime
import glob
import json as json_text
import re
import shlex
import shutil
import sys
import time
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

from cyclopts import ArgumentCollection, CycloptsError

from hystfit.cli.interrupts import INTERRUPTED
from hystfit.cli.write import show
from hystfit.errors import DataError
from hystfit.outcome import Column, Table
from hystfit.registry import file_digest, near
from hystfit.version import version_of

_KEYS = ("out", "seed", "sha256", "steps")
_FOLDERS = ("--out", "--c")  # options that name the folder of a verb
_BY_STUDY = (*_FOLDERS, "--json")
_REFERENCE = re.compile(r"\{([^{}]*)\}")
_NAME = re.compile(r"[\w-]+")


@dataclass(frozen=True)
class Step:
    """One call of a verb that writes `folder`; `needs` are steps whose folders it uses, `sources` values that may name files or folders."""

    name: str
    arguments: tuple[str, ...]
    folder: Path
    needs: tuple[str, ...]
    sources: tuple[str, ...]


@dataclass(frozen=True)
class Study:
    """A run file: `out` is the folder of all steps, `sha256` pinned digests by file; steps that others need come first."""

    file: Path
    out: Path
    sha256: Mapping[str, str]
    steps: tuple[Step, ...]

    @classmethod
    def read(cls, file: Path) -> Study:
        """The steps of a file."""
        content = _toml(file)
        where = str(file)
        _refuse_unknown(where, content, _KEYS)
        out, seed = _typed(where, content, "out", str, file.stem), _typed(where, content, "seed", int, None)
        pins = _typed(where, content, "sha256", dict, {})
        for name in pins:
            _typed(f"{where} [sha256]", pins, name, str, "")
        tables = _typed(where, content, "steps", dict, {})
        if not tables:
            raise DataError(f"{where} has no steps: write one as [steps.fit] with loops and options below it")
        read = {name: _step(f"{where} [steps.{name}]", name, tables, Path(out), seed) for name in tables}
        return cls(file, Path(out), pins, _in_order(where, read))

    def check_pins(self) -> None:
        """Compare the pinned files with their SHA-256."""
        for name, pinned in self.sha256.items():
            actual = file_digest(Path(name))
            if actual is None:
                raise DataError(f"{self.file} pins the SHA-256 of {name!r}, which cannot be read")
            if actual != pinned.lower():
                raise DataError(
                    f"{name!r} has SHA-256 {actual}, {self.file} pins {pinned}: restore the file, or pin the new one"
                )


def _in_order(where: str, steps: Mapping[str, Step]) -> tuple[Step, ...]:
    """Steps in the order of the file, but each after those that it needs."""
    try:
        TopologicalSorter({name: step.needs for name, step in steps.items()}).prepare()
    except CycleError as error:
        raise DataError(f"{where}: steps depend on each other in a cycle: {' -> '.join(error.args[1])}") from None
    ordered: dict[str, Step] = {}

    def place(name: str) -> None:
        for need in steps[name].needs:
            place(need)
        ordered.setdefault(name, steps[name])

    for name in steps:
        place(name)
    return tuple(ordered.values())


def _toml(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DataError(f"no run file {str(file)!r}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DataError(f"{file} is not TOML: {error}") from None


def _typed(where: str, table: Mapping[str, Any], key: str, kind: type, default: Any) -> Any:
    value = table.get(key, default)
    if value is not default and (not isinstance(value, kind) or isinstance(value, bool)):
        words = {str: "text", int: "a whole number", dict: "a table"}
        raise DataError(f"{where}: {key} must be {words[kind]}, got {value!r}")
    return value


def _refuse_unknown(where: str, table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            raise DataError(f"{where}: unknown key {key!r}{near(key, known) or '; known are ' + ', '.join(known)}")


def _step(where: str, name: str, tables: Mapping[str, Any], out: Path, seed: int | None) -> Step:
    """One step, its options checked by the parser of the command line."""
    from hystfit.cli import app
    from hystfit.cli.verbs import VERBS

    table = dict(_typed(where, tables, name, dict, {}))
    if not _NAME.fullmatch(name):
        raise DataError(f"{where}: a step is named by letters, digits, - and _, because its folder has this name")
    verb = str(table.pop("verb", name))
    if verb not in VERBS:
        hint = near(verb, VERBS) or (
            "" if "verb" in tables[name] else ': name the verb of this step, such as verb = "fit"'
        )
        raise DataError(f"{where}: no verb {verb!r}{hint}")
    arguments = app[verb].assemble_argument_collection()
    options = {argument.name: argument for argument in arguments}
    folder_option = next((option for option in _FOLDERS if option in options), None)
    if folder_option is None:
        raise DataError(f"{where}: {verb} writes no folder, so that it cannot be a step")
    if "--seed" in options and seed is not None:
        table.setdefault("seed", seed)
    needs: list[str] = []
    words, sources = _words(where, table, arguments, lambda text: _resolved(where, text, tables, out, needs))
    words = (verb, *words, f"{folder_option}={out / name}")
    try:
        app.parse_args(list(words), exit_on_error=False, print_error=False)
    except CycloptsError as error:
        raise DataError(f"{where}: {error}") from None
    return Step(name, words, out / name, tuple(dict.fromkeys(needs)), sources)


def _words(
    where: str, table: Mapping[str, Any], arguments: ArgumentCollection, resolve: Any
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """A table of options as words of a command line, and the values that may name files."""
    by_key = {argument.name.lstrip("-").lower(): argument for argument in arguments if not argument.children}
    takes_loops = "loops" in by_key
    for option in _BY_STUDY:
        by_key.pop(option.lstrip("-"), None)
    any_name = by_key.pop("[keyword]", None) is not None  # parameters of a signal
    if not any_name:
        _refuse_unknown(where, table, ("verb", *by_key))
    if takes_loops and not table.get("loops"):
        raise DataError(f'{where}: LOOP is missing: name the file of a measured loop, as loops = "loop.csv"')
    positional, named, sources = [], [], []
    in_order = sorted(table, key=lambda key: getattr(by_key.get(key), "index", None) or 0)
    for key in in_order:
        argument, value = by_key.get(key), table[key]
        if argument is not None and argument.is_flag():
            if not isinstance(value, bool):
                raise DataError(f"{where}: {key} must be true or false, got {value!r}")
            named += [argument.name] if value else []
            continue
        values = value if isinstance(value, list) else [value]
        for one in values:
            if isinstance(one, bool) or not isinstance(one, str | int | float):
                raise DataError(f"{where}: {key} must be text or a number, got {value!r}")
        texts = [resolve(str(one)) for one in values]
        sources += [text for text, one in zip(texts, values, strict=True) if isinstance(one, str)]
        if argument is not None and argument.index is not None:
            positional += texts
        else:
            named += [f"--{key}={text}" for text in texts]
    return (*positional, *named), tuple(sources)


def _resolved(where: str, text: str, tables: Mapping[str, Any], out: Path, needs: list[str]) -> str:
    """A text in which names of steps in braces are their folders; the names are added to `needs`."""

    def folder(match: re.Match[str]) -> str:
        if match[1] not in tables:
            raise DataError(
                f"{where}: {text!r} refers to no step{near(match[1], tables)}; there are {', '.join(tables)}"
            )
        needs.append(match[1])
        return str(out / match[1])

    return _REFERENCE.sub(folder, text)


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
