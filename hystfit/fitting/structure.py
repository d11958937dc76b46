"""Greedy search for the terms of a Prandtl-Ishlinskii model, judged on blocks left out.

Plays or stops, one envelope or three, the degree of the single-valued part, a lag, creep, forces of the input's rate,
hardening: given the lag all of them are columns of one linear system, so that a candidate costs one ridge solve.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.polynomial.legendre import legvander

from hystfit.data.batch import bucket
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.fitting.convex import LinearSystem, block_of, fit_ridge
from hystfit.inference.problem import check_fittable
from hystfit.models.base import AbstractHysteresis
from hystfit.models.creep import LinearCreep
from hystfit.models.dynamics import Delay, Lag
from hystfit.models.negate import Negate
from hystfit.models.play_columns import play_columns, rising_columns
from hystfit.models.prandtl_ishlinskii import Envelope, Operator, PrandtlIshlinskii, Rest, envelope
from hystfit.models.rate import SaturatingRate, Viscous
from hystfit.models.registry import model_name
from hystfit.models.series import Series
from hystfit.models.simulation import simulate
from hystfit.models.starting import fitted_input_range, output_range
from hystfit.models.sum import Sum
from hystfit.outcome import Code, Note
from hystfit.quality.baselines import rounding_error
from hystfit.quality.determination import delayed, falling
from hystfit.quality.slow_lag import SHORT
from hystfit.quality.summary import summarize

_GAIN = 0.98  # a term is taken only if it lowers the error on left-out data by at least 2 %
_CLEARLY = 0.8  # of the error at a lag, below which a finer lag is taken before any other term
_DEGREES = (1, 3, 5)
_COARSE = (1e-9, 1e-7, 1e-5, 1e-3, 1e-1)
_ALL = get_args(Envelope)
_PLAYS, _OTHER_PLAYS = 20, (10, 40)  # of the search for terms; numbers tried with the terms found
_FEWEST_RANGES = 4  # that the input runs through, so that later cycles can differ from the first one
_FEWEST = 3  # plays, however few the samples are
# Terms besides plays and stops, and the name of their weight.
_BESIDE: dict[str, tuple[type[AbstractHysteresis], str]] = {
    "creep": (LinearCreep, "a[0]"),
    "viscous": (Viscous, "c"),
    "saturating": (SaturatingRate, "F"),
}
_ABOUT = np.geomspace(0.7, 1.4, 5)  # lags that are tried, over that which the records show
_HALF = 0.5  # samples between the lags that are tried
_LEVELS = 200  # inputs closer than this fraction of their range count as one


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
    hardening: int = 0

    def columns(self, plays: int, records: int) -> int:
        """Number of weights with this many plays, one offset per record included."""
        return plays * (self.envelopes + (self.hardening > 0)) + self.degree + records + self.creep + self.rate

    def change_from(self, other: Structure) -> str:
        """The one term in which it differs from another structure, in words."""
        envelopes = (
            "one envelope for symmetric loops" if self.envelopes == 1 else "three envelopes for asymmetric loops"
        )
        hardening = f"hardening over {self.hardening} input ranges" if self.hardening else "leaving out the hardening"
        rates = ("leaving out forces of the rate", "a viscous force", "a viscous and a saturating force")
        words = {
            "operator": f"{self.operator}s instead of {other.operator}s",
            "envelopes": envelopes,
            "degree": f"a single-valued part of degree {self.degree}",
            "rest": f"rest at the {'first input' if self.rest == 'first' else 'input 0'} before the record",
            "lag": f"a lag of {self.lag:g} samples" if self.lag else "leaving out the lag",
            "creep": f"{'adding' if self.creep else 'leaving out'} creep",
            "rate": rates[self.rate],
            "hardening": hardening,
        }
        return next(text for field, text in words.items() if getattr(self, field) != getattr(other, field))


@dataclasses.dataclass(frozen=True)
class Found:
    """Result of the structure search.

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

    def notes(self) -> tuple[Note, ...]:
        """The choice, and each step towards it."""
        first = f"{model_name(self.model)} is the best of {self.tried} combinations of terms by cross-validation"
        return tuple(Note(Code.CHOICE, text) for text in (first, *self.trail))


