"""The pages that verbs write beside their result.json, all in the style of the report on a fit."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hystfit.cli.verbs import as_options
from hystfit.outcome import Note, Status, Table
from hystfit.outcome.table import number
from hystfit.params.units import axis_label
from hystfit.results.labels import column_label
from hystfit.results.plots import MEASURED, MODEL
from hystfit.results.quantities import QUANTITIES
from hystfit.results.report.answer import Wording, loops_of, next_commands, opened
from hystfit.results.webpage import Block, Page, Picture

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

    from hystfit.control.bands import InverseBands
    from hystfit.control.inverse import Inverse
    from hystfit.data.record import Record
    from hystfit.fitting.comparison import Comparison
    from hystfit.results.result import FitResult
    from hystfit.sampling.posterior import Posterior
    from hystfit.uncertainty.calibration import Calibration
    from hystfit.uncertainty.input_design import Design
    from hystfit.uncertainty.profiles import Profiles


def page_of(
    title: str,
    status: Status | str,
    verb: str,
    answer: Sequence[tuple[str, str]],
    sections: Sequence[tuple[str, Sequence[Block]]],
) -> Page:
    """A page whose status is explained in the words of its verb.

    Args:
        title: one line.
        status: of the result.
        verb: that made it.
        answer: names and values at the top.
        sections: heading and blocks of each.
    """
    status = Status(status)
    words = "Usable." if status.usable else f"Not usable as it is: {as_options(status.advice(verb))}."
    return Page(title, words, status.usable, answer, sections)


def notes_of(notes: Sequence[Note]) -> list[str]:
    """Notes in the words of the shell."""
    return [as_options(str(note)) for note in notes]


def forc_page(
    title: str,
    how: str,
    table: Table,
    numbers: Any,
    units: Mapping[str, str],
    notes: Sequence[str],
    figures: Mapping[str, Any],
    loop: str,
) -> Page:
    """The page of `hystfit forc`.

    Args:
        title: the curves in words.
        how: the density was found.
        table: all numbers.
        numbers: `ForcNumbers`.
        units: of the curves.
        notes: on the curves.
        figures: forc, coercivity and curves.
        loop: the file with the options for reading it, quoted.
    """
    unit = units["u"]
    answer = [
        ("Median coercivity", f"{number(numbers.median_coercivity)} {unit}".rstrip()),
        ("Interaction of the ridge", f"{number(numbers.ridge)} {unit}".rstrip()),
        ("Density", how),
        ("Next", f"hystfit fit {loop} --model preisach-forc --out fit"),
    ]
    captions = {
        "forc": f"FORC diagram ({how}); red: positive, blue: negative; contour lines of the smoothed density",
        "coercivity": "Coercivity distribution: the density integrated over the interaction",
        "curves": "Reversal curves",
    }
    shown = [Picture(figures[name], caption) for name, caption in captions.items()]
    return page_of(
        title, Status.OK, "forc", answer, [("Plots", [shown]), ("Numbers", [table]), ("Notes", [list(notes)])]
    )


def compare_page(comparison: Comparison, folder: Path) -> Page:
    """The page of `hystfit compare`, written into a folder: the ranking, and the loop of the winner."""
    winner, best = comparison.winner, comparison.rows[0]
    wording = Wording(translate=as_options).at(folder / "winner")
    answer = [
        ("Winner", best.name),
        ("Cross-validation error", f"{number(best.score_percent, '.3g')} % of the range"),
        ("Full report of its fit", "winner/report.html"),
        ("Next", "\n".join(next_commands(winner, wording))),
    ]
    figures = (
        ("loop", "Winner: measured loop and model"),
        ("residuals-input", "Winner: residuals (measured minus model)"),
    )
    shown = [Picture(_of_fit(winner, kind), caption) for kind, caption in figures]
    sections = [
        ("Ranking", [comparison.table(), *comparison.explanations()]),
        ("Errors of all models", [[Picture(_ranking(comparison), "Cross-validation error and error on the fitted samples")]]),
        ("Remarks", [comparison.remarks()]),
        ("Plots", [shown]),
    ]  # fmt: skip
    title = f"{len(comparison.rows)} models compared on {winner.data.name or winner.data[0].name}"
    return page_of(title, winner.status, "fit", answer, sections)


def _of_fit(result: FitResult, kind: str) -> Figure:
    from hystfit.results.plots import fit as draw

    figure = _sheet()
    draw(result, kind, figure.subplots())
    return figure


def _sheet(width: float = 5.6, height: float = 4.0) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _ranking(comparison: Comparison) -> Figure:
    """Errors of all models that have one, the best at the top."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    rows = [row for row in comparison.rows if row.score_percent is not None]
    figure = _sheet(5.6, 1.4 + 0.32 * len(rows))
    ax = figure.subplots()
    for k, row in enumerate(rows):
        ax.plot(row.score_percent, k, "o", color="#0072b2", label="cross-validation" if k == 0 else None)
        if row.in_sample_percent is not None:
            ax.plot(
                row.in_sample_percent, k, "o", mfc="none", color="#d55e00", label="fitted samples" if k == 0 else None
            )
    ax.set_yticks(range(len(rows)), [row.name for row in rows], fontsize=8)
    ax.set(xscale="log", xlabel="error [% of the range]")
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.invert_yaxis()
    ax.grid(axis="x", color="0.9", which="both")
    figure.legend(fontsize=8, frameon=False, ncols=2, loc="outside upper center")
    return figure


