"""A lag of the output of many samples, which the turns of the loops do not show: hysteresis of the lagged input describes it better."""

from __future__ import annotations

import numpy as np

from hystfit.quality.baselines import MOST_OF
from hystfit.quality.delay import MOST
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
    used = np.isfinite(y)
    if turns.size < 3 or used.sum() < FEWEST or np.ptp(u) == 0:
        return None
    stride = -(-u.size // MOST)
    longest = float(np.median(np.diff(turns))) / 4
    if longest <= SHORT:
        return None
    span = float(np.ptp(y[used]))

    def error(lag: float) -> float:
        behind = lagged(lagged(u[:, None], lag / 2), lag / 2)[:, 0] if lag else u
        rows = used[::stride]
        columns = _rate_independent(behind)[::stride][rows]
        return unexplained(columns, y[::stride][rows]) / span

    without = error(0.0)
    if not explains(0.0, without):
        return None
    lags = np.geomspace(SHORT, longest, 10)
    errors = np.array([error(lag) for lag in lags])
    best = int(np.argmin(errors))
    found = explains(errors[best], without) and errors[best] < MOST_OF * errors[0]
    return float(lags[best]) if found else None


def _rate_independent(u: np.ndarray) -> np.ndarray:
    """Regressors of a flexible rate-independent model: polynomials of the input and of plays of it, shape (T, K)."""
    x = 2 * (u - u.min()) / np.ptp(u) - 1
    plays = play_positions(x, _RADII)
    return np.column_stack([np.ones_like(x), x, x**2, x**3, x**5, plays, plays**2, plays**3])
