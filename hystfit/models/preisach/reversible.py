"""The single-valued part of a Preisach model: ramps between levels, and a Legendre series."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial.legendre import legvander

from hystfit.models.preisach.everett import AnyArray

if TYPE_CHECKING:
    from hystfit.models.preisach.model import Preisach


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


def single_valued_columns(model: Preisach, u: np.ndarray) -> list[np.ndarray]:
    """Columns of slopes and b at inputs u, shapes (len(u), intervals) and (len(u), degree)."""
    levels, center = np.asarray(model.levels), float(model.center)
    out = [np.asarray(ramps(levels, np.asarray(center), u, model.symmetric, np))] if model.slopes.size else []
    if model.b.size:
        out.append(legvander((u - center) / float(model.half), model.b.size)[:, 1:])
    return out
