"""Width and coverage of error bars on simulated loops, calibration of stated setups, and predictions of measured loops.

    python experiments/uncertainty/run.py [--quick] [--out FOLDER] [--only SECTION ...]

Writes results.json to out/ and, in full, the page RESULTS.md here; the full form resumes from the sections of an earlier one in out/.
With --only, the page of all sections in out/ is written there and names those that are missing.
Exit status: see experiments/common.py.
"""

from __future__ import annotations

import os
import sys
import warnings
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
from sections import Page, Section

import hystfit as hf

HERE = Path(__file__).resolve().parent
warnings.filterwarnings("ignore", category=RuntimeWarning, module="numpy")  # columns without a finite error bar


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
SECTIONS: dict[str, Section] = {
    "well-determined": lambda r: {
        "Least squares and samplers on a well-determined problem": agreement.well_determined(r)
    },
    "grid": lambda r: {"A curved posterior of two parameters, compared with a grid": agreement.banana_on_a_grid(r)},
    "long-run": lambda r: {
        "A curved posterior of all parameters, compared with a long run": agreement.banana_in_full(r)
    },
    "one-amplitude": lambda r: {f"One amplitude: {k}": v for k, v in one_amplitude.run(r).items()},
    "bands": bands.run,
    "seeds": several_seeds.short,
    "seeds-of-sets": several_seeds.long,
    "calibration": calibrations,
    "default-priors": wide,
    "coverage": coverages,
    "posteriors": sampled,
}
FULL = ("grid", "long-run", "bands", "seeds", "seeds-of-sets", "default-priors", "posteriors")


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
    page = Page(results, SECTIONS)
    for name in SECTIONS:
        if name in (given.only or SECTIONS) and not (given.quick and name in FULL):
            page.add(name)
    page.write(results.out if given.quick or given.only or results.skipped else HERE)
    if not given.only:
        results.finish()


if __name__ == "__main__":
    main()
