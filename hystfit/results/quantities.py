"""Quantities of the trade that follow from a model: their definitions, and the inputs on which they are computed.

The steady loop is the last of three cycles over the input range of the fit: where the record has a time, as long as its cycles and of
their waveform, sine or triangle; else triangular. The creep is that after a step over the same range, of a device that has rested at
its lower end.
"""

from __future__ import annotations

import dataclasses
import enum
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from hystfit.data.record import Dataset, Record
from hystfit.data.steady_cycle import from_turning_point
from hystfit.params.units import quantity
from hystfit.quality.loops import cycles, reversals

_CYCLES, _POINTS = 3, 400
_WHOLE = 0.01  # gap to the fitted range, in parts of it, within which a measured cycle covers it
_GRID = 2001  # inputs of the branches of a measured cycle
_GAP = 0.05  # of the output's range, between the two ends of a measured loop
_TURN = 0.05  # of the input's range: smallest reversal that ends a measured branch
_APART = 2.0  # standard errors between a model's quantity and the measured one that are worth a word
_SINE = 0.5 * (
    2**-0.5 + 3**-0.5
)  # rms over half the range, about its middle: between that of a triangle and that of a sine
_NO_CREEP = 1e-6  # % a decade
_LARGE = 0.5  # of the input's range: stroke of the cycles that count as those of the record
_RESTED = 1e5  # seconds on the lower end of the range before the step of the creep
_STEP = 0.05  # seconds between the samples of the step
_AT_1S, _AT_10S = 21, 201


class Trade(enum.StrEnum):
    """What kind of loop a record is, by the units of its input and output."""

    MAGNETIC = "magnetic"
    FERROELECTRIC = "ferroelectric"
    ACTUATOR = "actuator"
    DISPLACEMENT_DRIVEN = "displacement-driven"
    FORCE_DRIVEN = "force-driven"
    OTHER = "other"

    @classmethod
    def of(cls, data: Dataset) -> Trade:
        """The kind of the records; `OTHER` where their units are not known, or not those of a trade."""
        u, y = quantity(data.units["u"]), quantity(data.units["y"])
        for trade, inputs, outputs in _TRADES:
            if u in inputs and y in outputs:
                return trade
        return cls.OTHER


_FORCES, _PATHS = {"force", "stress"}, {"displacement", "strain"}
_TRADES = (
    (Trade.MAGNETIC, {"field", "induction", "current"}, {"moment", "magnetization", "induction", "field", "flux"}),
    (Trade.FERROELECTRIC, {"voltage", "electric field"}, {"charge", "polarization"}),
    (Trade.ACTUATOR, {"voltage", "electric field", "current", "field", "charge", "temperature", "pressure"}, _PATHS),
    (Trade.DISPLACEMENT_DRIVEN, _PATHS, _FORCES),
    (Trade.FORCE_DRIVEN, _FORCES, _PATHS),
)
_STRUCTURAL = frozenset({Trade.DISPLACEMENT_DRIVEN, Trade.FORCE_DRIVEN})
_REMANENT = frozenset({Trade.MAGNETIC, Trade.FERROELECTRIC})


@dataclasses.dataclass(frozen=True)
class SteadyLoops:
    """Steady loops over one input range.

    Attributes:
        inputs: rising, shape (P,).
        rising, falling: outputs of each loop at these inputs, shape (count, P).
        force_driven: whether the input is the force.
    """

    inputs: np.ndarray
    rising: np.ndarray
    falling: np.ndarray
    force_driven: bool = False

    @property
    def gap(self) -> Float[np.ndarray, "count P"]:
        """Height of the loop at each input."""
        return np.abs(self.falling - self.rising)

    @property
    def stroke(self) -> Float[np.ndarray, " count"]:
        """Range of the output."""
        return np.maximum(self.rising.max(1), self.falling.max(1)) - np.minimum(self.rising.min(1), self.falling.min(1))

    @property
    def width(self) -> float:
        """Range of the input."""
        return float(self.inputs[-1] - self.inputs[0])

    @property
    def area(self) -> Float[np.ndarray, " count"]:
        """Enclosed area."""
        return np.abs(np.trapezoid(self.falling - self.rising, self.inputs, axis=1))

    @property
    def travel(self) -> Float[np.ndarray, " count"]:
        """Change of the output from the lowest to the highest input."""
        ends = 0.5 * (self.rising + self.falling)
        return np.abs(ends[:, -1] - ends[:, 0])

    @property
    def coercive_input(self) -> Float[np.ndarray, " count"]:
        """Half the distance of the branches at the middle of the output."""
        middle = 0.5 * (
            np.maximum(self.rising.max(1), self.falling.max(1)) + np.minimum(self.rising.min(1), self.falling.min(1))
        )
        crossing = lambda branch: np.array([_crossing(y - m, self.inputs) for y, m in zip(branch, middle, strict=True)])
        return 0.5 * np.abs(crossing(self.rising) - crossing(self.falling))

    @property
    def remanence(self) -> Float[np.ndarray, " count"]:
        """Half the height of the loop at the middle of the input."""
        middle = 0.5 * (self.inputs[0] + self.inputs[-1])
        return 0.5 * np.array([np.interp(middle, self.inputs, row) for row in self.gap])

    @property
    def secant_stiffness(self) -> Float[np.ndarray, " count"]:
        """Force over displacement between the ends of the loop."""
        return self.width / self.travel if self.force_driven else self.travel / self.width


