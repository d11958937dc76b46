"""Delay of the output behind the input, as distinct from hysteresis.

The output of rate-independent hysteresis turns at the same time as the input, however wide the loop. Around every turning
point the output is fitted by one polynomial of the delayed input before the turn and another after it, joined at the turn;
the lag is the delay at which all turns fit best.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg.lapack import dgtsv

from hystfit.data.preparation import smooth

Spline = Callable[[Any], Any]  # of positions, numbers of samples, with any shape

SIDES = (2, 3)  # degree of the polynomial before and after a turn: branches curve most just after it
# Range of a fit as a fraction of the shorter neighboring branch; the first with enough samples.
NEAR = 0.12, 0.2, 0.35
# How far the output goes on after a turn within the lag, over how far it came within a lag before: a lag gives a third behind a sine and 1
# behind a triangle, a play or a valve that sticks 0. Half of the least.
_GOES_ON = 1 / 6
# Error of the method, as the polynomials follow a branch but nearly: samples of coarse cycles, and part of a half cycle of fine ones, which
# is what plays of 15 to 60 widths had as a lag in 2000 to 30 000 samples a cycle.
_OF_SAMPLES, _OF_HALF_CYCLE = 0.1, 3e-4
# Change of the input by smoothing at its turns, in rms of its noise, that noise alone makes at most: 1.5 at the turns of sines.
_NOISE_OF_TURNS = 2


@dataclasses.dataclass(frozen=True)
class Lag:
    """Time for which the output keeps moving after the input has turned.

    Attributes:
        samples: delay in samples; negative where the output turns first (as a velocity-dependent force does).
        stderr: its standard error [samples], from the scatter over the turns, upper against lower turns, two ranges of the fit,
            and the error of the method.
        seconds: delay in the unit of time; None without time.
        turns: number of turning points used.
    """

    samples: float
    stderr: float
    seconds: float | None
    turns: int


@dataclasses.dataclass(frozen=True)
class _Turn:
    """Samples around one turning point, its position and direction, and the range of the input that is fitted."""

    index: np.ndarray
    at: float
    upper: bool
    scale: float


def _smooth(u: np.ndarray, noise: float | None, reversals: np.ndarray) -> np.ndarray:
    """The input without its noise; as it is where smoothing would change its turns by more than the noise, as those of a triangle."""
    if not noise:
        return u
    smoothed = smooth(u, 7)
    return smoothed if np.median(np.abs(smoothed - u)[reversals]) < _NOISE_OF_TURNS * noise else u


def _cubic_spline(values: np.ndarray) -> Spline:
    """The cubic B-spline through samples, shape (T,), mirrored at its ends.

    As by `scipy.ndimage.map_coordinates`, whose import takes as long as the lag.
    """
    size = values.size
    beside, inner = np.ones(size - 1), np.full(size, 4.0)
    above, below = np.append(2.0, beside[1:]), np.append(beside[1:], 2.0)
    coefficients = np.pad(dgtsv(below, inner, above, 6 * values)[3], 2, mode="reflect")

    def spline(at: Any) -> np.ndarray:
        left = np.clip(np.floor(at).astype(int), 0, size - 1)
        s = at - left
        weights = (1 - s) ** 3, 4 - 3 * s**2 * (2 - s), 1 + 3 * s * (1 + s - s**2), s**3
        return np.sum([weight * coefficients[left + k] for k, weight in enumerate(weights, start=1)], axis=0) / 6

    return spline


def _turns(u: np.ndarray, spline: Spline, reversals: np.ndarray, reach: int, near: float) -> list[_Turn]:
    """The usable turning points, forty at most, which tell as much as all."""
    knots = np.concatenate([[0], reversals, [u.size - 1]])
    found = []
    for before, turn, after in zip(knots[:-2], knots[1:-1], knots[2:], strict=True):
        stroke = float(min(abs(u[turn] - u[before]), abs(u[after] - u[turn])))
        if stroke < 0.3 * np.ptp(u):
            continue
        far = near * stroke
        left, right = np.abs(u[turn:before:-1] - u[turn]) > far, np.abs(u[turn:after] - u[turn]) > far
        start = turn - (int(np.argmax(left)) if left.any() else turn - before)
        stop = turn + (int(np.argmax(right)) if right.any() else after - turn)
        index = np.arange(start, stop + 1)
        rests = np.mean(np.abs(np.diff(u[index])) < 1e-6 * stroke) > 0.2 if index.size > 1 else True
        if turn - start < 5 or stop - turn < 5 or start < reach or stop + reach >= u.size or rests:
            continue
        upper = bool(u[turn] > u[before])
        grid = np.linspace(turn - 1, turn + 1, 41)
        at = float(grid[np.argmax(spline(grid) * (1 if upper else -1))])
        found.append(_Turn(index, at, upper, far))
    keep = np.unique(np.linspace(0, len(found) - 1, min(len(found), 40)).round().astype(int))
    return [found[k] for k in keep]


def _misfit(turn: _Turn, y: np.ndarray, spline: Spline, delays: np.ndarray) -> np.ndarray:
    """Residual sum of squares of the two polynomials at every delay, shape (D,)."""
    value = y[turn.index]
    when = turn.index - delays[:, None]
    s = (spline(when) - spline(turn.at)) / turn.scale
    before, after = np.where(when > turn.at, 0.0, s), np.where(when > turn.at, s, 0.0)
    columns = [
        np.ones_like(s),
        *(before**k for k in range(1, SIDES[0] + 1)),
        *(after**k for k in range(1, SIDES[1] + 1)),
    ]
    basis, size, _ = np.linalg.svd(np.stack(columns, axis=2), full_matrices=False)
    basis = np.where((size > 1e-9 * size[:, :1])[:, None, :], basis, 0.0)
    fitted = basis @ (value @ basis)[:, :, None]
    return np.sum((value - fitted[:, :, 0]) ** 2, axis=1)


def _lowest(delays: np.ndarray, misfit: np.ndarray) -> float | None:
    """Delay of the least misfit, by a parabola through the three lowest points; None at an end of the range."""
    k = int(np.argmin(misfit))
    if k in (0, delays.size - 1):
        return None
    low, mid, high = misfit[k - 1 : k + 2]
    bend = low - 2 * mid + high
    return float(delays[k] + 0.5 * (low - high) / bend * (delays[1] - delays[0])) if bend > 0 else None


def estimate_lag(
    u: np.ndarray, y: np.ndarray, interval: float | None, reversals: np.ndarray, *, u_noise: float | None = None
) -> Lag | None:
    """Delay of y behind u, separated from rate-independent hysteresis.

    A pure delay, a fast first-order lag and creep just after the turn are not distinguished.

    Args:
        u: input, shape (T,).
        y: output, shape (T,).
        interval: sampling interval [unit of time] of evenly spaced samples; None without time.
        reversals: turning points of u, see `loops.reversals`.
        u_noise: rms of the noise on u [unit of u]; a noisy input is smoothed first.

    Returns:
        None with fewer than three usable turns, where branches are too short or hold at the turn, or without a best delay
        clearly within a quarter of a branch and 20 samples.
    """
    u, y = np.asarray(u, dtype=float), np.asarray(y, dtype=float)
    if reversals.size < 2:
        return None
    reach = int(min(20, np.median(np.diff(reversals)) // 4))
    if reach < 2:
        return None
    spline = _cubic_spline(_smooth(u, u_noise, reversals))
    delays = np.arange(-reach, reach + 0.25, 0.5)
    estimates = []
    for near in NEAR:
        turns = [turn for turn in _turns(u, spline, reversals, reach, near) if np.isfinite(y[turn.index]).all()]
        if len(turns) >= 3:
            estimates.append(_over_turns(turns, y, spline, delays))
        if len(estimates) == 2:
            break
    if not estimates:
        return None
    best, stderr, count = estimates[0]
    if abs(best) + 2 * stderr >= reach:
        return None
    stderr = float(np.hypot(stderr, estimates[-1][0] - best))
    stderr = float(np.hypot(stderr, _OF_HALF_CYCLE * np.median(np.diff(reversals))))
    if stderr > max(2.0, 0.5 * abs(best)) or _rests(turns, y, best):
        return None
    return Lag(best, stderr, None if interval is None else best * interval, count)


def _rests(turns: list[_Turn], y: np.ndarray, lag: float) -> bool:
    """Whether the output rests at the turns of the input, where it would go on behind a lag of this many samples, or turn before.

    A saturated output rests throughout.
    """
    if abs(lag) < 1:
        return False
    way = np.array([1.0 if turn.upper else -1.0 for turn in turns])
    before, at, after = (
        np.interp([turn.at + shift for turn in turns], np.arange(y.size), y) for shift in (-lag, 0.0, lag)
    )
    short = way * ((after - at) - _GOES_ON * (at - before))
    return bool(short.mean() + 2 * short.std(ddof=1) / np.sqrt(short.size) <= 0)


def _over_turns(turns: list[_Turn], y: np.ndarray, spline: Spline, delays: np.ndarray) -> tuple[float, float, int]:
    """Best delay over all turns, its jackknife standard error, infinite at an end of the range, and the number of turns."""
    misfit = np.array([_misfit(turn, y, spline, delays) for turn in turns])
    best = _lowest(delays, misfit.sum(axis=0))
    without = [_lowest(delays, misfit.sum(axis=0) - one) for one in misfit]
    known = np.array([value for value in without if value is not None])
    if best is None or known.size < 2:
        return float(delays[np.argmin(misfit.sum(axis=0))]), np.inf, len(turns)
    scatter = np.sqrt((known.size - 1) / known.size * np.sum((known - known.mean()) ** 2))
    upper = np.array([turn.upper for turn in turns])
    sides = [_lowest(delays, misfit[side].sum(axis=0)) for side in (upper, ~upper) if side.any()]
    both = len(sides) == 2 and None not in sides
    gap = 0.5 * abs(sides[0] - sides[1]) if both else 0.5  # type: ignore[operator]
    return best, float(np.sqrt(scatter**2 + gap**2 + _OF_SAMPLES**2)), len(turns)
