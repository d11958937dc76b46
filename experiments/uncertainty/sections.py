"""The page of the results, section by section, see run.py."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from common import Results

Section = Callable[[Results], dict[str, str]]  # its tables under their titles


class Page:
    """Sections of the page, in order, by the functions that compute them.

    The full form stores each finished section with its numbers, and a later run resumes from there.
    """

    def __init__(self, results: Results, sections: Mapping[str, Section]):
        self.results, self.sections = results, sections
        self.parts: dict[str, str] = {}
        self.kept = None if results.quick else results.out / "sections"
        if self.kept is not None:
            self.kept.mkdir(parents=True, exist_ok=True)

    def stored(self, name: str) -> dict[str, Any] | None:
        """A section of an earlier run."""
        file = None if self.kept is None else self.kept / f"{name}.json"
        return json.loads(file.read_text(encoding="utf-8")) if file is not None and file.exists() else None

    def add(self, name: str) -> None:
        """A section, computed now or read from an earlier run."""
        earlier = self.stored(name)
        if earlier is not None:
            for number, value in earlier["numbers"].items():
                self.results.add(number, value)
            self.parts[name] = earlier["text"]
            return
        before, started = set(self.results.numbers), time.process_time()
        made = self.sections[name](self.results)
        text = "\n".join(f"## {title}\n\n{words}" for title, words in made.items())
        text += f"\n({time.process_time() - started:.0f} s of processor time)\n"
        self.parts[name] = text
        if self.kept is not None:
            numbers = {k: v for k, v in self.results.numbers.items() if k not in before}
            scratch = self.kept / f"{name}.part"
            scratch.write_text(json.dumps({"text": text, "numbers": numbers}, indent=1), encoding="utf-8")
            scratch.replace(self.kept / f"{name}.json")

    def write(self, folder: Path) -> None:
        """RESULTS.md with the sections of this run and, in full, those of earlier ones; the page names the others."""
        found = {
            name: earlier["text"] for name in self.sections if (earlier := self.stored(name)) is not None
        } | self.parts
        head = "# Width and coverage of error bars\n\nWritten by `run.py` (full form).\n"
        missing = [name for name in self.sections if name not in found]
        words = [f"Sections that were not computed: {', '.join(missing)}.\n"] if missing else []
        parts = [head, *words, *(found[name] for name in self.sections if name in found)]
        (folder / "RESULTS.md").write_text("\n".join(parts), encoding="utf-8")
