"""Pictures of Preisach models and of reversal curves, as the field draws them; each function takes axes and returns them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.models.preisach.everett import cells
from hystfit.models.preisach.model import Preisach
from hystfit.params.units import axis_label
from hystfit.results.labels import column_label


def plot_density(
    model: Preisach, ax: Any = None, reach: np.ndarray | None = None, *, units: Mapping[str, str] | None = None
) -> Any:
    """Weight density of every cell over the Preisach plane, beta to the right and alpha upward; hatched where the data do not reach.

    Args:
        model: with cells.
        ax: matplotlib axes; new ones if None.
        reach: part of each weight's cells that the data switched, as a fit returns it.
        units: of the input "u" and the output "y".
    """
    u, y = ((units or {}).get(symbol, "") for symbol in ("u", "y"))
    ax = axes_or_new(ax)
    levels, n = np.asarray(model.levels), model.n
    i, j = cells(n)
    if model.elements == "relays":
        alpha, beta = (np.asarray(t) for t in model.thresholds())
        dots = ax.scatter(beta, alpha, c=np.asarray(model.masses()), s=12, cmap="BuPu")
        ax.figure.colorbar(dots, ax=ax, label=axis_label("weight", y))
        return _label(ax, u)
    width = np.diff(levels)
    area = width[i] * width[j] * np.where(i == j, 0.5, 1.0)
    square = np.full((n, n), np.nan)
    square[i, j] = np.asarray(model.masses()) / area
    top = np.nanpercentile(np.abs(square), 99.5) or 1.0
    signed = bool((square[i, j] < -1e-3 * top).any())
    shades = {"cmap": "RdBu_r", "vmin": -top, "vmax": top} if signed else {"cmap": "BuPu", "vmin": 0, "vmax": top}
    mesh = ax.pcolormesh(levels, levels, square, shading="flat", rasterized=True, **shades)
    ax.figure.colorbar(mesh, ax=ax, label=axis_label("weight density", per_area(y, u)))
    middle = 0.5 * (levels[1:] + levels[:-1])
    contours(ax, middle[None, :] + 0 * square, middle[:, None] + 0 * square, square, top)
    if reach is not None:
        _hatch(ax, model, reach)
    return _label(ax, u)


def per_area(y: str, u: str) -> str:
    """Unit of a density over the plane; "" where a unit is unknown."""
    return f"{y}/({u})^2" if y and u and not u.isalpha() else f"{y}/{u}^2" if y and u else ""


def contours(ax: Any, x: np.ndarray, y: np.ndarray, density: np.ndarray, top: float) -> None:
    """Contours of a smoothed density at even parts of its largest value, where there are cells enough."""
    from scipy.ndimage import gaussian_filter

    known = np.isfinite(density)
    if min(density.shape) < 12:
        return
    blurred = gaussian_filter(np.where(known, density, 0.0), 1.0)
    share = gaussian_filter(known.astype(float), 1.0)
    smooth = np.ma.masked_where(~known, blurred / np.maximum(share, 1e-9))
    if smooth.max() > 0.2 * top:
        ax.contour(x, y, smooth, levels=np.linspace(0, top, 7)[1:-1], colors="0.35", linewidths=0.5)


def _hatch(ax: Any, model: Preisach, reach: np.ndarray) -> None:
    from matplotlib.patches import Rectangle

    from hystfit.models.preisach.everett import mirror

    levels = np.asarray(model.levels)
    seen = reach[mirror(model.n)[0]] if model.symmetric else reach
    for i, j in zip(*(c[seen < 1e-9] for c in cells(model.n)), strict=True):
        low, right, bottom, high = (float(levels[k]) for k in (j, j + 1, i, i + 1))
        ax.add_patch(Rectangle((low, bottom), right - low, high - bottom, fill=False, hatch="////", lw=0, ec="0.6"))


def _label(ax: Any, unit: str) -> Any:
    ax.set(
        xlabel=axis_label("switch-down threshold beta", unit),
        ylabel=axis_label("switch-up threshold alpha", unit),
        aspect="equal",
    )
    return ax


def plot_curves(
    data: Dataset | Sequence[Record], predicted: Sequence[np.ndarray] = (), ax: Any = None, every: int = 1
) -> Any:
    """Reversal curves, measured as dots and predicted as lines, colored by their order of reversal.

    Args:
        data: one record for each curve.
        predicted: output of the model on each curve, shape (T,).
        ax: matplotlib axes; new ones if None.
        every: draw every n-th curve.
    """
    import matplotlib

    ax = axes_or_new(ax)
    curves = list(Dataset.of(data))[::every]
    colors = matplotlib.colormaps["viridis"](np.linspace(0, 0.9, len(curves)))
    for r, color in zip(curves, colors, strict=True):
        ax.plot(r.u, r.y, ".", ms=2, color=color)
    for r, y, color in zip(curves, list(predicted)[::every], colors, strict=False):
        ax.plot(r.u, y, "-", lw=0.8, color=color)
    first = curves[0]
    column_label(ax, "x", first.u_name, first.u_unit, "input")
    column_label(ax, "y", first.y_name, first.y_unit, "output")
    return ax


def axes_or_new(ax: Any) -> Any:
    """The axes, or those of a new figure where None."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.subplots(layout="constrained")[1]
