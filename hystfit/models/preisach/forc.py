"""First-order reversal curves: saturate, go back to a reversal field, return; a density from them, and the field's diagram of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.models.preisach.everett import cells
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


@dataclasses.dataclass(frozen=True)
class ForcDiagram:
    """FORC distribution rho = -1/2 d2M / dHr dH over reversal field Hr and field H.

    Attributes:
        reversal, field: grid lines, shapes (R,) and (F,).
        density: shape (R, F), NaN where there are no data (H before Hr).
        area: of each cell of the grid, shape (R, F); None where it follows from the grid lines.
    """

    reversal: np.ndarray
    field: np.ndarray
    density: np.ndarray
    area: np.ndarray | None = None

    @property
    def coercivity(self) -> np.ndarray:
        """Half the distance from reversal to field, shape (R, F): the horizontal axis as the field draws it."""
        return 0.5 * np.abs(self.field[None, :] - self.reversal[:, None])

    @property
    def interaction(self) -> np.ndarray:
        """Middle of reversal and field, shape (R, F): the vertical axis."""
        return 0.5 * (self.field[None, :] + self.reversal[:, None])

    @property
    def mass(self) -> np.ndarray:
        """Integral of the density over each cell of the grid, shape (R, F); 0 where there are no data."""
        area = self.area
        if area is None:
            area = np.abs(np.gradient(self.reversal))[:, None] * np.abs(np.gradient(self.field))[None, :]
        return np.nan_to_num(self.density) * area


@dataclasses.dataclass(frozen=True)
class ForcNumbers:
    """Key numbers of a FORC diagram.

    Attributes:
        peak: coercivity and interaction of the largest density [u].
        median_coercivity: half of the positive mass lies below [u].
        width: of the coercivity distribution at half its height [u]; None where it does not fall to that.
        ridge: mean interaction, weighted by the mass within half the height of the coercivity distribution [u].
        ridge_width: standard deviation of the interaction there [u].
        total: integral of the density [y]: half the irreversible change of the output.
        negative_percent: share of the absolute mass that is negative: noise, or interactions that a Preisach model does not have.
        coercivity, distribution: centers of bins [u] and integral of the density over the interaction [y/u], shape (B,).
    """

    peak: tuple[float, float]
    median_coercivity: float
    width: float | None
    ridge: float
    ridge_width: float
    total: float
    negative_percent: float
    coercivity: np.ndarray
    distribution: np.ndarray

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`: the numbers; the distribution has a file of its own."""
        kept = {k: v for k, v in dataclasses.asdict(self).items() if not isinstance(v, np.ndarray)}
        return kept | {"peak": {"coercivity": self.peak[0], "interaction": self.peak[1]}}


def forc_numbers(diagram: ForcDiagram) -> ForcNumbers:
    """Peak, ridge and coercivity distribution of a diagram."""
    x, y, mass = diagram.coercivity, diagram.interaction, diagram.mass
    if not (mass > 0).any():
        raise DataError("the FORC density is nowhere positive: use more curves, or a smaller smoothing factor")
    at = np.unravel_index(np.nanargmax(diagram.density), diagram.density.shape)
    step = float(np.median(np.abs(np.diff(diagram.reversal))))
    edges = np.arange(0.0, x.max() + step, step)
    sums = np.histogram(x, bins=edges, weights=mass)[0]
    centers, heights = 0.5 * (edges[1:] + edges[:-1]), sums / step
    positive = np.cumsum(np.maximum(sums, 0.0))
    low, high = _half_height(centers, heights)
    ridge = mass * ((x >= low) & (x <= high) & (mass > 0))
    mean = float(np.sum(ridge * y) / np.sum(ridge))
    return ForcNumbers(
        peak=(float(x[at]), float(y[at])),
        median_coercivity=float(np.interp(0.5 * positive[-1], positive, edges[1:])),
        width=None if heights[0] > 0.5 * heights.max() else high - low,
        ridge=mean,
        ridge_width=float(np.sqrt(np.sum(ridge * (y - mean) ** 2) / np.sum(ridge))),
        total=float(mass.sum()),
        negative_percent=100 * float(-mass[mass < 0].sum() / np.abs(mass).sum()),
        coercivity=centers,
        distribution=heights,
    )


def _half_height(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Where a curve has fallen to half its largest value on both sides of it."""
    top = int(np.argmax(y))
    below = np.flatnonzero(y < 0.5 * y[top])
    left, right = below[below < top], below[below > top]
    cross = lambda a, b: float(np.interp(0.5 * y[top], *zip(*sorted([(y[a], x[a]), (y[b], x[b])]), strict=True)))
    low = cross(left[-1], left[-1] + 1) if left.size else float(x[0])
    return low, cross(right[0], right[0] - 1) if right.size else float(x[-1])


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
