"""How far a prediction is from a measurement, in the measurement's units and in percent of its range."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np


@dataclasses.dataclass(frozen=True)
class Metrics:
    """Errors over the samples that count; the range is max - min of the measured output over the same samples.

    Attributes:
        rmse, max_error: in output units.
        nrmse_percent, max_error_percent: of the range; None where the range is zero.
        r2: explained part of the variance; None where there is none.
        n: number of samples.
    """

    rmse: float
    nrmse_percent: float | None
    max_error: float
    max_error_percent: float | None
    r2: float | None
    n: int

    @classmethod
    def of(cls, measured: Sequence[np.ndarray], predicted: Sequence[np.ndarray]) -> Metrics:
        """Metrics over records: arrays (T_r,) of the samples that count."""
        y, error = np.concatenate(measured), np.concatenate(predicted) - np.concatenate(measured)
        span, variance = float(np.ptp(y)), float(np.sum((y - y.mean()) ** 2))
        rmse, largest = float(np.sqrt(np.mean(error**2))), float(np.max(np.abs(error)))
        percent = lambda value: 100 * value / span if span > 0 else None
        r2 = 1 - float(np.sum(error**2)) / variance if variance > 0 else None
        return cls(rmse, percent(rmse), largest, percent(largest), r2, y.size)

    def to_dict(self) -> dict[str, float | int | None]:
        """For `result.json`."""
        return {k: (v if v is None or np.isfinite(v) else None) for k, v in dataclasses.asdict(self).items()}


def autocorrelation(x: np.ndarray, lags: int) -> np.ndarray:
    """Autocorrelation of a series about its mean at lags 0..lags, shape (lags + 1,)."""
    x = np.asarray(x, float) - np.mean(x)
    size = 1 << (2 * x.size - 1).bit_length()
    spectrum = np.fft.rfft(x, size)
    full = np.fft.irfft(spectrum * np.conj(spectrum), size)[: lags + 1]
    return full / full[0] if full[0] > 0 else np.eye(lags + 1)[0]


def is_correlated(x: np.ndarray) -> bool:
    """Whether a series is correlated in time: the Ljung-Box statistic of its first ten lags, at 1 %. Thirty samples at least."""
    n = x.size
    if n < 30:
        return False
    first = autocorrelation(x, 10)[1:]
    limit = 23.21  # 99 % point of chi squared with ten degrees of freedom
    return n * (n + 2) * float(np.sum(first**2 / (n - np.arange(1, 11)))) >= limit


def autocorrelation_time(x: np.ndarray) -> float:
    """Integrated autocorrelation time of residuals in samples; 1 for white noise, and when no correlation is significant.

    Sokal's window (five times the time itself). It may be 1 for a series that swings: its correlations cancel in the sum.
    """
    if not is_correlated(x):
        return 1.0
    rho = autocorrelation(x, min(x.size // 2, 5000))
    times = 2 * np.cumsum(rho) - 1
    window = np.flatnonzero(np.arange(times.size) >= 5 * times)
    return float(max(1.0, times[window[0] if window.size else -1]))
