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
        y = _joined(measured)
        span, variance = float(np.ptp(y)), _sum_of_squares(y - y.mean())
        error = _joined(predicted) - y
        largest = max(float(error.max()), -float(error.min()))
        squares = _sum_of_squares(error)
        rmse = float(np.sqrt(squares / y.size))
        percent = lambda value: 100 * value / span if span > 0 else None
        r2 = 1 - squares / variance if variance > 0 else None
        return cls(rmse, percent(rmse), largest, percent(largest), r2, y.size)

    def to_dict(self) -> dict[str, float | int | None]:
        """For `result.json`."""
        return {k: (v if v is None or np.isfinite(v) else None) for k, v in dataclasses.asdict(self).items()}


def _joined(rows: Sequence[np.ndarray]) -> np.ndarray:
    """One array of several; a single one as it is."""
    return np.asarray(rows[0]) if len(rows) == 1 else np.concatenate(rows)


def _sum_of_squares(values: np.ndarray) -> float:
    """The values are overwritten: long records have no room for copies."""
    return float(np.sum(np.multiply(values, values, out=values)))
