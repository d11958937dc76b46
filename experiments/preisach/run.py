"""Song et al. 2005 on a surrogate: reversal curves, wiping-out, congruency, prediction, and tracking with the inverse; the full form
also predicts held-out measured reversal curves and minor loops.

    python experiments/preisach/run.py [--quick] [--out FOLDER]

Writes figures and results.json to out/ and all numbers to RESULTS.md (the quick form to report.md in out/). Exit status: see
experiments/common.py.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"  # matrices are too small for threads
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import figures
import numpy as np
from common import Results, arguments, table
from identify import reversal_record, static_model, with_relaxation
from measured import measured
from plant import STRONGER, Thunder, actuator, legs, measure
from tracking import Trio, feedforward, loop_design, robust_damping, track, trio

import hystfit as hf
from hystfit.models.preisach import congruency
from hystfit.models.preisach.properties import CONGRUENCY, HIGHER_ORDER, WIPING_OUT

HERE = Path(__file__).resolve().parent
MAJOR, MINOR, WIPED = (0.0, 100.0, 0.0), (0.0, 100.0, 20.0, 80.0, 40.0), (0.0, 80.0, 40.0, 100.0, 20.0)
RAISED = (0.0, 100.0, 2.0)
DRIFT = 0.92


def predict(model: hf.models.AbstractHysteresis, record: hf.Record) -> np.ndarray:
    """Free run on a record's input."""
    return np.asarray(hf.simulate(model, record.u, record.dt)[0])


def errors(model: hf.models.AbstractHysteresis, record: hf.Record) -> tuple[float, float]:
    """Largest and RMS error in percent of the record's range."""
    e, span = predict(model, record) - record.y, np.ptp(record.y)
    return 100 * float(np.abs(e).max() / span), 100 * float(np.sqrt(np.mean(e**2)) / span)


def reversal_curves(results: Results) -> tuple[hf.Record, hf.Preisach]:
    """S1: curves of 12 heights; rising branches coincide, and the table is monotone."""
    record = reversal_record(actuator(), 0.01, 2.0, seed=1)
    model = static_model(record)
    legs_of = np.split(record.y, np.arange(100, record.y.size - 1, 100) + 1)
    rises = [leg for leg in legs_of[::2]]
    tops = [leg[-1] for leg in rises]
    u_rises = np.split(record.u, np.arange(100, record.u.size - 1, 100) + 1)[::2]
    apart = [np.interp(u, u_rises[-1], rises[-1]) - y for u, y in zip(u_rises[:-1], rises[:-1], strict=True)]
    results.add("S1: rising branches apart, % of range", 100 * max(np.abs(a).max() for a in apart) / np.ptp(record.y))
    results.add("S1: least step of the branch tops, um", float(np.min(np.diff(tops))))
    results.add("S1: least weight of the cells, um", float(np.min(np.asarray(model.w))))
    results.add("S1: fit of the curves, RMS % of range", errors(model, record)[1])
    return record, model


def lag(results: Results, model: hf.Preisach) -> hf.Record:
    """S2: at 1 Hz the output lags the input, and the static model fails."""
    t, u = legs((0, 150, 0, 150, 0), 1.0, 1000.0)
    record = measure(actuator(relaxation=STRONGER), t, u, name="1 Hz")
    second = t > 1.0
    late = t[second][np.argmax(record.y[second])] - t[second][np.argmax(u[second])]
    results.add("S2: output peak after input peak at 1 Hz, deg", 360 * late)
    results.add("S2: input at the output's peak, V", u[second][np.argmax(record.y[second])])
    results.add("S2: static model at 1 Hz, max % of range", errors(model, record)[0])
    return record


def wiping_out(results: Results) -> list[hf.Record]:
    """S3, S4: histories wiped out by 180 V, in time and in the input-output plane, with and without relaxation."""
    kept = []
    for label, relaxation in (("on", actuator().parts[1]), ("off", None)):
        plant = Thunder() if relaxation is None else hf.Series(Thunder(), relaxation)
        long, short = (measure(plant, *legs(extrema, 0.01, 10.0)) for extrema in WIPING_OUT)
        kept += [long, short] if relaxation is not None else []
        tails = [record.y[-501:] for record in (long, short)]  # from 180 V on
        span = np.ptp(long.y)
        results.add(
            f"S3: outputs apart from 180 V on, relaxation {label}, % of range",
            100 * np.abs(tails[0] - tails[1]).max() / span,
        )
        late = measure(plant, *_delayed(WIPING_OUT[0]))
        down = np.arange(180.0, 120.0, -1.0)
        falls = [np.interp(-down, -r.u[-501:], r.y[-501:]) for r in (late, short)]
        results.add(
            f"S4: falls of a delayed signal apart, relaxation {label}, % of range",
            100 * np.abs(falls[0] - falls[1]).max() / span,
        )
    return kept


