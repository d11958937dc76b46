"""Steady loops of a model: the inputs on which they and the creep are computed, and what is measured on the outputs.

The steady loop is the last of three cycles over the input range of the fit, after a device at rest in the middle has moved to the lower
end: slow relaxation settles about the middle, and from rest at an end would still do so in the third cycle. The cycles of a model that
hardens run the path of the record: the record need not show the loop of a new device at this amplitude. Where the record has a time, the
cycles last as long as its own, with their waveform, sine or triangle, and their sampling rate: the delay of a lag of few samples includes
half a sampling interval. Else they are triangular. The creep is that after a step over the same range, of a device that has rested at
the lower end.
"""

from __future__ import annotations

import dataclasses
import functools
from statistics import median
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.slopes import CYCLES, POINTS
from hystfit.params.relative_size import ROUNDED
from hystfit.params.units import loop_energy, stiffness_unit
from hystfit.quality.loops import APART, LARGEST, branches, cycles
from hystfit.quality.shape import has_lobes
from hystfit.results.measured.loop_kinds import LoopKind
from hystfit.results.measured.loop_origin import MIDDLE, Origin, inside
from hystfit.results.measured.steady_branches import at_pace, usual_duration

_FEWEST, _MOST = 40, 2000  # samples of a cycle
_OF_CYCLE = 64  # samples of a cycle from which its rms follows to 0.1 %
CRITICAL = 100.0  # % of the critical damping, above which a ratio tells of no vibration: the force is that of a damper
_SINE = 0.5 * (2**-0.5 + 3**-0.5)  # rms of a cycle over half its range: between that of a triangle and that of a sine
_RESTED = 1e5  # seconds on the lower end of the range before the step of the creep
_STEP = 0.05  # seconds between the samples of the step
_AT_1S, _AT_10S = (1 + round(seconds / _STEP) for seconds in (1, 10))  # samples of it


