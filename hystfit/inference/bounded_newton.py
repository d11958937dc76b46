"""Least squares within bounds on the host: Levenberg-Marquardt steps on whitened normal equations, each a bounded quadratic problem.

A linear parameter moves in units of its scale, between its bounds: with hundreds of non-negative weights any of them may reach zero or
leave it in one step, and a problem that is linear in all parameters is solved exactly. The others move in unconstrained coordinates.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
import scipy  # loads its subpackages when they are first used, which optimize is not in most fits

from hystfit.inference.newton import LONGEST
from hystfit.inference.problem import Problem
from hystfit.inference.whitened import Whitened
from hystfit.params.coordinates import BOTH, LOWER, UPPER
from hystfit.params.host_arrays import compiled
from hystfit.params.space import ParameterSpace

EDGE = 8.0  # |z| beyond which a parameter counts as lying on its bound: within 3e-4 of the scale or the interval
_END = 16.0  # |z| beyond which no step leads towards a bound
_INSIDE = 3.0  # |z| from which a search is started again where a parameter lies on its bound
_DAMPING = 1e-9, 1e6  # least and largest
_STEPS, _TRIAL = 30, 8  # of a descent, and of those from several starts of which the best is continued


@dataclasses.dataclass(frozen=True)
class Point:
    """End point of a descent: coordinates v, half the squared whitened residual there, its gradient and its matrix."""

    v: np.ndarray
    value: float
    gradient: np.ndarray
    matrix: np.ndarray
    settled: bool = False  # whether a further step gains nothing


@dataclasses.dataclass(frozen=True)
class BoundedNewton:
    """Whitened least squares of a problem within the bounds of its parameters; a linear one is expanded about physical `origin`."""

    problem: Problem
    whitened: Whitened
    origin: np.ndarray

    # -- coordinates ---------------------------------------------------------------------------------------------------

    @property
    def _space(self) -> ParameterSpace:
        return self.problem.space

    @functools.cached_property
    def linear(self) -> np.ndarray:
        """Which parameters move in units of their scale, shape (p,), bool."""
        return self._space.linear

    @functools.cached_property
    def _one_sided(self) -> np.ndarray:
        return (self._space.kinds == LOWER) | (self._space.kinds == UPPER)

    @functools.cached_property
    def _two_sided(self) -> np.ndarray:
        return self._space.kinds == BOTH

    @functools.cached_property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest coordinates, shapes (p,)."""
        low = np.where(self._one_sided | self._two_sided, -_END, -np.inf)
        high = np.where(self._two_sided, _END, np.inf)
        linear_low, linear_high = self._space.lower / self._space.scale, self._space.upper / self._space.scale
        return np.where(self.linear, linear_low, low), np.where(self.linear, linear_high, high)

    def coordinates(self, x: np.ndarray) -> np.ndarray:
        """v of physical parameters; nonlinear parameters on a bound are moved to `EDGE`."""
        with np.errstate(all="ignore"):
            z = self._space.coordinates.unconstrained(x, 1e-9, np)
        z = np.where(self._one_sided, np.maximum(z, -EDGE), z)
        z = np.where(self._two_sided, np.clip(z, -EDGE, EDGE), z)
        return np.where(self.linear, x / self._space.scale, z)

    def physical(self, v: np.ndarray) -> np.ndarray:
        """Physical parameters at v."""
        x = self._space.physical(np.where(self.linear, 0.0, v))
        return np.where(self.linear, v * self._space.scale, x)

    def inside(self, v: np.ndarray, held: int = -1) -> np.ndarray | None:
        """v with the nonlinear parameters that lie on a bound, except number `held`, moved away from it; None where there are none."""
        near_low = (self._one_sided | self._two_sided) & (v < -_INSIDE)
        near = ~self.linear & (near_low | (self._two_sided & (v > _INSIDE)))
        near &= np.arange(v.size) != held
        return np.where(near, np.sign(v) * _INSIDE, v) if near.any() else None

    # -- descent -------------------------------------------------------------------------------------------------------

    @functools.cached_property
    def _expansion(self) -> tuple[float, np.ndarray, np.ndarray]:
        return self._traced(self.origin)

    def _traced(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        r, J = self.problem.linearize(x)
        value, gradient, matrix = _normal(self.whitened, jnp.asarray(r), jnp.asarray(J))
        return float(value), np.asarray(gradient), np.asarray(matrix)

    def at(self, v: np.ndarray) -> Point:
        """Value, gradient and Gauss-Newton matrix at v."""
        x = self.physical(v)
        if self.linear.all():
            value, gradient, matrix = self._expansion
            move = x - self.origin
            value, gradient = value + gradient @ move + 0.5 * move @ matrix @ move, gradient + matrix @ move
        else:
            value, gradient, matrix = self._traced(x)
        slope = np.where(self.linear, self._space.scale, self._space.slope(v))
        return Point(v, value, gradient * slope, matrix * np.outer(slope, slope))

    def descend(self, v: np.ndarray, moving: np.ndarray, steps: int = _STEPS, tolerance: float = 1e-5) -> Point:
        """The least-squares estimate from v, (p,), in at most so many steps; `tolerance` is the predicted decrease at which it stops."""
        low, high = self.limits
        point, damping = self.at(np.clip(v, low, high)), _DAMPING[0]
        for _ in range(steps):
            step = _step(point, damping, low, high, moving)
            longest = np.max(np.abs(step[~self.linear]), initial=0.0)
            step = step * min(1.0, LONGEST / max(longest, 1e-300))
            gain = -(point.gradient @ step + 0.5 * step @ point.matrix @ step)
            if not gain > tolerance:
                return dataclasses.replace(point, settled=True)
            new = self.at(np.clip(point.v + step, low, high))
            if new.value < point.value:
                point, damping = new, max(0.1 * damping, _DAMPING[0])
            else:
                damping = 10.0 * max(damping, 1e-5)
            if damping > _DAMPING[1]:
                return dataclasses.replace(point, settled=True)
        return point

    def best(self, starts: Sequence[np.ndarray], moving: np.ndarray, held: int = -1, steps: int = _TRIAL) -> Point:
        """The lowest of the descents from several starts, and from inside the bounds on which they lie; the parameter `held` stays."""
        inner = [v for start in starts if (v := self.inside(start, held)) is not None]
        several = [*starts, *inner]
        if len(several) == 1:
            return self.descend(several[0], moving)
        points = [self.descend(v, moving, steps) for v in several]
        return self.descend(min(points, key=lambda point: point.value).v, moving)


def _step(point: Point, damping: float, low: np.ndarray, high: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """The minimum of the damped quadratic model within the bounds."""
    at, step = np.flatnonzero(moving), np.zeros(point.v.size)
    diagonal = np.diag(point.matrix)[at]
    size = 1 / np.sqrt(np.maximum(diagonal, 1e-14 * max(diagonal.max(initial=0.0), 1e-280)))
    A = point.matrix[np.ix_(at, at)] * np.outer(size, size) + damping * np.eye(at.size)
    b = -size * point.gradient[at]
    below, above = (low - point.v)[at] / size, (high - point.v)[at] / size
    try:
        scaled = np.linalg.solve(A, b)
        if np.any(scaled < below) or np.any(scaled > above):
            root = np.linalg.cholesky(A).T
            target = np.linalg.solve(root.T, b)
            scaled = scipy.optimize.lsq_linear(root, target, (below, above), method="bvls").x
    except np.linalg.LinAlgError:
        return step
    step[at] = np.clip(scaled, below, above) * size
    return step


_normal = compiled(Whitened.normal_of)
