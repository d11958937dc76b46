"""Levenberg-Marquardt driven from the host, for the last steps of a fit on all samples.

It needs no program but that of residuals and Jacobian, which the standard errors use as well: a compiled solver for each length of
the records would cost about 2 s of compilation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hystfit.inference.problem import Problem

_GAIN = 1e-10  # predicted decrease of the cost, relative to it, at which the fit has converged: 1e-3 standard errors at 10 000 samples
_ROUNDING = 1e-28  # decrease for each sample that is below rounding errors
_LEAST, _MOST = 1e-12, 1e10  # damping
_LONGEST = 4.0  # step in z, infinity norm


class Polished(NamedTuple):
    """Where the steps ended: unconstrained z, the cost there, whether they converged, and the number of linearizations."""

    z: np.ndarray
    cost: float
    converged: bool
    evaluations: int


def polish(problem: Problem, z: np.ndarray, steps: int = 40) -> Polished:
    """Minimize half the sum of squared misfits from a point near the minimum.

    The Jacobian enters by its triangular factor, not by normal equations, which would square its condition.

    Args:
        problem: what is fitted.
        z: start, unconstrained, shape (p,).
        steps: linearizations at most.
    """
    residual, jacobian = _linearize(problem, z)
    cost, damping, converged = 0.5 * float(residual @ residual), 1e-6, False
    for evaluations in range(1, steps):
        triangle = np.linalg.qr(np.column_stack([jacobian, residual]), mode="r")
        step, gain = _step(triangle[:-1, :-1], triangle[:-1, -1], damping)
        converged = gain <= _GAIN * cost + _ROUNDING * residual.size
        if converged or damping > _MOST or not np.isfinite(cost):
            return Polished(z, cost, converged, evaluations)
        new_residual, new_jacobian = _linearize(problem, z + step)
        new_cost = 0.5 * float(new_residual @ new_residual)
        if new_cost < cost:
            z, residual, jacobian, cost = z + step, new_residual, new_jacobian, new_cost
            damping = max(0.1 * damping, _LEAST)
        else:
            damping *= 10.0
    return Polished(z, cost, converged, steps)


def _linearize(problem: Problem, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    residual, jacobian = problem.linearize_misfit(problem.space.physical(z))
    return residual, jacobian * problem.space.slope(z)


def _step(R: np.ndarray, q: np.ndarray, damping: float) -> tuple[np.ndarray, float]:
    """Damped step from J = Q R and q = Q' r, and the decrease of the cost that the linear model predicts for it."""
    size = np.maximum(np.linalg.norm(R, axis=0), 1e-12 * max(float(np.abs(R).max(initial=0.0)), 1e-300))
    rows = np.vstack([R, np.diag(np.sqrt(damping) * size)])
    step = np.linalg.lstsq(rows / size, np.concatenate([-q, np.zeros(q.size)]), rcond=None)[0] / size
    step = step * min(1.0, _LONGEST / max(float(np.max(np.abs(step))), 1e-300))
    return step, 0.5 * float(q @ q - np.sum((R @ step + q) ** 2))
