"""`hystfit population`: how much devices of one kind differ."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hystfit.cli.batches import processes_for
from hystfit.cli.interrupts import resumable
from hystfit.cli.options import DEFAULT_READING, FITTING, STDOUT, Fitting, Output, Reading
from hystfit.cli.write import finish, progress, write_input
from hystfit.errors import DataError

if TYPE_CHECKING:
    from hystfit.population.next_measurement import PopulationDesign
    from hystfit.population.population_fit import PopulationFit
    from hystfit.results.webpage import Page


def population(
    *loops: str,
    model: str,
    covariate: list[str] | None = None,
    device: str | None = None,
    draws: int = 1000,
    chains: int = 4,
    next_measurement: bool = False,
    fitting: Fitting = FITTING,
    workers: int | None = None,
    reading: Reading = DEFAULT_READING,
    output: Output = STDOUT,
) -> int:
    """Fit one model to many devices: mean device, scatter from device to device, correlations, and the next device.

    Exit status 1: devices were left out, or the draws have not converged. With --out, the folder holds result.json, devices.csv, a page
    (report.html), pictures and the fits (run/): the same command resumes after an interruption. `hystfit sample FIT --prior-from OUT` uses
    the population as the prior of a further device.

    Args:
        loops: files, or patterns in quotes ('loops/*.csv'); every curve of a file is a device.
        model: name, or my_model.py:MyModel.
        covariate: property, from the header or the name of a file, on which the mean depends linearly; repeatable.
        device: regular expression for the names of loops, whose first group is the device; for several loops per device.
        draws: draws per chain.
        chains: chains.
        next_measurement: also rank what to measure next, a new device or one of these again, and with which input (next.csv).
        workers: processes (default: one for each core where there are many loops).
    """
    output.check("hystfit.population")
    processes = processes_for(loops, workers)
    from hystfit.population.fit_population import fit_population

    with progress(f"fitting {model}") as update, resumable(output.run):
        result = fit_population(
            model,
            list(loops),
            by=None if device is None else _named_by(device),
            covariates=covariate or (),
            draws=draws,
            chains=chains,
            folder=output.run,
            workers=processes,
            reading=dataclasses.asdict(reading),
            progress=update,
            **fitting.keywords(),
        )
        proposal = _ranked(result, update) if next_measurement else None

    def save(folder: Path) -> None:
        from hystfit.population.population_files import write_devices

        write_devices(result, folder / "devices.csv")
        if proposal is not None:
            like = result.devices[0].result.data[0]
            write_input(folder / "next.csv", like, proposal.best.u, proposal.dt)

    text, content = str(result), result.to_dict()
    if proposal is not None:
        text, content = f"{text}\n\n{proposal}", content | {"next_measurement": proposal.to_dict()}
    return finish(text, content, output, save, page=lambda folder: _page(result, folder, proposal))


def _ranked(result: PopulationFit, update: Any) -> PopulationDesign:
    from hystfit.population.next_measurement import design_population

    update("ranking the next measurement", 0.0)
    return design_population(result)


def _named_by(pattern: str) -> Any:
    """The device of a loop by the first group of a regular expression."""
    import re

    try:
        compiled = re.compile(pattern)
    except re.error as error:
        raise DataError(f"--device {pattern!r} is no regular expression: {error}") from None
    if compiled.groups != 1:
        raise DataError(f"--device {pattern!r} needs one group, such as 'coupon(\\d+)'")

    def of(loop: str) -> str:
        match = compiled.search(loop)
        if match is None:
            raise DataError(f"--device {pattern!r} does not match the loop {loop!r}")
        return match[1]

    return of


def _page(result: PopulationFit, folder: Path, proposal: PopulationDesign | None) -> Page:
    from hystfit.cli.pages import notes_of, page_of
    from hystfit.outcome import Column, Table
    from hystfit.population.next_measurement import COLUMNS
    from hystfit.population.population_fit import MEANING
    from hystfit.results.webpage import Picture

    captions = {
        "forest": "Values of each device given all devices (90 %), the mean, and the range of nine in ten devices; outlying ones in color",
        "correlation": "Correlations between parameters: medians below, intervals of 90 % above the diagonal",
        "shrinkage": "Fitted values against those given all devices: a device with a poor record moves toward the mean",
    }
    columns = [Column("device"), *map(Column, result.names)]
    columns += [Column("effective", form=".2f"), Column("unusual", form=".3f")]
    shown = ("device", *result.names, "effective", "unusual")
    devices = Table(columns, [[row[key] for key in shown] for row in result.device_rows()])
    answer = [
        ("Devices", str(len(result.devices))),
        ("Outlying", ", ".join(result.outlying) or "none"),
        ("Next", f"hystfit sample FIT --prior-from {folder}"),
    ]
    pictures = [Picture(result.plot(kind), caption, name=kind) for kind, caption in captions.items()]
    sections = [
        ("Mean and scatter", [result.summary(), MEANING]),
        *([("Change of the mean device with covariates", [result.effects_table()])] if result.covariates else []),
        ("Pictures", [pictures]),
        ("Correlations whose interval excludes zero", [result.correlation_table()]),
        ("Devices", [devices]),
    ]
    notes = result.notes
    if proposal is not None:
        answer.append(("Measure next", proposal.best.label))
        sections.append(("Next measurement", [proposal.table(most=20), COLUMNS]))
        notes = (*notes, *proposal.notes)
    sections.append(("Notes", [notes_of(notes)]))
    return page_of(f"Population of {result.model}", result.status, "population", answer, sections)
