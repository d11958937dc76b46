"""Song et al. 2005 on a surrogate: reversal curves, wiping-out, congruency, prediction, and tracking with the inverse; the full form
also predicts held-out measured reversal curves and minor loops.

    python experiments/preisach/run.py [--quick] [--out FOLDER]

Writes figures and results.json to out/, and the page RESULTS.md with its figures here (the quick form to out/). Exit status: see
experiments/common.py.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"  # matrices are too small for threads
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import figures
import numpy as np
from common import Results, arguments, table
from identification import reversal_record, static_model, table_model, with_relaxation
from measured import measured
from plant import PLANTS, RELAXATION, STRONGER, actuator, legs, measure
from tracking import arms, feedforward, loop_design, robust_damping, track

import hystfit as hf
from hystfit.control import Design, LoopResult
from hystfit.models.preisach import EverettTable, congruency
from hystfit.models.preisach.properties import CONGRUENCY, HIGHER_ORDER, WIPING_OUT

HERE = Path(__file__).resolve().parent
MAJOR, MINOR, WIPED = (0.0, 100.0, 0.0), (0.0, 100.0, 20.0, 80.0, 40.0), (0.0, 80.0, 40.0, 100.0, 20.0)
RAISED = (0.0, 100.0, 2.0)
QUIET = (
    ("S8-10 major", "unchanged"),
    ("S11-13 minor", "changed in shape"),
)  # also without sensor noise in the quick form
DRAWN = (*QUIET, ("S14 wiping-out", "unchanged"))
SHOWN = ("properties.png", "predictions.png", "tracking.png")


def predict(model: hf.models.AbstractHysteresis, record: hf.Record) -> np.ndarray:
    """Free run on a record's input."""
    return np.asarray(hf.simulate(model, record.u, record.dt)[0])


def errors(model: hf.models.AbstractHysteresis, record: hf.Record) -> tuple[float, float]:
    """Largest and RMS error in percent of the record's range."""
    e, span = predict(model, record) - record.y, np.ptp(record.y)
    return 100 * float(np.abs(e).max() / span), 100 * float(np.sqrt(np.mean(e**2)) / span)


def reversal_curves(results: Results) -> tuple[hf.Record, hf.models.AbstractHysteresis, hf.models.AbstractHysteresis]:
    """S1: curves of 12 heights; rising branches coincide, and the table read off them is monotone."""
    record = reversal_record(actuator(), 0.01, 2.0, seed=1)
    cells, tabulated = static_model(record), table_model(record)
    rises = np.split(record.y, np.arange(100, record.y.size - 1, 100) + 1)[::2]
    u_rises = np.split(record.u, np.arange(100, record.u.size - 1, 100) + 1)[::2]
    apart = [np.interp(u, u_rises[-1], rises[-1]) - y for u, y in zip(u_rises[:-1], rises[:-1], strict=True)]
    results.add("S1: rising branches apart, % of range", 100 * max(np.abs(a).max() for a in apart) / np.ptp(record.y))
    measured_table = EverettTable.from_descending([record], np.asarray(cells.levels))
    results.add("S1: least step of the measured table, % of range", -100 * float(measured_table.turned().max()))
    results.add("S1: cells on the curves, RMS % of range", errors(cells, record)[1])
    results.add("S1: table on the curves, RMS % of range", errors(tabulated, record)[1])
    return record, cells, tabulated


def lag(results: Results, model: hf.Preisach) -> hf.Record:
    """S2: at 1 Hz the output lags the input, and the static model fails; also with the stronger relaxation of `STRONGER`."""
    t, u = legs((0, 150, 0, 150, 0), 1.0, 1000.0)
    second = t > 1.0
    for part, relaxation in (("S2", RELAXATION), ("S2 with a_1 = 0.35", STRONGER)):
        record = measure(actuator(relaxation=relaxation), t, u, name="1 Hz")
        peak = np.argmax(record.y[second])
        late = t[second][peak] - t[second][np.argmax(u[second])]
        results.add(f"{part}: output peak after input peak at 1 Hz, deg", 360 * late)
        results.add(f"{part}: input below its peak at the output's peak, V", u.max() - u[second][peak])
        results.add(f"{part}: static model at 1 Hz, max % of range", errors(model, record)[0])
    return record


