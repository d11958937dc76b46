"""Variable projection (Golub and Pereyra 1973): nonlinear parameters are searched for, and the weights beside them solved for inside."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy  # loads its subpackages when they are first used, which optimize is not in most fits
from jaxtyping import Float

from hystfit.inference.problem import Problem

# Step of forward differences and of the last one of a search, in natural scales of the parameters: outputs of cells have kinks as an
# input that a parameter moves passes their edges.
_STEP = 1e-3
_LEVEL = 1e-15  # of the largest derivative of the sum of squares: where the parameters have no effect, which else divides by zero in SciPy


class Eliminated(NamedTuple):
    """What the weights that suit nonlinear parameters best leave: residuals, then the roots of what a penalty adds, shape (n,).

    `slopes` gives their derivatives with respect to unconstrained nonlinear parameters, shape (n, q), by Kaufman (1975): the weights follow
    changes of the residuals, and the part that vanishes with these is left out. A difference would solve for the weights q times.
    """

    left: np.ndarray
    slopes: Callable[[], Float[np.ndarray, "n q"]]


class Searched(NamedTuple):
    """Where a search ended: physical parameters, shape (p,), the number of evaluations, whether it converged, and a message."""

    x: np.ndarray
    evaluations: int
    converged: bool
    message: str


def search_nonlinear(
    problem: Problem,
    eliminate: Callable[[np.ndarray], Eliminated],
    z: np.ndarray,
    others: np.ndarray,
    *,
    steps: int,
    gain: float,
) -> Searched:
    """Minimize the sum of squares that the weights leave, from unconstrained z, shape (p,), by Gauss-Newton steps in a trust region.

    Args:
        problem: has the coordinates of the parameters.
        eliminate: solves for the weights at physical parameters, shape (p,).
        others: positions of the nonlinear parameters, shape (q,).
        steps: at most, those that are refused included, such as into parameters at which a simulation is not finite.
        gain: relative decrease of the sum of squares at which the search ends.
    """
    evaluations, last = 0, (b"", Eliminated(np.empty(0), lambda: np.empty((0, 0))))

    def at(moved: np.ndarray) -> np.ndarray:
        trial = z.copy()
        trial[others] += moved
        return np.array(problem.space.physical(trial))

    def solved(moved: np.ndarray) -> Eliminated:
        nonlocal evaluations, last
        if moved.tobytes() != last[0]:
            try:
                with np.errstate(all="ignore"):
                    found = eliminate(at(moved))
            except np.linalg.LinAlgError:  # of equations that are not finite
                found = last[1]._replace(left=np.full(last[1].left.shape, np.nan))
            evaluations, last = evaluations + 1, (moved.tobytes(), found)
        return last[1]

    def slopes(moved: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            found = solved(moved).slopes()
        return np.where(np.isfinite(found).all(axis=0), found, 0.0)

    still = np.zeros(others.size)  # from zero the first steps are at most one natural scale long
    if not np.isfinite(solved(still).left).all():
        return Searched(at(still), 1, False, "the model is not finite at its starting values")
    left = lambda moved: solved(moved).left
    solution = scipy.optimize.least_squares(left, still, slopes, ftol=gain, xtol=_STEP, gtol=_LEVEL, max_nfev=steps)
    converged = solution.status > 0
    stopped = f"the search over nonlinear parameters stopped after {evaluations} evaluations"
    return Searched(at(solution.x), evaluations, converged, "converged" if converged else stopped)


def output_slopes(
    problem: Problem, x: np.ndarray, others: np.ndarray, before: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n q"]:
    """Forward differences by unconstrained parameters of the outputs that count, `counted`, which are `before` at physical x."""
    columns = []
    z = np.array(problem.space.unconstrained(x))
    for k in others:
        step, moved = z.copy(), x.copy()
        step[k] += _STEP
        moved[k] = np.asarray(problem.space.physical(step))[k]
        columns.append((counted(problem, problem.predict(moved)) - before) / _STEP)
    return np.stack(columns, axis=1)


def counted(problem: Problem, outputs: list[np.ndarray]) -> Float[np.ndarray, " n"]:
    """The samples of all records that count, times roots of their weights."""
    pairs = zip(outputs, problem.data, strict=True)
    return np.concatenate([output[record.used] * np.sqrt(record.weight[record.used]) for output, record in pairs])
