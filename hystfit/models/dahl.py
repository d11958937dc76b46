"""Dahl friction: forces that approach their limits exponentially with the displacement after every reversal."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis, check_same_length
from hystfit.models.shared.design import DesignMatrix
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.slopes import Slopes
from hystfit.models.shared.starting import input_range, output_range
from hystfit.params.param import element_places, element_weights, param
from hystfit.quality.loops import branches
from hystfit.quality.needs import Needs

_BRISTLES = 6  # by default
_SHORTEST, _LONGEST = 0.01, 2.0  # presliding displacements over half the range of the input


class Dahl(AbstractHysteresis):
    """Friction of bristles that bend before they slip, beside a spring:

        y = offset + k u + sum Fc_i q_i,    dq_i/du = (1 - sgn(du) q_i) / d_i

    q_i lies between -1 and 1. Fc_i >= 0 are the friction forces, and d_i = Fc_i / sigma0_i their presliding displacements, log-spaced
    and fixed, so that one convex solve gives the forces. One bristle is the model of Dahl (exponent 1). Between reversals the answer is
    exact at any step. There is no return-point memory: minor loops drift towards the middle of the loop. Add `viscous` for lubrication.

    Source: Dahl (1976), AIAA Journal 14, 1675-1682.
    """

    rate_independent: ClassVar[bool] = True
    c_template: ClassVar[str] = "dahl"
    counts: ClassVar[dict[str, str]] = {"bristles": "d"}
    has_fast_run: ClassVar[bool] = True
    estimator: ClassVar[str] = "convex"
    needs: ClassVar[Needs] = Needs(symmetry="symmetric", direction="clockwise", regularized=True)

    Fc: Float[Array, " bristles"] = element_weights((0.1,) * _BRISTLES, doc="friction force of each bristle")
    d: Float[Array, " bristles"] = element_places(
        tuple(np.geomspace(_SHORTEST, _LONGEST, _BRISTLES)), unit="u", doc="presliding displacements"
    )
    k: Scalar = param(0.0, unit="y/u", linear=True, doc="stiffness of the spring")
    offset: Scalar = param(0.0, unit="y", per_record=True, linear=True, doc="constant part of the force")

    def __check_init__(self) -> None:
        check_same_length(self, "Fc", "d", "bristle")

    @classmethod
    def of(cls, bristles: int = _BRISTLES) -> Dahl:
        """A model with this many bristles.

        Raises:
            ModelError: fewer than one.
        """
        if bristles < 1:
            raise ModelError(f"at least one bristle is needed, got {bristles}")
        return cls(Fc=np.full(bristles, 0.5 / bristles), d=_spread(bristles))

    def init(self, u0: Scalar) -> State:
        """State: q of each bristle, free of force, shape (bristles,)."""
        return jnp.zeros(self.d.size) * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """The exact answer to a displacement in one direction."""
        s = jnp.sign(u1 - u0)
        q = s + (state - s) * jnp.exp(-jnp.abs(u1 - u0) / self.d)
        return q, self.offset + self.k * u1 + jnp.dot(self.Fc, q)

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """The bristles, the spring and the offset."""
        u = np.asarray(u, dtype=float)
        columns = {"Fc": _bent(u, np.asarray(self.d)), "k": u[:, None], "offset": np.ones((u.size, 1))}
        return DesignMatrix.of(self, columns)

    def start(self, records: Sequence[Record]) -> Dahl:
        """Displacements over the range of the input; the forces follow from a linear solve."""
        half, out = input_range(records).half, output_range(records)
        d = half * _spread(self.d.size)
        return dataclasses.replace(self, d=d, Fc=np.full(d.shape, 0.5 * out.half / d.size), offset=out.center)

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes:
        """Flattest where all bristles slip, steepest after a reversal."""
        return Slopes.of(float(self.k), float(self.k) + 2.0 * float(jnp.sum(self.Fc / self.d)))


def _spread(bristles: int) -> np.ndarray:
    """Log-spaced displacements over half the range of the input; of a single bristle their geometric mean."""
    ends = (_SHORTEST, _LONGEST) if bristles > 1 else ((_SHORTEST * _LONGEST) ** 0.5,) * 2
    return np.geomspace(*ends, bristles)


def _bent(u: Float[np.ndarray, " T"], d: Float[np.ndarray, " n"]) -> Float[np.ndarray, "T n"]:
    """q of bristles with displacements d, branch by branch."""
    q = np.zeros((u.size, d.size))
    for first, last in branches(u):
        s = np.sign(u[last] - u[first])
        way = np.abs(u[first : last + 1, None] - u[first])
        q[first : last + 1] = s + (q[first] - s) * np.exp(-way / d)
    return q
