"""Excitations that reveal hysteresis: plain numpy functions of time, and the registry that the command line reads.

Every function takes its limits `low` and `high` in the input's unit, `rate` in samples/s and times in seconds, and
returns `(t, u)`, both of shape (T,); `forc_protocol` has no time and returns `(u, curve)`.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hystfit.errors import DataError

Series = tuple[np.ndarray, np.ndarray]
Real = float | int


def _positive(**values: Real) -> None:
    for name, value in values.items():
        if not np.isfinite(value) or value <= 0:
            raise DataError(f"{name} must be a positive number, got {value}")


def _limits(low: Real, high: Real) -> None:
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise DataError(f"low must be less than high, got low {low} and high {high}")


def _count(name: str, value: Real, least: int) -> int:
    if int(value) != value or value < least:
        raise DataError(f"{name} must be a whole number of at least {least}, got {value}")
    return int(value)


def _times(duration: Real, rate: Real) -> np.ndarray:
    _positive(duration=duration, rate=rate)
    count = round(duration * rate)
    if count < 2:
        raise DataError(f"{duration} s at {rate} samples/s makes {count} sample(s); a signal needs at least 2")
    return np.arange(count) / rate


def _below_nyquist(frequency: Real, rate: Real) -> None:
    if frequency > rate / 2:
        raise DataError(f"frequency {frequency} Hz is above half the rate of {rate} samples/s: raise the rate")


def _between(low: Real, high: Real, wave: np.ndarray) -> np.ndarray:
    """Map a wave in [-1, 1] onto [low, high]."""
    return 0.5 * (low + high) + 0.5 * (high - low) * wave


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

    `frequency` in Hz, `phase` in radians (0 starts at the middle and rises, -pi/2 starts at low).

    Raises:
        DataError: a number is out of its range.
    """
    t = _times(duration, rate)
    _positive(frequency=frequency)
    _below_nyquist(frequency, rate)
    _limits(low, high)
    return t, _between(low, high, np.sin(2 * np.pi * frequency * t + phase))


