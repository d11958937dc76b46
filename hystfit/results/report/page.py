"""The report on a fit as one HTML page with its pictures, in a notebook, and as files in a folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.outcome import fragment
from hystfit.results.estimates import grouped
from hystfit.results.measured.loop_values import MEASURED
from hystfit.results.plots import draw
from hystfit.results.record_plots import selects_cycles, traces_of
from hystfit.results.report.answer import Wording, answer
from hystfit.results.report.tables import fixed_words, metrics_table, parameter_table, quantity_table, unit_words
from hystfit.results.report.text_report import ERRORS, facts, headline, quantities_of, remarks, text_report, verdict
from hystfit.results.result import FitResult
from hystfit.results.webpage import Page, Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    Data = Record | Dataset | Sequence[Record]

_CAPTIONS = {
    "loop": "Measured loop and model",
    "cycle-errors": "Residuals (measured minus model) of these cycles over the input",
    "series": "Measured and simulated output over time",
    "worst": "Part of the record with the largest persistent error",
    "residuals": "Residuals (measured minus model) over time",
    "residuals-input": "Residuals over the input",
    "autocorrelation": "Autocorrelation of the residuals",
    "parameters": "Standard error of each parameter, in percent of its value",
    "weights": "Weights of the plays or stops over their thresholds",
    "density": "Preisach density; hatched: cells that no fitted sample switches",
    "test": "Test data (not fitted): loop",
    "test-series": "Test data (not fitted): output",
}


def pictures(result: FitResult, *, test: Data | None = None, refit_offset: bool = False) -> dict[str, Figure]:
    """Figures by file name, made without global state of matplotlib."""
    from matplotlib.figure import Figure

    traces = traces_of(result, None, False)
    kinds = ["loop", "cycle-errors"] if selects_cycles(traces) else ["loop"]
    kinds += ["series", "worst"] if sum(map(len, result.data)) > 600 else ["series"]  # samples that one picture shows
    kinds += ["residuals", "residuals-input", "autocorrelation", "parameters"]
    kinds += ["weights"] if result.model.plays() else []
    kinds += ["density"] if result.model.plane() is not None else []
    wanted = [(kind, kind, traces) for kind in kinds]
    if test is not None:
        held = traces_of(result, test, refit_offset)
        wanted += [("test", "loop", held), ("test-series", "series", held)]
    figures: dict[str, Figure] = {}
    count = len(grouped([p for p in result.parameters if not p.fixed]))
    for name, kind, shown in wanted:
        height = min(12.0, max(2.4, 1.2 + 0.3 * count)) if kind == "parameters" else 4.0
        figures[name] = Figure(figsize=(5.6, height), layout="constrained")
        draw(result, kind, figures[name].subplots(), shown)
    return figures


def html_report(result: FitResult, *, wording: Wording | None = None) -> str:
    """One self-contained HTML page with its pictures."""
    return _page(result, _captioned(pictures(result)), wording or Wording())


def notebook_view(result: FitResult) -> str:
    """The report as notebooks show it: status, tables and notes, without pictures."""
    advice = "" if result.usable else result.advice
    numbers = (quantities_of(result), quantity_table(result))
    tables = (ERRORS, metrics_table(result), *numbers, parameter_table(result), fixed_words(result))
    return fragment(headline(result), (advice, *tables, result.notes))


def _captioned(figures: dict[str, Figure]) -> dict[str, Picture]:
    return {name: Picture(figures[name], caption, name=name) for name, caption in _CAPTIONS.items() if name in figures}


def _page(result: FitResult, shown: dict[str, Picture], wording: Wording) -> str:
    status = "Usable." if result.usable else f"Not usable as it is: {wording.translate(result.advice)}."
    in_words = lambda texts: [wording.translate(str(text)) for text in texts]
    sections = [
        ("Verdict", [in_words(verdict(result))]),
        ("Plots", [list(shown.values())]),
        *([(quantities_of(result), [quantity_table(result, meaning=True)])] if result.quantities else []),
        *([(MEASURED, [result.measured.table()])] if any(result.measured.rows.values()) else []),
        (ERRORS, [metrics_table(result)]),
        ("Parameters", [parameter_table(result, meaning=True), *in_words([fixed_words(result), unit_words(result)])]),
        ("Notes", [in_words(remarks(result))]),
        *((heading, [in_words(items)]) for heading, items in facts(result).items()),
    ]
    return Page(headline(result), status, result.usable, answer(result, wording), sections).render()


def write(
    result: FitResult,
    folder: str | Path,
    *,
    test: Data | None = None,
    refit_offset: bool = False,
    wording: Wording | None = None,
) -> Path:
    """Write report.html, report.txt and the pictures (.png, .svg) into a folder; all of them or none."""
    from hystfit.results.saving.folders import writing

    with writing(folder) as scratch:
        write_into(result, scratch, test=test, refit_offset=refit_offset, wording=wording)
    return Path(folder)


def write_into(
    result: FitResult,
    folder: Path,
    *,
    test: Data | None = None,
    refit_offset: bool = False,
    wording: Wording | None = None,
    files: bool = True,
) -> None:
    """Write the files of `write` into an existing folder, with its arguments; without `files`, no pictures beside those of the page."""
    wording = wording or Wording()
    shown = _captioned(pictures(result, test=test, refit_offset=refit_offset))
    (folder / "report.txt").write_text(text_report(result, wording), encoding="utf-8")
    for name, picture in shown.items() if files else ():
        picture.write_png(folder)
        (folder / f"{name}.svg").write_bytes(picture.svg)
    (folder / "report.html").write_text(_page(result, shown, wording), encoding="utf-8")
