"""Variables of MATLAB files, also within structures; arrays of structures are records, or channels with a name and their data."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.files.file_bytes import FileBytes
from hystfit.reading.files.text_file import Opening
from hystfit.reading.layouts.array_files import DOUBLE, check_size, hdf5_arrays, is_hdf
from hystfit.reading.layouts.array_table import errors_of, read_arrays
from hystfit.reading.layouts.json_text import table_of_tree
from hystfit.reading.layouts.mat_structure import check_structure
from hystfit.reading.table.raw_table import Table


def read_matlab(file: FileBytes, opening: Opening) -> Table:
    """MATLAB variables, also within structures; an array of structures has a record, or a named channel, in each."""
    if file.raw.startswith(b"MATLAB 7.3") or is_hdf(file.raw):
        of_columns = lambda raw: {
            name: array.T for name, array in hdf5_arrays(raw).items()
        }  # which MATLAB stores first
        return read_arrays(of_columns, file, opening)
    with errors_of(file, opening):
        tree = _by_cell(_logged(_variables(file.raw)))
    if any(map(_has_structures, tree.values())):
        return table_of_tree(_listed(tree), file, Note(Code.FILE_FORMAT, "structures of MATLAB"))
    return read_arrays(lambda _: _flatten(tree) | _scalars(tree), file, opening)


def _variables(raw: bytes) -> dict[str, Any]:
    """The variables of a file before version 7.3, checked before they are unpacked."""
    from scipy.io import loadmat, whosmat

    check_structure(raw)
    shapes = [shape for _, shape, _ in whosmat(io.BytesIO(raw))]
    check_size(sum(DOUBLE * math.prod(map(int, shape)) for shape in shapes), raw)
    found = loadmat(io.BytesIO(raw), simplify_cells=True)
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _logged(tree: Mapping[str, Any]) -> dict[str, Any]:
    """The variables; the signals that Simulink logs in a structure with their time are called by their labels or numbers."""
    found: dict[str, Any] = {}
    for name, value in tree.items():
        signals = value.get("signals") if isinstance(value, Mapping) and "time" in value else None
        items = [signals] if isinstance(signals, Mapping) else _items(signals)
        if items and all(isinstance(item, Mapping) and "values" in item for item in items):
            labels = [str(item.get("label", "")) if np.size(item.get("label", "")) else "" for item in items]
            if len({*labels, ""}) <= len(items):
                labels = [str(k) for k in range(1, len(items) + 1)] if len(items) > 1 else [""]
            found[f"{name}.time"] = value["time"]
            found |= {f"{name}.{label}".rstrip("."): item["values"] for label, item in zip(labels, items, strict=True)}
        else:
            found[name] = _logged(value) if isinstance(value, Mapping) else value
    return found


def _flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, np.ndarray]:
    """The arrays in structures, their names joined by dots."""
    arrays: dict[str, np.ndarray] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            arrays.update(_flatten(value, f"{prefix}{name}."))
        elif isinstance(value, np.ndarray):
            arrays[f"{prefix}{name}"] = value
    return arrays


def _scalars(tree: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The numbers in structures, such as a sampling interval, by their own names."""
    found: dict[str, np.ndarray] = {}
    for name, value in tree.items():
        found |= _scalars(value) if isinstance(value, Mapping) else {}
        found |= {name: np.array(value)} if isinstance(value, int | float) else {}
    return found


def _items(value: Any) -> list[Any]:
    """The items of a list or of an array of objects; none of another value."""
    objects = isinstance(value, np.ndarray) and value.dtype == object and value.ndim > 0
    return [*value.ravel()] if objects else [*value] if isinstance(value, list) else []


def _by_cell(tree: Mapping[str, Any]) -> Mapping[str, Any]:
    """The variables; those that have a column in each of as many cells, one for each trial, as an array of structures."""
    cells = {name: columns for name, value in tree.items() if (columns := _columns(value))}
    if len(cells) < 2 or len({len(items) for items in cells.values()}) > 1:
        return tree
    trials = [dict(zip(cells, columns, strict=True)) for columns in zip(*cells.values(), strict=True)]
    return {name: value for name, value in tree.items() if name not in cells} | {"cell": trials}


def _columns(value: Any) -> list[np.ndarray]:
    """The columns in the cells of a variable, which are the rows of a matrix where all are of one length; none of another value."""
    cells = isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object and value.ndim > 0)
    columns = [np.array(cell.tolist()) for cell in value if isinstance(cell, np.ndarray)] if cells else []
    numbers = all(column.ndim == 1 and column.size > 1 and column.dtype.kind in "fiu" for column in columns)
    return columns if numbers and columns and len(columns) == len(value) else []


def _has_structures(value: Any) -> bool:
    """Whether there is an array of structures with arrays in a variable."""
    if isinstance(value, Mapping):
        return any(map(_has_structures, value.values()))
    items = _items(value)
    return bool(items) and all(isinstance(item, Mapping) and _flatten(item) for item in items)


def _listed(value: Any) -> Any:
    """A variable with lists in the place of its arrays."""
    if isinstance(value, Mapping):
        return {name: _listed(item) for name, item in value.items()}
    if items := _items(value):
        return [_listed(item) for item in items]
    return np.squeeze(value).tolist() if isinstance(value, np.ndarray) else value
