"""`hystfit batch`."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from hystfit.cli.interrupts import resumable
from hystfit.cli.options import DEFAULT_READING, LOOP_FITTING, STDOUT, Device, LoopFitting, Output, Reading, lists
from hystfit.cli.verbs import as_options
from hystfit.cli.write import finish, progress, terminal_width
from hystfit.config import use_device
from hystfit.errors import DataError, HystfitError, ParameterError, optional
from hystfit.fitting.solvers.registry import ESTIMATORS

if TYPE_CHECKING:
    from hystfit.batch.fits import Fits

Loops = Annotated[str, Parameter(help="files, or patterns in quotes ('loops/*.csv'); every curve is a loop of its own")]
Format = Literal["parquet", "netcdf", "zarr"]
ENDINGS: dict[Format, str] = {"parquet": ".parquet", "netcdf": ".nc", "zarr": ".zarr"}
_FEW = 32  # loops below which further processes take longer to start than to compute


def check_packages(forms: Iterable[Format]) -> None:
    """Refuse forms of a table whose packages are missing, before hours of fits."""
    from hystfit.results.exchange import TABLES

    for form in forms:
        for package in TABLES[ENDINGS[form]]:
            optional(package, "frames", f"--table {form}")


def processes_for(loops: Sequence[str], workers: int | None) -> int:
    """Processes as chosen, by default one for each core where there are many loops; refuses none."""
    from hystfit.batch.sources import sources_of

    if not loops:
        raise DataError("LOOP is missing: name files, or a pattern in quotes ('loops/*.csv')")
    return workers or (1 if len(sources_of(list(loops))) < _FEW else os.cpu_count() or 1)


@lists(methods=ESTIMATORS)
def batch(
    *loops: Loops,
    model: str = "auto",
    method: str = "auto",
    fitting: LoopFitting = LOOP_FITTING,
    workers: int | None = None,
    scheduler: str | None = None,
    device: Device = "auto",
    table: list[Format] | None = None,
    reports: str = "5",
    reading: Reading = DEFAULT_READING,
    output: Output = STDOUT,
) -> int:
    """Fit a model to each of many loops and tabulate the parameters.

    Exit status 1: a loop could not be fitted, or its fit is not usable. With --out, the folder holds fits.csv (one row per loop),
    overview.html (the distribution of each parameter, and the loops that need attention) and reports of some loops. The same command
    resumes after an interruption, and includes loops that were added.

    Args:
        model: name (see hystfit models), my_model.py:MyModel, or auto: the winner of hystfit compare on each loop.
        method: auto (suits the model), {methods}.
        workers: processes on this machine; default: one for each core, for many loops.
        scheduler: address of a Dask scheduler to use instead.
        table: form of the table besides CSV: parquet, netcdf or zarr; repeatable.
        reports: number of loops with a report, those that need attention first; or all.
    """
    from hystfit.batch.many import fit_many

    output.check()
    use_device(device)
    processes, count = processes_for(loops, workers), _count(reports)
    check_packages(table or [])
    with progress(f"fitting {model}") as update, resumable(output.run):
        fits = fit_many(
            model,
            list(loops),
            folder=output.run,
            workers=processes,
            scheduler=scheduler,
            reading=dataclasses.asdict(reading),
            progress=update,
            method=method,
            **fitting.keywords(),
        )

    def save(folder: Path) -> None:
        from hystfit.batch.overview import overview

        for ending in (".csv", *(ENDINGS[form] for form in table or [])):
            fits.save(folder / f"fits{ending}")
        addresses = _write_reports(fits, len(fits) if count is None else count, folder)
        (folder / "overview.html").write_text(overview(fits, addresses, as_options), encoding="utf-8")

    return finish(fits.text(terminal_width()), fits.to_dict(), output, save, status=fits.status)


def _count(reports: str) -> int | None:
    if reports == "all":
        return None
    if not reports.isdigit():
        raise ParameterError(f"--reports is a number of loops, or all; got {reports!r}")
    return int(reports)


def _write_reports(fits: Fits, count: int, folder: Path) -> dict[str, str]:
    """Reports of the loops that need attention and have a fit: address by name of the loop."""
    from hystfit.results.report import Wording, write_into

    addresses: dict[str, str] = {}
    chosen = [row for row in fits.worst(len(fits)) if row.values][:count]
    with progress("writing reports") as update:
        for number, row in enumerate(chosen):
            update(row.name, number / len(chosen))
            try:
                result = fits.result(row.name)
            except HystfitError as error:  # the file has gone since
                raise DataError(f"report of {row.name!r}: {error}") from error
            name = re.sub(r"[^\w.-]+", "_", Path(row.name).name)[:80]
            place = folder / "reports" / f"{name}-{(row.sha256 or '')[:8]}"
            place.mkdir(parents=True, exist_ok=True)
            write_into(result, place, wording=Wording("fit", saved=False, translate=as_options), files=False)
            addresses[row.name] = f"reports/{place.name}/report.html"
    return addresses
