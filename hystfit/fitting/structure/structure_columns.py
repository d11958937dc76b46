"""The terms of a Prandtl-Ishlinskii model as columns of one linear system, so that a candidate of the search costs one ridge solve.

Given the lag, plays or stops, the single-valued part, creep, forces of the rate and hardening all have columns in closed form.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.polynomial.legendre import legvander

from hystfit.data.circulation import SLACK
from hystfit.data.dataset import Dataset
from hystfit.fitting.solvers.ridge import LinearSystem, fit_ridge
from hystfit.fitting.structure.model_structure import Structure, falls, interval_of
from hystfit.models.base import AbstractHysteresis, Rest
from hystfit.models.creep import LinearCreep
from hystfit.models.curve import Curve
from hystfit.models.dynamics import Lag
from hystfit.models.prandtl_ishlinskii import Operator, PrandtlIshlinskii
from hystfit.models.rate import SaturatingRate, Viscous
from hystfit.models.shared.play_columns import Envelope, element_columns, envelope, fading, rising_columns
from hystfit.models.shared.starting import fitted_input_range, output_range
from hystfit.quality.held_out import HeldOut, Scheme
from hystfit.quality.slow_lag import SHORT
from hystfit.quality.summary import paces

_DEGREES = (1, 3, 5)
_COARSE = (1e-9, 1e-7, 1e-5, 1e-3, 1e-1)
_ALL = get_args(Envelope)
# Terms besides plays and stops, and the field of their weight.
_BESIDE: dict[str, tuple[type[AbstractHysteresis], str]] = {
    "creep": (LinearCreep, "a"),
    "viscous": (Viscous, "c"),
    "saturating": (SaturatingRate, "F"),
}
_ABOUT = np.geomspace(0.7, 1.4, 5)  # lags that are tried, over that which the records show
STEP_OF_LAGS = 0.5  # samples between the lags that are tried


class _Drive(NamedTuple):
    """What happens to the input before the plays, see `Structure`."""

    rest: Rest
    lag: float
    order: int
    falls: bool

    @classmethod
    def of(cls, structure: Structure) -> _Drive:
        return cls(structure.rest, structure.lag, structure.order, structure.falls)


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
        self.timed = interval_of(data) > 0 and all(record.t is not None for record in data)
        self.several_paces = self.timed and paces(data) > 1
        self.span = output_range(data).width
        self.falls = falls(data)
        self.used = np.concatenate([record.used for record in data])
        self.weight = np.concatenate([record.weight for record in data])[self.used]
        self.samples = self.weight.size
        self._known = np.concatenate([record.rate_known for record in data])[self.used]
        self.scores: dict[Structure, float] = {}
        # On the instance: a cache of the class would keep the columns of every search of the process.
        self._lagged, self._positions = functools.cache(self._lagged_data), functools.cache(self._positions_of)
        self._elements, self._single = functools.cache(self._element_columns), functools.cache(self._single_valued)
        self._beside, self._line = functools.cache(self._beside_plays), functools.cache(self._straight)
        self._curve = functools.cache(self._single_valued_curve)

    def served(self, structure: Structure) -> bool:
        """Whether there are two samples for each weight, and no line beside stops or a curve, which have one."""
        if structure.line and structure.operator != "play":
            return False
        if structure.order == 1 and not structure.lag:
            return False
        return 2 * structure.columns(self.plays, len(self.data)) <= self.samples

    def options(self, lag: float = 0.0) -> dict[str, tuple[Any, ...]]:
        """Values of each field that these data allow; `lag` [samples], where the records show one, adds lags about it."""
        options: dict[str, tuple[Any, ...]] = {"operator": get_args(Operator), "envelopes": (1, 3), "degree": _DEGREES}
        options["line"] = (False, True)
        span = max(float(np.ptp(record.u)) for record in self.data)
        if any(abs(record.u[0]) > SLACK * span for record in self.data):
            options["rest"] = ("level", "first")
        if self.timed:
            # Hardening would stand in for what creep and rate describe.
            lags = (
                0.0,
                *np.arange(1.0, SHORT + 0.1, STEP_OF_LAGS).tolist(),
                *(np.round(_ABOUT * lag, 1).tolist() if lag else ()),
            )
            return {**options, "lag": lags, "order": (1, 2), "creep": (False, True), "rate": (0, 1, 2)}
        if self.held.scheme is Scheme.SCATTERED:  # tests no later cycle, in which a device that hardens would differ
            return options
        return {**options, "hardening": (0, 1, 3, 10)}

    def score(self, structure: Structure) -> float:
        """Root mean square error on held-out samples, output units; infinite where all but stops have a force against the rate beside them.

        Such a force describes a lag by an output that falls as the input jumps up, which has no inverse; `lag` describes it with one.
        """
        if structure not in self.scores:
            fitted = fit_ridge(self.system(structure), _COARSE)
            forces = fitted.weights[fitted.weights.size - structure.rate :]
            # A curve takes the input as it is, plays negated where the output falls.
            sign = -1 if structure.operator == "curve" and self.falls else 1
            against = structure.operator != "stop" and bool((sign * forces < 0).any())
            self.scores[structure] = np.inf if against else float(fitted.score)
        return self.scores[structure]

    def lag_between(self, structure: Structure) -> float:
        """The lag near that of a structure at which the error is least [samples]: where a parabola through three squared errors is.

        The three are half a sample apart; where the error falls to one side, they move there in doubled steps. Half a sample off, the error
        is several times that of the right lag, and terms of a higher degree would seem to be needed.
        """
        square = lambda lag: self.score(dataclasses.replace(structure, lag=max(lag, 0.0))) ** 2
        before, lag, step = structure.lag - STEP_OF_LAGS, structure.lag, STEP_OF_LAGS
        if square(before) < square(lag + step):
            before, step = lag + step, -step
        while square(lag + step) < square(lag):
            before, lag, step = lag, lag + step, 2 * step
        slopes = (square(lag) - square(before)) / (lag - before), (square(lag + step) - square(lag)) / step
        bend = (slopes[1] - slopes[0]) / (lag + step - before)
        if not np.isfinite(bend) or bend <= 0:
            return lag
        least = 0.5 * (before + lag) - 0.5 * slopes[0] / bend
        return float(np.round(np.clip(least, *sorted((before, lag + step))), 2))

    def system(self, s: Structure) -> LinearSystem:
        """The linear system of a structure, joined from the columns of its terms."""
        drive = _Drive.of(s)
        if s.operator == "curve":
            terms = [self._curve(drive)]
        else:
            terms = [_Term(self._elements(drive, s.operator, kind), False) for kind in _ALL[: s.envelopes]]
            terms.append(self._single(drive, s.operator, s.degree))
        terms.append(self._offset)
        terms += [self._line(drive)] * s.line
        if s.hardening:
            terms.append(self._hardening(drive, s.operator, s.hardening))
        terms += [self._beside(term, drive) for term in ["creep"] * s.creep + ["viscous", "saturating"][: s.rate]]
        each = lambda name: np.concatenate([np.full(term.columns.shape[1], getattr(term, name)) for term in terms])
        # With all weights at zero every term is zero: the target is the output itself.
        y = np.concatenate([record.y for record in self.data])
        columns, target, kept = np.hstack([term.columns for term in terms]), self._weighted(y), self._kept(s)
        rows = columns[kept], target[kept]
        return LinearSystem(*rows, each("free"), each("ridged"), self._fold[kept], self.weight[kept])

    def _kept(self, s: Structure) -> np.ndarray | slice:
        """Which samples that count tell the weights of a structure: with a force of the rate, those at which the rate is known."""
        return self._known if s.rate else slice(None)

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
        through = Lag(tau=drive.lag * interval_of(data), rest=drive.rest, order=drive.order)
        return data.map(lambda record: record.replace(u=through.free_run(record.u, record.dt))) if drive.lag else data

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

    def _single_valued_curve(self, drive: _Drive) -> _Term:
        """A curve in place of plays."""
        data = list(self._lagged(drive))
        curve = Curve.of(self.plays).start(data)
        rows = [curve.design_matrix(record.u) for record in data]
        columns = [np.hstack([block.columns for block in one.blocks[:-1]]) for one in rows]
        return _Term(self._weighted(np.concatenate(columns)), free=True)

    def _straight(self, drive: _Drive) -> _Term:
        """A straight line over the input."""
        x = np.concatenate([x for x, _ in self._positions(drive)])
        return _Term(self._weighted(x[:, None]), free=True)

    def _beside_plays(self, name: str, drive: _Drive) -> _Term:
        """Creep, or a force of the rate: the output for a weight of one."""
        kind, weight = _BESIDE[name]
        data = self._lagged(drive)
        part = kind().with_rest(drive.rest).start(list(data))
        part = dataclasses.replace(part, **{weight: np.ones_like(getattr(part, weight))})
        y = np.concatenate([part.free_run(record.u, record.dt) for record in data])
        return _Term(self._weighted(y[:, None]), free=name != "creep")
