"""The Preisach plane: which cells or relays there are, what they weigh, and how an input moves their memory."""

from __future__ import annotations

from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.models.base import AbstractHysteresis
from hystfit.models.preisach.everett import AnyArray, CellMemory, cells, mirror
from hystfit.models.preisach.staircase import Rest
from hystfit.models.shared.polynomial import legendre_series
from hystfit.models.shared.shapes import Scalar, State

Elements = Literal["cells", "relays"]


def ramp_count(count: int, symmetric: bool) -> int:
    """Number of ramps on a number of levels."""
    return count // 2 if symmetric else max(count - 1, 0)


def ramps(levels: AnyArray, center: AnyArray, u: AnyArray, symmetric: bool, xp: Any) -> AnyArray:
    """The functions r_k of the reversible part (see `Preisach`) at inputs of any shape, shape (..., intervals)."""
    if symmetric:
        start = levels.shape[0] // 2
        levels = xp.concatenate([xp.reshape(xp.asarray(center), (1,)), levels[start + levels.shape[0] % 2 :]])
    x = xp.abs(u - center) + center if symmetric else u
    part = (x[..., None] - levels[:-1]) / (levels[1:] - levels[:-1])
    first, last = np.eye(levels.shape[0] - 1)[[0, -1]].astype(bool)
    low, high = np.where(first & (not symmetric), -np.inf, 0.0), np.where(last, np.inf, 1.0)
    part = xp.clip(part, low, high)
    return xp.sign(u - center)[..., None] * part if symmetric else part


class AbstractPlane(AbstractHysteresis):
    """Structure and dynamics of a Preisach model; `Preisach` holds the fields and documents them."""

    w: eqx.AbstractVar[Float[Array, " cells"]]
    levels: eqx.AbstractVar[Float[Array, " levels"]]
    slopes: eqx.AbstractVar[Float[Array, " intervals"]]
    b: eqx.AbstractVar[Float[Array, " degree"]]
    offset: eqx.AbstractVar[Scalar]
    center: eqx.AbstractVar[Scalar]
    half: eqx.AbstractVar[Scalar]
    elements: eqx.AbstractVar[Elements]
    symmetric: eqx.AbstractVar[bool]
    initial: eqx.AbstractVar[Rest]
    depth: eqx.AbstractVar[int]

    @property
    def n(self) -> int:
        """Cells, or relays, along each axis."""
        return self.levels.shape[0] - (self.elements == "cells")

    @property
    def weights(self) -> int:
        """Number of independent weights."""
        return mirror(self.n)[1].shape[1] if self.symmetric else self.n * (self.n + 1) // 2

    @property
    def intervals(self) -> int:
        """Number of slopes, where there are any."""
        return ramp_count(self.levels.shape[0], self.symmetric)

    def masses(self) -> Float[Array, " all"]:
        """Weights of all cells or relays, mirror images written out, shape (n (n + 1) / 2,)."""
        return self.w[mirror(self.n)[0]] if self.symmetric else self.w

    def thresholds(self) -> tuple[Float[Array, " all"], Float[Array, " all"]]:
        """Up and down threshold of every relay, or of the middle of every cell."""
        i, j = cells(self.n)
        at = self.levels if self.elements == "relays" else 0.5 * (self.levels[1:] + self.levels[:-1])
        return at[i], at[j]

    def single_valued(self, u: Float[Array, "..."]) -> Float[Array, "..."]:
        """The part of the output without memory, the offset included."""
        y = self.offset + legendre_series(self.b, (u - self.center) / self.half, first=1)
        if self.slopes.size:
            y = y + ramps(self.levels, self.center, u, self.symmetric, jnp) @ self.slopes
        return y

    def memory(self) -> CellMemory:
        """Tables of the masses of cells."""
        return CellMemory.of(self.masses(), self.levels, self.center, self.initial, self.symmetric)

    # -- dynamics --------------------------------------------------------------------------------------------------------

    def init(self, u0: Scalar) -> State:
        """State after the input went from the initial state to u0: the dominant extrema, the last one repeated to fill the
        array; or the relays, +1 or -1.
        """
        if self.elements == "cells":
            return jnp.full((self.depth,), u0)
        up, down = self.thresholds()
        if self.initial == "demagnetized":
            rest = jnp.where(up + down > 2.0 * self.center, -1.0, 1.0)
        else:
            rest = jnp.full(up.shape, 1.0 if self.initial == "positive" else -1.0)
        return _switch(rest, up, down, u0)

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """Wipe out the extrema that u1 passed; or switch the relays whose threshold it passed."""
        if self.elements == "relays":
            state = _switch(state, *self.thresholds(), u1)
            return state, self.single_valued(u1) + jnp.dot(self.masses(), state)
        state = self.remember(state, u1)
        memory = self.memory()
        pairs = memory.pair(memory.place(state[1:]), memory.place(state[:-1]), state[1:] > state[:-1])
        return state, self.single_valued(u1) + memory.rest + memory.first(state[0]) + jnp.sum(pairs)

    def remember(self, extrema: State, u: Scalar) -> State:
        """Dominant extrema after the input went to u: those that it passed are wiped out."""
        # Nested intervals: those that contain u come first. A full memory forgets its smallest loop.
        before = {"demagnetized": 2 * self.center - extrema[0], "negative": -jnp.inf, "positive": jnp.inf}[self.initial]
        other = jnp.concatenate([jnp.reshape(before, (1,)), extrema[:-1]])
        inside = (jnp.minimum(other, extrema) < u) & (u < jnp.maximum(other, extrema))
        kept = jnp.minimum(jnp.sum(inside), self.depth - 1)
        return jnp.where(jnp.arange(self.depth) < kept, extrema, u)


def _switch(state: Array, up: Array, down: Array, u: Array) -> Array:
    return jnp.where(u >= up, 1.0, jnp.where(u <= down, -1.0, state))
