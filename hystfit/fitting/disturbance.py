"""A short stretch of samples that carries half of the squared error of a record: a disturbance of the sensor, or an event."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.quality.baselines import BLOCK

ROBUST_LOSS = ("loss", "huber")  # option of a fit in which few large errors count less

_SHORT = 0.03  # of the samples of a record
_LARGER = 5.0  # times the rms error of the other samples
# Residuals belong to the stretch that are this many times that rms error, with at most so many samples between two of them.
_OUTSIDE, _GAP = 4.0, 4


def disturbance_note(rows: Sequence[np.ndarray], data: Dataset, *, robust: bool = False) -> Note | None:
    """A warning that names the first such stretch; None where there is none.

    Args:
        rows: residuals of the samples that count, for each record.
        data: the records.
        robust: the loss was robust.
    """
    for row, record in zip(rows, data, strict=True):
        if not (row.any() and np.isfinite(row).all()):
            continue
        first, last = shortest_half(row**2)
        if first == 0 or last - first + 1 > _SHORT * row.size:
            continue
        others = float(np.sqrt(np.mean(np.delete(row, slice(first, last + 1)) ** 2)))
        ratio = float(np.sqrt(np.mean(row[first : last + 1] ** 2))) / max(others, 1e-300)
        if ratio < _LARGER:
            continue
        far = np.flatnonzero(np.abs(row) > _OUTSIDE * others)
        stretch = next(part for part in np.split(far, np.flatnonzero(np.diff(far) > _GAP) + 1) if part[-1] >= first)
        number = np.flatnonzero(record.used)[[min(first, stretch[0]), max(last, stretch[-1])]]
        remedy = "mark them as missing" + ("" if robust else ", or use a robust loss (loss='huber')")
        note = warn(
            Code.SPIKES,
            f"most of the squared error of {record.name!r} lies in samples {number[0]} to {number[1]} of {len(record)}, where the error "
            f"is {ratio:.2g} times that of the others: if the sensor was disturbed there, {remedy}",
        )
        return note if robust else dataclasses.replace(note, option=ROBUST_LOSS)
    return None


def shortest_half(squares: np.ndarray) -> tuple[int, int]:
    """First and last of the fewest samples in a row that carry half of a sum of squares, shape (n,)."""
    count, total = squares.size, np.zeros(squares.size + 1)
    np.cumsum(squares, out=total[1:])
    first, fewest = 0, count + 1
    for begin in range(0, count, BLOCK):
        starts = np.arange(begin, min(begin + BLOCK, count))
        stops = np.searchsorted(total, total[starts] + 0.5 * total[-1])
        length = np.where(stops <= count, stops - starts, count)
        if length.min() < fewest:
            first, fewest = begin + int(np.argmin(length)), int(length.min())
    return first, first + fewest - 1
