"""M5 to M9: feed-forward tracking with the inverse of the model, on one axis and on three."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from common import Results, table
from plants import ALL_AT_ONCE, FINER, LIMITS, Tracking, axis, cosine, drive, track, with_mode
from scipy.optimize import minimize_scalar

from hystfit import Series, simulate
from hystfit.control import invert
from hystfit.data.record import Record
from hystfit.identify import Ukf
from hystfit.signals import staircase
from hystfit.stage import Kinematics, Sensor, Stage, identify_jacobian, perturbed, piezo
from hystfit.stage.adaptive import track_adaptively

FREQUENCIES = (0.1, 1.0, 10.0, 50.0, 100.0)
STROKES = (5.0, 20.0, 50.0, 100.0)


def sines(results: Results, quick: bool) -> tuple[str, Tracking]:
    """M5 and M6: tracking errors over frequency and stroke, with the true and with a perturbed model."""
    model, rows = axis(), []
    wrong, plant = perturbed(model, **ALL_AT_ONCE), with_mode(model)
    for frequency in FREQUENCIES:
        for stroke in STROKES[::3] if quick else STROKES:
            reference, dt, cycle = cosine(frequency, stroke)
            matched = track(plant, model, reference, dt, cycle).worst
            rows.append([frequency, stroke, matched, track(plant, wrong, reference, dt, cycle).worst])
    results.add("M6: maximum error %, 0.1-50 Hz, perturbed", max(row[3] for row in rows if row[0] < 100))
    results.add("M6: maximum error %, 100 Hz, perturbed", max(row[3] for row in rows if row[0] == 100))
    results.add("M6: maximum error %, 0.1-50 Hz, matched", max(row[2] for row in rows if row[0] < 100))
    reference, dt, cycle = cosine(10.0, 20.0)
    example = track(plant, wrong, reference, dt, cycle)
    results.add("M5: 20 um at 10 Hz, maximum error %, perturbed", example.worst)
    inverted = []
    for frequency, stroke in ((50.0, 50.0), (100.0, 20.0), (100.0, 100.0)):
        reference, dt, cycle = cosine(frequency, stroke)
        inverted.append([frequency, stroke, track(plant, plant, reference, dt, cycle).worst])
    results.add(
        "M6: maximum error %, 100 Hz, matched, resonance inverted", max(row[2] for row in inverted if row[0] == 100)
    )
    head = ["frequency / Hz", "stroke / um", "matched, max error %", "perturbed, max error %"]
    extra = table(["frequency / Hz", "stroke / um", "matched, resonance inverted, max error %"], inverted)
    return table(head, rows) + "\n" + extra, example


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


def ladder(results: Results) -> tuple[str, dict[str, Tracking]]:
    """M7 and M8: a staircase with and without control, and with parts of the model left out."""
    model = axis()
    t, reference = staircase(250.0, levels=9, hold=4.0, ramp=0.1, low=0.0, high=80.0)
    dt = float(t[1] - t[0])
    wrong = perturbed(model, **ALL_AT_ONCE)
    hysteresis, creep = model.parts
    no_loop = Series(perturbed(model, mu=1e-6).parts[0], creep)
    no_creep = Series(hysteresis, perturbed(model, gamma=1e-9).parts[1])
    runs = {
        "uncontrolled, best linear gain": uncontrolled(model, reference, dt, centered=False),
        "uncontrolled, best gain and offset": uncontrolled(model, reference, dt, centered=True),
        "controlled, matched": track(model, model, reference, dt),
        "controlled, perturbed": track(model, wrong, reference, dt),
        "no creep term, gain refitted": _refitted(model, no_creep, reference, dt),
        "no hysteresis term, gain refitted": _refitted(model, no_loop, reference, dt),
    }
    results.add("M7: uncontrolled, maximum % of the ladder", runs["uncontrolled, best linear gain"].worst)
    results.add("M8: controlled, perturbed, maximum % of the ladder", runs["controlled, perturbed"].worst)
    results.add("M8: controlled, matched, maximum % of the ladder", runs["controlled, matched"].worst)
    gain = runs["uncontrolled, best gain and offset"].worst / runs["controlled, perturbed"].worst
    results.add("M8: uncontrolled / controlled", gain)
    results.add("M8: no creep term, maximum %", runs["no creep term, gain refitted"].worst)
    results.add("M8: no hysteresis term, maximum %", runs["no hysteresis term, gain refitted"].worst)
    return table(
        ["staircase of 80 um", "maximum error, % of the ladder"], [[name, run.worst] for name, run in runs.items()]
    ), runs


def _refitted(plant: Series, model: Series, reference: np.ndarray, dt: float) -> Tracking:
    """Tracking with an incomplete model whose gain minimizes the largest error. Args as `drive`."""
    return least(lambda factor: track(plant, perturbed(model, c=factor), reference, dt), 0.5, 1.2)


def three_axes(results: Results) -> tuple[str, dict[str, np.ndarray]]:
    """M9: a circle with rotation by three unequal actuators, with the Jacobian of the design and the identified one."""
    devices = [perturbed(piezo(), c=1 + 0.03 * (k - 1), gamma=1 + 0.1 * (k - 1)) for k in range(3)]
    truth = Stage.of(devices, kinematics=Kinematics(amplification=6.3, arm=41.0, direction=0.02))
    t, dt = np.arange(20_000) / 10_000.0, 1e-4
    grow = np.minimum(t / 0.2, 1.0)
    middle = np.asarray(truth.kinematics.pose(jnp.full(3, 6.0)))
    shape = np.stack(
        [15 * np.cos(2 * np.pi * 5 * t), 15 * np.sin(2 * np.pi * 5 * t), 0.15 * np.sin(2 * np.pi * 10 * t)], axis=1
    )
    poses = grow[:, None] * (middle + shape)
    runs, designed, identified = {}, np.asarray(Kinematics().jacobian()), _identified_jacobian(truth)
    wrong = [perturbed(device, **ALL_AT_ONCE) for device in devices]
    for name, jacobian, models in (
        ("designed", designed, devices),
        ("calibrated", identified, devices),
        ("calibrated, actuators perturbed", identified, wrong),
    ):
        lengths = poses @ np.linalg.inv(jacobian).T
        u = np.stack([invert(models[k], lengths[:, k], dt, limits=LIMITS).u for k in range(3)], axis=1)
        runs[name] = truth.simulate(u, dt, finer=FINER)
    steady = t > 1.0
    size = np.ptp(poses[steady], axis=0)
    rows = []
    for name, reached in runs.items():
        error = 100 * np.max(np.abs(reached - poses)[steady], axis=0) / size
        rows.append([name, *error.tolist()])
    results.add("M9: circle with turn, worst axis %, calibrated Jacobian", max(rows[1][1:]))
    results.add("M9: worst axis %, calibrated Jacobian, actuators perturbed", max(rows[2][1:]))
    results.add("M9: worst axis %, designed / calibrated Jacobian", max(rows[0][1:]) / max(rows[1][1:]))
    results.add("M9: cross-axis, y and theta moved by x alone, %", _cross(truth, devices))
    return table(["Jacobian", "x, max error %", "y", "theta"], rows), {
        "reference": poses[steady],
        **{k: v[steady] for k, v in runs.items()},
    }


def _identified_jacobian(truth: Stage) -> np.ndarray:
    """Jacobian from records of the three actuators at different frequencies: strain gauges and probes with 5 nm of noise."""
    t = np.arange(20_000) / 10_000.0
    u = np.stack([50 - 50 * np.cos(2 * np.pi * f * t) for f in (2.0, 3.0, 4.5)], axis=1)
    rng = np.random.default_rng(5)
    steps = jnp.full(t.size, 1e-4).at[0].set(0.0)
    devices = [jax.tree.map(lambda leaf, k=k: leaf[k], truth.actuators) for k in range(3)]
    lengths = np.stack([simulate(device, jnp.asarray(u[:, k]), steps)[0] for k, device in enumerate(devices)], axis=1)
    noise = np.array([0.005, 0.005, 0.005 / 40])
    poses = truth.simulate(u) + noise * rng.standard_normal(u.shape)
    return identify_jacobian(lengths + 0.005 * rng.standard_normal(u.shape), poses).jacobian


def _cross(truth: Stage, devices: list[Any]) -> float:
    """Motion of y, and of theta times its arm, for a reference in x only, in percent of x."""
    t, dt = np.arange(10_000) / 10_000.0, 1e-4
    middle = np.asarray(truth.kinematics.pose(jnp.full(3, 6.0)))
    poses = np.minimum(t / 0.2, 1.0)[:, None] * (
        middle + np.stack([20 * np.sin(2 * np.pi * 5 * t), 0 * t, 0 * t], axis=1)
    )
    lengths = poses @ np.linalg.inv(_identified_jacobian(truth)).T
    u = np.stack([invert(devices[k], lengths[:, k], dt, limits=LIMITS).u for k in range(3)], axis=1)
    error = np.abs(truth.simulate(u, dt, finer=FINER) - poses)[t > 0.4]
    return float(100 * max(error[:, 1].max(), 40 * error[:, 2].max()) / 40.0)


def adaptive(results: Results) -> str:
    """The filter in parallel with the inverse: a wrong model is corrected during tracking."""
    plant = axis()
    wrong = perturbed(plant, c=1.05, mu=0.9, tau=1.2, delta=0.85, gamma=1.1)
    dt, block = 1e-3, 500
    t = dt * np.arange(12_000)
    reference = 40 * (0.6 + 0.4 * np.cos(2 * np.pi * t / 3.7)) * (1 - np.cos(2 * np.pi * t))
    u = invert(wrong, reference, dt, limits=LIMITS).u
    noise = 0.02
    scale = Record(u=u, y=np.asarray(simulate(wrong, jnp.asarray(u), jnp.full(u.size, dt))[0]) + 1e-9 * np.sin(t), t=t)
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
