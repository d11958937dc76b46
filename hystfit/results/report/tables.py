"""The tables of a report, as objects that the text and the HTML page share."""

from __future__ import annotations

import math

from hystfit.data.dataset import Dataset
from hystfit.outcome import Column, Table
from hystfit.outcome.table import number, rounded
from hystfit.results.accuracy import Metrics
from hystfit.results.estimates import ParameterEstimate, grouped
from hystfit.results.measured.quantities import QUANTITIES, QuantityEstimate
from hystfit.results.result import FitResult


def parameter_table(result: FitResult, *, meaning: bool = False) -> Table:
    """The free parameters with their standard errors, arrays of many weights in one row each, and what follows from them."""
    left = lambda head: Column(head, left=True)
    columns = [left("name"), Column("value"), Column("+- stderr"), left("unit"), left("bounds"), left("")]
    rows = [_row(name, family) for name, family in grouped([p for p in result.parameters if not p.fixed])]
    rows += [[p.name, *rounded(p.value, p.stderr), p.unit, "", "derived", p.doc] for p in result.derived]
    return Table([*columns, left("meaning")], rows) if meaning else Table(columns, [row[:-1] for row in rows])


def quantity_table(result: FitResult, *, meaning: bool = False) -> Table:
    """Engineering quantities with their standard errors, those of the measured loops, and the reason where one is unknown."""
    left = lambda head: Column(head, left=True)
    columns = [left("quantity"), Column("value"), Column("+- stderr"), left("unit"), Column("measured"), left("")]
    rows = [_quantity_row(q, result.data) for q in result.quantities]
    return Table([*columns, left("definition")], rows) if meaning else Table(columns, [row[:-1] for row in rows])


def _quantity_row(q: QuantityEstimate, data: Dataset) -> list[str]:
    one = QUANTITIES[q.name]
    shown = ("-", "-") if q.value is None else rounded(q.value, q.stderr)
    return [one.label_on(data), *shown, q.unit, number(q.measured), "" if q.reason is None else q.reason.text, one.doc]


def _row(name: str, family: list[ParameterEstimate]) -> list[str]:
    p = family[0]
    if len(family) == 1:
        return [name, *rounded(p.value, p.stderr), p.unit, _bounds(p), _remark(p), p.doc]
    values = [member.value for member in family]
    counts = {
        "zero": values.count(0),
        "at a bound": sum(m.at_bound is not None and m.value != 0 for m in family),
        "not determined": sum(m.identifiable is False and m.at_bound is None for m in family),
    }
    remark = [f"{len(family)} values"] + [f"{count} {what}" for what, count in counts.items() if count]
    span = f"{min(values):.3g} to {max(values):.3g}"
    return [f"{name}[{len(family)}]", span, "-", p.unit, _bounds(p), ", ".join(remark), p.doc]


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
    if p.tie is not None:
        return f"= {p.tie}"
    return "not determined" if p.identifiable is False else ""


def fixed_words(result: FitResult) -> str:
    """Fixed parameters and their values in one sentence; "" where there are none."""
    parts = []
    for name, family in grouped([p for p in result.parameters if p.fixed], many=2):
        values = [p.value for p in family]
        span = f"{values[0]:.5g}" if len(values) == 1 else f"{min(values):.3g} to {max(values):.3g}"
        count = "" if len(values) == 1 else f"[{len(values)}]"
        parts.append(f"{name}{count} = {span} {family[0].unit}".rstrip())
    return f"Fixed: {', '.join(parts)}" if parts else ""


def unit_words(result: FitResult) -> str:
    """What [u] and [y] in the units of parameters mean; "" where the data name their units."""
    unknown = [f"[{side}]" for side in ("u", "y") if any(f"[{side}]" in p.unit for p in result.parameters)]
    sides = {"[u]": "input", "[y]": "output"}
    if not unknown:
        return ""
    what = " and ".join(sides[mark] for mark in unknown)
    return f"{' and '.join(unknown)}: unit of the {what}, which the data do not name (units='V,um' names both)"


def metrics_table(result: FitResult) -> Table:
    """Errors on the training and the test data; percentages are of the output range."""
    unit = result.data.units["y"]
    suffix = f" [{unit}]" if unit else ""
    columns = [
        Column("", "data"),
        Column(f"rms{suffix}", "rmse"),
        Column("rms [% of range]", "nrmse_percent", ".3g"),
        Column(f"max{suffix}", "max_error"),
        Column("max [%]", "max_error_percent", ".3g"),
        Column("R2", "r2", ".6g"),
        Column("samples", "n"),
    ]
    rows = []
    for data, m in (("training", result.train), ("test", result.test)):
        if m is not None:
            r2 = None if m.r2 is None else math.floor(m.r2 * 1e6) / 1e6  # never rounded up to 1
            rows.append([data, m.rmse, m.nrmse_percent, m.max_error, m.max_error_percent, r2, m.n])
    return Table(columns, rows)


def metrics_words(metrics: Metrics | None) -> str:
    """Metrics in one line."""
    if metrics is None:
        return "-"
    percent, largest = number(metrics.nrmse_percent, ".3g"), number(metrics.max_error_percent, ".3g")
    return f"rms {percent} % of the range, maximum {largest} %, over {metrics.n} samples"
