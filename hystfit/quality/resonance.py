"""Dynamics: a response that changes with frequency as that of an oscillator does, as distinct from hysteresis, lag and viscosity.

Two descriptions of the output are fitted by least squares: hysteresis (plays and a cubic) of the delayed or lagged input with
velocity terms, and the same hysteresis followed by an underdamped second-order filter. The record is dynamic where the filter
explains most of what the first description does not, and the response at the excited frequencies changes accordingly.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable

import numpy as np

from hystfit.quality.host_operators import lagged, play_positions, recursion

FEWEST, _MOST = 200, 12_000  # samples used
EXCITED = 1e-3  # power of the input in a band that counts as excited, as a fraction of the strongest band
_APART = 1.5  # least ratio of excited frequencies between which a change of the response is visible
_DELAYS = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 20.0)  # samples
_DAMPING = (0.02, 0.1, 0.4)  # ratios at which the search starts
VISIBLE = 0.005  # least rms error without it, as a fraction of the range of y
_RINGING = 0.1  # damping ratio below which a resonance above the excited frequencies is seen to ring after a corner of the input
_CHANGE = 0.5  # least |H - 1| of the resonance H at an excited frequency: a gain of 1.5, or a phase of 29 degrees
_SINGULAR = 1e-7  # of the largest singular value of columns, below which a combination of them is none
_RADII = np.geomspace(0.03, 0.8, 5)  # of the plays
_KNOTS = np.linspace(-0.9, 0.9, 12)  # of envelopes by which any hysteresis without dynamics follows a loop
# Least ratio of two errors by which the smaller one decides: of a filter that runs backward in time and of one that runs forward, 1.3 and
# 1.7 on two stages that ring, at most 1.02 on steep transitions without a resonance; and of two delays (half a period and a change of
# sign look alike), of which the shorter is taken otherwise.
DECIDES = 1.1


def scaled(u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Input from -1 to 1, output over its range without its mean, and which outputs are known; None where few are, or one is constant."""
    u, y = np.asarray(u, dtype=float), np.asarray(y, dtype=float)
    used = np.isfinite(y)
    if used.sum() < max(FEWEST, 0.5 * y.size) or np.ptp(u) == 0 or np.ptp(y[used]) == 0:
        return None
    return 2 * (u - u.min()) / np.ptp(u) - 1, (y - y[used].mean()) / np.ptp(y[used]), used


def unexplained(design: np.ndarray, y: np.ndarray) -> float:
    """Root mean square of what columns of any scale, shape (T, K), leave of y by least squares."""
    design = design / np.linalg.norm(design, axis=0).clip(1e-300)
    solution = np.linalg.lstsq(design, y, rcond=_SINGULAR)[0]
    return float(np.sqrt(np.mean((y - design @ solution) ** 2)))


def explains(error: float, without: float) -> bool:
    """Whether a term explains most of what is left without it: it halves the error.

    Args:
        error, without: rms errors with and without the term, as fractions of the range of y.
    """
    return without > VISIBLE and error < without / 2


@dataclasses.dataclass(frozen=True)
class Dynamics:
    """Frequency response at two excited frequencies, and the resonance that explains it.

    Attributes:
        natural_frequency: of the resonance [cycles per unit of time].
        damping_ratio: of the resonance.
        explained: share of the variance unexplained by hysteresis, lag and velocity terms that the resonance explains.
        error_without, error_with: rms error without and with the resonance, as fractions of the range of y.
        low, high: excited frequencies that are compared: the lowest, and that at which the resonance changes the response most
            [cycles per unit of time].
        gain_ratio: measured gain at `high` over that at `low`.
        phase_low, phase_high: measured phase of the output against the input; negative where the output lags [degrees].
        change: |H - 1| of the resonance H alone at `high`.
    """

    natural_frequency: float
    damping_ratio: float
    explained: float
    error_without: float
    error_with: float
    low: float
    high: float
    gain_ratio: float
    phase_low: float
    phase_high: float
    change: float

    @property
    def underdamped(self) -> bool:
        """Whether a resonance whose amplitude exceeds the static one explains most of what hysteresis, lag and velocity terms leave."""
        return explains(self.error_with, self.error_without) and 2 * self.damping_ratio**2 < 1

    @property
    def resonant(self) -> bool:
        """Whether a resonance explains most of the change of the response with frequency, or rings after each reversal."""
        return self.underdamped and (self.change > _CHANGE or self.damping_ratio < _RINGING)


@dataclasses.dataclass(frozen=True)
class _Response:
    """Frequency response in the excited bands: frequencies [1/interval], gains [y/u] and unwrapped phases [degrees], shape (B,)."""

    frequency: np.ndarray
    gain: np.ndarray
    phase: np.ndarray

    @property
    def parts(self) -> tuple[np.ndarray, ...]:
        """The three arrays."""
        return self.frequency, self.gain, self.phase


