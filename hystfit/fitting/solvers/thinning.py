"""Short forms of the records: one on which starting points are fitted, before one of them is polished on every sample, and one for
comparisons of models on records that are sampled far finer than their signals.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from hystfit.data.batch import Batch, bucket
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.inference.objective import Objective
from hystfit.inference.problem import Problem
from hystfit.outcome import Code
from hystfit.params.host_arrays import to_device
from hystfit.quality.loops import clear_reversals

SAMPLES = 1024  # of all records together
LEAST = 256  # of each record; those on which starts, and loops, are compared
PAYS = 2  # times as many samples make the short form worth its compilation
_ENOUGH = 30_000  # samples of all records together on which models are compared: errors of 1 % are told apart, see `equal_errors`
_TIP = 100  # samples of a branch, of which the mean of the last ones is 0.25 % of the range short of a sharp tip
# Largest rms error of straight lines between the samples kept, over that of lines between every second sample (noise), or over the range.
_NOISE, _CURVED = 1.02, 2e-4


def thin(problem: Problem, samples: int = SAMPLES) -> Objective | None:
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


def kept_samples(records: Iterable[Record], padded: int, samples: int = SAMPLES) -> tuple[list[np.ndarray], int] | None:
    """Numbers of the samples of each record (`padded`: with padding) in the short form, and its length; None for short ones; see `thin`."""
    records = list(records)
    turns, length = _plan(records, samples)
    if PAYS * length > padded:
        return None
    return [_kept_samples(len(record), turn, length) for record, turn in zip(records, turns, strict=True)], length


def thinned(data: Dataset, samples: int = SAMPLES) -> Dataset:
    """Records of every k-th sample and the reversals of the input, for a quick fit, see `thin`; short records as they are."""
    turns, length = _plan(data, samples)
    pairs = zip(data, turns, strict=True)
    return Dataset(
        tuple(r.take(_kept_samples(len(r), turn, length)) if len(r) > PAYS * length else r for r, turn in pairs),
        data.name,
    )


def coarse(data: Dataset) -> Dataset:
    """Means of k samples at a time, for a choice between models, where straight lines over these describe the samples but for noise.

    Records of few samples stay as they are, and those that such lines do not describe: a resonance, or few samples in a cycle.
    """
    samples = sum(map(len, data))
    if samples < 2 * _ENOUGH:
        return data
    branches = sum(clear_reversals(record.u).size + 1 for record in data)
    step = min(samples // max(_ENOUGH, _TIP * branches), min(map(len, data)) // LEAST)
    while step > 1 and not all(_straight(values, step) for record in data for values in (record.u, record.y)):
        step //= 2
    return data.map(lambda record: _means(record, step)) if step > 1 else data


def _means(record: Record, step: int) -> Record:
    """Means of k samples at a time; a shorter rest at the end is left out."""
    count = len(record) // step
    rows = lambda values: values[: count * step].reshape(count, step)
    weight = rows(np.where(record.used, record.weight, 0.0))
    total = weight.sum(axis=1)
    sums = (weight * rows(np.where(record.used, record.y, 0.0))).sum(axis=1)
    short = record.take(slice(0, count))
    return short.replace(
        u=rows(record.u).mean(axis=1),
        y=np.where(total > 0, sums / np.where(total > 0, total, 1.0), np.nan),
        t=None if record.t is None else rows(record.t).mean(axis=1),
        weight=total / step,
    ).noted(
        Code.PREPARED,
        f"models were compared on means of {step} samples, because straight lines between the means describe the {len(record)} samples "
        "except for noise; --model NAME (model=NAME) fits a model to all samples",
    )


def _straight(values: np.ndarray, step: int) -> bool:
    """Whether lines between every k-th sample describe the samples halfway as well as their noise allows."""
    error = lambda k: float(np.sqrt(np.nanmean(_halfway(values, k) ** 2)))
    return error(step) <= max(_NOISE * error(2), _CURVED * float(np.ptp(values[np.isfinite(values)])))


def _halfway(values: np.ndarray, step: int) -> np.ndarray:
    """Samples halfway between every k-th sample, less the straight line."""
    half = step // 2
    ends, middle = values[::step], values[half::step]
    count = min(ends.size - 1, middle.size)
    share = half / step
    return middle[:count] - (1 - share) * ends[:count] - share * ends[1 : count + 1]


def _plan(data: Iterable[Record], samples: int = SAMPLES) -> tuple[list[np.ndarray], int]:
    """Reversals of the input of every record, and the number of samples to keep of each."""
    turns = [clear_reversals(record.u) for record in data]
    most = max(turn.size for turn in turns)
    return turns, bucket(max(samples // len(turns), LEAST, 12 * most))  # twelve between two reversals, on average


def _kept_samples(samples: int, turns: np.ndarray, most: int) -> np.ndarray:
    """Numbers of at most `most` samples: the turning points, the first and last one, and as many evenly spaced ones as have room."""
    fixed = np.concatenate([[0], turns, [samples - 1]])
    even = np.linspace(0, samples - 1, min(samples, most - fixed.size)).round()
    return np.unique(np.concatenate([fixed, even])).astype(int)
