"""The overview of many fits as one HTML page: counts, the distribution of each parameter, and the loops that need a look."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

from hystfit.batch.fits import Fits
from hystfit.batch.histograms import histogram
from hystfit.batch.row import Row
from hystfit.outcome import Column, Table
from hystfit.results.webpage import Markup, Page

_SHOWN = 50  # loops in the list at most, besides those with a report


def overview(fits: Fits, reports: Mapping[str, str] | None = None) -> str:
    """One self-contained HTML page.

    Args:
        reports: address of the report of a loop, by the name of the loop; for some of the loops.
    """
    reports = reports or {}
    listed = [row for k, row in enumerate(fits.worst(len(fits))) if k < _SHOWN or row.name in reports]
    pictures = [_picture(fits, name) for name in (*fits.names, *fits.quantities) if fits.values(name).size]
    counts = ", ".join(f"{count} {status}" for status, count in fits.counts.items())
    advice = "" if fits.usable else f" {fits.advice[:1].upper()}{fits.advice[1:]}."
    explained = "Bars count loops; the line is the median. Numbers below are the ends of the range."
    omitted = len(fits) - len(listed)
    rest = f"{omitted} more loops with smaller errors are in the table of all fits." if omitted else ""
    shown = [Markup(f'<div class="pictures small">{"".join(pictures)}</div>'), explained, fits.summary()]
    table = Markup(f'<div class="scroll">{_table(listed, reports)}</div>')
    sections = [
        ("Distributions over the usable fits", shown if pictures else []),
        (
            "Loops, those that need a look first",
            [table, rest, "Errors are in percent of the range of the measured output."],
        ),
    ]
    title = f"{fits.model} fitted to {len(fits)} loops"
    return Page(title, f"{counts}.{advice}", fits.usable, [], sections).render()


def _picture(fits: Fits, name: str) -> str:
    """Histogram of a parameter or quantity with its heading."""
    values, unit = fits.values(name), fits.unit(name)
    heading = f"{name} [{unit}]" if unit else name
    return f"<figure><figcaption>{html.escape(heading)}</figcaption>{histogram(values, heading)}</figure>"


def _table(rows: Sequence[Row], reports: Mapping[str, str]) -> str:
    """The list of loops, each with the address of its report where it has one."""
    columns = [
        Column("loop"),
        Column("status", left=True),
        Column("error [%]", form=".3g"),
        Column("largest [%]", form=".3g"),
    ]
    cells = [[row.name, str(row.status), row.error_percent, row.max_error_percent, row.reason] for row in rows]
    links = {row.name: html.escape(reports[row.name], quote=True) for row in rows if row.name in reports}
    return Table([*columns, Column("reason", left=True)], cells).html(links)
