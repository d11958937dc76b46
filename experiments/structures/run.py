"""Structural loops: steel coupons with known parameters, measured steel, walls and a fastener that degrade, dampers, simulated laws.

    python experiments/structures/run.py [--quick] [--out FOLDER]

The quick form fits three of the 18 coupons and every eighth sample of the walls, with the model that the search takes. The full form
lets the comparison choose, as `hystfit fit FILE` does. Writes results.json and the tables to out/ and, in the full form with all data,
RESULTS.md here. Exit status: see experiments/common.py.
"""

from __future__ import annotations

import csv
import json
import sys
from datetime import datetime
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from common import Results, arguments, table
from laws import laws

import hystfit as hf

FOLDER = Path(__file__).resolve().parent
COUPONS = 18
NAMES: tuple[str, ...] = ("fy", "E", "b", "cR1", "cR2", "a1", "a3")
STARTS = 5
STRAIN_NOISE = 3e-5  # standard deviation
WALLS = {"trial2": 3, "spc1": 8}  # every k-th sample of the quick form
SPLIT = 0.6  # of the samples, which are fitted where the others are predicted
FAILED = 0.8  # of the largest force, to which that of the later peaks has fallen when the device has failed
HEAD = ["record", "model", "rms error in sample, %", "held out, %", "status"]


def coupon(path: Path, number: int) -> tuple[hf.Record, dict[str, float]]:
    """A simulated coupon and its true parameters; the names in the header of its file are in another order."""
    strain, stress = np.loadtxt(path / f"experiment_{number}.csv").T
    text = (path / f"experiment_{number}_parinfo.txt").read_text(encoding="utf-8").split("]")[1]
    truth: dict[str, float] = dict(zip(NAMES, map(float, text.replace("[", " ").split()), strict=False))
    return hf.Record(u=strain, y=stress, u_unit="1", y_unit="MPa", name=f"coupon {number}"), truth


def coupons(results: Results) -> list:
    """`Steel02` at the true parameters of the coupons, and fitted to them: errors of the parameters and of their standard errors."""
    if (path := results.measured_path("coupons", "steel_quofem")) is None:
        return []
    errors, ratios, rest, lags, agree, rows = [], [], [], [], [], []
    for number in range(0, COUPONS, 6 if results.quick else 1):
        record, truth = coupon(path, number)
        residuals = record.y - np.asarray(hf.simulate(hf.Steel02(**truth), record.u)[0])
        rest.append(float(np.sqrt(np.mean(residuals**2))))
        lags.append(abs(float(np.mean(residuals[1:] * residuals[:-1]) / np.mean(residuals**2))))
        fit = hf.fit("steel-02", record, starts=STARTS)
        agree.append(fit.in_best_basin / STARTS)
        found = {row.name: row for row in fit.parameters}
        errors.append([100 * abs(found[name].value / truth[name] - 1) for name in NAMES])
        ratios.append([(found[name].value - truth[name]) / (found[name].stderr or np.nan) for name in NAMES])
        rows.append([record.name, *errors[-1], fit.status])
    largest = dict(zip(NAMES, np.max(errors, axis=0), strict=True))
    results.add("coupons: largest rms at the truth, MPa", max(rest))
    results.add("coupons: smallest rms at the truth, MPa", min(rest))
    results.add("coupons: largest correlation of neighbors at the truth", max(lags))
    results.add("coupons: share of starts that agree", float(np.mean(agree)))
    for name, names in {"fy, E": ("fy", "E"), "b": ("b",), "cR1": ("cR1",), "cR2": ("cR2",), "a": ("a1", "a3")}.items():
        results.add(f"coupons: largest error of {name}, %", max(largest[one] for one in names))
    results.add("coupons: rms error over standard error", float(np.sqrt(np.mean(np.square(ratios)))))
    derivatives(results, path)
    return [*rows, strained(results, path)]


def derivatives(results: Results, path: Path) -> None:
    """Derivatives of `Steel02` at the truth against central differences of the simulation."""
    record, truth = coupon(path, 0)
    problem = hf.Problem(hf.Steel02(**truth), record)
    x, worst = problem.space.vector(problem.model), 0.0
    jacobian = problem.linearize(x)[1][0][: len(record)]
    for k, size in enumerate(x):
        step = 1e-5 * abs(size) * (np.arange(x.size) == k)
        difference = (problem.predict(x + step)[0] - problem.predict(x - step)[0]) / (2e-5 * abs(size))
        worst = max(worst, float(np.abs(jacobian[:, k] - difference).max() / np.abs(difference).max()))
    results.add("coupons: derivatives against differences", worst)


def strained(results: Results, path: Path) -> list:
    """A coupon whose strain has noise too, which makes false reversals."""
    record, truth = coupon(path, 0)
    noise = STRAIN_NOISE * np.random.default_rng(0).normal(size=len(record))
    fit = hf.fit("steel-02", record.replace(u=record.u + noise), starts=STARTS)
    errors = [100 * abs(fit[name].value / truth[name] - 1) for name in NAMES]
    results.add("coupons: noisy strain, error of b, %", errors[NAMES.index("b")])
    results.add("coupons: noisy strain, error of a3, %", errors[NAMES.index("a3")])
    return [f"{record.name}, strain noise {STRAIN_NOISE:g}", *errors, fit.status]


def split_fit(model: str, record: hf.Record, method: str = "auto") -> tuple[hf.FitResult, float]:
    """A fit of the first part of a record, and its error on the rest."""
    edge = round(SPLIT * len(record))
    early, late = record.window(None, edge), record.window(edge, None)
    fit = hf.fit(model, early, method=method)
    return fit, fit.metrics(late).nrmse_percent or np.nan


