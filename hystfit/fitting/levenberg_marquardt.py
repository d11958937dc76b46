"""The rule of Levenberg and Marquardt for lanes, which are descents of problems of one structure: NumPy on the host, JAX in programs.

A point is its normal equations, so that a lane needs no memory for its samples. The condition of the Jacobian is squared: the last steps
of a fit are those of `hystfit.fitting.polish`.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.normal import Normal

# Relative size of rounding errors: of the output, whose square no cost can fall below for each sample, and of what is left of a column of
# the Jacobian, or of the information, once the others are taken out of it.
ROUNDING = 1e-14
LEAST_DAMPING, MOST_DAMPING = 1e-12, 1e10  # relative to the columns of the Jacobian
LONGEST_STEP = 4.0  # step in z of parameters with bounds, infinity norm
# Rms change of the output by a step of one in z, in half ranges, below which a parameter with bounds stays.
NOTHING = 1e-8
# Rms change of the output by a step of one in z, in half ranges, up to which damping holds a parameter as if it had this effect: relative
# damping alone sends parameters of little effect far away. Of 40 descents of five models that do not describe the data, the best ended
# lowest with 0.1, of 1e-4, 1e-3, 1e-2, 0.1, 0.3 and 1.
_LITTLE = 0.1
ON_BOUND = 1e-6  # relative distance below which a bounded solver decides whether a parameter is on its bound: z would not converge
_FIRST = 1e-3  # damping
_EQUAL = 1e-12  # relative difference of two costs that rounding may cause, below which the linear model decides
# At a crease of the cost, as the limits of a branch make them, no step is shorter than what the linear model promises. A hundredth of a
# standard error may be left, which is this part of the cost times the number of samples.
_CREASE, _SHORT_STEP = 1e-4, 1.0  # and the damping from which a step is short
_CLOSE = 0.5  # excess of the cost over that of a converged start, within which the linear model shows whether a start can do better
# Part of the tolerance that the next step may leave by the decrease that the last one left, where it is taken without looking: steps of
# Bouc-Wen left up to 0.06 times the tolerance where 0.01 was expected.
_EXPECTED = 0.01
# The longest step that is taken so: along a direction that noise alone determines, the linear model promises as little of any step, and one
# of a hundred took the slope of a loop to 1e116.
_SURE_STEP = 0.02
_BETTER = 1e-4  # a lower cost, relative to that of the converged start, that is worth further steps


class Lane(NamedTuple):
    """The state of descents, with any leading axes.

    Attributes:
        best: the best point.
        trial: the next to try, (..., p).
        damping: of the step to it.
        promised: decrease of the cost below that of the best point that the linear model promises.
        last: whether the next point is the last.
        ended: whether the descent has.
        steps: linearizations.
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
        """Lanes before their first step.

        Args:
            z: where they start.
            damping: of their first step, that of descents which they continue.
        """
        count, p = z.shape
        none, no = np.zeros(count), np.zeros(count, bool)
        best = Normal(z.copy(), none + np.inf, np.zeros((count, p)), np.zeros((count, p, p)))
        damping = none + _FIRST if damping is None else damping.copy()
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
        """Which have: the linear model promises next to nothing, and the last step has shown it."""
        return np.asarray(self.last & self.ended & np.isfinite(self.best.cost))


