"""Weights of a Preisach model from any records: convex, non-negative, smooth, the smoothness chosen on data left out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.models.preisach.model import Preisach
from hystfit.models.preisach.smooth import SMOOTHNESS, fit_smooth
from hystfit.models.preisach.smooth_system import Offsets, SmoothSystem


@dataclasses.dataclass(frozen=True)
class PreisachFit:
    """A fitted Preisach model and what the data determine of it.

    Attributes:
        model: with the parameters of the first record.
        offsets: of every record, shape (R,).
        nrmse_percent: error on the samples that counted, percent of the output's range.
        smoothness: strength that blocks left out chose.
        left_out_percent: error on those blocks, percent of the output's range; None where one strength was given.
        reach: part of each weight's cells that the data switched, shape (weights,).
        notes: one sentence each.
    """

    model: Preisach
    offsets: np.ndarray
    nrmse_percent: float
    smoothness: float
    left_out_percent: float | None
    reach: np.ndarray
    notes: tuple[str, ...]

    def predict(self, u: np.ndarray) -> np.ndarray:
        """Output of the fitted model on an input, shape (T,)."""
        return self.model.free_run(u)


def fit_preisach(
    data: Record | Dataset | Sequence[Record],
    model: Preisach | int = 24,
    *,
    smoothness: Sequence[float] = SMOOTHNESS,
    nonnegative: bool = True,
    offsets: Offsets = "shared",
    **structure: Any,
) -> PreisachFit:
    """Fit the weights of a Preisach model to arbitrary loops.

    Args:
        data: records.
        model: a model (its levels are chosen again unless its spacing is "given"), or the number of cells along an axis of a new one.
        smoothness: strengths of the penalty on second differences, to choose among.
        nonnegative: bound the masses from below.
        offsets: each record its own constant, one for all, or none.
        **structure: of a new model, as in `Preisach.of` (symmetric, reversible, initial, ...).

    Returns:
        The model and what the data touched.

    Raises:
        HystfitError: data or settings that cannot be used.
    """
    records = list(Dataset.of(data))
    model = (Preisach.of(model, **structure) if isinstance(model, int) else model).start(records)
    designs = [model.design_matrix(r.u) for r in records]
    system = SmoothSystem.of(designs, records, nonnegative=nonnegative, offsets=offsets)
    fit = fit_smooth(system, smoothness)
    split = np.cumsum([model.w.size, model.slopes.size, model.b.size])
    *weights, constants = np.split(fit.weights, split)
    constants = np.resize(constants, len(records)) if constants.size else np.zeros(len(records))
    arrays = (jnp.asarray(value, dtype=model.levels.dtype) for value in (*weights, constants[0]))
    fitted = eqx.tree_at(lambda m: (m.w, m.slopes, m.b, m.offset), model, tuple(arrays))
    residuals = [
        (fitted.free_run(r.u) - constants[0] + constant - r.y)[r.used]
        for r, constant in zip(records, constants, strict=True)
    ]
    span = float(np.ptp(np.concatenate([r.y[r.used] for r in records]))) or np.nan
    error = None if fit.error is None else 100 * fit.error
    return PreisachFit(
        fitted,
        constants,
        100 * float(np.sqrt(np.mean(np.concatenate(residuals) ** 2))) / span,
        fit.smoothness,
        error,
        system.reach[: model.w.size],
        system.notes(),
    )
