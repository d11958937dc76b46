"""Fits of the public measured loops, with the error on what was never fitted: piezo, dampers, steel, magnetic materials.

No starting value, structure or strength is given by hand: the search of the Prandtl-Ishlinskii family and the Preisach fit choose
theirs on blocks left out of the fitting window. Records come from the folder that HYSTFIT_DATA names, or by download.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from common import Results, arguments, table

import hystfit as hf
from hystfit.fitting.compare import SEARCH

TARGET = {"steel_resspylab/example_1": 3.2, "steel_resspylab/example_2": 6.2, "struct_slotboom/u-damper": 2.7}


def held_out(results: Results, rows: list, name: str, train, test, *, refit_offset: bool = False) -> hf.FitResult:
    """Search and fit on `train`, report the error on `test`."""
    started = time.perf_counter()
    comparison = hf.compare(train, [SEARCH])
    fit = comparison.winner
    error = fit.metrics(test, refit_offset=refit_offset)
    results.add(f"{name}: held out", error.nrmse_percent)
    results.add(f"{name}: held out, largest", error.max_error_percent)
    results.add(f"{name}: in sample", fit.train.nrmse_percent)
    seconds = time.perf_counter() - started
    rows.append(
        [
            name,
            comparison.rows[0].note,
            fit.train.nrmse_percent,
            error.nrmse_percent,
            error.max_error_percent,
            fit.status,
            seconds,
        ]
    )
    return fit


def rest_of(record: hf.Record, window: hf.Record) -> hf.Record:
    """The samples that a window leaves out."""
    return record.replace(weight=record.weight - window.weight)


def predictions(results: Results) -> list:
    """Everything that has a held-out part."""
    rows: list = []
    model, test = hf.datasets.load("piezo_dbo/model"), hf.datasets.load("piezo_dbo/test")
    window = model.window(5, 25)
    fit = held_out(results, rows, "piezo a: fit 5-25 s, predict the rest", window, rest_of(model, window))
    late = rest_of(model, window).window(0.1, None)
    results.add("piezo a: held out without the first 0.1 s", fit.metrics(late).nrmse_percent)
    held_out(results, rows, "piezo b: fit Model, predict Test", model, test, refit_offset=True)
    held_out(results, rows, "piezo c: fit 27 s of Test, predict the rest", test.window(None, 27), test.window(27, None))
    for name, label in (("struct_slotboom/u-damper", "U-damper"), ("steel_resspylab/example_1", "steel 1")):
        record = hf.datasets.load(name)
        split = round(0.6 * len(record))
        train, test = record.window(None, split), record.window(split, None)
        fit = held_out(results, rows, f"{label}: fit 60 %, predict 40 %", train, test)
        if label == "U-damper":
            results.add("U-damper: warned of extrapolation", float(fit.extrapolates(test) is not None))
    record = hf.datasets.load("mr_labcontrol/4.1")
    held_out(results, rows, "MR damper: fit 0-6 s, predict 6-15 s", record.window(None, 6), record.window(6, 15))
    return rows


def in_sample(results: Results) -> list:
    """Whole records fitted: the best structure, plain Bouc-Wen, and Preisach for the magnetic loops."""
    rows = []
    for name in TARGET:
        record = hf.datasets.load(name)
        comparison = hf.compare(record, [SEARCH])
        best, plain = comparison.winner, hf.fit(hf.BoucWenForce(), record)
        for label, fit in (("best", best), ("plain Bouc-Wen", plain)):
            results.add(f"{name}: {label}", fit.train.nrmse_percent)
            rows.append([name, label, fit.train.nrmse_percent, fit.train.max_error_percent, fit.status])
    for name in ("M130_27s", "MnZn_HP_ferrite", "MnZn_ferrite"):
        fit = hf.fit("preisach-magnetic", hf.datasets.load(f"mag_ja_bh/{name}"))
        results.add(f"mag_ja_bh/{name}: all loops", fit.train.nrmse_percent)
        rows.append([f"mag_ja_bh/{name}", "Preisach", fit.train.nrmse_percent, fit.train.max_error_percent, fit.status])
    return rows


def refused(results: Results) -> list:
    """Records that no plain loop model makes: the software has to say so."""
    rows = []
    for name in ("steel_resspylab/example_3", "struct_slotboom/trial2", "struct_slotboom/spc1"):
        fit = hf.fit(hf.BoucWenForce(), hf.datasets.load(name))
        verdict = hf.check(hf.datasets.load(name)).verdict("bouc-wen")
        results.add(f"{name}: refused by the fit", float(not fit.usable))
        results.add(f"{name}: refused by the check", float(verdict.verdict == "no"))
        rows.append([name, fit.train.nrmse_percent, fit.status, fit.notes[0] if fit.notes else ""])
    return rows


def loops_left_out(results: Results) -> list:
    """Each magnetic loop predicted from the others of its material."""
    rows = []
    for name in ("M130_27s", "MnZn_HP_ferrite", "MnZn_ferrite"):
        data = hf.datasets.load(f"mag_ja_bh/{name}")
        for record in data:
            others = hf.Dataset(tuple(r for r in data if r.name != record.name))
            fit = hf.compare(others, ["preisach-magnetic"]).winner
            error = fit.metrics(record)
            full = max(r.y.max() for r in data) - min(r.y.min() for r in data)
            warned = fit.extrapolates(record) is not None
            results.add(f"mag_ja_bh/{name} {record.name} left out, % of full scale", 100 * error.rmse / full)
            if warned:
                results.add(f"mag_ja_bh/{name} {record.name}: warned of extrapolation", 1.0)
            else:
                results.add(f"mag_ja_bh/{name} {record.name} left out, % of its range", error.nrmse_percent)
            rows.append(
                [name, record.name, 100 * error.rmse / full, error.nrmse_percent, "extrapolates" if warned else ""]
            )
    return rows


def drift(results: Results) -> list:
    """The drift of the piezo's loops is creep of the step from rest at 0 V with which the record began; a fit not told of it fails."""
    record, rows = hf.datasets.load("piezo_dbo/model"), []
    plays = "lag+prandtl-ishlinskii-generalized+log-creep"
    for label, model, rest in (
        ("Bouc-Wen", "bouc-wen+log-creep", 0.0),
        ("", "bouc-wen+log-creep", None),
        ("plays", plays, 0.0),
    ):
        fit = hf.fit(model, record if rest is None else record.resting_on(rest), starts=2)
        gamma, found = fit["gamma[0]"], hf.explain_drift(fit)
        percent = [100 * gamma.value, None if gamma.stderr is None else 100 * gamma.stderr]
        parts = [found.measured, found.modeled, found.stderr, found.without_creep, found.left]
        rows.append([model, "first input" if rest is None else "0 V", *percent, *parts, fit.train.nrmse_percent])
        if label:
            results.add(f"piezo drift, {label}: creep, % a decade", 100 * gamma.value)
            results.add(f"piezo drift, {label}: explained, um/decade", found.modeled)
            results.add(f"piezo drift, {label}: left, um/decade", abs(found.left))
    results.add("piezo drift: measured, um/decade", rows[0][4])
    return rows