@dataclasses.dataclass(frozen=True)
class SteadyLoops:
    """Steady loops."""

    inputs: np.ndarray  # rising, of all loops, shape (P,), or of each, shape (count, P)
    rising: np.ndarray  # rising, falling: outputs of each loop at these inputs, shape (count, P)
    falling: np.ndarray
    force_driven: bool = False  # whether the input is the force
    energy: float = 1.0  # that of a unit of area, in the unit of `loop_energy`
    origin: Origin = MIDDLE  # where the height and the width are read
    stiffness: float = 1.0  # that of a unit of force over a unit of path, in the unit of `stiffness_unit`

    @functools.cached_property
    def gap(self) -> Float[np.ndarray, "count P"]:
        """Height of the loop at each input."""
        return np.abs(self.falling - self.rising)

    @functools.cached_property
    def stroke(self) -> Float[np.ndarray, " count"]:
        """Range of the output."""
        return np.maximum(self.rising.max(1), self.falling.max(1)) - np.minimum(self.rising.min(1), self.falling.min(1))

    @property
    def width(self) -> Any:
        """Range of the input."""
        return self.inputs[..., -1] - self.inputs[..., 0]

    @functools.cached_property
    def area(self) -> Float[np.ndarray, " count"]:
        """Enclosed area."""
        return np.abs(np.trapezoid(self.falling - self.rising, self.inputs, axis=1))

    @functools.cached_property
    def lobed(self) -> Bool[np.ndarray, " count"]:
        """Whether the branches cross (a butterfly): lobes in opposite directions have no common height, and their areas cancel."""
        return has_lobes(self.area, np.trapezoid(self.gap, self.inputs, axis=1), self.stroke * self.width)

    @property
    def loss(self) -> Float[np.ndarray, " count"]:
        """Energy of the enclosed area; NaN of a butterfly."""
        return np.where(self.lobed, np.nan, self.energy * self.area)

    @property
    def travel(self) -> Float[np.ndarray, " count"]:
        """Change of the output from the lowest to the highest input."""
        ends = 0.5 * (self.rising + self.falling)
        return np.abs(ends[:, -1] - ends[:, 0])

    @property
    def coercive_input(self) -> Float[np.ndarray, " count"]:
        """Half the distance of the branches at the `level`; NaN of a butterfly, and where they do not pass it."""
        crossing = lambda branch: _crossings(branch - self.level[:, None], self.inputs)
        return np.where(self.lobed, np.nan, 0.5 * np.abs(crossing(self.rising) - crossing(self.falling)))

    @functools.cached_property
    def level(self) -> Float[np.ndarray, " count"]:
        """The output at which the width is read."""
        highest = np.maximum(self.rising.max(1), self.falling.max(1))
        lowest = np.minimum(self.rising.min(1), self.falling.min(1))
        return inside(self.origin.y, lowest, highest, self.origin.reach)

    @property
    def remanence(self) -> Float[np.ndarray, " count"]:
        """Half the height of the loop at the input of its origin; NaN of a butterfly."""
        inputs, rows = np.broadcast_to(self.inputs, self.gap.shape), np.arange(len(self.gap))
        at = inside(self.origin.u, inputs[:, 0], inputs[:, -1])
        k = np.clip((inputs < at[:, None]).sum(axis=1), 1, inputs.shape[1] - 1)
        share = (at - inputs[rows, k - 1]) / (inputs[rows, k] - inputs[rows, k - 1])
        height = (1 - share) * self.gap[rows, k - 1] + share * self.gap[rows, k]
        return np.where(self.lobed, np.nan, 0.5 * height)

    @property
    def secant_stiffness(self) -> Float[np.ndarray, " count"]:
        """Force over displacement between the ends of the loop, in the unit of `stiffness_unit`."""
        with np.errstate(divide="ignore"):  # a butterfly ends at one output
            return self.stiffness * (self.width / self.travel if self.force_driven else self.travel / self.width)

    @property
    def damping_percent(self) -> Float[np.ndarray, " count"]:
        """Equivalent damping ratio; NaN above the critical damping."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = 100 * 2 * self.area / (np.pi * self.width * self.travel)
        return np.where(ratio > CRITICAL, np.nan, ratio)


def _crossings(
    branches: Float[np.ndarray, "count P"], inputs: Float[np.ndarray, "... P"]
) -> Float[np.ndarray, " count"]:
    """The input at which each branch passes zero, the middle one of several (a sloping film); NaN where it ends on its first side."""
    passed = np.signbit(branches[:, :-1]) != np.signbit(branches[:, 1:])
    half = (passed.sum(axis=1, keepdims=True) + 1) // 2
    k, rows = np.argmax(passed & (np.cumsum(passed, axis=1) == half), axis=1), np.arange(len(branches))
    before, after, inputs = branches[rows, k], branches[rows, k + 1], np.broadcast_to(inputs, branches.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        place = inputs[rows, k] - before * (inputs[rows, k + 1] - inputs[rows, k]) / (after - before)
        return np.where(passed.sum(axis=1) % 2 == 1, place, np.nan)


@dataclasses.dataclass(frozen=True)
class Excitation:
    """The inputs on which the quantities of a fit are computed."""

    # low, high: range of the input; a column of them, shape (count, 1), for `inputs` and `loops` of several that differ in these alone
    low: Any
    high: Any
    interval: float  # between the samples of the cycles [s]
    force_driven: bool = False  # whether the input is the force
    sine: bool = False  # whether the cycles of the records are nearer to a sine than to a triangle
    points: int = POINTS  # samples of a cycle, an even number
    cycles: int = CYCLES  # the last of which shows the steady loop
    # samples of the way from the middle to the lower end before them; with 0 no cycle is corrected for what still settles
    lead: int = 0
    energy: float = 1.0  # that of a unit of area of a loop
    origin: Origin = MIDDLE  # where its height and its width are read
    stiffness: float = 1.0  # that of a unit of force over a unit of path

    @classmethod
    def of(cls, data: Dataset, model: AbstractHysteresis | None = None) -> Excitation:
        """The excitation over the range of the inputs from the first to the last sample that counts.

        Args:
            model: where its loop changes with the path, the cycles run that of the longest record; where its output jumps at an input,
                this is known to the distance of the samples alone. Where its columns are known in closed form, as those of relays and plays
                are, the distance of the samples changes nothing but what straight lines between them cut off, and there are `POINTS`.
        """
        hardens, jumps = model is not None and model.hardens, model is not None and model.jumps
        low, high = min(float(r.reached.min()) for r in data), max(float(r.reached.max()) for r in data)
        interval, sine, points = _waveform(data)
        exact = model is not None and model.rate_independent and model.has_fast_run
        fine = _MOST if jumps else POINTS if exact else points
        if fine > points:
            interval, points = interval * points / fine, fine
        count = _cycles_of_path(data, high - low) if hardens else CYCLES
        u, y = data.units["u"], data.units["y"]
        lead = 0 if hardens else points - points // 4
        driven = LoopKind.of(data) is LoopKind.FORCE_DRIVEN
        energy, stiffness = loop_energy(u, y)[1], stiffness_unit(*((u, y) if driven else (y, u)))[1]
        return cls(low, high, interval, driven, sine, points, count, lead, energy, Origin.of(data), stiffness)

    @functools.cached_property
    def inputs(self) -> np.ndarray:
        """Inputs of one branch, rising, shape (..., points / 2 + 1), evenly spaced in time."""
        phase = np.linspace(0.0, 1.0, self.points // 2 + 1)
        share = 0.5 * (1 - np.cos(np.pi * phase)) if self.sine else phase
        return self.low + (self.high - self.low) * share

    @functools.cached_property
    def loop(self) -> Record:
        """The way from the middle to the lower end, and the cycles, the last of which shows the steady loop and ends where it began."""
        cycle = np.concatenate([self.inputs[:-1], self.inputs[:0:-1]])
        u = np.concatenate([cycle[cycle.size - self.lead :], np.tile(cycle, self.cycles), cycle[: bool(self.lead)]])
        return Record(u=u, y=np.zeros(u.size), t=self.interval * np.arange(u.size), name="steady loop")

    @functools.cached_property
    def step(self) -> Record:
        """A step over the range, of a device that has rested at its lower end; as long as `loop`, so that one program serves both."""
        size = max(len(self.loop), _AT_10S + 1)
        u = np.concatenate([[self.low, self.low], np.full(size - 2, self.high)])
        t = np.concatenate([[0.0], _RESTED + _STEP * np.arange(size - 1)])
        return Record(u=u, y=np.zeros(size), t=t, name="step")

    def loops(self, y: np.ndarray) -> SteadyLoops:
        """The steady loops in outputs over `loop`, shape (count, T)."""
        half = self.points // 2
        if self.lead:  # what still settles moves the end of the cycle away from its start
            y, moved = y[:, -self.points - 1 : -1], y[:, -1:] - y[:, -self.points - 1, None]
            y = y - moved * np.arange(self.points) / self.points
        y = y[:, -self.points :]
        falling = np.concatenate([y[:, half:], y[:, :1]], axis=1)[:, ::-1]
        return self.of_branches(self.inputs, y[:, : half + 1], falling)

    def of_branches(self, inputs: np.ndarray, rising: np.ndarray, falling: np.ndarray) -> SteadyLoops:
        """Loops with these branches; arguments as for `SteadyLoops`."""
        return SteadyLoops(inputs, rising, falling, self.force_driven, self.energy, self.origin, self.stiffness)

    @staticmethod
    def creep(y: np.ndarray) -> Float[np.ndarray, " count"]:
        """Creep a decade in percent of the change in the first second, by when a fast lag is over, from outputs over `step`, (count, T)."""
        return 100 * (y[:, _AT_10S] - y[:, _AT_1S]) / (y[:, _AT_1S] - y[:, 1])


def creeps(percent: np.ndarray) -> bool:
    """Whether a model has creep: it is not 0 at all parameter values, shape (count,), as that of a lag or a viscous term is."""
    return not bool((np.abs(percent) < ROUNDED).all())


def _cycles_of_path(data: Dataset, span: float) -> int:
    """Cycles over a range that run at most the longest path of a record up to its last sample that counts."""
    path = max(float(np.abs(np.diff(record.u[: record.last + 1])).sum()) for record in data)
    return int(np.clip(path / (2 * span), CYCLES, 50)) if span > 0 else CYCLES


def _waveform(data: Dataset) -> tuple[float, bool, int]:
    """Sampling interval [s] of cycles like the large ones of the records, whether these are nearer to a sine than a triangle, and samples.

    The sine is recognized by the rms over time about the middle. Without large cycles in time: the interval of the records, no sine.
    """
    for record in data:
        halves, found = (1, np.empty((0, 3), int)) if record.t is None else _large_cycles(record.u)
        if record.t is None or not len(found):
            continue
        first, last = found[:, 0], found[:, 2]
        lasts = halves * (record.t[last] - record.t[first])
        usual = usual_duration(lasts.tolist())
        at_usual = at_pace(lasts, usual)
        found, first, last = found[at_usual], first[at_usual], last[at_usual]
        points = int(np.clip(2 * round(median((halves * (last - first)).tolist()) / 2), _FEWEST, _MOST))
        return usual / points, median(_rms_of_cycles(record.t, record.u, found).tolist()) > _SINE, points
    return data[0].sampling_interval or 1.0, False, POINTS


def _large_cycles(u: np.ndarray) -> tuple[int, np.ndarray]:
    """1 and the large cycles, as by `cycles`; without a whole one 2 and the halves of a record of one cycle, or of a rise and a fall."""
    span = float(np.ptp(u))
    # Half: a first rise from the middle.
    found = cycles(u, 0.5 * LARGEST * span)
    if len(found):
        return 1, found
    ends = branches(u, APART * span)
    ends = ends[np.abs(u[ends[:, 1]] - u[ends[:, 0]]) >= LARGEST * span] if len(ends) > 1 else ends[:0]
    return 2, np.column_stack([ends[:, 0], ends.mean(axis=1).astype(int), ends[:, 1]])


def _rms_of_cycles(t: np.ndarray, u: np.ndarray, found: np.ndarray) -> Float[np.ndarray, " C"]:
    """RMS over time of the input in each cycle, about the middle of its range and over half of it; cycles as by `cycles`."""
    first, last = found[:, :1], found[:, 2:]
    at = first + np.round((last - first) * np.linspace(0.0, 1.0, _OF_CYCLE + 1)).astype(int)
    t, u = t[at], u[at]
    low, high = u.min(axis=1, keepdims=True), u.max(axis=1, keepdims=True)
    away = (2 * u - low - high) / (high - low)
    return np.sqrt(np.trapezoid(away**2, t, axis=1) / (t[:, -1] - t[:, 0]))
