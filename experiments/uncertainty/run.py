"""Width and coverage of error bars on simulated loops, calibration of stated setups, and predictions of measured loops.

    python experiments/uncertainty/run.py [--quick] [--out FOLDER] [--only SECTION ...]

Writes results.json to out/ and, in full, the page RESULTS.md here; the full form resumes from the sections of an earlier one in out/.
Exit status: see experiments/common.py.
"""

from __future__ import annotations

import json
import os
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are too small for threads
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import agreement
import bands
import coverage
import default_priors
import one_amplitude
import sbc
import several_seeds
from common import Results, arguments

import hystfit as hf

HERE = Path(__file__).resolve().parent
warnings.filterwarnings("ignore", category=RuntimeWarning, module="numpy")  # columns without a finite error bar


class Page:
    """Sections of the page; the full form stores each finished section with its numbers, and a later run resumes from there."""

    def __init__(self, results: Results):
        self.results = results
        self.parts: list[str] = []
        self.kept = None if results.quick else results.out / "sections"
        if self.kept is not None:
            self.kept.mkdir(parents=True, exist_ok=True)

    def add(self, name: str) -> None:
        """A section, computed now or read from an earlier run."""
        file = None if self.kept is None else self.kept / f"{name}.json"
        if file is not None and file.exists():
            stored = json.loads(file.read_text(encoding="utf-8"))
            for number, value in stored["numbers"].items():
                self.results.add(number, value)
            self.parts.append(stored["text"])
            return
        before, started = set(self.results.numbers), time.process_time()
        made = SECTIONS[name](self.results)
        if made is None:
            return
        text = "\n".join(f"## {title}\n\n{words}" for title, words in made.items())
        text += f"\n({time.process_time() - started:.0f} s of processor time)\n"
        self.parts.append(text)
        if file is not None:
            numbers = {k: v for k, v in self.results.numbers.items() if k not in before}
            scratch = file.with_suffix(".part")
            scratch.write_text(json.dumps({"text": text, "numbers": numbers}, indent=1), encoding="utf-8")
            scratch.replace(file)


def coverages(results: Results) -> dict[str, str]:
    """The tables of `coverage.py` under their titles."""
    tables = coverage.run(results, None if results.quick else results.out / "coverage.jsonl")
    titles = {
        "coverage": "Coverage of 95 % intervals, % (least of the four parameters in brackets)",
        "width": "Median standard error over the standard deviation of the estimates",
        "none": "Parameters without an error bar, replicates with a warning of recurring error, and intervals without a warning that "
        "miss the true value, %",
    }
    return {title: tables[name] for name, title in titles.items() if name in tables}


def sampled(results: Results) -> dict[str, str]:
    """The table of posteriors under its title."""
    words = f"Coverage of central 95 % intervals of the default sampler, records of {coverage.SHORT} samples"
    return {words: coverage.posteriors(results, results.out / "posteriors.jsonl")}


def calibrations(results: Results) -> dict[str, str]:
    """The table of `sbc.py`."""
    return {"Simulation-based calibration": sbc.run(results, None if results.quick else results.out / "sbc")}


def wide(results: Results) -> dict[str, str]:
    """The table of `default_priors.py` under its title."""
    return {
        "Calibration with the default priors of `hf.sample`, Bouc-Wen, independent noise": default_priors.run(
            results, results.out
        )
    }


# In the order of the page; those of FULL (long samplers, measured loops) run only in the full form.
SECTIONS: dict[str, Callable[[Results], dict[str, str] | None]] = {
    "well-determined": lambda r: {
        "Least squares and samplers on a well-determined problem": agreement.well_determined(r)
    },
    "grid": lambda r: {"A curved posterior of two parameters, compared with a grid": agreement.banana_on_a_grid(r)},
    "long-run": lambda r: {
        "A curved posterior of all parameters, compared with a long run": agreement.banana_in_full(r)
    },
    "one-amplitude": lambda r: {f"One amplitude: {k}": v for k, v in one_amplitude.run(r).items()},
    "bands": bands.run,
    "seeds": several_seeds.run,
    "calibration": calibrations,
    "default-priors": wide,
    "coverage": coverages,
    "posteriors": sampled,
}
FULL = ("grid", "long-run", "bands", "seeds", "default-priors", "posteriors")


def main() -> None:
    """Run everything, or some sections."""
    words = "Width and coverage of error bars, calibration, and predictions of measured loops."
    given = arguments(words, tuple(SECTIONS))
    if given.quick and (left_out := [name for name in given.only if name in FULL]):
        sys.exit(f"the quick form has no {', '.join(left_out)}: leave out --quick")
    hf.enable_x64()
    results = Results(HERE, given.quick, given.out)
    if not given.quick:
        for name in [name for name in results.expected if name.endswith(", quick")]:
            del results.expected[name]  # checked in the short form only
    page = Page(results)
    for name in SECTIONS:
        if name in (given.only or SECTIONS) and not (given.quick and name in FULL):
            page.add(name)
    if given.only:
        return
    head = "# Width and coverage of error bars\n\nWritten by `run.py` (full form).\n\n"
    target = results.out if given.quick or results.skipped else HERE
    (target / "RESULTS.md").write_text(head + "\n".join(page.parts), encoding="utf-8")
    results.finish()


if __name__ == "__main__":
    main()