def triangle(
    duration: Real = 5.0,
    rate: Real = 200.0,
    *,
    frequency: Real = 1.0,
    low: Real = -1.0,
    high: Real = 1.0,
) -> Series:
    """Triangle from low to high and back: constant speed between sharp reversals; `frequency` in Hz."""
    t = _times(duration, rate)
    _positive(frequency=frequency)
    _below_nyquist(frequency, rate)
    _limits(low, high)
    cycle = np.mod(frequency * t, 1.0)
    return t, low + (high - low) * (1 - np.abs(1 - 2 * cycle))


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

    `frequency` in Hz, `decay` in 1/s.
    """
    t, u = sine(duration, rate, frequency=frequency, low=low, high=high)
    _positive(decay=decay)
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
    tries: int = 32,
    seed: int = 0,
) -> Series:
    """Sum of equal sines, scaled to reach at most low and high about their middle.

    `frequencies` in Hz. Of `tries` draws of the phases (by `seed`) the one with the lowest crest factor is kept, so
    that most of the range is used most of the time.
    """
    t = _times(duration, rate)
    _limits(low, high)
    lines = np.atleast_1d(np.asarray(frequencies, dtype=float))
    if lines.size == 0:
        raise DataError("frequencies is empty: give at least one in Hz")
    for line in lines:
        _positive(frequency=float(line))
        _below_nyquist(float(line), rate)
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, size=(_count("tries", tries, 1), lines.size))
    waves = [np.sin(2 * np.pi * t[:, None] * lines + phase).sum(axis=1) for phase in phases]
    best = min(waves, key=crest_factor)
    return t, _between(low, high, best / np.max(np.abs(best)))


def amplitude_sweep(
    rate: Real = 200.0,
    *,
    frequency: Real = 1.0,
    low: Real = -1.0,
    high: Real = 1.0,
    cycles: int = 10,
    start: Real = 1.0,
    stop: Real = 0.1,
    anchor: str = "center",
) -> Series:
    """Whole cycles whose amplitude goes from `start` to `stop` (fractions of the range): nested minor loops.

    A decaying sweep (start > stop) leaves every minor loop inside the last; a growing one wipes them out in turn.
    `frequency` in Hz; the first and the last amplitude are exact. `anchor` says what all loops share: "center" (the
    middle of the range), "low" or "high" (that turning point).
    """
    _positive(rate=rate, frequency=frequency, start=start, stop=stop)
    _below_nyquist(frequency, rate)
    _limits(low, high)
    if max(start, stop) > 1:
        raise DataError(f"start and stop are fractions of the range, at most 1; got {start} and {stop}")
    amplitude = np.linspace(start, stop, _count("cycles", cycles, 1))
    t = _times(cycles / frequency, rate)
    cycle = frequency * t
    scale = amplitude[np.minimum(cycle.astype(int), cycles - 1)]
    if anchor == "center":
        return t, _between(low, high, scale * np.sin(2 * np.pi * cycle))
    if anchor == "low":
        return t, low + (high - low) * scale * 0.5 * (1 - np.cos(2 * np.pi * cycle))
    if anchor == "high":
        return t, high - (high - low) * scale * 0.5 * (1 - np.cos(2 * np.pi * cycle))
    raise DataError(f"anchor must be 'center', 'low' or 'high', got {anchor!r}")


def staircase(
    rate: Real = 100.0,
    *,
    levels: int = 6,
    hold: Real = 2.0,
    ramp: Real = 0.1,
    low: Real = -1.0,
    high: Real = 1.0,
) -> Series:
    """Steps up from low to high and down again, resting `hold` seconds on each of `levels` levels.

    Neighboring levels are joined by a straight ramp of `ramp` seconds (0: a jump). The holds show creep.
    """
    _positive(rate=rate, hold=hold)
    _limits(low, high)
    if ramp < 0:
        raise DataError(f"ramp must not be negative, got {ramp} s")
    up = np.linspace(low, high, _count("levels", levels, 2))
    values = np.concatenate([up, up[-2::-1]])
    starts = np.arange(values.size) * (hold + ramp)
    t = _times(starts[-1] + hold, rate)
    if ramp == 0:
        return t, values[np.clip(np.searchsorted(starts, t + 1e-9 / rate, side="right") - 1, 0, None)]
    knots = np.stack([starts, starts + hold], axis=1).ravel()
    return t, np.interp(t, knots, np.repeat(values, 2))


def step(
    duration: Real = 10.0,
    rate: Real = 200.0,
    *,
    at: Real = 1.0,
    low: Real = 0.0,
    high: Real = 1.0,
) -> Series:
    """A jump from low to high at the time `at` [s]: what follows at constant input is creep and dynamics."""
    t = _times(duration, rate)
    _limits(low, high)
    if not 0 < at < duration:
        raise DataError(f"the step must fall inside the record: at {at} s of {duration} s")
    return t, np.where(t < at - 1e-9 / rate, low, high)


def forc_protocol(*, curves: int = 20, points: int = 100, low: Real = -1.0, high: Real = 1.0) -> Series:
    """First-order reversal curves: saturate at high, go down to a reversal level, return to high; next level.

    Args:
        curves: number of reversal levels, evenly spaced from just under high down to low.
        points: samples over the whole range; every branch is sampled at about that spacing.

    Returns:
        u of shape (T,) and curve of shape (T,), int: k = 1..curves on the k-th returning branch (its reversal point
        included), 0 on the way down to it.
    """
    _limits(low, high)
    curves, points = _count("curves", curves, 1), _count("points", points, 2)
    spacing = (high - low) / points
    u, curve = [np.array([high])], [np.array([0])]
    for number, level in enumerate(np.linspace(high, low, curves + 1)[1:], start=1):
        count = max(1, round((high - level) / spacing))
        down = np.linspace(high, level, count + 1)[1:]
        u += [down, np.append(down[-2::-1], high)]
        curve += [
            np.append(np.zeros(count - 1, dtype=int), number),
            np.full(count, number),
        ]
    return np.concatenate(u), np.concatenate(curve)


def random_reversals(
    duration: Real = 20.0,
    rate: Real = 200.0,
    *,
    speed: Real = 2.0,
    low: Real = -1.0,
    high: Real = 1.0,
    start: Real | None = None,
    seed: int = 0,
) -> Series:
    """Constant speed [input unit/s] between random turning points: uniform on the range, alternately up and down.

    It reaches many pairs of turning levels, which a Preisach density needs. `start` is the first value (low if None).
    """
    t = _times(duration, rate)
    _positive(speed=speed)
    _limits(low, high)
    first = low if start is None else start
    if not low <= first <= high:
        raise DataError(f"start must lie between low and high, got {first}")
    rng = np.random.default_rng(seed)
    values, times, rising = [first], [0.0], first < high
    while times[-1] < t[-1]:
        end = high if rising else low
        # a turning point that is at least a sixth of the way keeps the branches long enough to be seen
        target = values[-1] + (end - values[-1]) * rng.uniform(1 / 6, 1)
        times.append(times[-1] + max(abs(target - values[-1]), 1e-9 * (high - low)) / speed)
        values.append(target)
        rising = not rising
    return t, np.interp(t, times, values)


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
    """Sine whose frequency runs from `start` to `stop` [Hz], geometrically ("log") or evenly ("linear") in time.

    It shows rate dependence: the same loop at many speeds.
    """
    t = _times(duration, rate)
    _positive(start=start, stop=stop)
    _below_nyquist(max(start, stop), rate)
    _limits(low, high)
    if spacing not in ("log", "linear"):
        raise DataError(f"spacing must be 'log' or 'linear', got {spacing!r}")
    if spacing == "linear" or start == stop:
        turns = start * t + 0.5 * (stop - start) / duration * t**2
    else:
        growth = np.log(stop / start) / duration
        turns = start * np.expm1(growth * t) / growth
    return t, _between(low, high, np.sin(2 * np.pi * turns))


@dataclasses.dataclass(frozen=True)
class Signal:
    """One excitation as the command line offers it.

    Attributes:
        name: what it is called there.
        make: the function.
        doc: the first line of its description.
        parameters: default value of every parameter, by name.
        timed: True where it returns (t, u), False where it returns (u, curve).
    """

    name: str
    make: Callable[..., Series]
    doc: str
    parameters: Mapping[str, Any]
    timed: bool = True


def _register(*functions: Callable[..., Series]) -> dict[str, Signal]:
    table = {}
    for function in functions:
        name = function.__name__.replace("_", "-")
        parameters = {key: item.default for key, item in inspect.signature(function).parameters.items()}
        doc = (inspect.getdoc(function) or "").splitlines()[0]
        table[name] = Signal(name, function, doc, parameters, timed=function is not forc_protocol)
    return table


SIGNALS: Mapping[str, Signal] = _register(
    sine,
    triangle,
    decaying_sine,
    multisine,
    amplitude_sweep,
    staircase,
    step,
    forc_protocol,
    random_reversals,
    chirp,
)


def signal(name: str) -> Signal:
    """The excitation of this name (dashes and underscores are the same).

    Raises:
        DataError: there is none; the message lists the names.
    """
    found = SIGNALS.get(name.replace("_", "-"))
    if found is None:
        raise DataError(f"no signal {name!r}; there are {', '.join(SIGNALS)}")
    return found


def make(name: str, **parameters: Any) -> Series:
    """Make an excitation by name: `make("sine", frequency=2.0)`.

    Raises:
        DataError: unknown name or parameter (the message lists them), or a value out of range.
    """
    entry = signal(name)
    unknown = sorted(set(parameters) - set(entry.parameters))
    if unknown:
        raise DataError(f"signal {entry.name!r} has no parameter {unknown}; it takes {', '.join(entry.parameters)}")
    return entry.make(**parameters)
