"""Measurement of one record for the data-quality report."""

from __future__ import annotations

import dataclasses
import functools
import math
import weakref
from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np

from hystfit.data.circulation import of_rate, trend
from hystfit.data.preparation import EVEN, CoarseClock
from hystfit.data.record import Record
from hystfit.quality import loops as geometry
from hystfit.quality.degradation import stiffness_left, strength_left, unloading_left
from hystfit.quality.delay import PureDelay, estimate_delay
from hystfit.quality.drift import drift
from hystfit.quality.faults import (
    bridged,
    chatter,
    clipped_samples,
    holds,
    noise_rms,
    resolution,
    saturated_samples,
    smoothing_length,
    spikes,
)
from hystfit.quality.flat_ends import flat_ends
from hystfit.quality.lag import estimate_lag
from hystfit.quality.load_control import controls_output
from hystfit.quality.record_quality import (
    SOFTER,
    WEAKER,
    WHOLE,
    Column,
    Motion,
    RecordQuality,
    Sampling,
)
from hystfit.quality.resonance import Dynamics, delayed, estimate_dynamics
from hystfit.quality.shape import loop_shape, rate_effect
from hystfit.quality.slow_lag import SHORT, estimate_slow_lag, likeliest_lag
from hystfit.quality.softening import softening_left

_VARIED = 0.1  # decimal logarithm of the ratio of two branches' speeds, above which the speed is no function of the place alone
_WAY = 0.2  # of the input's range: shortest branch whose speed counts
_MOST_OUTLIERS = 0.02  # part of the samples up to which isolated outliers are faults

_Measured = TypeVar("_Measured")


def _once(measure: Callable[[Record], _Measured]) -> Callable[[Record], _Measured]:
    """Measure a record only once: a search needs the same records for every model, and a measurement takes 0.2 s."""
    known: weakref.WeakKeyDictionary[Record, _Measured] = weakref.WeakKeyDictionary()

    @functools.wraps(measure)
    def remembered(record: Record) -> _Measured:
        if record not in known:
            known[record] = measure(record)
        return known[record]

    return remembered


@_once
def summarize(record: Record) -> RecordQuality:
    """Measure one record; time stamps that repeat are no time."""
    if record.t is not None and CoarseClock.of(record.t):
        record = record.replace(t=None)
    delay = delay_of(record)
    if delay is not None:
        record = record.replace(u=delayed(record.u[:, None], delay.samples)[:, 0])
    return dataclasses.replace(_summarize(record), delay=delay)


@_once
def may_change(record: Record) -> bool:
    """Whether the device may degrade: a first look, in a fraction of the time of `summarize`."""
    limits = {"stiffness_left": WHOLE, "strength_left": WEAKER, "unloading_left": SOFTER, "softening_left": WEAKER}
    return any(left is not None and left < limits[name] for name, left in losses(record).items())


def losses(record: Record) -> dict[str, float | None]:
    """What later cycles have left of the device, by the fields of `RecordQuality`."""
    u, sound, t = record.u, _without_spikes(record), record.t
    threshold = _threshold(_column(u))
    cycles = geometry.cycles(u, threshold)
    return {
        "stiffness_left": stiffness_left(u, sound, t, cycles, threshold),
        "strength_left": strength_left(u, sound, cycles),
        "unloading_left": unloading_left(u, sound, cycles, threshold),
        "softening_left": softening_left(u, sound, geometry.reversals(u, threshold)),
    }


@_once
def delay_of(record: Record) -> PureDelay | None:
    """Pure delay of the output; None without one or without even time steps."""
    interval = _even_interval(record)
    if interval is None:
        return None
    turns = geometry.reversals(record.u, _threshold(_column(record.u)))
    return estimate_delay(record.u, np.where(record.used, record.y, np.nan), interval, turns)


@_once
def dynamics_of(record: Record) -> Dynamics | None:
    """Frequency response and resonance; None where they cannot be estimated or without even time steps."""
    interval = _even_interval(record)
    return None if interval is None else estimate_dynamics(record.u, np.where(record.used, record.y, np.nan), interval)


@_once
def slow_lag_of(record: Record) -> float | None:
    """Lag of the output in samples where it is longer than the turns of the loops show; None without one."""
    return _of_turns(estimate_slow_lag, record)


@_once
def likeliest_lag_of(record: Record) -> float | None:
    """A starting value of a lag [samples], see `likeliest_lag`; None without one or without even time steps."""
    return _of_turns(likeliest_lag, record.replace(y=np.where(record.used, record.y, np.nan)))


def _of_turns(estimate: Callable[[np.ndarray, np.ndarray, np.ndarray], float | None], record: Record) -> float | None:
    """An estimate from input, output and the turns of the input; None without even time steps."""
    if _even_interval(record) is None or not np.ptp(record.u) > 0:
        return None
    return estimate(record.u, record.y, geometry.reversals(record.u, _threshold(_column(record.u))))


