"""A Preisach density fitted to first-order reversal curves, and the density of a model as a diagram."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.models.preisach.everett import cells
from hystfit.models.preisach.forc_diagram import ForcDiagram
from hystfit.models.preisach.model import Elements, Preisach
from hystfit.models.preisach.smooth import SMOOTHNESS
from hystfit.models.preisach.solve import PreisachFit, fit_preisach
from hystfit.quality.reversal_curves import reversal_curves


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
    """The density of a fitted model as a diagram over the middles of its cells.

    Args:
        model: of cells, not of point relays.
        rising: the curves rise from their reversals, as those of `forc_diagram` that begin at positive saturation.
    """
    levels, (i, j) = np.asarray(model.levels), cells(model.n)
    width, middle = np.diff(levels), 0.5 * (levels[1:] + levels[:-1])
    area = width[:, None] * width[None, :] * np.where(np.eye(model.n, dtype=bool), 0.5, 1.0)
    density, at = np.full(area.shape, np.nan), (j, i) if rising else (i, j)
    density[at] = np.asarray(model.masses()) / area[at]
    return ForcDiagram(middle, middle, density, area)
