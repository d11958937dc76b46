"""A force of fractional order: relaxation by a power law of time, with two parameters, added to a spring or a hysteresis."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import numpy as np
from jaxtyping import Array, Complex, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.design import DesignMatrix
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.simulation import checked_drive
from hystfit.models.shared.starting import input_range, output_range
from hystfit.models.viscoelastic import MODES, Viscoelastic, extensions, relaxation_times
from hystfit.params.param import element_places, param
from hystfit.quality.needs import Needs

_FASTER, _SLOWER = 1e-3, 1e12  # relaxation times, over the ends of the chain, of a dashpot and of a spring


class Springpot(AbstractHysteresis):
    """Force of fractional order, between a spring (order 0) and a dashpot (order 1):  y = c T^order d^order u / dt^order,  T = 1 s.

    A step of u relaxes as c (t / T)^-order / Gamma(1 - order). The power law is a sum of Maxwell elements, by the trapezoidal rule over
    the logarithm of the relaxation time: within 0.1 % for two elements a decade. Slower elements act as a spring and faster ones as a
    dashpot, whose sums have a closed form. Two parameters predict rates decades away, where a chain of free elements is undetermined.
    Source: Schiessel, Metzler, Blumen and Nonnenmacher (1995), J. Phys. A 28, 6567.
    """

    rate_independent: ClassVar[bool] = False
    counts: ClassVar[dict[str, str]] = {"modes": "tau"}
    estimator: ClassVar[str] = "convex"
    needs: ClassVar[Needs] = Needs(loop=False, time=True, rate=True)

    c: Scalar = param(
        0.5, bounds=(0.0, np.inf), unit="y/u", linear=True, doc="force after a unit step, about 1 s later"
    )
    order: Scalar = param(0.3, bounds=(1e-3, 0.999), scale=0.1, doc="exponent of the relaxation in time")
    tau: Float[Array, " modes"] = element_places(
        tuple(np.geomspace(1e-3, 1e3, MODES)), unit="s", doc="relaxation times, evenly spaced on a logarithmic scale"
    )

    @classmethod
    def of(cls, modes: int = MODES) -> Springpot:
        """A power law by this many elements; take two for each decade of time.

        Raises:
            ModelError: fewer than two, which have no spacing.
        """
        if modes < 2:
            raise ModelError(f"at least two elements are needed, got {modes}")
        return cls(tau=np.geomspace(1e-3, 1e3, modes))

    def init(self, u0: Scalar) -> State:
        """State: extensions of all springs, relaxed at u0, shape (modes + 2,)."""
        return self._chain().init(u0)

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """The exact answer of the chain to a ramp from u0 to u1."""
        return self._chain().step(state, u0, u1, dt)

    def _chain(self) -> Viscoelastic:
        """The elements, with a dashpot for all faster ones and a spring for all slower ones."""
        g, tau = self._elements()
        return Viscoelastic(g=self.c * g, tau=tau)

    def _elements(self) -> tuple[Array | np.ndarray, Array | np.ndarray]:
        """Stiffness with c = 1 and relaxation time of each element of the chain, of parameters of NumPy in NumPy."""
        xp = self.tau.__array_namespace__()
        first, last, order = self.tau[0], self.tau[-1], self.order
        spacing = xp.log(last / first) / (self.tau.size - 1)
        dashpot = first ** (1.0 - order) / xp.expm1((1.0 - order) * spacing)
        spring = last**-order / xp.expm1(order * spacing)
        g = xp.concatenate([(dashpot / (_FASTER * first))[None], self.tau**-order, spring[None]])
        tau = xp.concatenate([(_FASTER * first)[None], self.tau, (_SLOWER * last)[None]])
        return spacing * xp.sin(xp.pi * order) / xp.pi * g, tau

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """The force of a springpot with c = 1."""
        g, tau = jax.tree.map(np.asarray, self)._elements()
        return DesignMatrix.of(self, {"c": extensions(tau, *checked_drive(self, u, dt)) @ g[:, None]})

    def modulus(self, frequency: Any) -> Complex[np.ndarray, " F"]:
        """Complex stiffness G' + i G'' at frequencies.

        Args:
            frequency: shape (F,) [Hz].
        """
        turn = 2j * np.pi * np.atleast_1d(np.asarray(frequency, dtype=float))
        return float(self.c) * turn ** float(self.order)

    def start(self, records: Sequence[Record]) -> Springpot:
        """Relaxation times of the records; the force follows from a linear solve."""
        c = 0.2 * output_range(records).half / input_range(records).half
        return dataclasses.replace(self, c=c, tau=relaxation_times(records, self.tau.shape[-1]))

    def c_part(self) -> CPart:
        """The chain in C."""
        return self._chain().c_part()