def main() -> None:
    """Run, check and write the page."""
    options = arguments(__doc__)
    hf.enable_x64()
    folder = Path(__file__).resolve().parent
    try:
        hf.datasets.load("piezo_dbo/model", download=False)
    except hf.HystfitError as error:
        print(f"no measured data, nothing checked: {error}")
        return
    results = Results(folder, options.quick, options.out)
    pages = ["# Measured loops\n\nErrors in percent of the range of the samples they are taken on. Made by `run.py`.\n"]
    head = ["record", "terms found", "in sample %", "held out %", "largest %", "status", "s"]
    pages += ["## Held out\n", table(head, predictions(results))]
    pages += ["## In sample\n", table(["record", "model", "error %", "largest %", "status"], in_sample(results))]
    pages += ["## Not to be fitted\n", table(["record", "Bouc-Wen error %", "status", "why"], refused(results))]
    if not options.quick:
        head = [
            "model",
            "rested on",
            "creep % a decade",
            "+-",
            "drift um/decade",
            "modeled",
            "+-",
            "without creep",
            "left",
            "in sample %",
        ]
        pages += ["## Drift of the piezo\n", table(head, drift(results))]
        head = ["material", "loop", "% of full scale", "% of its own range", ""]
        pages += ["## Magnetic loops, each left out in turn (Preisach)\n", table(head, loops_left_out(results))]
        (folder / "RESULTS.md").write_text("\n".join(pages), encoding="utf-8")
    (results.out / "RESULTS.md").write_text("\n".join(pages), encoding="utf-8")
    results.finish()


if __name__ == "__main__":
    main()
