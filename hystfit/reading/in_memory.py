"""Records from what Python users hold: arrays, data frames (pandas, polars), dictionaries of columns, xarray datasets."""

from __future__ import annotations

from typing import Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.preparation import real_numbers
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.reading.assemble import assemble
from hystfit.reading.frames import columns_of, frame_table, is_clock, is_frame, seconds_of, unit_of

_NAMES = "the columns of a data frame are chosen by u=, y= and t=; hystfit.read(frame, rate=..., units=..., by=...) has more options"


def records_of(data: Any, y: Any = None, t: Any = None, *, u: Any = None) -> Dataset:
    """Records from records, from a data frame, or from arrays.

    Args:
        data: a `Record`, a `Dataset`, a data frame, or a list of these; or the input, shape (T,).
        y: output, shape (T,); of a data frame the name or number of its column, guessed where None.
        t: time of each sample [s], shape (T,), or a column as for `y`; None where there is none.
        u: input, shape (T,), instead of `data`; of a data frame the name or number of its column.
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
    """
    if isinstance(data, Record):
        if t is not None or u is not None:
            raise DataError("a record has its own columns: leave out u= and t=")
        return data
    if isinstance(data, Dataset):
        raise DataError("one record is predicted at a time: [result.predict(record) for record in data]")
    if is_frame(data):
        known = like.u_name if u is None and like.u_name in columns_of(data) else u
        record = _framed(data, known, None, t, "data", no_output=True)
        assert isinstance(record, Record)  # one curve: nothing divides it
        return record.replace(weight=np.zeros(len(record)), y_unit=like.y_unit, y_name=like.y_name)
    if u is not None:
        raise DataError("u= chooses a column of a data frame: give an array as the first argument")
    values = _vector(data, "the input u")
    units = {"u_unit": like.u_unit, "y_unit": like.y_unit, "t_unit": like.t_unit}
    nothing = np.zeros(values.size)
    return Record(values, nothing, t=t, weight=nothing, u_name=like.u_name, y_name=like.y_name, name="input", **units)


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
    """One column of numbers."""
    try:
        array = real_numbers(values)
    except (TypeError, ValueError) as error:
        raise DataError(f"{what} must be an array of numbers, got {type(values).__name__} ({error})") from error
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
        columns["t"] = seconds_of(t) if is_clock(t) else _vector(t, "the time t")
    labels: dict[str, str] = {}
    for symbol, values in (("u", u), ("y", y)):
        name = getattr(values, "name", None)
        if isinstance(name, str):
            labels |= {f"{symbol}_name": name, f"{symbol}_unit": unit_of(values, name, ())}
    return Record(**columns, **labels)


def _framed(data: Any, u: Any, y: Any, t: Any, name: str, *, no_output: bool = False) -> Record | Dataset:
    """The record in the columns of a data frame."""
    for role, column in (("u", u), ("y", y), ("t", t)):
        if column is not None and not isinstance(column, str | int | np.integer):
            raise DataError(
                f"{role}= must be the name or number of a column of the data frame, got {type(column).__name__}"
            )
    table = frame_table(data)
    if no_output:
        y = "no output"
        table = table.beside(y, np.zeros(table.rows))
    try:
        return assemble(table, time=t, input=u, output=y, name=name)
    except DataError as error:
        raise DataError(f"{error} ({_NAMES})") from error
