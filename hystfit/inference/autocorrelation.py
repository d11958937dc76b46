"""Autocorrelation of residuals."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

FEWEST = 30  # values of a series below which no test shows that it is autocorrelated
_FEW = 20  # lags for which direct sums are faster than Fourier transforms


def autocorrelation(x: np.ndarray, lags: int) -> np.ndarray:
    """Autocorrelation of a series about its mean at lags 0..lags, shape (lags + 1,)."""
    x = np.asarray(x, float) - np.mean(x)
    if lags <= _FEW:
        sums = np.array([x[: x.size - lag] @ x[lag:] for lag in range(min(lags + 1, x.size))])
        sums = np.pad(sums, (0, lags + 1 - sums.size))
    else:
        size = 1 << (2 * x.size - 1).bit_length()
        spectrum = np.fft.rfft(x, size)
        sums = np.fft.irfft(spectrum * np.conj(spectrum), size)[: lags + 1]
    return sums / sums[0] if sums[0] > 0 else np.eye(lags + 1)[0]


def is_correlated(x: np.ndarray) -> bool:
    """Whether a series is autocorrelated, by the Ljung-Box test of its first ten lags at 1 %; never below `FEWEST` samples."""
    return bool(correlated_rows(np.asarray(x, float)[None])[0])


def correlated_rows(x: Float[Any, "N T"], xp: Any = np) -> Any:
    """`is_correlated` of each row, shape (N,), bool; `xp` is the module of the arrays, NumPy or jax.numpy."""
    n = x.shape[1]
    if n < FEWEST:
        return xp.zeros(len(x), bool)
    x = x - x.mean(axis=1, keepdims=True)
    power = xp.vecdot(x, x)[:, None]
    sums = xp.stack([xp.vecdot(x[:, :-lag], x[:, lag:]) for lag in range(1, 11)], axis=1)
    first = xp.where(power > 0, sums / xp.where(power > 0, power, 1.0), 0.0)
    limit = 23.21  # 99 % point of chi squared with ten degrees of freedom
    return n * (n + 2) * xp.sum(first**2 / (n - np.arange(1, 11)), axis=1) >= limit


def autocorrelation_time(x: np.ndarray) -> float:
    """Integrated autocorrelation time of residuals in samples; 1 for white noise, and when no correlation is significant.

    Sokal's window (five times the time itself). It can be 1 for an oscillating series, whose correlations cancel in the sum.
    """
    if not is_correlated(x):
        return 1.0
    rho = autocorrelation(x, min(x.size // 2, 5000))
    times = 2 * np.cumsum(rho) - 1
    window = np.flatnonzero(np.arange(times.size) >= 5 * times)
    return float(max(1.0, times[window[0] if window.size else -1]))
