"""A lag of the output of many samples, which the turns of the loops do not show: hysteresis of the lagged input describes it better."""

from __future__ import annotations

import numpy as np

from hystfit.quality.lag import unexplained
from hystfit.quality.resonance import lagged
from hystfit.quality.trend import rate_independent_columns

SHORT = 6.0  # samples up to which a lag is short
_MOST = 4000  # samples used
_FEWEST = 400
_LAGS = 10  # that are tried
_LONGEST = 0.25  # of a branch
_VISIBLE = 0.005  # rms error without a lag, as a fraction of the range of y, below which none is sought
_BETTER = 0.5, 0.7  # error with the lag over that without one, and over that with a short one, below which it is found


def estimate_slow_lag(u: np.ndarray, y: np.ndarray, turns: np.ndarray) -> float | None:
    """Lag of the output behind the input [samples] where it is longer than `SHORT`; None without one.

    A flexible rate-independent model is fitted behind lags of the input.

    Args:
        u: input of evenly spaced samples, shape (T,).
        y: output, shape (T,).
        turns: turning points of u, see `loops.reversals`.
    """
    used = np.isfinite(y)
    if turns.size < 3 or used.sum() < _FEWEST or np.ptp(u) == 0:
        return None
    stride = -(-u.size // _MOST)
    longest = _LONGEST * float(np.median(np.diff(turns)))
    if longest <= SHORT:
        return None
    span = float(np.ptp(y[used]))

    def error(lag: float) -> float:
        behind = lagged(lagged(u[:, None], lag / 2), lag / 2)[:, 0] if lag else u
        rows = used[::stride]
        columns = rate_independent_columns(behind)[::stride][rows]
        return float(np.sqrt(unexplained(columns, y[::stride][rows], 1e-7))) / span

    without = error(0.0)
    if without < _VISIBLE:
        return None
    lags = np.geomspace(SHORT, longest, _LAGS)
    errors = np.array([error(lag) for lag in lags])
    best = int(np.argmin(errors))
    found = errors[best] < _BETTER[0] * without and errors[best] < _BETTER[1] * errors[0]
    return float(lags[best]) if found else None