def estimate_dynamics(u: np.ndarray, y: np.ndarray, interval: float) -> Dynamics | None:
    """Frequency response and resonance of a record.

    Args:
        u: input, shape (T,).
        y: output, shape (T,); missing values are bridged in the response and omitted in the fits.
        interval: time between the evenly spaced samples [unit of t].

    Returns:
        None with fewer than 200 samples, where the input excites a single frequency only, and where hysteresis, a delay, a lag and
        velocity terms leave nothing to explain.
    """
    signals = scaled(u, y)
    if signals is None:
        return None
    x, y, used = signals
    bridged = np.interp(np.arange(y.size), np.flatnonzero(used), y[used])
    response = _frequency_response(x, bridged)
    if response.frequency.size < 2 or response.frequency[-1] < _APART * response.frequency[0]:
        return None
    # 40 samples in a period of the highest excited frequency suffice.
    stride = max(1, min(int(1 / (40 * response.frequency[-1])), x.size // FEWEST))
    coarse = dataclasses.replace(response, frequency=response.frequency * stride)
    thinned = (part[::stride][:_MOST].tobytes() for part in (x, bridged, used))
    found = _described(*thinned, *(part.tobytes() for part in coarse.parts))
    if found is None:
        return None
    without, error, frequency, damping = found
    if (
        2 * np.pi * frequency * damping * x.size / stride < 1
    ):  # it does not decay within the record, of which it describes one wave
        return None
    ratio = coarse.frequency / frequency
    alone = 1 / (1 - ratio**2 + 2j * damping * ratio)
    high = int(np.argmax(np.abs(np.log(alone))))
    return Dynamics(
        natural_frequency=frequency / interval / stride,
        damping_ratio=damping,
        explained=1 - (error / without) ** 2,
        error_without=without,
        error_with=error,
        low=float(response.frequency[0]) / interval,
        high=float(response.frequency[high]) / interval,
        gain_ratio=float(response.gain[high] / response.gain[0]),
        phase_low=float(response.phase[0]),
        phase_high=float(response.phase[high]),
        change=float(np.abs(alone[high] - 1)),
    )


@functools.lru_cache(maxsize=8)
def _described(x: bytes, y: bytes, used: bytes, *response: bytes) -> tuple[float, float, float, float] | None:
    """Least rms errors without and with a resonance, its natural frequency [1/interval] and its damping ratio.

    None where hysteresis, a delay, a lag and velocity terms leave nothing to explain.

    Input, output and response are given as bytes: several steps of a search ask for those of the same record.
    """
    u = np.frombuffer(x)
    columns = Regressors.of(u, np.frombuffer(y), np.frombuffer(used, dtype=bool))
    static = columns.static(u)
    lags = np.geomspace(0.5, max(1.0, 0.02 * u.size), 8)
    without = min(columns.error_behind(_DELAYS, lags), columns.error_corrected(static))
    if without <= VISIBLE:
        return None
    band = _Response(*map(np.frombuffer, response))
    error, frequency, damping = columns.best_resonance(band)
    if frequency <= band.frequency[0]:  # at the bound of the search: what it follows there is a drift of the input
        return None
    # Like is compared with like: the richer description is filtered too. Filtered backward in time it is as flexible, but rings before
    # the turns of the input.
    behind, ahead = (columns.error_corrected(_filtered(static[::way], frequency, damping)[::way]) for way in (1, -1))
    return without, min(error, behind) if ahead > DECIDES * behind else error, frequency, damping


def _frequency_response(x: np.ndarray, y: np.ndarray) -> _Response:
    """Cross spectrum over the input's spectrum in bands of a sixth of an octave, where the input is excited."""
    taper = np.hanning(x.size)
    level = lambda values: (values - values.mean()) * taper
    spectrum, answer = np.fft.rfft(level(x))[2:], np.fft.rfft(level(y))[2:]
    number = np.arange(2, spectrum.size + 2)
    band = np.floor(6 * np.log2(number)).astype(int)
    power = np.bincount(band, np.abs(spectrum) ** 2)
    cross = answer * np.conj(spectrum)
    total = np.bincount(band, cross.real) + 1j * np.bincount(band, cross.imag)
    middle = np.bincount(band, number * np.abs(spectrum) ** 2) / np.maximum(power, 1e-300) / x.size
    excited = (power > EXCITED * power.max()) & (np.abs(total) > 0)
    ratio = total[excited] / power[excited]
    return _Response(middle[excited], np.abs(ratio), np.degrees(np.unwrap(np.angle(ratio))))


@dataclasses.dataclass(frozen=True)
class Regressors:
    """Regressors: `hysteresis` (T, K) of the input, `beside` (T, M) (constant, trend, relaxations), `speed` (T, 3), and the output."""

    hysteresis: np.ndarray
    beside: np.ndarray
    speed: np.ndarray
    y: np.ndarray
    used: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray, y: np.ndarray, used: np.ndarray, radii: np.ndarray = _RADII) -> Regressors:
        """The regressors of an input in -1..1, shape (T,), with plays of these radii."""
        play = play_positions(x, radii)
        speed = np.gradient(x)
        speed = speed / np.sqrt(np.mean(speed**2))
        slow = [lagged(x[:, None], part * x.size)[:, 0] for part in (0.01, 0.05, 0.25)]
        return cls(
            np.stack([x, x**2, x**3, *play.T], axis=1),
            np.stack([np.ones_like(x), np.linspace(-1, 1, x.size), *slow], axis=1),
            np.stack([speed, np.tanh(speed), np.tanh(3 * speed)], axis=1),
            y,
            used,
        )

    def error(self, *parts: np.ndarray) -> float:
        """Least rms error of the output by these columns."""
        return unexplained(np.hstack(parts)[self.used], self.y[self.used])

    def error_behind(self, delays: Iterable[float], lags: Iterable[float]) -> float:
        """Least rms error of hysteresis and velocity terms behind a delay, or behind one or two lags of the same time [samples]."""
        driven = np.hstack([self.hysteresis, self.speed])
        behind = [delayed(driven, delay) for delay in delays]
        for time in lags:
            behind += [once := lagged(driven, time), lagged(once, time)]
        return min(self.error(columns, self.beside) for columns in behind)

    def static(self, x: np.ndarray) -> np.ndarray:
        """Columns of hysteresis whose envelopes are free: of plays, and of the branches where the input rises and falls.

        A loop of one amplitude and rate leaves nothing beyond for a resonance to explain.
        """
        hinges = lambda values: np.maximum(values[:, None] - _KNOTS, 0.0)
        rises = np.gradient(x) > 0
        branches = [
            np.where(rises[:, None] == side, np.column_stack([np.ones_like(x), x, hinges(x)]), 0.0)
            for side in (True, False)
        ]
        envelopes = [hinges(play) for play in self.hysteresis[:, 3:].T]
        return np.hstack([self.hysteresis, *branches, *envelopes])

    def error_corrected(self, columns: np.ndarray) -> float:
        """Root mean square error of the output by columns and those beside them, corrected for their number."""
        parts = np.hstack([columns, self.beside])
        freedom = 1 - parts.shape[1] / np.count_nonzero(self.used)
        return self.error(parts) / np.sqrt(freedom) if freedom > 0 else np.inf

    def _error_with(self, frequency: float, damping: float) -> float:
        return self.error(_filtered(self.hysteresis, frequency, damping), self.beside)

    def best_resonance(self, response: _Response) -> tuple[float, float, float]:
        """Least rms error with a second-order filter, its natural frequency [1/interval] and its damping ratio."""
        from scipy.optimize import minimize

        low, high = response.frequency[0], min(0.4, 8 * response.frequency[-1])
        peak = response.frequency[int(np.argmax(response.gain))]
        grid = [*np.geomspace(low, high, max(4, round(4 * np.log2(high / low)))), peak, _natural_frequency(response)]
        starts = [(self._error_with(f, d), f, d) for f in np.clip(grid, low, high) for d in _DAMPING]
        _, frequency, damping = min(starts)
        bounded = lambda z: (float(np.clip(np.exp(z[0]), low, high)), float(np.clip(np.exp(z[1]), 1e-3, 2.0)))
        found = minimize(
            lambda z: self._error_with(*bounded(z)),
            np.log([frequency, damping]),
            method="Nelder-Mead",
            options={"maxfev": 50, "xatol": 0.01, "fatol": 1e-7},
        )
        return float(found.fun), *bounded(found.x)


def _natural_frequency(response: _Response) -> float:
    """Natural frequency by least squares of u/y = k - m w^2 + i w c over the excited bands [1/interval]."""
    inverse = np.exp(-1j * np.radians(response.phase)) / np.maximum(response.gain, 1e-12)
    design = np.stack([np.ones_like(response.frequency), -(response.frequency**2)], axis=1)
    weight = response.gain[:, None]
    stiffness, mass = np.linalg.lstsq(design * weight, inverse.real * weight[:, 0], rcond=None)[0]
    return float(np.sqrt(stiffness / mass)) if stiffness > 0 and mass > 0 else float(response.frequency[-1])


def delayed(columns: np.ndarray, delay: float) -> np.ndarray:
    """Columns delayed by a number of samples, linear between samples."""
    when = np.maximum(np.arange(len(columns)) - delay, 0.0)
    whole = np.floor(when).astype(int)
    part = (when - whole)[:, None]
    return columns[whole] * (1 - part) + columns[np.minimum(whole + 1, len(columns) - 1)] * part


def _filtered(columns: np.ndarray, frequency: float, damping: float) -> np.ndarray:
    """Columns behind a second-order filter of static gain one, from rest (bilinear transform, exact at its natural frequency)."""
    w = np.tan(np.pi * frequency)
    norm = 1 + 2 * damping * w + w**2
    denominator = (1.0, 2 * (w**2 - 1) / norm, (1 - 2 * damping * w + w**2) / norm)
    above = columns - columns[0]
    driven = above.copy()
    driven[1:] += 2 * above[:-1]
    driven[2:] += above[:-2]
    return columns[0] + recursion(denominator, w**2 / norm * driven)
