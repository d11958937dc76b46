"""Variable projection (Golub and Pereyra 1973): nonlinear parameters are searched for, and the weights beside them solved for inside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy  # loads its subpackages when they are first used, which optimize is not in most fits
from jaxtyping import Float

from hystfit.inference.problem import Problem

_STEP = 1e-3  # of forward differences, in the natural scales of the parameters: weights at a bound make derivatives of smaller ones uneven
_LEVEL = 1e-15  # cosine between the residuals and their derivatives at which nothing can be gained: only the gain ends a search


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
    """Minimize the sum of squares that the weights leave, from unconstrained z, shape (p,), by the steps of Levenberg and Marquardt.

    Args:
        problem: has the coordinates of the parameters.
        residuals: of physical parameters, shape (p,), with the weights that suit them best; the roots of what a penalty adds come last.
        others: positions of the nonlinear parameters, shape (q,).
        steps: at most, those that are refused included.
        gain: relative decrease of the sum of squares at which the search ends.
    """
    evaluations, last = 0, (b"", np.empty(0))

    def at(inner: np.ndarray) -> np.ndarray:
        trial = z.copy()
        trial[others] = inner
        return np.array(problem.space.physical(trial))

    def left(inner: np.ndarray) -> np.ndarray:
        nonlocal evaluations, last
        if inner.tobytes() != last[0]:
            evaluations, last = evaluations + 1, (inner.tobytes(), residuals(at(inner)))
        return last[1]

    def slopes(inner: np.ndarray) -> np.ndarray:
        before = left(inner)
        return np.stack([(left(inner + _STEP * unit) - before) / _STEP for unit in np.eye(others.size)], axis=1)

    # MINPACK: the trust region of SciPy divides by zero where a parameter has no effect.
    settings: dict[str, Any] = {"method": "lm", "ftol": gain, "xtol": _STEP, "gtol": _LEVEL, "max_nfev": steps}
    solution = scipy.optimize.least_squares(left, z[others], slopes, **settings)
    converged = solution.status > 0
    stopped = f"the search over nonlinear parameters stopped after {evaluations} evaluations"
    return Searched(at(solution.x), evaluations, converged, "converged" if converged else stopped)
