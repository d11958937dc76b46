"""Shared by all signals: their time axis, the map onto their limits, and checks of arguments."""

from __future__ import annotations

import numpy as np

from hystfit.errors import DataError

Series = tuple[np.ndarray, np.ndarray]
Real = float | int
_MOST = 10**8  # samples; a larger number is probably a typing error in the rate or the duration


def positive(**values: Real) -> None:
    """Refuse, by their names, numbers that are not finite and above zero."""
    for name, value in values.items():
        if not np.isfinite(value) or value <= 0:
            raise DataError(f"{name} must be a positive number, got {value}")


def limits(low: Real, high: Real) -> None:
    """Refuse limits that are not finite or not in order."""
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise DataError(f"low must be less than high, got low {low} and high {high}")


def whole_number(name: str, value: Real, least: int) -> int:
    """A whole number of at least `least` as int; others are refused by the name of the argument."""
    if not np.isfinite(value) or int(value) != value or value < least:
        raise DataError(f"{name} must be a whole number of at least {least}, got {value}")
    return int(value)


def time_axis(duration: Real, rate: Real, *frequencies: Real) -> np.ndarray:
    """Times from 0 at `rate` samples/s, the end left out, shape (T,), for a signal of these frequencies [Hz]; refuses what cannot be."""
    positive(duration=duration, rate=rate)
    if duration * rate > _MOST:
        raise DataError(f"{duration} s at {rate} samples/s makes {duration * rate:.3g} samples: at most {_MOST:.0e}")
    samples = round(duration * rate)
    if samples < 2:
        raise DataError(f"{duration} s at {rate} samples/s makes {samples} sample(s); a signal needs at least 2")
    for frequency in frequencies:
        positive(frequency=frequency)
        if frequency > rate / 2:
            raise DataError(f"frequency {frequency} Hz is above half the rate of {rate} samples/s: raise the rate")
    return np.arange(samples) / rate


def between(low: Real, high: Real, wave: np.ndarray) -> np.ndarray:
    """A wave in [-1, 1], shape (T,), on the range from low to high, which `limits` checks."""
    limits(low, high)
    return 0.5 * (low + high) + 0.5 * (high - low) * wave
