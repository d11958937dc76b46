"""Variable projection (Golub and Pereyra 1973): nonlinear parameters are searched for, and the weights beside them solved for inside."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy  # loads its subpackages when they are first used, which optimize is not in most fits
from jaxtyping import Float

from hystfit.inference.problem import Problem

_STEP = 1e-3  # of forward differences, in the natural scales of the parameters: weights at a bound make derivatives of smaller ones uneven
_LEVEL = 1e-15  # of the largest derivative of the sum of squares: where the parameters have no effect, which else divides by zero in SciPy


class Searched(NamedTuple):
    """Where a search ended: physical parameters, shape (p,), the number of evaluations, whether it converged, and a message."""

    x: np.ndarray
    evaluations: int
    converged: bool
    message: str


def search_nonlinear(
    problem: Problem,
    residuals: Callable[[np.ndarray], Float[np.ndarray, " n"]],
    z: np.ndarray,
    others: np.ndarray,
    *,
    steps: int,
    gain: float,
) -> Searched:
    """Minimize the sum of squares that the weights leave, from unconstrained z, shape (p,), by Gauss-Newton steps in a trust region.

    Args:
        problem: has the coordinates of the parameters.
        residuals: of physical parameters, shape (p,), with the weights that suit them best; the roots of what a penalty adds come last.
        others: positions of the nonlinear parameters, shape (q,).
        steps: at most, those that are refused included, such as into parameters at which a simulation is not finite.
        gain: relative decrease of the sum of squares at which the search ends.
    """
    evaluations, last = 0, (b"", np.empty(0))

    def at(moved: np.ndarray) -> np.ndarray:
        trial = z.copy()
        trial[others] += moved
        return np.array(problem.space.physical(trial))

    def left(moved: np.ndarray) -> np.ndarray:
        nonlocal evaluations, last
        if moved.tobytes() != last[0]:
            try:
                with np.errstate(all="ignore"):
                    found = residuals(at(moved))
            except np.linalg.LinAlgError:  # of equations that are not finite
                found = np.full(last[1].shape, np.nan)
            evaluations, last = evaluations + 1, (moved.tobytes(), found)
        return last[1]

    def slopes(moved: np.ndarray) -> np.ndarray:
        before = left(moved)
        columns = [(left(moved + _STEP * unit) - before) / _STEP for unit in np.eye(others.size)]
        return np.stack([column if np.isfinite(column).all() else np.zeros_like(column) for column in columns], axis=1)

    still = np.zeros(others.size)  # from zero the first steps are at most one natural scale long
    if not np.isfinite(left(still)).all():
        return Searched(at(still), 1, False, "the model is not finite at its starting values")
    solution = scipy.optimize.least_squares(left, still, slopes, ftol=gain, xtol=_STEP, gtol=_LEVEL, max_nfev=steps)
    converged = solution.status > 0
    stopped = f"the search over nonlinear parameters stopped after {evaluations} evaluations"
    return Searched(at(solution.x), evaluations, converged, "converged" if converged else stopped)