def _delayed(extrema: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    _, u = legs(extrema, 0.01, 10.0)
    u = np.concatenate([np.zeros(250), u])
    return np.arange(u.size) / 10.0, u


def minor_loops(results: Results, model: hf.Preisach) -> hf.Record:
    """S5: loops between 80 and 120 V after different histories."""
    t, u = legs(CONGRUENCY, 0.01, 10.0)
    truth = measure(actuator().parts[0], t, u)
    same = measure(model, t, u)
    for name, record in (("truth", truth), ("model", same)):
        pairs = [c for c in congruency(record) if abs(c.low - 80) < 1 and abs(c.high - 120) < 1]
        results.add(f"S5: loops of 80 to 120 V apart, {name}, % of loop", max(c.percent_of_loop for c in pairs))
    return truth


def prediction(results: Results, model: hf.Preisach) -> list[hf.Record]:
    """S6, S7: a sine, and reversals of higher order."""
    records = []
    for name, extrema in (("S6", (0, 150, 0)), ("S7", HIGHER_ORDER)):
        record = measure(actuator(), *legs(extrema, 0.01, 10.0), name=name)
        largest, rms = errors(model, record)
        results.add(f"{name}: prediction, max % of range", largest)
        results.add(f"{name}: prediction, RMS % of range", rms)
        records.append(record)
    return records


def report(results: Results, name: str, found: Trio) -> None:
    """Numbers of a trio."""
    for label, run in (("FF", found.ff), ("FB", found.fb), ("FF+FB", found.both)):
        results.add(f"{name}: {label} max, um", run.max_error())
        results.add(f"{name}: {label} RMS, um", run.rms_error())
    results.add(f"{name}: RMS of FF+FB over FB", found.both.rms_error() / found.fb.rms_error())


def tracking(results: Results, model: hf.Preisach) -> tuple[list[Trio], object]:
    """S8 to S14: the loop's design and the tracked trajectories."""
    secant = 100.0 / float(hf.invert(model, np.linspace(0, 100, 50)).u[-1])
    made, paper, ours = loop_design(secant)
    results.add("loop: secant gain at 100 um, um/V", secant)
    results.add("loop: natural frequency by total least squares, rad/s", paper.omega)
    results.add("loop: natural frequency by output error, rad/s", ours.omega)
    results.add("loop: damping ratio of the plant by output error", ours.zeta)
    results.add("loop: damping ratio, closed", made.damping)
    results.add("loop: phase margin at 10 kHz, deg", made.margins.phase)
    results.add("loop: least damping over plants", robust_damping(made, ours.omega, secant))
    trios = []
    for name, extrema in (("S8-10 major, plant -8 %", MAJOR), ("S11-13 minor, plant -8 %", MINOR)):
        found = trio(extrema, model, made, DRIFT)
        report(results, name, found)
        trios.append(found)
    results.add(
        "S8 major, plant unchanged: FF max, um", track(MAJOR, feedforward(model, MAJOR, 0.01)[0], None).max_error()
    )
    wiped = track(WIPED, feedforward(model, WIPED, 0.01)[0], made, gain=DRIFT)
    results.add("S14 wiping-out, plant -8 %: FF+FB max, um", wiped.max_error())
    if not results.quick:
        for name, extrema in (("S8-10 major, plant unchanged", MAJOR), ("S11-13 minor, plant unchanged", MINOR)):
            report(results, name, trio(extrema, model, made, 1.0))
    return trios, wiped


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
        parts.setdefault(part, []).append([what, value, results.verdict(name)])
        if what.endswith((" max, um", " RMS, um")) and part.startswith(("S8-10", "S11-13")):
            tracked.setdefault(part, {})[what] = value
    columns = [f"{how} {size}, um" for how in ("FF", "FB", "FF+FB") for size in ("max", "RMS")]
    rows = [[part, *(values[column] for column in columns)] for part, values in tracked.items()]
    text = f"# Numbers of experiments/preisach, {'quick' if results.quick else 'full'} form\n\n"
    text += (
        "Written by `run.py`. Device, controller and unavailable signals are surrogates (README).\n\n## Tracking\n\n"
    )
    text += table(["trajectory", *columns], rows)
    for part, lines in parts.items():
        text += f"\n## {part}\n\n" + table(["number", "value", "expected"], lines)
    return text


def main() -> None:
    """Run everything, check the numbers and write the page."""
    hf.enable_x64()
    args = arguments(__doc__.splitlines()[0])
    results = Results(HERE, args.quick, args.out)
    curves, model = reversal_curves(results)
    fast = lag(results, model)
    wiped = wiping_out(results)
    loops = minor_loops(results, model)
    predicted = prediction(results, model)
    rows = frequency(results, curves, model)
    trios, last = tracking(results, model)
    records = None if args.quick else measured(results)
    if records is not None:
        figures.measured(results.out, records)
    figures.identification(results.out, curves, model, fast)
    figures.properties(results.out, wiped, loops)
    figures.predictions(results.out, [(record, predict(model, record)) for record in predicted])
    figures.tracked(results.out, trios, last)
    figures.frequencies(results.out, rows)
    target = results.out / "report.md" if args.quick or args.out or results.skipped else HERE / "RESULTS.md"
    target.write_text(page(results), encoding="utf-8")
    results.finish()


if __name__ == "__main__":
    main()
