"""M9: the three-axis stage in one call: inverse and Jacobian identified from records, open and closed loop, filters beside it."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from common import Results, table
from identification import identify_actuator
from plants import ALL_AT_ONCE, FAR_OFF, FINER, LIMITS

from hystfit import Record, datasets, simulate
from hystfit.control import Controller, LoopResult, TransferFunction, run_loop
from hystfit.identify import Ukf
from hystfit.stage import (
    Actuator,
    Decoupled,
    Kinematics,
    Sensor,
    Stage,
    StageInverse,
    identify_jacobian,
    perturbed,
    piezo,
    track_adaptively,
)

RATE = 10_000.0  # Hz
BANDWIDTH = 60.0  # rad/s of the integrator, a third of what the resonance of the stage allows
DEVICES = tuple(perturbed(piezo(), c=1 + 0.03 * (k - 1), gamma=1 + 0.1 * (k - 1)) for k in range(3))
NOISE = np.array([0.005, 0.005, 0.005 / 40])  # um, um, mrad
ALMOST = 0.4  # s after which the start-up has passed


def stage() -> Stage:
    """Three unequal actuators on a mechanism off its design."""
    return Stage.of(DEVICES, kinematics=Kinematics(amplification=6.3, arm=41.0, direction=0.02))


def circle(truth: Stage, duration: float, frequency: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Times, and poses of a circle of 30 um with a rotation of 0.3 mrad at twice its frequency.

    Args:
        truth: whose middle pose is the center.
        duration: in s.
        frequency: of the circle [Hz].
        rate: samples per second.
    """
    t = np.arange(round(duration * rate)) / rate
    phase = 2 * np.pi * frequency * t
    shape = np.stack([15 * np.cos(phase), 15 * np.sin(phase), 0.15 * np.sin(2 * phase)], axis=1)
    return t, np.minimum(t * frequency, 1.0)[:, None] * (middle(truth) + shape)


def middle(truth: Stage) -> np.ndarray:
    """Pose with all actuators at half their stroke."""
    return np.asarray(truth.kinematics.pose(jnp.full(3, 6.0)))


def identified_actuators() -> list[Any]:
    """The three actuators as the filter finds them, each from a fast and a slow record like those of `data/`."""
    fast, slow = datasets.load("stage-sweep"), datasets.load("stage-step")
    records = lambda k, r: Actuator(model=DEVICES[k]).record(r.t, r.u, seed=k, name=r.name)
    return [identify_actuator(records(k, fast), records(k, slow))[0] for k in range(3)]


def identified_jacobian(truth: Stage) -> np.ndarray:
    """Jacobian from one record of the gauges and probes, each actuator at a frequency of its own."""
    t = np.arange(5_000) / 2_500.0
    u = np.stack([50 - 50 * np.cos(2 * np.pi * f * t) for f in (2.0, 3.0, 4.5)], axis=1)
    measured = truth.measure(t, u, seed=5)
    return identify_jacobian(measured.extension, measured.pose).jacobian


def three_axes(results: Results) -> tuple[str, dict[str, LoopResult]]:
    """A circle with rotation: designed and identified Jacobian, identified and perturbed actuators, with and without feedback."""
    truth = stage()
    _, poses = circle(truth, 0.8, 5.0, RATE)
    found, jacobian = identified_actuators(), identified_jacobian(truth)
    wrong = [perturbed(device, **ALL_AT_ONCE) for device in DEVICES]
    integrator = Controller.of(TransferFunction((BANDWIDTH / 0.1542,), (1.0, 0.0)), RATE)
    feedback = Decoupled(integrator, jnp.asarray(jacobian))

    def run(reference: np.ndarray, models: Any, matrix: Any, controller: Any = None) -> LoopResult:
        ahead = StageInverse.of(models, matrix, limits=LIMITS)
        noise = 0.0 if controller is None else NOISE
        arguments = {"controller": controller, "limits": LIMITS, "noise": noise, "finer": FINER}
        return run_loop(truth, reference, RATE, feedforward=ahead, **arguments)

    runs = {
        "designed Jacobian": run(poses, found, Kinematics().jacobian()),
        "identified": run(poses, found, jacobian),
        "identified, with feedback": run(poses, found, jacobian, feedback),
        "perturbed actuators": run(poses, wrong, jacobian),
        "perturbed actuators, with feedback": run(poses, wrong, jacobian, feedback),
    }
    size = np.ptp(poses[runs["identified"].t >= ALMOST], axis=0)
    percent = {name: 100 * r.max_error(ALMOST) / size for name, r in runs.items()}
    worst = {name: float(row.max()) for name, row in percent.items()}
    results.add("M9: circle with turn, worst axis %, identified", worst["identified"])
    results.add("M9: worst axis %, identified, with feedback", worst["identified, with feedback"])
    results.add("M9: worst axis %, perturbed actuators", worst["perturbed actuators"])
    gain = worst["perturbed actuators"] / worst["perturbed actuators, with feedback"]
    results.add("M9: perturbed actuators, without / with feedback", gain)
    results.add("M9: worst axis %, designed / identified Jacobian", worst["designed Jacobian"] / worst["identified"])
    t = runs["identified"].t
    line = middle(truth) + np.stack([20 * np.sin(2 * np.pi * 5 * t), 0 * t, 0 * t], axis=1)
    error = run(np.minimum(5 * t, 1.0)[:, None] * line, found, jacobian).max_error(ALMOST)
    results.add(
        "M9: cross-axis motion by an identified Jacobian, y and theta moved by x alone, %",
        100 * max(error[1], 40 * error[2]) / 40.0,
    )
    return table(
        ["run", "x, max error %", "y", "theta"], [[name, *row.tolist()] for name, row in percent.items()]
    ), runs


def adaptive_stage(results: Results) -> str:
    """The circle with wrong models of all actuators, fixed and corrected by a filter for each."""
    truth, rate = stage(), 1000.0
    t, poses = circle(truth, 8.0, 1.0, rate)
    poses *= (0.8 + 0.2 * np.cos(2 * np.pi * t / 3.7))[:, None]  # several amplitudes
    jacobian = identified_jacobian(truth)
    wrong = [perturbed(device, **FAR_OFF) for device in DEVICES]
    ahead = StageInverse.of(wrong, jacobian, limits=LIMITS)
    fixed = run_loop(truth, poses, rate, feedforward=ahead, limits=LIMITS, finer=FINER)
    filters = []
    for model, u in zip(wrong, fixed.u.T, strict=True):
        y = np.asarray(simulate(model, u, np.full(u.size, 1 / rate))[0])
        scales = Record(u=u, y=y, t=t)
        filters.append(Ukf.of(model, scales, start="model", noise=0.002, prior=0.2, caution=0.2, settling=300.0))
    sensors = [Sensor(noise, 0.0) for noise in NOISE]
    options = {"block": 500, "limits": LIMITS, "sensor": sensors, "seed": 0, "jacobian": jacobian}
    run = track_adaptively(filters, truth, poses, 1 / rate, **options)
    late = t >= 6.0
    size = np.ptp(poses[late], axis=0)
    before, after = (100 * np.abs(e[late]).max(axis=0) / size for e in (fixed.error, run.error))
    results.add("M9: worst axis % over the last 2 s, wrong models, fixed", before.max())
    results.add("M9: worst axis % over the last 2 s, a filter for each actuator", after.max())
    rows = [["wrong models, fixed", *before.tolist()], ["corrected every 0.5 s", *after.tolist()]]
    return table(["feed-forward", "x, max error %, last 2 of 8 s", "y", "theta"], rows)
