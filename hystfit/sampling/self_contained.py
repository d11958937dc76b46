"""HDF5 files that read nothing but themselves: links to other files, external storage and virtual data sets are refused."""

from __future__ import annotations

import io
from typing import Any

from hystfit.errors import DataError

_SLACK = 10_000_000  # bytes of data beyond the size of the file, for what netCDF fills in


def refuse_outside(content: bytes, place: str) -> None:
    """Refuse an HDF5 file whose data lie outside it, or that declares more data than it holds.

    Raises:
        DataError: see above, or no HDF5 file.
    """
    import h5py

    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            size = _checked(file, place)
    except DataError:
        raise
    except (OSError, KeyError, ValueError, RuntimeError, TypeError, RecursionError) as error:
        raise DataError(f"{place} is damaged ({error}): restore it, or remove it and sample again") from error
    if size > len(content) + _SLACK:
        raise DataError(
            f"{place} declares {size} bytes of data, and the file has {len(content)}: restore it, or remove it and sample again"
        )


def _checked(group: Any, place: str) -> int:
    """Bytes of the data sets of a group and the groups within it, none of which was read."""
    import h5py

    size = 0
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise DataError(f"{place}: {name!r} is a link to another place, which hystfit does not follow")
        item = group[name]
        if isinstance(item, h5py.Group):
            if item == group.file["/"]:
                raise DataError(f"{place}: {name!r} is a group within itself")
            size += _checked(item, place)
        elif isinstance(item, h5py.Dataset):
            if item.external or item.is_virtual:
                raise DataError(f"{place}: {name!r} has its data in other files, which hystfit does not read")
            size += item.nbytes
    return size