def advanced(lane: Lane, new: Normal, gain: Any, samples: int, bounded: np.ndarray, xp: ModuleType) -> Lane:
    """Lanes after their trial points were linearized.

    Args:
        lane: before.
        gain: decrease of the cost that the linear model promises, relative to the cost, below which a lane has converged.
        samples: of each problem.
        bounded: which parameters have bounds, shape (p,).
        xp: `numpy` or `jax.numpy`.
    """
    # The last step may change the cost by less than rounding does.
    better = new.cost < xp.where(lane.last, lane.best.cost * (1 + _EQUAL), lane.best.cost)
    softer = xp.where(xp.isinf(lane.best.cost), lane.damping, xp.maximum(0.1 * lane.damping, LEAST_DAMPING))
    damping = xp.where(better, softer, 10.0 * lane.damping)
    chosen = lambda a, b: xp.where(better.reshape(better.shape + (1,) * (a.ndim - better.ndim)), a, b)
    best = Normal(*(chosen(a, b) for a, b in zip(new, lane.best, strict=True)))
    # Damping holds the directions that the data hardly determine: what is left to gain shows without it.
    floor = ROUNDING**2 * samples
    system = _scaled(best, samples, bounded, xp)
    step = _step(best, *system, damping, samples, xp)
    whole = _step(best, *system, xp.full_like(damping, LEAST_DAMPING), samples, xp)
    promised = -((best.gradient * whole).sum(-1) + 0.5 * xp.einsum("...i,...ij,...j->...", whole, best.matrix, whole))
    near = promised <= xp.maximum(gain, _EQUAL) * best.cost + floor
    settled = ~better | (promised <= gain * best.cost + floor)
    crease = ~better & (damping >= _SHORT_STEP) & (promised <= _CREASE / samples * best.cost)
    # What one step leaves of the promised decrease, the next one leaves of it, or less: damping falls.
    expected = promised**2 <= _EXPECTED * gain * best.cost * xp.where(xp.isinf(lane.promised), 0.0, lane.promised)
    sure = better & near & expected & (_longest(whole, bounded, xp) <= _SURE_STEP)
    best = best._replace(z=xp.where(sure[..., None], best.z + whole, best.z))
    ended = (lane.last & settled) | sure | crease | (damping >= MOST_DAMPING) | xp.isinf(best.cost)
    way = xp.where(near[..., None], whole, step)
    shorter = LONGEST_STEP / xp.maximum(_longest(way, bounded, xp), 1e-300)
    trial = best.z + way * xp.minimum(1.0, shorter)[..., None]
    return Lane(best, trial, damping, promised, lane.last | near | crease, ended, lane.steps + 1)


def _longest(step: Array, bounded: np.ndarray, xp: ModuleType) -> Array:
    """The largest change of a parameter that has bounds, in its unconstrained coordinate."""
    return xp.max(xp.where(bounded, xp.abs(step), 0.0), axis=-1, initial=0.0)


def _scaled(point: Normal, samples: int, bounded: np.ndarray, xp: ModuleType) -> tuple[Array, Array]:
    """The normal matrix with a diagonal of ones, and the factors that make it; 0 for a parameter that stays."""
    diagonal = xp.diagonal(point.matrix, axis1=-2, axis2=-1)
    largest = xp.max(diagonal, axis=-1, keepdims=True, initial=0.0)
    scale = 1 / xp.sqrt(xp.maximum(diagonal, 1e-24 * largest + 1e-300))
    scale = xp.where(bounded & (diagonal < NOTHING**2 * samples), 0.0, scale)
    return point.matrix * scale[..., :, None] * scale[..., None, :], scale


def _step(point: Normal, scaled: Array, scale: Array, damping: Array, samples: int, xp: ModuleType) -> Array:
    """The damped step; arguments as for `advanced`, and the result of `_scaled`."""
    held = damping[..., None] * xp.maximum(1.0, (_LITTLE * scale) ** 2 * samples)
    system = scaled + held[..., None] * xp.eye(scale.shape[-1])
    return -scale * xp.linalg.solve(system, (scale * point.gradient)[..., None])[..., 0]


def beaten(lane: Lane, problems: np.ndarray) -> np.ndarray:
    """Which lanes approach no lower cost than the best converged lane of the same problem, shape (L,).

    Args:
        problems: the number of the problem of each.
    """
    rival, cost, ended = _rival(lane, problems), np.asarray(lane.best.cost), np.asarray(lane.ended)
    near, hopeless = cost <= (1 + _CLOSE) * rival, cost - np.asarray(lane.promised) >= (1 - _BETTER) * rival
    return ~ended & np.isfinite(rival) & near & hopeless


def approached(lane: Lane, problems: np.ndarray) -> np.ndarray:
    """The cost that the linear model of each lane promises, above that of the best converged lane of its problem, shape (L,)."""
    return np.maximum(np.asarray(lane.best.cost - lane.promised), (1 + _BETTER) * _rival(lane, problems))


def _rival(lane: Lane, problems: np.ndarray) -> np.ndarray:
    """The least cost of the converged lanes of the same problem, infinite without one, shape (L,)."""
    least, converged = np.full(int(problems.max(initial=-1)) + 1, np.inf), lane.converged
    np.minimum.at(least, problems[converged], np.asarray(lane.best.cost)[converged])
    return least[problems]
