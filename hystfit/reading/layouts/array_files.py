"""Arrays in numpy and HDF5 files. Sizes are checked before anything is unpacked or allocated, and pickles never loaded."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np

from hystfit.errors import DataError, optional
from hystfit.reading.files.file_bytes import allowed
from hystfit.reading.names.names_with_units import is_unit, split_unit
from hystfit.reading.text.stated_interval import interval_of

HDF = b"\x89HDF"  # first bytes of an HDF5 file, before which MATLAB writes 512 of its own
_CHUNK = 2**20
DOUBLE = 8  # bytes that every number takes in the end


def is_hdf(raw: bytes) -> bool:
    """Whether the bytes are those of an HDF5 file, or of one with the header of MATLAB."""
    return HDF in (raw[:4], raw[512:516])


def check_size(size: int, raw: bytes) -> None:
    """Refuse numbers that would take many times the size of their file.

    Args:
        size: of all numbers [bytes].
    """
    if size > allowed(len(raw)):
        raise DataError(
            f"its contents would take {size / 2**20:.0f} MiB, and the file has {len(raw) / 2**20:.3g} MiB: it is damaged or "
            "not a measurement. If it is one, save fewer or shorter columns"
        )


def check_members(archive: zipfile.ZipFile, raw: bytes) -> None:
    """Refuse an archive that unpacks to many times its size; members longer than they state are cut off by zipfile."""
    check_size(sum(member.file_size for member in archive.infolist()), raw)


def numpy_arrays(raw: bytes) -> dict[str, np.ndarray]:
    """NumPy arrays: each array of a .npz is a column, a matrix gives several, a structured array its fields."""
    if raw.startswith(b"PK"):
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            check_members(archive, raw)
            sizes = []
            for member in archive.infolist():
                with archive.open(member) as stream:
                    sizes.append(_npy_size(stream.read(_CHUNK), member.file_size))
            check_size(sum(sizes), raw)
    else:
        check_size(_npy_size(raw, len(raw)), raw)
    found = np.load(io.BytesIO(raw), allow_pickle=False)
    if isinstance(found, np.ndarray):
        return {"": found} if found.dtype.names is None else {name: found[name] for name in found.dtype.names}
    arrays = {name: found[name] for name in found.files}
    return {name: array for name, array in arrays.items() if isinstance(array, np.ndarray)}


def _npy_size(start: bytes, size: int) -> int:
    """Bytes of an array as doubles, from the first bytes of its file of `size` bytes."""
    if not start.startswith(b"\x93NUMPY"):
        return size
    stream = io.BytesIO(start)
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(stream)
    count = math.prod(shape)
    if dtype.hasobject:
        raise DataError(
            "it holds Python objects, which are not loaded because they could run code: save arrays of numbers"
        )
    if count * dtype.itemsize > size - stream.tell():
        raise DataError(
            f"an array of shape {shape} is announced, and its numbers are not there: it is damaged, save it again"
        )
    return count * max(DOUBLE, dtype.itemsize)


def hdf5_arrays(raw: bytes) -> dict[str, np.ndarray]:
    """HDF5 data sets in all groups, and the fields of compound ones; needs the extra "files"."""
    h5py = optional("h5py", "files", "reading HDF5 (and MATLAB 7.3) files")
    found: list[tuple[str, Any]] = []

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith("#refs#"):
            found.append((name, item))

    with h5py.File(io.BytesIO(raw), "r") as file:
        file.visititems(visit)
        for name, item in found:
            settings = item.id.get_create_plist()
            if settings.get_external_count() or settings.get_layout() == h5py.h5d.VIRTUAL:
                raise DataError(f"{name!r} lies in another file, which is not read: store the numbers themselves")
        check_size(sum(math.prod(item.shape or ()) * max(DOUBLE, item.dtype.itemsize) for _, item in found), raw)
        arrays: dict[str, np.ndarray] = {}
        for name, item in found:
            values = item[()]
            if isinstance(values, np.ndarray) and values.dtype.names is not None:
                arrays.update({f"{name}/{field}": values[field] for field in values.dtype.names})
            elif isinstance(values, np.ndarray) and (titles := _titles_of(item.attrs, values.shape)):
                arrays.update({f"{name}/{title}": values[:, k] for k, title in enumerate(titles)})
            elif isinstance(values, np.ndarray):
                titled = name if split_unit(name)[1] or not (unit := _unit_of(item.attrs)) else f"{name} [{unit}]"
                arrays[titled] = _text(values) if values.dtype.kind in "SO" else values
        scalars = {key: np.ravel(value) for key, value in file.attrs.items() if np.size(value) == 1}
    stated = {key: value for key, value in scalars.items() if value.dtype.kind in "fiu"}
    # Of the attributes of the file, the rate or interval of the samples is read.
    return arrays | {key: value for key, value in stated.items() if interval_of({key: value.item()})}


def _titles_of(attributes: Mapping[str, Any], shape: tuple[int, ...]) -> list[str]:
    """The names of the columns of a matrix: the only attribute that is a list of as many different texts; [] for others."""
    lists = (np.ravel(attributes[key]) for key in attributes) if len(shape) == 2 else ()
    found = [_text(texts).tolist() for texts in lists if texts.size == shape[1] and texts.dtype.kind in "SO"]
    return found[0] if len(found) == 1 and len({*found[0]}) == shape[1] > 1 else []


def netcdf_arrays(raw: bytes) -> dict[str, np.ndarray]:
    """Variables of a netCDF file of the classic format, with their units."""
    from scipy.io import netcdf_file

    with netcdf_file(io.BytesIO(raw), mmap=False) as file:
        variables = {name: (one.data, _unit_of(one.__dict__)) for name, one in file.variables.items()}
        return {f"{name} [{unit}]" if unit else name: np.array(data) for name, (data, unit) in variables.items()}


def _unit_of(attributes: Mapping[str, Any]) -> str:
    """The unit that the attributes of a data set state, "" where they state none."""
    stated = next((attributes[key] for key in attributes if key.lower() in ("unit", "units")), "")
    text = stated.decode(errors="replace") if isinstance(stated, bytes) else str(stated)
    return text if is_unit(text) else ""


def _text(values: np.ndarray) -> np.ndarray:
    return np.array([v.decode(errors="replace") if isinstance(v, bytes) else str(v) for v in values.ravel()])
