"""Coordinates v for sampling near bounds: linear inside, bent only near the bounds.

A logistic coordinate z squeezes a wide posterior next to a bound into a long tail that linear whitening does not fit: chains stay
there, or do not get there. Between two bounds, with t = v / 4 + 1/2,

    (x - lower) / (upper - lower) = g(t) = e [softplus(t / e) - softplus((t - 1) / e)],

x is linear in v within about 3 e of the bounds and an exponential beyond; e -> infinity is the logistic map. Value and slope agree
with those of z in the middle. Linear weights with one bound have

    |x - bound| / scale = width softplus(v),

because weights that replace each other have a straight valley in x and one with a sharp corner in log x.

Parameters that depend on each other linearly stay so up to a bound, but v goes on beyond the place where x hardly moves. With linear
coordinates y, the others would leave their ridge there: the posterior becomes many times narrower next to the bound, and chains stay
there, or do not get there. So each coordinate i with two bounds, one after another, moves those behind it by a shear of determinant 1,

    v_j = y_j + slope_ij (straight(v_i) - v_i),

where straight(v_i) is v_i without its bend, and the slope is that of the regression of j on i given those before i.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.special import expit

from hystfit.params.host_arrays import to_device

BEND = 0.05  # e, as a part of the interval
_FAR = -30.0  # below it softplus is the exponential function to all digits


class Bend(eqx.Module):
    """The map between v and the unconstrained coordinates z of `hystfit.params.coordinates`, element by element."""

    both: Bool[Array, " d"]  # which elements have two bounds
    # of the bend of linear weights with one bound, in their scale; 0 for all other elements, whose v is z
    width: Float[Array, " d"]

    def unbent(self, v: Float[Array, "... d"]) -> Float[Array, "... d"]:
        """z from v."""
        part, near = self._part(v)
        z = jnp.log(part) - jnp.log1p(-part)
        z = jnp.where(self.both, jnp.where(near == self._place(v), z, -z), v)
        one = jnp.log(jnp.where(self._soft, self.width, 1.0)) + _log_softplus(jnp.where(self._soft, v, 0.0))
        return jnp.where(self._soft, one, z)

    def bent(self, z: Float[Array, "... d"]) -> Float[Array, "... d"]:
        """v from z."""
        part = jax.nn.sigmoid(-jnp.abs(z))
        near = BEND * (jnp.log(jnp.expm1(part / BEND)) - jnp.log1p(-jnp.exp((part - 1) / BEND)))
        v = jnp.where(self.both, jnp.where(z < 0, 1, -1) * (4 * near - 2), z)
        away = jnp.exp(jnp.where(self._soft, z, 0.0)) / jnp.where(self._soft, self.width, 1.0)
        return jnp.where(self._soft, away + jnp.log(-jnp.expm1(-away)), v)

    def log_slope(self, v: Float[Array, " d"]) -> Float[Array, ""]:
        """log |det dz/dv|."""
        part, near = self._part(v)
        by_part = (
            jax.nn.log_sigmoid(near / BEND) + jax.nn.log_sigmoid((1 - near) / BEND) + jnp.log(-jnp.expm1(-1 / BEND) / 4)
        )
        two = jnp.where(self.both, by_part - jnp.log(part) - jnp.log1p(-part), 0.0)
        at = jnp.where(self._soft, v, 0.0)
        return jnp.sum(jnp.where(self._soft, jax.nn.log_sigmoid(at) - _log_softplus(at), two))

    @property
    def _soft(self) -> Bool[Array, " d"]:
        return self.width > 0

    def _place(self, v: Array) -> Array:
        return jnp.where(self.both, v, 0.0) / 4 + 0.5

    def _part(self, v: Array) -> tuple[Array, Array]:
        """Part of the interval from the nearer bound, so that small parts keep their digits; and t from there."""
        t = self._place(v)
        near = jnp.minimum(t, 1 - t)
        return BEND * (jax.nn.softplus(near / BEND) - jax.nn.softplus((near - 1) / BEND)), near


def straight(v: Any, xp: Any = jnp) -> Any:
    """v without its bend, for coordinates between two bounds: 4 (x - lower) / (upper - lower) - 2; `xp` is the module of the arrays."""
    t = v / 4 + 0.5
    return 4 * BEND * (xp.logaddexp(0.0, t / BEND) - xp.logaddexp(0.0, (t - 1) / BEND)) - 2


def straight_slope(v: np.ndarray) -> np.ndarray:
    """Derivative of `straight`, on the host."""
    t = v / 4 + 0.5
    return expit(t / BEND) - expit((t - 1) / BEND)


def _log_softplus(v: Array) -> Array:
    far = v < _FAR
    return jnp.where(far, v, jnp.log(jax.nn.softplus(jnp.where(far, 0.0, v))))


_WITHIN = 2.0  # standard deviations from the center at which bends are compared
_FLATTEST = 0.5  # slope of straight(v) at the center below which the center itself lies in the bend, and slopes there say nothing


class Shear(eqx.Module):
    """The map between linear coordinates y and v: others follow those with two bounds, in `order` of their bends, by `slopes`."""

    order: Int[Array, " b"]
    slopes: Float[Array, "b d"]

    @classmethod
    def of(cls, bend: Bend, center: Float[np.ndarray, " d"], factor: Float[np.ndarray, "d d"]) -> Shear:
        """From the center in v and a square root of the covariance of y."""
        two_sided = np.flatnonzero(np.asarray(bend.both))
        middle, sd = center[two_sided], np.linalg.norm(factor[two_sided], axis=1)
        ends = middle + _WITHIN * sd * np.array([[-1.0], [1.0]])
        strength = np.abs(straight(ends, np) - ends).max(axis=0) / sd
        ranked = np.argsort(-strength, kind="stable")
        place = np.concatenate([two_sided[ranked], np.setdiff1d(np.arange(center.size), two_sided)])
        root = np.linalg.qr(factor[place].T, mode="r")  # transpose of the Cholesky factor, but for signs
        slopes = np.zeros((two_sided.size, center.size))
        slopes[:, place] = np.triu(root / np.diag(root)[:, None], 1)[: two_sided.size]
        slopes[straight_slope(middle)[ranked] < _FLATTEST] = 0.0
        return cls(to_device(two_sided[ranked]), to_device(slopes))

    def sheared(self, y: Any, xp: Any = jnp) -> Any:
        """v from y, shape (..., d); `xp` is the module of the arrays, as in `unsheared`."""

        def follow(v: Any, at: tuple[Any, Any]) -> tuple[Any, None]:
            own = v[..., at[0]]
            return v + (straight(own, xp) - own)[..., None] * at[1], None

        if xp is jnp:
            return jax.lax.scan(follow, y, (self.order, self.slopes))[0]
        for at in zip(np.asarray(self.order), np.asarray(self.slopes), strict=True):
            y, _ = follow(y, at)
        return y

    def unsheared(self, v: Any, xp: Any = jnp) -> Any:
        """y from v."""
        own = v[..., xp.asarray(self.order)]
        return v - (straight(own, xp) - own) @ xp.asarray(self.slopes)
