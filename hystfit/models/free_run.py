"""Free runs on the host by the fastest way that a model has."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from hystfit.models.base import AbstractHysteresis, simulate
from hystfit.models.compose import Series, Sum
from hystfit.models.preisach.compiled import compile_for, respond
from hystfit.models.preisach.density import ParametricPreisach
from hystfit.models.preisach.design_matrix import features
from hystfit.models.preisach.model import Preisach

_SMALL = (
    4_000_000  # samples times weights up to which columns on the host beat compiling look-ups for yet another shape
)


def has_short_cut(model: AbstractHysteresis) -> bool:
    """Whether some part of a model is faster by look-ups than by a scan."""
    if isinstance(model, Sum):
        return any(has_short_cut(part) for part in model.parts)
    if isinstance(model, Series):
        return model.parts[0].rate_independent and has_short_cut(model.parts[0])
    return isinstance(model, (Preisach, ParametricPreisach))


def free_run(model: AbstractHysteresis, u: Any, dt: Any = None) -> np.ndarray:
    """The output that `simulate` returns, shape (T,): by look-ups where the model is a Preisach model or begins with one.

    Args:
        model: any model.
        u: input, shape (T,).
        dt: as in `simulate`.

    Raises:
        ModelError: as `simulate`.
    """
    if not has_short_cut(model) or np.ndim(u) != 1 or np.size(u) == 0:
        return np.asarray(simulate(model, jnp.asarray(u), None if dt is None else jnp.asarray(dt))[0])
    if isinstance(model, Sum):
        return np.sum([free_run(part, u, dt) for part in model.parts], axis=0)
    if isinstance(model, Series):
        first, *others = model.parts
        return free_run(others[0] if len(others) == 1 else Series(*others), free_run(first, u), dt)
    cells = model.preisach() if isinstance(model, ParametricPreisach) else model
    u = np.asarray(u, dtype=float)
    if u.size * cells.w.size > _SMALL:
        return np.asarray(respond(cells, compile_for(cells, u)))
    columns, index = features(cells, u)
    return (columns @ np.concatenate([cells.w, cells.slopes, cells.b]) + float(cells.offset))[index]
