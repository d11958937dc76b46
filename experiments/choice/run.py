"""Simulated devices: the model that the bare comparison chooses against the best candidate on loops that it has not seen.

    python experiments/choice/run.py [--quick] [--out FOLDER]

The quick form takes three devices. A choice is right where its error on unseen loops is at most 1.3 times that of the best
candidate, or below a third of the noise of one sample. The unseen loops are of the same and of smaller amplitudes; where the held-out
samples test no other amplitude, as the comparison then says, those of the same amplitude decide. Writes results.json and the table to out/
and, in the full form, RESULTS.md here. Exit status: see experiments/common.py.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from common import Results, arguments, table
from devices import Case, case

import hystfit as hf
from hystfit.errors import HystfitError
from hystfit.fitting.comparison.compared_models import Fits
from hystfit.quality.held_out import Scheme
from hystfit.results.result import FitResult

DEVICES, QUICK = 105, (0, 8, 16)
FACTOR, OF_NOISE = 1.3, 1 / 3
# Besides those that the comparison fits to the end.
FAMILIES = ("prandtl-ishlinskii-search", "preisach", "preisach-magnetic", "bouc-wen", "bouc-wen-force", "duhem")
HEAD = [
    "device", "kind", "protocol", "noise, %", "held out", "chosen", "same, %", "best there", "its error, %", "all, %", "best there",
    "its error, %", "right",
]  # fmt: skip


def error_on(result: FitResult, record: hf.Record) -> float:
    """Root mean square error on the samples that count, percent of the range of the fitted output."""
    miss = (result.predict(record) - record.y)[record.used]
    return 100 * float(np.sqrt(np.mean(miss**2))) / result.baselines.span


def fitted(one: Case, chosen: Fits, *, all_families: bool) -> dict[str, FitResult]:
    """Every candidate: the fits of the comparison, and those of families that it stopped or skipped."""
    fits = dict(chosen.items())
    for name in FAMILIES if all_families else ():
        if not any(name in known for known in fits):
            try:
                fits[name] = hf.fit(name, one.data, starts=2)
            except HystfitError:
                continue
    return fits


def judge(one: Case, quick: bool) -> tuple[list, bool, bool]:
    """A row of the table, whether the choice is right, and whether it is right for other amplitudes."""
    found = hf.compare(one.data, starts=2, progress=lambda *_: None)
    fits = fitted(one, found.fits, all_families=not quick)
    tested = found.scheme is not Scheme.SCATTERED and one.tests_amplitudes
    same, other = ({name: error_on(fit, record) for name, fit in fits.items()} for record in (one.same, one.other))
    both = {name: float(np.hypot(same[name], other[name]) / np.sqrt(2)) for name in fits}
    cells, right = [], []
    for errors in (same, both):
        best, error = min(errors, key=lambda name: errors[name]), errors[found.rows[0].asked]
        right.append(error <= max(FACTOR * errors[best], OF_NOISE * 100 * one.noise))
        cells += [error, best, errors[best]]
    good = right[tested]
    row = [
        one.name,
        one.kind,
        one.protocol,
        100 * one.noise,
        found.scheme,
        found.rows[0].name,
        *cells,
        "yes" if good else "no",
    ]
    return row, good, right[True]


def main() -> None:
    """Run, check and write the page."""
    options = arguments((__doc__ or "").partition("\n")[0])
    hf.enable_x64()
    folder = Path(__file__).resolve().parent
    results = Results(folder, options.quick, options.out)
    rows, right, elsewhere = [], 0, 0
    numbers = QUICK if options.quick else range(DEVICES)
    for number in numbers:
        row, good, other = judge(case(number), options.quick)
        rows.append(row)
        right, elsewhere = right + good, elsewhere + other
        print("  " + " | ".join(f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in row), flush=True)
    results.add("devices", len(rows))
    results.add("share of right choices", right / len(rows))
    results.add("share of right choices, all amplitudes", elsewhere / len(rows))
    about = (__doc__ or "").partition("\n")[0]
    page = f"# Cross-validation schemes on simulated devices\n\n{about} Written by `run.py`.\n\n{table(HEAD, rows)}"
    complete = not (options.quick or options.out)
    (folder if complete else results.out).joinpath("RESULTS.md").write_text(page, encoding="utf-8")
    results.finish()


if __name__ == "__main__":
    main()
