"""Shared by the experiments: numbers by name, compared with expected.json, written as JSON and as a Markdown page.

Exit status of every run.py:

    0    all numbers within their limits (status "ok")
    1    a number outside its limits or not computed (status "missed")
    77   no number missed, but parts skipped because their measured data were not found (status "skipped")

`results.json` holds the status and the reason for each skipped part. Measured data come from the folder that HYSTFIT_DATA names;
the full form downloads what is not there.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import re
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import hystfit as hf
from hystfit.errors import DataError
from hystfit.outcome import Status
from hystfit.reading.datasets import FOLDER_VARIABLE

EXIT = {Status.OK: 0, Status.MISSED: 1, Status.SKIPPED: 77}


def times(record: hf.Record) -> np.ndarray:
    """Times of a record that has them [t_unit], shape (T,)."""
    assert record.t is not None
    return record.t


def arguments(description: str, sections: Sequence[str] = ()) -> argparse.Namespace:
    """Command line of an experiment: --quick, --out, and --only where the experiment has sections.

    Args:
        description: for --help.
        sections: names that --only accepts.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="the same checks on less data, without downloads")
    parser.add_argument("--out", type=Path, default=None, help="folder for figures and results.json")
    if sections:
        only = "compute only these sections of the full form; a later run without --only assembles the page"
        parser.add_argument("--only", nargs="+", choices=sections, default=(), help=only)
    return parser.parse_args()


