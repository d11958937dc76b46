"""Numbers of a report as text: values with their errors, the table of parameters, metrics."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from hystfit.results.metrics import Metrics
from hystfit.results.plots import grouped
from hystfit.results.result import FitResult, ParameterEstimate


def rounded(value: float, stderr: float | None) -> tuple[str, str]:
    """A value and its standard error as text: two digits of the error, the value to the same decimal; "-" where unknown."""
    if stderr is None or not math.isfinite(stderr) or stderr <= 0:
        return f"{value:.5g}", "-"
    exponent = math.floor(math.log10(max(abs(value), stderr)))
    scale = 0 if -4 <= exponent < 6 else exponent
    decimals = min(15, 1 - math.floor(math.log10(stderr)) + scale)
    tail = f"e{scale:+03d}" if scale else ""
    if decimals < 0:
        return f"{round(value, decimals):z.0f}", f"{round(stderr, decimals):.0f}"
    return f"{value / 10**scale:z.{decimals}f}{tail}", f"{stderr / 10**scale:.{decimals}f}{tail}"


def number(value: float | None, form: str = ".4g") -> str:
    """A number as text; "-" where it is unknown."""
    return "-" if value is None or not math.isfinite(value) else format(value, form)


def _bounds(p: ParameterEstimate) -> str:
    if p.lower is None and p.upper is None:
        return ""
    if p.upper is None:
        return f">= {p.lower:.4g}"
    if p.lower is None:
        return f"<= {p.upper:.4g}"
    return f"{p.lower:.4g} to {p.upper:.4g}"


def _remark(p: ParameterEstimate) -> str:
    if p.at_bound:
        return f"at its {p.at_bound} bound"
    return "not determined" if p.identifiable is False else ""


@dataclasses.dataclass(frozen=True)
class Line:
    """One line of the table of parameters, as text."""

    name: str
    value: str
    stderr: str
    unit: str
    bounds: str
    remark: str
    doc: str = ""


def lines(result: FitResult) -> list[Line]:
    """The table of free parameters; arrays of many weights in one line each."""
    table = []
    for name, family in grouped([p for p in result.parameters if not p.fixed]):
        p = family[0]
        if len(family) == 1:
            table.append(Line(name, *rounded(p.value, p.stderr), p.unit, _bounds(p), _remark(p), p.doc))
            continue
        values = np.array([member.value for member in family])
        counts = {
            "zero": int(np.sum(values == 0)),
            "at a bound": sum(m.at_bound is not None and m.value != 0 for m in family),
            "not determined": sum(m.identifiable is False and m.at_bound is None for m in family),
        }
        said = [f"{len(family)} values"] + [f"{count} {what}" for what, count in counts.items() if count]
        span = f"{values.min():.3g} to {values.max():.3g}"
        table.append(Line(f"{name}[{len(family)}]", span, "-", p.unit, _bounds(p), ", ".join(said), p.doc))
    return table


def held(result: FitResult) -> str:
    """Parameters that were held, and where, in one sentence; "" where there are none."""
    told = []
    for name, family in grouped([p for p in result.parameters if p.fixed], many=2):
        values = [p.value for p in family]
        span = f"{values[0]:.5g}" if len(values) == 1 else f"{min(values):.3g} to {max(values):.3g}"
        count = "" if len(values) == 1 else f"[{len(values)}]"
        told.append(f"{name}{count} = {span} {family[0].unit}".rstrip())
    return f"Held: {', '.join(told)}" if told else ""


def metrics_words(metrics: Metrics | None) -> str:
    """Metrics in one line."""
    if metrics is None:
        return "-"
    percent, largest = number(metrics.nrmse_percent, ".3g"), number(metrics.max_error_percent, ".3g")
    return f"rms {percent} % of the range, largest {largest} %, over {metrics.n} samples"
