"""What is measured on one record for the data-quality report."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from hystfit.data.preparation import CoarseClock
from hystfit.data.record import Record
from hystfit.params.units import quantity
from hystfit.quality import loops as geometry
from hystfit.quality.chatter import chatter, smoothing_length
from hystfit.quality.delay import PureDelay, estimate_delay
from hystfit.quality.drift import Drift, drift
from hystfit.quality.faults import bridged, clipped_samples, holds, noise_rms, resolution, spikes
from hystfit.quality.lag import Lag, estimate_lag, velocity_gain
from hystfit.quality.resonance import Dynamics, delayed, estimate_dynamics
from hystfit.quality.shape import Shape, loop_shape, rate_effect, stiffness_left, strength_left, unloading_left
from hystfit.quality.slow_lag import SHORT, estimate_slow_lag
from hystfit.quality.softening import softening_left
from hystfit.quality.trend import linear_trend

LONG_HOLD = 50  # samples of a hold in which creep would show
_BESIDE_DELAY = 2.0  # samples: a shorter lag beside a delay is an error of the delay
_SOFTER = 0.7  # part of the first stiffness after a reversal below which the later one shows damage
_FEWEST_CYCLES = 3  # in which a trend of the output is sought
_MULLINS = (
    0.9  # part of the output on branches from the outermost level, below which larger strokes have softened the device
)
_WHOLE = 0.95  # part of the stiffness from which a device is whole
_WEAKER = 0.85  # part of the output of shorter branches, below which that of longer ones shows damage
_UNEVEN = 0.01  # largest deviation of even time steps from their interval, as a fraction of it
_MOST_OUTLIERS = 0.02  # part of the samples up to which isolated outliers are faults
_CHARGING = 0.6  # size of the mean product of signs from which a current follows the rate of the voltage
_FALLING = -0.5  # correlation of output and input below which the output falls as the input rises


@dataclasses.dataclass(frozen=True)
class Sampling:
    """Samples and time: `rate` [samples per unit of time], `uniform` (steps within 1 %), `gaps` (over 1.5 steps)."""

    n: int
    missing: int
    left_out: int
    duration: float | None
    rate: float | None
    uniform: bool | None
    repeated_stamps: int
    gaps: int

    @property
    def used(self) -> int:
        """Number of samples that count; at least that where missing samples are also left out."""
        return max(self.n - self.missing - self.left_out, 0)


@dataclasses.dataclass(frozen=True)
class Column:
    """Extent and noise of one column, in its unit; `noise_is_bound`: the noise is an upper bound only."""

    low: float
    high: float
    resolution: float | None
    noise_rms: float | None
    noise_is_bound: bool

    @property
    def range(self) -> float:
        """Largest minus smallest value."""
        return self.high - self.low

    @property
    def known_noise(self) -> float | None:
        """RMS noise where it is an estimate and not only a bound."""
        return None if self.noise_is_bound else self.noise_rms


@dataclasses.dataclass(frozen=True)
class Motion:
    """Motion of the input.

    Attributes:
        threshold: change of u by which a turning point must stand out [unit of u].
        reversals: number of turning points.
        chatter_percent: share of the samples at which the input steps back against its branch.
        smoothing: length of the smoothing filter that removes the chatter [samples]; None if none is needed or helps.
        closed_loops, major, minor, nested: loops that close; those within 5 % of the largest stroke; the others; those inside
            another.
        cycles: pairs of branches, closed or not.
        strokes: different strokes, largest first, as fractions of the input's range (5 % apart).
        turning_pairs: different (low, high) pairs of neighboring turning levels (5 % of the range apart).
        monotonic: the input never turns.
        holds, longest_hold, hold_creep: holds of the input, the longest [samples], and the largest change of the output during
            one as a fraction of its range.
    """

    threshold: float
    reversals: int
    chatter_percent: float
    smoothing: int | None
    closed_loops: int
    major: int
    minor: int
    nested: int
    cycles: int
    strokes: tuple[float, ...]
    turning_pairs: int
    monotonic: bool
    holds: int
    longest_hold: int
    hold_creep: float | None


@dataclasses.dataclass(frozen=True)
class RecordQuality:
    """Everything measured on one record; None where it is unknown.

    Attributes:
        trend: change of the output over the record apart from its loops, where neither a drift of like cycles nor a lag is found
            [unit of y].
        slow_lag: of the output, where it is longer than the turns of the loops show [samples].
        delay: of the output; all other properties are measured with the input delayed by it.
        area: signed, of the whole record, see `loops.loop_area`.
        correlation: of output and input; 0 where one of them is constant.
        sign_of_rate: mean product of the signs of the output and of the input's rate, over samples at which the input moves: near +-1
            for the current of a capacitor, which charges and discharges with the voltage.
    """

    name: str
    units: dict[str, str]
    sampling: Sampling
    u: Column
    y: Column
    motion: Motion
    shape: Shape | None
    area: float
    correlation: float
    drift: Drift | None
    lag: Lag | None
    velocity_gain: float | None
    rate_effect: float | None
    stiffness_left: float | None
    strength_left: float | None
    unloading_left: float | None
    softening_left: float | None
    dynamics: Dynamics | None
    clipped: int
    spikes: int
    trend: float | None = None
    slow_lag: float | None = None
    delay: PureDelay | None = None
    sign_of_rate: float = 0.0

    @property
    def charges(self) -> bool:
        """Whether the output is the current that charges a device: its integral, and not itself, is a function of the loop."""
        kinds = quantity(self.units["u"]), quantity(self.units["y"])
        driven = kinds[0] in ("voltage", "electric field") and kinds[1] in ("current", "current density")
        return driven and abs(self.sign_of_rate) > _CHARGING

    @property
    def dynamic(self) -> bool:
        """Whether the response changes with frequency as that of an oscillator does, beyond a lag or a velocity term."""
        return self.dynamics is not None and self.dynamics.resonant

    @property
    def falls(self) -> bool:
        """Whether the output falls as the input rises, apart from the loop."""
        return self.correlation < _FALLING

    @property
    def circulation(self) -> str | None:
        """Direction of the loop, of the mirrored one where the output falls; None where no loop is open."""
        way = None if self.shape is None else self.shape.circulation
        opposite = {"clockwise": "counter-clockwise", "counter-clockwise": "clockwise"}
        return opposite[way] if self.falls and way is not None else way

    @property
    def switches(self) -> bool:
        """Whether the output has two values, as that of a thermostat or another switch."""
        return self.y.range > 0 and self.y.range == self.y.resolution

    @property
    def degrading(self) -> bool:
        """Whether the loop loses more stiffness or strength than loops without damage do; unknown in a resonance, a switch, a current."""
        if self.shape is None or self.dynamic or self.switches or self.charges or self.shape.circulation is None:
            return False
        left = 1.0 if self.stiffness_left is None else self.stiffness_left
        return (
            self.weakens
            or self.softens
            or self.softens_with_stroke
            or left < 0.88
            or (left < _WHOLE and self.shape.pinching < 0.6)
        )

    @property
    def softens(self) -> bool:
        """Whether a force unloads with less stiffness the later it is, at growing strokes."""
        late = self.unloading_left
        return late is not None and late < _SOFTER and self.circulation == "clockwise" and not self.dynamic

    @property
    def softens_with_stroke(self) -> bool:
        """Whether branches from the outermost level are softer after larger strokes (Mullins effect)."""
        return self.softening_left is not None and self.softening_left < _MULLINS

    @property
    def weakens(self) -> bool:
        """Whether longer branches reach less output than shorter ones before did; unknown in a resonance."""
        return self.strength_left is not None and self.strength_left < _WEAKER and not self.dynamic

    @property
    def lags(self) -> bool:
        """Whether the output keeps moving after the input has turned."""
        least = 0.0 if self.delay is None else _BESIDE_DELAY
        if self.slow_lag is not None:
            return True
        return self.lag is not None and self.lag.samples > max(2 * self.lag.stderr, least)

    @property
    def leads(self) -> bool:
        """Whether the output turns before the input."""
        return self.lag is not None and self.lag.samples < -2 * self.lag.stderr

    @property
    def speed_dependent(self) -> bool:
        """Whether the output turns early and velocity terms explain most of what is unexplained, or the area changes."""
        explained = self.velocity_gain is not None and self.velocity_gain > 0.5
        widens = self.rate_effect is not None and abs(self.rate_effect) > 0.1 and not self.degrading
        return not self.dynamic and ((self.leads and explained) or widens)

    @property
    def creeps(self) -> bool:
        """Whether the output moves by more than its noise during a long hold."""
        motion, noise = self.motion, self.y.noise_rms or 0.0
        if motion.longest_hold < LONG_HOLD or motion.hold_creep is None or self.sampling.rate is None:
            return False
        return motion.hold_creep * self.y.range > 4 * noise / (motion.longest_hold / 20) ** 0.5


def summarize(record: Record) -> RecordQuality:
    """Measure one record; time stamps that repeat are no time."""
    if record.t is not None and CoarseClock.of(record.t):
        record = record.replace(t=None)
    delay = delay_of(record)
    if delay is not None:
        record = record.replace(u=delayed(record.u[:, None], delay.samples)[:, 0])
    return dataclasses.replace(_summarize(record), delay=delay)


def may_change(record: Record) -> bool:
    """Whether the output may drift or the device degrade: a first look, in a fraction of the time of `summarize`."""
    u, y, t = record.u, record.y, record.t
    _, turns, cycles, _ = _motion(record, _column(u))
    parts = (
        (stiffness_left(u, y, t, cycles), _WHOLE),
        (strength_left(u, y, cycles), _WEAKER),
        (unloading_left(u, y, cycles), _SOFTER),
        (softening_left(u, y, turns), _MULLINS),
    )
    if any(left is not None and left < whole for left, whole in parts):
        return True
    return t is not None and linear_trend(u, y, t) is not None


def delay_of(record: Record) -> PureDelay | None:
    """Pure delay of the output; None without one or without even time steps."""
    interval = _even_interval(record)
    if interval is None:
        return None
    turns = geometry.reversals(record.u, _threshold(_column(record.u)))
    return estimate_delay(record.u, np.where(record.used, record.y, np.nan), interval, turns)


def dynamics_of(record: Record) -> Dynamics | None:
    """Frequency response and resonance; None where they cannot be estimated or without even time steps."""
    interval = _even_interval(record)
    return None if interval is None else estimate_dynamics(record.u, np.where(record.used, record.y, np.nan), interval)


def _even_interval(record: Record) -> float | None:
    """Time between samples; None without time or where it is uneven."""
    interval = record.sampling_interval
    if interval is None or record.t is None or np.max(np.abs(np.diff(record.t) - interval)) > _UNEVEN * interval:
        return None
    return interval


def outliers_of(record: Record) -> np.ndarray:
    """Sample numbers of isolated outliers of the output; none where there are so many that they belong to its noise."""
    noise, _ = noise_rms(record.y)
    if not noise:
        return np.empty(0, dtype=int)
    found = spikes(record.y, noise, record.u, geometry.reversals(record.u, _threshold(_column(record.u))))
    return found if found.size <= _MOST_OUTLIERS * len(record) else found[:0]


def _summarize(record: Record) -> RecordQuality:
    u, y, t = record.u, record.y, record.t
    u_column, y_column = _column(u), _column(y)
    motion, turns, cycles, loops = _motion(record, u_column)
    moving = np.ptp(u) > 0
    sampling, interval = _sampling(record), record.sampling_interval
    lag = gain = dynamics = slow_lag = None
    resonates = False
    shape = loop_shape(u, bridged(y), loops, cycles, y_column.known_noise or 0.0)
    if moving and t is not None and interval and sampling.uniform and sampling.repeated_stamps == 0:
        lag = estimate_lag(u, y, interval, turns, u_noise=u_column.known_noise)
        dynamics = estimate_dynamics(u, y, interval)
        resonates = dynamics is not None and dynamics.resonant
        short = lag is not None and lag.samples + 2 * lag.stderr < SHORT
        if not (short or resonates) and shape is not None and not shape.crossing:
            slow_lag = estimate_slow_lag(u, y, turns)
        if motion.cycles >= 1:
            late = max(0, round(lag.samples)) if lag else 0
            gain = velocity_gain(u[: u.size - late], y[late:], t[: u.size - late])
    drifts = drift(u, y, t, cycles, y_column.known_noise or 0.0) if moving else None
    known = slow_lag is not None or (drifts is not None and drifts.law != "none")
    trend = None if t is None or known or resonates or motion.cycles < _FEWEST_CYCLES else linear_trend(u, y, t)
    return RecordQuality(
        name=record.name,
        units={"u": record.u_unit, "y": record.y_unit, "t": record.t_unit},
        sampling=sampling,
        u=u_column,
        y=y_column,
        motion=motion,
        area=geometry.loop_area(u[record.used], y[record.used]) if record.used.any() else 0.0,
        correlation=_correlation(u[record.used], y[record.used]),
        sign_of_rate=_sign_of_rate(u, y),
        shape=shape,
        drift=drifts,
        lag=lag,
        velocity_gain=gain,
        rate_effect=rate_effect(u, y, t, cycles),
        stiffness_left=stiffness_left(u, y, t, cycles),
        strength_left=strength_left(u, y, cycles),
        unloading_left=unloading_left(u, y, cycles),
        softening_left=softening_left(u, y, turns),
        dynamics=dynamics,
        clipped=int(clipped_samples(u, y).sum()),
        spikes=int(outliers_of(record).size),
        slow_lag=slow_lag,
        trend=trend,
    )


def _correlation(u: np.ndarray, y: np.ndarray) -> float:
    if u.size < 2 or not (np.ptp(u) > 0 and np.ptp(y) > 0):
        return 0.0
    scaled = lambda x: (x - x.mean()) / np.ptp(x)
    return float(np.corrcoef(scaled(u), scaled(y))[0, 1])


def _sign_of_rate(u: np.ndarray, y: np.ndarray) -> float:
    """See `RecordQuality.sign_of_rate`; 0 for an input at rest."""
    rate = np.sign(np.gradient(u)) if u.size > 1 else np.zeros(u.size)
    known = (rate != 0) & np.isfinite(y)
    return float(np.mean(rate[known] * np.sign(y[known]))) if known.any() else 0.0


def _column(values: np.ndarray) -> Column:
    noise, bound = noise_rms(values)
    return Column(float(np.nanmin(values)) + 0.0, float(np.nanmax(values)) + 0.0, resolution(values), noise, bound)


def _sampling(record: Record) -> Sampling:
    counts = len(record), int(np.isnan(record.y).sum()), int((record.weight == 0).sum())
    if record.t is None:
        return Sampling(*counts, None, None, None, 0, 0)
    steps, interval = np.diff(record.t), record.sampling_interval
    repeated, duration = int((steps == 0).sum()), float(record.t[-1] - record.t[0])
    if interval is None:
        return Sampling(*counts, duration, None, None, repeated, 0)
    uniform = bool(np.max(np.abs(steps - interval)) <= _UNEVEN * interval)
    return Sampling(*counts, duration, 1 / interval, uniform, repeated, int((steps > 1.5 * interval).sum()))


def _threshold(column: Column) -> float:
    """Change of u by which a turning point must stand out: above the noise, as far as sparse samples show it."""
    most = (0.03 if column.noise_is_bound else 0.1) * column.range
    least = max(6 * (column.noise_rms or 0.0), 1.5 * (column.resolution or 0.0))
    return max(0.005 * column.range, min(least, most))


def _motion(record: Record, column: Column) -> tuple[Motion, np.ndarray, np.ndarray, list[geometry.Loop]]:
    """Motion of the input, its turning points, cycles and closed loops."""
    u, y = record.u, record.y
    threshold = _threshold(column)
    turns = geometry.reversals(u, threshold)
    loops, cycles = geometry.closed_loops(u, threshold), geometry.cycles(u, threshold)
    span = column.range or 1.0
    largest = max((loop.stroke for loop in loops), default=0.0)
    major = sum(loop.stroke >= 0.95 * largest for loop in loops)
    branches = geometry.branches(u, threshold)
    levels = u[turns]
    pairs = {tuple(sorted(pair)) for pair in np.round(np.stack([levels[:-1], levels[1:]], 1) / span / 0.05).tolist()}
    rests = [(int(a), int(b)) for a, b in holds(u, 2e-4 * span + 10 * (column.known_noise or 0.0))]
    creep = [_change(y[a:b]) for a, b in rests]
    extent = float(np.nanmax(y) - np.nanmin(y))
    motion = Motion(
        threshold=float(threshold),
        reversals=int(turns.size),
        chatter_percent=chatter(u, branches),
        smoothing=smoothing_length(u, branches),
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
    )
    return motion, turns, cycles, loops


def _change(y: np.ndarray) -> float:
    """Size of the change over a hold: mean of its last fifth minus mean of its first twentieth."""
    part = max(1, y.size // 20)
    with np.errstate(invalid="ignore"):
        change = abs(float(np.mean(y[-4 * part :]) - np.mean(y[:part])))
    return change if math.isfinite(change) else 0.0
