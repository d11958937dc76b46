"""The field of a soft magnetic core from its flux density: stops, a single-valued curve and rates, linear in all coefficients.

One shared fit over many sequences, then a small correction to each new sequence from the part of it whose field is known: the initial
state, which no sequence states, and the coefficients. Everything is solved in closed form.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hystfit.errors import DataError
from hystfit.identify.vector_hysteresis import FEWEST
from hystfit.quality.host_operators import play_positions

_STOPS, _FINEST, _COARSEST = 8, 3.2e-3, 0.745  # number, and half widths over the saturation: 1.5 to 350 mT of 0.47 T
_CLIP = 0.995  # of the saturation, at most, where the single-valued curve turns up
_AGE = 200.0  # samples after which the known past counts 1/e
_FADE = (0.02, 0.06, 0.2, 0.6)  # of the saturation: ranges of B after which a wrong initial state is forgotten
# Histories of one and two turning points, of the saturation.
_DEPTHS, _BACKS = (0.02, 0.06, 0.15, 0.35, 0.75), (0.0, 0.02, 0.06, 0.2)
_BEST = 3  # histories that are averaged
_ROUNDS = 2  # of choosing the histories of the training sequences
_CYCLE = 500  # samples of a cycle whose loss is computed
# Penalties, chosen on 53 transients of 3C90, whose mean error they change by less than its standard error of 0.7 points where no other
# figure is given: of scaled coefficients (1e-4 costs a point); of their change for one sequence, by the shared normal matrix; the part of
# that for the sequence's own B (0: one sequence errs by 90 %); of the terms of the initial state, over the mean square of the field, and
# where histories of training sequences are chosen (0.1 there costs 0.7 points).
_RIDGE, _STIFF, _OWN = 1e-6, 0.3, 0.1
_FADE_RIDGE, _FADE_FREE = 0.1, 0.01


@dataclasses.dataclass(frozen=True, eq=False)
class FluxSequence:
    """B over time at one temperature, with the field where it is known.

    Attributes:
        b: flux density [T], shape (T,).
        h: field [A/m], shape (T,); NaN where it is unknown.
        dt: sampling interval [s].
        temperature: [degC].

    Raises:
        DataError: columns of different length, or fewer than 20 known fields.
    """

    b: np.ndarray
    h: np.ndarray
    dt: float
    temperature: float = 25.0

    def __post_init__(self) -> None:
        if self.b.shape != self.h.shape or self.b.ndim != 1:
            raise DataError(f"B and H must be columns of one length, got {self.b.shape} and {self.h.shape}")
        if not np.isfinite(self.b).all() or not self.dt > 0:
            raise DataError("B must be finite and the sampling interval positive")
        if np.isfinite(self.h).sum() < FEWEST:
            raise DataError(f"at least {FEWEST} fields must be known, got {int(np.isfinite(self.h).sum())}")


class Reach(NamedTuple):
    """What sequences cover [T, degC]. Beyond it losses may have either sign: at 150 degC that of a core measured from 25 to 70 degC had."""

    peak: float
    coldest: float
    warmest: float

    @classmethod
    def of(cls, sequences: Sequence[FluxSequence]) -> Reach:
        warm = [one.temperature for one in sequences]
        return cls(max(float(np.abs(one.b).max()) for one in sequences), min(warm), max(warm))

    def check(self, peak: float, temperature: float) -> None:
        """Refuse a flux density or a temperature beyond those covered."""
        if peak > self.peak:
            raise DataError(
                f"a flux density of {peak:.4g} T is beyond the sequences fitted, which reach {self.peak:.4g} T"
            )
        if not self.coldest <= temperature <= self.warmest:
            covered = f"{self.coldest:.4g} to {self.warmest:.4g} degC"
            raise DataError(
                f"a temperature of {temperature:.4g} degC is beyond the sequences fitted, which cover {covered}"
            )


@dataclasses.dataclass(frozen=True, eq=False)
class FieldFromInduction:
    """H = sum w_j s_j(B) + p1 x + p5 x^5 + (q9 x^9 + q21 x^21) / (1 - x^2) + r1 dB/dt + r2 d2B/dt2, x = B / Bs(T).

    The s_j are stops of B; every coefficient is linear in the temperature: 28 in all. The terms in 1 - x^2 are the approach to saturation,
    r1 the eddy currents; derivatives are central, so that they take one sample ahead.

    Attributes:
        w: coefficients over the root mean squares of their columns, shape (28,).
        size: these root mean squares, shape (28,).
        normal: mean normal matrix of the scaled columns over all training samples, each sequence weighted by 1/rms(H)^2, shape (28, 28).
        covariance: of w, by the jackknife over sequences, shape (28, 28); NaN of one sequence.
        saturation: Bs at 25 degC [T].
        drop: relative fall of Bs with the temperature [1/K].
        reach: what the training sequences cover; None without any.
    """

    w: np.ndarray
    size: np.ndarray = dataclasses.field(repr=False)
    normal: np.ndarray = dataclasses.field(repr=False)
    covariance: np.ndarray = dataclasses.field(repr=False)
    saturation: float = 0.47
    drop: float = 0.0025
    reach: Reach | None = None

    @classmethod
    def fit(
        cls, sequences: Sequence[FluxSequence], saturation: float = 0.47, drop: float = 0.0025, ridge: float = _RIDGE
    ) -> FieldFromInduction:
        """The shared coefficients, with the initial state of each sequence chosen among histories of one and two turning points.

        Args:
            sequences: with known fields.
            saturation, drop: of Bs, see above.
            ridge: penalty of the scaled coefficients.

        Raises:
            DataError: no sequences.
        """
        if not sequences:
            raise DataError("no sequences to fit")
        known = [np.isfinite(one.h) for one in sequences]
        weights = [1.0 / float(np.sqrt(np.mean(one.h[k] ** 2))) for one, k in zip(sequences, known, strict=True)]
        histories = [0] * len(sequences)
        count = 2 * (_STOPS + 6)
        model = cls(np.zeros(count), np.ones(count), np.eye(count), np.zeros((count, count)), saturation, drop)
        stops = [model.stops(one) for one in sequences]
        for turn in range(_ROUNDS + 1):
            if turn:
                histories = [model._adapts_best(one, every) for one, every in zip(sequences, stops, strict=True)]
            each, squares, samples = [], np.zeros(count), 0
            for one, every, at, k, weight in zip(sequences, stops, histories, known, weights, strict=True):
                columns, fading = model.columns(one, every[:, at])[k], model.fading(one)[k]
                both = np.column_stack([columns, one.h[k]]) * weight
                left = both - fading @ _solved(fading, both)
                each.append(left[:, :-1].T @ left)
                squares += np.sum((weight * columns) ** 2, axis=0)
                samples += int(k.sum())
            size = np.where(squares > 0, np.sqrt(squares / samples), 1.0)  # none at one temperature
            scaled = np.array(each) / samples / size[:, None] / np.append(size, 1.0)
            normal, right = scaled[..., :-1].sum(0), scaled[..., -1].sum(0)
            w = np.linalg.solve(normal + ridge * np.eye(count), right)
            model = cls(w, size, normal, _jackknife(scaled, ridge), saturation, drop)
        return dataclasses.replace(model, reach=Reach.of(sequences))

    def stops(self, one: FluxSequence) -> np.ndarray:
        """Stops of B [T] from all histories, shape (T, histories, 8)."""
        states = self.states()
        plays = play_positions(one.b, np.tile(self.widths, len(states)), (one.b[0] - states).ravel())
        return (one.b[:, None] - plays).reshape(one.b.size, *states.shape)

    def columns(self, one: FluxSequence, stops: np.ndarray) -> np.ndarray:
        """The columns of the coefficients, shape (T, 28), from the stops (T, 8) of one of the sequence's histories."""
        warm = (one.temperature - 25.0) / 25.0
        limit = self.saturation * (1 - self.drop * (one.temperature - 25.0))
        x = np.clip(one.b / limit, -_CLIP, _CLIP)
        rate = np.gradient(one.b, one.dt)
        plain = [*stops.T, x, x**5, x**9 / (1 - x**2), x**21 / (1 - x**2), rate]
        base = np.column_stack([*plain, np.gradient(rate, one.dt)])
        return np.column_stack([base, warm * base])

    @property
    def widths(self) -> np.ndarray:
        """Half widths of the stops [T], shape (8,)."""
        return self.saturation * np.geomspace(_FINEST, _COARSEST, _STOPS)

    def states(self) -> np.ndarray:
        """Stops after the histories: demagnetized, and turned from +-D by d, shape (histories, 8) [T]."""
        r, found = self.widths, [np.zeros(_STOPS)]
        for depth, back, sign in itertools.product(_DEPTHS, _BACKS, (1.0, -1.0)):
            turned = np.clip(depth * self.saturation, -r, r)
            found.append(sign * np.clip(turned - back * self.saturation, -r, r))
        return np.array(found)

    def fading(self, one: FluxSequence) -> np.ndarray:
        """Terms of the initial state, which fade with the range of B so far, shape (T, 4)."""
        span = np.maximum.accumulate(one.b) - np.minimum.accumulate(one.b)
        return np.exp(-span[:, None] / (self.saturation * np.array(_FADE)))

    def loss(self, peak: float, frequency: float, temperature: float = 25.0) -> tuple[float, float]:
        """Core loss per cycle and volume of a sine of B, by the shared coefficients, and its standard error [J/m^3].

        The error is that of the coefficients by the scatter over sequences; the model has one besides.

        Args:
            peak: amplitude [T].
            frequency: [Hz].
            temperature: [degC].

        Raises:
            DataError: an amplitude or frequency that is not positive, or a flux density or temperature beyond all sequences.
        """
        if not (peak > 0 and frequency > 0):
            raise DataError(f"peak and frequency must be positive, got {peak} and {frequency}")
        if self.reach is not None:
            self.reach.check(peak, temperature)
        dt = 1.0 / (_CYCLE * frequency)
        b = peak * np.sin(2 * np.pi * np.arange(2 * _CYCLE + 1) / _CYCLE)
        one = FluxSequence(b, np.zeros(b.size), dt, temperature)
        columns = self.columns(one, self.stops(one)[:, 0])[_CYCLE:] / self.size
        each = 0.5 * np.diff(b[_CYCLE:]) @ (columns[1:] + columns[:-1])  # loss of each coefficient
        return float(each @ self.w), float(np.sqrt(each @ self.covariance @ each))

    def _errors(self, one: FluxSequence, stops: np.ndarray) -> np.ndarray:
        """Mean square of the error of the shared coefficients on the known past, recent samples first, for each history."""
        known = np.flatnonzero(np.isfinite(one.h))
        weight, coefficients = np.exp((known - known[-1]) / _AGE), self.w / self.size
        left = [one.h[known] - (self.columns(one, every) @ coefficients)[known] for every in stops.swapaxes(0, 1)]
        return np.sum(weight * np.square(left), axis=1) / weight.sum()

    def _adapted(self, one: FluxSequence, stops: np.ndarray, fade: float = _FADE_RIDGE) -> tuple[np.ndarray, float]:
        """Field over the whole sequence with coefficients adapted to its known part, and the mean square of its error there.

        A change of coefficients is dear where it changes the field elsewhere: of the training sequences, and of this one at its own B.
        """
        known, m = np.flatnonzero(np.isfinite(one.h)), self.w.size
        columns, fading = self.columns(one, stops) / self.size, self.fading(one)
        scale = float(np.mean(one.h[known] ** 2))
        weight = np.exp((known - known[-1]) / _AGE)
        weight /= weight.sum() * scale
        both, plain = np.column_stack([columns, fading]), columns @ self.w
        own = columns.T @ columns / len(columns) / max(float(np.mean(plain**2)), np.finfo(float).tiny)
        penalty = np.zeros((both.shape[1],) * 2)
        penalty[:m, :m] = _STIFF * (self.normal + _OWN * own) + _RIDGE * np.eye(m)
        penalty[m:, m:] = fade / scale * np.eye(fading.shape[1])
        rows = both[known]
        square, right = rows.T @ (weight[:, None] * rows), rows.T @ (weight * (one.h - plain)[known])
        field = plain + both @ np.linalg.solve(square + penalty, right)
        return field, float(np.sum(weight * (field - one.h)[known] ** 2))

    def _adapts_best(self, one: FluxSequence, stops: np.ndarray) -> int:
        """Number of the history from which the adapted coefficients err least on the known part."""
        return int(np.argmin([self._adapted(one, every, _FADE_FREE)[1] for every in stops.swapaxes(0, 1)]))

    def predict(self, one: FluxSequence, *, adapt: bool = True) -> np.ndarray:
        """The field over a sequence [A/m], shape (T,): the mean over the best histories.

        Args:
            one: with a known past, which fixes the initial state.
            adapt: whether the past also changes the coefficients; without it they are the shared ones.
        """
        stops = self.stops(one)
        best = np.argsort(self._errors(one, stops), kind="stable")[:_BEST]
        if not adapt:
            return np.mean([self.columns(one, stops[:, k]) @ (self.w / self.size) for k in best], axis=0)
        return np.mean([self._adapted(one, stops[:, k])[0] for k in best], axis=0)


def _solved(columns: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Least squares with the smallest penalty that keeps columns apart which are nearly equal."""
    square = columns.T @ columns
    return np.linalg.solve(square + 1e-6 * np.trace(square) * np.eye(len(square)), columns.T @ right)


def _jackknife(each: np.ndarray, ridge: float) -> np.ndarray:
    """Covariance of coefficients by leaving out sequences in turn (Efron 1982), from [A, b] of each, shape (sequences, m, m + 1)."""
    count, penalty = len(each), ridge * np.eye(each.shape[1])
    if count < 2:
        return np.full(penalty.shape, np.nan)
    others = each.sum(0) - each
    without = np.linalg.solve(others[..., :-1] + penalty, others[..., -1:])[..., 0]
    away = without - without.mean(0)
    return (count - 1) / count * away.T @ away
