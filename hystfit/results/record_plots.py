"""Pictures of the records of a fit: loops, output and residuals over time and input, autocorrelation."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.inference.autocorrelation import autocorrelation
from hystfit.params.relative_size import REACH
from hystfit.params.units import axis_label
from hystfit.quality.loops import cycles
from hystfit.results.accuracy import persistent_error
from hystfit.results.colors import DARK, FAINT, HELD_OUT, MEASURED, MODEL, SECOND, THIRD
from hystfit.results.labels import column_label, substitute_missing_glyphs
from hystfit.results.result import FitResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CYCLES = {"first": MODEL, "last": THIRD, "largest error": SECOND}  # of many, those that a picture shows
_POINTS, _LOOP_POINTS, _RASTER = 4000, 40_000, 6000
_MANY_CYCLES = 4  # above which the loop shows some of them
_TURN = 0.3  # of the input's range: stroke of a cycle


class Trace:
    """One record as drawn: measured and predicted output, and which samples were fitted."""

    def __init__(self, record: Record, predicted: np.ndarray, fitted: bool, start: float):
        self.u, self.y, self.predicted = record.u, record.y, predicted
        self.seen = record.used & fitted
        self.held = np.isfinite(record.y) & ~record.used if fitted else record.used
        if (
            self.seen[1:2].any() and not self.seen[0]
        ):  # one sample alone, such as a calibration point, belongs to no curve
            self.held[0] = False
        self.axis = (np.arange(len(record)) if record.t is None else record.t - record.t[0] * (start > 0)) + start
        self.residual = record.y - predicted
        shown = np.flatnonzero(self.seen | self.held)
        at = np.arange(len(record))  # the model is not drawn over samples that only set its state
        self.model = np.where((at >= shown[0]) & (at <= shown[-1]), predicted, np.nan) if shown.size else predicted
        self.columns = {  # name, unit and role
            "u": (record.u_name, record.u_unit, "input"),
            "y": (record.y_name, record.y_unit, "output"),
        }
        self.residual_label = substitute_missing_glyphs(axis_label("measured - model", record.y_unit))
        self.axis_label = "sample" if record.t is None else substitute_missing_glyphs(f"time [{record.t_unit}]")

    def outputs(self, mask: np.ndarray) -> np.ndarray:
        """Measured outputs of some samples, NaN for the others."""
        return np.where(mask, self.y, np.nan)

    def residuals(self, mask: np.ndarray) -> np.ndarray:
        """Residuals of some samples, NaN for the others."""
        return np.where(mask, self.residual, np.nan)


def traces_of(result: FitResult, data: Any, refit_offset: bool) -> list[Trace]:
    """Records one after another along one axis."""
    records = list(result.data if data is None else Dataset.of(data).map(result.in_fitted_units))
    traces, start = [], 0.0
    for record in records:
        predicted = result.predict(record, refit_offset=refit_offset and data is not None)
        trace = Trace(record, predicted, data is None, start)
        traces.append(trace)
        start = float(trace.axis[-1]) + (1.0 if record.t is None else float(record.dt[0]))
    return traces


def thin(most: int, *columns: np.ndarray) -> np.ndarray:
    """Positions of about `most` samples that keep the ends and every stretch's extremes of each column, ascending."""
    n = columns[0].size
    if n <= most:
        return np.arange(n)
    edges = np.linspace(0, n, max(2, most // (2 * len(columns))) + 1).astype(int)
    kept = {0, n - 1}
    for column in columns:
        low, high = np.where(np.isnan(column), np.inf, column), np.where(np.isnan(column), -np.inf, column)
        for a, b in itertools.pairwise(edges):
            kept |= {a + int(np.argmin(low[a:b])), a + int(np.argmax(high[a:b]))}
    return np.array(sorted(kept))


def _line(ax: Axes, parts: Iterable[tuple[np.ndarray, np.ndarray]], label: str, color: str, width: float = 0.0) -> None:
    """The same line of several records, one artist with gaps between them and where y is missing; points where it has no width."""
    shown = [(x, y) for x, y in parts if np.isfinite(y).any()]
    if not shown:
        return
    x, y = (
        np.concatenate([row for part in column for row in (part, [np.nan])][:-1]) for column in zip(*shown, strict=True)
    )
    style: dict[str, Any] = {"lw": width} if width else {"ls": "", "marker": ".", "ms": 2}
    ax.plot(x, y, color=color, label=label, rasterized=not width or x.size > _RASTER, **style)


def _selected_cycles(trace: Trace) -> dict[str, tuple[int, slice]]:
    """Number and samples of the first, the last and the worst cycle of many; empty where there are few."""
    found = cycles(trace.u, _TURN * float(np.ptp(trace.u)))
    counted = trace.seen if trace.seen.any() else trace.held
    found = found[[bool(counted[a : c + 1].any()) for a, _, c in found]] if len(found) else found
    if len(found) <= _MANY_CYCLES:
        return {}
    size = np.where(counted, trace.residual, np.nan)
    errors = [float(np.nanmean(size[a : c + 1] ** 2)) for a, _, c in found]
    worst = int(np.argmax(errors))
    at = {"first": 0, "last": len(found) - 1, "largest error": worst}
    cut = lambda k: slice(int(found[k, 0]), int(found[k, 2]) + 1)
    return {name: (k + 1, cut(k)) for name, k in at.items() if k != worst or name == "largest error"}


def selects_cycles(traces: list[Trace]) -> bool:
    """Whether pictures show some of many cycles."""
    return len(traces) == 1 and bool(_selected_cycles(traces[0]))


def draw_loop(traces: list[Trace], ax: Axes) -> None:
    """Measured and simulated output over the input; of many cycles the first, the last and the one with the largest error."""
    if len(traces) == 1 and (shown := _selected_cycles(traces[0])):
        _some_cycles(traces[0], shown, ax)
        return
    share = max(1, _LOOP_POINTS // len(traces))
    chosen = [(t, thin(share, t.u, t.y, t.predicted)) for t in traces]
    _line(ax, ((t.u[at], t.outputs(t.held)[at]) for t, at in chosen), "measured, not fitted", HELD_OUT, 3.8)
    _line(ax, ((t.u[at], t.outputs(t.seen)[at]) for t, at in chosen), "measured", MEASURED, 2.4)
    _line(ax, ((t.u[at], t.model[at]) for t, at in chosen), "model", MODEL, 0.9)
    column_label(ax, "x", *traces[0].columns["u"])
    column_label(ax, "y", *traces[0].columns["y"])
    ax.legend(frameon=False)


def _some_cycles(trace: Trace, shown: dict[str, tuple[int, slice]], ax: Axes) -> None:
    """Measured (thick) and model (thin) of some cycles."""
    for name, (number, part) in shown.items():
        at = part.start + thin(_POINTS, trace.u[part], trace.y[part], trace.predicted[part])
        ax.plot(trace.u[at], trace.y[at], color=CYCLES[name], lw=4, alpha=0.3, solid_capstyle="butt")
        ax.plot(trace.u[at], trace.predicted[at], color=CYCLES[name], lw=0.9, label=f"cycle {number} ({name})")
    column_label(ax, "x", *trace.columns["u"])
    column_label(ax, "y", *trace.columns["y"])
    ax.legend(frameon=False, title="measured: thick, model: thin", fontsize="small", title_fontsize="small")


def draw_cycle_errors(traces: list[Trace], ax: Axes) -> None:
    """Residuals of some cycles over the input."""
    trace = traces[0]
    shown = _selected_cycles(trace) or {"first": (1, slice(0, trace.u.size))}
    for name, (number, part) in shown.items():
        at = part.start + thin(_POINTS, trace.u[part], trace.residual[part])
        ax.plot(trace.u[at], trace.residual[at], color=CYCLES[name], lw=0.9, label=f"cycle {number} ({name})")
    ax.axhline(0.0, color="black", lw=0.7)
    column_label(ax, "x", *trace.columns["u"])
    ax.set_ylabel(trace.residual_label)
    _legend_above(ax)


def draw_worst(traces: list[Trace], ax: Axes) -> None:
    """Output over time around the largest persistent error."""
    errors = [persistent_error(np.where(t.seen | t.held, t.residual, 0.0)) for t in traces]
    trace, error = max(zip(traces, errors, strict=True), key=lambda pair: float(pair[1].max()))
    middle, size = int(np.argmax(error)), error.size
    turns = [part.stop - part.start for _, part in _selected_cycles(trace).values()]
    half = max(20, turns[-1] if turns else size // 20)
    part = slice(max(middle - half, 0), min(middle + half + 1, size))
    at = part.start + thin(_POINTS, trace.y[part], trace.predicted[part])
    ax.plot(trace.axis[at], trace.y[at], color=MEASURED, lw=2.6, label="measured")
    ax.plot(trace.axis[at], trace.predicted[at], color=MODEL, lw=0.9, label="model")
    ax.axvline(trace.axis[middle], color=SECOND, lw=0.8, ls="--", label="largest persistent error")
    _over_time(traces, ax)


def _legend_above(ax: Axes) -> None:
    """A legend that covers no curve."""
    ax.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize="small")


def draw_series(traces: list[Trace], ax: Axes) -> None:
    """Measured and simulated output over time."""
    share = max(1, _POINTS // len(traces))
    chosen = [(t, thin(share, t.y, t.predicted)) for t in traces]
    _line(ax, ((t.axis[at], t.outputs(t.seen)[at]) for t, at in chosen), "measured", MEASURED, 2.6)
    _line(ax, ((t.axis[at], t.outputs(t.held)[at]) for t, at in chosen), "measured, not fitted", HELD_OUT, 2.6)
    _line(ax, ((t.axis[at], t.model[at]) for t, at in chosen), "model", MODEL, 0.9)
    _over_time(traces, ax)


def _axis(traces: list[Trace]) -> str:
    several = ", records one after another" if len(traces) > 1 else ""
    return traces[0].axis_label + several


def _over_time(traces: list[Trace], ax: Axes) -> None:
    """Labels and legend of outputs over time."""
    column_label(ax, "y", *traces[0].columns["y"])
    ax.set_xlabel(_axis(traces))
    ax.margins(x=0.01)
    _legend_above(ax)


def draw_residuals(traces: list[Trace], ax: Axes) -> None:
    """Residuals over time."""
    share = max(1, _POINTS // len(traces))
    chosen = [(t, thin(share, t.residual)) for t in traces]
    _line(ax, ((t.axis[at], t.residuals(t.seen)[at]) for t, at in chosen), "fitted", MODEL, 0.8)
    _line(ax, ((t.axis[at], t.residuals(t.held)[at]) for t, at in chosen), "not fitted", HELD_OUT, 0.8)
    ax.axhline(0.0, color="black", lw=0.7)
    if any(trace.held.any() for trace in traces) and any(trace.seen.any() for trace in traces):
        _legend_above(ax)
    ax.set(xlabel=_axis(traces), ylabel=traces[0].residual_label)
    ax.margins(x=0.01)
    _frame(ax, traces)


def draw_residuals_over_input(traces: list[Trace], ax: Axes) -> None:
    """Residuals over the input."""
    share = max(1, _POINTS // len(traces))
    chosen = [(t, thin(share, t.u, t.residual)) for t in traces]
    _line(ax, ((t.u[at], t.residuals(t.held)[at]) for t, at in chosen), "not fitted", HELD_OUT)
    _line(ax, ((t.u[at], t.residuals(t.seen)[at]) for t, at in chosen), "fitted", MODEL)
    ax.axhline(0.0, color="black", lw=0.7)
    column_label(ax, "x", *traces[0].columns["u"])
    ax.set_ylabel(traces[0].residual_label)
    if len(ax.get_legend_handles_labels()[1]) > 1:
        _legend_above(ax)
    _frame(ax, traces)


def _frame(ax: Axes, traces: list[Trace]) -> None:
    """Limit the axis where a few residuals are so large that they would flatten the others, and say how many are not shown."""
    seen, held = (np.abs(np.concatenate([t.residual[getattr(t, k)] for t in traces])) for k in ("seen", "held"))
    # A few residuals beyond three times the 99.5 % quantile, or not fitted and beyond twice the largest fitted, are not drawn.
    usual = 3.0 * float(np.quantile(seen, 0.995)) if seen.size else 0.0
    outliers = np.concatenate([seen, held])
    outliers = outliers[outliers > usual]
    if usual > 0 and (seen > usual).any() and outliers.size <= 0.01 * (seen.size + held.size):
        ax.set_ylim(-1.1 * usual, 1.1 * usual)
        _annotate_outliers(
            ax,
            f"{outliers.size} {'outlier lies' if outliers.size == 1 else 'outliers lie'} outside (up to {outliers.max():.3g})",
        )
        return
    limit = 2.0 * np.max(seen, initial=0.0)
    beyond = held > limit
    if limit > 0 and 0 < beyond.sum() <= 0.05 * held.size:
        ax.set_ylim(-limit, limit)
        _annotate_outliers(ax, f"{beyond.sum()} samples not fitted lie outside (up to {held.max():.3g})")


def _annotate_outliers(ax: Axes, text: str) -> None:
    ax.text(0.99, 0.98, text, transform=ax.transAxes, ha="right", va="top", fontsize="small", color=DARK)


def draw_autocorrelation(traces: list[Trace], ax: Axes) -> None:
    """Autocorrelation of the residuals of the longest record, until it has decayed, with the 95 % band of white noise."""
    chosen = [t.residual[t.seen] if t.seen.any() else t.residual[t.held] for t in traces]
    r = max(chosen, key=lambda part: part.size)
    r = r[np.isfinite(r)]
    rho = autocorrelation(r, max(1, min(r.size // 2, 5000)))
    band = REACH / np.sqrt(r.size)
    large = np.flatnonzero(np.abs(rho) > 0.2)
    shown = rho[: max(20, min(rho.size, 2 * int(large[-1]) + 10))]
    at = thin(_POINTS, shown)
    ax.axhspan(-band, band, color=FAINT, alpha=0.5, lw=0, label="95 % band of white noise")
    ax.axhline(0.0, color="black", lw=0.7)
    if shown.size <= 60:
        ax.vlines(at, 0, shown[at], color=MODEL, lw=1.5)
    else:
        ax.plot(at, shown[at], color=MODEL, lw=1.0)
    ax.locator_params(axis="x", integer=True)
    ax.set(xlabel="lag [samples]", ylabel="autocorrelation of residuals", ylim=(min(-0.2, 1.1 * shown.min()), 1.05))
    ax.legend(frameon=False)
