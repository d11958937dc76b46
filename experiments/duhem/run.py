"""Zhou and Wang 2013 on a surrogate: recursive least squares, gradient correction, and their simulation error.

    python experiments/duhem/run.py [--quick] [--out FOLDER]

Writes figures and results.json to out/ and the page RESULTS.md here; exit status: see experiments/common.py.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"  # threads slow down matrices of eight columns
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import estimators
import numpy as np
import page
from cases import LABELS, PAPER_GC, PAPER_RLS, SMALL_STEPS, WAVES, WEIGHTS, case, near
from common import Results, arguments, table
from estimators import costs, gradient_correction, outcome, output_error

import hystfit as hf
from hystfit.identify import GradientCorrection, Rls, identify
from hystfit.outcome import Code, Status
from hystfit.outcome.note import has

HERE = Path(__file__).resolve().parent
SCHEMES = ("explicit", "midpoint")


def noise_free(results: Results) -> dict[str, str]:
    """Recovery of the eight parameters, and the paper's two tables."""
    rows, columns = [], []
    for wave in WAVES:
        for count in (201, 2001):
            for scheme in SCHEMES:
                c = case(wave, count, scheme=scheme)
                rls = Rls.of(hf.Duhem(scheme=scheme), c.record)
                identified = rls.fit(c.record)
                worst = float(np.max(np.abs(rls.regressor.powers(identified.theta) / PAPER_RLS - 1)))
                error = c.error(identified.model) / c.span
                results.add(f"noise free: RLS free-run maximum / range, {wave}, N={count}, {scheme}", error)
                rows.append([wave, count, scheme, worst, 100 * error])
                if count == 2001 and scheme == "midpoint":
                    columns.append(rls.regressor.powers(identified.theta))
                    gc = identify(c.record, "gradient-correction", _off(c), start="model", passes=100)
                    columns.append(rls.regressor.powers(gc.theta))
    results.add("noise free: RLS worst parameter, relative", max(row[3] for row in rows))
    head = ["", "paper, RLS", "paper, gradient", *(f"{m}, {w}" for w in WAVES for m in ("RLS", "gradient, 100 passes"))]
    body = [[name, *values] for name, *values in zip(LABELS, PAPER_RLS, PAPER_GC, *columns, strict=True)]
    recovery = table(["input", "N", "regressors", "worst parameter, relative", "free-run maximum, % of range"], rows)
    return {"parameters": table(head, body), "recovery": recovery}


def _off(c) -> hf.Duhem:
    """A start with errors of 5 % in f and in the rate."""
    m = c.model
    return hf.Duhem(1.05 * m.alpha, 0.95 * m.f, m.g, m.w0, m.center, m.half, scheme=m.scheme)


def gradient(results: Results) -> str:
    """Gradient correction without noise from forty starts within 10 %, and with noise, with and without floor."""
    rows = []
    for wave in WAVES:
        c = case(wave)
        for passes in (1, 10, 100):
            starts = 4 if results.quick and passes == 100 else 40
            errors = [100 * c.error(gradient_correction(c, seed, passes=passes)) / c.span for seed in range(starts)]
            share = np.mean(np.array(errors) <= 2.5)
            results.add(f"gradient: median free-run maximum %, {wave}, {passes} passes", np.median(errors))
            rows.append([wave, "0", "1", passes, np.median(errors), max(errors), f"{share:.0%}"])
    distance = lambda theta: float(np.linalg.norm(theta - truth) / np.linalg.norm(truth))
    for floor in (1.0, 0.0):
        c = case("decaying sine", noise=0.005)
        truth = np.asarray(GradientCorrection.of(c.model, c.record, start="model").theta0)
        identified = identify(c.record, "gradient-correction", c.model, start="model", floor=floor)
        results.add(f"gradient: distance from the truth, 5 nm noise, floor {floor:g}", distance(identified.theta))
        error = 100 * c.error(identified.model) / c.span
        rows.append(["decaying sine", "5 nm", f"{floor:g}", 1, error, error, identified.status])
        if floor == 0:
            warned = identified.status is Status.DIVERGED and has(identified.notes, Code.STEP_SIZE)
            results.add("gradient: divergence without floor is told", float(warned))
    head = [
        "input",
        "noise",
        "floor",
        "passes",
        "free-run maximum, % of range (median)",
        "(worst)",
        "within 2.5 %, or status",
    ]
    return table(head, rows)


