"""A lag of the output of many samples, which the turns of the loops do not show: hysteresis of the lagged input describes it better."""

from __future__ import annotations

import numpy as np

from hystfit.quality.baselines import MOST_OF
from hystfit.quality.delay import MOST
from hystfit.quality.held_out import GAIN
from hystfit.quality.host_operators import lagged, play_positions
from hystfit.quality.resonance import FEWEST, explains, unexplained

SHORT = 6.0  # samples up to which a lag is short
_RADII = np.geomspace(0.03, 1.0, 8)  # of plays, for an input from -1 to 1


def estimate_slow_lag(u: np.ndarray, y: np.ndarray, turns: np.ndarray) -> float | None:
    """Lag of the output behind the input [samples] where it is longer than `SHORT`; None without one.

    A flexible rate-independent model is fitted behind lags of the input.

    Args:
        u: input of evenly spaced samples, shape (T,).
        y: output, shape (T,).
        turns: turning points of u, see `loops.reversals`.
    """
    if not _shows_loops(u, y, turns):
        return None
    longest = float(np.median(np.diff(turns))) / 4
    if longest <= SHORT:
        return None
    without = _error(u, y)
    if not explains(0.0, without):
        return None
    lags = np.geomspace(SHORT, longest, 10)
    errors = np.array([_error(lagged(lagged(u[:, None], lag / 2), lag / 2)[:, 0], y) for lag in lags])
    best = int(np.argmin(errors))
    found = explains(errors[best], without) and errors[best] < MOST_OF * errors[0]
    return float(lags[best]) if found else None


def likeliest_lag(u: np.ndarray, y: np.ndarray, turns: np.ndarray) -> float | None:
    """First-order lag [samples] behind which such a model errs least, of half a sample to half a branch; None where none lowers its error.

    It is a starting value, and no evidence of a lag; arguments as for `estimate_slow_lag`.
    """
    if not _shows_loops(u, y, turns):
        return None
    lags = np.geomspace(0.5, max(1.0, float(np.median(np.diff(turns))) / 2), 16)
    errors = [_error(lagged(u[:, None], lag)[:, 0], y) for lag in lags]
    best = int(np.argmin(errors))
    return float(lags[best]) if errors[best] < GAIN * _error(u, y) else None


def _shows_loops(u: np.ndarray, y: np.ndarray, turns: np.ndarray) -> bool:
    return turns.size >= 3 and np.isfinite(y).sum() >= FEWEST and np.ptp(u) > 0


def _error(u: np.ndarray, y: np.ndarray) -> float:
    """Rms error of a flexible rate-independent model of the input, over the range of the output."""
    stride, used = -(-u.size // MOST), np.isfinite(y)
    rows = used[::stride]
    return unexplained(_rate_independent(u)[::stride][rows], y[::stride][rows]) / float(np.ptp(y[used]))


def _rate_independent(u: np.ndarray) -> np.ndarray:
    """Regressors of a flexible rate-independent model: polynomials of the input and of plays of it, shape (T, K)."""
    x = 2 * (u - u.min()) / np.ptp(u) - 1
    plays = play_positions(x, _RADII)
    return np.column_stack([np.ones_like(x), x, x**2, x**3, x**5, plays, plays**2, plays**3])
