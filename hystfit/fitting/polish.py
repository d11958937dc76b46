"""Levenberg-Marquardt driven from the host, for the last steps of a fit on all samples.

It needs no program but that of residuals and Jacobian, which the standard errors use as well: a compiled solver for each length of
the records would cost about 2 s of compilation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hystfit.fitting.levenberg_marquardt import LEAST_DAMPING, LONGEST_STEP, MOST_DAMPING, NOTHING, ROUNDING
from hystfit.inference.linearization import Linearization
from hystfit.inference.problem import Problem
from hystfit.params.coordinates import REAL

NEAR, EXACT = 1e-3, 3e-7  # standard errors from the minimum, in the linear model, at which a fit has converged
# Linearizations of a fit at most. Refits of `steel-02` to five parts of a coupon took 120 to 207; stopped at 40, near the values that the
# held-out samples had helped to find, they erred 2.5 % instead of 3.1 %.
STEPS = 250
_BLUR = 0.01  # rounding error of an output over ROUNDING


class Polished(NamedTuple):
    """End point of a polish: unconstrained z, its cost, whether it converged, and the number of linearizations.

    `linearized` is `Problem.linearization` there, None where another point was linearized last. `beaten` says that the start was the end.
    """

    z: np.ndarray
    cost: float
    converged: bool
    evaluations: int
    linearized: Linearization | None
    beaten: bool = False


def polish(
    problem: Problem,
    z: np.ndarray,
    steps: int = 40,
    within: float = NEAR,
    *,
    held: np.ndarray | None = None,
    most: float = np.inf,
) -> Polished:
    """Minimize half the sum of squared misfits from a point near the minimum.

    The Jacobian enters by its triangular factor, not by normal equations, which would square its condition. Offsets of records are
    solved for in each step: where an input or output is far from zero, damping would hold them, and with them all others.

    Args:
        z: start, unconstrained, shape (p,).
        steps: linearizations at most.
        within: standard errors from the minimum, in the linear model, at which the fit has converged.
        held: which parameters stay, shape (p,), bool; None for none.
        most: error of the start where samples are held out [y], above which it is the end.
    """
    offsets = problem.space.offsets
    order, bounded = np.argsort(~offsets, kind="stable"), problem.space.kinds != REAL
    samples, largest = int(problem.used.sum()), _largest_output(problem)
    gain = gain_within(within, samples)
    at, damping, converged, evaluations = _linearize(problem, z, order, samples, held), 1e-6, False, 1
    linearized = at.linearized
    if linearized is not None and most < np.inf and problem.error_where_held_out(linearized.misfit) > most:
        return Polished(at.z, at.cost, False, evaluations, linearized, beaten=True)
    while evaluations < steps:
        floor = _floor(problem, at.x, samples, largest)
        if not np.isfinite(at.cost + floor):
            break
        ordered, decrease = _step(at.factor, int(offsets.sum()), damping)
        converged = decrease <= gain * at.cost + floor
        if converged or damping > MOST_DAMPING:
            break
        step = np.zeros(z.size)
        step[order] = ordered
        step = step * min(1.0, LONGEST_STEP / max(float(np.max(np.abs(step[bounded]), initial=0.0)), 1e-300))
        at, linearized = at._replace(linearized=None), None  # of a long record there is no room for two
        new, evaluations = _linearize(problem, at.z + step, order, samples, held), evaluations + 1
        blurred = _BLUR * np.sqrt(
            2 * at.cost * floor
        )  # where a smaller decrease cannot be seen, the linear model decides
        if new.cost < at.cost + (blurred if decrease < blurred else 0.0):
            at, linearized = new, new.linearized
            damping = max(0.1 * damping, LEAST_DAMPING)
        else:
            damping *= 10.0
        del new
    return Polished(at.z, at.cost, converged, evaluations, linearized)


def gain_within(errors: float, samples: int) -> float:
    """Decrease of the cost, relative to it, that some standard errors from the minimum are worth: the Newton decrement in these units."""
    return errors**2 / samples


class _Linearized(NamedTuple):
    """A point, unconstrained z and physical x; its cost, the triangular factor of [J, r] there, and `Problem.linearization`."""

    z: np.ndarray
    x: np.ndarray
    cost: float
    factor: np.ndarray
    linearized: Linearization | None


def _largest_output(problem: Problem) -> float:
    return max(*(np.abs(record.y[record.used]).max(initial=0.0) for record in problem.data), problem.scales.y)


def _floor(problem: Problem, x: np.ndarray, samples: int, largest: float) -> float:
    """Decrease of the cost below rounding errors, which are those of the largest numbers that add up to an output.

    Infinite where an offset has run away, as in a refit whose samples do not determine it.
    """
    largest = float(np.abs(x)[problem.space.offsets].max(initial=largest))
    with np.errstate(over="ignore"):
        return float(samples * np.square(np.float64(ROUNDING * largest / problem.scales.y)))


def _linearize(
    problem: Problem, z: np.ndarray, order: np.ndarray, samples: int, held: np.ndarray | None
) -> _Linearized:
    """The problem about a point, with the columns of J in an order; the factor is empty where the cost is not finite."""
    x, bounded = problem.space.physical(z), problem.space.kinds != REAL
    linear = problem.linearization(x)
    with np.errstate(over="ignore", invalid="ignore"):  # a step too far is taken back
        cost = 0.5 * float(linear.misfit @ linear.misfit)
        if not np.isfinite(cost):
            return _Linearized(z, x, cost, np.empty((0, 0)), None)
        factor = linear.factor(order)
        columns = factor[:, :-1]
        columns *= problem.space.slope(z)[order]
        columns[:, bounded[order] & (np.linalg.norm(columns, axis=0) < NOTHING * np.sqrt(samples))] = 0.0
        if held is not None:
            columns[:, held[order]] = 0.0
    return _Linearized(z, x, cost, factor, linear)


def _step(triangle: np.ndarray, offsets: int, damping: float) -> tuple[np.ndarray, float]:
    """Step from [J, r] = Q R, damped but for its first entries, and the decrease of the cost that an undamped one predicts.

    Args:
        triangle: R, shape (p + 1, p + 1).
        offsets: number of the first columns of J, whose entries are not damped.
        damping: relative to the columns of the others, less what the first ones explain of them.
    """
    p = len(triangle) - 1
    R, q = triangle[offsets:p, offsets:p], triangle[offsets:p, p]
    size = np.linalg.norm(R, axis=0)
    size = np.maximum(size, 1e-12 * max(float(size.max(initial=0.0)), 1e-300))
    rows = np.vstack([R / size, np.diag(np.full(size.size, np.sqrt(damping)))])
    others = np.linalg.lstsq(rows, np.concatenate([-q, np.zeros(q.size)]), rcond=None)[0] / size
    shifts = -triangle[:offsets, p] - triangle[:offsets, offsets:p] @ others
    shifts = np.linalg.lstsq(triangle[:offsets, :offsets], shifts, rcond=ROUNDING)[0]
    full = R / size @ np.linalg.lstsq(R / size, -q, rcond=ROUNDING)[0]
    return np.concatenate([shifts, others]), 0.5 * float(full @ full + np.sum(triangle[:offsets, p] ** 2))
