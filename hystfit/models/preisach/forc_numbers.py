"""What is read off a FORC diagram: peak, distributions, profiles, the central ridge, each number with its standard error."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from hystfit.errors import DataError
from hystfit.models.preisach.forc_diagram import ForcDiagram
from hystfit.models.shared.slopes import POINTS

NUMBERS = {
    "peak_coercivity": ("coercivity of the peak", "u"),
    "peak_interaction": ("interaction of the peak", "u"),
    "median_coercivity": ("median coercivity", "u"),
    "coercivity_width": ("width of the coercivity distribution at half height", "u"),
    "interaction_width": ("width of the interaction profile through the peak at half height", "u"),
    "central_ridge": ("integral of the central ridge", "y"),
    "total": ("integral of the density", "y"),
    "negative_percent": ("negative part", "%"),
}
"""Label of each number, and the unit that it has: of the input, of the output, or per cent."""

# Of the maximum: the part of the density whose center is the peak, so that it does not jump from cell to cell.
_TOP = 0.9
_PARTS = 8  # of a cell along each axis, at most, over which its mass is spread
# Integral above the sides at twice the distance of the sides: simulated ridges without interaction have 1.00 to 1.01 times as much, with
# interactions of a fifth of the resolution 1.01 to 1.13, of the resolution 3 to 5, of twice it 7 to 8.
_NARROW = 1.5


@dataclasses.dataclass(frozen=True)
class Profile:
    """A curve read off a diagram over coordinates x [u], shape (B,), NaN where there are no data; None as stderr where unknown."""

    x: np.ndarray
    values: np.ndarray
    stderr: np.ndarray | None = None

    def width(self) -> float | None:
        """Full width at half height [u]; None where the curve does not fall to that on both sides."""
        known = np.isfinite(self.values)
        found = _half_height(self.x[known], self.values[known])
        return None if None in found else found[1] - found[0]  # type: ignore[operator]


@dataclasses.dataclass(frozen=True)
class ForcNumbers:
    """Key numbers of a FORC diagram.

    Attributes:
        values: by name, see `NUMBERS`; None where the diagram does not show one. `negative_percent` is the share of the absolute mass
            that is negative: noise, or interactions that a Preisach model does not have.
        stderr: their standard errors from the noise of the curves, by name; without those that are unknown.
        profiles: "coercivity", the density integrated over the interaction [y/u]; "peak coercivity" and "peak interaction", the density
            along either axis through the peak [y/u^2]; "central ridge", what the density has at the interaction of the peak above the
            line between both sides, integrated over the interaction [y/u] (Egli and others 2010).
    """

    values: dict[str, float | None]
    stderr: dict[str, float]
    profiles: dict[str, Profile]

    def numbers(self, units: Mapping[str, str]) -> dict[str, tuple[str, float | None, float | None, str]]:
        """Label, value, standard error and unit of each number, by name."""
        unit = {**units, "%": "%"}
        return {
            name: (NUMBERS[name][0], value, self.stderr.get(name), unit[NUMBERS[name][1]])
            for name, value in self.values.items()
        }


def forc_numbers(diagram: ForcDiagram) -> ForcNumbers:
    """Numbers and profiles of a diagram, with standard errors where it has repeats."""
    if not (diagram.mass > 0).any():
        raise DataError("the FORC density is nowhere positive: use more curves, or a smaller smoothing factor")
    peak, edges = _peak(diagram), _edges(diagram)
    values, profiles = _read(diagram, peak, edges)
    repeats = [_read(one, peak, edges) for one in diagram.again()]
    if not repeats:
        return ForcNumbers(values, {}, profiles)
    moved = [_peak(one) for one in diagram.again()]
    stderr = {}
    for name, value in values.items():
        drawn = [found[name] for found, _ in repeats if found[name] is not None]
        if value is not None and len(drawn) > len(repeats) // 2:
            stderr[name] = float(np.std(drawn, ddof=1))  # type: ignore[arg-type]
    within = _within_cells(diagram)
    scatter = [float(np.hypot(np.std([at[k] for at in moved], ddof=1), within)) for k in (0, 1)]
    stderr |= dict(zip(list(values)[:2], scatter, strict=True))
    scattered = {
        name: dataclasses.replace(one, stderr=np.std([found[name].values for found in drawn], axis=0, ddof=1))
        for name, one in profiles.items()
        if len(drawn := [found for _, found in repeats if name in found]) > len(repeats) // 2
    }
    return ForcNumbers(values, stderr, scattered)


def _peak(diagram: ForcDiagram) -> tuple[float, float]:
    """Coercivity and interaction of the peak [u]: the center of the density above nine tenths of its maximum."""
    density = np.nan_to_num(diagram.density)
    top = np.maximum(density - _TOP * density.max(), 0.0)
    return tuple(float(np.sum(top * axis) / top.sum()) for axis in (diagram.coercivity, diagram.interaction))  # type: ignore[return-value]


def _within_cells(diagram: ForcDiagram) -> float:
    """Standard error of the peak of a fitted density, which says nothing of where in its cells it lies [u]; 0 of local fits."""
    if diagram.resolution:
        return 0.0
    density = np.nan_to_num(diagram.density)
    top = density > _TOP * density.max()
    sides = np.meshgrid(*_sizes(diagram), indexing="ij")
    return float(0.5 * np.sqrt(np.mean((sides[0] ** 2 + sides[1] ** 2)[top]) / 12 / top.sum()))


def _sizes(diagram: ForcDiagram) -> tuple[np.ndarray, np.ndarray]:
    """Lengths of the cells along reversals and fields [u], shapes (R,) and (F,)."""
    return np.abs(np.gradient(diagram.reversal)), np.abs(np.gradient(diagram.field))


def _edges(diagram: ForcDiagram) -> np.ndarray:
    """Edges of bins of the coercivity [u], as fine as the cells where the density lies."""
    sizes, weight = _sizes(diagram)[0], np.abs(diagram.mass).sum(1)
    order = np.argsort(sizes)
    half = int(np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum()))
    step = float(sizes[order[min(half, order.size - 1)]])
    return np.arange(0.0, diagram.coercivity.max() + step, step)


def _binned(diagram: ForcDiagram, edges: np.ndarray) -> np.ndarray:
    """Mass in bins of the coercivity: that of a cell longer than a bin is spread over it, else it would leave bins empty."""
    sizes = _sizes(diagram)
    parts = [int(np.clip(np.round(one.max() / edges[1]), 1, _PARTS)) for one in sizes]
    reversals, fields = (
        [axis + ((k + 0.5) / n - 0.5) * one for k in range(n)]
        for axis, one, n in zip((diagram.reversal, diagram.field), sizes, parts, strict=True)
    )
    at = (0.5 * np.abs(field[None, :] - reversal[:, None]) for reversal in reversals for field in fields)
    return np.sum([np.histogram(x, bins=edges, weights=diagram.mass)[0] for x in at], axis=0) / np.prod(parts)


def _read(
    diagram: ForcDiagram, peak: tuple[float, float], edges: np.ndarray
) -> tuple[dict[str, float | None], dict[str, Profile]]:
    """Numbers and profiles of one diagram, along axes through a peak, and over bins of the coercivity."""
    x, y, mass = diagram.coercivity, diagram.interaction, diagram.mass
    h, m = peak
    sums, step = _binned(diagram, edges), float(edges[1])
    whole = np.cumsum(np.maximum(sums, 0.0))
    coercivity = Profile(0.5 * (edges[1:] + edges[:-1]), sums / step)
    along, across = np.linspace(0.0, x.max(), POINTS), np.linspace(y.min(), y.max(), POINTS)
    vertical = Profile(across, diagram.at(np.full(POINTS, h), across))
    ridge = _central_ridge(diagram, coercivity.x, m) if diagram.resolution else None
    values = {
        "peak_coercivity": h,
        "peak_interaction": m,
        "median_coercivity": float(np.interp(0.5 * whole[-1], whole, edges[1:])) if whole[-1] > 0 else None,
        "coercivity_width": coercivity.width(),
        "interaction_width": vertical.width(),
        "central_ridge": float(np.nansum(ridge.values) * step) if ridge else None,
        "total": float(mass.sum()),
        "negative_percent": 100 * float(abs(mass[mass < 0].sum()) / np.abs(mass).sum()),
    }
    return values, {
        "coercivity": coercivity,
        "peak coercivity": Profile(along, diagram.at(along, np.full(POINTS, m))),
        "peak interaction": vertical,
        **({"central ridge": ridge} if ridge else {}),
    }


def _central_ridge(diagram: ForcDiagram, coercivity: np.ndarray, interaction: float) -> Profile | None:
    """The central ridge over coercivities, shape (B,); None where the diagram has none that is narrower than its resolution.

    Interactions between grains spread the density over widths that the curves resolve; grains without interaction have none, and their
    density lies within the resolution of the diagram.
    """
    once, twice = (_above_sides(diagram, coercivity, interaction, k * diagram.resolution) for k in (1, 2))
    narrow = 0 < np.nansum(once) and np.nansum(twice) < _NARROW * np.nansum(once)
    return Profile(coercivity, once) if narrow else None


def _above_sides(diagram: ForcDiagram, coercivity: np.ndarray, interaction: float, width: float) -> np.ndarray:
    """The density within a width of an interaction above the mean of both sides, integrated over the interaction [y/u], shape (B,).

    The factor 2 is the area of the plane of reversal and field for a unit of coercivity times a unit of interaction.
    """
    offsets = np.linspace(-1.5 * width, 1.5 * width, 91)
    h, m = np.meshgrid(coercivity, interaction + offsets, indexing="ij")
    density = diagram.at(h, m)
    inside = np.abs(offsets) <= width
    sides = density[:, ~inside].mean(axis=1)
    return 2 * np.trapezoid(density[:, inside] - sides[:, None], offsets[inside], axis=1)


def _half_height(x: np.ndarray, y: np.ndarray) -> tuple[float | None, float | None]:
    """Where a curve has fallen to half its largest value on either side of it; None where it does not."""
    if not y.size:
        return None, None
    top = int(np.argmax(y))
    below = np.flatnonzero(y < 0.5 * y[top])
    left, right = below[below < top], below[below > top]
    cross = lambda a, b: float(np.interp(0.5 * y[top], *zip(*sorted([(y[a], x[a]), (y[b], x[b])]), strict=True)))
    low = cross(left[-1], left[-1] + 1) if left.size else None
    return low, cross(right[0], right[0] - 1) if right.size else None
