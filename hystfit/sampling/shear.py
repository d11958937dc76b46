"""A shear by which coordinates follow those with two bounds where these bend.

Parameters that depend on each other linearly stay so up to a bound, but the coordinate v of `hystfit.sampling.bend` goes on beyond
the place where x hardly moves. With linear coordinates y, the others would leave their ridge there: the posterior becomes many times
narrower next to the bound, and chains stay there, or do not get there. So each coordinate i with two bounds, one after another, moves
those behind it by

    v_j = y_j + slope_ij (straight(v_i) - v_i),

where straight(v_i) is v_i without its bend, and the slope is that of the regression of j on i given those before i. The determinant is 1.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hystfit.params.host_arrays import to_device
from hystfit.sampling.bend import Bend, straight, straight_slope

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
