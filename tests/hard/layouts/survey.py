"""Outcomes of many generated files by kind, and the files that were not read right."""

from __future__ import annotations

import collections
import dataclasses
import tempfile
from collections.abc import Mapping
from pathlib import Path

from .registry import KINDS, layout_of
from .scorer import ASKED, HALF, RIGHT, SILENT, USELESS, score

OUTCOMES = (RIGHT, HALF, ASKED, USELESS, SILENT)


@dataclasses.dataclass(frozen=True)
class Survey:
    """Outcomes of files.

    Attributes:
        counts: number of files by kind and outcome.
        failures: kind, seed, outcome and details of each file that was not read right.
    """

    counts: dict[str, collections.Counter[str]]
    failures: tuple[tuple[str, int, str, str], ...]

    @property
    def total(self) -> collections.Counter[str]:
        """Number of files by outcome."""
        return sum(self.counts.values(), collections.Counter[str]())

    def table(self) -> str:
        """Outcomes by kind, as lines of text."""
        width = max(map(len, self.counts), default=0)
        line = lambda name, cells: f"{name:<{width}} " + " ".join(f"{cell:>18}" for cell in cells)
        lines = [line("kind", OUTCOMES)]
        lines += [line(name, [counts[o] for o in OUTCOMES]) for name, counts in sorted(self.counts.items())]
        return "\n".join([*lines, line("all", [self.total[o] for o in OUTCOMES])])


def survey(seeds: range, keep: Path | None = None) -> Survey:
    """Read the files of some seeds.

    Args:
        keep: folder in which files that are not read right are kept, by kind and seed, with the details as text.
    """
    counts = {name: collections.Counter[str]() for name in KINDS}
    failures = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            name = sorted(KINDS)[seed % len(KINDS)]
            layout = layout_of(seed)
            outcome, details = score(layout, Path(folder))
            counts[name][outcome] += 1
            if outcome != RIGHT:
                details = details.replace(f"{folder}/", "")
                failures.append((name, seed, outcome, details))
                if keep is not None:
                    _keep(keep / name.replace("/", "-") / f"{seed}", layout.files, f"{outcome}: {details}\n")
    return Survey(counts, tuple(failures))


def _keep(folder: Path, files: Mapping[str, bytes], details: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    (folder / "outcome.txt").write_text(details, encoding="utf-8")
