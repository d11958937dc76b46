"""Minase et al. 2010 on a surrogate: Bouc-Wen with creep identified by an unscented filter, inverse control, the three-axis stage.

    python experiments/ukf/run.py [--quick] [--out FOLDER]

Writes figures and results.json to out/ and the tables to RESULTS.md (report.md in out/ in the quick form); exit status 1 where a
number misses expected.json.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"  # threads slow down matrices of eight columns
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import figures
import identification
import measured
import three_axes
import tracking
from common import Results, arguments

import hystfit as hf

HERE = Path(__file__).resolve().parent


def main() -> None:
    """Compute all numbers, tables and figures."""
    options = arguments((__doc__ or "").partition("\n")[0])
    hf.enable_x64()
    results = Results(HERE, options.quick, options.out)
    loops, circles = identification.loops_and_creep(results)
    parts = {"Loops (M1, M2) and creep (M3)": loops}
    parts["Identification (M4)"], kept = identification.filter_and_least_squares(results, 3 if options.quick else 20)
    if not options.quick:
        parts["Methods on one record"] = identification.methods(results, 30)
    parts["Far starts"] = identification.far_starts(results)
    parts["Stopping on-line"] = identification.online(results)
    parts["Creep in stages"], identified = identification.in_stages(results)
    identification.one_amplitude(results)
    parts["Sines (M5, M6)"], example = tracking.sines(results, options.quick, identified)
    parts["Staircase (M7, M8)"], runs = tracking.ladder(results, identified)
    parts["Three axes (M9)"], poses = three_axes.three_axes(results)
    parts["Adaptive feed-forward"] = tracking.adaptive(results)
    if not options.quick:
        parts["Adaptive feed-forward on three axes"] = three_axes.adaptive_stage(results)
        parts["Measured piezo stack"] = measured.measured(results)
    figures.all_of_them(results.out, circles, kept, example, runs, poses)
    text = "\n".join(f"## {title}\n\n{body}" for title, body in parts.items())
    target = results.out / "report.md" if options.quick or options.out else HERE / "RESULTS.md"
    target.write_text(
        f"# Numbers of experiments/ukf, {'quick' if options.quick else 'full'} form\n\n" + text, encoding="utf-8"
    )
    results.finish()


if __name__ == "__main__":
    main()
