"""Arrays of loops in HDF5 and netCDF-4 files and Zarr stores: outputs over the points of a scan, and the input that all loops share."""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.errors import DataError, optional
from hystfit.params.units import conversion
from hystfit.reading.files.file_bytes import is_zarr
from hystfit.reading.names.column_names import column_quantity, column_role
from hystfit.reading.names.names_with_units import split_unit


@dataclasses.dataclass(frozen=True)
class Outputs:
    """Outputs of a file, read part by part, with the samples as the last axis.

    Attributes:
        values: the array of the file: an HDF5 data set or a Zarr array.
        axis: of its samples.
        factor: to the unit of the cube.
    """

    values: Any
    axis: int
    factor: float

    @property
    def shape(self) -> tuple[int, ...]:
        """Points of the scan, then samples."""
        shape = tuple(self.values.shape)
        return (*shape[: self.axis], *shape[self.axis + 1 :], shape[self.axis])

    def __getitem__(self, part: slice) -> np.ndarray:
        """Outputs of some rows of the first axis of the scan.

        Raises:
            DataError: they cannot be read.
        """
        places = (slice(None), part) if self.axis == 0 else (part,)
        return self.factor * np.moveaxis(_numbers(self.values, places), self.axis, -1)


@dataclasses.dataclass(frozen=True)
class Cube:
    """Loops over one input.

    Attributes:
        u, t: input and time, shape (T,); t is None where there is none.
        y: outputs, shape (..., T).
        units: of "u", "y" and "t", "" where unknown.
        names: of the data sets of input, output and time in the file.
    """

    u: np.ndarray
    y: Outputs
    t: np.ndarray | None
    units: dict[str, str]
    names: dict[str, str]


@contextlib.contextmanager
def open_cube(
    path: str | Path,
    *,
    input: str | None = None,
    output: str | None = None,
    time: str | None = None,
    units: str | None = None,
) -> Iterator[Cube]:
    """The loops of a file, which stays open while they are read.

    Args:
        path: of an HDF5 or netCDF-4 file, or a Zarr store.
        input, output, time: names of data sets. By default the output is the one with the most axes, and input and time are the data
            sets of one axis along its samples; the time is recognized by its name or unit, "none" reads without it.
        units: of input and output, "V,nm"; other units of the same quantity in the file are converted.

    Raises:
        DataError: not such a file, no array of loops in it, or several data sets that may be the input.
        MissingExtraError: h5py or zarr is not installed.
    """
    arrays_of = _zarr_arrays if is_zarr(path) else _hdf5_data_sets
    with arrays_of(Path(path)) as found:
        found = {name: item for name, item in found.items() if item.dtype.kind in "fiu" and item.ndim > 0}
        yield _cube(str(path), found, {"input": input, "output": output, "time": time}, units)


@contextlib.contextmanager
def _hdf5_data_sets(path: Path) -> Iterator[dict[str, Any]]:
    h5py = optional("h5py", "files", "reading HDF5 and netCDF files")
    if not path.is_file():
        raise DataError(f"no file {str(path)!r}" if not path.is_dir() else f"the folder {str(path)!r} is no Zarr store")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise DataError(
            f"{str(path)!r} is no HDF5 or netCDF-4 file: {error}; in Python, fit_map takes any array"
        ) from error
    with file:
        found: dict[str, Any] = {}
        visit = lambda name, item: found.update({name: item}) if isinstance(item, h5py.Dataset) else None
        file.visititems(visit)
        yield found


@contextlib.contextmanager
def _zarr_arrays(path: Path) -> Iterator[dict[str, Any]]:
    zarr = optional("zarr", "files", "reading Zarr stores")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about files of other programs in the folder
            root = zarr.open(path, mode="r")
            members = [("", root)] if isinstance(root, zarr.Array) else root.members(max_depth=None)
    except Exception as error:  # several kinds, of damaged metadata
        raise DataError(f"the Zarr store {str(path)!r} cannot be opened: {error}") from error
    yield {name: item for name, item in members if isinstance(item, zarr.Array)}


def _numbers(item: Any, places: Any = ()) -> np.ndarray:
    """Values of a data set, unpacked by the attributes of the CF conventions: fill value, scale factor and offset.

    Raises:
        DataError: they cannot be read.
    """
    attribute = lambda name, default: np.ravel(item.attrs.get(name, default))[0]
    # In Zarr of format 2, xarray names the axes, and then the value of chunks that were not written is that of missing numbers too.
    unwritten = item.fill_value if "_ARRAY_DIMENSIONS" in item.attrs else None
    try:
        stored = np.asarray(item[places])
        values, missing = stored.astype(float), attribute("_FillValue", unwritten)
        if isinstance(missing, str):  # as xarray writes numbers in attributes of Zarr
            missing = np.frombuffer(base64.b64decode(missing), "<f8")[0]
        values[stored == missing] = np.nan
        return values * float(attribute("scale_factor", 1.0)) + float(attribute("add_offset", 0.0))
    except Exception as error:  # of h5py, zarr and the codecs of both
        raise DataError(f"the data set {item.name!r} cannot be read: {error}; the file is damaged") from error