def search_structure(data: Dataset, *, plays: int | None = None) -> Found:
    """Search for the terms of a model: on the delayed or negated input where the output has a delay or falls as the input rises."""
    records = [summarize(record) for record in data]
    lag = max(record.slow_lag or 0.0 for record in records)
    before = [Delay().start(list(data))] * delayed(records) + [Negate()] * falling(records)
    if not before:
        return search_rising(data, plays=plays, lag=lag)
    for part in before:
        data = data.map(lambda record, part=part: record.replace(u=_output(part, record)))
    found = search_rising(data, plays=plays, lag=lag)
    parts = found.model.parts if isinstance(found.model, Series) else (found.model,)
    return dataclasses.replace(found, model=Series(*before, *parts))


def search_rising(data: Dataset, *, plays: int | None = None, lag: float = 0.0) -> Found:
    """Greedy search from plays with one envelope: repeat the single change that lowers the cross-validation error most.

    Args:
        plays: number of thresholds; by default blocks left out choose it among those that the data can determine.
        lag: about which lags are tried too, where the records have one longer than those tried on all [samples].
    """
    check_fittable(PrandtlIshlinskii.of(1), data)
    most = max_plays(data)
    terms = Terms(data, min(_PLAYS, most) if plays is None else plays)
    options = terms.options(lag)
    structure, score = min(((s, terms.score(s)) for s in map(Structure, get_args(Operator))), key=lambda pair: pair[1])
    trail: list[str] = []
    # Rounding errors recur where the cycles repeat: terms that describe them would also lower the error on left-out cycles.
    rounding = rounding_error(data)
    while score > rounding:
        best = _next(structure, score, terms, options)
        if terms.score(best) >= _GAIN * score:
            break
        trail.append(_step(best.change_from(structure), score, terms.score(best), terms.span))
        structure, score = best, terms.score(best)
    tried, chosen = len(terms.scores), terms.plays
    for other in _OTHER_PLAYS if plays is None and score > rounding else ():
        resized = Terms(data, other)
        if other > most or other == terms.plays or not resized.served(structure):
            continue
        tried += 1
        if resized.score(structure) < _GAIN * score:
            trail.append(
                _step(f"{other} instead of {chosen} {structure.operator}s", score, resized.score(structure), terms.span)
            )
            chosen, score = other, resized.score(structure)
    return Found(build(structure, data, chosen), structure, chosen, score, tried, tuple(trail))


def _next(structure: Structure, score: float, terms: Terms, options: dict[str, tuple[Any, ...]]) -> Structure:
    """The structure with one change whose error is least; one with a finer lag where that is clearly better, or nothing else helps."""
    # With other terms another lag may be the right one: a finer lag must not keep them out.
    near = dataclasses.replace(structure, lag=round(structure.lag / _HALF) * _HALF)
    changes = [
        changed
        for old in dict.fromkeys((structure, near))
        for field, values in options.items()
        for value in values
        if value != getattr(old, field) and terms.served(changed := dataclasses.replace(old, **{field: value}))
    ]
    best = min(changes, key=terms.score, default=structure)
    finer = dataclasses.replace(structure, lag=terms.lag_between(structure)) if structure.lag else structure
    clearly = terms.score(finer) < _CLEARLY * score
    return finer if clearly or terms.score(best) >= _GAIN * score else best


def max_plays(data: Dataset) -> int:
    """Number of thresholds that the samples and the distinct levels of the input can determine."""
    samples = sum(int(record.used.sum()) for record in data)
    inputs = np.concatenate([record.u[record.used] for record in data])
    levels = np.unique(np.round(_LEVELS * inputs / (float(np.ptp(inputs)) or 1.0))).size
    return max(_FEWEST, min(samples // 8, levels // 2, max(_OTHER_PLAYS)))


def _step(change: str, before: float, after: float, span: float) -> str:
    before, after = 100 * before / span, 100 * after / span
    digits = max(0, 1 - int(np.floor(np.log10(after)))) if after > 0 else 2
    return (
        f"{change} reduced the cross-validation error by {100 * (1 - after / before):.0f} %, from {before:.{digits}f} to "
        f"{after:.{digits}f} % of the range"
    )


def build(structure: Structure, data: Dataset, plays: int) -> AbstractHysteresis:
    """The model of a structure, started on the data."""
    play = PrandtlIshlinskii.of(
        plays,
        structure.degree,
        envelopes=structure.envelopes,
        operator=structure.operator,
        hardening=structure.hardening,
        rest=structure.rest,
    )
    parts: list[AbstractHysteresis] = [play]
    if structure.creep:
        parts.append(LinearCreep(rest=structure.rest))
    parts += [Viscous(), SaturatingRate()][: structure.rate]
    lag = Lag(tau=structure.lag * _interval(data), rest=structure.rest) if structure.lag else None
    records = list(data) if lag is None else [record.replace(u=_output(lag, record)) for record in data]
    # Every part takes its ranges from the records themselves: the weights are solved together.
    started = [part.start(records) for part in parts]
    model = started[0] if len(parts) == 1 else Sum(*started)
    return model if lag is None else Series(lag, model)


def _interval(data: Dataset) -> float:
    return data.sampling_interval or 0.0


def _output(model: AbstractHysteresis, record: Record) -> np.ndarray:
    """Output of a model over a record, by one program for records of similar length."""
    extra = bucket(len(record)) - len(record)
    u, dt = np.pad(record.u, (0, extra), mode="edge"), np.pad(record.dt, (0, extra))
    return np.asarray(simulate(model, u, dt)[0])[: len(record)]


class _Term(NamedTuple):
    """Weighted columns of one array of weights, shape (n, k), whether these have no lower bound, and whether a ridge acts on them."""

    columns: np.ndarray
    free: bool
    ridged: bool = True


class Terms:
    """Columns of every term, computed once for each lag and rest, and the scores of the structures tried."""

    def __init__(self, data: Dataset, plays: int):
        self.data, self.plays = data, plays
        self.thresholds = np.asarray(PrandtlIshlinskii.of(plays).r)
        self.timed = _interval(data) > 0 and all(record.t is not None for record in data)
        self.span = output_range(data).width
        self.used = np.concatenate([record.used for record in data])
        self.weight = np.concatenate([record.weight for record in data])[self.used]
        self.samples = self.weight.size
        self.scores: dict[Structure, float] = {}
        # On the instance: a cache of the class would keep the columns of every search of the process.
        self._lagged, self._positions = functools.cache(self._lagged_data), functools.cache(self._positions_of)
        self._elements, self._single = functools.cache(self._element_columns), functools.cache(self._single_valued)
        self._beside = functools.cache(self._beside_plays)

    def served(self, structure: Structure) -> bool:
        """Whether there are two samples for each weight."""
        return 2 * structure.columns(self.plays, len(self.data)) <= self.samples

    def options(self, lag: float = 0.0) -> dict[str, tuple[Any, ...]]:
        """Values of each field that these data allow; for `lag` see `search_rising`."""
        options: dict[str, tuple[Any, ...]] = {"operator": ("play", "stop"), "envelopes": (1, 3), "degree": _DEGREES}
        span = max(float(np.ptp(record.u)) for record in self.data)
        if any(abs(record.u[0]) > 1e-3 * span for record in self.data):
            options["rest"] = ("level", "first")
        if self.timed:
            # Hardening would stand in for what creep and rate describe.
            lags = (
                0.0,
                *np.arange(1.0, SHORT + 0.1, _HALF).tolist(),
                *(np.round(_ABOUT * lag, 1).tolist() if lag else ()),
            )
            return {**options, "lag": lags, "creep": (False, True), "rate": (0, 1, 2)}
        if max(float(np.abs(np.diff(record.u)).sum()) for record in self.data) < _FEWEST_RANGES * span:
            return options
        return {**options, "hardening": (0, 1, 3, 10)}

    def score(self, structure: Structure) -> float:
        """Root mean square error on blocks left out, output units; infinite where plays have a force against the rate beside them.

        Such a force describes a lag by an output that falls as the input jumps up, which has no inverse; `lag` describes it with one.
        """
        if structure not in self.scores:
            fitted = fit_ridge(self.system(structure), _COARSE)
            forces = fitted.weights[fitted.weights.size - structure.rate :]
            against = structure.operator == "play" and bool((forces < 0).any())
            self.scores[structure] = np.inf if against else fitted.score
        return self.scores[structure]

    def lag_between(self, structure: Structure) -> float:
        """The lag at which a parabola through the squared errors at this lag and half a sample to either side is least [samples].

        Half a sample off, the error is several times that of the right lag, and terms of a higher degree would seem to be needed.
        """
        sides = [dataclasses.replace(structure, lag=structure.lag + step) for step in (-_HALF, 0.0, _HALF)]
        low, middle, high = (self.score(side) ** 2 for side in sides)
        bend = low - 2 * middle + high
        shift = 0.5 * _HALF * (low - high) / bend if np.isfinite(bend) and bend > 0 else 0.0
        return float(np.round(structure.lag + np.clip(shift, -_HALF, _HALF), 2))

    def system(self, s: Structure) -> LinearSystem:
        """The linear system of a structure, joined from the columns of its terms."""
        terms = [_Term(self._elements(s.rest, s.lag, s.operator, kind), False) for kind in _ALL[: s.envelopes]]
        terms += [self._single(s.rest, s.lag, s.operator, s.degree), self._offset]
        if s.hardening:
            terms.append(self._hardening(s.rest, s.lag, s.operator, s.hardening))
        terms += [
            self._beside(term, s.rest, s.lag) for term in ["creep"] * s.creep + ["viscous", "saturating"][: s.rate]
        ]
        each = lambda name: np.concatenate([np.full(term.columns.shape[1], getattr(term, name)) for term in terms])
        # With all weights at zero every term is zero: the target is the output itself.
        y = np.concatenate([record.y for record in self.data])
        columns, target = np.hstack([term.columns for term in terms]), self._weighted(y)
        return LinearSystem(columns, target, each("free"), each("ridged"), self._block, self.weight)

    def _weighted(self, rows: np.ndarray) -> np.ndarray:
        """The rows of samples that count, times the roots of their weights."""
        root = np.sqrt(self.weight)
        return rows[self.used] * (root if rows.ndim == 1 else root[:, None])

    @functools.cached_property
    def _block(self) -> np.ndarray:
        return block_of(np.array([np.count_nonzero(record.used) for record in self.data]))

    @functools.cached_property
    def _offset(self) -> _Term:
        """One column of ones per record."""
        record = np.repeat(np.arange(len(self.data)), [len(record) for record in self.data])
        return _Term(self._weighted(np.eye(len(self.data))[record]), free=True, ridged=False)

    def _lagged_data(self, rest: Rest, lag: float) -> Dataset:
        """The records with the input behind the lag."""
        through = Lag(tau=lag * _interval(self.data), rest=rest)
        return self.data.map(lambda record: record.replace(u=_output(through, record))) if lag else self.data

    def _positions_of(self, rest: Rest, lag: float) -> list[tuple[np.ndarray, float]]:
        """Input of each record as a fraction of the range, and where it rested before."""
        records = list(self._lagged(rest, lag))
        place = fitted_input_range(records)
        low, high = place.center - place.half, place.center + place.half
        inputs = [(record.u - low) / (high - low) for record in records]
        return [(x, float(x[0]) if rest == "first" else -low / (high - low)) for x in inputs]

    def _element_columns(self, rest: Rest, lag: float, operator: Operator, kind: Envelope) -> np.ndarray:
        """Plays or stops of one envelope."""
        rows = []
        for x, before in self._positions(rest, lag):
            e = envelope(kind, x)
            plays = play_columns(e, self.thresholds, envelope(kind, before))
            rows.append(e[:, None] - plays if operator == "stop" else plays)
        return self._weighted(np.concatenate(rows))

    def _hardening(self, rest: Rest, lag: float, operator: Operator, path: int) -> _Term:
        """Elements of the first envelope that fade with the path run."""
        ways = [np.cumsum(np.abs(np.diff(x, prepend=before))) for x, before in self._positions(rest, lag)]
        fading = np.exp(-np.concatenate(ways) / path)[self.used]
        return _Term(fading[:, None] * self._elements(rest, lag, operator, _ALL[0]), free=True)

    def _single_valued(self, rest: Rest, lag: float, operator: Operator, degree: int) -> _Term:
        """The single-valued part: polynomials of different degree share no columns."""
        x = np.concatenate([x for x, _ in self._positions(rest, lag)])
        columns = rising_columns(degree, x) if operator == "play" else legvander(2.0 * x - 1.0, degree)[:, 1:]
        return _Term(self._weighted(columns), free=operator == "stop")

    def _beside_plays(self, name: str, rest: Rest, lag: float) -> _Term:
        """Creep, or a force of the rate: the output for a weight of one."""
        kind, weight = _BESIDE[name]
        data = self._lagged(rest, lag)
        part = kind().with_rest(rest).start(list(data)).replace(**{weight: 1.0})
        y = np.concatenate([_output(part, record) for record in data])
        return _Term(self._weighted(y[:, None]), free=name != "creep")
