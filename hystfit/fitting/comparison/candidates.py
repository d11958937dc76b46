"""Which models a comparison tries: every family that the records can drive, in an order that gives an answer early."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from hystfit.data.circulation import FOLLOWS, circulation, trend
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.data.two_levels import has_two_levels
from hystfit.errors import HystfitError
from hystfit.fitting.structure.model_structure import Structure, falls, on_falling_line
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import MODELS, SEARCH, make_model, tried
from hystfit.quality.baselines import Baselines
from hystfit.quality.faults import CLEAR, noise_rms
from hystfit.quality.loops import SPEEDS_APART, distinct, turns_back
from hystfit.quality.needs import Needs
from hystfit.quality.shape import NARROWEST
from hystfit.quality.summary import speeds_of, speeds_within
from hystfit.results.measured.loop_kinds import LoopKind, may_be_force

# Error of ten plays over that of a single-valued curve, from which weights of either sign are tried on loops of either direction: at most
# 0.44 on simulated stops and Bouc-Wen springs, 0.55 to 1.7 on force curves of probes and keys, charge curves and voltammograms.
_LEFT = 0.5


@dataclasses.dataclass(frozen=True)
class Candidates:
    """Models that a comparison tries, in order.

    The weights of `closed` ones follow from a linear solve, in a tenth of a second each; `iterated` ones are searched for, of which the
    `resonant` take longest. `late` ones, which need more speeds than the long branches have, and the `last`, for loops of the other
    direction that describe these too, are tried only where the others leave more than noise.
    """

    closed: tuple[str, ...]
    iterated: tuple[str, ...] = ()
    resonant: tuple[str, ...] = ()
    late: tuple[str, ...] = ()
    last: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """All but the last."""
        return (*self.closed, *self.iterated, *self.resonant, *self.late)

    def timed_late(self) -> Candidates:
        """The same with the iterated models that depend on time behind the others."""
        early = timeless(self.iterated)
        late = tuple(name for name in self.iterated if name not in early)
        return dataclasses.replace(self, iterated=early, late=(*late, *self.late))

    def beside(self, found: Structure, delay: bool) -> Candidates:
        """The same after the search, with the terms and the pure delay that it found before and beside the iterated models too."""
        before = "delay+" * delay + "negate+" * found.falls
        around = lambda name: f"{before}{name}" + "+linear" * found.line
        lagged = (f"{before}lag+preisach",) if found.lag and len(self.closed) > 1 else ()  # none without a loop
        others = (tuple(map(around, names)) for names in (self.iterated, self.resonant, self.late))
        return Candidates(lagged, *others, self.last)


def timeless(names: Sequence[str]) -> tuple[str, ...]:
    """Those of the models that do not depend on time."""
    return tuple(name for name in names if make_model(name).rate_independent)


def candidates(data: Dataset) -> Candidates:
    """Models that the records can drive."""
    models = {name: make_model(name) for name in tried()}
    if not turns_back(data):  # without a turn of the input there is no loop but that of reversal curves
        curves = [name for name, model in models.items() if model.from_saturation and _drives(model, data)]
        # Free masses take a tenth of the time of bounded ones, and their error may tell that these cannot win.
        return Candidates(tuple(sorted(curves, key=lambda name: models[name].has_inverse)) or (SEARCH,))
    if all(has_two_levels(record.y[record.used]) for record in data):  # no other model has two levels alone
        return Candidates(tuple(name for name, model in models.items() if model.jumps and "+" not in name))
    timed = all(record.t is not None for record in data)
    speeds = len(distinct((v for record in data for v in speeds_of(record)), SPEEDS_APART))
    within = speeds_within(data)
    contrary, suits, baselines = _contrary(data), suited(data), Baselines.of(data)
    able = {
        name: model
        for name, model in models.items()
        if not model.from_saturation
        and (timed or model.rate_independent)
        and within >= _speeds_needed(name)
        and all(map(suits, _needs(name)))
        and (contrary not in {need.direction for need in _needs(name)} or model.either_way)
    }
    against = [name for name in able if contrary in {need.direction for need in _needs(name)}]
    # At contacts, stops and peaks plays leave much of the loops, and only weights of either sign may do.
    plays_fail = baselines.plays is not None and baselines.plays > _LEFT * baselines.curve
    last = () if plays_fail else tuple(against)
    able = {name: model for name, model in able.items() if name not in last}
    # Some models are tried both ways, unless the loop shows which way they dissipate energy.
    both_ways = {part for name in able if name.startswith("negate+") for part in (name, name.removeprefix("negate+"))}
    if way := _dissipated(data):
        able = {
            name: model
            for name, model in able.items()
            if name not in both_ways or name.startswith("negate+") == (way > 0)
        }
    either = lambda name, model: model.either_way or not model.has_inverse or name in both_ways
    before = lambda name, model: "negate+" if falls(data) and not either(name, model) else ""
    line = lambda model: "+linear" if on_falling_line(data) and not model.either_way else ""
    late = tuple(name for name in able if speeds < _speeds_needed(name))
    closed = {
        name: before(name, model) + name + line(model)
        for name, model in able.items()
        if model.estimator in ("preisach", "convex", "switching") and name not in late
    }
    rings = lambda name, model: model.output_resonance() is not None or any(need.dynamics for need in _needs(name))
    resonant = tuple(name for name, model in able.items() if name not in closed and rings(name, model))
    others = tuple(name for name in able if name not in (*closed, *resonant, *late))
    return Candidates((SEARCH, *closed.values()), others, resonant, late, last)


def suited(data: Dataset) -> Callable[[Needs], bool]:
    """Whether a model that needs this may describe such quantities: laws of magnetization and of forces describe no others."""
    magnetic, force = LoopKind.of(data) is LoopKind.MAGNETIC, may_be_force(data)
    return lambda need: (magnetic or not need.magnetic) and (force or not need.force)


def _drives(model: AbstractHysteresis, data: Dataset) -> bool:
    """Whether the records are such that the model can be started on them."""
    try:
        model.start(list(data))
    except HystfitError:
        return False
    return True


def _contrary(data: Dataset) -> str:
    """The direction against which the loops of most records run; "" where noise or an output that follows the speed hides it."""
    follows = lambda record: abs(trend(record.u[record.used], record.y[record.used])) >= FOLLOWS
    way = float(np.median([_way(record) if follows(record) else 0.0 for record in data]))
    return "" if abs(way) < 1 else "clockwise" if way > 0 else "counter-clockwise"


def _dissipated(data: Dataset) -> int:
    """1 or -1 where most loops run counter-clockwise or clockwise by more than noise can make them, else 0."""
    way = float(np.median([_way(record, mirrored=False) for record in data]))
    return 0 if abs(way) < 1 else int(np.sign(way))


def _way(record: Record, *, mirrored: bool = True) -> float:
    """Which way a loop runs: positive for an output that lags, 1 or more where noise cannot turn it; `mirrored` as of `circulation`."""
    u, y = record.u[record.used], record.y[record.used]
    # The area is a sum of outputs, each weighed by the step of the input around it.
    error = (noise_rms(y)[0] or 0.0) / np.ptp(y) * np.sqrt(np.sum(np.gradient(u) ** 2)) / np.ptp(u)
    return circulation(u, y, mirrored=mirrored) / max(CLEAR * error, NARROWEST)


def _needs(name: str) -> list[Needs]:
    """What the parts of a model need; of a variant that `check` does not judge apart, what its family needs."""
    models = [MODELS[part.partition(":")[0]].default for part in name.split("+")]
    of_family = lambda model: (vars(kind).get("needs") for kind in type(model).__mro__)
    needs = [
        model.needs or next((found for found in of_family(model) if isinstance(found, Needs)), None) for model in models
    ]
    return [need for need in needs if need is not None]


def _speeds_needed(name: str) -> int:
    """Number of speeds of the input without which parameters of a model stay undetermined."""
    return max((need.speeds for need in _needs(name) if need.rate), default=0)
