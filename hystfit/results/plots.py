"""Pictures of a fit. Every function takes axes or makes them, returns them, and neither shows nor changes anything else."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hystfit.config import require_x64
from hystfit.data.record import Dataset, Record
from hystfit.errors import HystfitError
from hystfit.inference.autocorrelation import autocorrelation
from hystfit.params.units import axis_label
from hystfit.quality.loops import cycles
from hystfit.results.accuracy import persistent_error
from hystfit.results.labels import column_label, substitute_missing_glyphs, use_available_fonts

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hystfit.results.estimates import ParameterEstimate
from hystfit.results.result import FitResult

# Okabe and Ito's colors, which can also be distinguished with color-vision deficiency.
MEASURED, HELD_OUT, MODEL, FAINT = "#a6a6a6", "#e69f00", "#0072b2", "#bbbbbb"
DARK = "#8a5a00"  # of HELD_OUT, for text
CYCLES = {"first": MODEL, "last": "#009e73", "largest error": "#d55e00"}  # of many, those that a picture shows
MANY = 12  # weights of one array above which they share one row
_POINTS, _LOOP_POINTS, _RASTER = 4000, 40_000, 6000
_BEYOND = 2.0  # times the largest residual fitted, beyond which a few residuals not fitted are not drawn
_OUTLIER, _FEW_OUTLIERS = (
    3.0,
    0.005,
)  # times the 99.5 % quantile, beyond which residuals fitted are not drawn; part of them at most
_MANY_CYCLES = 4  # above which the loop shows some of them
_TURN = 0.3  # of the input's range: stroke of a cycle
_STRETCH = 0.1  # of a record: length of the worst stretch; two cycles where there are many


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
    require_x64()
    if kind not in KINDS:
        raise HystfitError(f"no picture {kind!r}; there are {', '.join(KINDS)}")
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.subplots(layout="constrained")[1]
    assert ax is not None
    if kind in _OF_RESULT:
        return KINDS[kind](result, ax)
    KINDS[kind](_traces(result, data, refit_offset), ax)
    ax.spines[["top", "right"]].set_visible(False)
    use_available_fonts(ax)
    return ax


class _Trace:
    """One record as drawn: measured and predicted output, and which samples were fitted."""

    def __init__(self, record: Record, predicted: np.ndarray, fitted: bool, start: float):
        self.u, self.y, self.predicted = record.u, record.y, predicted
        self.seen = record.used & fitted
        self.held = np.isfinite(record.y) & ~record.used if fitted else record.used
        if self.seen[1:2].any() and not self.seen[0]:
            self.held[0] = (
                False  # one sample alone before the fitted ones, such as a calibration point, belongs to no curve
            )
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


def _traces(result: FitResult, data: Any, refit_offset: bool) -> list[_Trace]:
    """Records one after another along one axis."""
    records = list(result.data if data is None else Dataset.of(data).map(result.in_fitted_units))
    traces, start = [], 0.0
    for record in records:
        predicted = result.predict(record, refit_offset=refit_offset and data is not None)
        trace = _Trace(record, predicted, data is None, start)
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


def _line(ax: Axes, x: np.ndarray, y: np.ndarray, label: str, color: str, width: float) -> None:
    """A line with one entry in the legend and gaps where y is missing."""
    if not np.isfinite(y).any():
        return
    known = ax.get_legend_handles_labels()[1]
    ax.plot(x, y, color=color, lw=width, label=None if label in known else label, rasterized=x.size > _RASTER)


def _selected_cycles(trace: _Trace) -> dict[str, tuple[int, slice]]:
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


def selects_cycles(result: FitResult) -> bool:
    """Whether pictures of a fit show some of its many cycles."""
    return len(result.data) == 1 and bool(_selected_cycles(_traces(result, None, False)[0]))


def _loop(traces: list[_Trace], ax: Axes) -> None:
    if len(traces) == 1 and (shown := _selected_cycles(traces[0])):
        _some_cycles(traces[0], shown, ax)
        return
    share = max(1, _LOOP_POINTS // len(traces))
    for trace in traces:
        at = thin(share, trace.u, trace.y, trace.predicted)
        _line(ax, trace.u[at], np.where(trace.held, trace.y, np.nan)[at], "measured, not fitted", HELD_OUT, 3.8)
        _line(ax, trace.u[at], np.where(trace.seen, trace.y, np.nan)[at], "measured", MEASURED, 2.4)
    for trace in traces:
        at = thin(share, trace.u, trace.y, trace.predicted)
        _line(ax, trace.u[at], trace.model[at], "model", MODEL, 0.9)
    column_label(ax, "x", *traces[0].columns["u"])
    column_label(ax, "y", *traces[0].columns["y"])
    ax.legend(frameon=False)


def _some_cycles(trace: _Trace, shown: dict[str, tuple[int, slice]], ax: Axes) -> None:
    """Measured (thick) and model (thin) of some cycles."""
    for name, (number, part) in shown.items():
        at = part.start + thin(_POINTS, trace.u[part], trace.y[part], trace.predicted[part])
        ax.plot(trace.u[at], trace.y[at], color=CYCLES[name], lw=4, alpha=0.3, solid_capstyle="butt")
        ax.plot(trace.u[at], trace.predicted[at], color=CYCLES[name], lw=0.9, label=f"cycle {number} ({name})")
    column_label(ax, "x", *trace.columns["u"])
    column_label(ax, "y", *trace.columns["y"])
    ax.legend(frameon=False, title="measured: thick, model: thin", fontsize="small", title_fontsize="small")


def _cycle_errors(traces: list[_Trace], ax: Axes) -> None:
    """Residuals of some cycles over the input."""
    trace = traces[0]
    shown = _selected_cycles(trace) or {"first": (1, slice(0, trace.u.size))}
    for name, (number, part) in shown.items():
        at = part.start + thin(_POINTS, trace.u[part], trace.residual[part])
        ax.plot(trace.u[at], trace.residual[at], color=CYCLES[name], lw=0.9, label=f"cycle {number} ({name})")
    ax.axhline(0.0, color="black", lw=0.7)
    column_label(ax, "x", *trace.columns["u"])
    ax.set_ylabel(trace.residual_label)
    ax.legend(frameon=False, fontsize="small")


def _worst(traces: list[_Trace], ax: Axes) -> None:
    """Output over time around the largest persistent error."""
    errors = [persistent_error(np.where(t.seen | t.held, t.residual, 0.0)) for t in traces]
    trace, error = max(zip(traces, errors, strict=True), key=lambda pair: float(pair[1].max()))
    middle, size = int(np.argmax(error)), error.size
    turns = [part.stop - part.start for _, part in _selected_cycles(trace).values()]
    half = max(20, turns[-1] if turns else int(_STRETCH * size / 2))
    part = slice(max(middle - half, 0), min(middle + half + 1, size))
    at = part.start + thin(_POINTS, trace.y[part], trace.predicted[part])
    ax.plot(trace.axis[at], trace.y[at], color=MEASURED, lw=2.6, label="measured")
    ax.plot(trace.axis[at], trace.predicted[at], color=MODEL, lw=0.9, label="model")
    ax.axvline(trace.axis[middle], color="#d55e00", lw=0.8, ls="--", label="largest persistent error")
    column_label(ax, "y", *trace.columns["y"])
    ax.set_xlabel(_axis(traces))
    ax.margins(x=0.01)
    ax.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize="small")


def _series(traces: list[_Trace], ax: Axes) -> None:
    share = max(1, _POINTS // len(traces))
    for trace in traces:
        at = thin(share, trace.y, trace.predicted)
        for mask, label, color in ((trace.seen, "measured", MEASURED), (trace.held, "measured, not fitted", HELD_OUT)):
            _line(ax, trace.axis[at], np.where(mask, trace.y, np.nan)[at], label, color, 2.6)
        _line(ax, trace.axis[at], trace.model[at], "model", MODEL, 0.9)
    column_label(ax, "y", *traces[0].columns["y"])
    ax.set_xlabel(_axis(traces))
    ax.margins(x=0.01)
    ax.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def _axis(traces: list[_Trace]) -> str:
    several = ", records one after another" if len(traces) > 1 else ""
    return traces[0].axis_label + several


def _residuals(traces: list[_Trace], ax: Axes) -> None:
    share = max(1, _POINTS // len(traces))
    for trace in traces:
        at = thin(share, trace.residual)
        for mask, label, color in ((trace.seen, "fitted", MODEL), (trace.held, "not fitted", HELD_OUT)):
            _line(ax, trace.axis[at], np.where(mask, trace.residual, np.nan)[at], label, color, 0.8)
    ax.axhline(0.0, color="black", lw=0.7)
    if any(trace.held.any() for trace in traces) and any(trace.seen.any() for trace in traces):
        ax.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    ax.set(xlabel=_axis(traces), ylabel=traces[0].residual_label)
    ax.margins(x=0.01)
    _frame(ax, traces)


def _residuals_input(traces: list[_Trace], ax: Axes) -> None:
    share = max(1, _POINTS // len(traces))
    for trace in traces:
        at = thin(share, trace.u, trace.residual)
        for mask, color in ((trace.held, HELD_OUT), (trace.seen, MODEL)):
            y = np.where(mask, trace.residual, np.nan)[at]
            if np.isfinite(y).any():
                ax.plot(trace.u[at], y, ".", ms=2, color=color, rasterized=True)
    ax.axhline(0.0, color="black", lw=0.7)
    column_label(ax, "x", *traces[0].columns["u"])
    ax.set_ylabel(traces[0].residual_label)
    _frame(ax, traces)


def _frame(ax: Axes, traces: list[_Trace]) -> None:
    """Limit the axis where a few residuals are so large that they would flatten the others, and say how many are not shown."""
    seen, held = (np.abs(np.concatenate([t.residual[getattr(t, k)] for t in traces])) for k in ("seen", "held"))
    usual = _OUTLIER * float(np.quantile(seen, 1 - _FEW_OUTLIERS)) if seen.size else 0.0
    outliers = np.concatenate([seen, held])
    outliers = outliers[outliers > usual]
    if usual > 0 and (seen > usual).any() and outliers.size <= 0.01 * (seen.size + held.size):
        ax.set_ylim(-1.1 * usual, 1.1 * usual)
        _annotate_outliers(
            ax,
            f"{outliers.size} {'outlier lies' if outliers.size == 1 else 'outliers lie'} outside (up to {outliers.max():.3g})",
        )
        return
    limit = _BEYOND * np.max(seen, initial=0.0)
    beyond = held > limit
    if limit > 0 and 0 < beyond.sum() <= 0.05 * held.size:
        ax.set_ylim(-limit, limit)
        _annotate_outliers(ax, f"{beyond.sum()} samples not fitted lie outside (up to {held.max():.3g})")


def _annotate_outliers(ax: Axes, text: str) -> None:
    ax.text(0.99, 0.98, text, transform=ax.transAxes, ha="right", va="top", fontsize="small", color=DARK)


def _autocorrelation(traces: list[_Trace], ax: Axes) -> None:
    """Autocorrelation of the residuals of the longest record, until it has decayed, with the 95 % band of white noise."""
    chosen = [t.residual[t.seen] if t.seen.any() else t.residual[t.held] for t in traces]
    r = max(chosen, key=lambda part: part.size)
    r = r[np.isfinite(r)]
    rho = autocorrelation(r, max(1, min(r.size // 2, 5000)))
    band = 1.96 / np.sqrt(r.size)
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


KINDS: dict[str, Callable[..., Any]] = {
    "loop": _loop,
    "series": _series,
    "residuals": _residuals,
    "residuals-input": _residuals_input,
    "worst": _worst,
    "cycle-errors": _cycle_errors,
    "autocorrelation": _autocorrelation,
    "parameters": lambda result, ax: _parameters(result, ax),
    "weights": lambda result, ax: _weights(result, ax),
    "density": lambda result, ax: _density(result, ax),
}
_OF_RESULT = ("parameters", "weights", "density")  # drawn from the fit alone, whatever its records


def grouped(parameters: Sequence[ParameterEstimate], many: int = MANY) -> list[tuple[str, list[ParameterEstimate]]]:
    """Parameters by their name in a report; arrays (or per-record sets) of more than `many` share one name."""
    base = lambda p: re.split(r"[\[@]", p.name)[0]
    families: dict[tuple[str, bool], list[ParameterEstimate]] = {}
    for p in parameters:
        families.setdefault((base(p), p.fixed), []).append(p)
    rows: list[tuple[str, list[ParameterEstimate]]] = []
    for p in parameters:
        family = families[base(p), p.fixed]
        if len(family) <= many:
            rows.append((p.name, [p]))
        elif p is family[0]:
            rows.append((base(p), family))
    return rows


def _parameters(result: FitResult, ax: Axes) -> Axes:
    """Standard errors in percent of the values, log scale; the reason where there is none."""
    from matplotlib.ticker import FormatStrFormatter, NullFormatter

    rows = [(name, family) for name, family in grouped(result.parameters) if not family[0].fixed]
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


def _weights(result: FitResult, ax: Axes) -> Axes:
    """Weights of plays or stops over their thresholds, with standard errors where they have one."""
    found, unit = result.model.plays(), result.data.units
    if not found:
        return _empty_axes(ax, f"{result.name} has no plays")
    errors = {p.name: p.stderr for p in result.parameters}
    for plays, color in zip(found, itertools.cycle(CYCLES.values())):
        spread = [errors.get(name) or 0.0 for name in plays.names]
        ax.errorbar(plays.threshold, plays.weight, yerr=spread, fmt="o-", ms=4, lw=0.8, color=color, label=plays.label)
        zero = plays.weight == 0
        ax.plot(plays.threshold[zero], plays.weight[zero], "o", ms=4, mec=color, mfc="white")
    ax.axhline(0.0, color="black", lw=0.7)
    ax.set(xlabel=axis_label("threshold (half width)", unit["u"]), ylabel=axis_label("weight", unit["y"]))
    ax.legend(frameon=False, fontsize="small", title="open: zero", title_fontsize="small")
    return ax


def _empty_axes(ax: Axes, text: str) -> Axes:
    ax.set(xlabel=text, xticks=[], yticks=[])
    return ax


def _density(result: FitResult, ax: Axes) -> Axes:
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
    """The reason why parameters have no standard error."""
    if all(p.at_bound for p in family):
        return f"at its {family[0].at_bound} bound" if len(family) == 1 else "all at a bound"
    if any(p.identifiable is False for p in family):
        return "not determined by these data"
    return "no standard error"
