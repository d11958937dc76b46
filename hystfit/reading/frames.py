"""The columns of data frames (pandas, polars), dictionaries, xarray datasets and structured arrays, as those of a file.

Data frames are recognized by what they can do, so that none of these packages is imported.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from hystfit.data.preparation import real_numbers
from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Table, plain_table


def is_frame(data: Any) -> bool:
    """Whether an object holds columns by name: a data frame, a dictionary, an xarray dataset, a structured array."""
    named = isinstance(data, Mapping) or getattr(getattr(data, "dtype", None), "names", None) is not None
    return named or (hasattr(data, "columns") and hasattr(data, "__getitem__"))


def columns_of(data: Any) -> dict[Any, Any]:
    """The columns of a data frame by name, a meaningful index of its rows first."""
    if getattr(getattr(data, "dtype", None), "names", None) is not None:
        return {name: data[name] for name in data.dtype.names}
    names = [*getattr(data, "coords", ()), *data] if isinstance(data, Mapping) else list(data.columns)
    if len(set(names)) < len(names):
        raise DataError("the columns of the data frame must have different names")
    columns = {name: data[name] for name in names}
    index = getattr(data, "index", None)
    if index is not None and getattr(index, "nlevels", 0) == 1 and (index.name is not None or is_clock(index)):
        label = "time" if index.name is None else index.name
        return columns if label in columns else {label: index, **columns}
    return columns


def frame_table(data: Any) -> Table:
    """The columns of a data frame as those of a file."""
    arrays: dict[Any, np.ndarray] = {}
    units: dict[Any, str] = {}
    columns = columns_of(data)
    clocks = {name for name, values in columns.items() if is_clock(values)}
    for name, values in columns.items():
        array = seconds_of(values) if name in clocks else _numbers(values)
        if array.ndim == 1:
            arrays[name] = array
            units[name] = "s" if name in clocks else unit_of(values, str(name), [str(other) for other in columns])
    lengths = {array.size for array in arrays.values()}
    if len(lengths) != 1:
        found = ", ".join(f"{name} {array.size}" for name, array in arrays.items()) or "no columns of one dimension"
        raise DataError(f"the columns must have one length, found {found}")
    odd = [str(name) for name in columns if name not in arrays]
    notes = [Note(Code.LEFT_OUT, f"left out: columns that do not have one dimension: {', '.join(odd)}")] if odd else []
    named = any(isinstance(name, str) for name in arrays)
    names = [str(name) if named else f"column {name}" for name in arrays]
    table = plain_table(names, list(arrays.values()), "data frame", None, tuple(notes), list(units.values()))
    stamps = frozenset(k for k, name in enumerate(arrays) if name in clocks)
    return dataclasses.replace(table, named=named, stamps=stamps)


def unit_of(values: Any, name: str, siblings: Any) -> str:
    """Unit of a column: its attribute "units", or the end of its name."""
    attributes = getattr(values, "attrs", None)
    stored = attributes.get("units") if isinstance(attributes, Mapping) else None
    return stored if isinstance(stored, str) else split_unit(name, siblings)[1]


def _numbers(values: Any) -> np.ndarray:
    """A column as numbers, missing values NaN; as it is where it holds text, and as text where it holds complex numbers."""
    try:
        return real_numbers(values)
    except (TypeError, ValueError):
        if np.iscomplexobj(values):
            return np.asarray(values).astype(str)
    if hasattr(values, "to_numpy"):  # columns of pandas with missing whole numbers
        try:
            return values.to_numpy(dtype=float, na_value=np.nan)
        except (TypeError, ValueError):
            pass
    return np.asarray(values)


def is_clock(values: Any) -> bool:
    """Whether a column holds dates or durations; pandas and polars name their types so."""
    kind = str(getattr(values, "dtype", "")).lower()
    return kind.startswith(("datetime", "timedelta", "duration"))


def seconds_of(values: Any) -> np.ndarray:
    """Dates or durations as seconds from the first one that is there, NaN where missing."""
    kind = str(values.dtype).lower()
    return seconds_passed(
        np.asarray(values, dtype=f"{'datetime' if kind.startswith('datetime') else 'timedelta'}64[ns]")
    )


def seconds_passed(stamps: np.ndarray) -> np.ndarray:
    """Dates or durations of numpy as seconds from the first one that is there, NaN where missing; all NaN for months and years."""
    there = stamps[~np.isnat(stamps)]
    passed = stamps - (there[0] if there.size else stamps[0])
    if np.datetime_data(passed.dtype)[0] in ("Y", "M", "generic"):
        return np.full(stamps.size, np.nan)
    return np.where(np.isnat(passed), np.nan, passed / np.timedelta64(1, "s"))
