"""M5 to M8: feed-forward tracking on one axis with the inverse of the model, and with the filter beside it."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from common import Results, table
from plants import ALL_AT_ONCE, FAR_OFF, LIMITS, Tracking, axis, cosine, drive, on_axis, track, with_mode
from scipy.optimize import minimize_scalar

from hystfit import Series, simulate
from hystfit.control import invert
from hystfit.data.record import Record
from hystfit.identify import Ukf
from hystfit.signals import staircase
from hystfit.stage import Sensor, perturbed, track_adaptively

FREQUENCIES = (0.1, 1.0, 10.0, 50.0, 100.0)
STROKES = (5.0, 20.0, 50.0, 100.0)


def sines(results: Results, quick: bool, identified: Series) -> tuple[str, Tracking]:
    """M5 and M6: tracking errors over frequency and stroke, with the identified, the true and a perturbed model.

    Args:
        results: of the experiment.
        quick: two strokes only.
        identified: the actuator as the filter found it.
    """
    model, runs = axis(), {}
    plant = with_mode(model)
    models = {"identified": on_axis(identified), "matched": model, "perturbed": perturbed(model, **ALL_AT_ONCE)}
    for frequency in FREQUENCIES:
        for stroke in STROKES[1::2] if quick else STROKES:
            reference, dt, cycle = cosine(frequency, stroke)
            for name, inverted in models.items():
                runs[frequency, stroke, name] = track(plant, inverted, reference, dt, cycle)
    worst = lambda name, at: max(r.worst for (f, _, n), r in runs.items() if n == name and f in at)
    for frequency in (0.1, 10.0, 50.0, 100.0):
        results.add(f"M6: maximum error % at {frequency:g} Hz, identified", worst("identified", (frequency,)))
    steps = [worst("identified", (f,)) for f in (0.1, 10.0, 50.0, 100.0)]
    results.add(
        "M6: growth of the error with frequency, identified, least ratio", min(np.divide(steps[1:], steps[:-1]))
    )
    larger = [runs[f, 100.0, "identified"].worst / runs[f, 20.0, "identified"].worst for f in FREQUENCIES]
    results.add("M6: growth of the error from 20 to 100 um, identified, least ratio", min(larger))
    results.add("M6: maximum error %, 0.1-50 Hz, perturbed", worst("perturbed", FREQUENCIES[:-1]))
    results.add("M6: maximum error % at 100 Hz, matched", worst("matched", (100.0,)))
    results.add("M6: maximum error % at 10 Hz, matched", worst("matched", (10.0,)))
    example = runs[10.0, 20.0, "identified"]
    results.add("M5: 20 um at 10 Hz, maximum error %, identified", example.worst)
    results.add("M5: 20 um at 10 Hz, maximum error %, perturbed", runs[10.0, 20.0, "perturbed"].worst)
    output_resonance = []
    for frequency, stroke in ((50.0, 50.0), (100.0, 20.0), (100.0, 100.0)):
        reference, dt, cycle = cosine(frequency, stroke)
        kinds = (plant, with_mode(on_axis(identified)))
        output_resonance.append(
            [frequency, stroke, *(track(plant, inverted, reference, dt, cycle).worst for inverted in kinds)]
        )
    results.add(
        "M6: maximum error % at 100 Hz, matched, resonance inverted",
        max(row[2] for row in output_resonance if row[0] == 100),
    )
    results.add(
        "M6: maximum error % at 100 Hz, identified, resonance inverted",
        max(row[3] for row in output_resonance if row[0] == 100),
    )
    head = ["frequency / Hz", "stroke / um", *(f"{name}, max error %" for name in models)]
    rows = [[f, s, *(runs[f, s, name].worst for name in models)] for f, s, name in runs if name == "identified"]
    extra = [*head[:2], "matched, resonance inverted, max error %", "identified, resonance inverted"]
    return table(head, rows) + "\n" + table(extra, output_resonance), example


def least(make: Callable[[float], Tracking], low: float, high: float) -> Tracking:
    """The run with the least largest error, over one factor.

    Args:
        make: the run for a factor.
        low, high: range of the factor.
    """
    best = minimize_scalar(
        lambda x: make(float(x)).worst, bounds=(low, high), method="bounded", options={"xatol": 3e-3}
    )
    return make(float(best.x))


def uncontrolled(plant: Series, reference: np.ndarray, dt: float, *, centered: bool) -> Tracking:
    """The voltage is the reference over the best gain.

    Args:
        plant: voltage to displacement.
        reference: shape (T,) [um].
        dt: sampling interval [s].
        centered: also use the best offset.
    """
    gain = 100.0 / float(np.ptp(simulate(plant, jnp.linspace(0.0, 100.0, 200), jnp.full(200, 0.01))[0]))

    def make(factor: float) -> Tracking:
        run = drive(plant, reference, factor * gain * reference, dt, None)
        miss = reference - run.y
        shift = 0.5 * (miss.max() + miss.min()) if centered else 0.0
        return Tracking(run.t, reference, run.u, run.y + shift, None)

    return least(make, 0.8, 1.25)


def ladder(results: Results, identified: Series) -> tuple[str, dict[str, Tracking]]:
    """M7 and M8: a staircase with and without control, and with parts of the model left out.

    Args:
        results: of the experiment.
        identified: the actuator as the filter found it.
    """
    model, found = axis(), on_axis(identified)
    t, reference = staircase(250.0, levels=9, hold=4.0, ramp=0.1, low=0.0, high=80.0)
    dt = float(t[1] - t[0])
    hysteresis, creep = found.parts
    no_loop = Series(perturbed(found, mu=1e-6).parts[0], creep)
    no_creep = Series(hysteresis, perturbed(found, gamma=1e-9).parts[1])
    runs = {
        "uncontrolled, best linear gain": uncontrolled(model, reference, dt, centered=False),
        "uncontrolled, best gain and offset": uncontrolled(model, reference, dt, centered=True),
        "controlled, identified": track(model, found, reference, dt),
        "controlled, matched": track(model, model, reference, dt),
        "controlled, perturbed": track(model, perturbed(model, **ALL_AT_ONCE), reference, dt),
        "identified, no creep term, gain refitted": _refitted(model, no_creep, reference, dt),
        "identified, no hysteresis term, gain refitted": _refitted(model, no_loop, reference, dt),
    }
    worst = {name: run.worst for name, run in runs.items()}
    results.add("M7: uncontrolled, maximum % of the ladder", worst["uncontrolled, best linear gain"])
    for kind in ("identified", "perturbed", "matched"):
        results.add(f"M8: controlled, {kind}, maximum % of the ladder", worst[f"controlled, {kind}"])
    gain = worst["uncontrolled, best gain and offset"] / worst["controlled, identified"]
    results.add("M8: uncontrolled / controlled, identified", gain)
    results.add("M8: no creep term, maximum %", worst["identified, no creep term, gain refitted"])
    results.add("M8: no hysteresis term, maximum %", worst["identified, no hysteresis term, gain refitted"])
    return table(["staircase of 80 um", "maximum error, % of the ladder"], [list(row) for row in worst.items()]), runs


def _refitted(plant: Series, model: Series, reference: np.ndarray, dt: float) -> Tracking:
    """Tracking with an incomplete model whose gain minimizes the largest error. Args as `drive`."""
    return least(lambda factor: track(plant, perturbed(model, c=factor), reference, dt), 0.5, 1.2)


def adaptive(results: Results) -> str:
    """The filter in parallel with the inverse: a wrong model is corrected during tracking."""
    plant = axis()
    wrong = perturbed(plant, **FAR_OFF)
    dt, block = 1e-3, 500
    t = dt * np.arange(12_000)
    reference = 40 * (0.6 + 0.4 * np.cos(2 * np.pi * t / 3.7)) * (1 - np.cos(2 * np.pi * t))
    u = invert(wrong, reference, dt, limits=LIMITS).u
    noise = 0.02
    scale = Record(u=u, y=np.asarray(simulate(wrong, jnp.asarray(u), jnp.full(u.size, dt))[0]), t=t)
    ukf = Ukf.of(wrong, scale, start="model", noise=noise, prior=0.2, caution=2.0, settling=300.0)
    run = track_adaptively(ukf, plant, reference, dt, block=block, limits=LIMITS, sensor=Sensor(noise, 0.0), seed=0)
    fixed = drive(plant, reference, u, dt, None)
    late = slice(-4000, None)
    span = np.ptp(reference)
    before, after = (100 * np.max(np.abs(e[late])) / span for e in (reference - fixed.y, run.error))
    results.add("adaptive: maximum error % over the last 4 s, fixed model", before)
    results.add("adaptive: maximum error % over the last 4 s, filter beside", after)
    return table(
        ["feed-forward", "maximum error %, last 4 of 12 s"],
        [["wrong model, fixed", before], ["corrected every 0.5 s", after]],
    )
