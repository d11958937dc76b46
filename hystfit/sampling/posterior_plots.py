"""Pictures of a posterior: corner, trace, rank, and bands over the loop."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.stats import rankdata

from hystfit.errors import ParameterError, optional
from hystfit.outcome.table import rounded
from hystfit.params.units import axis_label
from hystfit.results.colors import HELD_OUT, MODEL, THIRD
from hystfit.results.labels import column_label, use_available_fonts
from hystfit.results.webpage import POINTS
from hystfit.sampling.posterior import Posterior

_SHOWN = 8  # chains in one picture at most
_LEGIBLE = 12  # parameters in a corner plot: its panels grow with their square
_MOST = 24  # parameters in a trace or rank plot, which is as high as they are many
_FEW = 3  # parameters up to which a corner plot has no room at its upper right
_TICKS = 1.0  # room for the tick labels of a corner plot, and between them and those of the axes [inches]
_PAD = 0.12  # between the tick labels of a corner plot and the labels of its axes, in panels
_CHARACTER = 0.62  # width of a character, in font sizes
_BINS = 20
_CHAINS = (MODEL, HELD_OUT, THIRD, "#cc79a7")
_KINDS = ("corner", "trace", "rank", "bands")


def draw(posterior: Posterior, kind: str, **options: Any) -> Any:
    """Draw a picture of one kind and return its figure."""
    if kind not in _KINDS:
        raise ParameterError(f"no picture {kind!r} of a posterior; there are {', '.join(_KINDS)}")
    figure = {"corner": _corner, "trace": _trace, "rank": _rank, "bands": _bands}[kind](posterior, **options)
    use_available_fonts(figure)
    return figure


def _labels(posterior: Posterior) -> list[str]:
    """Names of the parameters, with their units in a second line."""
    named = zip(posterior.names, posterior.units, strict=True)
    return [f"{name}\n{axis_label('', unit).strip()}".rstrip() for name, unit in named]


def _corner(posterior: Posterior) -> Any:
    corner = optional("corner", "bayes", "a corner plot")
    flat = posterior.draws.reshape(-1, len(posterior.names))
    at = _of_corner(posterior, flat)
    labels, size = _labels(posterior), 8 + 0.8 * len(at)  # the figure grows with the panels, and is shown at one width
    figure = corner.corner(
        flat[:, at],
        labels=[labels[k] for k in at],
        quantiles=[0.025, 0.5, 0.975],
        levels=(0.5, 0.9),
        range=[0.998] * len(at),
        bins=25,
        smooth=1.0,
        max_n_ticks=3,
        label_kwargs={"fontsize": size},
        labelpad=_PAD,
    )
    panels = np.array(figure.axes).reshape(len(at), len(at))
    for ax, k in zip(np.diag(panels), at, strict=True):
        value = " +- ".join(rounded(float(np.median(flat[:, k])), float(np.std(flat[:, k]))))
        wide = ax.get_position().width * figure.get_figwidth() * POINTS
        ax.set_title(f"{posterior.names[k]}\n{value}", fontsize=min(size, wide / (_CHARACTER * len(value))))
    for ax in panels.ravel():
        ax.tick_params(labelsize=0.8 * size)
        for density in ax.collections:  # hundreds of cells a panel, each a path of its own as vector graphics
            density.set_rasterized(density.get_array() is not None)
    words = ["median +- standard deviation", "dashed: median and 95 % interval", "contours: 50 and 90 %"]
    words = [f"{len(at)} of {len(labels)} parameters", *words] if len(at) < len(labels) else words
    beside = len(at) > _FEW  # the explanation stands beside the first title, where there is room, else above it
    figure.suptitle(("; " if beside else "\n").join(words), fontsize=size, x=0.98, ha="right")
    _widen_margins(figure, size, above=2 if beside else 3 + len(words))
    return figure


def _widen_margins(figure: Any, size: float, above: int) -> None:
    """Make room in a corner plot for labels of two lines of this size [points], and for as many lines `above` as given."""
    line, (wide, high) = 1.3 * size / POINTS, figure.get_size_inches()
    side = _TICKS + 2 * line
    figure.subplots_adjust(left=side / wide, bottom=side / high, top=1 - (0.1 + above * line) / high)


def _of_corner(posterior: Posterior, flat: np.ndarray) -> list[int]:
    """Parameters of the corner plot: those whose draws differ, weights last, as many as are legible and as there are draws."""
    weights = np.zeros(len(posterior.names), bool)
    own = posterior.result.problem.space.weights
    weights[: own.size] = own
    moving = [k for k in np.argsort(weights, kind="stable").tolist() if np.ptp(flat[:, k]) > 0]
    return sorted(moving[: min(_LEGIBLE, len(flat) - 1)])


def _by_chain(posterior: Posterior, draw: Callable[[Any, np.ndarray], None], title: str, axis: str) -> Any:
    """A panel for each parameter, those of the corner plot where all would be hundreds; `draw` is given axes, and draws by chain."""
    import matplotlib.pyplot as plt

    every, count = list(range(len(posterior.names))), len(posterior.draws)
    shown = every if len(every) <= _MOST else _of_corner(posterior, posterior.draws.reshape(-1, len(every)))
    size = (5.6, 0.9 + len(shown))
    figure, axes = plt.subplots(len(shown), 1, figsize=size, layout="constrained", squeeze=False, sharex=True)
    for ax, k, label in zip(axes[:, 0], shown, np.array(_labels(posterior))[shown], strict=True):
        draw(ax, posterior.draws[:, :, k])
        ax.set_ylabel(label, fontsize=8)
    chains = f"{count} {'walkers' if posterior.sampler == 'emcee' else 'chains'}"
    axes[0, 0].set_title(title.format(chains if count <= _SHOWN else f"the first {_SHOWN} of {chains}"), fontsize=9)
    axes[-1, 0].set_xlabel(axis)
    return figure


def _trace(posterior: Posterior) -> Any:
    def draw(ax: Any, draws: np.ndarray) -> None:
        for chain, color in zip(draws[:_SHOWN], itertools.cycle(_CHAINS)):
            ax.plot(chain, lw=0.4, color=color)

    return _by_chain(posterior, draw, "{}", "draw")


def _rank(posterior: Posterior) -> Any:
    def draw(ax: Any, draws: np.ndarray) -> None:
        for chain, color in zip(rankdata(draws).reshape(draws.shape)[:_SHOWN], itertools.cycle(_CHAINS)):
            ax.hist(chain, bins=_BINS, range=(0, draws.size), histtype="step", color=color)
        ax.axhline(draws.shape[1] / _BINS, color="#a6a6a6", lw=0.8)

    return _by_chain(posterior, draw, "draws by rank, {}; line: expected for converged chains", "rank over all chains")


def _bands(posterior: Posterior, level: float = 0.9, count: int = 200) -> Any:
    """The loop, and beside it the deviations from the median of the draws over time, which are too small to be seen in the loop."""
    import matplotlib.pyplot as plt

    record = posterior.result.data[0]
    on = record.used
    low, _, high = posterior.bands(record, level, count)
    inner = posterior.bands(record, level, count, kind="credible")
    middle = inner[1]
    figure, (loop, rest) = plt.subplots(1, 2, figsize=(10.6, 4.0), layout="constrained")
    axis = np.arange(len(record)) if record.t is None else record.t
    loop.plot(record.u[on], record.y[on], ".", ms=2, color="#a6a6a6", label="measured", rasterized=True)
    loop.plot(record.u[on], middle[on], color="#0072b2", lw=0.8, label="median of the draws")
    for edges, color in (((low, high), "#e69f00"), ((inner[0], inner[2]), "#0072b2")):
        lower, upper = (np.where(on, edge - middle, np.nan) for edge in edges)
        rest.fill_between(axis, lower, upper, color=color, alpha=0.45, lw=0)
    rest.plot(axis[on], (record.y - middle)[on], ".", ms=1.5, color="#4d4d4d", rasterized=True)
    column_label(loop, "y", record.y_name, record.y_unit, "output")
    column_label(loop, "x", record.u_name, record.u_unit, "input")
    rest.set_xlabel("sample" if record.t is None else axis_label("time", record.t_unit))
    rest.margins(x=0.01)
    rest.set_ylabel(axis_label("deviation from the median", record.y_unit))
    if len(posterior.result.data) > 1:
        loop.set_title(f"{record.name}, the first of {len(posterior.result.data)} records", fontsize=9)
    rest.set_title(f"{100 * level:.0f} % bands: of the model output (blue), of a measurement (orange)", fontsize=9)
    loop.legend(frameon=False, markerscale=4)
    return figure
