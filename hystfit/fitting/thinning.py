"""A short form of the records on which starting points are fitted, before one of them is polished on every sample."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from hystfit.data.batch import Batch, bucket
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.inference.objective import Objective
from hystfit.inference.problem import Problem
from hystfit.params.host_arrays import to_device
from hystfit.quality.loops import clear_reversals

_SAMPLES = 1024  # of all records together
LEAST = 256  # of each record; those on which starts, and loops, are compared
_A_BRANCH = 12  # samples between two reversals of the input, on average
_PAYS = 2  # times as many samples make the short form worth its compilation


def thin(problem: Problem, samples: int = _SAMPLES) -> Objective | None:
    """The objective on every k-th sample and the reversals of the input; None for short records, and models that do not allow it.

    All records together keep `samples`, or more where the input has many reversals.
    """
    found = kept_samples(problem.data, problem.objective.batch.u.shape[1], samples)
    if found is None or not problem.model.allows_thinning:
        return None
    numbers, length = found
    batch = problem.objective.batch
    u, y, dt, weight = (np.asarray(values) for values in (batch.u, batch.y, batch.dt, batch.weight))
    rows = []
    for number, kept in enumerate(numbers):
        padding = (0, length - kept.size)  # as `Batch` pads
        elapsed = np.diff(np.cumsum(dt[number])[kept], prepend=0.0)
        others = (np.pad(values, padding) for values in (y[number, kept], elapsed, weight[number, kept]))
        rows.append((np.pad(u[number, kept], padding, mode="edge"), *others))
    short = Batch(*(to_device(np.stack(column)) for column in zip(*rows, strict=True)))
    return dataclasses.replace(problem.objective, batch=short)


def kept_samples(
    records: Iterable[Record], padded: int, samples: int = _SAMPLES
) -> tuple[list[np.ndarray], int] | None:
    """Numbers of the samples of each record in the short form, and its length; None for short records, see `thin`.

    Args:
        records: the records.
        padded: samples of a record, padding included.
        samples: that all records together keep, or more where the input has many reversals.
    """
    records = list(records)
    turns, length = _plan(records, samples)
    if _PAYS * length > padded:
        return None
    return [_kept_samples(len(record), turn, length) for record, turn in zip(records, turns, strict=True)], length


def thinned(data: Dataset, samples: int = _SAMPLES) -> Dataset:
    """Records of every k-th sample and the reversals of the input, for a quick fit; short records as they are.

    Args:
        data: records.
        samples: that all records together keep, see `thin`.
    """
    turns, length = _plan(data, samples)
    pairs = zip(data, turns, strict=True)
    return Dataset(
        tuple(r.take(_kept_samples(len(r), turn, length)) if len(r) > _PAYS * length else r for r, turn in pairs),
        data.name,
    )


def _plan(data: Iterable[Record], samples: int = _SAMPLES) -> tuple[list[np.ndarray], int]:
    """Reversals of the input of every record, and the number of samples to keep of each."""
    turns = [clear_reversals(record.u) for record in data]
    most = max(turn.size for turn in turns)
    return turns, bucket(max(samples // len(turns), LEAST, _A_BRANCH * most))


def _kept_samples(samples: int, turns: np.ndarray, most: int) -> np.ndarray:
    """Numbers of at most `most` samples: the turning points, the first and last one, and as many evenly spaced ones as have room."""
    fixed = np.concatenate([[0], turns, [samples - 1]])
    even = np.linspace(0, samples - 1, min(samples, most - fixed.size)).round()
    return np.unique(np.concatenate([fixed, even])).astype(int)
