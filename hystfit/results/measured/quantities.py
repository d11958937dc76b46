"""Engineering quantities that follow from a model: their definitions, and an estimate of one."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Callable
from typing import Any

import numpy as np

from hystfit.data.circulation import FEWEST
from hystfit.data.dataset import Dataset
from hystfit.params.units import is_energy, loop_energy, stiffness_unit
from hystfit.quality.coverage import is_switched
from hystfit.results.measured.loop_kinds import REMANENT, STRUCTURAL, LoopKind
from hystfit.results.measured.loop_origin import is_unipolar
from hystfit.results.measured.steady_loops import SteadyLoops

# Standard errors of both, and part of the measured value, by which a model's quantity must differ from it to be reported.
_APART, _VISIBLE = 2.0, 0.02


@dataclasses.dataclass(frozen=True)
class Quantity:
    """The definition of a quantity."""

    label: str  # its name in a report
    doc: str  # what it is
    # with {u}, {y}, {stiffness} and {energy} for the units of input, output, force over displacement and area of a loop
    unit: str
    # its value for each loop; None for the creep, which follows from a step
    of_loops: Callable[[SteadyLoops], np.ndarray] | None
    kinds: frozenset[LoopKind] | None = None  # of loops for which it is defined; None for all
    leads: frozenset[LoopKind] = frozenset()  # kinds in whose reports it comes first, in the order of the registry
    # kinds of loops that have a name of their own for it, and this name
    named: tuple[frozenset[LoopKind], str] = (frozenset(), "")

    def label_on(self, data: Dataset) -> str:
        """Its name on these records, in the words of their field."""
        kinds, own = self.named
        kind = LoopKind.of(data)
        if self.unit == "{energy}":
            return area_label(kind, self.units(data))
        # Capacitors are often driven on one side of zero, where no coercivity is.
        one_sided = kind is LoopKind.FERROELECTRIC and is_unipolar(np.concatenate([record.u for record in data]))
        return own if kind in kinds and not one_sided else self.label

    def units(self, data: Dataset) -> str:
        """Its unit on these records; empty where they have none."""
        u, y = data.units["u"], data.units["y"]
        force, path = (u, y) if LoopKind.of(data) is LoopKind.FORCE_DRIVEN else (y, u)
        stiffness = stiffness_unit(force, path)[0]
        text = self.unit.format(u=u, y=y, stiffness=stiffness, energy=loop_energy(u, y)[0]).strip()
        return text if (u and y) or "/" not in self.unit else ""


CREEP = "creep_percent_per_decade"
_AT = "at the middle of the {0}; of magnetic and ferroelectric loops at zero {0}, where the loop passes it"
QUANTITIES: dict[str, Quantity] = {
    "loop_area": Quantity(
        "loss per cycle", "area of the steady loop over the fitted input range", "{energy}", lambda loops: loops.loss,
        leads=REMANENT | STRUCTURAL | {LoopKind.OTHER},
    ),
    "coercive_input": Quantity(
        "half width", f"half the width of the loop, in input, {_AT.format('output')}", "{u}",
        lambda loops: loops.coercive_input, leads=REMANENT | {LoopKind.OTHER},
        named=(REMANENT, "coercivity (half width)"),
    ),
    "remanence": Quantity(
        "half height", f"half the height of the loop, in output, {_AT.format('input')}", "{y}",
        lambda loops: loops.remanence, leads=REMANENT | {LoopKind.OTHER}, named=(REMANENT, "remanence (half height)"),
    ),
    "hysteresis_percent": Quantity(
        "hysteresis (of the range)", "largest height of the loop in percent of the range of the output", "%",
        lambda loops: 100 * loops.gap.max(1) / loops.stroke, leads=frozenset({LoopKind.ACTUATOR, LoopKind.OTHER}),
        named=(frozenset({LoopKind.ACTUATOR}), "hysteresis (of the stroke)"),
    ),
    "stroke": Quantity(
        "range of the output", "range of the output over the steady loop", "{y}", lambda loops: loops.stroke,
        leads=frozenset({LoopKind.ACTUATOR}), named=(frozenset({LoopKind.ACTUATOR}), "stroke"),
    ),
    "secant_stiffness": Quantity(
        "secant stiffness", "force over displacement between the ends of the steady loop", "{stiffness}",
        lambda loops: loops.secant_stiffness, kinds=STRUCTURAL, leads=STRUCTURAL,
    ),
    "equivalent_damping_percent": Quantity(
        "equivalent damping", "damping ratio, up to 100 %: loss per cycle over 4 pi times the elastic energy at the secant stiffness", "%",
        lambda loops: loops.damping_percent, kinds=STRUCTURAL, leads=STRUCTURAL,
    ),
    CREEP: Quantity(
        "creep per decade", "change of the output from 1 s to 10 s after a step over the range, in percent of that in the first 1 s", "%",
        None,
        leads=frozenset(LoopKind),
    ),
}  # fmt: skip


def area_label(kind: LoopKind, unit: str) -> str:
    """What the area of a loop is called: a loss where its unit is that of an energy, or unknown for columns whose product is one."""
    is_loss = is_energy(unit) if unit else kind in STRUCTURAL | REMANENT
    return "loss per cycle" if is_loss else "area of the loop"


def applicable(data: Dataset, *, timed: bool) -> tuple[str, ...]:
    """Names of the quantities that records of these units have, `timed` if the model creeps; no loop where the input has two levels."""
    kind = LoopKind.of(data)
    looped = not (min(map(len, data)) >= FEWEST and is_switched([record.u for record in data]))
    return tuple(
        name
        for name, one in QUANTITIES.items()
        if (one.kinds is None or kind in one.kinds) and (timed if one.of_loops is None else looped)
    )


class Unknown(enum.StrEnum):
    """Why a quantity has no value, or no standard error."""

    NOT_FINITE = "not-finite"
    NO_CROSSING = "no-crossing"
    LOBES = "lobes"
    OVERDAMPED = "overdamped"
    NOT_DETERMINED = "not-determined"
    NO_ERRORS = "no-errors"

    @property
    def text(self) -> str:
        """The reason in words."""
        return _REASONS[self]


_REASONS = {
    Unknown.NOT_FINITE: "the model cannot be simulated on this loop",
    Unknown.NO_CROSSING: "no branch passes from one side of the output at which widths are read to the other",
    Unknown.LOBES: "the branches cross: the lobes run in opposite directions",
    Unknown.OVERDAMPED: "the damping is above the critical one: the force follows the velocity, as that of a damper",
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
        measured_stderr: standard error of that, by noise or repeats; None where it is unknown.
    """

    name: str
    value: float | None
    stderr: float | None
    unit: str
    reason: Unknown | None = None
    measured: float | None = None
    measured_stderr: float | None = None

    @property
    def differs(self) -> bool:
        """Whether the model's value is further from the measured one than both errors allow, and visibly so."""
        if self.value is None or self.stderr is None or self.measured is None:
            return False
        apart, both = abs(self.value - self.measured), float(np.hypot(self.stderr, self.measured_stderr or 0.0))
        return apart > _APART * both and apart > _VISIBLE * abs(self.measured)

    def vaguer_than(self, stderr: float | None) -> bool:
        """Whether its error is visible, and larger than that of the measured loop, or without one than `stderr`, read off other loops."""
        stderr = stderr if self.measured is None else self.measured_stderr
        if None in (self.value, self.stderr, stderr):
            return False
        return self.stderr > max(stderr, _VISIBLE * abs(self.value))  # type: ignore[operator,arg-type,type-var]

    def beside(self, value: float, stderr: float | None) -> QuantityEstimate:
        """The same beside another measured value."""
        return dataclasses.replace(self, measured=value, measured_stderr=stderr)

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`."""
        return {k: v for k, v in dataclasses.asdict(self).items() if k != "name"} | {"differs": self.differs}