def sample_page(posterior: Posterior, folder: Path) -> Page:
    """The page of `hystfit sample`, written into a folder: parameters and quantities with intervals, and the pictures of the draws."""
    rows = posterior.derived_rows
    interval = lambda row: (
        f"{number(row['median'])} ({number(row['lower'])} to {number(row['upper'])}) {row['unit']}".rstrip()
    )
    answer = [(QUANTITIES[row["name"]].label.capitalize(), interval(row)) for row in rows]
    chains, draws, _ = posterior.draws.shape
    answer += [("Draws", f"{chains} chains of {draws} by {posterior.sampler}, noise {posterior.noise}")]
    at = lambda place: opened(posterior.result, shlex.quote(str(place)))
    commands = [f"hystfit profile {at(folder / 'fit')}"]
    if posterior.result.model.obstacle("inverse") is None:
        commands.insert(0, f"hystfit invert {at(folder)} REFERENCE")
    answer += [("Next", "\n".join(commands))]
    captions = {
        "corner": "Joint distributions of the parameters; contours contain 50 and 90 % of the draws",
        "bands": "Loop, and output over time with 90 % bands: model output (blue), new measurement (orange)",
        "trace": "Draws of each chain",
        "rank": "Ranks of the draws of each chain; flat histograms mean that the chains agree",
    }
    shown = [Picture(posterior.plot(kind), caption, wide=kind == "corner") for kind, caption in captions.items()]
    sections = [
        ("Parameters", [posterior.summary()]),
        ("Derived quantities (median and 95 % interval)", [posterior.derived_table()]),
        ("Plots", [shown]),
        ("Notes", [notes_of(posterior.notes)]),
        ("Priors", [[f"{name}: {text}" for name, text in posterior.priors.items()]]),
    ]
    title = f"Posterior of {posterior.result.name} on {posterior.result.data[0].name}"
    return page_of(title, posterior.status, "sample", answer, sections)


def profile_page(profiles: Profiles, fit: Path) -> Page:
    """The page of `hystfit profile`."""
    level = f"{100 * profiles.level:.0f} %"
    answer = [(f"{p.name} ({level} limits)", str(p).partition(": ")[2]) for p in list(profiles.profiles.values())[:12]]
    answer += [("Noise", profiles.noise), ("Next", f"hystfit sample {opened(profiles.result, shlex.quote(str(fit)))}")]
    figure = Picture(
        profiles.plot(), "Likelihood profiles with confidence limits; dashed: parabola of the standard error", wide=True
    )
    sections = [("Plots", [[figure]]), ("All limits", [list(map(str, profiles.profiles.values()))])]
    title = f"{level} limits of {profiles.result.name} by profile likelihood"
    return page_of(title, profiles.status, "profile", answer, [*sections, ("Notes", [notes_of(profiles.notes)])])


def calibrate_page(calibration: Calibration, _: Path) -> Page:
    """The page of `hystfit calibrate`."""
    head = str(calibration).partition("\n")[0]
    low, high = calibration.coverage_band() if len(calibration.ranks) else (None, None)
    answer = [("Replicates", f"{len(calibration.ranks)}, {len(calibration.failures)} failed")]
    if low is not None and high is not None:
        answer += [("Coverage consistent with 95 %", f"{100 * low:.1f} % to {100 * high:.1f} %")]
    caption = "Top: ranks of the true values among the draws. Bottom: coverage; gray: 99 % range of chance"
    shown = [[Picture(calibration.plot(), caption, wide=True)]] if len(calibration.ranks) else []
    failures = [f"replicate {k} failed: {why}" for k, why in calibration.failures[:10]]
    sections = [
        ("Coverage", [calibration.table()]),
        ("Plots", shown),
        ("Remarks", [[*failures, *calibration.broken]]),
    ]
    return page_of(head.rpartition(":")[0], calibration.status, "calibrate", answer, sections)


