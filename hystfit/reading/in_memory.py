"""Records from what Python users hold: arrays, data frames (pandas, polars), dictionaries of columns, xarray datasets.

Data frames are recognized by what they can do, so that none of these packages is imported.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.reading.header import split_unit
from hystfit.reading.raw_table import Table, plain_table
from hystfit.reading.read import assemble
from hystfit.reading.several import with_column

_NAMES = "the columns of a data frame are chosen by u=, y= and t="


def records_of(data: Any, y: Any = None, t: Any = None, *, u: Any = None) -> Dataset:
    """Records from records, from a data frame, or from arrays.

    Args:
        data: a `Record`, a `Dataset`, a data frame, or a list of these; or the input, shape (T,).
        y: output, shape (T,); of a data frame the name or number of its column, guessed where None.
        t: time of each sample [s], shape (T,), or a column as for `y`; None where there is none.
        u: input, shape (T,), instead of `data`; of a data frame the name or number of its column.

    Raises:
        DataError: the data are none of these, or cannot make a record.
    """
    if is_frame(data):
        return Dataset.of(_framed(data, u, y, t, "data"))
    if y is None and u is None:
        return Dataset.of(_records(data, t))
    if isinstance(data, Record | Dataset):
        raise DataError("a record has its own columns: leave out u=, y= and t=")
    if (data is None) == (u is None):
        raise DataError("give the input once: as the first array, or as u=")
    if y is None:
        raise DataError("an input without an output cannot be fitted: give y, the measured output of each sample")
    return Dataset.of(_record(data if u is None else u, y, t))


def excitation_of(data: Any, t: Any = None, *, u: Any = None, like: Record) -> Record:
    """A record that drives a model: its output is 0 with weight 0 where `data` is not a record.

    Args:
        data: a `Record`, a data frame, or the input, shape (T,).
        t: time of each sample, shape (T,), or of a data frame the name or number of its column.
        u: column of the input in a data frame; that of the fitted record or a guess where None.
        like: a fitted record, which gives names and units.

    Raises:
        DataError: the data are none of these, or the input cannot be used.
    """
    if isinstance(data, Record):
        if t is not None or u is not None:
            raise DataError("a record has its own columns: leave out u= and t=")
        return data
    if isinstance(data, Dataset):
        raise DataError("one record is predicted at a time: [result.predict(record) for record in data]")
    if is_frame(data):
        known = like.u_name if u is None and like.u_name in _columns(data) else u
        record = _framed(data, known, None, t, "data", no_output=True)
        assert isinstance(record, Record)  # one curve: nothing divides it
        return record.replace(weight=np.zeros(len(record)), y_unit=like.y_unit, y_name=like.y_name)
    if u is not None:
        raise DataError("u= chooses a column of a data frame: give an array as the first argument")
    values = _vector(data, "the input u")
    units = {"u_unit": like.u_unit, "y_unit": like.y_unit, "t_unit": like.t_unit}
    nothing = np.zeros(values.size)
    return Record(values, nothing, t=t, weight=nothing, u_name=like.u_name, y_name=like.y_name, name="input", **units)


def is_frame(data: Any) -> bool:
    """Whether an object holds columns by name: a data frame, a dictionary, an xarray dataset, a structured array."""
    named = isinstance(data, Mapping) or getattr(getattr(data, "dtype", None), "names", None) is not None
    return named or (hasattr(data, "columns") and hasattr(data, "__getitem__"))


def _records(data: Any, t: Any) -> Any:
    """Records as they are, and a list of data frames as records."""
    if t is not None:
        raise DataError("t= goes with the arrays u and y, or with a data frame: a record has its own time")
    if isinstance(data, str):
        raise DataError(f"read the file first: hystfit.read({data!r})")
    if hasattr(data, "ndim") and not isinstance(data, Record | Dataset):
        _vector(data, "the input u")
        raise DataError("one array is an input without an output: give the input, the output and the time as u, y, t")
    if isinstance(data, list | tuple) and any(is_frame(item) for item in data):
        framed = (_framed(item, None, None, None, f"data {k}") for k, item in enumerate(data, start=1))
        return [record for item in framed for record in Dataset.of(item)]
    return data


def _vector(values: Any, what: str) -> np.ndarray:
    """One column of numbers.

    Raises:
        DataError: not numbers, or an array of another number of dimensions.
    """
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise DataError(f"{what} must be an array of numbers, got {type(values).__name__}") from error
    if array.ndim == 2:
        raise DataError(
            f"{what} must be one column, got an array of shape {array.shape}: give its columns one by one, or make a record, "
            "hystfit.Record(u=a[:, 0], y=a[:, 1], t=a[:, 2])"
        )
    if array.ndim != 1:
        raise DataError(f"{what} must be one column, shape (T,), got shape {array.shape}")
    return array


def _record(u: Any, y: Any, t: Any) -> Record:
    columns = {"u": _vector(u, "the input u"), "y": _vector(y, "the output y")}
    if t is not None:
        columns["t"] = _seconds(t) if _is_clock(t) else _vector(t, "the time t")
    labels: dict[str, str] = {}
    for symbol, values in (("u", u), ("y", y)):
        name = getattr(values, "name", None)
        if isinstance(name, str):
            labels |= {f"{symbol}_name": name, f"{symbol}_unit": _unit(values, name, ())}
    return Record(**columns, **labels)


def _framed(data: Any, u: Any, y: Any, t: Any, name: str, *, no_output: bool = False) -> Record | Dataset:
    """The record in the columns of a data frame."""
    for role, column in (("u", u), ("y", y), ("t", t)):
        if column is not None and not isinstance(column, str | int | np.integer):
            raise DataError(
                f"{role}= must be the name or number of a column of the data frame, got {type(column).__name__}"
            )
    table = _table(data)
    if no_output:
        y = "no output"
        table = with_column(table, y, np.zeros(table.rows))
    try:
        return assemble(table, time=t, input=u, output=y, name=name)
    except DataError as error:
        raise DataError(f"{error} ({_NAMES})") from error


def _columns(data: Any) -> dict[Any, Any]:
    """The columns of a data frame by name, a meaningful index of its rows first."""
    if getattr(getattr(data, "dtype", None), "names", None) is not None:
        return {name: data[name] for name in data.dtype.names}
    names = [*getattr(data, "coords", ()), *data] if isinstance(data, Mapping) else list(data.columns)
    if len(set(names)) < len(names):
        raise DataError("the columns of the data frame must have different names")
    columns = {name: data[name] for name in names}
    index = getattr(data, "index", None)
    if index is not None and getattr(index, "nlevels", 0) == 1 and (index.name is not None or _is_clock(index)):
        label = "time" if index.name is None else index.name
        return columns if label in columns else {label: index, **columns}
    return columns


def _table(data: Any) -> Table:
    """The columns of a data frame as those of a file.

    Raises:
        DataError: no columns of numbers, or columns of different lengths.
    """
    arrays: dict[Any, np.ndarray] = {}
    units: dict[Any, str] = {}
    columns = _columns(data)
    clocks = {name for name, values in columns.items() if _is_clock(values)}
    for name, values in columns.items():
        array = _seconds(values) if name in clocks else _numbers(values)
        if array.ndim == 1:
            arrays[name] = array
            units[name] = "s" if name in clocks else _unit(values, str(name), [str(other) for other in columns])
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


def _unit(values: Any, name: str, siblings: Any) -> str:
    """Unit of a column: its attribute "units", or the end of its name."""
    attributes = getattr(values, "attrs", None)
    stored = attributes.get("units") if isinstance(attributes, Mapping) else None
    return stored if isinstance(stored, str) else split_unit(name, siblings)[1]


def _numbers(values: Any) -> np.ndarray:
    """A column as numbers, missing values NaN; as it is where it holds text."""
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        pass
    if hasattr(values, "to_numpy"):  # columns of pandas with missing whole numbers
        try:
            return values.to_numpy(dtype=float, na_value=np.nan)
        except (TypeError, ValueError):
            pass
    return np.asarray(values)


def _is_clock(values: Any) -> bool:
    """Whether a column holds dates or durations; pandas and polars name their types so."""
    kind = str(getattr(values, "dtype", "")).lower()
    return kind.startswith(("datetime", "timedelta", "duration"))


def _seconds(values: Any) -> np.ndarray:
    """Dates or durations as seconds from the first one that is there, NaN where missing."""
    kind = str(values.dtype).lower()
    plain = np.asarray(values, dtype="datetime64[ns]" if kind.startswith("datetime") else "timedelta64[ns]")
    there = plain[~np.isnat(plain)]
    passed = plain - (there[0] if there.size else plain[0])
    return np.where(np.isnat(passed), np.nan, passed / np.timedelta64(1, "s"))
