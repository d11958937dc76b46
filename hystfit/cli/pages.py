"""The pages that verbs write beside their result.json, all in the style of the report on a fit."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from hystfit.cli.figures import fit_figure, gain_figure, input_figure, ranking_figure
from hystfit.cli.verbs import as_options
from hystfit.outcome import Note, Status, Table
from hystfit.outcome.table import number
from hystfit.results.measured.quantities import QUANTITIES
from hystfit.results.report.answer import Wording, loops_of, next_commands, opened
from hystfit.results.webpage import Block, Markup, Page, Picture, link

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

    from hystfit.fitting.comparison.compared_models import Comparison
    from hystfit.models.preisach.forc_numbers import ForcNumbers
    from hystfit.sampling.posterior import Posterior
    from hystfit.uncertainty.calibration import Calibration
    from hystfit.uncertainty.input_design import Design
    from hystfit.uncertainty.profiles import Profiles


def page_of(
    title: str,
    status: Status | str,
    verb: str,
    answer: Sequence[tuple[str, str | Markup]],
    sections: Sequence[tuple[str, Sequence[Block]]],
) -> Page:
    """A page whose status is explained in the words of its verb."""
    status = Status(status)
    words = "Usable." if status.usable else f"Not usable as it is: {as_options(status.advice(verb))}."
    return Page(title, words, status.usable, answer, sections)


def notes_of(notes: Sequence[Note]) -> list[str]:
    """Notes in the words of the shell."""
    return [as_options(str(note)) for note in notes]


def forc_page(
    title: str,
    how: str,
    tables: Mapping[str, Table],
    numbers: ForcNumbers,
    u_unit: str,
    notes: Sequence[str],
    figures: Mapping[str, Figure],
    loop: str,
) -> Page:
    """The page of `hystfit forc`; `how` the density was found, and the `loop` with its options, quoted for a shell."""
    answer = [
        ("Median coercivity", f"{number(numbers.values['median_coercivity'])} {u_unit}".rstrip()),
        ("Interaction of the peak", f"{number(numbers.values['peak_interaction'])} {u_unit}".rstrip()),
        ("Density", how),
        ("Next", f"hystfit fit {loop} --model preisach-forc --out fit"),
    ]
    captions = {
        "forc": f"FORC diagram ({how}); red: positive, blue: negative; contour lines of the smoothed density",
        "profiles": "Coercivity distribution (the density integrated over the interaction), and profiles through the peak",
        "curves": "Reversal curves, and the major loop that they contain",
        "compared": "Densities by local regression and as the posterior of a model; coercivity distributions with two standard errors",
    }
    shown = [Picture(figures[name], caption, name=name) for name, caption in captions.items() if name in figures]
    sections = [("Plots", [shown]), *((f"Numbers {of}", [table]) for of, table in tables.items())]
    sections.append(("Notes", [list(notes)]))
    return page_of(title, Status.OK, "forc", answer, sections)


def compare_page(comparison: Comparison, folder: Path) -> Page:
    """The page of `hystfit compare`, written into a folder: the ranking, and the loop of the winner."""
    winner, best = comparison.winner, comparison.rows[0]
    wording = Wording(translate=as_options).at(folder / "winner")
    answer = [
        ("Winner", best.name),
        ("Cross-validation error", f"{number(best.score_percent, '.3g')} % of the range"),
        ("Full report of its fit", link("winner/report.html", "winner/report.html")),
        ("Next", "\n".join(next_commands(winner, wording))),
    ]
    errors = Picture(ranking_figure(comparison), "Cross-validation error and error on the fitted samples")
    shown = [
        Picture(fit_figure(winner, "loop"), "Winner: measured loop and model"),
        Picture(fit_figure(winner, "residuals-input"), "Winner: residuals (measured minus model)"),
    ]
    sections = [
        ("Ranking", [comparison.table(), *comparison.explanations()]),
        ("Errors of all models", [[errors]]),
        ("Remarks", [comparison.remarks()]),
        ("Plots", [shown]),
    ]
    title = f"{len(comparison.rows)} models compared on {winner.data.name or winner.data[0].name}"
    return page_of(title, winner.status, "fit", answer, sections)


def sample_page(posterior: Posterior, folder: Path) -> Page:
    """The page of `hystfit sample`, written into a folder: parameters and quantities with intervals, and the pictures of the draws."""
    from hystfit.sampling.posterior import CHECKS

    answer = []
    for row in posterior.derived_rows:
        interval = f"{number(row['median'])} (95 %: {number(row['lower'])} to {number(row['upper'])}) {row['unit']}"
        answer.append((QUANTITIES[row["name"]].label_on(posterior.result.data).capitalize(), interval.rstrip()))
    chains, draws, _ = posterior.draws.shape
    answer += [("Draws", f"{chains} chains of {draws} by {posterior.sampler}, noise {posterior.noise}")]
    at = lambda place: opened(posterior.result, shlex.quote(str(place)))
    commands = [f"hystfit profile {at(folder / 'fit')}"]
    if posterior.result.obstacle("inverse") is None:
        commands.insert(0, f"hystfit invert {at(folder)} REFERENCE")
    answer += [("Next", "\n".join(commands))]
    captions = {
        "corner": "Joint distributions of the parameters; contours contain 50 and 90 % of the draws",
        "bands": "Loop, and output over time with 90 % bands: model output (blue), new measurement (orange)",
        "trace": "Draws of each chain",
        "rank": "Ranks of the draws of each chain; flat histograms mean that the chains agree",
    }
    wide = ("corner", "bands")
    shown = [Picture(posterior.plot(kind), caption, wide=kind in wide, name=kind) for kind, caption in captions.items()]
    sections = [
        ("Parameters", [posterior.summary(), CHECKS]),
        ("Derived quantities (median and 95 % interval)", [posterior.derived_table()]),
        ("Plots", [shown]),
        ("Sensitivity of the posterior", _sensitivity_blocks(posterior)),
        ("Notes", [notes_of(posterior.notes)]),
        ("Priors", [[f"{name}: {text}" for name, text in posterior.priors.items()]]),
    ]
    title = f"Posterior of {posterior.result.name} on {posterior.result.data[0].name}"
    return page_of(title, posterior.status, "sample", answer, sections)


def _sensitivity_blocks(posterior: Posterior) -> list[Block]:
    """Prior against data, influence of records, and checks by replicated data."""
    found = posterior.sensitivity
    text = (
        "Contraction: 1 where the data determine a parameter, 0 where the prior does. Shifts of the mean, in posterior standard "
        "deviations: if the prior or the data are counted twice, and if a record is left out."
    )
    blocks: list[Block] = [text, found.table()]
    if found.checks:
        blocks += ["Measured loops and 100 sets of replicated data:", found.checks_table()]
    return [*blocks, notes_of(found.notes)] if found.notes else blocks


def profile_page(profiles: Profiles, fit: Path) -> Page:
    """The page of `hystfit profile`."""
    level = f"{100 * profiles.level:.0f} %"
    answer = [(f"{p.name} ({level} limits)", p.limits) for p in list(profiles.profiles.values())[:12]]
    answer += [("Noise", profiles.noise), ("Next", f"hystfit sample {opened(profiles.result, shlex.quote(str(fit)))}")]
    caption = "Likelihood profiles with confidence limits; dashed: parabola of the standard error"
    sections = [
        ("Plots", [[Picture(profiles.plot(), caption, wide=True, name="profiles")]]),
        ("All limits", [list(map(str, profiles.profiles.values()))]),
        ("Notes", [notes_of(profiles.notes)]),
    ]
    title = f"{level} limits of {profiles.result.name} by profile likelihood"
    return page_of(title, profiles.status, "profile", answer, sections)


def calibrate_page(calibration: Calibration) -> Page:
    """The page of `hystfit calibrate`."""
    answer, explained, shown = [], [], []
    if len(calibration.ranks):
        covered = dict(zip(calibration.names, calibration.coverage().tolist(), strict=True))
        least, most = min(covered, key=covered.__getitem__), max(covered, key=covered.__getitem__)
        low, high = calibration.coverage_band()
        share = lambda part: number(part, ".1%")
        answer += [
            ("Coverage of the 95 % intervals", f"{share(covered[least])} ({least}) to {share(covered[most])} ({most})"),
            ("Coverage consistent with 95 %", f"{share(low)} to {share(high)}"),
        ]
        explained = calibration.explanations()
        caption = (
            "Top: ranks of the true values among the draws. Bottom: coverage; gray: 99 % range of calibrated intervals"
        )
        shown = [[Picture(calibration.plot(), caption, wide=True, name="calibration")]]
    answer += [
        ("Simulated data", f"{len(calibration.ranks)} sets, noise {calibration.truth}"),
        ("Inference", f"{calibration.method}, noise {calibration.assumed}"),
        ("Failed", str(len(calibration.failures))),
    ]
    failures = [f"replicate {k} failed: {why}" for k, why in calibration.failures[:10]]
    sections = [
        ("Coverage", [calibration.table(), *explained]),
        ("Plots", shown),
        ("Remarks", [[*failures, *calibration.broken]]),
    ]
    title = f"Test of the confidence intervals of {calibration.model} by simulation"
    return page_of(title, calibration.status, "calibrate", answer, sections)


def design_page(proposal: Design, folder: Path) -> Page:
    """The page of `hystfit design`, written into a folder: the input over time, and the standard errors predicted with it."""
    best, result, aims = proposal.best, proposal.result, proposal.families(proposal.aim)
    answer = [("Proposed input", best.name), ("Aim", ", ".join(aims))]
    for name, members in list(aims.items())[:4]:
        now, then = proposal.median(proposal.present, members), proposal.median(best.stderr, members)
        known = lambda value: "not determined" if value is None else number(value, ".3g")
        answer.append((f"Standard error of {name}", f"{known(now)} now, {known(then)} with the proposed input"))
    command = f"hystfit fit NEW_LOOP {loops_of(result.data)} --model {shlex.quote(result.name)} --out fit"
    answer.append(("Next", f"measure with {folder / 'input.csv'}, then fit both records:\n{command}"))
    shown = [
        Picture(input_figure(proposal), f"Proposed input ({best.name})"),
        Picture(gain_figure(proposal), "Predicted standard errors, relative to the present ones"),
    ]
    sections = [
        ("Plots", [shown]),
        ("Predicted standard errors", [proposal.table()]),
        ("Notes", [notes_of(proposal.notes)]),
    ]
    return page_of(f"Next input for {result.name}", proposal.status, "design", answer, sections)


def invert_page(title: str, content: Mapping[str, Any], remarks: Sequence[str], figure: Figure, following: str) -> Page:
    """The page of `hystfit invert`, from the content of its result.json, its remarks and the `following` command."""
    unit, reach = content["units"]["input"] or "", content["input"]
    missed = {name: count for name, count in content["counts"].items() if count and name != "ok"}
    answer = [
        ("Input", f"{number(reach['lowest'])} to {number(reach['highest'])} {unit}".rstrip()),
        ("Reference reached", f"{content['counts']['ok']} of {sum(content['counts'].values())} samples"),
        ("Not reached", ", ".join(f"{count} {name}" for name, count in missed.items()) or "none"),
        ("Next", following),
    ]
    caption = "Top: reference and output of the model. Middle: input. Bottom: tracking error"
    sections = [
        ("Plots", [[Picture(figure, caption, wide=True)]]),
        ("Remarks", [[as_options(remark) for remark in remarks]]),
    ]
    return page_of(title, content["status"], "invert", answer, sections)
