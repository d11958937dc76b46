"""The paths along which profile likelihoods are followed: one parameter stepped outward, all others refitted within their bounds."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from hystfit.fitting.solvers.multistart import spread_starts
from hystfit.inference.bounded_newton import EDGE, BoundedNewton, Point

# Deviation of the root statistic from that of the curvature, relative, up to which one descent is enough.
_ORDINARY = 0.2
_STRIDE = 0.6  # target rise of the root statistic from point to point
_JUMP = 1.5  # rise of the root statistic above which a step is shortened
_FAR = 12.0  # distance in z beyond which a side counts as open: a factor of 160 000, or within 6e-6 of a bound
_FAR_LINEAR = 1e4  # the same for a linear parameter, in its scale
_LOWER = 1e-3  # decrease of the value below the optimum that counts as another optimum


class LowerOptimum(Exception):
    """The refits of a path end below the optimum from which the paths started."""

    def __init__(self, point: Point):
        super().__init__(point.value)
        self.point = point


@dataclasses.dataclass(frozen=True)
class Path:
    """One side of a profile: the coordinate away from the optimum, -2 delta log likelihood over the squared widening, and the refits."""

    v: np.ndarray
    statistic: np.ndarray
    points: tuple[Point, ...]

    def crossing(self, start: float, limit: float) -> float | None:
        """Where the root of the statistic crosses the limit, by linear interpolation; None where it does not."""
        root = np.sqrt(np.concatenate([[0.0], self.statistic]))
        v = np.concatenate([[start], self.v])
        above = np.flatnonzero(root > np.sqrt(limit))
        if not above.size:
            return None
        j = int(above[0])
        part = (np.sqrt(limit) - root[j - 1]) / (root[j] - root[j - 1])
        return float(v[j - 1] + part * (v[j] - v[j - 1]))


@dataclasses.dataclass(frozen=True)
class Walk:
    """The way along parameter k from the optimum to a limit of the statistic; its reported error is `wider` than an i.i.d. one."""

    newton: BoundedNewton
    optimum: Point
    k: int
    wider: float
    limit: float

    def root(self, point: Point) -> float:
        """Root of the statistic at a refit."""
        return float(np.sqrt(max(2 * (point.value - self.optimum.value), 0.0))) / self.wider

    def follow(self, sign: int) -> Path:
        """The path upward or downward in the parameter's coordinate."""
        points, before, shorter = [self.optimum], 0.0, 0
        start, low, high = self.optimum.v[self.k], *(side[self.k] for side in self.newton.limits)
        linear = self.newton.linear[self.k]
        step = float(np.clip(_STRIDE * self._error, 1e-6, 10.0 if linear else 1.0))
        far = _FAR_LINEAR if linear else max(_FAR, abs(start) + EDGE)
        while len(points) <= 24:  # on each side
            value = float(np.clip(points[-1].v[self.k] + sign * step, low, high))
            if value == points[-1].v[self.k]:
                break
            point = self._nearby(value, points[-1])
            if self.root(point) - before > _JUMP and shorter < 5:  # times
                step, shorter = 0.3 * step, shorter + 1
                continue
            point = self._spread_refit(value, point)
            rise = self.root(point) - before
            points.append(point)
            before, shorter = before + rise, 0
            if before**2 > 1.3 * self.limit or abs(value - start) > far:
                break
            step *= float(np.clip(_STRIDE / max(rise, 1e-3), 0.4, 3.0))
            step = step if linear else min(step, 2.0)
        path = self._back(points)
        lowest = min(path.points, key=lambda point: point.value, default=self.optimum)
        if lowest.value < self.optimum.value - _LOWER:
            raise LowerOptimum(lowest)
        return path

    @functools.cached_property
    def _error(self) -> float:
        """Standard error of the coordinate by the curvature, the parameters on their bounds left out."""
        low, high = self.newton.limits
        v = self.optimum.v
        free = (v > low) & (v < high)
        free[self.k] = True
        size = np.sqrt(np.maximum(np.diag(self.optimum.matrix)[free], 1e-24))
        scaled = self.optimum.matrix[np.ix_(free, free)] / np.outer(size, size)
        error = np.sqrt(np.linalg.pinv(scaled, rcond=1e-10, hermitian=True).diagonal()) / size
        return self.wider * float(error[np.flatnonzero(free) == self.k][0])

    def _ordinary(self, point: Point) -> bool:
        """Whether the statistic of a refit is negligible or about that of the curvature: one that stopped elsewhere is larger."""
        expected = abs(point.v[self.k] - self.optimum.v[self.k]) / max(self._error, 1e-300)
        root = self.root(point)
        return bool(root < 0.5 * _STRIDE or abs(root - expected) < _ORDINARY * expected)

    def _nearby(self, value: float, before: Point) -> Point:
        """The refit with the parameter at a value, from that before; from the optimum too where its statistic is not the curvature's."""
        point = self._refit(value, before.v)
        if self._ordinary(point):
            return point
        return min(point, self._refit(value, self.optimum.v), key=lambda one: one.value)

    def _spread_refit(self, value: float, point: Point) -> Point:
        """A refit, or the best of several starts where it would end the path although its statistic is not that of the curvature."""
        if self._ordinary(point) or self.root(point) ** 2 <= self.limit:
            return point
        return min(point, self._refit(value, *self._spread(), steps=30), key=lambda one: one.value)

    def _spread(self) -> list[np.ndarray]:
        """Starts spread about the optimum, for a refit that would end the path; a problem linear in the others needs none."""
        newton = self.newton
        others = np.arange(newton.linear.size) != self.k
        if newton.linear[others].all():
            return [self.optimum.v]
        space = newton.problem.space
        center = space.unconstrained(newton.physical(self.optimum.v))
        return [newton.coordinates(space.physical(z)) for z in spread_starts(newton.problem, center, 8, 0)]

    def _refit(self, value: float, *others: np.ndarray, steps: int = 8) -> Point:
        """The best refit with the parameter at a value, from several starts of the other parameters."""
        moving = np.arange(others[0].size) != self.k
        starts = [np.where(moving, other, value) for other in others]
        return self.newton.best(starts, moving, self.k, steps)

    def _back(self, points: list[Point]) -> Path:
        """The path; where a refit is not ordinary, each is repeated from its outer neighbor and the better one kept."""
        unusual = not all(self._ordinary(point) for point in points[1:])
        for j in range(len(points) - 2, 0, -1) if unusual else ():
            again = self._refit(float(points[j].v[self.k]), points[j + 1].v)
            if again.value < points[j].value:
                points[j] = again
        roots = np.array([self.root(point) for point in points[1:]])
        return Path(np.array([point.v[self.k] for point in points[1:]]), roots**2, tuple(points[1:]))
