"""Pure delay: an output that repeats, a fixed time later, what it would be at once, as distinct from a lag, viscosity and hysteresis.

Hysteresis (plays and a cubic) of the input is fitted to the output by least squares for each of many delays. A delay is found
where it explains most of what hysteresis leaves behind a lag of any time constant and beside velocity terms.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from hystfit.quality.baselines import MOST_OF
from hystfit.quality.resonance import DECIDES, Regressors, delayed, scaled

MOST = 4000  # samples used; longer records are thinned
_RADII = np.geomspace(0.03, 1.2, 20)  # of the plays, in half ranges of the input
_FINE = np.linspace(0.02, 1.2, 60)  # a loop that switches within 6 % of the half range is left to no delay
_GRID, _LAGS = 48, 7  # delays and time constants tried
_LONGEST = 0.9  # of the median branch
SHORTEST = 2.0  # samples: a shorter delay is a lag, and a shorter lag beside a delay is an error of the delay
_VISIBLE = 0.002  # least rms error without the delay, as a fraction of the range of y: one of 12 samples at 100 a branch leaves 0.004


@dataclasses.dataclass(frozen=True)
class PureDelay:
    """Time by which the output comes after the input.

    Attributes:
        samples: the delay in samples.
        seconds: the same in the unit of time.
        error_without, error_with: rms error of hysteresis with a lag and velocity terms, and with the delay instead, as fractions of
            the range of y.
    """

    samples: float
    seconds: float
    error_without: float
    error_with: float


def estimate_delay(u: np.ndarray, y: np.ndarray, interval: float, reversals: np.ndarray) -> PureDelay | None:
    """Pure delay of y behind u.

    Args:
        u: input, shape (T,).
        y: output, shape (T,); missing values are omitted.
        interval: time between the evenly spaced samples [unit of t].
        reversals: turning points of u, see `loops.reversals`.

    Returns:
        None with fewer than 200 samples or two reversals among the outputs, or where a delay does not explain most of what a lag and
        velocity terms leave.
    """
    signals = scaled(u, y)
    if signals is None:
        return None
    x, y, used = signals
    known = np.flatnonzero(used)
    reversals = reversals[(reversals > known[0]) & (reversals < known[-1])]
    if reversals.size < 2:
        return None
    stride = -(-x.size // MOST)
    columns_of = lambda radii: Regressors.of(x[::stride], y[::stride], used[::stride], radii)
    branch = float(np.median(np.diff(reversals))) / stride
    lags = np.geomspace(0.02 * branch, branch, _LAGS)
    columns = columns_of(_RADII)
    without = columns.error_behind((0.0,), lags)
    if without < _VISIBLE:
        return None
    found = _best(lambda delay: _error(columns, delay), _LONGEST * branch)
    if found is None:
        return None
    samples, remaining = found
    if samples * stride < SHORTEST or remaining > MOST_OF * without:
        return None
    fine = columns_of(_FINE)  # a delay makes up for plays too coarse for a steep loop
    if _error(fine, samples) > MOST_OF * fine.error_behind((0.0,), lags):
        return None
    return PureDelay(samples * stride, samples * stride * interval, without, remaining)


def _error(columns: Regressors, delay: float) -> float:
    """Least rms error of hysteresis that is delayed by so many samples."""
    return columns.error(delayed(np.hstack([columns.hysteresis, columns.beside]), delay))


def _best(error: Callable[[float], float], longest: float) -> tuple[float, float] | None:
    """The shortest delay [samples] whose error is about the least, and its error; None where it is an end of the range."""
    delays = np.linspace(0.0, longest, _GRID)
    step = delays[1]
    errors = np.array([error(delay) for delay in delays])
    inner = np.flatnonzero((errors[1:-1] <= errors[:-2]) & (errors[1:-1] <= errors[2:])) + 1
    if not inner.size or step == 0:
        return None
    candidates = []
    for start in inner[errors[inner] <= 3 * errors[inner].min()]:
        at, size = delays[start], step
        while size > 0.05:
            near = at + size * np.array([-0.5, 0.0, 0.5])
            at, size = near[int(np.argmin([error(delay) for delay in near]))], 0.5 * size
        candidates.append((float(at), float(error(at))))
    least = min(value for _, value in candidates)
    return next(pair for pair in candidates if pair[1] <= DECIDES * least)
