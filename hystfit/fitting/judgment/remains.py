"""What the residuals of a fit tell a comparison: whether they are noise, and over how many samples they are correlated."""

from __future__ import annotations

import numpy as np

from hystfit.fitting.judgment.verdict import are_white, may_be_noise, residuals_are_white, stands_out
from hystfit.quality.held_out import correlation_length
from hystfit.results.result import FitResult


def correlation_of(fit: FitResult) -> int:
    """Samples over which the residuals of a fit are correlated."""
    return max(map(correlation_length, residuals_of(fit)))


def residuals_of(fit: FitResult) -> list[np.ndarray]:
    """Prediction less measurement at the samples of each record that count [y]."""
    return [row[used] for row, used in zip(fit.problem.residuals(fit.x), fit.problem.used, strict=True)]


def leaves_noise(fit: FitResult, parameters: float) -> bool:
    """Whether the residuals of a fit are white, and its loop stands out of them, worth the parameters that the data determine."""
    return may_be_noise(fit.train.rmse, fit.baselines) and residuals_are_white(
        residuals_of(fit), fit.baselines.curve, parameters
    )


def without_loop(fit: FitResult, parameters: int) -> bool:
    """Whether the residuals of a fit are white, and no loop that takes as many parameters or more stands out of them."""
    rows = residuals_of(fit)
    return (
        may_be_noise(fit.train.rmse, fit.baselines)
        and are_white(rows)
        and not stands_out(rows, fit.baselines.curve, parameters)
    )
