"""Records as arrays for compiled code, padded to common lengths so that new data rarely cause a compilation."""

from __future__ import annotations

import math
from collections.abc import Iterable

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.params.host_arrays import to_device, zeros

_SMALLEST, _LONG = 64, 4096


def bucket(length: int) -> int:
    """Smallest common length that holds so many samples: 2^k or 3 * 2^(k-1), at least 64; in sixteenths of 2^k from 4096 on.

    Short records share few lengths, because a compilation takes longer than their padding; long ones waste at most 6 %.
    """
    size = _SMALLEST
    while 2 * size <= length:
        size *= 2
    step = size // 16 if size >= _LONG else size // 2
    return max(_SMALLEST, step * math.ceil(length / step))


class Batch(eqx.Module):
    """Arrays of one or more records; no labels, which would be keys of the compilation cache."""

    u: Float[Array, "R T"]  # u, y, dt: shape (R, T); u is padded with its last value, dt and y with 0, missing y are 0
    y: Float[Array, "R T"]
    dt: Float[Array, "R T"]
    weight: Float[Array, "R T"]  # shape (R, T), 0 where a sample does not count (outside the window, missing, padding)

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


def _column(values: Iterable[np.ndarray], length: int, *, hold: bool = False) -> Array:
    """One row for each record, padded with 0, or with its last value."""
    rows = list(values)
    columns = zeros(len(rows), length)
    for column, row in zip(columns, rows, strict=True):
        column[: row.size], column[row.size :] = row, row[-1] if hold else 0.0
    return to_device(columns)
