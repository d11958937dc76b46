"""Coordinates of two parts of one variance: their sum, which the data determine, and their ratio, which they may not.

White and slow noise cannot be told apart where the slow one is small or as fast as the samples. In the logarithms z of both standard
deviations the posterior then has two arms, along each of which one of them goes to zero while the other is known to one part in the
root of twice the number of samples: no step size suits both arms, and transitions diverge. In

    a = log sqrt(exp(2 z_i) + exp(2 z_j)),    b = z_j - z_i

a is determined everywhere, and b is wide everywhere. The map keeps volumes.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from hystfit.inference.noise.base import AbstractNoise
from hystfit.params.param import leaves_of


def parts_of_noise(noise: AbstractNoise, first: int) -> tuple[int, int] | None:
    """Positions of the two parts of a noise model's variance, from `first` on; None where it has one part."""
    names = [leaf.path[-1] for leaf in leaves_of(noise)]
    if noise.parts is None:
        return None
    return first + names.index(noise.parts[0]), first + names.index(noise.parts[1])


def to_shares(z: Float[Array, "... d"], parts: tuple[int, int] | None) -> Float[Array, "... d"]:
    """(a, b) in the places of (z_i, z_j)."""
    if parts is None:
        return z
    i, j = parts
    first, second = z[..., i], z[..., j]
    return z.at[..., i].set(0.5 * jnp.logaddexp(2 * first, 2 * second)).at[..., j].set(second - first)


def from_shares(w: Float[Array, "... d"], parts: tuple[int, int] | None) -> Float[Array, "... d"]:
    """The inverse of `to_shares`."""
    if parts is None:
        return w
    i, j = parts
    a, b = w[..., i], w[..., j]
    first = a - 0.5 * jnp.logaddexp(0.0, 2 * b)
    return w.at[..., i].set(first).at[..., j].set(first + b)
