"""The report on a fit as text."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

import numpy as np

from hystfit.data.record import Record
from hystfit.results.report.numbers import held, lines, number
from hystfit.results.result import FitResult

_WIDTH = 100


def _columns(rows: Sequence[Sequence[str]], right: Sequence[int]) -> list[str]:
    """Rows of text in aligned columns; those numbered in `right` flush right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    pad = lambda text, k: text.rjust(widths[k]) if k in right else text.ljust(widths[k])
    return ["  " + "  ".join(pad(text, k) for k, text in enumerate(row)).rstrip() for row in rows]


def _item(text: str) -> str:
    return textwrap.fill(
        text, _WIDTH, initial_indent="  - ", subsequent_indent="    ", break_long_words=False, break_on_hyphens=False
    )


def metric_rows(result: FitResult) -> list[tuple[str, ...]]:
    """Metrics of the fitted and of the test data as rows of text, below a heading."""
    unit = result.data.units["y"]
    suffix = f" [{unit}]" if unit else ""
    rows: list[tuple[str, ...]] = [("", f"rms{suffix}", "rms [%]", f"largest{suffix}", "largest [%]", "R2", "samples")]
    for what, m in (("fitted", result.train), ("test", result.test)):
        if m is None:
            continue
        percents = (number(m.nrmse_percent, ".3g"), number(m.max_error_percent, ".3g"))
        r2 = "-" if m.r2 is None else f"{math.floor(m.r2 * 1e6) / 1e6:.6g}"  # never rounded up to 1
        rows.append((what, f"{m.rmse:.4g}", percents[0], f"{m.max_error:.4g}", percents[1], r2, str(m.n)))
    return rows


def headline(result: FitResult) -> str:
    """Model, data and verdict in one line."""
    names = [record.name for record in result.data]
    what = names[0] if len(names) == 1 else f"{len(names)} records of {result.data.name}"
    verdict = "usable" if result.usable else f"NOT USABLE ({result.status})"
    return f"{result.name} fitted to {what}: {verdict}"


def facts(result: FitResult) -> dict[str, list[str]]:
    """How the result came about, in sentences under headings."""
    unit = result.data.units["y"]
    starts = f"{result.in_best_basin} of {result.starts} starts reached the best cost"
    how = [f"{result.method}; {starts}" if result.starts > 1 else f"{result.method}, one start"]
    if result.rank is not None:
        condition = f", condition {result.condition:.2g}" if result.condition is not None else ""
        how.append(f"{len(result.free_names)} free parameters, rank {result.rank}{condition}")
    else:
        how.append(f"{len(result.free_names)} free parameters")
    how.append(f"{number(result.compile_s, '.2f')} s compiling, {number(result.run_s, '.2f')} s running")
    spread = [f"standard deviation {number(result.sigma)} {unit}".rstrip()]
    if result.correlation_time > 1 or result.honest_ratio != 1:
        spread.append(f"correlated over {result.correlation_time:.3g} samples (integrated autocorrelation time)")
    else:
        spread.append("no correlation found")
    data = []
    for record in result.data:
        fitted = "all" if record.used.all() else str(int(record.used.sum()))
        data.append(f"{record.name}: {len(record)} samples, {fitted} fitted; {', '.join(_columns_of(record))}")
        data += [note.text for note in record.notes if note.text not in data]
    made = result.provenance
    versions = ", ".join(f"{name} {version}" for name, version in made.get("versions", {}).items())
    origin = [f"{made.get('date', '-')}, seed {made.get('seed', '-')}, Python {made.get('python', '-')}", versions]
    files: dict[str, list[str]] = {}
    for record in made.get("records", []):
        digest = record.get("file_sha256") or record.get("data_sha256")
        files.setdefault(digest, []).append(record.get("source") or record.get("name"))
    for digest, names in list(files.items())[:5]:
        shared = f" and {len(names) - 1} more records" if len(names) > 1 else ""
        origin.append(f"{names[0]}{shared}, SHA-256 {digest}")
    if len(files) > 5:
        origin.append(f"and {len(files) - 5} more files (result.json has their checksums)")
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
    out += _columns(metric_rows(result), right=range(1, 7))
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
    for heading, items in facts(result).items():
        out += ["", heading] + [_item(item) for item in items if item]
    return "\n".join(out) + "\n"
