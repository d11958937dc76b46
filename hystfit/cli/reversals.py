"""`hystfit forc`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hystfit.cli.options import DEFAULT_READING, STDOUT, Loop, Output, Reading, command_words
from hystfit.cli.records import load
from hystfit.cli.write import finish, named, progress, write_csv
from hystfit.outcome import Column, Status, Table
from hystfit.outcome.table import number

if TYPE_CHECKING:
    from hystfit.models.preisach.forc import ForcDiagram, ForcNumbers
    from hystfit.quality.reversal_curves import ReversalFamily

_SHOWN = 40  # curves in the picture at most


def forc(
    *loops: Loop,
    smoothing: int = 3,
    density: Literal["regression", "fitted"] = "regression",
    reading: Reading = DEFAULT_READING,
    output: Output = STDOUT,
) -> int:
    """Draw the FORC diagram of reversal curves and compute its key numbers.

    The file holds one curve for each reversal (--by names the column that separates them). With --out, the folder holds the picture
    (forc.png), the density (forc.csv, forc.npz), the coercivity distribution (coercivity.csv) and a page (report.html).

    Args:
        smoothing: the factor SF of the regression: second-degree polynomials over (2 SF + 1) x (2 SF + 1) points.
        density: by local regression on the curves, or fitted: a Preisach density whose smoothness is chosen by curves left out.
    """
    from hystfit.models.preisach.forc import density_of, fit_forc, forc_diagram, forc_numbers
    from hystfit.quality.reversal_curves import reversal_curves
    from hystfit.results.provenance import provenance

    output.check()
    data = load(loops, reading)
    family = reversal_curves(data)
    with progress("computing the density"):
        if density == "fitted":
            diagram = density_of(fit_forc(data, nonnegative=False).model, rising=family.rising)
        else:
            diagram = forc_diagram(data, smoothing)
    numbers, units = forc_numbers(diagram), data.units
    how = f"local regression, smoothing factor {smoothing}" if density == "regression" else "fitted Preisach density"
    content = {
        "schema": "hystfit.forc/1",
        "status": str(Status.OK),
        "curves": len(family.curves),
        "density": density,
        "smoothing": smoothing if density == "regression" else None,
        "units": {"input": units["u"] or None, "output": units["y"] or None},
        "numbers": numbers.to_dict(),
        "notes": list(family.notes),
        "provenance": provenance(data, None),
    }
    table = _table(numbers, units)
    text = "\n".join([family.words(), f"density: {how}", *table.lines("  "), *(f"  - {note}" for note in family.notes)])

    def save(folder: Path) -> None:
        from hystfit.cli.pages import forc_page

        figures = _figures(diagram, numbers, family, units)
        _write_density(folder, diagram, numbers, units)
        loop = command_words(loops, reading)
        page = forc_page(family.words(), how, table, numbers, units["u"], family.notes, figures, loop)
        (folder / "report.html").write_text(page.render(), encoding="utf-8")
        for name, figure in figures.items():
            figure.savefig(folder / f"{name}.png", dpi=120)

    return finish(text, content, output, save)


def _table(numbers: ForcNumbers, units: dict[str, str]) -> Table:
    u, y = units["u"], units["y"]
    rows = [
        ("coercivity of the peak", number(numbers.peak[0]), u),
        ("interaction of the peak", number(numbers.peak[1]), u),
        ("median coercivity", number(numbers.median_coercivity), u),
        ("width of the coercivity distribution at half height", number(numbers.width), u),
        ("mean interaction of the ridge", number(numbers.ridge), u),
        ("standard deviation of the interaction", number(numbers.ridge_width), u),
        ("integral of the density", number(numbers.total), y),
        ("negative part", number(numbers.negative_percent, ".3g"), "%"),
    ]
    return Table(["", Column("value"), Column("unit", left=True)], rows)


def _figures(
    diagram: ForcDiagram, numbers: ForcNumbers, family: ReversalFamily, units: dict[str, str]
) -> dict[str, Any]:
    """Diagram, coercivity distribution and curves."""
    from matplotlib.figure import Figure

    from hystfit.params.units import axis_label
    from hystfit.results.colors import MODEL, SECOND
    from hystfit.results.preisach_plots import per_unit, plot_curves, plot_forc_diagram

    sheets = {name: Figure(figsize=(5.6, 4.4), layout="constrained") for name in ("forc", "coercivity", "curves")}
    plot_forc_diagram(diagram, sheets["forc"].subplots(), units=units)
    ax = sheets["coercivity"].subplots()
    ax.plot(numbers.coercivity, numbers.distribution, color=MODEL)
    ax.axvline(numbers.median_coercivity, color=SECOND, lw=0.9, ls="--", label="median")
    ax.axhline(0.0, color="black", lw=0.7)
    ax.set(xlabel=axis_label("coercivity", units["u"]))
    ax.set_ylabel(axis_label("density over the interaction", per_unit(units["y"], units["u"])))
    ax.legend(frameon=False)
    plot_curves(family.curves, ax=sheets["curves"].subplots(), every=max(1, len(family.curves) // _SHOWN))
    return sheets


def _write_density(folder: Path, diagram: ForcDiagram, numbers: ForcNumbers, units: dict[str, str]) -> None:
    import numpy as np

    u, known = units["u"], np.isfinite(diagram.density)
    reversal, field = np.meshgrid(diagram.reversal, diagram.field, indexing="ij")
    columns = {"reversal": reversal, "field": field}
    columns |= {"coercivity": diagram.coercivity, "interaction": diagram.interaction}
    listed = {named(name, u): values[known] for name, values in columns.items()}
    write_csv(folder / "forc.csv", listed | {"density": diagram.density[known]}, ".9g")
    np.savez_compressed(folder / "forc.npz", reversal=diagram.reversal, field=diagram.field, density=diagram.density)
    distribution = {named("coercivity", u): numbers.coercivity, "density": numbers.distribution}
    write_csv(folder / "coercivity.csv", distribution, ".9g")
