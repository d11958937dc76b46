"""The simulated actuator of one axis, its perturbed model, and a plant with ten integration steps per controller sample."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np

from hystfit import Record, SecondOrder, Series, simulate
from hystfit.control import invert
from hystfit.models.base import AbstractHysteresis
from hystfit.stage import Actuator, Sensor, axis_plant, perturbed, piezo, upsample

LIMITS = (-20.0, 120.0)
FINER = 10
ALL_AT_ONCE = {"c": 1.005, "mu": 0.99, "tau": 1.03, "delta": 0.97, "gamma": 1.10}
FAR_OFF = {"c": 1.05, "mu": 0.9, "tau": 1.2, "delta": 0.85, "gamma": 1.1}
FAR = {"c": 1.2, "mu": 0.7, "tau": 1.5, "delta": 0.6}


def modulated(duration: float = 20.0, rate: float = 500.0) -> tuple[np.ndarray, np.ndarray]:
    """-20..100 V at 1 Hz with slowly changing amplitude, from 0 V."""
    t = np.arange(round(duration * rate)) / rate
    u = 40 + 60 * (0.55 + 0.45 * np.cos(2 * np.pi * t / 6.7)) * np.sin(2 * np.pi * t)
    return t, np.minimum(u, 160 * t)


def bare() -> AbstractHysteresis:
    """The hysteresis of the actuator alone."""
    return piezo().parts[0]


def hysteresis_record(seed: int, noise: float = 0.005, signal=modulated) -> Record:
    """A record of the hysteresis alone."""
    return Actuator(model=bare(), sensor=Sensor(noise, 0.001)).record(*signal(), seed=seed)


def off(model: AbstractHysteresis, factors: dict[str, float]) -> AbstractHysteresis:
    """The model with its parameters multiplied by factors."""
    return perturbed(Series(model, *piezo().parts[1:]), **factors).parts[0]


@dataclasses.dataclass(frozen=True)
class Tracking:
    """A tracking run.

    Attributes:
        t, reference, u, y: time, reference, voltage and output, shape (T,).
        cycle: samples of one cycle; errors are those of the last two cycles, or of all samples where it is None.
    """

    t: np.ndarray
    reference: np.ndarray
    u: np.ndarray
    y: np.ndarray
    cycle: int | None

    @property
    def percent(self) -> np.ndarray:
        """Error in percent of the range of the reference, in the last two cycles."""
        last = slice(None) if self.cycle is None else slice(-2 * self.cycle, None)
        return 100 * (self.reference - self.y)[last] / np.ptp(self.reference)

    @property
    def worst(self) -> float:
        """Largest error in percent."""
        return float(np.max(np.abs(self.percent)))


def drive(plant: Series, reference: np.ndarray, u: np.ndarray, dt: float, cycle: int | None) -> Tracking:
    """Simulate the plant with `FINER` steps per controller sample, the voltage linear between samples.

    Args:
        plant: voltage to displacement.
        reference, u: reference and voltage, shape (T,).
        dt: sampling interval of the controller [s].
        cycle: see `Tracking`.
    """
    steps = np.full(reference.size, dt)
    fine, fine_steps = upsample(u, steps, FINER)
    fine_steps[0] = 0.0
    y, _ = simulate(plant, jnp.asarray(fine), jnp.asarray(fine_steps))
    return Tracking(dt * np.arange(reference.size), reference, u, np.asarray(y)[::FINER], cycle)


def track(plant: Series, model: Series, reference: np.ndarray, dt: float, cycle: int | None = None) -> Tracking:
    """Feed-forward: the inverse of a model drives the plant. Args as `drive`; `model` is inverted."""
    u = invert(model, reference, dt, limits=LIMITS).u
    return drive(plant, reference, u, dt, cycle)


def rate(frequency: float) -> float:
    """Sampling rate of the controller [Hz]: a thousand samples per cycle, between 1 and 10 kHz."""
    return float(np.clip(1000 * frequency, 1000, 10_000))


def cosine(frequency: float, stroke: float, cycles: int = 5) -> tuple[np.ndarray, float, int]:
    """A cosine from 0 to `stroke`, from rest at 0.

    Args:
        frequency: in Hz.
        stroke: in um.
        cycles: their number.

    Returns:
        Reference [um], sampling interval [s], samples of one cycle.
    """
    dt = 1 / rate(frequency)
    cycle = round(1 / (frequency * dt))
    t = dt * np.arange(cycles * cycle)
    return 0.5 * stroke * (1 - np.cos(2 * np.pi * frequency * t)), dt, cycle


def with_mode(model: Series) -> Series:
    """The axis with its resonance."""
    return Series(*model.parts, SecondOrder(omega=2 * np.pi * 630.0, zeta=0.02))


def axis() -> Series:
    """The axis without its resonance."""
    return axis_plant(mode=None)


def on_axis(actuator: Series) -> Series:
    """An identified actuator behind the lever of the axis, without resonance."""
    return axis_plant(actuator, mode=None)
