"""The overview of many fits as one HTML page: counts, the distribution of each parameter, and the loops that need attention."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hystfit.batch.fits import Fits
from hystfit.batch.row import Row
from hystfit.outcome import Column, Table
from hystfit.outcome.table import ROUNDING, number
from hystfit.params.units import with_unit
from hystfit.results.webpage import Markup, Page

_WIDTH, _HEIGHT, _FOOT = 240, 96, 18  # of a histogram
_FEWEST, _MOST = 5, 30  # bars


def overview(fits: Fits, reports: Mapping[str, str] | None = None, translate: Callable[[str], str] = str) -> str:
    """One self-contained HTML page, with links to some `reports` by the name of the loop; `translate` gives the options of the reader."""
    reports = reports or {}
    listed = [row for k, row in enumerate(fits.worst(len(fits))) if k < 50 or row.name in reports]
    pictures = [_picture(fits, name) for name in (*fits.names, *fits.quantities) if fits.values(name).size]
    counts = ", ".join(f"{count} {status}" for status, count in fits.counts.items())
    advice = "" if fits.usable else f" {translate(fits.advice[:1].upper() + fits.advice[1:])}."
    explained = "Bars count loops; the line is the median. Numbers below are the ends of the range."
    omitted = len(fits) - len(listed)
    rest = f"{omitted} more loops with smaller errors are in the table of all fits." if omitted else ""
    shown = [Markup(f'<div class="pictures small">{"".join(pictures)}</div>'), explained, fits.summary()]
    table = Markup(f'<div class="scroll">{_table(listed, reports, translate)}</div>')
    sections = [
        ("Distributions over the usable fits", shown if pictures else []),
        (
            "Loops, those that need attention first",
            [table, rest, "Errors are in percent of the range of the measured output."],
        ),
    ]
    title = f"{fits.model} fitted to {len(fits)} loops"
    return Page(title, f"{counts}.{advice}", fits.usable, [], sections).render()


def _picture(fits: Fits, name: str) -> str:
    values, unit = fits.values(name), fits.unit(name)
    heading = with_unit(name, unit)
    return f"<figure><figcaption>{html.escape(heading)}</figcaption>{histogram(values, heading)}</figure>"


def _table(rows: Sequence[Row], reports: Mapping[str, str], translate: Callable[[str], str]) -> str:
    columns = [
        Column("loop"),
        Column("status", left=True),
        Column("error [%]", form=".3g"),
        Column("largest [%]", form=".3g"),
    ]
    cells = [
        [row.name, str(row.status), row.error_percent, row.max_error_percent, translate(row.reason)] for row in rows
    ]
    links = {row.name: html.escape(reports[row.name], quote=True) for row in rows if row.name in reports}
    return Table([*columns, Column("reason", left=True)], cells).html(links)


def histogram(values: np.ndarray, heading: str) -> str:
    """An SVG picture with a bar for each bin of finite values, shape (n,), the median as a line, and the ends of the range below."""
    bars = int(np.clip(np.sqrt(values.size) * 1.5, _FEWEST, _MOST))
    center, size = float(values[0]), float(np.abs(values).max())
    alike = np.ptp(values) <= ROUNDING * size  # bins of such a range would be narrower than numbers can be
    pad = 0.1 * size or 1.0
    counts, edges = np.histogram(values, bins=bars, range=(center - pad, center + pad) if alike else None)
    low, high, middle = float(edges[0]), float(edges[-1]), float(np.median(values))
    width, floor = _WIDTH / counts.size, _HEIGHT - _FOOT
    place = lambda value: _WIDTH * (value - low) / (high - low)
    shapes = []
    for k, count in enumerate(counts):
        tall = (floor - 4) * count / counts.max()
        title = f"<title>{number(edges[k])} to {number(edges[k + 1])}: {count}</title>"
        corner = f'x="{k * width + 0.5:.1f}" y="{floor - tall:.1f}"'
        shapes.append(
            f'<rect class="bar" {corner} width="{max(width - 1, 0.5):.1f}" height="{tall:.1f}">{title}</rect>'
        )
    at = f"{place(middle):.1f}"
    shapes.append(f'<line class="median" x1="{at}" x2="{at}" y1="0" y2="{floor}"/>')
    shapes.append(f'<text x="0" y="{_HEIGHT - 4}">{number(low)}</text>')
    shapes.append(f'<text x="{_WIDTH}" y="{_HEIGHT - 4}" text-anchor="end">{number(high)}</text>')
    label = html.escape(heading, quote=True)
    return f'<svg role="img" aria-label="{label}" viewBox="0 0 {_WIDTH} {_HEIGHT}">{"".join(shapes)}</svg>'
