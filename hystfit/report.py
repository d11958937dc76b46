"""The report on a fit: as text, and as one HTML page with its pictures."""

from __future__ import annotations

import base64
import dataclasses
import io
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.metrics import Metrics
from hystfit.plot import fit as draw
from hystfit.plot import grouped
from hystfit.results import FitResult, ParameterEstimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    Data = Record | Dataset | Sequence[Record]

_WIDTH = 100
_DPI = 150


# -- numbers -----------------------------------------------------------------------------------------------------------


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


def _number(value: float | None, form: str = ".4g") -> str:
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
    percent, largest = _number(metrics.nrmse_percent, ".3g"), _number(metrics.max_error_percent, ".3g")
    return f"rms {percent} % of the range, largest {largest} %, over {metrics.n} samples"


# -- text --------------------------------------------------------------------------------------------------------------


def _columns(rows: Sequence[Sequence[str]], right: Sequence[int]) -> list[str]:
    """Rows of text in aligned columns; those numbered in `right` flush right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    pad = lambda text, k: text.rjust(widths[k]) if k in right else text.ljust(widths[k])
    return ["  " + "  ".join(pad(text, k) for k, text in enumerate(row)).rstrip() for row in rows]


def _item(text: str) -> str:
    return textwrap.fill(
        text, _WIDTH, initial_indent="  - ", subsequent_indent="    ", break_long_words=False, break_on_hyphens=False
    )


def _metric_rows(result: FitResult) -> list[tuple[str, ...]]:
    unit = result.data.units["y"]
    suffix = f" [{unit}]" if unit else ""
    rows: list[tuple[str, ...]] = [("", f"rms{suffix}", "rms [%]", f"largest{suffix}", "largest [%]", "R2", "samples")]
    for what, m in (("fitted", result.train), ("test", result.test)):
        if m is None:
            continue
        percents = (_number(m.nrmse_percent, ".3g"), _number(m.max_error_percent, ".3g"))
        r2 = "-" if m.r2 is None else f"{math.floor(m.r2 * 1e6) / 1e6:.6g}"  # never rounded up to 1
        rows.append((what, f"{m.rmse:.4g}", percents[0], f"{m.max_error:.4g}", percents[1], r2, str(m.n)))
    return rows


def headline(result: FitResult) -> str:
    """Model, data and verdict in one line."""
    names = [record.name for record in result.data]
    what = names[0] if len(names) == 1 else f"{len(names)} records of {result.data.name}"
    verdict = "usable" if result.usable else f"NOT USABLE ({result.status})"
    return f"{result.name} fitted to {what}: {verdict}"


def _facts(result: FitResult) -> dict[str, list[str]]:
    """How the result came about, in sentences under headings."""
    unit = result.data.units["y"]
    starts = f"{result.in_best_basin} of {result.starts} starts reached the best cost"
    how = [f"{result.method}; {starts}" if result.starts > 1 else f"{result.method}, one start"]
    if result.rank is not None:
        condition = f", condition {result.condition:.2g}" if result.condition is not None else ""
        how.append(f"{len(result.free_names)} free parameters, rank {result.rank}{condition}")
    else:
        how.append(f"{len(result.free_names)} free parameters")
    how.append(f"{_number(result.compile_s, '.2f')} s compiling, {_number(result.run_s, '.2f')} s running")
    spread = [f"standard deviation {_number(result.sigma)} {unit}".rstrip()]
    if result.correlation_time > 1 or result.honest_ratio != 1:
        spread.append(f"correlated over {result.correlation_time:.3g} samples (integrated autocorrelation time)")
    else:
        spread.append("no correlation found")
    data = []
    for record in result.data:
        fitted = "all" if record.used.all() else str(int(record.used.sum()))
        data.append(f"{record.name}: {len(record)} samples, {fitted} fitted; {', '.join(_columns_of(record))}")
        data += [note for note in record.notes if note not in data]
    made = result.provenance
    versions = ", ".join(f"{name} {version}" for name, version in made.get("versions", {}).items())
    origin = [f"{made.get('date', '-')}, seed {made.get('seed', '-')}, Python {made.get('python', '-')}", versions]
    for record in made.get("records", [])[:5]:
        digest = record.get("file_sha256") or record.get("data_sha256")
        origin.append(f"{record.get('source') or record.get('name')}, SHA-256 {digest}")
    if len(made.get("records", [])) > 5:
        origin.append(f"and {len(made['records']) - 5} more records (result.json has their checksums)")
    return {"Residuals": spread, "Fit": how, "Data": _shortened(data), "Provenance": origin}


def _columns_of(record: Record) -> list[str]:
    """What input, output and time are, and how far they reach."""
    told = []
    for role, name, values, unit in (
        ("input", record.u_name, record.u, record.u_unit),
        ("output", record.y_name, record.y, record.y_unit),
    ):
        told.append(f"{role} {name} {np.nanmin(values):.4g} to {np.nanmax(values):.4g} {unit}".rstrip())
    if record.t is not None:
        told.append(f"{record.t[0]:.4g} to {record.t[-1]:.4g} {record.t_unit}".rstrip())
    return told


def _shortened(items: list[str], most: int = 16) -> list[str]:
    return (
        items if len(items) <= most else [*items[:most], f"and {len(items) - most} more (result.json and records.npz)"]
    )


def text_report(result: FitResult) -> str:
    """The report as text, at most about 100 columns wide."""
    table = lines(result)
    title = headline(result)
    out = [title, "=" * len(title)]
    if not result.usable:
        out.append(textwrap.fill(result.advice, _WIDTH))
    out += ["", "Error of the free run"]
    out += _columns(_metric_rows(result), right=range(1, 7))
    out += ["", "Parameters"]
    head = ("name", "value", "+- stderr", "unit", "bounds", "")
    cells = [head] + [(r.name, r.value, r.stderr, r.unit, r.bounds, r.remark) for r in table]
    out += _columns(cells, right=(1, 2))
    if fixed := held(result):
        out.append(
            textwrap.fill(
                fixed,
                _WIDTH,
                initial_indent="  ",
                subsequent_indent="  ",
                break_long_words=False,
                break_on_hyphens=False,
            )
        )
    if result.notes:
        out += ["", "Verdict"] + [_item(note) for note in result.notes]
    for heading, items in _facts(result).items():
        out += ["", heading] + [_item(item) for item in items if item]
    return "\n".join(out) + "\n"


# -- pictures and files ------------------------------------------------------------------------------------------------


def pictures(result: FitResult, *, test: Data | None = None, refit_offset: bool = False) -> dict[str, Figure]:
    """Figures by file name, made without any global state of matplotlib."""
    from matplotlib.figure import Figure

    def sheet(width: float, height: float, count: int = 1) -> tuple[Figure, Any]:
        figure = Figure(figsize=(width, height), layout="constrained")
        return figure, figure.subplots(1, count)

    found: dict[str, Figure] = {}
    found["loop"], ax = sheet(6.4, 4.8)
    draw(result, "loop", ax)
    found["series"], ax = sheet(9.6, 3.4)
    draw(result, "series", ax)
    found["residuals"], axes = sheet(9.6, 3.4, 2)
    draw(result, "residuals", axes[0])
    draw(result, "residuals-input", axes[1])
    found["autocorrelation"], ax = sheet(6.4, 3.2)
    draw(result, "autocorrelation", ax)
    count = sum(not family[0].fixed for _, family in grouped(result.parameters))
    found["parameters"], ax = sheet(6.4, min(12.0, 1.2 + 0.3 * count))
    draw(result, "parameters", ax)
    if test is not None:
        found["test"], axes = sheet(9.6, 3.8, 2)
        draw(result, "loop", axes[0], data=test, refit_offset=refit_offset)
        draw(result, "series", axes[1], data=test, refit_offset=refit_offset)
    return found


_CAPTIONS = {
    "loop": "Measured loop and model",
    "test": "Test data, which were not fitted",
    "series": "Output",
    "residuals": "Residuals",
    "autocorrelation": "Autocorrelation of the residuals",
    "parameters": "Relative standard errors",
}


def html_report(result: FitResult, *, test: Data | None = None, refit_offset: bool = False) -> str:
    """One HTML page with its pictures inside, which needs nothing else."""
    figures = pictures(result, test=test, refit_offset=refit_offset)
    return _page(result, {name: _png(figure) for name, figure in figures.items()})


def _page(result: FitResult, images: dict[str, bytes]) -> str:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("hystfit"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    shown = [
        (caption, _width(images[name]), base64.b64encode(images[name]).decode("ascii"))
        for name, caption in _CAPTIONS.items()
        if name in images
    ]
    return environment.get_template("report.html").render(
        title=headline(result),
        usable=result.usable,
        advice=result.advice,
        metrics=_metric_rows(result),
        table=lines(result),
        held=held(result),
        notes=result.notes,
        facts=_facts(result),
        pictures=shown,
    )


def _width(png: bytes) -> int:
    """Width at which a picture reads well [CSS pixels]: PNG's header holds it in device pixels."""
    return int.from_bytes(png[16:20], "big") * 96 // _DPI


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()


def write(result: FitResult, folder: str | Path, *, test: Data | None = None, refit_offset: bool = False) -> Path:
    """Write report.html, report.txt and the pictures (.png, .svg) into a folder; all of them or none.

    Raises:
        HystfitError: the folder cannot be made or written.
    """
    from hystfit.saved import writing

    with writing(folder) as scratch:
        write_into(result, scratch, test=test, refit_offset=refit_offset)
    return Path(folder)


def write_into(result: FitResult, folder: Path, *, test: Data | None = None, refit_offset: bool = False) -> None:
    """The files of `write` into a folder that is there."""
    figures = pictures(result, test=test, refit_offset=refit_offset)
    images = {name: _png(figure) for name, figure in figures.items()}
    (folder / "report.html").write_text(_page(result, images), encoding="utf-8")
    (folder / "report.txt").write_text(text_report(result), encoding="utf-8")
    for name, figure in figures.items():
        (folder / f"{name}.png").write_bytes(images[name])
        figure.set_layout_engine("none")  # as laid out for the PNG
        figure.savefig(folder / f"{name}.svg", dpi=_DPI)
