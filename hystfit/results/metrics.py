"""Error of a prediction, in output units and in percent of the measured range."""

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
