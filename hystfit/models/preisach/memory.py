"""Outputs of a Preisach model from its dominant extrema: look-ups in tables of its weights."""

from __future__ import annotations

from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hystfit.models.preisach.everett import Everett, FirstRise, Place, place

if TYPE_CHECKING:
    from hystfit.models.preisach.model import Preisach


class CellMemory(eqx.Module):
    """Tables of a model with cells; output = rest + first(e_0) + sum over k of pair(e_{k+1}, e_k).

    Attributes:
        everett: mass in triangles.
        up, down: mass switched by a first excursion from an asymmetric demagnetized state; None where it is not needed.
        rest: output of the initial state.
        levels, center: of the model.
        initial: the state before the record.
    """

    everett: Everett
    up: FirstRise | None
    down: FirstRise | None
    rest: Float[Array, ""]
    levels: Float[Array, " m"]
    center: Float[Array, ""]
    initial: str = eqx.field(static=True)

    @classmethod
    def of(cls, model: Preisach) -> CellMemory:
        """Tables of a model's weights."""
        w, levels, center = model.masses(), model.levels, model.center
        everett = Everett.of(w, model.n)
        up = down = None
        if model.initial == "demagnetized" and not model.symmetric:
            up, down = FirstRise.of(w, levels, center), FirstRise.falling(w, levels, center)
            rest = everett.total - 2 * up.sums[-1]
        else:
            rest = {"demagnetized": 0.0, "negative": -1.0, "positive": 1.0}[model.initial] * everett.total
        return cls(everett, up, down, rest, levels, center, model.initial)

    def place(self, u: Float[Array, "..."]) -> Place:
        """Locate inputs."""
        return place(self.levels, u)

    def first(self, u: Float[Array, "..."]) -> Float[Array, "..."]:
        """What the first excursion, to u, adds to the output."""
        if self.initial == "negative":
            return 2 * self.everett(self.place(u), self.place(self.levels[0]))
        if self.initial == "positive":
            return -2 * self.everett(self.place(self.levels[-1]), self.place(u))
        if self.up is not None and self.down is not None:
            return jnp.where(u >= self.center, 2 * self.up(u), -2 * self.down(2 * self.center - u))
        image = 2 * self.center - u
        mass = self.everett(self.place(jnp.maximum(u, image)), self.place(jnp.minimum(u, image)))
        return jnp.where(u >= self.center, mass, -mass)

    def pair(self, now: Place, before: Place, rising: Bool[Array, "..."]) -> Float[Array, "..."]:
        """What a move from one extremum to the next adds to the output."""
        pick = lambda a, b: Place(jnp.where(rising, a.cell, b.cell), jnp.where(rising, a.part, b.part))
        return jnp.where(rising, 2.0, -2.0) * self.everett(pick(now, before), pick(before, now))
