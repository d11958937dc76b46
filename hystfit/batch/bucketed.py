"""Levenberg-Marquardt for many records of one length in one compiled program: every start of every record in one loop.

A loop over records is faster on a CPU than a batched program, in which every record takes as many steps as the slowest.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.fitting.estimate import Estimate
from hystfit.fitting.thinning import thin
from hystfit.inference.objective import Objective
from hystfit.inference.problem import Problem

_SHORT = 256  # samples of the short form on which starts are compared
_STEPS, _MORE = 25, 60  # of every start, of the best one
# Predicted decrease of the cost, relative to it, at which starts and the best one have converged.
_ROUGH, _FINE = 1e-5, 1e-13
_ROUNDING = 1e-28  # decrease for each sample that is below rounding errors
_LEAST, _MOST = 1e-12, 1e10  # damping
_LONGEST = 4.0  # step in z, infinity norm
_ON_BOUND = 1e-6  # relative distance below which a bounded solver decides whether a parameter is on its bound
_RECORDS, _SAMPLES = 64, 2**19  # of one call at most


class Task(NamedTuple):
    """A record to fit: its problem, the short form of it (None for short records), and starts of shape (S, p)."""

    problem: Problem
    short: Objective | None
    starts: np.ndarray

    @classmethod
    def of(cls, problem: Problem, starts: np.ndarray) -> Task:
        """The task of a problem."""
        return cls(problem, thin(problem, _SHORT) if len(starts) > 1 else None, starts)

    @property
    def key(self) -> tuple[object, ...]:
        """Tasks of one key share their compiled program: structure and shapes."""
        leaves, treedef = jax.tree_util.tree_flatten((self.problem.objective, self.short, self.starts))
        return treedef, tuple(np.shape(leaf) for leaf in leaves)

    @property
    def capacity(self) -> int:
        """Number of such tasks that one call takes: few long ones, so that memory is bounded."""
        return max(1, min(_RECORDS, _SAMPLES // self.problem.objective.batch.u.size))


def solve_together(tasks: Sequence[Task]) -> list[Estimate | None]:
    """Estimates of tasks of one key, at most as many as their capacity.

    None where a fit did not converge, is not finite or ends on a bound: those need the estimators of `hystfit.fitting`.
    """
    capacity, count = tasks[0].capacity, len(tasks)
    full = _stacked([task.problem.objective for task in tasks], capacity)
    short = None if tasks[0].short is None else _stacked([task.short for task in tasks], capacity)
    starts = _stacked([task.starts for task in tasks], capacity)
    solved = jax.tree_util.tree_map(np.asarray, _solve(full, short, starts, jnp.asarray(count)))
    return [_estimate(task, *(column[k] for column in solved)) for k, task in enumerate(tasks)]


def _stacked(trees: Sequence[object], capacity: int) -> object:
    """Trees of one structure as one with a leading axis of length `capacity`; what lies beyond them is never read."""

    def stack(*leaves: object) -> np.ndarray:
        rows = np.zeros((capacity, *np.shape(leaves[0])), np.asarray(leaves[0]).dtype)
        for k, leaf in enumerate(leaves):
            rows[k] = leaf
        return rows

    return jax.tree_util.tree_map(stack, *trees)


def _estimate(task: Task, z: np.ndarray, cost: Any, converged: Any, steps: Any, costs: np.ndarray) -> Estimate | None:
    """The estimate of one task from its row of what was solved."""
    if not (converged and np.isfinite(z).all() and np.isfinite(cost)):
        return None
    x = task.problem.space.physical(z)
    if any(task.problem.at_bound(x, _ON_BOUND)):
        return None
    best = float(np.min(costs))
    return Estimate(x, float(cost), True, "converged", int(steps), costs * (float(cost) / best) if best else costs)


class _Point(NamedTuple):
    """A point of the descent, with half the sum of squares there, its gradient and the Gauss-Newton matrix."""

    z: Array
    cost: Array
    gradient: Array
    matrix: Array


_Carry = tuple[_Point, Array, Array, Array]  # point, damping, convergence, linearizations


@eqx.filter_jit
def _solve(
    full: Objective, short: Objective | None, starts: Array, count: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """z, cost, convergence, steps and the costs of all starts, for the first `count` records."""
    capacity, several, p = starts.shape
    number = lambda tree, k: jax.tree_util.tree_map(lambda rows: rows[k], tree)

    def begun(k: Array, z: Array) -> tuple[_Point, Array, Array]:
        rough = number(full if short is None else short, k)
        return _descend(_normal(rough), z, rough.batch.u.size, _ROUGH, _STEPS)

    def ended(k: Array, ends: _Point, taken: Array) -> tuple[Array, ...]:
        objective, z = number(full, k), ends.z[jnp.argmin(ends.cost)]
        point, converged, more = _descend(_normal(objective), z, objective.batch.u.size, _FINE, _MORE)
        return point.z, point.cost, converged, jnp.sum(taken) + more, ends.cost

    def one(k: Array, solved: tuple[Array, ...]) -> tuple[Array, ...]:
        ends, _, taken = jax.lax.map(lambda z: begun(k, z), number(starts, k))
        return tuple(rows.at[k].set(value) for rows, value in zip(solved, ended(k, ends, taken), strict=True))

    numbers = jnp.zeros(capacity)
    empty = (
        jnp.zeros((capacity, p)),
        numbers,
        numbers.astype(bool),
        numbers.astype(int),
        jnp.zeros((capacity, several)),
    )
    return jax.lax.fori_loop(0, count, one, empty)


def _normal(objective: Objective) -> Callable[[Array], _Point]:
    """Normal equations in unconstrained coordinates; an infinite cost where they are not finite."""

    def at(z: Array) -> _Point:
        residual, columns = objective.linearize_at(z)
        point = _Point(z, 0.5 * residual @ residual, columns @ residual, columns @ columns.T)
        finite = functools.reduce(jnp.logical_and, [jnp.isfinite(value).all() for value in point])
        return point._replace(cost=jnp.where(finite, point.cost, jnp.inf))

    return at


def _descend(
    normal: Callable[[Array], _Point], z: Array, samples: int, gain: float, most: int
) -> tuple[_Point, Array, Array]:
    """Levenberg-Marquardt from z: where it ended, whether it converged, and the number of linearizations, `most` at most.

    It has converged where the predicted decrease of the cost is below `gain` times the cost.
    """

    def goes_on(carry: _Carry) -> Array:
        _, damping, converged, k = carry
        return ~converged & (damping < _MOST) & (k < most)

    def once(carry: _Carry) -> _Carry:
        point, damping, _, k = carry
        step, predicted = _step(point, damping)
        converged = predicted <= gain * point.cost + _ROUNDING * samples
        new = normal(point.z + step)
        better = new.cost < point.cost
        point = jax.tree_util.tree_map(lambda a, b: jnp.where(better, a, b), new, point)
        damping = jnp.where(better, jnp.maximum(0.1 * damping, _LEAST), 10.0 * damping)
        return point, damping, converged, k + 1

    first = normal(z)
    finite = jnp.isfinite(first.cost)
    carry = (first, jnp.where(finite, 1e-3, _MOST), jnp.zeros((), bool), jnp.asarray(1))
    point, _, converged, steps = jax.lax.while_loop(goes_on, once, carry)
    return point, converged & jnp.isfinite(point.cost), steps


def _step(point: _Point, damping: Array) -> tuple[Array, Array]:
    """The damped step, and the decrease of the cost that the linear model predicts for it."""
    diagonal = jnp.diag(point.matrix)
    scale = 1 / jnp.sqrt(jnp.maximum(diagonal, 1e-24 * jnp.max(diagonal) + 1e-300))
    scaled = point.matrix * scale[:, None] * scale[None, :]
    step = -scale * jnp.linalg.solve(scaled + damping * jnp.eye(scale.size), scale * point.gradient)
    step = step * jnp.minimum(1.0, _LONGEST / jnp.maximum(jnp.max(jnp.abs(step)), 1e-300))
    return step, -(point.gradient @ step + 0.5 * step @ point.matrix @ step)