def papers_form(results: Results) -> str:
    """The paper's own regressors, weights and step from forty starts within 10 %, without noise and with 5 nm.

    The paper's Table 2 has the largest error and the mean square deviation; here those of the simulation.
    """
    rows: list[list[object]] = [
        ["paper, Table 2", "", "", "RLS", 66.0, 26.3],
        ["", "", "", "gradient correction", 48.0, 22.2],
    ]
    for wave in WAVES:
        for noise in (0.0, 0.005):
            c = case(wave, noise=noise)
            label = f"{1e3 * noise:g} nm"
            rls = identify(c.record, "rls", basis="powers").model
            least = c.error(rls)
            rows.append([wave, label, "", "RLS, powers", 1e3 * least, 1e3 * c.rms(rls)])
            starts = [c.model_of(near(PAPER_RLS, seed)) for seed in range(40)]
            rows.append(
                [
                    wave,
                    label,
                    "",
                    "the starts themselves",
                    *(1e3 * np.median([f(m) for m in starts]) for f in (c.error, c.rms)),
                ]
            )
            for name, weights in WEIGHTS.items():
                floor = 1.0 if noise else 0.0  # the paper has none; noise needs it
                models = [
                    gradient_correction(c, seed, floor=floor, basis="powers", weights=weights) for seed in range(40)
                ]
                errors, rms = ([f(model) for model in models] for f in (c.error, c.rms))
                worst = 100 * np.median(errors) / c.span
                rows.append([wave, label, name, "gradient correction", 1e3 * np.median(errors), 1e3 * np.median(rms)])
                results.add(f"paper's form: median free-run maximum %, {wave}, {label}, {name}", worst)
                if noise:
                    ratio = np.median(errors) / least
                    results.add(f"paper's form: gradient / RLS free-run maximum, {wave}, {label}, {name}", ratio)
    head = ["input", "noise", "weights", "method", "largest free-run error, nm (median)", "RMS, nm (median)"]
    return table(head, rows)


def small_step(results: Results) -> str:
    """A hundredth of the normalized step: ten passes from twelve starts within 10 %, over six realizations of 5 nm noise."""
    if results.quick:
        return ""
    rows: list[list[object]] = []
    for wave in WAVES:
        cases = [case(wave, noise=0.005, seed=seed) for seed in range(6)]
        rls = np.array([c.error(identify(c.record, "rls", basis="powers").model) for c in cases])
        rows.append([wave, "", "RLS", *_percents(rls, cases[0].span), ""])
        for name, settings in SMALL_STEPS.items():
            gc = [[gradient_correction(c, k, passes=10, mu=0.01, **settings) for k in range(12)] for c in cases]
            errors = np.array([np.median([c.error(m) for m in models]) for c, models in zip(cases, gc, strict=True)])
            better = int(np.sum(errors < rls))
            rows.append([wave, name, "gradient correction", *_percents(errors, cases[0].span), better])
            results.add(f"small step: gradient / RLS free-run maximum, {wave}, {name}", np.median(errors / rls))
    head = ["input", "regressors and weights", "method", "largest free-run error, % of range (median)", "least", "most"]
    return table([*head, "realizations of 6 in which it is below that of RLS"], rows)


def _percents(errors: np.ndarray, span: float) -> list[float]:
    return [100 * float(f(errors)) / span for f in (np.median, np.min, np.max)]


def free_run(results: Results) -> tuple[str, dict]:
    """Simulation errors, which the paper does not give: 5 nm noise, N = 2001, every estimator."""
    seeds = 4 if results.quick else 20
    rows, kept = [], {}
    for scheme in SCHEMES:
        for wave in WAVES:
            by_name = {name: [] for name in estimators.estimators(scheme)}
            for seed in range(seeds):
                c = case(wave, 2001, 0.005, seed, scheme)
                for name, estimate in estimators.estimators(scheme).items():
                    by_name[name].append(outcome(estimate, c, seed))
            for name, outcomes in by_name.items():
                alpha, equation, error = np.array(outcomes).T
                spread = f"{np.nanmean(alpha):.3g} [{np.nanmin(alpha):.3g}, {np.nanmax(alpha):.3g}]"
                lost = int(np.sum(~np.isfinite(error)))
                rows.append(
                    [scheme, wave, name, 1e3 * np.nanmean(equation), spread, 1e3 * np.median(error), lost or ""]
                )
            kept[scheme, wave] = {name: np.array(outcomes) for name, outcomes in by_name.items()}
            _judge(results, f"{scheme}, {wave}", kept[scheme, wave])
    head = [
        "regressors",
        "input",
        "estimator",
        "equation error, nm",
        "α / truth: mean [min, max]",
        "free-run maximum, nm (median)",
        "no valid model",
    ]
    return table(head, rows), kept


