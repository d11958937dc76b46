"""Error bars on trial: width and coverage where the truth is known, calibration of stated pairs, and a measured piezo stack.

    python experiments/uncertainty/run.py [--quick] [--out FOLDER]

Writes results.json to out/ and, in full, the page RESULTS.md here; the full form goes on from what an interrupted one left in out/.
Status 1 where a number misses expected.json.
"""

from __future__ import annotations

import os
import sys
import time
import warnings
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads would only wait for each other
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import agreement
import coverage
import one_amplitude
import piezo
import sbc
from common import Results, arguments

import hystfit as hf

HERE = Path(__file__).resolve().parent
warnings.filterwarnings("ignore", category=RuntimeWarning, module="numpy")  # columns without one finite error bar


def main() -> None:
    """Run everything."""
    given = arguments("Width and coverage of error bars, calibration, and predictions of a measured piezo stack.")
    hf.enable_x64()
    results = Results(HERE, given.quick, given.out)
    parts, started = [], time.perf_counter()

    def section(title: str, *pieces: str) -> None:
        nonlocal started
        parts.append("\n".join([f"## {title}\n", *pieces, f"({time.perf_counter() - started:.0f} s)\n"]))
        started = time.perf_counter()

    section("Least squares, NUTS and emcee on a well-determined problem", agreement.well_determined(results))
    if not given.quick:
        section("A bent posterior of two parameters, beside a grid", agreement.banana_on_a_grid(results))
        section("A bent posterior of all parameters, beside a long run", agreement.banana_in_full(results))
    section("One amplitude", *one_amplitude.run(results).values())
    tables = coverage.run(results, None if given.quick else results.out / "coverage.jsonl")
    section("Coverage of 95 % intervals, % (least of the four parameters in brackets)", tables["coverage"])
    section("Median standard error over the spread of the estimates", tables["width"])
    if "samplers" in tables:
        section("Samplers on the first replicates", tables["samplers"])
    section("Simulation-based calibration", sbc.run(results, None if given.quick else results.out / "sbc"))
    measured = None if given.quick else piezo.run(results)
    if measured is not None:
        section("piezo_dbo: fitted 5 to 15 s, predicted 15 to 40 s", measured["bands"], measured["notes"])
    page = "# Error bars on trial\n\nMade by `run.py`; seconds are of the run that wrote this page, without what it found ready.\n\n"
    target = results.out if given.quick else HERE
    (target / "RESULTS.md").write_text(page + "\n".join(parts), encoding="utf-8")
    results.finish()


if __name__ == "__main__":
    main()
