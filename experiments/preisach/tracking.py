"""The tracked trajectories: feed-forward by the inverse, feedback by PD with lag, and both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from plant import LIMITS, NOISE, actuator, legs

import hystfit as hf
from hystfit.control import Controller, Design, LoopResult, assess, design, identify_plant, run_loop, second_order
from hystfit.models import AbstractHysteresis

RATE = 10_000.0
SLOW = 500.0  # samples per second of the inverse, with linear voltage in between
FULL = 100.0  # um


def sweep() -> tuple[np.ndarray, np.ndarray, float]:
    """Input, output and time step of a sweep of 5 V about 100 V through the resonance, after the creep has settled."""
    rate = 5000.0
    rest = np.full(round(60 * rate), 100.0)
    _, u = hf.signals.chirp(duration=4.0, rate=rate, start=5.0, stop=150.0, low=95.0, high=105.0)
    y = np.array(hf.simulate(actuator(), np.concatenate([rest, u]), 1 / rate)[0])[rest.size :]
    return u, y + NOISE * np.random.default_rng(5).standard_normal(y.size), 1 / rate


def loop_design(gain: float) -> tuple[Design, object, object]:
    """The controller for the identified resonance and the secant gain, and both identifications."""
    u, y, dt = sweep()
    paper, ours = (identify_plant(u, y, dt, method=m) for m in ("total-least-squares", "output-error"))
    return design(omega=ours.omega, zeta=ours.zeta, gain=gain, rate=RATE), paper, ours


def robust_damping(made: Design, omega: float, gain: float) -> float:
    """Least damping for plants of damping ratio 0.005 to 0.05 and a natural frequency 10 % off."""
    cases = [(z, w) for z in (0.005, 0.02, 0.05) for w in (0.9, 1.0, 1.1)]
    return min(assess(made.controller, second_order(omega * w, z, gain)).damping for z, w in cases)


def reference(extrema: tuple[float, ...], frequency: float, rate: float = RATE) -> np.ndarray:
    """Half cosines through the extrema [um]; 100 um take half a period."""
    return legs(extrema, frequency, rate, full=FULL)[1]


def feedforward(
    model: AbstractHysteresis, extrema: tuple[float, ...], frequency: float
) -> tuple[np.ndarray, np.ndarray]:
    """The inverse of a model along a reference, at the loop's rate, and which samples are within reach."""
    slow = min(SLOW * max(frequency / 0.01, 1.0), RATE)
    coarse = reference(extrema, frequency, slow)
    found = hf.invert(model, coarse, 1 / slow)
    t = np.arange(reference(extrema, frequency).size) / RATE
    at = np.arange(coarse.size) / slow
    return np.interp(t, at, found.u), np.interp(t, at, found.codes) == 0


def track(
    extrema: tuple[float, ...],
    ahead: np.ndarray | None,
    made: Design | None,
    *,
    changed: Mapping[str, float] | None = None,
    frequency: float = 0.01,
    noise: float = NOISE,
) -> LoopResult:
    """One run on the whole plant.

    Args:
        extrema: of the reference [um].
        ahead: feed-forward voltage at the loop's rate; None for none.
        made: the feedback; None for none.
        changed: parameters of the plant that have changed since the identification.
        frequency: of the reference [Hz].
        noise: of the sensor [um].
    """
    controller = None if made is None else Controller.of(made.controller, RATE)
    return run_loop(
        actuator(**(changed or {})),
        reference(extrema, frequency),
        RATE,
        feedforward=ahead,
        controller=controller,
        limits=LIMITS,
        noise=noise,
        seed=7,
    )


def arms(
    extrema: tuple[float, ...],
    models: Mapping[str, AbstractHysteresis],
    secant: float,
    made: Design,
    changed: Mapping[str, float],
    names: Sequence[str],
    noise: float = NOISE,
) -> dict[str, LoopResult]:
    """Runs on one reference: FF and FF+FB by the inverse of each model, FB alone, and FB with the straight line r / secant.

    Args:
        extrema: of the reference [um].
        models: by the word in front of the arm, such as "table ".
        secant: gain of the straight line [um/V].
        made: the feedback.
        changed: see `track`.
        names: which of the arms to run.
        noise: of the sensor [um].
    """
    ahead = {f"{word}FF": feedforward(model, extrema, 0.01)[0] for word, model in models.items()}
    ahead["line"] = reference(extrema, 0.01) / secant
    out = {}
    for name in names:
        forward, _, back = name.partition("+")
        forward, back = (None, "FB") if name == "FB" else (ahead[forward], back)
        out[name] = track(extrema, forward, made if back else None, changed=changed, noise=noise)
    return out
