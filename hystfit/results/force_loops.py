"""Cycles of measured force loops, without a model: energy, stiffness and damping of each, backbone, loss of stiffness, failure."""

from __future__ import annotations

import dataclasses
import itertools
from typing import TYPE_CHECKING, Any

import numpy as np

from hystfit.data.circulation import SLACK
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.outcome import Column, Table
from hystfit.outcome.notebook import fragment
from hystfit.outcome.table import rounded
from hystfit.outcome.wrapping import shortened
from hystfit.quality.damage import FAILED
from hystfit.quality.faults import noise_rms
from hystfit.quality.loops import SAME_LEVEL, reversals
from hystfit.results.measured.loop_kinds import STRUCTURAL, LoopKind

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SAME = 1.1  # ratio of displacements up to which peaks repeat one another
FAILURE = f"failure ({100 * FAILED:.0f} % of the largest force)"


@dataclasses.dataclass(frozen=True)
class ForceCycle:
    """One cycle of displacement, from its middle to one side, to the other and back."""

    first: int  # first, last: samples
    last: int
    low: float  # low, high: smallest and largest displacement
    high: float
    force_low: float  # force_low, force_high: forces there
    force_high: float
    energy: float  # absorbed in the cycle, the integral of force over displacement; with its standard error
    energy_error: float | None
    stiffness: float  # secant between the two ends; with its standard error
    stiffness_error: float | None
    # equivalent viscous damping ratio, energy / (2 pi stiffness amplitude^2); None for a stiffness that is not positive
    damping: float | None
    # 1 less the ratio of the stiffness to the largest of the cycles so far: a damage index from 0 to 1
    stiffness_lost: float | None


@dataclasses.dataclass(frozen=True)
class BackbonePoint:
    """A peak of the displacement beyond all before in its direction."""

    displacement: float  # displacement, force: where the force of that half cycle is largest in size
    force: float
    later: float | None  # largest force of the last half cycle that repeats this peak; None where it is not repeated
    sample: int  # of the peak