def steel(results: Results) -> list:
    """The updated Voce-Chaboche law on the measured steel, in sample and predicting."""
    rows = []
    for name in ("example_2",) if results.quick else ("example_1", "example_2"):
        if (loaded := results.load(f"steel {name}", f"steel_resspylab/{name}")) is None:
            continue
        fit = hf.fit("voce-chaboche", loaded[0])
        results.add(f"steel {name}: in sample", fit.train.nrmse_percent)
        results.add(f"steel {name}: largest error", fit.train.max_error_percent)
        if not results.quick:
            part, ahead = split_fit("voce-chaboche", loaded[0])
            results.add(f"steel {name}: held out", ahead)
            rows.append([name, part.name, part.train.nrmse_percent, ahead, part.status])
        rows.append([name, fit.name, fit.train.nrmse_percent, None, fit.status])
    return rows


def walls(results: Results) -> list:
    """Walls that degrade: the model of the comparison, and Bouc-Wen-Baber-Noori; in sample, and the last 40 % predicted."""
    rows = []
    for name, every in WALLS.items():
        if (loaded := results.load(name, f"struct_slotboom/{name}")) is None:
            continue
        whole, model = loaded[0], "self-similar-stops"
        thin = hf.Record(u=whole.u[::every], y=whole.y[::every], u_unit=whole.u_unit, y_unit=whole.y_unit)
        record = thin if results.quick else whole
        best = hf.fit(model, record) if results.quick else hf.compare(record).winner
        part, ahead = split_fit(model, record)
        results.add(f"{name}: best in sample", best.train.nrmse_percent)
        results.add(f"{name}: best held out", ahead)
        rows += [
            [name, best.name, best.train.nrmse_percent, None, best.status],
            [name, part.name, part.train.nrmse_percent, ahead, part.status],
        ]
        if not results.quick:
            # The bounded solver: several parameters end on their bounds.
            plain = hf.fit("bouc-wen-baber-noori", thin, method="trf")
            half, ahead = split_fit("bouc-wen-baber-noori", thin, "trf")
            results.add(f"{name}: Baber-Noori in sample", plain.train.nrmse_percent)
            results.add(f"{name}: Baber-Noori held out", ahead)
            rows.append([name, plain.name, plain.train.nrmse_percent, ahead, half.status])
    return rows


def fastener(results: Results) -> list:
    """A screw in cyclic shear, up to the last peak that reaches 80 % of the largest force."""
    if (path := results.measured_path("fastener", "wild/fastener_c33g12_1.json")) is None:
        return []
    test = json.loads(path.read_text(encoding="utf-8"))["test"]
    record = hf.Record(u=np.array(test["displacement"]), y=np.array(test["force"]), u_unit="in", y_unit="lbf")
    last = int(np.flatnonzero(np.abs(record.y) >= FAILED * np.abs(record.y).max())[-1])
    part = hf.Record(u=record.u[: last + 1], y=record.y[: last + 1], u_unit="in", y_unit="lbf")
    fit = hf.fit("self-similar-stops", part) if results.quick else hf.compare(part).winner
    results.add("fastener: in sample", fit.train.nrmse_percent)
    return [["fastener", fit.name, fit.train.nrmse_percent, None, fit.status]]


def dampers(results: Results) -> list:
    """A racing damper in sample, and a magnetorheological damper fitted on 6 s and predicted for 9 s more."""
    rows = []
    if (path := results.measured_path("racing damper", "wild/damper_s5_n10_50psi.csv")) is not None:
        with path.open(encoding="utf-8") as file:
            lines = list(csv.DictReader(file))
        t = np.array([datetime.fromisoformat(line["Timestamp"]).timestamp() for line in lines])
        u, y = (np.array([float(line[name]) for line in lines]) for name in ("Displacement (mm)", "Force (N)"))
        record = hf.Record(u=u, y=y, t=t - t[0], u_unit="mm", y_unit="N", t_unit="s")
        fit = hf.fit("negate+damper", record) if results.quick else hf.compare(record).winner
        results.add("racing damper: in sample", fit.train.nrmse_percent)
        rows.append(["racing damper", fit.name, fit.train.nrmse_percent, None, fit.status])
    if (loaded := results.load("MR damper", "mr_labcontrol/4.1")) is not None:
        train, test = loaded[0].window(None, 6.0), loaded[0].window(6.0, 15.0)
        fit = hf.fit("damper", train)
        ahead = results.add("MR damper: damper, held out", fit.metrics(test).nrmse_percent)
        rows.append(["MR damper", fit.name, fit.train.nrmse_percent, ahead, fit.status])
        if not results.quick:
            best = hf.compare(train).winner
            ahead = results.add("MR damper: best, held out", best.metrics(test).nrmse_percent)
            rows.append(["MR damper", best.name, best.train.nrmse_percent, ahead, best.status])
    return rows


def main() -> None:
    """Compute all numbers."""
    options = arguments((__doc__ or "").splitlines()[0])
    hf.enable_x64()
    results = Results(FOLDER, options.quick, options.out)
    tables = {
        "Coupons with known parameters: errors in percent": table(["coupon", *NAMES, "status"], coupons(results)),
        "Measured steel": table(HEAD, steel(results)),
        "Degrading loops": table(HEAD, [*walls(results), *fastener(results)]),
        "Dampers": table(HEAD, dampers(results)),
        "Simulated laws": table(["model", "what", "value"], laws(results)),
    }
    results.publish("Structural loops", "experiments/structures/run.py", tables)
    results.finish()


if __name__ == "__main__":
    main()