def wiping_out(results: Results) -> list[hf.Record]:
    """S3, S4: histories wiped out by 180 V, in time, and in the input-output plane after a delay."""
    long, short = (measure(actuator(), *legs(extrema, 0.01, 10.0)) for extrema in WIPING_OUT)
    span = np.ptp(long.y)
    apart = np.abs(long.y[-501:] - short.y[-501:]).max()  # from 180 V on
    results.add("S3: outputs apart from 180 V on, % of range", 100 * apart / span)
    late = measure(actuator(), *_delayed(WIPING_OUT[0]))
    for words, at in (
        ("rises from 150 to 180 V", np.arange(150.0, 180.5)),
        ("falls from 180 to 120 V", np.arange(180.0, 119.5, -1.0)),
    ):
        branch = slice(-501, None) if at[0] > at[-1] else slice(None, -500)
        values = [_on_branch(r.u[branch], r.y[branch], at) for r in (late, short)]
        results.add(f"S4: {words} apart, % of range", 100 * np.abs(values[0] - values[1]).max() / span)
    return [long, short]


def _delayed(extrema: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    _, u = legs(extrema, 0.01, 10.0)
    u = np.concatenate([np.zeros(250), u])
    return np.arange(u.size) / 10.0, u


def _on_branch(u: np.ndarray, y: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Output at inputs on the last monotonic branch of a record.

    Args:
        u, y: record that ends with the branch, shape (T,).
        at: inputs within the branch.
    """
    sign = np.sign(u[-1] - u[-2])
    start = u.size - 1 - int(np.argmax(sign * np.diff(u)[::-1] < 0)) if (sign * np.diff(u) < 0).any() else 0
    return np.interp(sign * at, sign * u[start:], y[start:])


def minor_loops(results: Results) -> hf.Record:
    """S5: loops between 80 and 120 V after different histories, shifted to the same mean or to the same start."""
    truth = measure(actuator().parts[0], *legs(CONGRUENCY, 0.01, 10.0))
    pairs = [c for c in congruency(truth) if abs(c.low - 80) < 1 and abs(c.high - 120) < 1]
    results.add("S5: loops of 80 to 120 V apart, same mean, % of loop", max(c.percent_of_loop for c in pairs))
    legs_of = np.split(truth.y, np.arange(500, truth.y.size - 1, 500) + 1)
    before, after = (leg - leg[0] for leg in (legs_of[3], legs_of[7]))  # 80 to 120 V, before and after 180 V
    results.add(
        "S5: rises from 80 to 120 V apart, same start, % of loop", 100 * abs(before - after).max() / np.ptp(before)
    )
    return truth


def prediction(results: Results, models: dict[str, hf.Preisach]) -> list[hf.Record]:
    """S6, S7: a sine, and reversals of higher order, by the cells and by the table."""
    records = []
    for name, extrema in (("S6", (0, 150, 0)), ("S7", HIGHER_ORDER)):
        record = measure(actuator(), *legs(extrema, 0.01, 10.0), name=name)
        for word, model in models.items():
            largest, rms = errors(model, record)
            results.add(f"{name}: prediction by the {word}, max % of range", largest)
            results.add(f"{name}: prediction by the {word}, RMS % of range", rms)
        records.append(record)
    return records


def report(results: Results, name: str, runs: dict[str, LoopResult], since: float) -> None:
    """Numbers of runs on one reference, from a time on [s].

    Args:
        results: takes them.
        name: of the reference and the plant.
        runs: by arm.
        since: start of the samples that count.
    """
    rms = {}
    for arm, run in runs.items():
        error = run.error[run.t >= since]
        rms[arm] = float(np.sqrt(np.mean(error**2)))
        results.add(f"{name}: {arm} max, um", float(np.abs(error).max()))
        results.add(f"{name}: {arm} RMS, um", rms[arm])
    for arm in rms:
        for other in ("FB", "line+FB") if arm.endswith("FF+FB") else ():
            if other in rms:
                results.add(f"{name}: RMS of {arm} over {other}", rms[arm] / rms[other])


def loop(results: Results, model: hf.Preisach) -> tuple[Design, float]:
    """The loop's design, and the secant gain that it and the straight line have."""
    secant = 100.0 / float(hf.invert(model, np.linspace(0, 100, 50)).u[-1])
    made, paper, ours = loop_design(secant)
    results.add("loop: secant gain at 100 um, um/V", secant)
    results.add("loop: natural frequency by total least squares, rad/s", paper.omega)
    results.add("loop: natural frequency by output error, rad/s", ours.omega)
    results.add("loop: damping ratio of the plant by output error", ours.zeta)
    results.add("loop: damping ratio, closed", made.damping)
    results.add("loop: phase margin at 10 kHz, deg", made.margins.phase)
    results.add("loop: least damping over plants", robust_damping(made, ours.omega, secant))
    return made, secant


def tracking(results: Results, model: hf.Preisach, tabulated: hf.Preisach) -> dict[str, dict[str, LoopResult]]:
    """S8 to S14: the tracked trajectories.

    The rise to 100 um is common to all of them; S11 to S14 are judged after it, where they differ.
    """
    made, secant = loop(results, model)
    models, rise = {"": model, "table ": tabulated}, 50.0
    every = ("FF", "table FF", "FB", "line+FB", "FF+FB", "table FF+FB")
    chosen = {
        ("S8-10 major", "unchanged"): every,
        ("S8-10 major", "-8 %"): ("FF", "FB", "line+FB", "FF+FB"),
        ("S8-10 major", "changed in shape"): ("FF", "FB", "line+FB", "FF+FB"),
        ("S11-13 minor", "unchanged"): ("FF", "FB", "line+FB", "FF+FB"),
        ("S11-13 minor", "changed in shape"): ("FF", "FB", "line+FB", "FF+FB"),
        ("S14 wiping-out", "unchanged"): ("FB", "line+FB", "FF+FB"),
    }
    kept = {}
    for trajectory, extrema in (("S8-10 major", MAJOR), ("S11-13 minor", MINOR), ("S14 wiping-out", WIPED)):
        for plant, changed in PLANTS.items():
            names = chosen.get((trajectory, plant), ()) if results.quick else every
            if not names:
                continue
            runs = arms(extrema, models, secant, made, changed, names)
            name, since = f"{trajectory}, plant {plant}", 0.0 if extrema == MAJOR else rise
            report(results, name, runs, since)
            if (trajectory, plant) in DRAWN:
                kept[name] = runs
            if not results.quick or (trajectory, plant) in QUIET:
                quiet = arms(extrema, models, secant, made, changed, ("line+FB", "FF+FB"), noise=0.0)
                report(results, f"{name}, no sensor noise", quiet, since)
    return kept


def frequency(results: Results, curves: hf.Record, model: hf.Preisach) -> dict[str, list[float]]:
    """S15: the static inverse away from 0.01 Hz, and the inverse of a model with relaxation."""
    plant, records = actuator(), [curves]
    for f in (0.1, 1.0):
        t, u = legs((0, 150, 0, 150, 0, 100, 0), f, 200 * f)
        records.append(measure(plant, t, u, seed=2, name=f"{f:g} Hz"))
    relaxed = with_relaxation(records)
    rows: dict[str, list[float]] = {"static": [], "relaxation": []}
    over_all: dict[str, list[float]] = {"static": [], "relaxation": []}
    for f in (0.01, 0.1, 1.0):
        # At the end of a fast cycle the displacement at 0 V is still above zero: no voltage reaches the reference there.
        ahead = {name: feedforward(inverse, MAJOR, f) for name, inverse in (("static", model), ("relaxation", relaxed))}
        within = ahead["relaxation"][1]
        results.add(f"S15: out of reach at {f:g} Hz, % of samples", 100 * float(np.mean(~within)))
        for name in rows:
            run = track(MAJOR, ahead[name][0], None, frequency=f)
            rows[name].append(float(np.abs(run.error[within]).max()))
            results.add(f"S15: FF max within reach at {f:g} Hz, {name} inverse, um", rows[name][-1])
            over_all[name].append(results.add(f"S15: FF max at {f:g} Hz, {name} inverse, um", run.max_error()))
    ratio = over_all["relaxation"][1] / over_all["static"][0]
    results.add("S15: relaxation inverse at 0.1 Hz over the static one at 0.01 Hz, out of reach included", ratio)
    # The same for a reference that returns to 2 um and is within reach throughout: all samples count.
    above = {}
    for name, inverse, f in (("static", model, 0.01), ("static", model, 0.1), ("relaxation", relaxed, 0.1)):
        run = track(RAISED, feedforward(inverse, RAISED, f)[0], None, frequency=f)
        above[name, f] = results.add(f"S15 back to 2 um: FF max at {f:g} Hz, {name} inverse, um", run.max_error())
    for name in rows:
        ratio = above[name, 0.1] / above["static", 0.01]
        results.add(f"S15 back to 2 um: {name} inverse at 0.1 Hz over the static one at 0.01 Hz", ratio)
    for k, f in ((1, 0.1), (2, 1.0)):
        for name, values in rows.items():
            results.add(
                f"S15: {name} inverse at {f:g} Hz over the static one at 0.01 Hz", values[k] / rows["static"][0]
            )
    return rows


def page(results: Results) -> str:
    """All numbers as tables, the tracking errors like Tables I and II of the paper."""
    parts: dict[str, list[list[object]]] = {}
    tracked: dict[str, dict[str, float]] = {}
    for name, value in results.numbers.items():
        part, what = name.split(": ", 1)
        parts.setdefault(part, []).append([what, value, results.verdict(name), results.origin(name)])
        if what.endswith(" RMS, um") and ", plant " in part:
            tracked.setdefault(part, {})[what.removesuffix(" RMS, um")] = value
    columns = ["FF", "table FF", "FB", "line+FB", "FF+FB", "table FF+FB"]
    rows = [[part, *(values.get(column) for column in columns)] for part, values in tracked.items()]
    values = {
        "form": " --quick" if results.quick else "",
        "tracking": table(["RMS error, um", *columns], rows),
        "numbers": "\n".join(
            f"### {part}\n\n" + table(["number", "value", "expected", "data"], lines) for part, lines in parts.items()
        ),
    }
    return results.fill((HERE / "page.md").read_text(encoding="utf-8"), values)


def main() -> None:
    """Run everything, check the numbers and write the page."""
    hf.enable_x64()
    args = arguments((__doc__ or "").partition("\n")[0])
    results = Results(HERE, args.quick, args.out)
    curves, model, tabulated = reversal_curves(results)
    fast = lag(results, model)
    wiped = wiping_out(results)
    loops = minor_loops(results)
    models = {"cells": model, "table": tabulated}
    predicted = prediction(results, models)
    rows = frequency(results, curves, model)
    runs = tracking(results, model, tabulated)
    records = None if args.quick else measured(results)
    if records is not None:
        figures.measured(results.out, records)
    figures.identification(results.out, curves, model, fast)
    figures.properties(results.out, wiped, loops)
    figures.predictions(results.out, [(r, {word: predict(m, r) for word, m in models.items()}) for r in predicted])
    figures.tracked(results.out, runs)
    figures.frequencies(results.out, rows)
    complete = not (args.quick or args.out or results.skipped)
    (HERE if complete else results.out).joinpath("RESULTS.md").write_text(page(results), encoding="utf-8")
    if complete:
        for name in SHOWN:
            shutil.copy(results.out / name, HERE / name)
    results.finish()


if __name__ == "__main__":
    main()
