"""Records of known kind: the advice of `check`, the model that the default search selects, and its error beside that of the best model.

    python experiments/recognition/run.py [--quick] [--out FOLDER]

The quick form takes one record of noise, and does not fit the other models. Writes results.json and the
table to out/ and, in the full form with all data, RESULTS.md here. Exit status: see experiments/common.py.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from cases import Case, measured, simulated
from common import Results, arguments, table

import hystfit as hf
from hystfit.errors import HystfitError
from hystfit.fitting.comparison.compared_models import Comparison
from hystfit.fitting.data_check import is_settled, with_models
from hystfit.models.registry import judged
from hystfit.quality.check import examine

# Every family, with the filters that its records may need; those that need time are left out for records without it.
ALL_RECORDS = (
    "bouc-wen", "bouc-wen-asymmetric", "bouc-wen-force", "duhem", "preisach", "prandtl-ishlinskii-search",
)  # fmt: skip
TIMED = ("bouc-wen+log-creep", "bouc-wen+relaxation", "bouc-wen+second-order", "bouc-wen-force+viscous", "lag+bouc-wen")
UNTIMED = ("preisach-magnetic",)
# Kind of the quick form: a search of all models finds none. `measured` searches the models of piezos and dampers and refuses devices that
# degrade, `choice` searches those of relays, and the tests compare models of few samples and judge fits to lines.
QUICK = ("noise only",)
FACTOR = 1.5  # error on left-out data, over that of the best model, up to which the choice is right
HEAD = [
    "record", "kind", "check advises", "search takes", "status", "error on left-out data, %", "best model", "its error, %",
]  # fmt: skip


def fittable(case: Case) -> list[str]:
    """The models that a record can be fitted with."""
    curves = case.kind == "reversal curves"
    timed = all(record.t is not None for record in case.data)
    return ["preisach-forc"] if curves else [*ALL_RECORDS, *(TIMED if timed else UNTIMED)]


def best_fitting(case: Case, chosen: Comparison) -> tuple[str, float]:
    """Name and error of the best model, among those of the search and those that it did not try."""
    tried = {row.asked for row in chosen.rows if row.score_percent is not None}
    rows = list(chosen.rows)
    if others := [name for name in fittable(case) if name not in tried]:
        try:
            rows += hf.compare(case.data, others, progress=lambda *_: None).rows
        except HystfitError as error:  # none of the others can be fitted
            print(f"  {case.name}: {error}")
    scored = [(row.score_percent, row.name) for row in rows if row.score_percent is not None]
    score, name = min(scored)
    return name, score


def judge(case: Case, quick: bool) -> tuple[list, bool, float | None]:
    """A row of the table, whether the status is wrong, and the error over that of the best model."""
    try:
        chosen = hf.compare(case.data, progress=lambda *_: None)
    except HystfitError as error:
        return [case.name, case.kind, "none", f"refused: {error}", "", None, "", None], case.usable, None
    report = examine(case.data, judged())
    report = with_models(report, case.data, None if is_settled(report) else chosen)
    advised = report.advice.model if report.advice else "none"
    first = chosen.rows[0]
    name, error = ("", None) if quick else best_fitting(case, chosen)
    ratio = first.score_percent / error if error and first.score_percent is not None else None
    row = [case.name, case.kind, advised, first.name, chosen.winner.status, first.score_percent, name, error]
    return row, chosen.winner.usable and not case.usable, ratio


def main() -> None:
    """Run, check and write the page."""
    options = arguments((__doc__ or "").partition("\n")[0])
    hf.enable_x64()
    folder = Path(__file__).resolve().parent
    results = Results(folder, options.quick, options.out)
    cases = list(simulated())
    if options.quick:
        cases = [next(case for case in cases if case.kind == kind) for kind in QUICK]
    else:
        cases += measured(results.load)
    rows, wrong, ratios = [], 0, []
    for case in cases:
        row, is_wrong, ratio = judge(case, options.quick)
        rows.append(row)
        wrong += is_wrong
        ratios.append(ratio)
        print("  " + " | ".join(f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in row), flush=True)
    results.add("records", len(cases))
    results.add("refused, or usable where no model describes the record", wrong)
    described = [ratio for case, ratio in zip(cases, ratios, strict=True) if case.usable and ratio is not None]
    if not options.quick:
        results.add("described records", sum(case.usable for case in cases))
        results.add("share within 1.5 of the best model", sum(r <= FACTOR for r in described) / max(len(described), 1))
    about = (__doc__ or "").partition("\n")[0]
    page = f"# Records of known kind\n\n{about} Written by `run.py`.\n\n{table(HEAD, rows)}"
    complete = not (options.quick or options.out or results.skipped)
    (folder if complete else results.out).joinpath("RESULTS.md").write_text(page, encoding="utf-8")
    results.finish()


if __name__ == "__main__":
    main()
