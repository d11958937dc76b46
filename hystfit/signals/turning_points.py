"""Signals made of turning points and holds: amplitude sweep, staircase, step, reversal curves, random reversals."""

from __future__ import annotations

import numpy as np

from hystfit.errors import DataError
from hystfit.signals.checks import Real, Series, between, limits, positive, time_axis, whole_number


def amplitude_sweep(
    rate: Real = 200.0,
    *,
    frequency: Real = 1.0,
    low: Real = -1.0,
    high: Real = 1.0,
    cycles: Real = 10,
    start: Real = 1.0,
    stop: Real = 0.1,
    anchor: str = "center",
) -> Series:
    """Whole cycles of decreasing or increasing amplitude: nested minor loops.

    A decaying sweep (start > stop) nests every minor loop in the one before; a growing one wipes them out in turn.

    Args:
        rate: samples/s.
        frequency: Hz.
        low, high: limits [unit of u].
        cycles: number of cycles.
        start, stop: first and last amplitude, as fractions of the range.
        anchor: common to all loops: "center" (the middle of the range), or the turning point "low" or "high".
    """
    positive(frequency=frequency, start=start, stop=stop)
    if max(start, stop) > 1:
        raise DataError(f"start and stop are fractions of the range, at most 1; got {start} and {stop}")
    cycles = whole_number("cycles", cycles, 1)
    amplitude = np.linspace(start, stop, cycles)
    t = time_axis(cycles / frequency, rate, frequency)
    cycle = frequency * t
    scale = amplitude[np.minimum(cycle.astype(int), cycles - 1)]
    from_the_end = scale * (1 - np.cos(2 * np.pi * cycle))
    waves = {"center": scale * np.sin(2 * np.pi * cycle), "low": from_the_end - 1, "high": 1 - from_the_end}
    if anchor not in waves:
        raise DataError(f"anchor must be 'center', 'low' or 'high', got {anchor!r}")
    return t, between(low, high, waves[anchor])


def staircase(
    rate: Real = 100.0, *, levels: Real = 6, hold: Real = 2.0, ramp: Real = 0.1, low: Real = -1.0, high: Real = 1.0
) -> Series:
    """Steps up from low to high and down again; creep shows during the holds.

    Args:
        rate: samples/s.
        levels: number of levels.
        hold: duration of each level [s].
        ramp: duration of the ramp between levels [s]; 0 for jumps.
        low, high: limits [unit of u].
    """
    positive(rate=rate, hold=hold)
    limits(low, high)
    if not 0 <= ramp < np.inf:
        raise DataError(f"ramp must be finite and not negative, got {ramp} s")
    up = np.linspace(low, high, whole_number("levels", levels, 2))
    values = np.concatenate([up, up[-2::-1]])
    starts = np.arange(values.size) * (hold + ramp)
    t = time_axis(starts[-1] + hold, rate)
    if ramp == 0:
        return t, values[np.clip(np.searchsorted(starts, t + 1e-9 / rate, side="right") - 1, 0, None)]
    knots = np.stack([starts, starts + hold], axis=1).ravel()
    return t, np.interp(t, knots, np.repeat(values, 2))


def step(duration: Real = 10.0, rate: Real = 200.0, *, at: Real = 1.0, low: Real = 0.0, high: Real = 1.0) -> Series:
    """A jump from low to high; the response at constant input is creep and dynamics.

    Args:
        duration: length of the signal [s].
        rate: samples/s.
        at: time of the jump [s].
        low, high: limits [unit of u].
    """
    t = time_axis(duration, rate)
    limits(low, high)
    if not 0 < at < duration:
        raise DataError(f"the step must fall inside the record: at {at} s of {duration} s")
    return t, np.where(t < at - 1e-9 / rate, low, high)


def forc_protocol(*, curves: Real = 20, points: Real = 100, low: Real = -1.0, high: Real = 1.0) -> Series:
    """First-order reversal curves: saturate at high, go down to a reversal level, return to high; next level.

    Args:
        curves: number of reversal levels, evenly spaced from just under high down to low.
        points: samples over the whole range; every branch has about that spacing.
        low, high: limits [unit of u].

    Returns:
        u of shape (T,) and curve of shape (T,), int: k = 1..curves on the k-th returning branch (its reversal point
        included), 0 on the way down to it.
    """
    limits(low, high)
    curves, points = whole_number("curves", curves, 1), whole_number("points", points, 2)
    spacing = (high - low) / points
    u, curve = [np.array([high])], [np.array([0])]
    for number, level in enumerate(np.linspace(high, low, curves + 1)[1:], start=1):
        count = max(1, round((high - level) / spacing))
        down = np.linspace(high, level, count + 1)[1:]
        u += [down, np.append(down[-2::-1], high)]
        curve += [np.append(np.zeros(count - 1, dtype=int), number), np.full(count, number)]
    return np.concatenate(u), np.concatenate(curve)


def random_reversals(
    duration: Real = 20.0,
    rate: Real = 200.0,
    *,
    speed: Real | None = None,
    low: Real = -1.0,
    high: Real = 1.0,
    start: Real | None = None,
    seed: int = 0,
) -> Series:
    """Constant speed [input unit/s] between random turning points: uniform on the range, alternately up and down.

    It has many pairs of turning levels, which a Preisach density needs.

    Args:
        duration: length of the signal [s].
        rate: samples/s.
        speed: of the input [unit of u per second]; None for the whole range in a second.
        low, high: limits [unit of u].
        start: first value; None for low.
        seed: of the turning points.
    """
    t = time_axis(duration, rate)
    limits(low, high)
    speed = high - low if speed is None else speed
    positive(speed=speed)
    first = low if start is None else start
    if not low <= first <= high:
        raise DataError(f"start must lie between low and high, got {first}")
    rng = np.random.default_rng(whole_number("seed", seed, 0))
    values, times, rising = [first], [0.0], first < high
    while times[-1] < t[-1]:
        end = high if rising else low
        # branches of a sixth of the way or more are long enough to show
        target = values[-1] + (end - values[-1]) * rng.uniform(1 / 6, 1)
        times.append(times[-1] + max(abs(target - values[-1]), 1e-9 * (high - low)) / speed)
        values.append(target)
        rising = not rising
    return t, np.interp(t, times, values)
