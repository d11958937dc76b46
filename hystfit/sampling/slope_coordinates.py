"""Coordinates that have the slope of the loop in the place of the slope without hysteresis.

Data determine the slope of a loop to many digits, and often not which part of it the hysteresis takes, nor how soon that saturates:
where the loop is thin, c (1 - mu) is known if tau is small, and c if it is large. Over log c, logit mu and log tau such a posterior is
a narrow, curved ridge, which no whitening straightens. In the coordinates here it is straight. Their determinant is 1, because the
logarithm of `AbstractBoucWen.log_secant` shifts that of c by a function of the other parameters.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hystfit.inference.density import Density
from hystfit.models.bouc_wen import AbstractBoucWen
from hystfit.params.coordinates import BOTH, LOWER, Coordinates
from hystfit.params.host_arrays import to_device


class SlopeCoordinates(eqx.Module):
    """The map between z and coordinates w that have log(c secant) in the place of log c."""

    # c, mu: places in z of the parameters of each Bouc-Wen part of the model
    c: tuple[int, ...] = eqx.field(static=True)
    mu: tuple[int, ...] = eqx.field(static=True)
    parts: tuple[int, ...] = eqx.field(static=True)  # numbers of these parts among all such parts
    swing: Float[Array, ""]  # half range of the input [u]

    @classmethod
    def of(cls, density: Density) -> SlopeCoordinates | None:
        """Those of the model of a density; None where no part of it has both parameters free and of its own."""
        coordinates, u = density.objective.coordinates, np.asarray(density.objective.batch.u)
        places = _places(coordinates)
        template = jax.tree_util.tree_unflatten(coordinates.treedef, coordinates.leaves)
        index = {path: k for k, (path, _) in enumerate(jax.tree_util.tree_flatten_with_path(template)[0])}
        rows = []
        for number, (path, _) in enumerate(_secants(template)):
            c, mu = (places.get(index[*path, jax.tree_util.GetAttrKey(name)]) for name in ("c", "mu"))
            if c is not None and mu is not None and (coordinates.kinds[c], coordinates.kinds[mu]) == (LOWER, BOTH):
                rows.append((c, mu, number))
        if coordinates.ties or not rows:
            return None
        return cls(*zip(*rows, strict=True), to_device(0.5 * np.ptp(u)))

    def of_z(self, density: Density, z: Float[Array, "... d"]) -> Float[Array, "... d"]:
        """w from z."""
        return z.at[..., self.c].add(self._shift(density, z))

    def z_of(self, density: Density, w: Float[Array, "... d"]) -> Float[Array, "... d"]:
        """z from w."""
        return w.at[..., self.c].add(-self._shift(density, w))

    def bent(self, kinds: tuple[int, ...]) -> Bool[np.ndarray, " d"]:
        """Which coordinates between two bounds are linear inside: not mu, whose ridge is straight in its logit."""
        return np.array([kind == BOTH and k not in self.mu for k, kind in enumerate(kinds)])

    def _shift(self, density: Density, z: Float[Array, "... d"]) -> Float[Array, "... s"]:
        def one(z: Array) -> Array:
            parts = [part for _, part in _secants(density.objective.coordinates.tree(z[: density.p]))]
            return jnp.stack([parts[k].log_secant(self.swing) for k in self.parts])

        return jnp.vectorize(one, signature="(d)->(s)")(z)


def _secants(tree: Any) -> list[tuple[Any, Any]]:
    """Paths and parts of a model that have a secant."""
    found = lambda node: isinstance(node, AbstractBoucWen)
    return [row for row in jax.tree_util.tree_flatten_with_path(tree, is_leaf=found)[0] if found(row[1])]


def _places(coordinates: Coordinates) -> dict[int, int]:
    """Place in z of each leaf that is one free number for all records."""
    places, start = {}, 0
    for index, positions, per_record in coordinates.layout:
        if len(positions) == 1 and not per_record:
            places[index] = start
        start += len(positions) * (coordinates.n_records if per_record else 1)
    return places
