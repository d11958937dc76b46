"""Which terms do the data ask for? A greedy search over the Prandtl-Ishlinskii family, judged on blocks left out.

Plays or stops, one envelope or three, the degree of the single-valued part, a lag, creep, forces of the input's rate,
hardening: given the lag all of them are columns of one linear system, so that a candidate costs one ridge solve.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.fitting.convex import LinearSystem, fit_ridge
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis, simulate
from hystfit.models.compose import Series, Sum
from hystfit.models.creep import LinearCreep
from hystfit.models.dynamics import Lag
from hystfit.models.prandtl_ishlinskii import Operator, PrandtlIshlinskii, Rest
from hystfit.models.rate import SaturatingRate, Viscous
from hystfit.params.space import ParameterSpace

_GAIN = 0.98  # a term is taken only if it lowers the error on left-out blocks by at least 2 %
_COARSE = (1e-9, 1e-7, 1e-5, 1e-3, 1e-1)
_ALL = ("identity", "square", "mirror")


@dataclasses.dataclass(frozen=True)
class Structure:
    """One candidate: which terms a model has.

    Attributes:
        operator: plays or stops.
        envelopes: 1 (symmetric) or 3.
        degree: of the single-valued part.
        rest: where the device rested before the record.
        lag: mean delay of the input, in sampling intervals; 0 for none.
        creep: logarithmic creep of the input.
        rate: 0, 1 (viscous) or 2 (and saturating).
        hardening: path, in input ranges, over which hardening fades; 0 for none.
    """

    operator: Operator = "play"
    envelopes: int = 1
    degree: int = 1
    rest: Rest = "level"
    lag: float = 0.0
    creep: bool = False
    rate: int = 0
    hardening: float = 0.0

    def words(self) -> str:
        """In words, for a report."""
        parts = [f"{self.operator}s", "3 envelopes" if self.envelopes == 3 else "1 envelope", f"degree {self.degree}"]
        parts += [f"lag {self.lag:g} samples"] if self.lag else []
        parts += ["creep"] if self.creep else []
        parts += [("", "viscous", "viscous and saturating force")[self.rate]] if self.rate else []
        parts += [f"hardening over {self.hardening:g} ranges"] if self.hardening else []
        parts += ["at rest on the first input"] if self.rest == "first" else []
        return ", ".join(parts)


@dataclasses.dataclass(frozen=True)
class Found:
    """What the search found.

    Attributes:
        model: started on the data, ready for `fit(..., start="model")`.
        structure: its terms.
        plays: number of thresholds.
        score: root mean square error on left-out blocks, output units.
        tried: number of candidates.
        trail: each step taken, in words.
    """

    model: AbstractHysteresis
    structure: Structure
    plays: int
    score: float
    tried: int
    trail: tuple[str, ...]

    def resized(self, data: Dataset, plays: int) -> Found:
        """The same structure with another number of plays."""
        score = _Bench(data, plays).score(self.structure)
        return dataclasses.replace(self, model=build(self.structure, data, plays), plays=plays, score=score)


def search_structure(data: Dataset, *, plays: int = 20) -> Found:
    """Start from plays with one envelope and take, while it pays, the single change that lowers the left-out error most.

    Args:
        data: records; only samples that count are fitted or judged.
        plays: number of thresholds.
    """
    bench = _Bench(data, plays)
    options = bench.options()
    structure, score = min(((s, bench.score(s)) for s in map(Structure, ("play", "stop"))), key=lambda pair: pair[1])
    trail = [f"{structure.operator}s"]
    while True:
        changes = [
            dataclasses.replace(structure, **{field: value})
            for field, values in options.items()
            for value in values
            if value != getattr(structure, field)
        ]
        best = min(changes, key=bench.score)
        if bench.score(best) >= _GAIN * score:
            break
        changed = next(f for f in options if getattr(best, f) != getattr(structure, f))
        trail.append(
            f"{changed} {getattr(best, changed)} reduced the cross-validation error by {100 * (1 - bench.score(best) / score):.0f} %"
        )
        structure, score = best, bench.score(best)
    return Found(build(structure, data, plays), structure, plays, score, len(bench.scores), tuple(trail))


def build(structure: Structure, data: Dataset, plays: int) -> AbstractHysteresis:
    """The model of a structure, started on the data.

    Args:
        structure: its terms.
        data: records.
        plays: number of thresholds.
    """
    play = PrandtlIshlinskii.of(
        plays,
        structure.degree,
        envelopes=_ALL[: structure.envelopes],
        operator=structure.operator,
        hardening=structure.hardening > 0,
        rest=structure.rest,
    )
    if structure.hardening:
        play = eqx.tree_at(lambda m: m.s0, play, jnp.asarray(structure.hardening))
    parts: list[AbstractHysteresis] = [play]
    if structure.creep:
        parts.append(LinearCreep(rest=structure.rest))
    parts += [Viscous(), SaturatingRate()][: structure.rate]
    lag = Lag(tau=structure.lag * _interval(data), rest=structure.rest) if structure.lag else None
    records = list(data) if lag is None else [_through(lag, record) for record in data]
    # Every part takes its ranges from the records themselves: the weights are solved together.
    started = [part.start(records) for part in parts]
    model = started[0] if len(parts) == 1 else Sum(*started)
    return model if lag is None else Series(lag, model)


def _interval(data: Dataset) -> float:
    return data.sampling_interval or 0.0


def _through(lag: Lag, record: Record) -> Record:
    return record.replace(u=np.asarray(simulate(lag, jnp.asarray(record.u), jnp.asarray(record.dt))[0]))


class _Bench:
    """Columns of every term, computed once for each lag and rest, and the scores of the structures tried."""

    def __init__(self, data: Dataset, plays: int):
        self.data, self.plays = data, plays
        self.timed = _interval(data) > 0 and all(record.t is not None for record in data)
        self.scores: dict[Structure, float] = {}

    def options(self) -> dict[str, tuple[Any, ...]]:
        """Values of each field that these data allow."""
        options: dict[str, tuple[Any, ...]] = {"operator": ("play", "stop"), "envelopes": (1, 3), "degree": (1, 3, 5)}
        span = max(float(np.ptp(record.u)) for record in self.data)
        if any(abs(record.u[0]) > 1e-3 * span for record in self.data):
            options["rest"] = ("level", "first")
        if self.timed:
            # Lags up to six samples; hardening would stand in for what creep and rate describe.
            return {**options, "lag": (0.0, *np.arange(1.0, 6.1, 0.5)), "creep": (False, True), "rate": (0, 1, 2)}
        return {**options, "hardening": (0.0, 1.0, 3.0, 10.0)}

    def score(self, structure: Structure) -> float:
        """Root mean square error on blocks left out, output units."""
        if structure not in self.scores:
            self.scores[structure] = fit_ridge(self.system(structure), _COARSE).score
        return self.scores[structure]

    def system(self, s: Structure) -> LinearSystem:
        """The linear system of a structure: its columns out of the columns of the largest."""
        whole, groups = self._plays(s.rest, s.lag, s.operator, s.hardening)
        at = groups["w"][: s.envelopes * self.plays] + groups["b"][: s.degree] + groups["offset"]
        at += groups["hardening"] if s.hardening else []
        beside = ["creep"] * s.creep + ["viscous", "saturating"][: s.rate]
        parts = [whole.take(at), *(self._beside(term, s.rest, s.lag) for term in beside)]
        join = lambda name: np.concatenate([getattr(part, name) for part in parts], axis=-1)
        return LinearSystem(join("columns"), whole.target, join("free"), join("ridged"), whole.block, whole.weight)

    @functools.cache  # noqa: B019  (the bench lives as long as one search)
    def _beside(self, term: str, rest: Rest, lag: float) -> LinearSystem:
        part: AbstractHysteresis = {
            "creep": LinearCreep(rest=rest),
            "viscous": Viscous(),
            "saturating": SaturatingRate(),
        }[term]
        return self._respond(part, rest, lag)[1]

    @functools.cache  # noqa: B019  (the bench lives as long as one search)
    def _plays(
        self, rest: Rest, lag: float, operator: Operator, fade: float
    ) -> tuple[LinearSystem, dict[str, list[int]]]:
        model = PrandtlIshlinskii.of(self.plays, 5, envelopes=_ALL, operator=operator, hardening=True, rest=rest)
        model = eqx.tree_at(lambda m: m.s0, model, jnp.asarray(fade or 1.0))
        problem, system = self._respond(model, rest, lag)
        groups: dict[str, list[int]] = {"w": [], "b": [], "offset": [], "hardening": []}
        for k, name in enumerate(problem.space.names):
            groups[name.partition("[")[0].partition("@")[0]].append(k)
        return system, groups

    def _respond(self, part: AbstractHysteresis, rest: Rest, lag: float) -> tuple[Problem, LinearSystem]:
        data = self.data
        if lag:
            through = Lag(tau=lag * _interval(data), rest=rest)
            data = Dataset(tuple(_through(through, record) for record in data))
        part = part.start(list(data))
        space = ParameterSpace.of(part)
        problem = Problem(
            part, data, fix=[n for n, info in zip(space.names, space.infos, strict=True) if not info.linear]
        )
        return problem, LinearSystem.of(problem, problem.space.vector(problem.model))
