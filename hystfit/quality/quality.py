"""The data-quality verdict: what a record holds, what is wrong with it, and which models it can determine."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.quality import loops as geometry
from hystfit.quality.drift import Drift, drift
from hystfit.quality.faults import clipped_samples, holds, noise_rms, resolution, spikes
from hystfit.quality.lag import Lag, estimate_lag, velocity_gain
from hystfit.quality.reversal_curves import recognize_family
from hystfit.quality.shape import Shape, loop_shape, rate_effect, stiffness_left


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


@dataclasses.dataclass(frozen=True)
class Column:
    """Extent and small-scale faults of one column, in its unit; `noise_is_bound`: an upper bound only."""

    low: float
    high: float
    resolution: float | None
    noise_rms: float | None
    noise_is_bound: bool

    @property
    def range(self) -> float:
        """Extent."""
        return self.high - self.low


@dataclasses.dataclass(frozen=True)
class Motion:
    """What the input does.

    Attributes:
        reversals: turning points; `threshold` [unit of u] is what stands out from chatter.
        chatter_percent: share of the samples at which the input steps back against its branch.
        closed_loops, major, minor, nested: loops that close; those within 5 % of the largest stroke; the rest;
            those inside another.
        cycles: pairs of branches, whether they close or not.
        strokes: different strokes, largest first, as fractions of the input's range (5 % apart).
        turning_pairs: different (low, high) pairs of neighboring turning levels (5 % of the range apart).
        monotonic: the input never turns.
        holds, longest_hold, hold_creep: rests of the input, the longest [samples], and the largest change of the
            output during one as a fraction of its range.
    """

    threshold: float
    reversals: int
    chatter_percent: float
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
    """Everything measured on one record; None where it is not known."""

    name: str
    units: dict[str, str]
    sampling: Sampling
    u: Column
    y: Column
    motion: Motion
    shape: Shape | None
    drift: Drift | None
    lag: Lag | None
    velocity_gain: float | None
    rate_effect: float | None
    stiffness_left: float | None
    clipped: int
    spikes: int


@dataclasses.dataclass(frozen=True)
class Determination:
    """Whether data determine a model: "yes", "partly" or "no", and why."""

    model: str
    verdict: str
    reasons: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class QualityReport:
    """The verdict on a data set: one entry per record, findings in words, and what each model can learn from it."""

    name: str
    records: tuple[RecordQuality, ...]
    findings: tuple[str, ...]
    determines: tuple[Determination, ...]

    def to_dict(self) -> dict[str, Any]:
        """As plain lists, dicts, numbers and None, ready for JSON."""
        return _plain(dataclasses.asdict(self))

    def text(self) -> str:
        """As a page of text."""
        from hystfit.quality.findings import page

        return page(self)

    def __str__(self) -> str:
        return self.text()

    def verdict(self, model: str) -> Determination:
        """What the data say about one model. Raises KeyError for an unknown name."""
        return {item.model: item for item in self.determines}[model]


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def check(data: Record | Dataset) -> QualityReport:
    """Data-quality verdict of a record or a data set.

    Raises:
        DataError: `data` holds no records.
    """
    from hystfit.quality.findings import findings
    from hystfit.quality.verdict import determine

    dataset = Dataset.of(data)
    records = tuple(check_record(record) for record in dataset)
    told, determined = findings(records), determine(records)
    family = recognize_family(dataset)
    if family is not None:
        told = (family.words(), *family.notes, *told)
        reason = f"{len(family.curves)} first-order reversal curves determine the density (model preisach-forc)"
        able = Determination("preisach", "partly" if family.notes else "yes", (reason, *family.notes))
        determined = tuple(able if item.model == "preisach" else item for item in determined)
    return QualityReport(dataset.name, records, told, determined)


def check_record(record: Record) -> RecordQuality:
    """Measure one record; see `RecordQuality`."""
    u, y, t = record.u, record.y, record.t
    u_column, y_column = _column(u), _column(y)
    motion, turns, cycles, loops = _motion(record, u_column)
    moving = np.ptp(u) > 0
    sampling = _sampling(record)
    timed = t is not None and sampling.uniform and sampling.repeated_stamps == 0
    lag = estimate_lag(u, y, t, turns, u_noise=_noise(u_column)) if moving and timed else None
    gain = None
    if moving and timed and t is not None and motion.cycles >= 1:
        late = max(0, round(lag.samples)) if lag else 0
        gain = velocity_gain(u[: u.size - late], y[late:], t[: u.size - late])
    return RecordQuality(
        name=record.name,
        units={"u": record.u_unit, "y": record.y_unit, "t": record.t_unit},
        sampling=sampling,
        u=u_column,
        y=y_column,
        motion=motion,
        shape=loop_shape(u, y, loops, cycles),
        drift=drift(u, y, t, cycles) if moving else None,
        lag=lag,
        velocity_gain=gain,
        rate_effect=rate_effect(u, y, t, cycles),
        stiffness_left=stiffness_left(u, y, cycles),
        clipped=clipped_samples(u, y),
        spikes=int(spikes(y, y_column.noise_rms, turns).size),
    )


def _noise(column: Column) -> float | None:
    return None if column.noise_is_bound else column.noise_rms


def _column(values: np.ndarray) -> Column:
    noise, bound = noise_rms(values)
    return Column(float(np.nanmin(values)), float(np.nanmax(values)), resolution(values), noise, bound)


def _sampling(record: Record) -> Sampling:
    missing, left_out = int(np.isnan(record.y).sum()), int((record.weight == 0).sum())
    if record.t is None:
        return Sampling(len(record), missing, left_out, None, None, None, 0, 0)
    steps = np.diff(record.t)
    moving = steps[steps > 0]
    repeated = int((steps == 0).sum())
    duration = float(record.t[-1] - record.t[0])
    if moving.size == 0:
        return Sampling(len(record), missing, left_out, duration, None, None, repeated, 0)
    usual = float(np.median(moving))
    uniform = bool(np.max(np.abs(steps - usual)) <= 0.01 * usual)
    return Sampling(
        len(record), missing, left_out, duration, 1 / usual, uniform, repeated, int((steps > 1.5 * usual).sum())
    )


def _threshold(column: Column) -> float:
    """What a turning point must stand out by: over the chatter, as far as that can be told from sparse samples."""
    most = (0.03 if column.noise_is_bound else 0.1) * column.range
    least = max(6 * (column.noise_rms or 0.0), 1.5 * (column.resolution or 0.0))
    return max(0.005 * column.range, min(least, most))


def _motion(record: Record, column: Column) -> tuple[Motion, np.ndarray, np.ndarray, list[geometry.Loop]]:
    u, y = record.u, record.y
    threshold = _threshold(column)
    turns = geometry.reversals(u, threshold)
    loops, cycles = geometry.closed_loops(u, threshold), geometry.cycles(u, threshold)
    span = column.range or 1.0
    largest = max((loop.stroke for loop in loops), default=0.0)
    major = sum(loop.stroke >= 0.95 * largest for loop in loops)
    branches = geometry.branches(u, threshold)
    back = sum(
        int((np.sign(u[b] - u[a]) * np.diff(u[a : b + 1]) < 0).sum()) for a, b in branches if b > a and u[b] != u[a]
    )
    levels = u[turns]
    pairs = {tuple(sorted(pair)) for pair in np.round(np.stack([levels[:-1], levels[1:]], 1) / span / 0.05).tolist()}
    strokes = [float(abs(u[b] - u[a])) / span for a, b in (branches[1:-1] if len(branches) > 2 else branches)]
    hum = 6 * (_noise(column) or 0.0)
    rests = holds(u, 1e-4 * span + 0.5 * hum, least=10)
    # the top of a slow sine is flat too, but it does not stay within so little
    rests = np.array([r for r in rests if np.ptp(u[r[0] : r[1]]) <= 2e-4 * span + hum], dtype=int).reshape(-1, 2)
    creep = [_change(y[a:b]) for a, b in rests]
    extent = float(np.nanmax(y) - np.nanmin(y))
    motion = Motion(
        threshold=float(threshold),
        reversals=int(turns.size),
        chatter_percent=100 * back / max(u.size - 1, 1),
        closed_loops=len(loops),
        major=int(major),
        minor=len(loops) - int(major),
        nested=sum(loop.depth > 0 for loop in loops),
        cycles=len(cycles),
        strokes=_different(strokes),
        turning_pairs=len(pairs),
        monotonic=turns.size == 0,
        holds=len(rests),
        longest_hold=int(max((b - a for a, b in rests), default=0)),
        hold_creep=max(creep) / extent if creep and extent > 0 else None,
    )
    return motion, turns, cycles, loops


def _change(y: np.ndarray) -> float:
    """Size of the change over a rest: mean of its last fifth less mean of its first twentieth."""
    part = max(1, y.size // 20)
    with np.errstate(invalid="ignore"):
        change = abs(float(np.mean(y[-4 * part :]) - np.mean(y[:part])))
    return change if math.isfinite(change) else 0.0


def _different(values: list[float], apart: float = 0.05) -> tuple[float, ...]:
    kept: list[float] = []
    for value in sorted(values, reverse=True):
        if not kept or kept[-1] - value > apart:
            kept.append(float(value))
    return tuple(kept)
