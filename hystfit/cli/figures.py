"""Figures on the pages of verbs that no result draws by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hystfit.params.units import axis_label
from hystfit.results.colors import MEASURED, MODEL, SECOND, THIRD
from hystfit.results.labels import column_label
from hystfit.results.plots import fit as draw

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hystfit.control.bands import InverseBands
    from hystfit.control.inverse import Inverse
    from hystfit.data.record import Record
    from hystfit.fitting.comparison.compared_models import Comparison
    from hystfit.results.result import FitResult
    from hystfit.uncertainty.input_design import Design


def sheet(width: float = 5.6, height: float = 4.0) -> Figure:
    """An empty figure, its size in inches, outside the global state of matplotlib."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def fit_figure(result: FitResult, kind: str) -> Figure:
    """A picture of a fit, see `hystfit.plots.fit`."""
    figure = sheet()
    draw(result, kind, figure.subplots())
    return figure


def ranking_figure(comparison: Comparison) -> Figure:
    """Errors of all models that have one, the best at the top."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    rows = [row for row in comparison.rows if row.score_percent is not None]
    figure = sheet(5.6, 1.4 + 0.32 * len(rows))
    ax = figure.subplots()
    for k, row in enumerate(rows):
        ax.plot(row.score_percent, k, "o", color=MODEL, label="cross-validation" if k == 0 else None)
        if row.in_sample_percent is not None:
            ax.plot(row.in_sample_percent, k, "o", mfc="none", color=SECOND, label="fitted samples" if k == 0 else None)
    ax.set_yticks(range(len(rows)), [row.name for row in rows], fontsize=8)
    ax.set(xscale="log", xlabel="error [% of the range]")
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.grid(axis="x", color="0.9", which="both")
    _finish_rows(figure, ax)
    return figure


def _finish_rows(figure: Figure, ax: Axes) -> None:
    """The first row at the top, and the legend above the axes."""
    ax.invert_yaxis()
    figure.legend(fontsize=8, frameon=False, ncols=2, loc="outside upper center")


def input_figure(proposal: Design) -> Figure:
    """The proposed input over time."""
    record, u = proposal.result.data[0], proposal.best.u
    figure = sheet()
    ax = figure.subplots()
    ax.plot(np.arange(u.size) * (proposal.dt or 1.0), u, color=MODEL, lw=0.9)
    column_label(ax, "y", record.u_name, record.u_unit, "input")
    ax.set_xlabel("sample" if proposal.dt is None else axis_label("time", record.t_unit))
    return figure


def gain_figure(proposal: Design) -> Figure:
    """Standard errors with each candidate relative to those of the present data."""
    present = lambda members: proposal.median(proposal.present, members)
    families = {name: members for name, members in proposal.families(proposal.aim).items() if present(members)}
    figure = sheet(5.6, 1.6 + 0.3 * len(families))
    ax = figure.subplots()
    styles = zip("os^D", (MODEL, SECOND, THIRD, "#4d4d4d"), strict=True)
    for candidate, (marker, color) in zip(proposal.candidates, styles, strict=False):
        ratios = [(proposal.median(candidate.stderr, m) or np.nan) / (present(m) or np.nan) for m in families.values()]
        ax.plot(ratios, range(len(families)), marker, color=color, ls="none", label=candidate.name)
    ax.axvline(1.0, color="black", lw=0.7)
    ax.set_yticks(range(len(families)), list(families))
    ax.set(xlabel="predicted / present standard error")
    _finish_rows(figure, ax)
    return figure


def inverse_figure(target: Record, inverse: Inverse, bands: InverseBands | None, unit: str) -> Figure:
    """Reference and output, input [unit], and tracking error over time, with bands of posterior draws where there are some."""
    figure = sheet(8.4, 6.4)
    axis = np.arange(len(target)) if target.t is None else target.t
    above, middle, below = figure.subplots(3, 1, sharex=True, height_ratios=(2, 2, 1))
    above.plot(axis, target.y, color=MEASURED, lw=2.6, label="reference")
    above.plot(axis, inverse.y, color=MODEL, lw=0.9, label="output of the model")
    missed = inverse.codes != 0
    above.plot(axis[missed], inverse.y[missed], ".", ms=4, color=SECOND, label="not reached" if missed.any() else None)
    middle.plot(axis, inverse.u, color=MODEL, lw=0.9)
    below.plot(axis, inverse.y - target.y, color=MODEL, lw=0.9)
    if bands is not None:
        for ax, of in ((middle, "u"), (below, "error")):
            low, _, high = bands.band(of)
            ax.fill_between(axis, low, high, color="#e69f00", alpha=0.5, lw=0, label="90 % of the draws")
            ax.legend(frameon=False, fontsize=8)
    column_label(above, "y", target.y_name, target.y_unit, "output")
    middle.set_ylabel(axis_label("input", unit))
    below.set_ylabel(axis_label("error", target.y_unit))
    below.set_xlabel("sample" if target.t is None else axis_label("time", target.t_unit))
    above.legend(frameon=False, fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure
