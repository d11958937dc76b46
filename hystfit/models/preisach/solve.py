"""Weights of a Preisach model from any records, or from reversal curves: convex, non-negative, smooth, by data left out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.models.preisach.everett import cells
from hystfit.models.preisach.forc_diagram import ForcDiagram
from hystfit.models.preisach.model import Elements, Preisach
from hystfit.models.preisach.smooth import SMOOTHNESS, fit_smooth
from hystfit.models.preisach.smooth_system import Offsets, SmoothSystem
from hystfit.quality.reversal_curves import reversal_curves


@dataclasses.dataclass(frozen=True)
class PreisachFit:
    """A fitted Preisach model and what the data determine of it."""

    model: Preisach  # with the parameters of the first record
    offsets: np.ndarray  # of every record, shape (R,)
    nrmse_percent: float  # error on the samples that counted, percent of the output's range
    smoothness: float  # strength that blocks left out chose
    reach: np.ndarray  # part of each weight's cells that the data switched, shape (weights,)
    notes: tuple[str, ...]  # one sentence each

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
    return PreisachFit(
        fitted,
        constants,
        100 * float(np.sqrt(np.mean(np.concatenate(residuals) ** 2))) / span,
        fit.smoothness,
        system.reach[: model.w.size],
        system.notes(),
    )


def fit_forc(
    data: Dataset | Sequence[Record],
    n: int = 60,
    *,
    nonnegative: bool = True,
    elements: Elements = "cells",
    smoothness: Sequence[float] = SMOOTHNESS[2:7],
) -> PreisachFit:
    """Preisach masses from first-order reversal curves, on levels denser where the output is steep (see `levels_of_family`).

    Args:
        data: one record per curve, the reversal point first.
        n: cells, or relay levels, along each axis.
        nonnegative: bound masses and slopes from below; signed masses follow the data closer, and have no inverse.
        elements: cells, or point relays.
        smoothness: strengths to choose among, by curves left out.

    Returns:
        The fit; its model starts from saturation.

    Raises:
        DataError: see `hystfit.quality.reversal_curves.reversal_curves`.
    """
    family = reversal_curves(data)
    model = Preisach.of(n, elements=elements, spacing="reversal-curves")
    fit = fit_preisach(family.curves, model, nonnegative=nonnegative, smoothness=smoothness)
    return dataclasses.replace(fit, notes=(*family.notes, *fit.notes))


def density_of(model: Preisach, *, rising: bool = True) -> ForcDiagram:
    """The density of a fitted model over the middles of its cells; `rising` as for curves that begin at positive saturation."""
    levels, (i, j) = np.asarray(model.levels), cells(model.n)
    width, middle = np.diff(levels), 0.5 * (levels[1:] + levels[:-1])
    area = width[:, None] * width[None, :] * np.where(np.eye(model.n, dtype=bool), 0.5, 1.0)
    density, at = np.full(area.shape, np.nan), (j, i) if rising else (i, j)
    density[at] = np.asarray(model.masses()) / area[at]
    return ForcDiagram(middle, middle, density, area)
