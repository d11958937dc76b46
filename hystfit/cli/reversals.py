"""`hystfit forc`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hystfit.cli.options import DEFAULT_READING, STDOUT, Loop, Output, Reading, command_words
from hystfit.cli.records import load
from hystfit.cli.write import finish, named, progress, write_csv, write_rows
from hystfit.outcome import Column, Note, Status, Table
from hystfit.outcome.table import rounded

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hystfit.data.dataset import Dataset
    from hystfit.models.preisach.forc_diagram import ForcDiagram
    from hystfit.models.preisach.forc_numbers import ForcNumbers
    from hystfit.quality.reversal_curves import ReversalFamily
    from hystfit.results.measured.forc_loop import ForcLoop

_HOW = {
    "regression": "local regression",
    "fitted": "fitted Preisach density",
    "sampled": "posterior of a Preisach density",
}


_Numbers = Mapping[str, tuple[str, float | None, float | None, str]]  # label, value, standard error and unit by name


def forc(
    *loops: Loop,
    smoothing: int = 3,
    density: Literal["regression", "fitted", "sampled"] = "regression",
    reading: Reading = DEFAULT_READING,
    output: Output = STDOUT,
) -> int:
    """Draw the FORC diagram of reversal curves and compute its key numbers.

    The file holds one curve for each reversal (--by names the column that separates them). Drift of the calibration points and unsettled
    first points are corrected if the curves show them, and reported. With --out, the folder holds pictures (forc.png, profiles.png,
    curves.png), the density (forc.csv, forc.npz), the profiles (profiles.csv) and a page (report.html).

    Args:
        smoothing: the factor SF of the regression: second-degree polynomials over (2 SF + 1) x (2 SF + 1) points.
        density: regression (local, on the curves); fitted (a Preisach density whose smoothness is chosen by cross-validation); or sampled
            (the posterior of such a density, which gives every number a standard deviation and takes minutes). A picture (compared.png)
            then shows it beside the regression.
    """
    from hystfit.models.preisach.forc_numbers import forc_numbers
    from hystfit.quality.reversal_curves import corrected_curves, reversal_curves
    from hystfit.results.measured.forc_loop import forc_loop
    from hystfit.results.provenance import provenance

    output.check()
    data = load(loops, reading)
    reversal_curves(data)  # the data are refused as they were read, not as they are corrected
    data, corrections = corrected_curves(data)
    family = reversal_curves(data)
    with progress("computing the density"):
        diagrams, status, found = _density(data, density, smoothing, rising=family.rising)
    diagram = diagrams[_HOW[density]]
    numbers, loop = forc_numbers(diagram), forc_loop(family)
    units = {symbol: data.units[symbol] for symbol in ("u", "y")}
    of_density, of_loop = numbers.numbers(units), loop.numbers()
    how = _HOW[density] + (f", smoothing factor {smoothing}" if density == "regression" else "")
    notes = [*map(str, corrections), *family.notes, *map(str, found)]
    content = {
        "schema": "hystfit.forc/2",
        "status": str(status),
        "curves": len(family.curves),
        "density": density,
        "smoothing": smoothing if density == "regression" else None,
        "units": {"input": units["u"] or None, "output": units["y"] or None},
        "numbers": _plain(of_density),
        "loop": _plain(of_loop),
        "notes": notes,
        "provenance": provenance(data, None),
    }
    tables = {"of the density": _table(of_density), "of the curves": _table(of_loop)}
    shown = [line for title, table in tables.items() for line in (title, *table.lines("  "))]
    text = "\n".join([family.words(), f"density: {how}", *shown, *(f"  - {note}" for note in notes)])

    def save(folder: Path) -> None:
        from hystfit.cli.figures import sheet
        from hystfit.cli.pages import forc_page
        from hystfit.results.preisach_plots import plot_compared

        figures = _figures(diagram, numbers, loop, family, units)
        if len(diagrams) > 1:
            figures["compared"] = sheet(5.6 * len(diagrams), 8.4)
            plot_compared(diagrams, figures["compared"], units=units)
        _write_density(folder, diagram, numbers, units)
        page = forc_page(
            family.words(), how, tables, numbers, units["u"], notes, figures, command_words(loops, reading)
        )
        page.write(folder)

    return finish(text, content, output, save, status=status)


def _density(
    data: Dataset, density: str, smoothing: int, *, rising: bool
) -> tuple[dict[str, ForcDiagram], Status, tuple[Note, ...]]:
    """Diagrams by how they were found, the status of a posterior and its notes."""
    from hystfit.fitting.fit import fit
    from hystfit.fitting.fit_model import solve_model
    from hystfit.fitting.fit_options import DEFAULT_OPTIONS
    from hystfit.models.preisach.forc_diagram import ForcDiagram, forc_diagram

    if density == "fitted":  # by the weights alone: their standard errors would take as long again
        fitted = solve_model("preisach-forc-signed:n=60", data, DEFAULT_OPTIONS).unjudged.model
        return {_HOW[density]: ForcDiagram.of_model(fitted, rising=rising)}, Status.OK, ()
    # 24 draws of the noise: their standard deviation has an error of 15 %.
    local = {_HOW["regression"]: forc_diagram(data, smoothing, repeats=24)}
    if density == "regression":
        return local, Status.OK, ()
    from hystfit.sampling.derived import sampled_density
    from hystfit.sampling.sample import sample

    # The time grows with the third power of the number of cells along an axis, and 40 took minutes.
    posterior = sample(fit("preisach-forc:n=24", data))
    return local | {_HOW[density]: sampled_density(posterior, rising=rising)}, posterior.status, posterior.notes


def _table(numbers: _Numbers) -> Table:
    """The numbers that are known, with their standard errors."""
    rows = [(label, *rounded(value, e), unit) for label, value, e, unit in numbers.values() if value is not None]
    return Table(["", Column("value"), Column("+- stderr"), Column("unit", left=True)], rows)


def _plain(numbers: _Numbers) -> dict[str, Any]:
    """The numbers for `result.json`."""
    return {
        name: {"value": value, "stderr": stderr, "unit": unit or None}
        for name, (_, value, stderr, unit) in numbers.items()
    }


def _figures(
    diagram: ForcDiagram, numbers: ForcNumbers, loop: ForcLoop, family: ReversalFamily, units: dict[str, str]
) -> dict[str, Figure]:
    from hystfit.cli.figures import sheet
    from hystfit.results.preisach_plots import plot_curves, plot_forc_diagram, plot_profiles

    sheets = {"forc": sheet(5.6, 4.4), "profiles": sheet(5.6, 7.2), "curves": sheet(5.6, 4.4)}
    plot_forc_diagram(diagram, sheets["forc"].subplots(), units=units)
    plot_profiles(numbers, sheets["profiles"].subplots(3), units=units)
    ax = plot_curves(family.curves, ax=sheets["curves"].subplots(), every=max(1, len(family.curves) // 40))
    ax.plot(loop.loop.u, loop.loop.y, color="black", lw=0.9, label="major loop")
    ax.legend(frameon=False)
    return sheets


def _write_density(folder: Path, diagram: ForcDiagram, numbers: ForcNumbers, units: dict[str, str]) -> None:
    import numpy as np

    u, known = units["u"], np.isfinite(diagram.density)
    reversal, field = np.meshgrid(diagram.reversal, diagram.field, indexing="ij")
    columns = {"reversal": reversal, "field": field}
    columns |= {"coercivity": diagram.coercivity, "interaction": diagram.interaction}
    listed = {named(name, u): values[known] for name, values in columns.items()} | {"density": diagram.density[known]}
    grid = {"reversal": diagram.reversal, "field": diagram.field, "density": diagram.density}
    if diagram.stderr is not None:
        listed["stderr"], grid["stderr"] = diagram.stderr[known], diagram.stderr
    write_csv(folder / "forc.csv", listed, ".9g")
    np.savez_compressed(folder / "forc.npz", **grid)
    profiles = (
        (name, *row)
        for name, one in numbers.profiles.items()
        for row in zip(one.x, one.values, [None] * one.x.size if one.stderr is None else one.stderr, strict=True)
    )
    write_rows(folder / "profiles.csv", ["profile", named("field", u), "value", "stderr"], profiles, ".9g")