def _even_interval(record: Record) -> float | None:
    """Time between samples; None without time or where it is uneven."""
    interval = record.sampling_interval
    if interval is None or record.t is None or np.max(np.abs(np.diff(record.t) - interval)) > EVEN * interval:
        return None
    return interval


@_once
def outliers_of(record: Record) -> np.ndarray:
    """Sample numbers of isolated outliers of the output; none where there are so many that they belong to its noise."""
    noise, _ = noise_rms(record.y)
    if not noise:
        return np.empty(0, dtype=int)
    found = spikes(record.y, noise, record.u)
    return found if found.size <= _MOST_OUTLIERS * len(record) else found[:0]


def without_outliers(record: Record) -> Record:
    """The record with isolated outliers of the output left out, as a fit leaves them out."""
    found = outliers_of(record)
    weight = record.weight.copy()
    weight[found] = 0.0
    return record.replace(weight=weight) if found.size else record


def _without_spikes(record: Record) -> np.ndarray:
    """The output with straight lines in place of isolated outliers, which are no strength that later cycles have lost."""
    found, y = outliers_of(record), record.y.copy()
    known = np.setdiff1d(np.flatnonzero(np.isfinite(y)), found)
    y[found] = np.interp(found, known, y[known])
    return y


def _summarize(record: Record) -> RecordQuality:
    u, y, t = record.u, record.y, record.t
    sound = _without_spikes(record)
    u_column, y_column = _column(u), _column(y)
    motion, turns, cycles, loops = _motion(record, u_column)
    moving = np.ptp(u) > 0
    sampling, interval = _sampling(record), record.sampling_interval
    lag = dynamics = slow_lag = None
    shape = loop_shape(u, bridged(sound), loops, cycles, y_column.known_noise or 0.0)
    if moving and t is not None and interval and sampling.uniform and sampling.repeated_stamps == 0:
        seen = np.where(saturated_samples(u, y), np.nan, y)  # a sensor at its limit does not show when the output turns
        lag = estimate_lag(u, seen, interval, turns, u_noise=u_column.known_noise)
        dynamics = estimate_dynamics(u, y, interval)
        resonates = dynamics is not None and dynamics.resonant
        short = lag is not None and lag.samples + 2 * lag.stderr < SHORT
        if not (short or resonates) and shape is not None and not shape.crossing:
            slow_lag = estimate_slow_lag(u, y, turns)
    drifts = drift(u, y, t, cycles, y_column.known_noise or 0.0) if moving else None
    return RecordQuality(
        name=record.name,
        units={"u": record.u_unit, "y": record.y_unit, "t": record.t_unit},
        sampling=sampling,
        u=u_column,
        y=y_column,
        motion=motion,
        area=geometry.loop_area(u[record.used], y[record.used]) if record.used.any() else 0.0,
        correlation=trend(u[record.used], y[record.used]),
        of_rate=of_rate(u, y),
        flat_ends=int(flat_ends(u, y, y_column.known_noise).sum()),
        shape=shape,
        drift=drifts,
        lag=lag,
        rate_effect=rate_effect(u, y, t, cycles),
        dynamics=dynamics,
        clipped=int(clipped_samples(u, y).sum()),
        spikes=int(outliers_of(record).size),
        slow_lag=slow_lag,
        output_controlled=controls_output(u, y, turns),
        **losses(record),
    )


def decades_of(values: np.ndarray) -> float:
    """Decades over which the upper three quarters of the sizes of values extend; 0 of those of both signs."""
    known = values[np.isfinite(values)]
    if not known.size or known.min() * known.max() <= 0:
        return 0.0
    sizes = np.abs(known)
    return float(np.log10(sizes.max() / np.quantile(sizes, 0.25)))


def _column(values: np.ndarray) -> Column:
    noise, bound = noise_rms(values)
    low, high = float(np.nanmin(values)) + 0.0, float(np.nanmax(values)) + 0.0
    return Column(low, high, resolution(values), noise, bound, decades_of(values))


def _sampling(record: Record) -> Sampling:
    counts = len(record), int(np.isnan(record.y).sum()), int((record.weight == 0).sum())
    if record.t is None:
        return Sampling(*counts, None, None, None, 0, 0)
    steps, interval = np.diff(record.t), record.sampling_interval
    repeated, duration = int((steps == 0).sum()), float(record.t[-1] - record.t[0])
    if interval is None:
        return Sampling(*counts, duration, None, None, repeated, 0)
    uniform = bool(np.max(np.abs(steps - interval)) <= EVEN * interval)
    return Sampling(*counts, duration, 1 / interval, uniform, repeated, int((steps > 1.5 * interval).sum()))