def _cube(path: str, found: dict[str, Any], names: dict[str, str | None], wanted: str | None) -> Cube:
    """The cube among data sets of numbers by name."""
    for option, name in names.items():
        if name is not None and name not in found and not (option == "time" and name == "none"):
            raise DataError(f"{path!r} has no data set {name!r}; there are {', '.join(found) or 'none of numbers'}")
    output = names["output"] or max(
        found, key=lambda name: (found[name].ndim, math.prod(found[name].shape)), default=None
    )
    if output is None or found[output].ndim < 2:
        raise DataError(
            f"{path!r} holds no array of loops: data sets of two or more axes, one of them along the samples"
        )
    values = found[output]
    quantity = lambda name: column_quantity(Path(name).name, _unit(found[name], name))
    columns = [name for name, item in found.items() if item.ndim == 1 and item.shape[0] in values.shape]
    columns = [name for name in columns if names["input"] is None or found[name].shape == found[names["input"]].shape]
    clocks = [name for name in columns if quantity(name) == "time" and name != names["input"]]
    axis = _samples(path, values.shape, {name: found[name].shape[0] for name in columns}, clocks)
    columns = [name for name in columns if found[name].shape[0] == values.shape[axis]]
    clock = names["time"] or (clocks[0] if len(clocks) == 1 else None)
    inputs = [name for name in columns if name not in (clock, *clocks)]
    marked = [name for name in inputs if column_role(Path(name).name) == "input"]
    inputs = [names["input"]] if names["input"] else marked if len(marked) == 1 else inputs
    if len(inputs) != 1:
        options = f"it may be {' or '.join(inputs)}" if inputs else "no data set has one axis along the samples"
        raise DataError(f"{path!r}: which data set is the input? {options}; name it with input=")
    chosen = {"u": inputs[0], "y": output} | ({"t": clock} if clock not in (None, "none") else {})
    units, factors = _converted({key: _unit(found[name], name) for key, name in chosen.items()}, wanted)
    column = lambda key: factors[key] * _numbers(found[chosen[key]]) if key in chosen else None
    u, t = column("u"), column("t")
    for name, one in (("input", u), ("time", t)):
        if one is not None and one.shape != (values.shape[axis],):
            raise DataError(f"{path!r}: the {name} has shape {one.shape}, and each loop {values.shape[axis]} samples")
    return Cube(np.asarray(u), Outputs(values, axis, factors["y"]), t, units, chosen)


def _converted(units: dict[str, str], wanted: str | None) -> tuple[dict[str, str], dict[str, float]]:
    """Units of "u", "y" and "t" as wanted, time in seconds, and the factors to them."""
    given = [part.strip() for part in (wanted or "").split(",")]
    asked = dict(zip("uy", given, strict=False)) | {"t": "s"}
    target = {key: asked.get(key) or units.get(key, "") for key in "uyt"}
    factors = {key: (conversion(units[key], target[key]) or 1.0) if units.get(key) else 1.0 for key in "uyt"}
    return target, factors


def _samples(path: str, shape: tuple[int, ...], columns: dict[str, int], clocks: list[str]) -> int:
    """The axis of the samples: along which the time lies, or an input by its name, or the only one along which a column lies.

    Args:
        path: of the file.
        shape: of the outputs.
        columns: lengths of the data sets of one axis that may lie along it, by name.
        clocks: which of them are times.
    """
    inputs = [name for name in columns if column_role(Path(name).name) == "input"]
    lengths = {columns[name] for name in clocks or inputs or columns}
    axes = [k for k, size in enumerate(shape) if size in lengths]
    if len(lengths) > 1 or not axes:
        listed = ", ".join(columns) or "there is none"
        raise DataError(f"{path!r}: which data set of one axis is the input? {listed}; name it with input=")
    return axes[-1]


def _unit(item: Any, name: str) -> str:
    """Unit of a data set: its attribute, or the end of its name."""
    stored = item.attrs.get("units", "")
    text = stored.decode(errors="replace") if isinstance(stored, bytes) else str(stored)
    return text or split_unit(Path(name).name)[1]