def _crossing(branch: np.ndarray, inputs: np.ndarray) -> float:
    """The first input at which a branch, rising or falling with the input, passes zero; NaN where it does not (a butterfly)."""
    passed = np.flatnonzero(np.signbit(branch[:-1]) != np.signbit(branch[1:]))
    if not passed.size:
        return float("nan")
    k = int(passed[0])
    return float(inputs[k] - branch[k] * (inputs[k + 1] - inputs[k]) / (branch[k + 1] - branch[k]))


@dataclasses.dataclass(frozen=True)
class Quantity:
    """The definition of a quantity.

    Attributes:
        label: its name in a report.
        doc: what it is.
        unit: with {u}, {y}, {force} and {path} for the units of input, output, force and displacement.
        of_loops: its value for each loop; None for the creep, which follows from a step.
        trades: for which it is defined; None for all.
        leads: trades in whose reports it stands at the top, in the order of the registry.
    """

    label: str
    doc: str
    unit: str
    of_loops: Callable[[SteadyLoops], np.ndarray] | None
    trades: frozenset[Trade] | None = None
    leads: frozenset[Trade] = frozenset()

    def units(self, data: Dataset) -> str:
        """Its unit on these records; empty where they have none."""
        u, y = data.units["u"], data.units["y"]
        force, path = (u, y) if Trade.of(data) is Trade.FORCE_DRIVEN else (y, u)
        text = self.unit.format(u=u, y=y, force=force, path=path).strip()
        return text if (u and y) or "/" not in text else ""


CREEP = "creep_percent_per_decade"
QUANTITIES: dict[str, Quantity] = {
    "loop_area": Quantity(
        "loss a cycle", "area of the steady loop over the fitted input range", "{y} {u}", lambda loops: loops.area,
        leads=_REMANENT | _STRUCTURAL,
    ),
    "coercive_input": Quantity(
        "coercivity (half width)", "half the width of the loop, in input, at the middle of the output", "{u}",
        lambda loops: loops.coercive_input, leads=_REMANENT | {Trade.OTHER},
    ),
    "remanence": Quantity(
        "remanence (half height)", "half the height of the loop, in output, at the middle of the input", "{y}",
        lambda loops: loops.remanence, leads=_REMANENT,
    ),
    "hysteresis_percent": Quantity(
        "hysteresis (of the stroke)", "largest height of the loop in percent of the stroke", "%",
        lambda loops: 100 * loops.gap.max(1) / loops.stroke, leads=frozenset({Trade.ACTUATOR, Trade.OTHER}),
    ),
    "stroke": Quantity(
        "stroke", "range of the output over the steady loop", "{y}", lambda loops: loops.stroke,
        leads=frozenset({Trade.ACTUATOR}),
    ),
    "secant_stiffness": Quantity(
        "secant stiffness", "force over displacement between the ends of the steady loop", "{force}/{path}",
        lambda loops: loops.secant_stiffness, trades=_STRUCTURAL, leads=_STRUCTURAL,
    ),
    "equivalent_damping_percent": Quantity(
        "equivalent damping", "damping ratio: loss a cycle over 4 pi times the elastic energy at the secant stiffness", "%",
        lambda loops: 100 * 2 * loops.area / (np.pi * loops.width * loops.travel), trades=_STRUCTURAL, leads=_STRUCTURAL,
    ),
    CREEP: Quantity(
        "creep a decade", "output between 1 s and 10 s after a step over the range, in percent of the step", "%", None,
        leads=frozenset(Trade),
    ),
}  # fmt: skip


