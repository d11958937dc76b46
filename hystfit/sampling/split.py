"""Coordinates in which a parameter and a part of it are two amounts.

With c > 0 and a part mu between 0 and 1 the output may show (1 - mu) c and mu c: data that determine the first to many digits, and c
to a factor, have a posterior in log c and logit mu that is a narrow, curved ridge, which no whitening straightens. In

    log((1 - mu) c)   and   log(mu c)

it is straight. Where the data determine c itself, that ridge is straight in log c and mu, and curved here. Either map has the
determinant 1 between these logarithms and the coordinates z.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hystfit.params.host_arrays import to_device


class Split(eqx.Module):
    """The map between z and coordinates w that have the logarithms of both amounts in the places of log c and logit mu.

    Attributes:
        whole, part: places of the parameters c, and of their parts.
        active: whether w differs from z; data, so that both have one program.
    """

    whole: tuple[int, ...] = eqx.field(static=True)
    part: tuple[int, ...] = eqx.field(static=True)
    active: Bool[Array, ""]

    @classmethod
    def all_of(cls, pairs: tuple[tuple[int, int], ...]) -> tuple[Split | None, ...]:
        """Those to choose from, for the places of c and mu."""
        if not pairs:
            return (None,)
        whole, part = zip(*pairs, strict=True)
        return tuple(cls(whole, part, to_device(active)) for active in (False, True))

    def z_of(self, w: Float[Array, "... d"]) -> Float[Array, "... d"]:
        """z from w."""
        rest, part = w[..., self.whole], w[..., self.part]
        z = w.at[..., self.whole].set(jnp.logaddexp(rest, part)).at[..., self.part].set(part - rest)
        return jnp.where(self.active, z, w)

    def of_z(self, z: Float[Array, "... d"]) -> Float[Array, "... d"]:
        """w from z."""
        whole, logit = z[..., self.whole], z[..., self.part]
        rest = whole - jnp.logaddexp(0.0, logit)
        w = z.at[..., self.whole].set(rest).at[..., self.part].set(rest + logit)
        return jnp.where(self.active, w, z)

    def split(self, size: int) -> Bool[Array, " d"]:
        """Which of so many coordinates are logarithms of amounts instead of parts between two bounds."""
        return jnp.zeros(size, bool).at[self.part,].set(self.active)
