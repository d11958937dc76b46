"""Levenberg-Marquardt driven from the host, for the last steps of a fit on all samples.

It uses only the compiled residuals and Jacobian, which the standard errors need too. A compiled solver would take about 2 s of
compilation for each record length.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from hystfit.fitting.solvers.levenberg_marquardt import (
    LEAST_DAMPING,
    LONGEST_STEP,
    MOST_DAMPING,
    NOTHING,
    ROUNDING,
    between_bounds,
    to_bounds,
)
from hystfit.inference.linearization import Linearization
from hystfit.inference.problem import Problem
from hystfit.params.coordinates import REAL

# Distance from the minimum, in standard errors of the linear model, at which a fit has converged
NEAR, EXACT = 1e-3, 3e-7
# Most linearizations of a fit. Refits of `steel-02` to five parts of a coupon needed 120 to 207. Stopped at 40, they were still near their
# start, which had been fitted to the held-out samples too, so that the cross-validation error was 2.5 % instead of 3.1 %.
STEPS = 250


class Polished(NamedTuple):
    """End point of a polish: unconstrained z, its cost, whether it converged, and the number of linearizations.

    `linearized` is `Problem.linearization` at z, None if another point was linearized last.
    """

    z: np.ndarray
    cost: float
    converged: bool
    evaluations: int
    linearized: Linearization | None


def polish(
    problem: Problem,
    z: np.ndarray,
    steps: int = 40,
    within: float = NEAR,
    *,
    held: np.ndarray | None = None,
    step_on: bool = False,
    known: Linearization | None = None,
) -> Polished:
    """Minimize half the sum of squared misfits from an unconstrained point near the minimum, by so many linearizations at most.

    It factorizes the Jacobian, because normal equations would square its condition. Offsets of records are not damped: if an input or
    output is far from zero, damped offsets would slow down all other parameters. The fit has converged `within` this distance from the
    minimum, in standard errors of the linear model; with `step_on` it ends at the minimum of that model, without another linearization.
    Parameters that are `held`, shape (p,), are not moved. `known` is `Problem.linearization` at the first point, if known.
    """
    offsets = problem.space.offsets
    order, kinds = np.argsort(~offsets, kind="stable"), problem.space.kinds
    bounded = kinds != REAL
    samples = int(problem.used.sum())
    largest = max(*(np.abs(record.y[record.used]).max(initial=0.0) for record in problem.data), problem.scales.y)
    gain = gain_within(within, samples)
    at, damping, converged, evaluations = _linearize(problem, z, order, samples, held, known), 1e-6, False, 1
    linearized = at.linearized
    while evaluations < steps:
        floor = _floor(problem, at.x, samples, largest)
        if not np.isfinite(at.cost + floor):
            break
        with np.errstate(divide="ignore"):  # far beside one bound, the other one is at infinity
            low, high = to_bounds(at.z[order], kinds[order], np)
        ordered, decrease = _step(at.factor, int(offsets.sum()), damping, low, high)
        converged = decrease <= gain * at.cost + floor
        step = np.zeros(z.size)
        step[order] = ordered
        step = step * min(1.0, LONGEST_STEP / max(float(np.max(np.abs(step[bounded]), initial=0.0)), 1e-300))
        if converged and step_on:
            at, linearized = at._replace(z=at.z + step), None
        if converged or damping > MOST_DAMPING:
            break
        at, linearized = at._replace(linearized=None), None  # two linearizations of a long record may not fit in memory
        new, evaluations = _linearize(problem, at.z + step, order, samples, held), evaluations + 1
        blurred = 0.01 * np.sqrt(2 * at.cost * floor)  # smaller decreases are lost: the linear model decides
        if new.cost < at.cost + (blurred if decrease < blurred else 0.0):
            at, linearized = new, new.linearized
            damping = max(0.1 * damping, LEAST_DAMPING)
        else:
            damping *= 10.0
        del new
    return Polished(at.z, at.cost, converged, evaluations, linearized)


def gain_within(errors: float, samples: int) -> float:
    """Relative decrease of the cost to the minimum (Newton decrement) at a distance of some standard errors."""
    return errors**2 / samples


class _Linearized(NamedTuple):
    """A point, unconstrained z and physical x; its cost, the triangular factor of [J, r] there, and `Problem.linearization`."""

    z: np.ndarray
    x: np.ndarray
    cost: float
    factor: np.ndarray
    linearized: Linearization | None


def _floor(problem: Problem, x: np.ndarray, samples: int, largest: float) -> float:
    """Rounding error of the cost, from the largest numbers that add up to an output.

    Infinite if an offset has diverged, as in a refit to samples that do not determine it.
    """
    largest = float(np.abs(x)[problem.space.offsets].max(initial=largest))
    with np.errstate(over="ignore"):
        return float(samples * np.square(np.float64(ROUNDING * largest / problem.scales.y)))


def _linearize(
    problem: Problem,
    z: np.ndarray,
    order: np.ndarray,
    samples: int,
    held: np.ndarray | None,
    known: Linearization | None = None,
) -> _Linearized:
    """Linearize the problem at z, with the columns of J in the given order; the factor is empty if the cost is not finite."""
    x, bounded = problem.space.physical(z), problem.space.kinds != REAL
    linear = problem.linearization(x) if known is None else known
    with np.errstate(over="ignore", invalid="ignore"):  # such a step is rejected
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


def _step(
    triangle: np.ndarray, offsets: int, damping: float, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, float]:
    """Move of z from [J, r] = Q R, damped except for its first entries, and the decrease of the cost predicted for the undamped step.

    Args:
        triangle: R, shape (p + 1, p + 1).
        offsets: number of the first columns of J, whose entries are not damped.
        damping: relative to the norms of the other columns, with the first columns projected out.
        low, high: distances to the bounds, see `to_bounds`; a step that would cross one ends there, as in `levenberg_marquardt`.
    """
    R, q = triangle[:-1, :-1], triangle[:-1, -1]

    def bounded(damping: float) -> tuple[Any, Any]:
        solve = lambda ends, free: ends + _damped(np.where(free, R, 0.0), q + R @ ends, offsets, damping)
        damped = np.where(np.arange(q.size) < offsets, 0.0, damping * _sizes(R, offsets) ** 2)
        return between_bounds(solve, lambda step: R.T @ (q + R @ step) + damped * step, low, high, np)

    (step, ended), (full, _) = bounded(damping), bounded(0.0)
    left = q + R @ full
    return np.where(ended, np.sign(step) * LONGEST_STEP, step), 0.5 * float(q @ q - left @ left)


def _damped(R: np.ndarray, q: np.ndarray, offsets: int, damping: float) -> Float[np.ndarray, " p"]:
    """The least-squares solution of R step = -q with damping; by the numerical rank of R without."""
    S, r, size = R[offsets:, offsets:], q[offsets:], _sizes(R, offsets)[offsets:]
    if damping > 0:
        rows = np.vstack([S / size, np.diag(np.full(size.size, np.sqrt(damping)))])
        others = np.linalg.lstsq(rows, np.concatenate([-r, np.zeros(size.size)]), rcond=None)[0] / size
    else:
        others = np.linalg.lstsq(S / size, -r, rcond=ROUNDING)[0] / size
    shifts = -q[:offsets] - R[:offsets, offsets:] @ others
    return np.concatenate([np.linalg.lstsq(R[:offsets, :offsets], shifts, rcond=ROUNDING)[0], others])


def _sizes(R: np.ndarray, offsets: int) -> Float[np.ndarray, " p"]:
    """Norms of the columns with the first ones projected out, far above rounding."""
    size = np.linalg.norm(R[offsets:], axis=0)
    return np.maximum(size, 1e-12 * max(float(size.max(initial=0.0)), 1e-300))