def _threshold(column: Column) -> float:
    """Change of u by which a turning point must stand out: above the noise, as far as sparse samples show it."""
    most = (0.03 if column.noise_is_bound else 0.1) * column.range
    return max(0.005 * column.range, min(_noisy(column), most))


def _noisy(column: Column) -> float:
    """Change of a column that noise and rounding alone make."""
    return max(6 * (column.noise_rms or 0.0), 1.5 * (column.resolution or 0.0))


def _motion(record: Record, column: Column) -> tuple[Motion, np.ndarray, np.ndarray, list[geometry.Loop]]:
    u, y = record.u, record.y
    threshold = _threshold(column)
    turns = geometry.reversals(u, threshold)
    loops, cycles = geometry.closed_loops(u, threshold), geometry.cycles(u, threshold)
    span = column.range or 1.0
    largest = max((loop.stroke for loop in loops), default=0.0)
    major = sum(loop.stroke >= (1 - geometry.APART) * largest for loop in loops)
    branches = geometry.branches(u, threshold)
    levels = u[turns]
    pairs = {
        tuple(sorted(pair))
        for pair in np.round(np.stack([levels[:-1], levels[1:]], 1) / span / geometry.APART).tolist()
    }
    rests = [(int(a), int(b)) for a, b in holds(u, 2e-4 * span + 10 * (column.known_noise or 0.0))]
    creep = [_change(y[a:b]) for a, b in rests]
    extent = float(np.nanmax(y) - np.nanmin(y))
    motion = Motion(
        threshold=float(threshold),
        reversals=int(turns.size),
        chatter_percent=chatter(u, branches, _noisy(column)),
        smoothing=smoothing_length(u, branches, _noisy(column)),
        closed_loops=len(loops),
        major=int(major),
        minor=len(loops) - int(major),
        nested=sum(loop.depth > 0 for loop in loops),
        cycles=len(cycles),
        strokes=geometry.distinct(geometry.strokes(u, threshold) / span),
        turning_pairs=len(pairs),
        monotonic=turns.size == 0,
        holds=len(rests),
        longest_hold=max((b - a for a, b in rests), default=0),
        hold_creep=max(creep) / extent if creep and extent > 0 else None,
        speeds=_speeds(record, branches),
    )
    return motion, turns, cycles, loops


def speeds_of(record: Record) -> tuple[float, ...]:
    """Different speeds of the branches, see `Motion`, longer than a part of the input's range."""
    return _speeds(record, geometry.branches(record.u, _threshold(_column(record.u))))


def speeds_within(records: Iterable[Record]) -> int:
    """Number of different speeds along the branches; one where all branches have one speed, which is a function of the place then."""
    whole, parts = list[np.ndarray](), list[np.ndarray]()
    for record in records:
        if record.t is not None:
            ends = record.t[geometry.branches(record.u, _threshold(_column(record.u)))]
            whole.append(_log_speeds(record, ends.T))
            tenths = np.linspace(ends[:, 0], ends[:, 1], 11)  # of branches, whose speeds differ along a sinusoid
            parts.append(_log_speeds(record, tenths))
    if not whole:
        return 0
    varied = len(geometry.distinct(np.concatenate(whole), _VARIED)) > 1
    return len(geometry.distinct(np.concatenate(parts), geometry.SPEEDS_APART)) if varied else 1


def _log_speeds(record: Record, times: np.ndarray) -> np.ndarray:
    """Decimal logarithms of the speeds between successive times, shape (n, branches), without those at rest."""
    way, time = np.abs(np.diff(np.interp(times, record.t, record.u), axis=0)), np.diff(times, axis=0)
    moved = (way > 0) & (time > 0)
    return np.log10(way[moved] / time[moved])


def _speeds(record: Record, branches: np.ndarray) -> tuple[float, ...]:
    """Different speeds of the branches, see `Motion`; none without time."""
    if record.t is None:
        return ()
    long = np.abs(np.diff(record.u[branches]).ravel()) > _WAY * np.ptp(record.u)
    return geometry.distinct(_log_speeds(record, record.t[branches[long]].T), geometry.SPEEDS_APART)


def paces(records: Iterable[Record]) -> int:
    """Number of durations of branches that differ as speeds do: at one, the speed is a function of the amplitude and the place."""
    durations = [
        np.log10(record.t[at[1:]] - record.t[at[:-1]])
        for record in records
        if record.t is not None and np.diff(record.t).min() > 0 and (at := geometry.clear_reversals(record.u)).size > 1
    ]
    return len(geometry.distinct(np.concatenate(durations), geometry.SPEEDS_APART)) if durations else 0


def _change(y: np.ndarray) -> float:
    """Size of the change over a hold: mean of its last fifth minus mean of its first twentieth."""
    part = max(1, y.size // 20)
    with np.errstate(invalid="ignore"):
        change = abs(float(np.mean(y[-4 * part :]) - np.mean(y[:part])))
    return change if math.isfinite(change) else 0.0
