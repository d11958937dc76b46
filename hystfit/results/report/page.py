"""The report on a fit as one HTML page with its pictures, in a notebook, and as files in a folder."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hystfit.data.record import Dataset, Record
from hystfit.outcome import fragment
from hystfit.results.plots import fit as draw
from hystfit.results.plots import grouped
from hystfit.results.report.tables import fixed_words, metrics_table, parameter_table, quantity_table
from hystfit.results.report.text_report import ERRORS, QUANTITIES_OF, facts, headline, remarks, text_report, verdict
from hystfit.results.result import FitResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    Data = Record | Dataset | Sequence[Record]

_DPI = 150


def pictures(result: FitResult, *, test: Data | None = None, refit_offset: bool = False) -> dict[str, Figure]:
    """Figures by file name, made without global state of matplotlib."""
    from matplotlib.figure import Figure

    def sheet(width: float, height: float, count: int = 1) -> tuple[Figure, Any]:
        figure = Figure(figsize=(width, height), layout="constrained")
        return figure, figure.subplots(1, count)

    figures: dict[str, Figure] = {}
    figures["loop"], ax = sheet(6.4, 4.8)
    draw(result, "loop", ax)
    figures["series"], ax = sheet(9.6, 3.4)
    draw(result, "series", ax)
    figures["residuals"], axes = sheet(9.6, 3.4, 2)
    draw(result, "residuals", axes[0])
    draw(result, "residuals-input", axes[1])
    figures["autocorrelation"], ax = sheet(6.4, 3.2)
    draw(result, "autocorrelation", ax)
    count = sum(not family[0].fixed for _, family in grouped(result.parameters))
    figures["parameters"], ax = sheet(6.4, min(12.0, 1.2 + 0.3 * count))
    draw(result, "parameters", ax)
    if test is not None:
        figures["test"], axes = sheet(9.6, 3.8, 2)
        draw(result, "loop", axes[0], data=test, refit_offset=refit_offset)
        draw(result, "series", axes[1], data=test, refit_offset=refit_offset)
    return figures


_CAPTIONS = {
    "loop": "Measured loop and model",
    "test": "Test data (not fitted)",
    "series": "Measured and simulated output",
    "residuals": "Residuals",
    "autocorrelation": "Autocorrelation of the residuals",
    "parameters": "Relative standard errors",
}


def html_report(result: FitResult, *, test: Data | None = None, refit_offset: bool = False) -> str:
    """One self-contained HTML page with its pictures."""
    figures = pictures(result, test=test, refit_offset=refit_offset)
    return _page(result, {name: _png(figure) for name, figure in figures.items()})


def notebook_view(result: FitResult) -> str:
    """The report as notebooks show it: status, tables and notes, without pictures."""
    advice = "" if result.usable else result.advice
    numbers = (QUANTITIES_OF, quantity_table(result))
    tables = (ERRORS, metrics_table(result), *numbers, parameter_table(result), fixed_words(result))
    return fragment(headline(result), (advice, *tables, result.notes))


def _page(result: FitResult, images: dict[str, bytes]) -> str:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("hystfit.results"), autoescape=True, trim_blocks=True, lstrip_blocks=True
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
        errors=ERRORS,
        metrics=metrics_table(result).html(),
        parameters=parameter_table(result, meaning=True).html(),
        fixed=fixed_words(result),
        quantities_of=QUANTITIES_OF,
        quantities=quantity_table(result, meaning=True).html(),
        verdict=[str(note) for note in verdict(result)],
        notes=[str(note) for note in remarks(result)],
        facts=facts(result),
        pictures=shown,
    )


def _width(png: bytes) -> int:
    """Width at which a picture reads well [CSS pixels]: PNG's header holds it in device pixels."""
    return int.from_bytes(png[16:20], "big") * 96 // _DPI


def _png(figure: Figure) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    buffer = io.BytesIO()
    figure.dpi = _DPI
    FigureCanvasAgg(figure).print_png(buffer)  # `savefig` draws everything twice
    return buffer.getvalue()


def _svg(figure: Figure, path: Path) -> None:
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    figure.set_layout_engine("none")  # as laid out for the PNG
    with path.open("w", encoding="utf-8") as file:
        FigureCanvasSVG(figure).print_svg(file)


def write(result: FitResult, folder: str | Path, *, test: Data | None = None, refit_offset: bool = False) -> Path:
    """Write report.html, report.txt and the pictures (.png, .svg) into a folder; all of them or none.

    Args:
        result: the fit.
        folder: made if it does not exist.
        test: records that were not fitted, for a picture of their own.
        refit_offset: shift the prediction of each test record to its mean.

    Raises:
        HystfitError: the folder cannot be made or written.
    """
    from hystfit.results.folders import writing

    with writing(folder) as scratch:
        write_into(result, scratch, test=test, refit_offset=refit_offset)
    return Path(folder)


def write_into(result: FitResult, folder: Path, *, test: Data | None = None, refit_offset: bool = False) -> None:
    """Write the files of `write` into an existing folder."""
    figures = pictures(result, test=test, refit_offset=refit_offset)
    images = {name: _png(figure) for name, figure in figures.items()}
    (folder / "report.html").write_text(_page(result, images), encoding="utf-8")
    (folder / "report.txt").write_text(text_report(result), encoding="utf-8")
    for name, figure in figures.items():
        (folder / f"{name}.png").write_bytes(images[name])
        _svg(figure, folder / f"{name}.svg")
