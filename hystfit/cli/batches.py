"""`hystfit batch`."""

from __future__ import annotations

import dataclasses
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from hystfit.cli.interrupts import resumable
from hystfit.cli.options import DEFAULT_READING, STDOUT, Device, Output, Reading, lists, named_values, tied_values
from hystfit.cli.verbs import as_options
from hystfit.cli.write import finish, progress, terminal_width
from hystfit.config import use_device
from hystfit.errors import DataError, HystfitError, ParameterError, optional
from hystfit.fitting.registry import ESTIMATORS
from hystfit.inference.noise.registry import NOISES

if TYPE_CHECKING:
    from hystfit.batch.fits import Fits

Loops = Annotated[str, Parameter(help="files, or patterns in quotes ('loops/*.csv'); every curve is a loop of its own")]
Format = Literal["parquet", "netcdf"]
ENDINGS: dict[Format, str] = {"parquet": ".parquet", "netcdf": ".nc"}
PACKAGES: dict[Format, tuple[str, ...]] = {"parquet": ("pandas", "pyarrow"), "netcdf": ("xarray", "h5netcdf")}
RUN = "run"  # folder of the finished rows, from which an interrupted batch resumes
_FEW = 32  # loops below which further processes take longer to start than to compute


@lists(methods=ESTIMATORS, noises=NOISES)
def batch(
    *loops: Loops,
    model: str = "auto",
    method: str = "auto",
    fix: list[str] | None = None,
    free: list[str] | None = None,
    tie: list[str] | None = None,
    noise: str = "auto",
    loss: str = "linear",
    start: Literal["data", "model"] = "data",
    starts: int = 8,
    seed: int = 0,
    workers: int | None = None,
    scheduler: str | None = None,
    device: Device = "auto",
    table: list[Format] | None = None,
    reports: str = "5",
    reading: Reading = DEFAULT_READING,
    output: Output = STDOUT,
) -> int:
    """Fit a model to each of many loops and tabulate the parameters.

    Exit status 1: some loop could not be fitted, or its fit is not usable. With --out, the folder holds fits.csv (one row per loop),
    overview.html (the distribution of each parameter, and the loops that need attention) and reports of some loops. The same command
    resumes after an interruption, and loops may be added to it.

    Args:
        model: name (see hystfit models), my_model.py:MyModel, or auto: the winner of hystfit compare on each loop.
        method: auto (suits the model), {methods}.
        fix: parameter that is not fitted, as NAME or NAME=VALUE; repeatable.
        free: parameter to fit that the model fixes by default; repeatable.
        tie: parameter that follows from another one, as NAME=NUMBER*NAME+NUMBER; repeatable.
        noise: auto, {noises}, or my_file.py:MyNoise, as in hystfit fit.
        loss: linear, huber, soft-l1 or cauchy, as in hystfit fit.
        start: starting values estimated from the data, or those of the model.
        starts: number of starting points.
        seed: random seed for the starting points.
        workers: processes on this machine; default: one for each core, for many loops.
        scheduler: address of a Dask scheduler to use instead.
        table: form of the table besides CSV: parquet or netcdf; repeatable.
        reports: number of loops with a report, those that need attention first; or all.
    """
    from hystfit.batch.many import fit_many
    from hystfit.batch.sources import sources_of

    output.check()
    use_device(device)
    if not loops:
        raise DataError("LOOP is missing: name files, or a pattern in quotes ('loops/*.csv')")
    count = _count(reports)
    for form in table or []:  # before hours of fits
        for package in PACKAGES[form]:
            optional(package, "frames", f"--table {form}")
    found = len(sources_of(list(loops)))
    options: dict[str, Any] = {"method": method, "noise": noise, "loss": loss, "start": start}
    options |= {
        "starts": starts,
        "seed": seed,
        "fix": named_values(fix or []),
        "free": free or [],
        "tie": tied_values(tie or []),
    }
    run = None if output.out is None else output.out / RUN
    processes = workers or (1 if found < _FEW else os.cpu_count() or 1)
    with progress(f"fitting {model}") as update, resumable(run):
        fits = fit_many(
            model,
            list(loops),
            folder=run,
            workers=processes,
            scheduler=scheduler,
            reading=dataclasses.asdict(reading),
            progress=update,
            **options,
        )

    def save(folder: Path) -> None:
        from hystfit.batch.overview import overview

        for ending in (".csv", *(ENDINGS[form] for form in table or [])):
            fits.save(folder / f"fits{ending}")
        addresses = _write_reports(fits, len(fits) if count is None else count, folder)
        (folder / "overview.html").write_text(overview(fits, addresses, as_options), encoding="utf-8")

    return finish(fits.text(terminal_width()), fits.to_dict(), output, save, status=fits.status)


def _count(reports: str) -> int | None:
    """Number of reports; None for all."""
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
            write_into(result, place, wording=Wording("fit", saved=False, translate=as_options))
            addresses[row.name] = f"reports/{place.name}/report.html"
    return addresses
