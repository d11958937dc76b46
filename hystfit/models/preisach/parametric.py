"""Parametric Preisach densities: a handful of parameters instead of one weight per cell.

The plane is described by coercivity h = (alpha - beta) / 2 and interaction m = (alpha + beta) / 2, as reversal curves draw it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.preisach.everett import cells
from hystfit.models.preisach.model import Preisach
from hystfit.models.preisach.staircase import Rest
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.starting import input_range, output_range
from hystfit.params.param import param

Density = Literal["gaussian", "lorentzian", "factorized"]


class ParametricPreisach(AbstractHysteresis):
    """A `Preisach` model with cells whose masses follow from a density, and a straight reversible part:

        gaussian     exp(-((h - coercivity) / width)^2 / 2 - ((m - shift) / spread)^2 / 2), a bivariate normal in (h, m)
        lorentzian   1 / ((1 + ((h - coercivity) / width)^2) (1 + ((m - shift) / spread)^2))
        factorized   f(alpha - shift) f(shift - beta), f(x) = 1 / (1 + ((x - coercivity) / width)^2): what a major loop determines
        y = offset + saturation (sum of masses g) / (sum of masses) + slope (u - center)

    The density is taken at the middle of each cell. `preisach()` gives the model with weights, and with it the compiled form.
    `depth` is the number of extrema that the sample-by-sample form remembers; its cost is in proportion.

    Raises:
        ModelError: an unknown density, or fewer than two levels.
    """

    rate_independent: ClassVar[bool] = True
    words: ClassVar[Mapping[str, tuple[str, ...]]] = {"density": get_args(Density), "initial": get_args(Rest)}
    has_fast_run: ClassVar[bool] = True

    saturation: Scalar = param(
        1.0, bounds=(0.0, np.inf), unit="y", linear=True, doc="half the jump between saturations"
    )
    coercivity: Scalar = param(0.4, bounds=(0.0, np.inf), unit="u", doc="h at the peak of the density")
    width: Scalar = param(0.3, bounds=(0.0, np.inf), unit="u", scale=0.3, doc="width of the density in h")
    spread: Scalar = param(0.3, bounds=(0.0, np.inf), unit="u", scale=0.3, doc="width of the density in m")
    shift: Scalar = param(0.0, unit="u", doc="m at the peak of the density")
    slope: Scalar = param(0.0, unit="y/u", linear=True, doc="reversible slope")
    offset: Scalar = param(0.0, unit="y", per_record=True, linear=True, doc="constant part of the output")
    levels: Float[Array, " levels"] = param(
        tuple(np.linspace(-1, 1, 41)), unit="u", fixed=True, doc="edges of the cells, rising"
    )
    center: Scalar = param(0.0, unit="u", fixed=True, doc="input of the demagnetized state")
    density: Density = eqx.field(static=True, default="gaussian")
    initial: Rest = eqx.field(static=True, default="demagnetized")
    depth: int = eqx.field(static=True, default=64)

    def __check_init__(self) -> None:
        if hasattr(self.levels, "shape") and self.levels.shape[0] < 2:
            raise ModelError(f"a density needs at least two levels, got {self.levels.shape[0]}")

    def shape(self, alpha: Float[Array, "..."], beta: Float[Array, "..."]) -> Float[Array, "..."]:
        """Density at thresholds, its peak 1."""
        h, m = 0.5 * (alpha - beta), 0.5 * (alpha + beta)
        if self.density == "factorized":
            f = lambda x: 1.0 / (1.0 + ((x - self.coercivity) / self.width) ** 2)
            return f(alpha - self.shift) * f(self.shift - beta)
        a, b = ((h - self.coercivity) / self.width) ** 2, ((m - self.shift) / self.spread) ** 2
        return jnp.exp(-0.5 * (a + b)) if self.density == "gaussian" else 1.0 / ((1.0 + a) * (1.0 + b))

    def preisach(self) -> Preisach:
        """The model with one weight per cell."""
        i, j = cells(self.levels.shape[0] - 1)
        width = self.levels[1:] - self.levels[:-1]
        middle = 0.5 * (self.levels[1:] + self.levels[:-1])
        # The middle of a triangle lies a third of the way from its right angle.
        third = jnp.where(i == j, width[i] / 6.0, 0.0)
        mass = width[i] * width[j] * jnp.where(i == j, 0.5, 1.0) * self.shape(middle[i] + third, middle[j] - third)
        mass = self.saturation * mass / jnp.sum(mass)
        straight = jnp.reshape(self.slope, (1,))
        return Preisach(
            w=mass,
            levels=self.levels,
            b=straight,
            offset=self.offset,
            center=self.center,
            half=1.0,
            initial=self.initial,
            depth=self.depth,
        )

    def plane(self) -> Preisach:
        """See `preisach`."""
        return self.preisach()

    def init(self, u0: Scalar) -> State:
        """The dominant extrema, as in `Preisach`."""
        return self.preisach().init(u0)

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        return self.preisach().step(state, u0, u1, dt)

    def start(self, records: Sequence[Record]) -> ParametricPreisach:
        """Cells over the input range, the peak at a third of it."""
        place, out = input_range(records), output_range(records)
        old = np.asarray(self.levels)
        return dataclasses.replace(
            self,
            saturation=0.8 * out.half,
            coercivity=place.half / 3,
            width=place.half / 4,
            spread=place.half / 4,
            shift=place.center,
            slope=0.2 * out.half / place.half,
            offset=out.center,
            levels=place.center + place.half * (2 * (old - old[0]) / (old[-1] - old[0]) - 1),
            center=place.center,
        )

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        return self.preisach().free_run(u, dt)