def design_page(proposal: Design, folder: Path) -> Page:
    """The page of `hystfit design`, written into a folder: the input over time, and the errors that it leaves."""
    best, record = proposal.best, proposal.result.data[0]
    aims = proposal.families(proposal.aim)
    answer = [("Proposed input", best.name), ("Aim", ", ".join(aims))]
    for name, members in list(aims.items())[:4]:
        now, then = proposal.median(proposal.present, members), proposal.median(best.stderr, members)
        known = lambda value: "not determined" if value is None else number(value, ".3g")
        answer.append((f"Standard error of {name}", f"{known(now)} now, {known(then)} with the proposed input"))
    command = (
        f"hystfit fit NEW_LOOP {loops_of(proposal.result.data)} --model {shlex.quote(proposal.result.name)} --out fit"
    )
    answer.append(("Next", f"measure with {folder / 'input.csv'}, then fit both records:\n{command}"))
    figure = _sheet()
    ax = figure.subplots()
    axis = np.arange(best.u.size) * (proposal.dt or 1.0)
    ax.plot(axis, best.u, color=MODEL, lw=0.9)
    column_label(ax, "y", record.u_name, record.u_unit, "input")
    ax.set_xlabel("sample" if proposal.dt is None else axis_label("time", record.t_unit))
    shown = [
        Picture(figure, f"Proposed input ({best.name})"),
        Picture(_gains(proposal), "Predicted standard errors, relative to the present ones"),
    ]
    sections = [
        ("Plots", [shown]),
        ("Predicted standard errors", [proposal.table()]),
        ("Notes", [notes_of(proposal.notes)]),
    ]
    return page_of(f"Next input for {proposal.result.name}", proposal.status, "design", answer, sections)


def _gains(proposal: Design) -> Figure:
    """Errors with each candidate relative to those of the present data."""
    families = {name: m for name, m in proposal.families(proposal.aim).items() if proposal.median(proposal.present, m)}
    names = list(families)
    figure = _sheet(5.6, 1.6 + 0.3 * len(names))
    ax = figure.subplots()
    for candidate, marker, color in zip(
        proposal.candidates[:4], "os^D", (MODEL, "#d55e00", "#009e73", "#4d4d4d"), strict=False
    ):
        ratio = [
            (proposal.median(candidate.stderr, m) or np.nan) / (proposal.median(proposal.present, m) or np.nan)
            for m in families.values()
        ]
        ax.plot(ratio, range(len(names)), marker, color=color, ls="none", label=candidate.name)
    ax.axvline(1.0, color="black", lw=0.7)
    ax.set_yticks(range(len(names)), names)
    ax.set(xlabel="predicted / present standard error")
    ax.invert_yaxis()
    figure.legend(fontsize=8, frameon=False, ncols=2, loc="outside upper center")
    return figure


def invert_page(title: str, content: Mapping[str, Any], lines: Sequence[str], figure: Figure, following: str) -> Page:
    """The page of `hystfit invert`.

    Args:
        title: model and reference.
        content: of result.json.
        lines: what the verb prints, below its headline.
        figure: reference, output and input.
        following: the next command.
    """
    unit, reach = content["units"]["input"] or "", content["input"]
    missed = {name: count for name, count in content["counts"].items() if count and name != "ok"}
    answer = [
        ("Input", f"{number(reach['lowest'])} to {number(reach['highest'])} {unit}".rstrip()),
        ("Reference reached", f"{content['counts']['ok']} of {sum(content['counts'].values())} samples"),
        ("Not reached", ", ".join(f"{count} {name}" for name, count in missed.items()) or "none"),
        ("Next", following),
    ]
    shown = [
        Picture(figure, "Top: reference and output of the model. Middle: input. Bottom: tracking error", wide=True)
    ]
    words = [as_options(line.strip().removeprefix("- ")) for line in lines]
    return page_of(title, content["status"], "invert", answer, [("Plots", [shown]), ("Remarks", [words])])


def inverse_figure(target: Record, inverse: Inverse, bands: InverseBands | None, unit: str) -> Figure:
    """Reference and output, input, and tracking error over time; filled bands of posterior draws.

    Args:
        target: the reference.
        inverse: of the fitted model.
        bands: over posterior draws; None without a posterior.
        unit: of the input.
    """
    figure = _sheet(8.4, 6.4)
    axis = np.arange(len(target)) if target.t is None else target.t
    above, middle, below = figure.subplots(3, 1, sharex=True, height_ratios=(2, 2, 1))
    above.plot(axis, target.y, color=MEASURED, lw=2.6, label="reference")
    above.plot(axis, inverse.y, color=MODEL, lw=0.9, label="output of the model")
    missed = inverse.codes != 0
    above.plot(
        axis[missed], inverse.y[missed], ".", ms=4, color="#d55e00", label="not reached" if missed.any() else None
    )
    middle.plot(axis, inverse.u, color=MODEL, lw=0.9)
    below.plot(axis, inverse.y - target.y, color=MODEL, lw=0.9)
    for ax, of in ((middle, "u"), (below, "error")):
        if bands is not None:
            low, _, high = bands.band(of)
            ax.fill_between(axis, low, high, color="#e69f00", alpha=0.5, lw=0, label="90 % of the draws")
            ax.legend(frameon=False, fontsize=8)
    column_label(above, "y", target.y_name, target.y_unit, "output")
    middle.set_ylabel(axis_label("input", unit))
    below.set_ylabel(axis_label("error", target.y_unit))
    below.set_xlabel("sample" if target.t is None else axis_label("time", target.t_unit))
    above.legend(frameon=False, fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure
