"""Greedy search for the terms of a Prandtl-Ishlinskii model, judged on held-out samples.

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
from hystfit.fitting.convex import LinearSystem, fit_ridge
from hystfit.inference.problem import check_fittable
from hystfit.models.base import AbstractHysteresis
from hystfit.models.creep import LinearCreep
from hystfit.models.dynamics import Delay, Lag
from hystfit.models.linear import Linear
from hystfit.models.negate import Negate
from hystfit.models.play_columns import element_columns, fading, rising_columns
from hystfit.models.prandtl_ishlinskii import Envelope, Operator, PrandtlIshlinskii, Rest, envelope
from hystfit.models.rate import SaturatingRate, Viscous
from hystfit.models.registry import model_name
from hystfit.models.series import Series
from hystfit.models.simulation import simulate
from hystfit.models.starting import fitted_input_range, output_range
from hystfit.models.sum import Sum
from hystfit.outcome import Code, Note
from hystfit.quality.baselines import rounding_error
from hystfit.quality.held_out import HeldOut, held_out
from hystfit.quality.slow_lag import SHORT
from hystfit.quality.summary import delay_of, slow_lag_of

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
        falls: the input is negated first: the output falls as the input rises.
        line: a straight line of either sign beside plays, which alone only rise (stops have one).
        lag: mean delay of the input, in sampling intervals; 0 for none.
        creep: logarithmic creep of the input.
        rate: 0, 1 (viscous) or 2 (and saturating).
        hardening: path, in input ranges, over which hardening fades; 0 for none.
    """

    operator: Operator = "play"
    envelopes: int = 1
    degree: int = 1
    rest: Rest = "level"
    falls: bool = False
    line: bool = False
    lag: float = 0.0
    creep: bool = False
    rate: int = 0
    hardening: int = 0

    def columns(self, plays: int, records: int) -> int:
        """Number of weights with this many plays, one offset per record included."""
        return (
            plays * (self.envelopes + (self.hardening > 0)) + self.degree + records + self.line + self.creep + self.rate
        )

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
            "line": f"{'adding' if self.line else 'leaving out'} a straight line",
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


def search_structure(data: Dataset, *, plays: int | None = None, spacing: int = 1) -> Found:
    """Search for the terms of a model, also behind a pure delay where the records show one.

    Args:
        data: records.
        plays: number of thresholds; by default the held-out error chooses it among those that the data can determine.
        spacing: samples over which errors are correlated, see `held_out`.
    """
    check_fittable(PrandtlIshlinskii.of(1), data)
    held = held_out(list(data), spacing)
    found = _search(data, held, plays)
    if not any(delay_of(record) for record in data):
        return found
    delay = Delay().start(list(data))
    later = _search(data.map(lambda record: record.replace(u=_output(delay, record))), held, plays)
    if later.score >= _GAIN * found.score:
        return found
    parts = later.model.parts if isinstance(later.model, Series) else (later.model,)
    return dataclasses.replace(later, model=Series(delay, *parts), tried=found.tried + later.tried)


def _search(data: Dataset, held: HeldOut, plays: int | None) -> Found:
    """Greedy search from plays or stops with one envelope: repeat the single change that lowers the held-out error most."""
    most = max_plays(data)
    terms = Terms(data, min(_PLAYS, most) if plays is None else plays, held)
    # Lags about one longer than those tried on all records.
    options = terms.options(max(slow_lag_of(record) or 0.0 for record in data) if terms.timed else 0.0)
    structure = min((Structure(operator, falls=terms.falls) for operator in get_args(Operator)), key=terms.score)
    score, trail = terms.score(structure), list[str]()
    # Rounding errors recur where the cycles repeat: terms that describe them would also lower the error on held-out cycles.
    rounding = rounding_error(data)
    while score > rounding:
        best = _next(structure, score, terms, options)
        if terms.score(best) >= _GAIN * score:
            break
        trail.append(_step(best.change_from(structure), score, terms.score(best), terms.span))
        structure, score = best, terms.score(best)
    tried, chosen = len(terms.scores), terms.plays
    for other in _OTHER_PLAYS if plays is None and score > rounding else ():
        resized = Terms(data, other, held)
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


def structure_of(model: AbstractHysteresis) -> tuple[Structure, bool]:
    """What the model of a search has before and beside its plays, and whether it has a pure delay."""
    parts = [leaf for part in getattr(model, "parts", (model,)) for leaf in getattr(part, "parts", (part,))]
    has = lambda kind: any(isinstance(part, kind) for part in parts)
    return Structure(falls=has(Negate), line=has(Linear), lag=float(has(Lag))), has(Delay)


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
    if structure.line:
        parts.append(Linear())
    before: list[AbstractHysteresis] = [Negate()] * structure.falls
    if structure.lag:
        before.append(Lag(tau=structure.lag * _interval(data), rest=structure.rest))
    records = list(data)
    for part in before:
        records = [record.replace(u=_output(part, record)) for record in records]
    # Every part takes its ranges from the records themselves: the weights are solved together.
    started = [part.start(records) for part in parts]
    model = started[0] if len(parts) == 1 else Sum(*started)
    return Series(*before, model) if before else model


def _interval(data: Dataset) -> float:
    return data.sampling_interval or 0.0


def _output(model: AbstractHysteresis, record: Record) -> np.ndarray:
    """Output of a model over a record, by one program for records of similar length."""
    extra = bucket(len(record)) - len(record)
    u, dt = np.pad(record.u, (0, extra), mode="edge"), np.pad(record.dt, (0, extra))
    return np.asarray(simulate(model, u, dt)[0])[: len(record)]


class _Drive(NamedTuple):
    """What happens to the input before the plays, see `Structure`."""

    rest: Rest
    lag: float
    falls: bool

    @classmethod
    def of(cls, structure: Structure) -> _Drive:
        return cls(structure.rest, structure.lag, structure.falls)


class _Term(NamedTuple):
    """Weighted columns of one array of weights, shape (n, k), whether these have no lower bound, and whether a ridge acts on them."""

    columns: np.ndarray
    free: bool
    ridged: bool = True


class Terms:
    """Columns of every term, computed once for each lag and rest, and the scores of the structures tried."""

    def __init__(self, data: Dataset, plays: int, held: HeldOut):
        self.data, self.plays, self.held = data, plays, held
        self.thresholds = np.asarray(PrandtlIshlinskii.of(plays).r)
        self.timed = _interval(data) > 0 and all(record.t is not None for record in data)
        self.span = output_range(data).width
        slopes = (np.cov(record.u[record.used], record.y[record.used])[0, 1] for record in data)
        self.falls = bool(sum(slopes) < 0)  # the output falls as the input rises
        self.used = np.concatenate([record.used for record in data])
        self.weight = np.concatenate([record.weight for record in data])[self.used]
        self.samples = self.weight.size
        self.scores: dict[Structure, float] = {}
        # On the instance: a cache of the class would keep the columns of every search of the process.
        self._lagged, self._positions = functools.cache(self._lagged_data), functools.cache(self._positions_of)
        self._elements, self._single = functools.cache(self._element_columns), functools.cache(self._single_valued)
        self._beside, self._line = functools.cache(self._beside_plays), functools.cache(self._straight)

    def served(self, structure: Structure) -> bool:
        """Whether there are two samples for each weight, and no line beside stops, which have one."""
        if structure.line and structure.operator == "stop":
            return False
        return 2 * structure.columns(self.plays, len(self.data)) <= self.samples

    def options(self, lag: float = 0.0) -> dict[str, tuple[Any, ...]]:
        """Values of each field that these data allow; for `lag` see `search_rising`."""
        options: dict[str, tuple[Any, ...]] = {"operator": get_args(Operator), "envelopes": (1, 3), "degree": _DEGREES}
        options["line"] = (False, True)
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
        """Root mean square error on held-out samples, output units; infinite where plays have a force against the rate beside them.

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
        drive = _Drive.of(s)
        terms = [_Term(self._elements(drive, s.operator, kind), False) for kind in _ALL[: s.envelopes]]
        terms += [self._single(drive, s.operator, s.degree), self._offset]
        terms += [self._line(drive)] * s.line
        if s.hardening:
            terms.append(self._hardening(drive, s.operator, s.hardening))
        terms += [self._beside(term, drive) for term in ["creep"] * s.creep + ["viscous", "saturating"][: s.rate]]
        each = lambda name: np.concatenate([np.full(term.columns.shape[1], getattr(term, name)) for term in terms])
        # With all weights at zero every term is zero: the target is the output itself.
        y = np.concatenate([record.y for record in self.data])
        columns, target = np.hstack([term.columns for term in terms]), self._weighted(y)
        return LinearSystem(columns, target, each("free"), each("ridged"), self._fold, self.weight)

    def _weighted(self, rows: np.ndarray) -> np.ndarray:
        """The rows of samples that count, times the roots of their weights."""
        root = np.sqrt(self.weight)
        return rows[self.used] * (root if rows.ndim == 1 else root[:, None])

    @functools.cached_property
    def _fold(self) -> np.ndarray:
        return np.concatenate([fold[r.used] for fold, r in zip(self.held.folds, self.data, strict=True)])

    @functools.cached_property
    def _offset(self) -> _Term:
        """One column of ones per record."""
        record = np.repeat(np.arange(len(self.data)), [len(record) for record in self.data])
        return _Term(self._weighted(np.eye(len(self.data))[record]), free=True, ridged=False)

    def _lagged_data(self, drive: _Drive) -> Dataset:
        """The records with the input negated, where it is, and behind the lag."""
        data = self.data.map(lambda record: record.replace(u=-record.u)) if drive.falls else self.data
        through = Lag(tau=drive.lag * _interval(data), rest=drive.rest)
        return data.map(lambda record: record.replace(u=_output(through, record))) if drive.lag else data

    def _positions_of(self, drive: _Drive) -> list[tuple[np.ndarray, float]]:
        """Input of each record as a fraction of the range, and where it rested before."""
        records = list(self._lagged(drive))
        place = fitted_input_range(records)
        low, high = place.center - place.half, place.center + place.half
        inputs = [(record.u - low) / (high - low) for record in records]
        return [(x, float(x[0]) if drive.rest == "first" else -low / (high - low)) for x in inputs]

    def _element_columns(self, drive: _Drive, operator: Operator, kind: Envelope) -> np.ndarray:
        """Plays or stops of one envelope."""
        rows = []
        for x, before in self._positions(drive):
            rows.append(element_columns(envelope(kind, x), self.thresholds, envelope(kind, before), operator))
        return self._weighted(np.concatenate(rows))

    def _hardening(self, drive: _Drive, operator: Operator, path: int) -> _Term:
        """Elements of the first envelope that fade with the path run."""
        left = [fading(x, before, float(path)) for x, before in self._positions(drive)]
        return _Term(np.concatenate(left)[self.used, None] * self._elements(drive, operator, _ALL[0]), free=True)

    def _single_valued(self, drive: _Drive, operator: Operator, degree: int) -> _Term:
        """The single-valued part: polynomials of different degree share no columns."""
        x = np.concatenate([x for x, _ in self._positions(drive)])
        columns = rising_columns(degree, x) if operator == "play" else legvander(2.0 * x - 1.0, degree)[:, 1:]
        return _Term(self._weighted(columns), free=operator == "stop")

    def _straight(self, drive: _Drive) -> _Term:
        """A straight line over the input."""
        x = np.concatenate([x for x, _ in self._positions(drive)])
        return _Term(self._weighted(x[:, None]), free=True)

    def _beside_plays(self, name: str, drive: _Drive) -> _Term:
        """Creep, or a force of the rate: the output for a weight of one."""
        kind, weight = _BESIDE[name]
        data = self._lagged(drive)
        part = kind().with_rest(drive.rest).start(list(data)).replace(**{weight: 1.0})
        y = np.concatenate([_output(part, record) for record in data])
        return _Term(self._weighted(y[:, None]), free=name != "creep")
