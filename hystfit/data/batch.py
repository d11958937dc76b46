"""Records as arrays for compiled code, padded to common lengths so that new data rarely cause a compilation."""

from __future__ import annotations

import math
import weakref
from collections.abc import Iterable
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from hystfit.config import platform, shares_programs
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.params.host_arrays import to_device, zeros
from hystfit.params.plain_module import PlainModule

_SMALLEST, _LONG = 64, 4096
_ROOM = 4096  # samples of all records up to which all lengths share the arrays of a program: 0.1 MB for each derivative
# Samples of all records up to which their padded arrays are kept, 2 MB: to pad ten records of 802 samples takes 0.5 ms, and to linearize
# 19 parameters of `bouc-wen-force+relaxation` on them 4 ms.
_KEPT = 2**16


def bucket(length: int) -> int:
    """Smallest common length that holds so many samples: 2^k or 3 * 2^(k-1), at least 64; in sixteenths of 2^k from 4096 on.

    Short records share few lengths, because a compilation takes longer than their padding; long ones waste at most 6 %.
    """
    return _rounded_up(length, 2 if length < _LONG else 16)


def room(length: int, records: int = 1) -> int:
    """Length of the arrays of a program that is told how many of its samples count.

    It is that of `bucket`, or larger where one program is to serve more records (`shares_programs`): what lies behind the samples costs
    memory and no steps of a scan. With it a default fit of 400 samples takes 50 ms in place of 30, and the next record no compilation.
    """
    if not shares_programs():
        return bucket(length)
    return _rounded_up(max(length, _ROOM // records), 2)


def _rounded_up(length: int, parts: int) -> int:
    """To a whole number of parts of the largest 2^k that fits, from 64 on."""
    size = _SMALLEST
    while 2 * size <= length:
        size *= 2
    step = size // parts
    return max(_SMALLEST, step * math.ceil(length / step))


def in_room(values: np.ndarray, *, hold: bool = False) -> np.ndarray:
    """A signal, shape (T,), in an array of a common length, see `room`, padded with 0 or with its last value; not to be changed."""
    row = zeros(room(values.size))
    row[: values.size], row[values.size :] = values, values[-1] if hold else 0.0
    return row


class Batch(PlainModule):
    """Arrays of one or more records; no labels, which would be keys of the compilation cache."""

    u: Float[Array, "R T"]  # u, y, dt: shape (R, T); u is padded with its last value, dt and y with 0, missing y are 0
    y: Float[Array, "R T"]
    dt: Float[Array, "R T"]
    weight: Float[Array, "R T"]  # shape (R, T), 0 where a sample does not count (outside the window, missing, padding)
    counts: Int[Array, " R"] | None = None  # samples of each record that are simulated, shape (R,); None for all

    def count_of(self, record: Any) -> Array | None:
        """Samples of one record that are simulated."""
        return None if self.counts is None else self.counts[record]

    def with_room(self, counts: Int[np.ndarray, " R"] | None = None) -> Batch:
        """The same samples in arrays of common lengths, see `room`, and how many of each record are simulated: all that count, or `counts`.

        Those of few samples are kept as long as the batch: the iterations of a fit ask for the same ones hundreds of times.
        """
        records, length = self.u.shape
        wide = room(length, records)
        asked = wide, None if counts is None else counts.tobytes(), platform()
        known, roomy = _roomy.get(id(self), (None, None))
        if roomy is not None and known == asked:
            return roomy
        if counts is None:
            counts = length - np.argmax(np.asarray(self.weight)[:, ::-1] > 0, axis=1)
        rows = (_column(np.asarray(values), wide, hold=k == 0) for k, values in enumerate(self.signals))
        roomy = Batch(*rows, counts=to_device(counts))
        if records * wide <= _KEPT and all(isinstance(values, jax.Array) for values in self.signals):
            if id(self) not in _roomy:
                weakref.finalize(self, _roomy.pop, id(self), None)
            _roomy[id(self)] = asked, roomy
        return roomy

    @property
    def signals(self) -> tuple[Array, Array, Array, Array]:
        """Arrays of one row for each record: u, y, dt and weight."""
        return self.u, self.y, self.dt, self.weight

    @classmethod
    def of(cls, data: Record | Dataset) -> Batch:
        """Arrays of a data set."""
        records = list(Dataset.of(data))
        length = bucket(max(len(record) for record in records))
        return cls(
            u=_column([record.u for record in records], length, hold=True),
            y=_column((np.where(record.used, record.y, 0.0) for record in records), length),
            dt=_column((record.dt for record in records), length),
            weight=_column((np.where(record.used, record.weight, 0.0) for record in records), length),
        )

    @property
    def count(self) -> int:
        """Number of samples that count."""
        return int(np.count_nonzero(np.asarray(self.weight)))


# Of batches that cannot change, by `id`: padding them anew took a quarter of the processor time of a comparison on 22 samples.
_roomy: dict[int, tuple[tuple[Any, ...], Batch]] = {}


def _column(values: Iterable[np.ndarray], length: int, *, hold: bool = False) -> Array:
    """One row for each record, padded with 0, or with its last value."""
    rows = list(values)
    columns = zeros(len(rows), length)
    for column, row in zip(columns, rows, strict=True):
        column[: row.size], column[row.size :] = row, row[-1] if hold else 0.0
    return to_device(columns)
