"""The file of `hystfit run`: steps, each a verb with its options, checked against the options of the command line."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

from cyclopts import ArgumentCollection, CycloptsError

from hystfit.errors import DataError
from hystfit.registry import file_digest, near

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
