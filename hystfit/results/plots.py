"""Pictures of a fit. Every function takes axes or makes them, returns them, and neither shows nor changes anything else."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hystfit.config import verb
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import HystfitError
from hystfit.params.units import axis_label
from hystfit.results.colors import DARK, FAINT, HELD_OUT, MODEL, SECOND, THIRD
from hystfit.results.estimates import ParameterEstimate, grouped
from hystfit.results.labels import substitute_missing_glyphs, use_available_fonts
from hystfit.results.record_plots import (
    Trace,
    draw_autocorrelation,
    draw_cycle_errors,
    draw_loop,
    draw_residuals,
    draw_residuals_over_input,
    draw_series,
    draw_worst,
    traces_of,
)
from hystfit.results.result import FitResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_parameters(result: FitResult, ax: Axes) -> Axes:
    """Standard errors in percent of the values, log scale; the reason where there is none."""
    from matplotlib.ticker import FormatStrFormatter, NullFormatter

    rows = grouped([p for p in result.parameters if not p.fixed])
    relative = [
        [100 * p.stderr / abs(p.value) for p in family if p.stderr is not None and p.stderr > 0 and p.value != 0]
        for _, family in rows
    ]
    everything = [value for values in relative for value in values]
    low, high = (min(everything), max(everything)) if everything else (1.0, 10.0)
    left, right = min(10 ** (np.floor(np.log10(low)) - 0.2), 10.0), max(10 ** (np.ceil(np.log10(high)) + 0.2), 200.0)
    for k, ((_, family), values) in enumerate(zip(rows, relative, strict=True)):
        if not values:
            ax.text(left * 1.1, k, _missing_error_reason(family), va="center", fontsize="small", color="#666666")
        elif len(family) == 1:
            ax.plot([left, values[0]], [k, k], color=FAINT, lw=1)
            ax.plot(values[0], k, "o", color=MODEL, ms=6)
        else:
            ax.plot(values, np.full(len(values), k), "|", color=MODEL, ms=9, alpha=0.6)
            if len(values) < len(family):
                text = f"{len(family) - len(values)} of {len(family)} have no standard error"
                ax.text(left * 1.1, k + 0.32, text, va="center", fontsize="small", color="#666666")
    ax.axvline(100.0, color=HELD_OUT, lw=1, ls="--")
    over = ax.get_xaxis_transform()
    ax.text(100.0, 1.01, "100 % of the value", transform=over, color=DARK, fontsize="small", ha="center")
    ax.set_xscale("log")
    # plain numbers: percent are read more easily than powers of ten, which are typeset as formulas, at ten times the cost
    ax.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set(xlim=(left, right), ylim=(-0.6, len(rows) - 0.4), xlabel="standard error [% of the value]")
    ax.set_yticks(
        range(len(rows)), [substitute_missing_glyphs(name if len(f) == 1 else f"{name} ({len(f)})") for name, f in rows]
    )
    use_available_fonts(ax)
    ax.invert_yaxis()
    ax.spines[["top", "right"]].set_visible(False)
    return ax


def draw_weights(result: FitResult, ax: Axes) -> Axes:
    """Weights of plays or stops over their thresholds, with standard errors where they have one."""
    found, unit = result.model.plays(), result.data.units
    if not found:
        return _empty_axes(ax, f"{result.name} has no plays")
    errors = {p.name: p.stderr for p in result.parameters}
    for plays, color in zip(found, itertools.cycle((MODEL, THIRD, SECOND))):
        spread = [errors.get(name) or 0.0 for name in plays.names]
        ax.errorbar(plays.threshold, plays.weight, yerr=spread, fmt="o-", ms=4, lw=0.8, color=color, label=plays.label)
        zero = plays.weight == 0
        ax.plot(plays.threshold[zero], plays.weight[zero], "o", ms=4, mec=color, mfc="white")
    ax.axhline(0.0, color="black", lw=0.7)
    ax.set(xlabel=axis_label("threshold (half width)", unit["u"]), ylabel=axis_label("weight", unit["y"]))
    ax.legend(frameon=False, fontsize="small", title="open: zero", title_fontsize="small")
    ax.spines[["top", "right"]].set_visible(False)
    return ax


def _empty_axes(ax: Axes, text: str) -> Axes:
    ax.set(xlabel=text, xticks=[], yticks=[])
    return ax


def draw_density(result: FitResult, ax: Axes) -> Axes:
    """Density over the Preisach plane; hatched where the fitted samples switch no cell."""
    from hystfit.results.preisach_plots import plot_density

    plane = result.model.plane()
    if plane is None:
        return _empty_axes(ax, f"{result.name} has no Preisach density")
    at = [k for k, name in enumerate(result.free_names) if re.fullmatch(r"w\[\d+\]", name)]
    reach = None
    if result.joint is not None and len(at) == plane.w.size:
        reach = np.isfinite(np.diag(result.joint)[at]).astype(float)
    return plot_density(plane, ax, reach, units=result.data.units)


def _missing_error_reason(family: Sequence[ParameterEstimate]) -> str:
    if all(p.at_bound for p in family):
        return f"at its {family[0].at_bound} bound" if len(family) == 1 else "all at a bound"
    if any(p.identifiable is False for p in family):
        return "not determined by these data"
    return "no standard error"


_OF_RECORDS: dict[str, Callable[..., Any]] = {
    "loop": draw_loop,
    "series": draw_series,
    "residuals": draw_residuals,
    "residuals-input": draw_residuals_over_input,
    "worst": draw_worst,
    "cycle-errors": draw_cycle_errors,
    "autocorrelation": draw_autocorrelation,
}
_OF_PARAMETERS: dict[str, Callable[..., Any]] = {
    "parameters": draw_parameters,
    "weights": draw_weights,
    "density": draw_density,
}
KINDS = (*_OF_RECORDS, *_OF_PARAMETERS)


@verb
def fit(
    result: FitResult,
    kind: str = "loop",
    ax: Axes | None = None,
    *,
    data: Record | Dataset | Sequence[Record] | None = None,
    refit_offset: bool = False,
) -> Axes:
    """Draw a picture of a fit.

    Args:
        result: the fit.
        kind: "loop" (output over input), "series" (output over time), "residuals" (over time), "residuals-input" (over
            the input), "worst" (output over time around the largest persistent error), "cycle-errors" (residuals of the first, last and
            worst cycle over the input), "autocorrelation" (of the residuals), "parameters" (their relative standard errors), "weights"
            (of plays or stops over their thresholds) or "density" (over the Preisach plane).
        ax: axes to draw on; new ones where None.
        data: other records than those fitted, such as test data.
        refit_offset: shift the prediction of each of those to its mean.

    Raises:
        HystfitError: no such kind.
        PrecisionError: double precision is off.
    """
    if kind not in KINDS:
        raise HystfitError(f"no picture {kind!r}; there are {', '.join(KINDS)}")
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.subplots(layout="constrained")[1]
    assert ax is not None
    return draw(result, kind, ax, [] if kind in _OF_PARAMETERS else traces_of(result, data, refit_offset))


def draw(result: FitResult, kind: str, ax: Axes, traces: list[Trace]) -> Axes:
    """One of the `KINDS` of pictures; those of records show the traces, which several pictures share."""
    if kind in _OF_PARAMETERS:
        return _OF_PARAMETERS[kind](result, ax)
    _OF_RECORDS[kind](traces, ax)
    ax.spines[["top", "right"]].set_visible(False)
    use_available_fonts(ax)
    return ax
