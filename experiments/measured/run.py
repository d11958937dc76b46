"""Fits of public measured loops with their errors on held-out samples: piezo, dampers, steel, magnetic materials.

    python experiments/measured/run.py [--quick] [--out FOLDER]

No model, starting values, structure or regularization are set by hand: each record gets the fit that `hystfit fit FILE` makes of a
file by default, which chooses among the models that suit the record by cross-validation within the fitting window. Writes results.json
and the tables to out/ and, in the full form with all data, RESULTS.md here. Exit status: see experiments/common.py.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from common import Results, arguments, table

import hystfit as hf

LOOPS = ("steel_resspylab/example_1", "steel_resspylab/example_2", "struct_slotboom/u-damper")
SUBSETS = (40, 63, 120)
MAGNETIC = ("mag_ja_bh/M130_27s", "mag_ja_bh/MnZn_HP_ferrite", "mag_ja_bh/MnZn_ferrite")


def held_out(
    results: Results, rows: list, name: str, train: hf.Record, test: hf.Record, *, refit_offset: bool = False
) -> hf.FitResult:
    """Search the model and fit it on `train`; report the error on `test`.

    Args:
        results: receives the errors.
        rows: receives a row of the table.
        name: of the split, as printed.
        train: fitted samples.
        test: held-out samples.
        refit_offset: whether the offset of the test record is fitted to it.
    """
    started = time.perf_counter()
    comparison = hf.compare(train)
    fit = comparison.winner
    error = fit.metrics(test, refit_offset=refit_offset)
    results.add(f"{name}: held out", error.nrmse_percent)
    results.add(f"{name}: held out, largest", error.max_error_percent)
    results.add(f"{name}: in sample", fit.train.nrmse_percent)
    structure, seconds = comparison.rows[0].name, time.perf_counter() - started
    errors = [fit.train.nrmse_percent, error.nrmse_percent, error.max_error_percent]
    rows.append([name, structure, *errors, fit.status, seconds])
    return fit


def outside(record: hf.Record, window: hf.Record) -> hf.Record:
    """The samples that a window leaves out."""
    return record.replace(weight=record.weight - window.weight)


def predictions(results: Results) -> list:
    """Errors on held-out samples."""
    rows: list = []
    if (piezo := results.load("piezo", "piezo_dbo/model", "piezo_dbo/test")) is not None:
        model, test = piezo
        window = model.window(5, 25)
        fit = held_out(results, rows, "piezo a: fit 5-25 s, predict the rest", window, outside(model, window))
        late = outside(model, window).window(0.1, None)
        results.add("piezo a: held out without the first 0.1 s", fit.metrics(late).nrmse_percent)
        if not results.quick:
            held_out(results, rows, "piezo b: fit Model, predict Test", model, test, refit_offset=True)
            early, late = test.window(None, 27), test.window(27, None)
            held_out(results, rows, "piezo c: fit 27 s of Test, predict the rest", early, late)
    yielding = (("struct_slotboom/u-damper", "U-damper"), ("steel_resspylab/example_1", "steel 1"))
    for name, label in yielding[:1] if results.quick else yielding:
        if (loaded := results.load(label, name)) is not None:
            split = round(0.6 * len(loaded[0]))
            train, test = loaded[0].window(None, split), loaded[0].window(split, None)
            fit = held_out(results, rows, f"{label}: fit 60 %, predict 40 %", train, test)
            if label == "U-damper":
                results.add("U-damper: warned of extrapolation", float(fit.extrapolation(test) is not None))
    if (loaded := results.load("MR damper", "mr_labcontrol/4.1")) is not None:
        train, test = loaded[0].window(None, 6), loaded[0].window(6, 15)
        held_out(results, rows, "MR damper: fit 0-6 s, predict 6-15 s", train, test)
    return rows


def in_sample(results: Results) -> list:
    """Whole records fitted: the best structure, plain Bouc-Wen, and Preisach for the magnetic loops."""
    rows = []
    for name in LOOPS:
        if (loaded := results.load(name, name)) is None:
            continue
        found, plain = hf.compare(loaded[0]), hf.fit(hf.BoucWenForce(), loaded[0])
        for label, model, fit in (
            ("best", found.rows[0].name, found.winner),
            ("plain Bouc-Wen", "bouc-wen-force", plain),
        ):
            results.add(f"{name}: {label}", fit.train.nrmse_percent)
            rows.append([name, model, fit.train.nrmse_percent, fit.train.max_error_percent, fit.status])
    for name in MAGNETIC:
        if (loaded := results.load(name, name)) is None:
            continue
        found = hf.compare(loaded[0])
        fit = found.winner
        results.add(f"{name}: all loops", fit.train.nrmse_percent)
        rows.append([name, found.rows[0].name, fit.train.nrmse_percent, fit.train.max_error_percent, fit.status])
    return rows


def reversal_curves(results: Results) -> list:
    """Every fourth first-order reversal curve fitted, as the instrument wrote them: the others are predicted."""
    if (loaded := results.load("reversal curves", "mag_forc_pyforc/FeCo")) is None:
        return []
    curves = list(loaded[0])
    found = hf.compare(curves[::4])
    error = found.winner.metrics([curve for k, curve in enumerate(curves) if k % 4])
    results.add("reversal curves: held out", error.nrmse_percent)
    return [
        ["mag_forc_pyforc/FeCo", found.rows[0].name, error.nrmse_percent, error.max_error_percent, found.winner.status]
    ]


def few_samples(results: Results) -> list:
    """Stepped loops of 40 to 120 samples: the samples between them are predicted, and the status says how well."""
    rows = []
    for name in MAGNETIC:
        if (loaded := results.load(f"few samples, {name}", name)) is None:
            continue
        whole = list(loaded[0])
        for count in SUBSETS:
            chosen = [np.linspace(0, len(loop) - 1, count // len(whole)).round().astype(int) for loop in whole]
            part = [hf.Record(loop.u[at], loop.y[at], name=loop.name) for loop, at in zip(whole, chosen, strict=True)]
            found = hf.compare(part)
            error = found.winner.metrics(whole)
            results.add(f"{name}, {count} samples: between them", error.nrmse_percent)
            results.add(f"{name}, {count} samples: usable", float(found.winner.usable))
            rows.append([name, count, found.rows[0].name, error.nrmse_percent, found.winner.status])
    return rows


def refused(results: Results) -> list:
    """Records that no plain loop model describes: fit and check must both reject them."""
    rows = []
    for name in ("steel_resspylab/example_3", "struct_slotboom/trial2", "struct_slotboom/spc1"):
        if (loaded := results.load(name, name)) is None:
            continue
        fit = hf.fit(hf.BoucWenForce(), loaded[0])
        verdict = hf.check(loaded[0], data_only=results.quick).verdict("bouc-wen")
        results.add(f"{name}: refused by the fit", float(not fit.usable))
        results.add(f"{name}: refused by the check", float(verdict.verdict == "no"))
        rows.append([name, fit.train.nrmse_percent, str(fit.status), str(fit.notes[0]) if fit.notes else ""])
    return rows


def loops_left_out(results: Results) -> list:
    """Each magnetic loop predicted from the others of its material, by a Preisach and by a Jiles-Atherton model."""
    rows = []
    for name in MAGNETIC:
        if (loaded := results.load(name, name)) is None:
            continue
        for record in loaded[0]:
            others = hf.Dataset(tuple(r for r in loaded[0] if r.name != record.name))
            fit = hf.compare(others, ["preisach-magnetic"]).winner
            error = fit.metrics(record)
            full_scale = max(r.y.max() for r in loaded[0]) - min(r.y.min() for r in loaded[0])
            percent = 100 * error.rmse / full_scale
            warned = fit.extrapolation(record) is not None
            results.add(f"{name} {record.name} left out, % of full scale", percent)
            if warned:
                results.add(f"{name} {record.name}: warned of extrapolation", 1.0)
            else:
                results.add(f"{name} {record.name} left out, % of its range", error.nrmse_percent)
            other = hf.fit("jiles-atherton", others).metrics(record).nrmse_percent
            results.add(f"{name} {record.name} left out, Jiles-Atherton, % of its range", other)
            material, remark = name.partition("/")[2], "extrapolates" if warned else ""
            rows.append([material, record.name, percent, error.nrmse_percent, other, remark])
    return rows


def drift(results: Results) -> list:
    """The drift of the piezo's loops is the creep of the step from rest at 0 V that starts the record.

    Without the rest state the creep estimate is meaningless; the row without it shows so.
    """
    rows: list = []
    if (loaded := results.load("piezo drift", "piezo_dbo/model")) is None:
        return rows
    plays = "lag+prandtl-ishlinskii-generalized+log-creep"
    for label, model, rest in (
        ("Bouc-Wen", "bouc-wen+log-creep", 0.0),
        ("", "bouc-wen+log-creep", None),
        ("plays", plays, 0.0),
    ):
        fit = hf.fit(model, loaded[0] if rest is None else loaded[0].resting_on(rest), starts=2)
        gamma, explained = fit["gamma[0]"], hf.explain_drift(fit)
        percent = [100 * gamma.value, None if gamma.stderr is None else 100 * gamma.stderr]
        parts = [explained.measured, explained.modeled, explained.stderr, explained.without_creep, explained.left]
        rows.append([model, "first input" if rest is None else "0 V", *percent, *parts, fit.train.nrmse_percent])
        if label:
            results.add(f"piezo drift, {label}: creep, % a decade", 100 * gamma.value)
            results.add(f"piezo drift, {label}: explained, um/decade", explained.modeled)
            results.add(f"piezo drift, {label}: left, um/decade", abs(explained.left))
    results.add("piezo drift: measured, um/decade", rows[0][4])
    return rows


HELD_OUT_HEAD = ["record", "model", "in sample %", "held out %", "largest %", "status", "s"]
DRIFT_HEAD = ["model", "initial rest at", "creep, % per decade", "+-", "measured drift, um/decade", "modeled", "+-",
              "modeled without creep", "unexplained", "in sample %"]  # fmt: skip


def main() -> None:
    """Run, check and write the page."""
    options = arguments((__doc__ or "").partition("\n")[0])
    hf.enable_x64()
    folder = Path(__file__).resolve().parent
    results = Results(folder, options.quick, options.out)
    pages = [
        "# Measured loops\n\nNRMSE and largest error in percent of the measured output range. Written by `run.py`.\n"
    ]
    pages += ["## Held-out samples\n", table(HELD_OUT_HEAD, predictions(results))]
    if not options.quick:
        pages += ["## In sample\n", table(["record", "model", "error %", "largest %", "status"], in_sample(results))]
    pages += ["## Rejected records\n", table(["record", "Bouc-Wen error %", "status", "reason"], refused(results))]
    if not options.quick:
        head = ["record", "model", "held out %", "largest %", "status"]
        pages += ["## Reversal curves, every fourth fitted\n", table(head, reversal_curves(results))]
        head = ["material", "samples", "model", "error between them %", "status"]
        pages += ["## Stepped loops of few samples\n", table(head, few_samples(results))]
        pages += ["## Drift of the piezo\n", table(DRIFT_HEAD, drift(results))]
        head = ["material", "loop", "% of full scale", "% of its own range", "Jiles-Atherton, % of its own range", ""]
        pages += [
            "## Magnetic loops, each predicted from the others (Preisach and Jiles-Atherton)\n",
            table(head, loops_left_out(results)),
        ]
    complete = not (options.quick or options.out or results.skipped)
    (folder if complete else results.out).joinpath("RESULTS.md").write_text("\n".join(pages), encoding="utf-8")
    results.finish()


if __name__ == "__main__":
    main()
