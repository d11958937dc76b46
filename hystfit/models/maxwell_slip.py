"""Generalized Maxwell slip: friction by stops whose limits fall as the velocity grows."""

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
from hystfit.models.shared.sample_rate import rate_over
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.simulation import states_over
from hystfit.models.shared.starting import TYPICAL, input_range, output_range, speed
from hystfit.params.param import element_places, element_weights, param
from hystfit.quality.needs import Needs

_ELEMENTS = 10  # by default
_SHORTEST, _LONGEST = 0.005, 1.5  # limits over half the range of the input
_FIRST = (0.2, 0.2)  # excess of static friction, and Stribeck velocity over the typical one, from which a fit starts


class MaxwellSlip(AbstractHysteresis):
    """Elements that stick, as springs, and slip at limits that depend on the velocity v = du/dt, beside a spring and a dashpot:

        y = offset + k x + viscous v / speed + sum w_i e_i,    e_i <- clip(e_i + dx, -r_i s(v), r_i s(v)),    x = (u - center) / half
        s(v) = 1 + excess exp(-(v / vs)^2)

    w_i, viscous >= 0 follow from a linear solve for given excess and vs; the r_i are log-spaced and fixed. Before the elements slip the
    loop has return-point memory, as that of stops; excess is static over Coulomb friction less 1. It needs reversals at several speeds.
    Limits follow the velocity at once: the attraction of the slipping force, and so friction lag, is left out.

    Source: Al-Bender, Lampaert and Swevers (2005), IEEE Transactions on Automatic Control 50, 1883-1887.
    """

    no_inverse: ClassVar[str] = (
        "friction that depends on the velocity has no inverse: elements that slip have the same force at every place"
    )
    rate_independent: ClassVar[bool] = False
    takes_rate: ClassVar[bool] = True
    c_template: ClassVar[str] = "maxwell_slip"
    counts: ClassVar[dict[str, str]] = {"elements": "r"}
    estimator: ClassVar[str] = "convex"
    needs: ClassVar[Needs] = Needs(
        time=True,
        symmetry="symmetric",
        direction="clockwise",
        rate=True,
        speeds=2,
        regularized=True,
        too_few="static friction and the Stribeck velocity need reversals at several speeds",
    )

    w: Float[Array, " elements"] = element_weights(
        (0.1,) * _ELEMENTS, doc="stiffness of each element, as force over half the range"
    )
    r: Float[Array, " elements"] = element_places(
        tuple(np.geomspace(_SHORTEST, _LONGEST, _ELEMENTS)),
        scale=0.1,
        doc="limits at high velocity, over half the range of the input",
    )
    k: Scalar = param(0.0, unit="y", linear=True, doc="force of the spring over half the range")
    viscous: Scalar = param(0.1, bounds=(0.0, np.inf), unit="y", scale=0.1, linear=True, doc="viscous force at `speed`")
    offset: Scalar = param(0.0, unit="y", per_record=True, linear=True, doc="constant part of the force")
    excess: Scalar = param(0.2, bounds=(0.0, 10.0), scale=0.2, doc="static over Coulomb friction, less 1")
    vs: Scalar = param(0.2, bounds=(0.0, np.inf), unit="u/s", scale=0.1, doc="Stribeck velocity")
    center: Scalar = param(0.0, unit="u", fixed=True, doc="displacement where x = 0")
    half: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u", fixed=True, doc="half the range of the displacement")
    speed: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u/s", fixed=True, doc="typical velocity")

    def __check_init__(self) -> None:
        check_same_length(self, "w", "r", "element")

    @classmethod
    def of(cls, elements: int = _ELEMENTS) -> MaxwellSlip:
        """A model with this many elements.

        Raises:
            ModelError: fewer than two.
        """
        if elements < 2:
            raise ModelError(f"at least two elements are needed, got {elements}")
        return cls(w=np.full(elements, 1.0 / elements), r=np.geomspace(_SHORTEST, _LONGEST, elements))

    def init(self, u0: Scalar) -> State:
        """State: deflections of the elements, free of force, and the last velocity, shape (elements + 1,)."""
        return jnp.zeros(self.r.size + 1) * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """Stops with the limits of this velocity."""
        v = rate_over(u0, u1, dt, state[-1])
        limit = self.r * (1.0 + self.excess * jnp.exp(-((v / self.vs) ** 2)))
        e = jnp.clip(state[:-1] + (u1 - u0) / self.half, -limit, limit)
        x = (u1 - self.center) / self.half
        y = self.offset + self.k * x + self.viscous * v / self.speed + jnp.dot(self.w, e)
        return jnp.concatenate([e, v[None]]), y

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """The deflections and the velocity, which are the state; the spring and the offset."""
        states, x = states_over(self, u, dt), (np.asarray(u, dtype=float) - float(self.center)) / float(self.half)
        viscous = states[:, -1:] / float(self.speed)
        columns = {"w": states[:, :-1], "k": x[:, None], "viscous": viscous, "offset": np.ones((x.size, 1))}
        return DesignMatrix.of(self, columns)

    def start(self, records: Sequence[Record]) -> MaxwellSlip:
        """Ranges and a typical velocity from the records; the weights follow from a linear solve."""
        place, out = input_range(records), output_range(records)
        typical = speed(records, TYPICAL)
        ranges = {"center": place.center, "half": place.half, "speed": typical, "vs": _FIRST[1] * typical}
        w = np.full(self.w.shape, 0.5 * out.half / self.w.size)
        return dataclasses.replace(self, **ranges, w=w, viscous=0.1 * out.half, excess=_FIRST[0], offset=out.center)
