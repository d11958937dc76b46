"""Levenberg-Marquardt driven from the host, from several starts in step: one compiled program, residuals and Jacobian, serves all.

The steps are those of optimistix' `LevenbergMarquardt`, whose compiled solver takes several times as long to compile as this program.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.objective import Objective
from hystfit.params.host_arrays import compiled

# A step is accepted where the cost falls by more than _LEAST of what the linear model predicts, and the next one is longer where it
# falls by more than _GOOD of it: "Sensitivity of trust-region algorithms to their parameters" (Gould et al. 2005).
_LEAST, _GOOD = 0.01, 0.99
_ROUNDING = 1e-15  # of the cost: a smaller decrease cannot be seen, and every step towards it would be rejected
_SHORTER, _LONGER, _LONGEST, _SHORTEST = 0.25, 3.5, 1e30, 1e-200
_CLOSE = 0.5  # excess of the cost over that of a converged start, within which the linear model shows whether a start can do better
_BETTER = 1e-4  # a lower cost, relative to that of the converged start, that is worth further steps
_LANES = 8  # starts for which a program has room; fewer cost no more than their share
_BYTES = 2**26  # of their Jacobians, beyond which a program has room for fewer


class Descents(NamedTuple):
    """End points of S descents.

    Attributes:
        z: unconstrained, shape (S, p).
        cost: half the squared misfits, shape (S,). Of a descent that was given up: what its linear model promises, which is above the
            least of the converged ones.
        converged: which converged, shape (S,).
        evaluations: linearizations of each, shape (S,).
        given_up: which approached no lower cost than a converged one, shape (S,).
    """

    z: Float[np.ndarray, "S p"]
    cost: Float[np.ndarray, " S"]
    converged: np.ndarray
    evaluations: np.ndarray
    given_up: np.ndarray


def descend(
    objective: Objective, starts: np.ndarray, *, rtol: float, atol: float, steps: int, gain: float = 0.0
) -> Descents:
    """Minimize half the sum of squared misfits from every start.

    Once a start has converged, others end where they are close to its cost and their linear model promises no lower one.

    Args:
        objective: what is fitted.
        starts: unconstrained, shape (S, p).
        rtol: change of z and of the misfit, relative to them, below which a descent has converged.
        atol: the same, absolute.
        steps: linearizations at most, of each.
        gain: decrease of the cost that the linear model promises, relative to the cost, below which a descent has converged too.
    """
    samples, p = objective.batch.u.size, starts.shape[1]
    lanes = int(np.clip(_BYTES // (8 * samples * (p + 1)), 1, _LANES))
    groups = [starts[k : k + lanes] for k in range(0, len(starts), lanes)]
    with np.errstate(over="ignore", invalid="ignore"):  # of simulations that are not finite, whose steps are rejected
        ended = [_together(objective, group, lanes, (rtol, atol, gain), steps) for group in groups]
    return Descents(*(np.concatenate(part) for part in zip(*ended, strict=True)))


def _together(
    objective: Objective, starts: np.ndarray, lanes: int, tolerances: tuple[float, float, float], steps: int
) -> Descents:
    rtol, atol, gain = tolerances
    count, p = starts.shape
    z, trial = np.array(starts, float), np.array(starts, float)
    misfit, triangle = np.zeros((count, objective.batch.u.size)), np.zeros((count, p + 1, p + 1))
    own = objective.coordinates.own if objective.apart else np.arange(p)[None]
    cost, size = np.full(count, np.inf), np.ones(count)
    converged, evaluations, active = np.zeros(count, bool), np.zeros(count, int), np.ones(count, bool)
    given_up = np.zeros(count, bool)
    for number in range(steps):
        at = np.flatnonzero(active)
        if not at.size:
            break
        new, jacobian = _linearize(objective, trial[at], lanes)
        evaluations[at] += 1
        new_cost = 0.5 * np.sum(new**2, axis=1)
        predicted = np.zeros(at.size) if number == 0 else _predicted(triangle[at], trial[at] - z[at], cost[at])
        change = new_cost - cost[at]
        accepted = change <= _LEAST * predicted if number else np.ones(at.size, bool)
        good = accepted & (predicted < 0) & (change < _GOOD * predicted)
        size[at] = np.minimum(size[at] * np.where(good, _LONGER, np.where(accepted, 1.0, _SHORTER)), _LONGEST)
        taken, new, jacobian = at[accepted], new[accepted], jacobian[accepted]
        done = _converged(trial[taken] - z[taken], trial[taken], rtol, atol)
        done &= _converged(new - misfit[taken], new, rtol, atol)
        z[taken], misfit[taken], cost[taken], converged[taken] = trial[taken], new, new_cost[accepted], done
        going = ~done & np.isfinite(cost[taken]) & np.isfinite(jacobian).all(axis=(1, 2, 3))
        active[taken[~going]] = False
        last = new[going].reshape(-1, len(own), 1, jacobian.shape[3])
        at = taken[going]
        triangle[at] = _factor(np.concatenate([jacobian[going], last], axis=2).swapaxes(2, 3), own, p)
        converged[at] |= cost[at] - _attainable_cost(triangle[at]) <= max(gain, _ROUNDING) * cost[at]
        active[at[converged[at]]] = False
        behind = active & _cannot_win(triangle, cost, converged)
        given_up |= behind
        active &= ~behind
        left = np.flatnonzero(active)
        trial[left] = z[left] - _step(triangle[left], size[left])
    promised = np.maximum(_attainable_cost(triangle), (1 + _BETTER) * cost[converged].min(initial=np.inf))
    cost = np.where(given_up, promised, cost)
    return Descents(z, np.where(np.isfinite(cost), cost, np.inf), converged, evaluations, given_up)


def _linearize(objective: Objective, z: np.ndarray, lanes: int) -> tuple[np.ndarray, np.ndarray]:
    """Misfits (k, n) of k points and their derivatives.

    The derivatives are those of each record with respect to its own parameters where no record depends on all, (k, R, m, T); else
    those of all samples with respect to z, (k, 1, p, n).
    """
    padded = np.zeros((lanes, z.shape[1]))
    padded[: len(z)] = z
    misfit, jacobian = _linearize_first(objective, padded, np.int64(len(z)))
    return np.asarray(misfit)[: len(z)], np.asarray(jacobian)[: len(z)]


@compiled
def _linearize_first(objective: Objective, z: Float[Array, "lanes p"], count: Array) -> tuple[Array, Array]:
    """Misfit and derivatives at the first `count` points, zero at the others."""
    shape = (len(z), 1, z.shape[1], objective.batch.u.size)
    if objective.apart:
        shape = (len(z), *objective.coordinates.own.shape, objective.batch.u.shape[1])

    def one(k: Array, rows: tuple[Array, Array]) -> tuple[Array, Array]:
        linearize = objective.linearize_records_at if objective.apart else objective.linearize_at
        misfit, jacobian = linearize(z[k])
        return rows[0].at[k].set(misfit.reshape(-1)), rows[1].at[k].set(jacobian.reshape(shape[1:]))

    return jax.lax.fori_loop(0, count, one, (jnp.zeros((len(z), objective.batch.u.size)), jnp.zeros(shape)))


def _converged(change: np.ndarray, value: np.ndarray, rtol: float, atol: float) -> np.ndarray:
    return np.max(np.abs(change) / (atol + rtol * np.abs(value)), axis=1, initial=0.0) < 1


def _factor(rows: Float[np.ndarray, "k R T m1"], own: np.ndarray, p: int) -> Float[np.ndarray, "k p1 p1"]:
    """Factor R of [J, r] = Q R, from the columns of each record that are not zero, whose positions are `own`, and r."""
    triangle = np.asarray(np.linalg.qr(rows, mode="r"))
    count, records, height, _ = triangle.shape
    if records == 1:
        triangle = triangle[:, 0]
    else:
        columns = np.column_stack([own, np.full(records, p)])
        sparse = np.zeros((records, height, count, p + 1))
        sparse[np.arange(records)[:, None], :, :, columns] = triangle.transpose(1, 3, 2, 0)
        stacked = sparse.transpose(2, 0, 1, 3).reshape(count, records * height, p + 1)
        triangle = np.asarray(np.linalg.qr(stacked, mode="r"))
    return np.pad(triangle, ((0, 0), (0, p + 1 - triangle.shape[1]), (0, 0)))


def _predicted(triangle: np.ndarray, step: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Change of the cost that the linear model predicts."""
    rows = (triangle[:, :, :-1] @ step[:, :, None])[:, :, 0] + triangle[:, :, -1]
    return 0.5 * np.sum(rows**2, axis=1) - cost


def _attainable_cost(triangle: np.ndarray) -> np.ndarray:
    """Least cost of the linear model."""
    return 0.5 * triangle[:, -1, -1] ** 2


def _cannot_win(triangle: np.ndarray, cost: np.ndarray, converged: np.ndarray) -> np.ndarray:
    """Which starts approach no lower cost than that of the best converged one."""
    if not converged.any():
        return np.zeros(cost.size, bool)
    best = cost[converged].min()
    return (cost <= (1 + _CLOSE) * best) & (_attainable_cost(triangle) >= (1 - _BETTER) * best)


def _step(triangle: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Minimum d of |J d - r|^2 + |d|^2 / size."""
    count, p = len(size), triangle.shape[1] - 1
    damping = np.eye(p) / np.sqrt(np.maximum(size, _SHORTEST))[:, None, None]
    Q, R = np.linalg.qr(np.concatenate([triangle[:, :, :-1], damping], axis=1))
    target = np.concatenate([triangle[:, :, -1], np.zeros((count, p))], axis=1)
    return np.linalg.solve(R, np.einsum("kij,ki->kj", Q, target)[..., None])[..., 0]
