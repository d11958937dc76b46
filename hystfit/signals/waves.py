"""Signals that repeat or sweep in frequency: sine, triangle, decaying sine, multisine, chirp."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystfit.errors import DataError
from hystfit.signals.checks import Real, Series, between, limits, positive, time_axis, whole_number


def sine(
    duration: Real = 5.0,
    rate: Real = 200.0,
    *,
    frequency: Real = 1.0,
    low: Real = -1.0,
    high: Real = 1.0,
    phase: Real = 0.0,
) -> Series:
    """Sine between low and high: one loop, repeated.

    Args:
        duration: length of the signal [s].
        rate: samples/s.
        frequency: Hz.
        low, high: limits [unit of u].
        phase: radians; 0 starts at the middle and rises, -pi/2 starts at low.

    Raises:
        DataError: a number is out of its range.
    """
    t = time_axis(duration, rate, frequency)
    if not np.isfinite(phase):
        raise DataError(f"phase must be finite, got {phase}")
    return t, between(low, high, np.sin(2 * np.pi * frequency * t + phase))


def triangle(
    duration: Real = 5.0, rate: Real = 200.0, *, frequency: Real = 1.0, low: Real = -1.0, high: Real = 1.0
) -> Series:
    """Triangle from low to high and back: constant speed between sharp reversals.

    Args:
        duration: length of the signal [s].
        rate: samples/s.
        frequency: Hz.
        low, high: limits [unit of u].
    """
    t = time_axis(duration, rate, frequency)
    limits(low, high)
    return t, low + (high - low) * (1 - np.abs(1 - 2 * np.mod(frequency * t, 1.0)))


def decaying_sine(
    duration: Real = 10.0,
    rate: Real = 200.0,
    *,
    frequency: Real = 1.0,
    low: Real = -1.0,
    high: Real = 1.0,
    decay: Real = 0.3,
) -> Series:
    """Sine about the middle whose amplitude falls as exp(-decay t): nested minor loops that end near the middle.

    Args:
        duration: length of the signal [s].
        rate: samples/s.
        frequency: Hz.
        low, high: limits [unit of u].
        decay: 1/s.
    """
    t, u = sine(duration, rate, frequency=frequency, low=low, high=high)
    positive(decay=decay)
    middle = 0.5 * (low + high)
    return t, middle + (u - middle) * np.exp(-decay * t)


def crest_factor(u: np.ndarray) -> float:
    """Largest excursion from the mean over the RMS about it, dimensionless (sqrt(2) for a sine)."""
    about = np.asarray(u, dtype=float) - np.mean(u)
    return float(np.max(np.abs(about)) / np.sqrt(np.mean(about**2)))


def multisine(
    duration: Real = 10.0,
    rate: Real = 200.0,
    *,
    frequencies: Sequence[Real] = (0.5, 1.0, 2.0, 5.0, 10.0),
    low: Real = -1.0,
    high: Real = 1.0,
    tries: Real = 32,
    seed: int = 0,
) -> Series:
    """Sum of equal sines, scaled to reach at most low and high about their middle.

    Args:
        duration: length of the signal [s].
        rate: samples/s.
        frequencies: Hz.
        low, high: limits [unit of u].
        tries: number of random draws of the phases, of which the one with the lowest crest factor is used.
        seed: of the draws.
    """
    try:
        lines = np.atleast_1d(np.asarray(frequencies, dtype=float))
    except (TypeError, ValueError) as error:
        raise DataError(f"frequencies must be numbers in Hz, got {frequencies!r}") from error
    if lines.size == 0:
        raise DataError("frequencies is empty: give at least one in Hz")
    t = time_axis(duration, rate, *lines.tolist())
    rng = np.random.default_rng(whole_number("seed", seed, 0))
    phases = rng.uniform(0, 2 * np.pi, size=(whole_number("tries", tries, 1), lines.size))
    waves = [np.sin(2 * np.pi * t[:, None] * lines + phase).sum(axis=1) for phase in phases]
    best = min(waves, key=crest_factor)
    return t, between(low, high, best / np.max(np.abs(best)))


def chirp(
    duration: Real = 10.0,
    rate: Real = 1000.0,
    *,
    start: Real = 0.5,
    stop: Real = 50.0,
    low: Real = -1.0,
    high: Real = 1.0,
    spacing: str = "log",
) -> Series:
    """Sine of increasing or decreasing frequency: the same loop at many speeds, for rate dependence.

    Args:
        duration: length of the signal [s].
        rate: samples/s.
        start, stop: first and last frequency [Hz].
        low, high: limits [unit of u].
        spacing: "log" for a geometric change of the frequency in time, or "linear".
    """
    t = time_axis(duration, rate, start, stop)
    if spacing not in ("log", "linear"):
        raise DataError(f"spacing must be 'log' or 'linear', got {spacing!r}")
    if spacing == "linear" or start == stop:
        turns = start * t + 0.5 * (stop - start) / duration * t**2
    else:
        growth = np.log(stop / start) / duration
        turns = start * np.expm1(growth * t) / growth
    return t, between(low, high, np.sin(2 * np.pi * turns))
