"""Parts of other files of the repository that pages show."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def section(path: str, heading: str) -> str:
    """The text of a section of a Markdown file, without its heading and its subsections.

    Args:
        path: from the root of the repository.
        heading: of the section.

    Raises:
        ValueError: there is no such section.
    """
    text = (ROOT / path).read_text(encoding="utf-8")
    found = re.search(rf"^(#+) {re.escape(heading)}\n(.*?)(?=^#|\Z)", text, flags=re.DOTALL | re.MULTILINE)
    if not found:
        raise ValueError(f"{path} has no section {heading!r}")
    return re.sub(r"\n\(\d+ s of processor time\)\s*$", "", found[2]).strip()


def coverage() -> str:
    """Coverage of 95 % intervals by kind of noise and method."""
    return section(
        "experiments/uncertainty/RESULTS.md", "Coverage of 95 % intervals, % (least of the four parameters in brackets)"
    )


def sbc() -> str:
    """Simulation-based calibration."""
    return section("experiments/uncertainty/RESULTS.md", "Simulation-based calibration")


def contributing() -> str:
    """How to add a model, a noise model, an identifier or a sampler."""
    parts = ("A new noise model, identifier or sampler",)
    rest = (f"## {heading}\n\n{section('CONTRIBUTING.md', heading)}" for heading in parts)
    return "\n\n".join([_new_model(), *rest])


def _new_model() -> str:
    """The section on models, whose code has lines that begin like headings."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    return text.partition("## A new model\n")[2].partition("\n## ")[0].strip()
