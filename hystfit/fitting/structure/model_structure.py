"""One candidate of the search for terms: which a Prandtl-Ishlinskii model has, and that model."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from hystfit.data.circulation import trend
from hystfit.data.dataset import Dataset
from hystfit.models.base import AbstractHysteresis, Rest
from hystfit.models.creep import LinearCreep
from hystfit.models.curve import Curve
from hystfit.models.dynamics import Delay, Lag
from hystfit.models.linear import Linear
from hystfit.models.negate import Negate
from hystfit.models.prandtl_ishlinskii import Operator, PrandtlIshlinskii
from hystfit.models.rate import SaturatingRate, Viscous
from hystfit.models.series import Series
from hystfit.models.sum import Sum

Form = Operator | Literal["curve"]


@dataclasses.dataclass(frozen=True)
class Structure:
    """One candidate: which terms a model has."""

    operator: Form = "play"  # plays, stops, or a single-valued curve in their place, whose knots count as plays
    envelopes: int = 1  # 1 (symmetric) or 3
    degree: int = 1  # of the single-valued part
    rest: Rest = "level"  # where the device rested before the record
    falls: bool = False  # the input is negated first: the output falls as the input rises
    line: bool = False  # a straight line of either sign beside plays, which alone only rise (stops have one)
    lag: float = 0.0  # mean delay of the input, in sampling intervals; 0 for none
    order: int = 2  # of the lag, 1 or 2
    creep: bool = False  # logarithmic creep of the input
    rate: int = 0  # 0, 1 (viscous) or 2 (and saturating)
    hardening: int = 0  # path, in input ranges, over which hardening fades; 0 for none

    @property
    def elements(self) -> str:
        """Plural name of what is counted as plays."""
        return "knots" if self.operator == "curve" else f"{self.operator}s"

    @property
    def timed(self) -> bool:
        """Whether a term depends on time."""
        return self.lag > 0 or self.creep or self.rate > 0

    def columns(self, plays: int, records: int) -> int:
        """Number of weights with this many plays, one offset per record included."""
        return (
            plays * (self.envelopes + (self.hardening > 0)) + self.degree + records + self.line + self.creep + self.rate
        )

    def change_from(self, other: Structure) -> str:
        """The first term in which it differs from another structure, in words."""
        envelopes = (
            "one envelope for symmetric loops" if self.envelopes == 1 else "three envelopes for asymmetric loops"
        )
        hardening = (
            f"hardening over {self.hardening} input range{'s' if self.hardening > 1 else ''}"
            if self.hardening
            else "leaving out the hardening"
        )
        rates = ("leaving out forces of the rate", "a viscous force", "a viscous and a saturating force")
        words = {
            "operator": f"{self.operator}s instead of {other.operator}s",
            "envelopes": envelopes,
            "degree": f"a single-valued part of degree {self.degree}",
            "rest": f"rest at the {'first input' if self.rest == 'first' else 'input 0'} before the record",
            "line": f"{'adding' if self.line else 'leaving out'} a straight line",
            "lag": f"a lag of {self.lag:g} samples" if self.lag else "leaving out the lag",
            "order": f"a lag of order {self.order}",
            "creep": f"{'adding' if self.creep else 'leaving out'} creep",
            "rate": rates[self.rate],
            "hardening": hardening,
        }
        return next(text for field, text in words.items() if getattr(self, field) != getattr(other, field))

    def differs_in_lag(self, other: Structure) -> bool:
        """Whether both are equal but for their lags."""
        return self != other and dataclasses.replace(self, lag=other.lag) == other


def structure_of(model: AbstractHysteresis) -> tuple[Structure, bool]:
    """What the model of a search has before and beside its plays, but for values, and whether it has a pure delay."""
    parts = [leaf for part in getattr(model, "parts", (model,)) for leaf in getattr(part, "parts", (part,))]
    has = lambda kind: any(isinstance(part, kind) for part in parts)
    rate = int(has(Viscous)) + int(has(SaturatingRate))
    terms = Structure(falls=has(Negate), line=has(Linear), lag=float(has(Lag)), creep=has(LinearCreep), rate=rate)
    return terms, has(Delay)


def build(structure: Structure, data: Dataset, plays: int) -> AbstractHysteresis:
    """The model of a structure, started on the data."""
    parts: list[AbstractHysteresis] = [
        Curve.of(plays)
        if structure.operator == "curve"
        else PrandtlIshlinskii.of(
            plays,
            structure.degree,
            envelopes=structure.envelopes,
            operator=structure.operator,
            hardening=structure.hardening,
            rest=structure.rest,
        )
    ]
    if structure.creep:
        parts.append(LinearCreep(rest=structure.rest))
    parts += [Viscous(), SaturatingRate()][: structure.rate]
    if structure.line:
        parts.append(Linear())
    before: list[AbstractHysteresis] = [Negate()] * structure.falls
    if structure.lag:
        before.append(Lag(tau=structure.lag * interval_of(data), rest=structure.rest, order=structure.order))
    records = list(data)
    for part in before:
        records = [record.replace(u=part.free_run(record.u, record.dt)) for record in records]
    # Every part takes its ranges from the records themselves: the weights are solved together.
    started = [part.start(records) for part in parts]
    model = started[0] if len(parts) == 1 else Sum(*started)
    return Series(*before, model) if before else model


def falls(data: Dataset) -> bool:
    """Whether the output falls as the input rises, apart from a line that falls beneath a loop that rises."""
    used = ((record.u[record.used], record.y[record.used]) for record in data)
    return bool(sum(trend(u, y) * np.std(u) * np.std(y) for u, y in used) < 0)


def on_falling_line(data: Dataset) -> bool:
    """Whether a loop that rises stands on a line that falls more, as that of a film on its diamagnetic substrate does."""
    used = ((record.u[record.used], record.y[record.used]) for record in data)
    return bool(sum(np.cov(u, y)[0, 1] for u, y in used) < 0) and not falls(data)


def interval_of(data: Dataset) -> float:
    """Sampling interval, 0 without time."""
    return data.sampling_interval or 0.0