class Results:
    """Numbers of one run, compared with expected.json.

    An expectation is {"value": v, "tolerance": t} (within t of v) or {"bar": b} (at most b; at least b with "sense": "min"), with
    "kind" ("in-sample", "held-out" or "simulated"), "data" ("simulated", on a surrogate, or "measured"), "guards" (the effect that a
    limit further than a factor 2 from the value stands for), and "quick": false where the short form does not compute the number.

    Args:
        folder: of the experiment, with expected.json.
        quick: whether this is the short form.
        out: folder for figures and results.json; out/ beside expected.json by default.
    """

    def __init__(self, folder: Path, quick: bool, out: Path | None = None):
        self.folder, self.quick = folder, quick
        self.out = out or folder / "out"
        self.out.mkdir(parents=True, exist_ok=True)
        self.expected: dict[str, dict[str, Any]] = json.loads((folder / "expected.json").read_text(encoding="utf-8"))
        self.numbers: dict[str, float] = {}
        self.skipped: dict[str, str] = {}
        self.started = time.perf_counter()

    def add(self, name: str, value: float) -> float:
        """Record a number and print it beside its expectation."""
        self.numbers[name] = float(value)
        print(f"  {name:<52} {value:>12.5g}   {self.verdict(name)}", flush=True)
        return value

    def load(self, parts: str | Sequence[str], *names: str) -> tuple[Any, ...] | None:
        """Measured data sets by name, or None where they are not found; the numbers that need them are then skipped.

        Args:
            parts: how the names of the numbers that need these data begin.
            names: of the data sets.

        Raises:
            DataError: the folder of a set exists, but a file in it is missing, damaged or not readable.
        """
        try:
            return tuple(hf.datasets.load(name, download=not self.quick) for name in names)
        except DataError as error:
            local = os.environ.get(FOLDER_VARIABLE)
            if local and any((Path(local) / name.partition("/")[0]).is_dir() for name in names):
                raise  # present, but damaged or not readable
            for part in [parts] if isinstance(parts, str) else parts:
                self.skipped[part] = str(error)
                print(f"  skipped: {part}: {error}", flush=True)
            return None

    def verdict(self, name: str) -> str:
        """The expectation of a number, and whether it is met."""
        expectation = self.expected.get(name)
        if expectation is None or (self.quick and expectation.get("quick") is False):
            return "(reported)" if expectation is None else "(checked in the full form)"
        outcome = "ok" if self.passes(name) else "MISSED"
        if "bar" in expectation:
            sign = ">=" if expectation.get("sense") == "min" else "<="
            return f"{sign} {expectation['bar']:g} {outcome}"
        return f"{expectation['value']:g} +- {expectation['tolerance']:g} {outcome}"

    def origin(self, name: str) -> str:
        """Whether a number comes from a simulated surrogate or from measured data; empty without an expectation."""
        return self.expected.get(name, {}).get("data", "")

    def fill(self, text: str, values: Mapping[str, str]) -> str:
        """A page with {{name}} replaced by values, and {{number NAME}} by that number with three digits where it was computed.

        Args:
            text: the page.
            values: by name.
        """
        for name, value in values.items():
            text = text.replace("{{" + name + "}}", value)
        digits = lambda value: "-" if math.isnan(value) else f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
        return re.sub(r"{{number ([^}]*)}}", lambda match: digits(self.numbers.get(match[1], float("nan"))), text)

    def passes(self, name: str) -> bool:
        """Whether a number meets its expectation; a number that is not finite never does."""
        expectation, value = self.expected[name], self.numbers[name]
        if not math.isfinite(value):
            return False
        if "bar" in expectation:
            return value >= expectation["bar"] if expectation.get("sense") == "min" else value <= expectation["bar"]
        return abs(value - expectation["value"]) <= expectation["tolerance"]

    def failures(self) -> list[str]:
        """Expectations that are not met, or whose number was not computed although its data were found."""
        due = [name for name, expectation in self.expected.items() if expectation.get("quick", True) or not self.quick]
        due = [name for name in due if not name.startswith(tuple(self.skipped))]
        return [name for name in due if name not in self.numbers or not self.passes(name)]

    @property
    def status(self) -> Status:
        """Missed where an expectation is not met, else skipped where measured data were not found, else ok."""
        return Status.MISSED if self.failures() else Status.SKIPPED if self.skipped else Status.OK

    def measured_path(self, parts: str, name: str) -> Path | None:
        """A folder or a file among the measured data; None where it is missing, and the parts that need it are skipped."""
        path = Path(os.environ.get(FOLDER_VARIABLE, "")) / name
        if os.environ.get(FOLDER_VARIABLE) and path.exists():
            return path
        self.skipped[parts] = f"{name} is not in the folder that {FOLDER_VARIABLE} names"
        print(f"  skipped: {parts}: {self.skipped[parts]}", flush=True)
        return None

    def publish(self, title: str, script: str, tables: Mapping[str, str]) -> None:
        """Write RESULTS.md with a section for each table to the folder of the run; the full form with all data, beside the script too."""
        head = f"# {title}\n\nMade by `python {script}`, hystfit {hf.__version__}.\n"
        text = "\n".join([head, *(f"## {name}\n\n{table}" for name, table in tables.items())])
        folders = [self.out] if self.quick or self.skipped else [self.out, self.folder]
        for folder in folders:
            (folder / "RESULTS.md").write_text(text, encoding="utf-8")

    def finish(self) -> None:
        """Write results.json and end the program with the exit status listed at the top of this file."""
        failed, status = self.failures(), self.status
        content = {
            "status": status,
            "quick": self.quick,
            "numbers": self.numbers,
            "failed": failed,
            "skipped": self.skipped,
        }
        (self.out / "results.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        seconds = time.perf_counter() - self.started
        counts = f"{len(self.numbers)} numbers, {len(failed)} missed, {len(self.skipped)} parts skipped"
        print(f"{status}: {counts}, {seconds:.0f} s")
        for name in failed:
            computed = f"{self.numbers[name]:.5g} ({self.verdict(name)})" if name in self.numbers else "not computed"
            print(f"  missed: {name}: {computed}")
        for part in self.skipped:
            print(f"  skipped: {part}: measured data not found")
        sys.exit(EXIT[status])


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table; floats with four significant digits.

    Args:
        head: headings.
        rows: cells, as many a row as there are headings; None leaves a cell empty.
    """
    text = lambda cell: f"{cell:.4g}" if isinstance(cell, float) else "" if cell is None else str(cell)
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(text(cell) for cell in row) + " |" for row in rows]) + "\n"


@dataclasses.dataclass(frozen=True)
class Mutation:
    """A deliberate fault, and the part of an experiment whose expectations must notice it (experiments/mutations.py).

    Attributes:
        name: what is changed.
        breaks: what is missing or wrong then.
        apply: puts the fault in place; called once, in a process of its own, before the part.
        part: computes numbers of the quick form; without the fault it must meet their expectations.
    """

    name: str
    breaks: str
    apply: Callable[[], None]
    part: Callable[[Results], object]


def substitute(original: Any, mutant: Any) -> None:
    """Replace a function or class wherever a loaded module holds it by name.

    Raises:
        LookupError: no loaded module holds it.
    """
    places = [
        (m, k) for m in list(sys.modules.values()) for k, v in list(getattr(m, "__dict__", {}).items()) if v is original
    ]
    if not places:
        raise LookupError(f"no loaded module holds {original!r}")
    for module, name in places:
        setattr(module, name, mutant)
