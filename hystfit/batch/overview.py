"""The overview of many fits as one HTML page: counts, the distribution of each parameter, and the loops that need a look."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hystfit.batch.fits import Fits
from hystfit.batch.histograms import histogram
from hystfit.batch.row import Row
from hystfit.outcome.table import number

_SHOWN = 50  # loops in the list at most, besides those with a report


def overview(fits: Fits, reports: Mapping[str, str] | None = None) -> str:
    """One self-contained HTML page.

    Args:
        fits: the fits.
        reports: address of the report of a loop, by the name of the loop; for some of the loops.
    """
    import jinja2

    reports = reports or {}
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("hystfit.batch"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    listed = [row for k, row in enumerate(fits.worst(len(fits))) if k < _SHOWN or row.name in reports]
    return environment.get_template("overview.html").render(
        title=f"{fits.model} fitted to {len(fits)} loops",
        usable=fits.usable,
        advice=fits.advice,
        counts=fits.counts,
        pictures=[_picture(fits, name) for name in (*fits.names, *fits.quantities) if fits.values(name).size],
        summary=fits.summary().html(),
        rows=[_listed(row, reports) for row in listed],
        omitted=len(fits) - len(listed),
    )


def _picture(fits: Fits, name: str) -> tuple[str, str]:
    """Heading and histogram of a parameter or quantity."""
    values, unit = fits.values(name), fits.unit(name)
    heading = f"{name} [{unit}]" if unit else name
    return heading, histogram(values, heading)


def _listed(row: Row, reports: Mapping[str, str]) -> dict[str, Any]:
    """Cells of a loop in the list."""
    return {
        "name": row.name,
        "report": reports.get(row.name),
        "status": str(row.status),
        "usable": row.usable,
        "error": number(row.error_percent, ".3g"),
        "largest": number(row.max_error_percent, ".3g"),
        "reason": row.reason,
    }
