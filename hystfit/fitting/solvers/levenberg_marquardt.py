"""The Levenberg-Marquardt step for many lanes (descents of similar problems) at once, in NumPy on the host or in JAX.

A lane stores normal equations instead of a Jacobian, which saves memory but squares the condition number. The last steps of a fit are
therefore left to `hystfit.fitting.solvers.polish`.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.normal import Normal
from hystfit.params.coordinates import BOTH, LOWER, REAL, UPPER

# Relative rounding error of the output, whose square bounds the cost per sample from below, and of a column of the Jacobian or the
# information with the other columns projected out.
ROUNDING = 1e-14
LEAST_DAMPING, MOST_DAMPING = 1e-12, 1e10  # relative to the columns of the Jacobian
LONGEST_STEP = 4.0  # longest step in z, infinity norm over the parameters with bounds
# Rms change of the output by a step of one in z, in half ranges, below which a parameter with bounds is not moved.
NOTHING = 1e-8
# Parameters with a smaller rms effect on the output, in half ranges for a step of one in z, are damped as if they had this effect: damping
# relative to their own effect would allow huge steps. In 40 descents of five models that do not describe the data, 0.1 led to the lowest
# cost, among 1e-4, 1e-3, 1e-2, 0.1, 0.3 and 1.
_LITTLE = 0.1
ON_BOUND = 1e-6  # relative distance from a bound below which a bounded solver takes over, because z does not converge
_EXCHANGES = 4  # of parameters at a bound in one step
_EQUAL = 1e-12  # relative difference of two costs that rounding errors may cause; below it the linear model decides
_CLOSE = 0.5  # relative excess over the cost of a converged lane, within which the linear model shows whether a lane can do better
# The last step is taken without evaluating the cost if the decrease expected to remain after it is below this fraction of the tolerance.
# Steps of Bouc-Wen left up to 0.06 of the tolerance where 0.01 was expected.
_EXPECTED = 0.01
# Standard errors from the minimum within which such a step starts: the normal matrix there, from which standard errors follow, is
# within 1e-3 of that at the minimum where the relative errors are up to 10 %. So near a kink of the cost, such as the limits of a branch
# cause, a descent ends: even a short step, with a damping of 1 and more, does not achieve the predicted decrease.
_WITHIN = 0.01
# The longest such step. In a direction that only noise determines, the linear model predicts a tiny decrease for a step of any length: a
# step of 100 took the slope of a loop to 1e116.
_SURE_STEP = 0.02
_BETTER = 1e-4  # relative decrease below the cost of a converged lane that is worth further steps


class Lane(NamedTuple):
    """The state of descents, with any leading axes.

    `best` are normal equations at the best point, from which a step with `damping` leads to `trial`, (..., p). `promised` is the decrease
    of the cost from there, as predicted by the linear model; `last` tells whether the trial is the last; `steps` counts linearizations.
    """

    best: Normal
    trial: Array
    damping: Array
    promised: Array
    last: Array
    ended: Array
    steps: Array

    @classmethod
    def at(cls, z: Float[np.ndarray, "L p"], damping: Float[np.ndarray, " L"] | None = None) -> Lane:
        """Lanes before their first step, from z; `damping` continues earlier descents."""
        count, p = z.shape
        none, no = np.zeros(count), np.zeros(count, bool)
        best = Normal(z.copy(), none + np.inf, np.zeros((count, p)), np.zeros((count, p, p)))
        damping = none + 1e-3 if damping is None else damping.copy()
        return cls(best, z.copy(), damping, none + np.inf, no, no.copy(), none.astype(int))

    def rows(self, at: Any) -> Lane:
        """Some of the lanes."""
        return jax.tree_util.tree_map(lambda v: v[at], self)

    def put(self, at: np.ndarray, lanes: Lane) -> None:
        """Replace some of the lanes."""
        for mine, new in zip(jax.tree_util.tree_leaves(self), jax.tree_util.tree_leaves(lanes), strict=True):
            mine[at] = new

    @property
    def converged(self) -> np.ndarray:
        """Which lanes have converged: the predicted decrease is negligible, and the last step has confirmed it."""
        return np.asarray(self.last & self.ended & np.isfinite(self.best.cost))


def advanced(lane: Lane, new: Normal, gain: Any, samples: int, kinds: tuple[int, ...], xp: ModuleType) -> Lane:
    """Lanes after their trial points were linearized.

    `gain` is the relative decrease of the cost, predicted by the linear model, below which a lane has converged; `samples` are those of
    each problem; `kinds` are those of the bounds of the p parameters.
    """
    bounded = np.array(kinds) != REAL
    # The last step may change the cost by less than rounding errors do.
    better = new.cost < xp.where(lane.last, lane.best.cost * (1 + _EQUAL), lane.best.cost)
    softer = xp.where(xp.isinf(lane.best.cost), lane.damping, xp.maximum(0.1 * lane.damping, LEAST_DAMPING))
    damping = xp.where(better, softer, 10.0 * lane.damping)
    chosen = lambda a, b: xp.where(better.reshape(better.shape + (1,) * (a.ndim - better.ndim)), a, b)
    best = Normal(*(chosen(a, b) for a, b in zip(new, lane.best, strict=True)))
    # The undamped step gives the possible decrease: damping suppresses directions that the data hardly determine.
    floor = ROUNDING**2 * samples
    dampings = xp.stack([damping, xp.full_like(damping, LEAST_DAMPING)])
    (_, whole), (way, far) = _steps(best, dampings, samples, kinds, xp)
    promised = -((best.gradient * whole).sum(-1) + 0.5 * xp.einsum("...i,...ij,...j->...", whole, best.matrix, whole))
    near = promised <= xp.maximum(gain, _EQUAL) * best.cost + floor
    settled = ~better | (promised <= gain * best.cost + floor)
    kink = ~better & (damping >= 1.0) & (promised <= _WITHIN**2 / samples * best.cost)
    # The next step reduces the predicted decrease by at least the same factor as the last one, because damping falls.
    expected = promised**2 <= _EXPECTED * gain * best.cost * xp.where(xp.isinf(lane.promised), 0.0, lane.promised)
    sure = better & expected & (promised <= _WITHIN**2 / samples * best.cost + floor)
    sure &= _longest(far, bounded, xp) <= _SURE_STEP
    z, cost = xp.where(sure[..., None], best.z + whole, best.z), xp.where(sure, best.cost - promised, best.cost)
    best = best._replace(z=z, cost=cost)
    ended = (lane.last & settled) | sure | kink | (damping >= MOST_DAMPING) | xp.isinf(best.cost)
    way = xp.where(near[..., None], far, way)
    shorter = LONGEST_STEP / xp.maximum(_longest(way, bounded, xp), 1e-300)
    trial = best.z + way * xp.minimum(1.0, shorter)[..., None]
    return Lane(best, trial, damping, promised, lane.last | near | kink | sure, ended, lane.steps + 1)


def _longest(step: Array, bounded: np.ndarray, xp: ModuleType) -> Array:
    """The largest change of a parameter that has bounds, in its unconstrained coordinate."""
    return xp.max(xp.where(bounded, xp.abs(step), 0.0), axis=-1, initial=0.0)


def _steps(point: Normal, damping: Array, samples: int, kinds: tuple[int, ...], xp: ModuleType) -> tuple[Array, Array]:
    """Steps of the linear model with each damping, and the moves of z for them, shapes (k, ..., p); other arguments as for `advanced`.

    The normal matrix is scaled to a diagonal of ones; the scale of a parameter that is not moved is 0. Where a parameter would cross a
    bound, on a straight line in physical units, its step ends there, the others suit that, and z moves by `LONGEST_STEP`: in z, the bound
    is at infinity, and the linear model would predict ever more than a long step achieves.
    """
    bounded = np.array(kinds) != REAL
    diagonal = xp.diagonal(point.matrix, axis1=-2, axis2=-1)
    largest = xp.max(diagonal, axis=-1, keepdims=True, initial=0.0)
    scale = 1 / xp.sqrt(xp.maximum(diagonal, 1e-24 * largest + 1e-300))
    scale = xp.where(bounded & (diagonal < NOTHING**2 * samples), 0.0, scale)
    held = damping[..., None] * xp.maximum(1.0, (_LITTLE * scale) ** 2 * samples)
    low, high = to_bounds(point.z, kinds, xp)

    def solve(ends: Array, free: Array) -> Array:
        """The damped step of the free parameters beside steps `ends` of the others."""
        own = xp.where(free, scale, 0.0)
        system = point.matrix * own[..., :, None] * own[..., None, :] + held[..., None] * xp.eye(scale.shape[-1])
        gradient = point.gradient + xp.einsum("...ij,...j->...i", point.matrix, ends)
        return ends - own * xp.linalg.solve(system, (own * gradient)[..., None])[..., 0]

    def slope(step: Array) -> Array:
        """Derivative of the damped linear model."""
        own = xp.where(scale > 0, scale, 1.0)
        return point.gradient + xp.einsum("...ij,...j->...i", point.matrix, step) + held * step / own**2

    step, ended = between_bounds(solve, slope, xp.broadcast_to(low, held.shape), xp.broadcast_to(high, held.shape), xp)
    return step, xp.where(ended, xp.sign(step) * LONGEST_STEP, step)


def between_bounds(
    solve: Callable[[Array, Array], Array], slope: Callable[[Array], Array], low: Array, high: Array, xp: ModuleType
) -> tuple[Array, Array]:
    """The minimum of a quadratic function between bounds, shape (..., p), and which parameters are at one there.

    Those that cross a bound, and those at one that would leave it, are exchanged; where that does not end soon, as with parameters that are
    nearly redundant, the minimum without bounds is taken.

    Args:
        solve: minimum for given values of the parameters that are not free, of those and of a mask of the free ones.
        slope: the derivative.
        low, high: the bounds, infinite for parameters without.
    """
    none = xp.zeros(low.shape)
    plain = solve(none, none == 0)
    side = xp.where(plain < low, -1, xp.where(plain > high, 1, 0))
    if xp is np and not side.any():
        return plain, side != 0
    for _ in range(_EXCHANGES):
        ends = xp.where(side < 0, low, xp.where(side > 0, high, 0.0))
        step = solve(ends, side == 0)
        crossed = xp.where(step < low, -1, xp.where(step > high, 1, 0))
        new = xp.where(side == 0, crossed, xp.where(side * slope(step) < 0, side, 0))
        settled = (new == side).all(axis=-1, keepdims=True)
        side = xp.where(settled, side, new)
    return xp.where(settled, step, plain), settled & (side != 0)


def to_bounds(z: Array, kinds: Any, xp: ModuleType) -> tuple[Array, Array]:
    """Distances to both bounds along the tangents of the maps at z, infinite without a bound; the lower one is negative."""
    kind, grown = np.array(kinds), xp.exp(-xp.abs(z))
    nearer = -(1.0 + grown)  # to the bound on whose side z is, and to the other
    with np.errstate(over="ignore", divide="ignore"):  # infinite where z is far outside
        farther = (1.0 + grown) / grown
    low = xp.where(z < 0, nearer, -farther)
    high = xp.where(z < 0, farther, -nearer)
    one = xp.where((kind == LOWER) | (kind == UPPER), -1.0, -xp.inf)
    return xp.where(kind == BOTH, low, one), xp.where(kind == BOTH, high, xp.inf)


def beaten(lane: Lane, problems: np.ndarray) -> np.ndarray:
    """Which lanes cannot reach a lower cost than the best converged lane of the same problem, by their linear models, shape (L,)."""
    rival, cost, ended = _rival(lane, problems), np.asarray(lane.best.cost), np.asarray(lane.ended)
    near, hopeless = cost <= (1 + _CLOSE) * rival, cost - np.asarray(lane.promised) >= (1 - _BETTER) * rival
    return ~ended & np.isfinite(rival) & near & hopeless


def approached(lane: Lane, problems: np.ndarray) -> np.ndarray:
    """The cost predicted by the linear model of each lane, kept above that of the best converged lane of its problem, shape (L,)."""
    return np.maximum(np.asarray(lane.best.cost - lane.promised), (1 + _BETTER) * _rival(lane, problems))


def _rival(lane: Lane, problems: np.ndarray) -> np.ndarray:
    """The least cost of the converged lanes of the same problem, infinite without one, shape (L,)."""
    least, converged = np.full(int(problems.max(initial=-1)) + 1, np.inf), lane.converged
    np.minimum.at(least, problems[converged], np.asarray(lane.best.cost)[converged])
    return least[problems]
