"""Trend of the output over a whole record, whatever its cycles are: a share of what hysteresis of the input leaves unexplained."""

from __future__ import annotations

import numpy as np

from hystfit.quality.baselines import play_positions
from hystfit.quality.lag import unexplained

_MOST = 4000  # samples used
_FEWEST = 200
_EXPLAINED = 0.5  # least share of the unexplained variance that the trend explains
_VISIBLE = 0.01  # least trend over the record, as a fraction of the range of y
_RADII = np.geomspace(0.03, 1.0, 8)  # of plays, for an input from -1 to 1


def rate_independent_columns(u: np.ndarray) -> np.ndarray:
    """Regressors of a flexible rate-independent model: polynomials of the input and of plays of it, shape (T, K)."""
    x = 2 * (u - u.min()) / np.ptp(u) - 1
    plays = play_positions(x, _RADII)
    return np.column_stack([np.ones_like(x), x, x**2, x**3, x**5, plays, plays**2, plays**3])


def linear_trend(u: np.ndarray, y: np.ndarray, t: np.ndarray) -> float | None:
    """Change of the output over the record along a straight line in time, apart from hysteresis [unit of y]; None without one.

    Args:
        u: input, shape (T,).
        y: output, shape (T,).
        t: time, shape (T,).
    """
    stride = -(-u.size // _MOST)
    used = np.isfinite(y[::stride])
    if used.sum() < _FEWEST or not (np.ptp(u) > 0 and np.ptp(t) > 0):
        return None
    columns, y = rate_independent_columns(u)[::stride][used], y[::stride][used]
    passed = ((t - t[0]) / np.ptp(t))[::stride][used]
    beside = lambda values: values - columns @ np.linalg.lstsq(columns, values, rcond=1e-7)[0]
    along, error = beside(passed), unexplained(columns, y, 1e-7)
    slope = float(along @ beside(y) / (along @ along))
    with_trend = error - slope**2 * float(np.mean(along**2))
    found = with_trend < (1 - _EXPLAINED) * error and abs(slope) > _VISIBLE * np.ptp(y)
    return slope if found else None