def _judge(results: Results, where: str, outcomes: dict[str, np.ndarray]) -> None:
    rls, oe, gc = outcomes["RLS"], outcomes["output error"], outcomes["gradient correction"]
    deviation = np.abs(rls[:, 0] - 1)
    if where.startswith("explicit") and "decaying" not in where:
        results.add(f"5 nm: RLS alpha / truth, least, {where}", rls[:, 0].min())
    else:
        results.add(f"5 nm: RLS alpha off by, worst, {where}", deviation.max())
    results.add(f"5 nm: output-error alpha off by, worst, {where}", np.abs(oe[:, 0] - 1).max())
    results.add(f"5 nm: output-error / RLS free-run maximum, {where}", np.median(oe[:, 2]) / np.median(rls[:, 2]))
    results.add(f"5 nm: gradient / RLS free-run maximum, {where}", np.median(gc[:, 2]) / np.median(rls[:, 2]))


def sampling(results: Results) -> str:
    """Faster sampling makes explicit one-step regression worse; one seed each."""
    rows = []
    for count in (201, 2001):
        for noise in (0.020,) if results.quick else (0.005, 0.020):
            for wave in WAVES:
                line: list[object] = [wave, count, f"{1e3 * noise:g} nm"]
                for scheme in SCHEMES:
                    c = case(wave, count, noise, 0, scheme)
                    ways = estimators.estimators(scheme)
                    for name in ("RLS", "output error"):
                        o = outcome(ways[name], c, 0)
                        line.append(f"{o.alpha:.3g} · {1e3 * o.error:.3g}")
                rows.append(line)
    head = [
        "input",
        "N",
        "noise",
        *(f"{s} {n}: α / truth · free-run maximum, nm" for s in SCHEMES for n in ("RLS", "output error")),
    ]
    return table(head, rows)


def measured(results: Results) -> tuple[str | None, dict]:
    """The same Duhem model by three methods on measured loops; None where the data are not available."""
    loaded = results.load(("piezo", "steel"), "piezo_dbo/model", "steel_resspylab/example_1")
    if loaded is None:
        return None, {}
    piezo, steel = loaded
    lag = 2  # delay of this sensor in samples, removed in the second case
    prompt = hf.Record(u=piezo.u[:-lag], y=piezo.y[lag:], t=np.asarray(piezo.t)[:-lag], u_unit="V", y_unit="um")
    pairs = {
        "piezo, 5-25 s": (piezo, piezo.window(5, 25)),
        "piezo without its lag, 5-25 s": (prompt, prompt.window(5, 25)),
        "steel 1, first 60 %": (steel, steel.window(0, int(0.6 * len(steel)))),
    }
    methods = {
        "RLS": lambda r: identify(r, "rls"),
        "gradient correction": lambda r: identify(r, "gradient-correction"),
        "output error": output_error,
    }
    rows, kept = [], {}
    for name, (whole, train) in pairs.items():
        for method, estimate in methods.items():
            result = estimate(train)
            errors = page.free_run_errors(result.model, whole, train)
            alpha = float(result.model.alpha) if result.model else None
            rows.append([name, method, result.status, alpha, *errors.numbers])
            kept[name, method] = errors
            if result.model:
                results.add(f"{name}: {method}, fitted part %", errors.train)
                results.add(f"{name}: {method}, rest %", errors.rest)
        if kept[name, "RLS"].train is not None:
            ratio = kept[name, "output error"].train / kept[name, "RLS"].train
            results.add(f"{name}: output-error / RLS, fitted part", ratio)
    head = ["record and fitted part", "method", "status", "α, 1/[u]"]
    head += [f"{what}, %" for what in ("NRMSE fitted", "NRMSE rest", "maximum rest", "NRMSE after the fitted part")]
    return table(head, rows), kept


def main() -> None:
    """Run all parts, and write figures, numbers and the page."""
    options = arguments(
        "Recursive least squares and gradient correction of a Duhem model on a surrogate of Zhou and Wang 2013."
    )
    hf.enable_x64()
    estimators.quiet()
    results = Results(HERE, options.quick, options.out)
    parts: dict[str, Any] = noise_free(results)
    parts["gradient"] = gradient(results)
    parts["paper"] = papers_form(results)
    parts["small step"] = small_step(results)
    parts["free run"], outcomes = free_run(results)
    parts["sampling"] = sampling(results)
    parts["measured"], loops = measured(results)
    timing = costs(case("sine"))
    for name, seconds in timing.items():
        results.add(
            f"time: {name} [us]" if "update" in name else f"time: {name} [s]",
            seconds * (1e6 if "update" in name else 1),
        )
    page.figures(results.out, outcomes, loops)
    complete = not (options.out or options.quick or results.skipped)
    page.write(HERE if complete else results.out, parts, timing, outcomes, results)
    results.finish()


if __name__ == "__main__":
    main()
