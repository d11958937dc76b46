"""Latin hypercubes of starting points."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hystfit.params.coordinates import BOTH, Coordinates


def latin_hypercube(dimensions: int, count: int, seed: int) -> Float[np.ndarray, "n d"]:
    """Points in the unit cube, one in each of `count` equal slices along every axis (McKay, Beckman and Conover 1979).

    The points are those of `scipy.stats.qmc.LatinHypercube`, whose import takes longer than a fit.
    """
    rng = np.random.default_rng(seed).spawn(1)[0]
    inside = rng.uniform(size=(count, dimensions))
    slices = np.tile(np.arange(1, count + 1), (dimensions, 1))
    for row in slices:
        rng.shuffle(row)
    return (slices.T - inside) / count


def spread_points(
    coordinates: Coordinates, center: Float[np.ndarray, " p"], count: int, seed: int, *, spread: float
) -> Float[np.ndarray, "n p"]:
    """A Latin hypercube of unconstrained points: about a center, but over most of the range of parameters with two bounds."""
    unit = latin_hypercube(center.size, count, seed)
    inside = 0.05 + 0.9 * unit
    both = np.array([kind == BOTH for kind in coordinates.kinds])
    return np.where(both, np.log(inside) - np.log1p(-inside), center + spread * (2 * unit - 1))
