"""`hystfit map`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from hystfit.cli.batches import ENDINGS, Format, check_packages
from hystfit.cli.interrupts import resumable
from hystfit.cli.options import LOOP_FITTING, STDOUT, Device, LoopFitting, Output, lists
from hystfit.cli.write import finish, progress
from hystfit.config import use_device
from hystfit.fitting.solvers.registry import ESTIMATORS

if TYPE_CHECKING:
    from hystfit.batch.loop_map import LoopMap

File = Annotated[Path, Parameter(help="HDF5 or netCDF-4 file, or Zarr store, with an array of loops over one input")]


@lists(methods=ESTIMATORS)
def fit_loops(
    file: File,
    *,
    model: str,
    input: str | None = None,
    output_name: Annotated[str | None, Parameter(name="--output")] = None,
    time: str | None = None,
    units: str | None = None,
    method: str = "auto",
    fitting: LoopFitting = LOOP_FITTING,
    workers: int | None = None,
    device: Device = "auto",
    table: list[Format] | None = None,
    output: Output = STDOUT,
) -> int:
    """Fit a model to every loop of an array, such as that of a scan over a sample, and draw the map of each parameter.

    The file is read part by part. Exit status 1: a loop has no usable fit. With --out, the folder holds maps.nc (every parameter, its
    standard error, the status and the notes, over the axes of the array) and a picture of each parameter. The same command resumes
    after an interruption.

    Args:
        model: name (see hystfit models) or my_model.py:MyModel.
        input: data set of the input; recognized by default, like the following.
        output_name: data set of the outputs; default: the one with the most axes.
        time: data set of the time; "none" reads without it.
        units: units of input and output, such as V,nm; others of the same quantity in the file are converted.
        method: auto (suits the model), {methods}.
        workers: threads; default: one for each core.
        table: form of the maps besides netCDF: zarr, or parquet with one row per loop; repeatable.
    """
    from hystfit.batch.fit_map import fit_map
    from hystfit.reading.cubes import open_cube

    output.check()
    use_device(device)
    forms: list[Format] = ["netcdf", *(table or [])] if output.out is not None else []
    check_packages(forms)
    with (
        open_cube(file, input=input, output=output_name, time=time, units=units) as cube,
        progress(f"fitting {model}") as update,
        resumable(output.run),
    ):
        found = fit_map(
            model,
            cube.u,
            cube.y,
            cube.t,
            u_unit=cube.units["u"],
            y_unit=cube.units["y"],
            t_unit=cube.units["t"],
            folder=output.run,
            workers=workers,
            progress=update,
            method=method,
            **fitting.keywords(),
        )

    def save(folder: Path) -> None:
        for form in dict.fromkeys(forms):
            found.save(folder / f"maps{ENDINGS[form]}")
        _draw(found, folder)

    return finish(str(found), found.to_dict(), output, save, status=found.status)


def _draw(found: LoopMap, folder: Path) -> None:
    if len(found.shape) != 2:
        return
    for name in (*found.values, *found.quantities):
        found.plot(name).savefig(folder / f"map_{re.sub(r'[^0-9A-Za-z_.-]+', '_', name).strip('_')}.png", dpi=120)
