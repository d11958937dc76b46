"""Pictures of Preisach models, reversal curves and FORC diagrams, as the field draws them; each function takes axes and returns them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.models.preisach.everett import cells
from hystfit.models.preisach.forc_diagram import ForcDiagram
from hystfit.models.preisach.forc_numbers import ForcNumbers, forc_numbers
from hystfit.models.preisach.model import Preisach
from hystfit.params.units import axis_label
from hystfit.results.colors import MODEL, SECOND
from hystfit.results.labels import column_label


def plot_density(
    model: Preisach, ax: Any = None, reach: np.ndarray | None = None, *, units: Mapping[str, str] | None = None
) -> Any:
    """Weight density of every cell over the Preisach plane, beta to the right and alpha upward; hatched where the data do not `reach`."""
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
    """Reversal curves, every n-th, measured as dots and predicted, shape (T,) each, as lines, colored by their order of reversal."""
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


_SHARE = 0.99  # of the points above it that the picture holds: isolated ones at the edge are noise


def plot_forc_diagram(diagram: ForcDiagram, ax: Any = None, *, units: Mapping[str, str] | None = None) -> Any:
    """The FORC distribution over coercivity and interaction field, red positive and blue negative; dashed: three standard errors."""
    ax = axes_or_new(ax)
    u, unit = ((units or {}).get(symbol, "") for symbol in ("u", "y"))
    top = np.nanpercentile(np.abs(diagram.density), 99.95) or 1.0
    far, half = _extent(diagram, top)
    h, m = np.linspace(0, far, 241), np.linspace(-half, half, 241)
    x, y = np.meshgrid(h, m)
    density = diagram.at(x, y)
    mesh = ax.pcolormesh(h, m, density, cmap="RdBu_r", vmin=-top, vmax=top, shading="nearest", rasterized=True)
    ax.figure.colorbar(mesh, ax=ax, label=axis_label("FORC distribution", per_area(unit, u)))
    contours(ax, x, y, density, top)
    if diagram.stderr is not None:
        ratio = dataclasses.replace(diagram, density=diagram.density / diagram.stderr).at(x, y)
        ax.contour(x, y, np.ma.masked_invalid(ratio), levels=[3.0], colors="0.2", linewidths=0.6, linestyles="--")
    ax.axhline(0, color="0.5", lw=0.6)
    ax.set(xlabel=axis_label("coercivity (H - Hr) / 2", u), ylabel=axis_label("interaction (H + Hr) / 2", u))
    return ax


def _extent(diagram: ForcDiagram, top: float) -> tuple[float, float]:
    """Largest coercivity and interaction of the picture [u]."""
    shown = np.abs(np.nan_to_num(diagram.density)) > 0.05 * top
    x, y = (axis[shown] if shown.any() else axis.ravel() for axis in (diagram.coercivity, np.abs(diagram.interaction)))
    return 1.2 * float(np.quantile(x, _SHARE)), 1.2 * float(np.quantile(y, _SHARE))


def plot_profiles(
    numbers: ForcNumbers, axes: Sequence[Any], *, units: Mapping[str, str] | None = None
) -> Sequence[Any]:
    """The coercivity distribution with its median and the central ridge, and the profiles along both axes, with two standard errors."""
    u, y = ((units or {}).get(symbol, "") for symbol in ("u", "y"))
    heads = {
        "coercivity": ("coercivity", "integral", _per_unit(y, u)),
        "peak coercivity": ("coercivity, at the interaction of the peak", "distribution", per_area(y, u)),
        "peak interaction": ("interaction, at the coercivity of the peak", "distribution", per_area(y, u)),
    }
    for ax, (name, (x_label, y_label, unit)) in zip(axes, heads.items(), strict=True):
        _draw(ax, numbers, name, MODEL)
        ax.axhline(0.0, color="black", lw=0.7)
        ax.set(xlabel=axis_label(x_label, u), ylabel=axis_label(y_label, unit))
    if "central ridge" in numbers.profiles:
        _draw(axes[0], numbers, "central ridge", SECOND)
    if (median := numbers.values["median_coercivity"]) is not None:
        axes[0].axvline(median, color="0.4", lw=0.9, ls="--", label="median")
        axes[0].legend(frameon=False)
    return axes


def plot_compared(
    diagrams: Mapping[str, ForcDiagram], figure: Any, *, units: Mapping[str, str] | None = None
) -> tuple[list[Any], Any]:
    """At most two diagrams by how they were found, over their coercivity distributions with two standard errors: the axes of both."""
    u, y = ((units or {}).get(symbol, "") for symbol in ("u", "y"))
    grid = figure.add_gridspec(2, len(diagrams))
    panels, below = [figure.add_subplot(grid[0, k]) for k in range(len(diagrams))], figure.add_subplot(grid[1, :])
    for ax, (name, diagram), color in zip(panels, diagrams.items(), (SECOND, MODEL), strict=False):
        plot_forc_diagram(diagram, ax, units=units)
        ax.set_title(name)
        _draw(below, forc_numbers(diagram), "coercivity", color, name)
    for ax in panels[1:]:  # one frame, so that the pictures can be laid over each other
        ax.set(xlim=panels[0].get_xlim(), ylim=panels[0].get_ylim())
    below.axhline(0.0, color="black", lw=0.7)
    below.set(
        xlabel=axis_label("coercivity", u), ylabel=axis_label("integral", _per_unit(y, u)), xlim=panels[0].get_xlim()
    )
    below.legend(frameon=False)
    return panels, below


def _draw(ax: Any, numbers: ForcNumbers, name: str, color: str, label: str = "") -> None:
    one = numbers.profiles[name]
    known = np.isfinite(one.values)
    x, values = one.x[known], one.values[known]
    ax.plot(x, values, color=color, lw=1.2, label=label or name)
    if one.stderr is not None:
        band = 2 * one.stderr[known]
        ax.fill_between(x, values - band, values + band, color=color, alpha=0.25, lw=0)


def _per_unit(y: str, u: str) -> str:
    """Unit of a density over an axis; "" where a unit is unknown."""
    return "" if not (y and u) else f"{y}/{u}" if u.isalpha() else f"{y}/({u})"
