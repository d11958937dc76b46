"""Standard errors under the noise in the residuals, relative to those for independent noise."""

from __future__ import annotations

import numpy as np

from hystfit.inference.noise.slow_likelihood import least_squares_root
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import analyze
from hystfit.params.space import relative_size

RANK = 1e-7  # singular value, relative to the largest of columns of unit length, below which rounding errors dominate


def error_ratios(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Standard errors of a least-squares fit at x under the noise in its residuals, over those for independent noise, shape (p,)."""
    residuals = analyze(problem, x)
    ratios = np.full(x.size, np.sqrt(residuals.correlation_time))
    if residuals.of_errors is None:
        return ratios
    live = ~problem.on_bound(x)
    used = problem.used.reshape(-1)
    jacobian = problem.with_loss("linear").linearize_misfit(x)[1]
    J = jacobian[used][:, live] * relative_size(problem.space, x)[live]
    root = least_squares_root(residuals.of_errors, J * problem.scales.y)
    plain = float(np.sum(residuals.residual**2)) / max(int(used.sum()) - int(live.sum()), 1) / problem.scales.y**2
    ratios[live] = np.exp(_log_ratios(root, J, plain))
    return np.where(np.isfinite(ratios), ratios, np.sqrt(residuals.correlation_time))


def mean_error_ratio(root: np.ndarray, J: np.ndarray, variance: float) -> float:
    """Geometric mean of standard errors under a noise model over those for independent noise; 1 where neither is finite."""
    logs = _log_ratios(root, J, variance)
    logs = logs[np.isfinite(logs)]
    return float(np.exp(logs.mean())) if logs.size else 1.0


def _log_ratios(root: np.ndarray, J: np.ndarray, variance: float) -> np.ndarray:
    with np.errstate(all="ignore"):
        errors = [np.sum(np.linalg.pinv(np.linalg.qr(A, mode="r"), rcond=RANK) ** 2, axis=1) for A in (root, J)]
        return 0.5 * np.log(errors[0] / (errors[1] * variance))