def applicable(data: Dataset, *, timed: bool) -> tuple[str, ...]:
    """Names of the quantities that records of these units have.

    Args:
        data: fitted records.
        timed: whether the model depends on time, without which there is no creep.
    """
    trade = Trade.of(data)
    return tuple(
        name
        for name, one in QUANTITIES.items()
        if (one.trades is None or trade in one.trades) and (one.of_loops is not None or timed)
    )


class Unknown(enum.StrEnum):
    """Why a quantity has no value, or no standard error."""

    NOT_FINITE = "not-finite"
    NO_CROSSING = "no-crossing"
    NOT_DETERMINED = "not-determined"
    NO_ERRORS = "no-errors"

    @property
    def text(self) -> str:
        """The reason in words."""
        return _REASONS[self]


_REASONS = {
    Unknown.NOT_FINITE: "the model cannot be simulated on this loop",
    Unknown.NO_CROSSING: "the branches do not cross the middle of the output",
    Unknown.NOT_DETERMINED: "the data do not determine it",
    Unknown.NO_ERRORS: "the fit has no standard errors",
}


@dataclasses.dataclass(frozen=True)
class QuantityEstimate:
    """A quantity of a fit.

    Attributes:
        name, unit: what it is; its definition is in `QUANTITIES`.
        value: None where it is unknown.
        stderr: standard error to first order; None where it is unknown.
        reason: why one of them is unknown; None where both are known.
        measured: that of the measured loops, without a model; None where no measured cycle covers the fitted range.
    """

    name: str
    value: float | None
    stderr: float | None
    unit: str
    reason: Unknown | None = None
    measured: float | None = None

    @property
    def differs(self) -> bool:
        """Whether the model's value is further than two standard errors from the measured one."""
        known = self.value is not None and self.stderr is not None and self.measured is not None
        return known and abs(self.value - self.measured) > _APART * self.stderr  # type: ignore[operator]

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`."""
        return {
            "value": self.value,
            "stderr": self.stderr,
            "unit": self.unit,
            "reason": self.reason,
            "measured": self.measured,
        }


@dataclasses.dataclass(frozen=True)
class Excitation:
    """The inputs on which the quantities of a fit are computed.

    Attributes:
        low, high: range of the input.
        interval: between the samples of the cycles [s].
        trade: kind of the records.
        sine: whether the cycles of the records are nearer to a sine than to a triangle.
    """

    low: float
    high: float
    interval: float
    trade: Trade
    sine: bool = False

    @classmethod
    def of(cls, data: Dataset) -> Excitation:
        """The excitation over the range of the samples that count."""
        low = min(float(r.u[r.used].min()) for r in data)
        high = max(float(r.u[r.used].max()) for r in data)
        record, large = _cycles(data)
        if record is None or record.t is None:
            return cls(low, high, data[0].sampling_interval or 1.0, Trade.of(data))
        return cls(low, high, _interval(record.t, large), Trade.of(data), _sinusoidal(record.u, record.t, large))

    @property
    def inputs(self) -> np.ndarray:
        """Inputs of one branch, rising, shape (201,), evenly spaced in time."""
        phase = np.linspace(0.0, 1.0, _POINTS // 2 + 1)
        share = 0.5 * (1 - np.cos(np.pi * phase)) if self.sine else phase
        return self.low + (self.high - self.low) * share

    @property
    def loop(self) -> Record:
        """Three cycles of 400 samples, of which the last shows the steady loop."""
        inputs = self.inputs
        u = np.tile(np.concatenate([inputs[:-1], inputs[:0:-1]]), _CYCLES)
        return Record(u=u, y=np.zeros(u.size), t=self.interval * np.arange(u.size), name="steady loop")

    @property
    def step(self) -> Record:
        """A step over the range, of a device that has rested on its lower end; as long as `loop`, so that one program serves both."""
        size = _CYCLES * _POINTS
        u = np.concatenate([[self.low, self.low], np.full(size - 2, self.high)])
        t = np.concatenate([[0.0], _RESTED + _STEP * np.arange(size - 1)])
        return Record(u=u, y=np.zeros(size), t=t, name="step")

    def loops(self, y: np.ndarray) -> SteadyLoops:
        """The steady loops in outputs over `loop`, shape (count, T)."""
        half, y = _POINTS // 2, y[:, -_POINTS:]
        falling = np.concatenate([y[:, half:], y[:, :1]], axis=1)[:, ::-1]
        return SteadyLoops(self.inputs, y[:, : half + 1], falling, self.trade is Trade.FORCE_DRIVEN)

    @staticmethod
    def creep(y: np.ndarray) -> Float[np.ndarray, " count"]:
        """Creep a decade in percent of the step, from outputs over `step`, shape (count, T)."""
        return 100 * (y[:, _AT_10S] - y[:, _AT_1S]) / (y[:, 2] - y[:, 1])


def creeps(percent: np.ndarray) -> bool:
    """Whether a model has creep: it is not 0 at all parameter values, shape (count,), as that of a lag or a viscous term is."""
    return not bool((np.abs(percent) < _NO_CREEP).all())


def measured_quantities(data: Dataset) -> dict[str, float]:
    """Quantities of the loops as measured, by name, without a model: medians over the closed loops that cover the range of all records.

    Samples are joined by straight lines. Empty where no two successive branches cover the range and meet at both ends: a first rise from
    rest and the branch after it are no loop.
    """
    excitation = Excitation.of(data)
    inputs = np.linspace(excitation.low, excitation.high, _GRID)
    branches: dict[bool, list[np.ndarray]] = {True: [], False: []}
    for record in data.map(from_turning_point):
        turns = np.unique([0, *reversals(record.u, _TURN * float(np.ptp(record.u))), len(record) - 1]).tolist()
        found = [(bool(record.u[b] > record.u[a]), _branch(record, a, b, inputs)) for a, b in itertools.pairwise(turns)]
        for pair in itertools.pairwise(found):
            if _closed(*pair):
                for rises, branch in pair:
                    branches[rises].append(branch)
    if not branches[True]:
        return {}
    loops = SteadyLoops(inputs, *map(np.array, branches.values()), excitation.trade is Trade.FORCE_DRIVEN)
    values = {name: float(np.median(q.of_loops(loops))) for name, q in QUANTITIES.items() if q.of_loops is not None}
    return {name: value for name, value in values.items() if np.isfinite(value)}


def _closed(one: tuple[bool, np.ndarray | None], other: tuple[bool, np.ndarray | None]) -> bool:
    """Whether two successive branches cover the range, and the second ends where the first began."""
    (rises, first), (_, second) = one, other
    if first is None or second is None:
        return False
    end = 0 if rises else -1
    return bool(abs(first[end] - second[end]) <= _GAP * np.ptp(first))


def _branch(record: Record, first: int, last: int, inputs: np.ndarray) -> np.ndarray | None:
    """The measured output at inputs between two turning points; None where the branch does not cover them."""
    kept = first + np.flatnonzero(record.used[first : last + 1])
    kept = kept[np.argsort(record.u[kept], kind="stable")]
    u, slack = record.u[kept], _WHOLE * float(inputs[-1] - inputs[0])
    if not kept.size or u[0] > inputs[0] + slack or u[-1] < inputs[-1] - slack:
        return None
    return np.interp(inputs, u, record.y[kept])


def _cycles(data: Dataset) -> tuple[Record | None, np.ndarray]:
    """The first record with a time and large cycles, and these cycles; None and no cycle where there is none."""
    for record in data:
        found = np.empty((0, 3), int) if record.t is None else cycles(record.u, _LARGE * float(np.ptp(record.u)))
        if len(found):
            return record, found
    return None, np.empty((0, 3), int)


def _interval(t: np.ndarray, large: np.ndarray) -> float:
    """Sampling interval of cycles as long as the large ones of a record, shape (C, 3), with the time t."""
    return float(np.median(t[large[:, 2]] - t[large[:, 0]])) / _POINTS


def _sinusoidal(u: np.ndarray, t: np.ndarray, large: np.ndarray) -> bool:
    """Whether the large cycles of a record are nearer to a sine than to a triangle, by their rms over time about their middle."""
    shares = []
    for first, _, last in large:
        time, part = t[first : last + 1], u[first : last + 1]
        about = (part - 0.5 * (part.min() + part.max())) / (0.5 * np.ptp(part))
        shares.append(np.sqrt(np.trapezoid(about**2, time) / (time[-1] - time[0])))
    return bool(np.median(shares) > _SINE)
