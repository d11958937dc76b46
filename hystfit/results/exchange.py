"""Fits and draws for other programs: a .mat file, an xarray data set, netCDF and Zarr, ArviZ' container."""

from __future__ import annotations

import contextlib
import importlib
import inspect
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hystfit.errors import DataError, optional
from hystfit.results.saving.folders import writing_file

if TYPE_CHECKING:
    from hystfit.results.result import FitResult

# Endings of tables of many fits, and the packages that write them.
TABLES = {".parquet": ("pandas", "pyarrow"), ".nc": ("xarray", "h5netcdf"), ".zarr": ("xarray", "zarr")}


def write_mat(result: FitResult, path: str | Path) -> Path:
    """Write a fit as a MATLAB file with one struct, `fit`.

    It has model, status, units; parameters (name, value, stderr, lower, upper, unit, fixed), free_names and covariance; rmse and
    error_percent; records (name, t, u, y, weight, predicted). Unknown numbers are NaN.
    """
    import scipy.io

    with writing_file(path) as scratch:
        scipy.io.savemat(scratch, {"fit": _contents(result)}, oned_as="column", long_field_names=True)
    return Path(path)


def _contents(result: FitResult) -> dict[str, Any]:
    estimates = [{"unit": "", **p.to_dict(), "name": p.name} for p in result.parameters]
    column = lambda key: np.array([np.nan if p[key] is None else p[key] for p in estimates], dtype=float)
    cells = lambda texts: np.array([*texts], dtype=object)
    words = lambda key: cells(str(p[key] or "") for p in estimates)
    records = np.empty(len(result.data), dtype=object)
    for k, record in enumerate(result.data):
        t = np.full(len(record), np.nan) if record.t is None else record.t
        records[k] = {"name": record.name, "t": t, "u": record.u, "y": record.y, "weight": record.weight}
        records[k]["predicted"] = result.predict(record)
    numbers = {key: column(key) for key in ("value", "stderr", "lower", "upper")}
    fixed = np.array([p.fixed for p in result.parameters])
    return {
        "model": result.name,
        "status": str(result.status),
        "units": dict(result.data.units),
        "parameters": {"name": words("name"), **numbers, "unit": words("unit"), "fixed": fixed},
        "free_names": cells(result.free_names),
        "covariance": result.covariance,
        "rmse": result.train.rmse,
        "error_percent": result.train.nrmse_percent,
        "records": records,
    }


def to_xarray(result: FitResult) -> Any:
    """A fit as an xarray data set: value, stderr over `parameter`; covariance; u, y, predicted over `sample`, with record names."""
    xarray = optional("xarray", "frames", "to_xarray")
    units, free = result.data.units, list(result.free_names)
    series = {
        "u": (np.concatenate([r.u for r in result.data]), units["u"]),
        "y": (np.concatenate([r.y for r in result.data]), units["y"]),
        "predicted": (np.concatenate([result.predict(r) for r in result.data]), units["y"]),
    }
    data: dict[str, Any] = {name: ("sample", values, {"units": unit}) for name, (values, unit) in series.items()}
    data["value"] = ("parameter", [p.value for p in result.parameters])
    data["stderr"] = ("parameter", [np.nan if p.stderr is None else p.stderr for p in result.parameters])
    data["covariance"] = (("free", "free_too"), result.covariance)
    where: dict[str, Any] = {"parameter": [p.name for p in result.parameters], "free": free, "free_too": free}
    where["unit"] = ("parameter", [p.unit for p in result.parameters])
    where["record"] = ("sample", [r.name for r in result.data for _ in range(len(r))])
    if all(r.t is not None for r in result.data):
        where["t"] = ("sample", np.concatenate([r.t for r in result.data]), {"units": units["t"]})
    return xarray.Dataset(data, where, {"model": result.name, "status": str(result.status)})


def write_table(path: str | Path, frames: Callable[[], Iterable[Any]], dataset: Callable[[], Any]) -> Path:
    """Write a table of many fits, whole or not at all: .parquet, .nc (netCDF) or .zarr (a store of format 2), in place of an older one.

    `frames` makes the pandas data frames of a Parquet table, part by part, and `dataset` the xarray data set of the others.
    """
    path = Path(path)
    if path.suffix not in TABLES:
        raise DataError(f"a table is written as {', '.join(TABLES)}, got {path.name!r}")
    for package in TABLES[path.suffix]:
        optional(package, "frames", f"a table in {path.suffix}")
    with writing_file(path) as scratch:
        if path.suffix == ".parquet":
            _write_parquet(scratch, frames())
        elif path.suffix == ".nc":
            scratch.write_bytes(dataset().to_netcdf(engine="h5netcdf"))  # HDF5 can crash on a full disk
        else:  # format 3 has no common metadata of all arrays, and no types of text, that all programs read
            dataset().to_zarr(scratch, zarr_format=2, consolidated=True)
    return path


def _write_parquet(path: Path, frames: Iterable[Any]) -> None:
    """A Parquet table with a row group for each part."""
    import pyarrow
    from pyarrow import parquet

    with contextlib.ExitStack() as stack:
        writer = None
        for frame in frames:
            part = pyarrow.Table.from_pandas(frame, preserve_index=False)
            writer = writer or stack.enter_context(parquet.ParquetWriter(path, part.schema))
            writer.write_table(part.cast(writer.schema))


def smoothed_weights(log_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pareto-smoothed importance weights that sum to one, shape (m, draws), and the shape parameter of each tail, by ArviZ."""
    arviz = optional("arviz", "bayes", "importance sampling")
    if hasattr(arviz, "psislw"):  # before version 1
        smoothed, shapes = arviz.psislw(log_weights)
    else:
        smoothed, shapes = importlib.import_module("arviz_stats.base").array_stats.psislw(log_weights)
    weights = np.exp(smoothed - np.max(smoothed, axis=-1, keepdims=True))
    return weights / weights.sum(axis=-1, keepdims=True), np.atleast_1d(np.asarray(shapes))


def arviz_data(groups: Mapping[str, Mapping[str, Any]], **axes: Any) -> Any:
    """ArviZ' container of draws: `InferenceData` before version 1, a DataTree from then on.

    Arrays are given by name for each group ("posterior", "sample_stats"); `axes` are `dims` and `coords`, as ArviZ takes them.
    """
    arviz = optional("arviz", "bayes", "to_arviz")
    old = "posterior" in inspect.signature(arviz.from_dict).parameters
    return arviz.from_dict(**groups, **axes) if old else arviz.from_dict(dict(groups), **axes)
