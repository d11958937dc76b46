"""Pictures of a population: devices beside it, correlations, and what all devices say about each."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import ndtri

from hystfit.errors import ParameterError
from hystfit.params.units import axis_label
from hystfit.population.population_fit import PopulationFit
from hystfit.results.colors import HELD_OUT, MODEL
from hystfit.results.estimates import INTERVAL
from hystfit.results.labels import use_available_fonts

_ACROSS = 4  # panels in a row
_NAMED = 40  # devices up to which each one is named
_REACH = ndtri(0.95)  # standard deviations of an interval of 90 %


def draw(population: PopulationFit, kind: str) -> Any:
    """Draw a picture of one kind and return its figure."""
    kinds = {"forest": _forest, "correlation": _correlation, "shrinkage": _shrinkage}
    if kind not in kinds:
        raise ParameterError(f"no picture {kind!r} of a population; there are {', '.join(kinds)}")
    figure = kinds[kind](population)
    use_available_fonts(figure)
    return figure


def _panels(count: int, height: float) -> tuple[Any, np.ndarray]:
    import matplotlib.pyplot as plt

    rows, across = -(-count // _ACROSS), min(count, _ACROSS)
    figure, axes = plt.subplots(
        rows, across, figsize=(3.2 * across, height * rows), squeeze=False, layout="constrained"
    )
    for ax in axes.flat[count:]:
        ax.set_visible(False)
    return figure, axes.flat[:count]


def _forest(population: PopulationFit) -> Any:
    """Values of each device with intervals of 90 %, over the range of nine in ten devices of the population."""
    count = len(population.devices)
    figure, axes = _panels(len(population.names), max(2.4, 0.17 * min(count, _NAMED) + 1))
    mean, sd = population.shrunken
    further = population.next_devices(4000)
    place = np.arange(count)
    outlying = [device.name in population.outlying for device in population.devices]
    colors = np.where(outlying, HELD_OUT, MODEL)
    for k, ax in enumerate(axes):
        ax.axvspan(*np.quantile(further[:, k], [0.05, 0.95]), color="0.9", lw=0)
        ax.axvline(np.median(population.means[:, k]), color="0.4", lw=1)
        ax.hlines(place, mean[:, k] - _REACH * sd[:, k], mean[:, k] + _REACH * sd[:, k], colors=colors, lw=1.2)
        ax.scatter(mean[:, k], place, c=colors, s=12, zorder=3)
        ax.set_xlabel(axis_label(population.names[k], population.units[k]))
        ax.invert_yaxis()
        ax.locator_params(axis="x", nbins=4)
        if count <= _NAMED and k % _ACROSS == 0:
            ax.set_yticks(place, [_short(device.name) for device in population.devices], fontsize=7)
        else:
            ax.set_yticks([])
    where = f" at the mean {' and '.join(population.covariates)}" if population.covariates else ""
    figure.suptitle(f"Devices (90 %), mean, and the range of nine in ten devices{where}", fontsize=10)
    return figure


def _short(name: str) -> str:
    """The last part of a path, without its ending."""
    return name.rpartition("/")[2].rpartition(".")[0] or name


def _correlation(population: PopulationFit) -> Any:
    """Correlations in the lower half, their intervals in the upper one; gray where the interval holds zero."""
    import matplotlib.pyplot as plt

    p, names = len(population.names), population.names
    low, middle, high = np.quantile(population.correlations, INTERVAL, axis=0)
    figure, ax = plt.subplots(figsize=(1.6 + 0.75 * p, 1.2 + 0.7 * p), layout="constrained")
    shown = np.where(np.tri(p, k=-1) > 0, middle, np.nan)
    image = ax.imshow(shown, cmap="RdBu_r", vmin=-1, vmax=1)
    for a in range(p):
        for b in range(a):
            sure = low[a, b] > 0 or high[a, b] < 0
            color = "white" if abs(middle[a, b]) > 0.6 else "black" if sure else "0.6"
            ax.text(b, a, f"{middle[a, b]:.2f}", ha="center", va="center", fontsize=8, color=color)
            ax.text(a, b, f"{low[a, b]:.2f} to\n{high[a, b]:.2f}", ha="center", va="center", fontsize=6, color="0.4")
    ax.set_xticks(range(p), names, rotation=45, ha="right")
    ax.set_yticks(range(p), names)
    figure.colorbar(image, ax=ax, label="correlation", shrink=0.8)
    return figure


def _shrinkage(population: PopulationFit) -> Any:
    """Fitted against better values: a device with a poor record moves toward the others."""
    figure, axes = _panels(len(population.names), 3.0)
    mean, sd = population.shrunken
    for k, ax in enumerate(axes):
        fitted = population.fitted[:, k]
        ax.axline((fitted.mean(), fitted.mean()), slope=1, color="0.7", lw=1)
        ax.axhline(np.median(population.means[:, k]), color="0.4", lw=1, ls=":")
        ax.errorbar(fitted, mean[:, k], _REACH * sd[:, k], fmt="o", ms=4, lw=1, color=MODEL)
        ax.set_xlabel(f"fit of {axis_label(population.names[k], population.units[k])}")
        ax.set_ylabel("given all devices")
    return figure
