"""Many records of one structure and length, solved as lanes of one descent: from every start on a short form, then from the best one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from hystfit.fitting.solvers.estimate import Estimate
from hystfit.fitting.solvers.lanes import Ends, Stack, descend_lanes, go_on
from hystfit.fitting.solvers.least_squares import ROUGH, ROUND, ROUNDS
from hystfit.fitting.solvers.levenberg_marquardt import ON_BOUND
from hystfit.fitting.solvers.polish import EXACT, NEAR, gain_within
from hystfit.fitting.solvers.thinning import PAYS, SAMPLES, thin
from hystfit.inference.objective import Objective
from hystfit.inference.problem import Problem

_MORE = 60  # steps of the best start on all samples
# Standard errors of the short form, from the minimum of which the best start goes on with all samples: their minima were 6 apart.
_CLOSE = 3.0


class Task(NamedTuple):
    """A record to fit: its problem, the short form of it (None for short records), and starts of shape (S, p)."""

    problem: Problem
    short: Objective | None
    starts: np.ndarray

    @classmethod
    def of(cls, problem: Problem, starts: np.ndarray) -> Task:
        return cls(problem, thin(problem) if len(starts) > 1 else None, starts)

    @property
    def key(self) -> tuple[object, ...]:
        """Tasks of one key share their compiled program: structure and shapes."""
        leaves, treedef = jax.tree_util.tree_flatten((self.problem.objective, self.short, self.starts))
        return treedef, tuple(np.shape(leaf) for leaf in leaves)


def solve_together(tasks: Sequence[Task]) -> list[Estimate | None]:
    """Estimates of tasks of one key; None where a fit did not converge, is not finite or ends on a bound: those need other estimators."""
    full = Stack.of([task.problem.objective for task in tasks])
    short = None if tasks[0].short is None else Stack.of([task.short for task in tasks if task.short is not None])
    starts = np.stack([task.starts for task in tasks])
    ends, costs, steps = solve_stack(full, short, starts)
    rows = zip(tasks, ends.normal.z, ends.normal.cost, ends.converged, costs, steps, strict=True)
    return [_estimate(*row) for row in rows]


def solve_stack(
    full: Stack, short: Stack | None, starts: np.ndarray, steps: int = ROUND
) -> tuple[Ends, np.ndarray, np.ndarray]:
    """Where the best start of each record ended, the costs of all, shape (N, S), and the linearizations for each record.

    The starts are unconstrained, shape (N, S, p), and compared on the fewer samples of `short` where there are any. After so many steps of
    every start as `hystfit.fit` takes, the best and the first continue as they do there.
    """
    count, several, p = starts.shape
    records, some = np.arange(count), full if short is None else short
    lanes = np.repeat(records, several)
    # Records of which a fit alone has a short form too; the best starts of others go on with all samples.
    long = short is not None and PAYS * max(short.samples, SAMPLES) <= full.samples
    rough = descend_lanes(some, lanes, starts.reshape(-1, p), gain=ROUGH, steps=steps)
    least = lambda: several * records + np.argmin(rough.cost.reshape(count, several), axis=1)
    going = least()
    if several > 1 and steps >= ROUND:
        going = np.union1d(going, several * records)
    else:
        going = going[long & (rough.promised[going] > gain_within(_CLOSE, some.samples) * rough.cost[going])]
    again = lambda at, z: descend_lanes(some, lanes[at], z, gain=ROUGH, steps=ROUNDS * ROUND, beside=len(lanes))
    go_on(rough, going, again)
    best, gain = least(), gain_within(NEAR if long else EXACT, full.samples)  # as exact as a fit alone
    ends = descend_lanes(full, records, rough.normal.z[best], gain=gain, steps=_MORE, damping=rough.damping[best])
    taken = rough.steps.reshape(count, several).sum(axis=1)
    return ends, rough.cost.reshape(count, several), ends.steps + taken


def _estimate(task: Task, z: np.ndarray, cost: Any, converged: Any, costs: np.ndarray, steps: Any) -> Estimate | None:
    """The estimate of one task from its row of what was solved."""
    if not (converged and np.isfinite(z).all()):
        return None
    x = task.problem.space.physical(z)
    if any(task.problem.at_bound(x, ON_BOUND)):
        return None
    best = float(np.min(costs))
    return Estimate(x, float(cost), True, "converged", int(steps), costs * (float(cost) / best) if best else costs)
