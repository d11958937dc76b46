"""Many records of one structure and length, solved as lanes of one descent: from every start on a short form, then from the best one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from hystfit.fitting.estimate import Estimate
from hystfit.fitting.lanes import Ends, Stack, descend_lanes
from hystfit.fitting.levenberg_marquardt import ON_BOUND
from hystfit.fitting.polish import EXACT, gain_within
from hystfit.fitting.thinning import thin
from hystfit.inference.objective import Objective
from hystfit.inference.problem import Problem

SHORT = 256  # samples on which starts are compared, and loops with each other
STEPS, _MORE = 25, 60  # of every start, of the best one
_ROUGH = 1e-5  # predicted decrease of the cost, relative to it, at which starts have converged


class Task(NamedTuple):
    """A record to fit: its problem, the short form of it (None for short records), and starts of shape (S, p)."""

    problem: Problem
    short: Objective | None
    starts: np.ndarray

    @classmethod
    def of(cls, problem: Problem, starts: np.ndarray) -> Task:
        """The task of a problem."""
        return cls(problem, thin(problem, SHORT) if len(starts) > 1 else None, starts)

    @property
    def key(self) -> tuple[object, ...]:
        """Tasks of one key share their compiled program: structure and shapes."""
        leaves, treedef = jax.tree_util.tree_flatten((self.problem.objective, self.short, self.starts))
        return treedef, tuple(np.shape(leaf) for leaf in leaves)


def solve_together(tasks: Sequence[Task]) -> list[Estimate | None]:
    """Estimates of tasks of one key.

    None where a fit did not converge, is not finite or ends on a bound: those need the estimators of `hystfit.fitting`.
    """
    full = Stack.of([task.problem.objective for task in tasks])
    short = None if tasks[0].short is None else Stack.of([task.short for task in tasks if task.short is not None])
    starts = np.stack([task.starts for task in tasks])
    ends, costs, steps = solve_stack(full, short, starts)
    rows = zip(tasks, ends.normal.z, ends.normal.cost, ends.converged, costs, steps, strict=True)
    return [_estimate(*row) for row in rows]


def solve_stack(
    full: Stack, short: Stack | None, starts: np.ndarray, steps: int = STEPS
) -> tuple[Ends, np.ndarray, np.ndarray]:
    """Where the best start of each record ended, the costs of all, shape (N, S), and the linearizations for each record.

    Args:
        full: the problems of N records.
        short: on fewer samples; None where starts are compared on all.
        starts: unconstrained, shape (N, S, p).
        steps: of every start, before the best one goes on.
    """
    count, several, p = starts.shape
    records = np.arange(count)
    rough = descend_lanes(
        full if short is None else short,
        np.repeat(records, several),
        starts.reshape(-1, p),
        gain=_ROUGH,
        steps=steps,
    )
    costs = rough.cost.reshape(count, several)
    best = several * records + np.argmin(costs, axis=1)
    ends = descend_lanes(
        full,
        records,
        np.asarray(rough.normal.z)[best],
        gain=gain_within(EXACT, full.samples),
        steps=_MORE,
        damping=np.asarray(rough.damping)[best],
    )
    return ends, costs, ends.steps + rough.steps.reshape(count, several).sum(axis=1)


def _estimate(task: Task, z: np.ndarray, cost: Any, converged: Any, costs: np.ndarray, steps: Any) -> Estimate | None:
    """The estimate of one task from its row of what was solved."""
    if not (converged and np.isfinite(z).all()):
        return None
    x = task.problem.space.physical(z)
    if any(task.problem.at_bound(x, ON_BOUND)):
        return None
    best = float(np.min(costs))
    return Estimate(x, float(cost), True, "converged", int(steps), costs * (float(cost) / best) if best else costs)
