"""A single-valued curve: the output that a device without hysteresis has, alone or behind a lag."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import check_same_length
from hystfit.models.memoryless import AbstractMemoryless
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.design import DesignMatrix
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.simulation import checked_drive
from hystfit.models.shared.slopes import POINTS, Slopes
from hystfit.models.shared.starting import fitted_input_range, output_range, used_samples
from hystfit.params.param import param
from hystfit.params.relative_size import ROUNDED

_KNOTS = 20  # as many as the search for terms has plays
_MEANS = 4  # of the samples, for each interval between knots, along which these are placed


class Curve(AbstractMemoryless):
    """A smooth curve without memory:  y = offset + rise x + sum of bend_j H_j(x),   x = (u - low) / (high - low).

    H_j'' is the hat function of knot j, and H_j is zero at both ends: the weights are the curvature at the knots, and a ridge on them
    makes a smoothing spline (Reinsch 1967). Beyond the outer knots it goes on as a straight line. The knots are denser where the curve is
    steep.

    Raises:
        ModelError: fewer than two knots, or not as many weights as knots.
    """

    one_scan: ClassVar[bool] = False
    counts: ClassVar[dict[str, str]] = {"knots": "knots"}
    estimator: ClassVar[str] = "convex"
    has_fast_run: ClassVar[bool] = True

    rise: Scalar = param(1.0, unit="y", linear=True, doc="rise of the output over the range of the input")
    bend: Float[Array, " knots"] = param(
        (0.0,) * _KNOTS, unit="y", linear=True, vector=True, doc="curvature at the knots"
    )
    offset: Scalar = param(0.0, unit="y", per_record=True, linear=True, doc="constant part of the output")
    knots: Float[Array, " knots"] = param(
        tuple(np.linspace(0.0, 1.0, _KNOTS)),
        fixed=True,
        vector=True,
        doc="knots, rising, as fractions of the input range",
    )
    low: Scalar = param(0.0, unit="u", fixed=True, doc="input where x = 0")
    high: Scalar = param(1.0, unit="u", fixed=True, doc="input where x = 1")

    def __check_init__(self) -> None:
        check_same_length(self, "bend", "knots", "knot")
        if getattr(self.knots, "size", 2) < 2:
            raise ModelError(f"a curve needs two knots or more, got {self.knots.size}")

    @classmethod
    def of(cls, knots: int = _KNOTS) -> Curve:
        """A curve with this many knots, at least two."""
        return cls(bend=np.zeros(knots), knots=np.linspace(0.0, 1.0, knots))

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        return state, self.sweep(state, u0, u1[None], dt)[1][0]

    def sweep(self, state: State, u0: Scalar, u: Any, dt: Any) -> tuple[State, Any]:
        """All samples at once."""
        x = (u - self.low) / (self.high - self.low)
        squares, cubes, line = (rows.T @ self.bend for rows in _hats(self.knots, jnp))
        beyond = jnp.maximum(x[:, None] - self.knots, 0.0)
        return state, self.offset + (self.rise + line[0]) * x + beyond**2 @ squares + beyond**3 @ cubes

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        """By columns, without a program to compile."""
        return self.design_matrix(*checked_drive(self, u, dt)).output(self)

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """The line, and the integrals of the hat functions."""
        x = (np.asarray(u, dtype=float) - float(self.low)) / (float(self.high) - float(self.low))
        knots = np.asarray(self.knots)
        squares, cubes, line = _hats(knots, np)
        beyond = np.maximum(x[:, None] - knots, 0.0)
        bends = beyond**2 @ squares.T + beyond**3 @ cubes.T + x[:, None] * line.T
        return DesignMatrix.of(self, {"rise": x[:, None], "bend": bends, "offset": np.ones((x.size, 1))})

    def start(self, records: Sequence[Record]) -> Curve:
        """Ranges from the samples that count, knots denser where their means are steep; the weights follow from a linear solve."""
        place, out = fitted_input_range(records), output_range(records)
        u, y = used_samples(records)
        order, count = np.argsort(u, kind="stable"), self.knots.shape[-1]
        edges = np.unique(np.linspace(0, u.size, min(u.size, _MEANS * count) + 1).astype(int))
        means = lambda values: np.diff(np.append(0.0, np.cumsum(values[order]))[edges]) / np.diff(edges)
        x, level = (means(u) - place.low) / place.width, means(y) / out.width
        way = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(level))))
        # By way and by samples in equal parts: no knots lie closer than half as far apart as they would by samples.
        place_of = way / (way[-1] or 1.0) + np.linspace(0.0, 1.0, way.size)
        knots = np.interp(np.linspace(0.0, 2.0, count), place_of, x)
        knots[[0, -1]] = 0.0, 1.0
        if not (np.diff(knots) > ROUNDED).all():  # of holds, and of a lag that decays to them
            knots = np.linspace(0.0, 1.0, count)
        return dataclasses.replace(
            self, rise=0.0, bend=np.zeros(count), offset=out.center, knots=knots, low=place.low, high=place.high
        )

    def reach(self) -> tuple[float, float]:
        """A quarter of the range beyond it on either side."""
        low, high = float(self.low), float(self.high)
        return low - 0.25 * (high - low), high + 0.25 * (high - low)

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes:
        """Slopes of the chords between many inputs."""
        u = np.linspace(low, high, POINTS)
        return Slopes.of(np.diff(self.free_run(u)) / np.diff(u))

    def c_part(self) -> CPart:
        """Cubic polynomials between the knots."""
        squares, cubes, line = (rows.T @ np.asarray(self.bend) for rows in _hats(np.asarray(self.knots), np))
        return CPart.of(self, "curve", squares=squares, cubes=cubes, slope=float(self.rise) + float(line[0]))


def _hats(knots: Any, xp: Any) -> tuple[Any, Any, Any]:
    """Second integrals of the hat functions, zero at both ends: factors of max(0, x - knot)^2, max(0, x - knot)^3, (n, n), and x, (n, 1).

    A hat is a step at an outer knot, and straight pieces whose slope changes at its knot and at the neighbors.
    """
    n = knots.shape[0]
    steepness = 1.0 / xp.diff(knots)
    rises, falls = xp.append(0.0, steepness), xp.append(steepness, 0.0)  # of each hat before and behind its knot
    at, before, after = np.eye(n), np.eye(n, k=-1), np.eye(n, k=1)
    cubes = (rises[:, None] * (before - at) + falls[:, None] * (after - at)) / 6
    squares = np.zeros((n, n))
    squares[0, 0], squares[-1, -1] = 0.5, -0.5
    last = 1.0 - knots
    return xp.asarray(squares), cubes, -(squares @ last**2 + cubes @ last**3)[:, None]
