"""Standard errors under the noise in the residuals, relative to those for independent noise."""

from __future__ import annotations

import numpy as np

from hystfit.inference.blocks import parts, triangle
from hystfit.inference.noise.slow_likelihood import least_squares_root
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import analyze

RANK = 1e-7  # singular value, relative to the largest of columns of unit length, below which rounding errors dominate


def error_ratios(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Standard errors of a least-squares fit at x under the noise in its residuals, over those for independent noise, shape (p,)."""
    residuals = analyze(problem, x)
    ratios = np.full(x.size, np.sqrt(residuals.correlation_time))
    if residuals.of_errors is None or residuals.derivatives is None:
        return ratios
    live = ~problem.on_bound(x)
    J = residuals.derivatives() * problem.scales.y
    plain = float(np.sum(residuals.residual**2)) / max(len(J) - J.shape[1], 1)
    independent = triangle((J[part] for part in parts(*J.shape)), J.shape[1])
    root = least_squares_root(residuals.of_errors, J, overwrite=True)
    ratios[live] = np.exp(_log_ratios(root, independent, plain))
    return np.where(np.isfinite(ratios), ratios, np.sqrt(residuals.correlation_time))


def mean_error_ratio(root: np.ndarray, J: np.ndarray, variance: float) -> float:
    """Geometric mean of standard errors under a noise model over those for independent noise; 1 where neither is finite."""
    logs = _log_ratios(root, J, variance)
    logs = logs[np.isfinite(logs)]
    return float(np.exp(logs.mean())) if logs.size else 1.0


def _log_ratios(root: np.ndarray, J: np.ndarray, variance: float) -> np.ndarray:
    with np.errstate(all="ignore"):
        errors = [np.sum(np.linalg.pinv(A, rcond=RANK) ** 2, axis=1) for A in (root, J)]
        return 0.5 * np.log(errors[0] / (errors[1] * variance))
