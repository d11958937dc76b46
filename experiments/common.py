"""What the experiments share: numbers by name, checked against expected.json, written as JSON and as a Markdown page."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def arguments(description: str, sections: Sequence[str] = ()) -> argparse.Namespace:
    """Command line of an experiment: --quick for the short form, --out for another folder than out/, --only for some sections."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="the same checks on less")
    parser.add_argument("--out", type=Path, default=None, help="folder for figures and results.json")
    if sections:
        only = "make only these sections of the full form, for a later run to put together"
        parser.add_argument("--only", nargs="+", choices=sections, default=(), help=only)
    return parser.parse_args()


class Results:
    """Numbers of one run, and whether each is what expected.json asks for.

    An expectation is {"value": v, "tolerance": t} (within t of v) or {"bar": b} (at most b; at least b with "sense": "min"), with
    "kind" ("in-sample", "held-out" or "simulated"), and "quick": false where the short form does not make it.
    """

    def __init__(self, folder: Path, quick: bool, out: Path | None = None):
        self.folder, self.quick = folder, quick
        self.out = out or folder / "out"
        self.out.mkdir(parents=True, exist_ok=True)
        self.expected: dict[str, dict[str, Any]] = json.loads((folder / "expected.json").read_text(encoding="utf-8"))
        self.numbers: dict[str, float] = {}
        self.skipped: tuple[str, ...] = ()
        self.started = time.perf_counter()

    def add(self, name: str, value: float) -> float:
        """Record a number and print it beside what is expected."""
        self.numbers[name] = float(value)
        print(f"  {name:<52} {value:>12.5g}   {self.verdict(name)}", flush=True)
        return value

    def skip(self, start: str, why: str) -> None:
        """Leave out the numbers whose names begin like this, and say why."""
        self.skipped = (*self.skipped, start)
        print(f"  no number of {start!r}: {why}", flush=True)

    def verdict(self, name: str) -> str:
        """What a number has to be, and whether it is."""
        asked = self.expected.get(name)
        if asked is None or (self.quick and asked.get("quick") is False):
            return "(reported)" if asked is None else "(judged in the full form)"
        if "bar" in asked:
            sign = ">=" if asked.get("sense") == "min" else "<="
            return f"{sign} {asked['bar']:g} {'ok' if self.passes(name) else 'FAILED'}"
        return f"{asked['value']:g} +- {asked['tolerance']:g} {'ok' if self.passes(name) else 'FAILED'}"

    def passes(self, name: str) -> bool:
        """Whether a number meets its expectation; a number that is not finite never does."""
        asked, value = self.expected[name], self.numbers[name]
        if not math.isfinite(value):
            return False
        if "bar" in asked:
            return value >= asked["bar"] if asked.get("sense") == "min" else value <= asked["bar"]
        return abs(value - asked["value"]) <= asked["tolerance"]

    def failures(self) -> list[str]:
        """Expectations that were missed, or whose number was never made."""
        due = [name for name, asked in self.expected.items() if asked.get("quick", True) or not self.quick]
        due = [name for name in due if not name.startswith(self.skipped)]
        return [name for name in due if name not in self.numbers or not self.passes(name)]

    def finish(self) -> None:
        """Write results.json and end the program: status 1 where an expectation was missed."""
        failed = self.failures()
        content = {"quick": self.quick, "numbers": self.numbers, "failed": failed}
        (self.out / "results.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        print(f"{len(self.numbers)} numbers, {len(failed)} missed, {time.perf_counter() - self.started:.0f} s")
        for name in failed:
            print(
                f"  missed: {name}: {self.numbers.get(name, 'never made')} ({self.verdict(name) if name in self.numbers else ''})"
            )
        sys.exit(1 if failed else 0)


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table; floats with four significant digits."""
    text = lambda cell: f"{cell:.4g}" if isinstance(cell, float) else "" if cell is None else str(cell)
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(text(cell) for cell in row) + " |" for row in rows]) + "\n"