@dataclasses.dataclass(frozen=True)
class ForceLoops:
    """What the loops of one record show; "u" is the displacement and "F" the force, whichever was the input.

    Attributes:
        name: of the record.
        units: of displacement and force; "" where unknown.
        cycles: in order.
        backbone: points towards positive (True) and negative (False) displacements, in order.
        failure: displacement at which the backbone of a direction has fallen to 80 % of its largest force, by straight lines between
            its points; None where it has not.
    """

    name: str
    units: tuple[str, str]
    cycles: tuple[ForceCycle, ...]
    backbone: dict[bool, tuple[BackbonePoint, ...]]
    failure: dict[bool, float | None]

    def table(self) -> Table:
        """One row for each cycle."""
        u, f = self.units
        heads = ("cycle", f"from [{u}]", f"to [{u}]", f"energy [{f} {u}]", "+-", f"stiffness [{f}/{u}]", "+-")
        heads = (*heads, "damping [%]", "stiffness lost [%]")
        rows = []
        for number, one in enumerate(self.cycles, start=1):
            shares = ["-" if share is None else f"{100 * share:.1f}" for share in (one.damping, one.stiffness_lost)]
            values = (*rounded(one.energy, one.energy_error), *rounded(one.stiffness, one.stiffness_error))
            rows.append([str(number), f"{one.low:.4g}", f"{one.high:.4g}", *values, *shares])
        return Table([Column(head) for head in heads], rows)

    def backbone_table(self) -> Table:
        """One row for each point of the backbone."""
        u, f = self.units
        heads = (f"displacement [{u}]", f"force, first cycle [{f}]", f"force, last cycle [{f}]", "sample")
        rows = [
            [f"{p.displacement:.4g}", f"{p.force:.4g}", "-" if p.later is None else f"{p.later:.4g}", str(p.sample)]
            for points in (self.backbone[False][::-1], self.backbone[True])
            for p in points
        ]
        return Table([Column(head) for head in heads], rows)

    def text(self) -> str:
        """The first cycles, the backbone and the failure, for a terminal."""
        table = self.table().lines()
        most = len(table) - len(self.cycles) + 12
        lines = shortened(table, most, "... and {} more cycles (--out writes all of them)")
        lines += ["", "backbone", *self.backbone_table().lines(), ""]
        for direction, words in ((True, "positive"), (False, "negative")):
            at = self.failure[direction]
            place = "not reached" if at is None else f"{at:.4g} {self.units[0]}".rstrip()
            lines.append(f"{FAILURE}, {words} direction: {place}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        return fragment(f"Force loops of {self.name}", (self.table(), self.backbone_table()))

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`."""
        sides = {True: "positive", False: "negative"}
        return {
            "units": {"displacement": self.units[0], "force": self.units[1]},
            "cycles": [dataclasses.asdict(one) for one in self.cycles],
            "backbone": {sides[d]: [dataclasses.asdict(p) for p in points] for d, points in self.backbone.items()},
            "failure": {sides[d]: at for d, at in self.failure.items()},
        }

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the backbones of the first and the last cycles, and the failure points, on given axes or new ones."""
        from hystfit.results.colors import MODEL, SECOND

        if ax is None:
            from matplotlib.figure import Figure

            ax = Figure(layout="constrained").subplots()
        for direction, points in self.backbone.items():
            at = [p.displacement for p in points]
            named = lambda text, of=direction: text if of else None  # once in the legend
            ax.plot([0.0, *at], [0.0, *(p.force for p in points)], "o-", color=MODEL, label=named("first cycles"))
            if later := [(p.displacement, p.later) for p in points if p.later is not None]:
                ax.plot(*zip(*later, strict=True), "s--", color=SECOND, mfc="none", label=named("last cycles"))
            if (failed := self.failure[direction]) is not None:
                ax.axvline(failed, color="0.5", ls=":", label=named(FAILURE))
        ax.set(xlabel=f"displacement [{self.units[0]}]", ylabel=f"force [{self.units[1]}]")
        ax.legend(frameon=False)
        return ax


def force_loops(data: Record | Dataset) -> dict[str, ForceLoops]:
    """Cycles and backbone of every record of a force and a displacement, or a stress and a strain; others are left out.

    Args:
        data: records.

    Returns:
        By the name of the record; a record without a whole cycle is left out.
    """
    found = {record.name: _of_record(record) for record in Dataset.of(data)}
    return {name: one for name, one in found.items() if one is not None}


def _of_record(record: Record) -> ForceLoops | None:
    kind, kept = LoopKind.of(Dataset((record,))), record.used
    if kind not in STRUCTURAL:
        return None
    columns = (record.u[kept], record.y[kept]), (record.u_unit, record.y_unit)
    (u, f), units = columns if kind is LoopKind.DISPLACEMENT_DRIVEN else tuple(pair[::-1] for pair in columns)
    if u.size == 0 or not np.ptp(u) > 0:  # type: ignore[attr-defined]
        return None
    turns = reversals(u, SLACK * float(np.ptp(u)))
    noise, is_bound = noise_rms(f)
    cycles = _cycles(u, f, turns, None if is_bound else noise)
    if not cycles:
        return None
    backbone = {direction: _backbone(u, f, turns, 1.0 if direction else -1.0) for direction in (True, False)}
    failure = {direction: _failure(points) for direction, points in backbone.items()}
    return ForceLoops(record.name, units, cycles, backbone, failure)


def _cycles(u: np.ndarray, f: np.ndarray, turns: np.ndarray, noise: float | None) -> tuple[ForceCycle, ...]:
    """A cycle for every second turning point, between the crossings of the middle before it and after the next one."""
    edges, cycles, stiffest = [0, *turns.tolist(), u.size - 1], [], 0.0
    for k in range(1, len(edges) - 2, 2):
        one, other = edges[k], edges[k + 1]
        middle = 0.5 * (u[one] + u[other])
        first, last = _crossing(u, edges[k - 1], one, middle), _crossing(u, other, edges[k + 2], middle)
        if last is None:  # the cycle does not end
            break
        part = slice(edges[k - 1] if first is None else first, last + 1)
        low, high = sorted((one, other), key=lambda at: u[at])
        energy = float(np.sum(0.5 * (f[part][1:] + f[part][:-1]) * np.diff(u[part])))
        width = float(u[high] - u[low])
        stiffness = float(f[high] - f[low]) / width
        stiffest = max(stiffest, stiffness)
        cycles.append(
            ForceCycle(
                first=part.start,
                last=last,
                low=float(u[low]),
                high=float(u[high]),
                force_low=float(f[low]),
                force_high=float(f[high]),
                energy=energy,
                energy_error=None if noise is None else noise * float(np.sqrt(np.sum(np.gradient(u[part]) ** 2))),
                stiffness=stiffness,
                stiffness_error=None if noise is None else noise * float(np.sqrt(2)) / width,
                damping=2 * energy / (np.pi * stiffness * width**2) if stiffness > 0 else None,
                stiffness_lost=1 - stiffness / stiffest if stiffest > 0 else None,
            )
        )
    return tuple(cycles)


def _crossing(u: np.ndarray, first: int, last: int, level: float) -> int | None:
    """The first sample of a half cycle on the other side of a level; None where it does not pass it."""
    beyond = np.flatnonzero((u[first : last + 1] >= level) != (u[first] >= level))
    return first + int(beyond[0]) if beyond.size else None


def _backbone(u: np.ndarray, f: np.ndarray, turns: np.ndarray, sign: float) -> tuple[BackbonePoint, ...]:
    """Points at the peaks beyond all before on one side, with the force of the last half cycle that repeats each."""
    edges = [0, *turns.tolist(), u.size - 1]
    halves = [(a, b) for a, b in itertools.pairwise(edges) if sign * (u[b] - u[a]) > 0 and sign * u[b] > 0]
    points, largest = [], 0.0
    for number, (a, b) in enumerate(halves):
        size = sign * u[b]
        if size <= (1 + SAME_LEVEL) * largest:
            continue
        largest = size
        repeats = [half for half in halves[number + 1 :] if size / _SAME <= sign * u[half[1]] <= _SAME * size]
        peak = a + int(np.argmax(sign * f[a : b + 1]))
        later = sign * float(np.max(sign * f[repeats[-1][0] : repeats[-1][1] + 1])) if repeats else None
        points.append(BackbonePoint(float(u[peak]), float(f[peak]), later, b))
    return tuple(points)


def _failure(points: tuple[BackbonePoint, ...]) -> float | None:
    """Displacement at which straight lines between the points fall to a share of the largest force."""
    force = np.abs([p.force for p in points])
    if not force.size:
        return None
    top = int(np.argmax(force))
    level = FAILED * force[top]
    below = top + np.flatnonzero(force[top:] <= level)
    if not below.size:
        return None
    k = int(below[0])
    part = (force[k - 1] - level) / (force[k - 1] - force[k])
    return float(points[k - 1].displacement + part * (points[k].displacement - points[k - 1].displacement))
