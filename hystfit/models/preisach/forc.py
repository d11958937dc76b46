"""First-order reversal curves: saturate, go back to a reversal field, return; a density from them, and the field's diagram of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError
from hystfit.models.preisach.model import Elements, Preisach
from hystfit.models.preisach.smooth import SMOOTHNESS
from hystfit.models.preisach.solve import PreisachFit, fit_preisach
from hystfit.quality.reversal_curves import at_inputs, reversal_curves


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
        data: one record a curve, the reversal point first.
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
    fit = fit_preisach(family.curves, model, nonnegative=nonnegative, smoothness=smoothness, left_out="records")
    return dataclasses.replace(fit, notes=(*family.notes, *fit.notes))


@dataclasses.dataclass(frozen=True)
class ForcDiagram:
    """FORC distribution rho = -1/2 d2M / dHr dH over reversal field Hr and field H, the field's picture of a density.

    Attributes:
        reversal, field: grid lines, shapes (R,) and (F,).
        density: shape (R, F), NaN where there are no data (H before Hr).
    """

    reversal: np.ndarray
    field: np.ndarray
    density: np.ndarray

    @property
    def coercivity(self) -> np.ndarray:
        """Half the distance from reversal to field, shape (R, F): the horizontal axis as the field draws it."""
        return 0.5 * np.abs(self.field[None, :] - self.reversal[:, None])

    @property
    def interaction(self) -> np.ndarray:
        """Middle of reversal and field, shape (R, F): the vertical axis."""
        return 0.5 * (self.field[None, :] + self.reversal[:, None])


def forc_diagram(data: Dataset | Sequence[Record], smoothing: int = 3) -> ForcDiagram:
    """Local second-degree fits over (2 SF + 1)^2 points, as the field computes it (Pike, Roberts and Verosub 1999).

    Args:
        data: reversal curves.
        smoothing: the factor SF, in curves and as many field steps.

    Raises:
        DataError: see `hystfit.quality.reversal_curves.reversal_curves`; a smoothing factor below one.
    """
    if smoothing < 1:
        raise DataError(f"the smoothing factor must be at least 1, got {smoothing}")
    curves = reversal_curves(data).curves
    reversal = np.array([r.u[0] for r in curves])
    step = float(np.median(np.abs(np.concatenate([np.diff(r.u) for r in curves]))))
    low, high = min(r.u.min() for r in curves), max(r.u.max() for r in curves)
    field = np.arange(low, high + 0.5 * step, step)
    table = np.full((reversal.size, field.size), np.nan)
    for k, r in enumerate(curves):
        inside = (field >= r.u.min()) & (field <= r.u.max())
        table[k, inside] = at_inputs(r, field[inside])
    density = np.full(table.shape, np.nan)
    for k in range(reversal.size):
        for j in np.flatnonzero(np.isfinite(table[k])):
            rows = slice(max(k - smoothing, 0), k + smoothing + 1)
            cols = slice(max(j - smoothing, 0), j + smoothing + 1)
            density[k, j] = _mixed(reversal[rows] - reversal[k], field[cols] - field[j], table[rows, cols])
    order = np.argsort(reversal)
    return ForcDiagram(reversal[order], field, density[order])


def _mixed(a: np.ndarray, b: np.ndarray, block: np.ndarray) -> float:
    """-1/2 of the mixed second derivative at the middle of a block, from the best second-degree polynomial."""
    A, B = np.meshgrid(a, b, indexing="ij")
    ok = np.isfinite(block)
    if ok.sum() < 9 or np.ptp(A[ok]) == 0 or np.ptp(B[ok]) == 0:
        return np.nan
    x, y = A[ok] / np.ptp(a), B[ok] / np.ptp(b)
    columns = np.column_stack([np.ones(x.size), x, y, x * x, x * y, y * y])
    solution, _, rank, _ = np.linalg.lstsq(columns, block[ok], rcond=1e-9)
    return float(-0.5 * solution[4] / (np.ptp(a) * np.ptp(b))) if rank == 6 else np.nan
