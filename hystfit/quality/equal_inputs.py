"""How far records lie apart whose inputs are equal: the least error that any one model of the input has on all of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from hystfit.data.record import Record
from hystfit.outcome.note import Code, Note, warn
from hystfit.quality.baselines import USABLE
from hystfit.quality.loops import SAME_LEVEL, closed_loops, loop_branches

_EDGES = np.linspace(0.015, 0.985, 98)
_GRID = (_EDGES[1:] + _EDGES[:-1]) / 2  # parts of the range at which loops are compared, apart from the turning points


@dataclasses.dataclass(frozen=True)
class _Loop:
    """The last of the largest loops of a record.

    Attributes:
        name: of the record.
        low, high: range of its input.
        duration: of the loop; None without time.
        samples: number of the loop's.
        outputs: of the rising and then of the falling branch at `_GRID`, without the mean of the samples.
        counts: of the samples next to each of these.
    """

    name: str
    low: float
    high: float
    duration: float | None
    samples: int
    outputs: np.ndarray
    counts: np.ndarray

    def like(self, other: _Loop) -> bool:
        """Whether the other loop has the same input: its range and, where both are timed, its speed."""
        near = SAME_LEVEL * (self.high - self.low)
        if self.duration and other.duration and abs(self.duration - other.duration) > SAME_LEVEL * self.duration:
            return False  # a law of the rate may tell them apart
        return abs(self.low - other.low) <= near and abs(self.high - other.high) <= near


@dataclasses.dataclass(frozen=True)
class RecordsApart:
    """Records of equal inputs whose outputs differ.

    Attributes:
        names: of the records.
        rms: least rms error of one model on the samples of their largest loops, each with an offset of its own [y].
        samples: number of those loops'.
    """

    names: tuple[str, ...]
    rms: float
    samples: int


def records_apart(records: Sequence[Record]) -> RecordsApart | None:
    """The records of equal inputs that are furthest apart; None where no two have loops over one range at one speed."""
    loops = [loop for loop in map(_largest_loop, records if len(records) > 1 else ()) if loop is not None]
    groups = [[other for other in loops if loop.like(other)] for loop in loops]
    found = [_apart(group) for group in groups if len(group) > 1]
    return max(found, key=lambda one: one.rms, default=None)


def _apart(group: Sequence[_Loop]) -> RecordsApart:
    outputs, counts = (np.array([getattr(loop, name) for loop in group]) for name in ("outputs", "counts"))
    mean = (counts * outputs).sum(axis=0) / np.maximum(counts.sum(axis=0), 1)
    samples = sum(loop.samples for loop in group)
    rms = float(np.sqrt((counts * (outputs - mean) ** 2).sum() / samples))
    return RecordsApart(tuple(loop.name for loop in group), rms, samples)


def apart_note(records: Sequence[Record], least: float = USABLE) -> Note | None:
    """The warning on records that no one model describes; None where any one is not known to err by more than `least` percent of the range.

    By default, that is what a usable fit may err. Its option reads the first of them, where they are curves of one file.
    """
    found, (span, _) = records_apart(records), _range_and_samples(records)
    if found is None or 100 * found.rms <= least * span:
        return None
    first, *others = found.names
    text = (
        f"the loops of {len(found.names)} records, {first!r} and {others[-1]!r} among them, differ at equal inputs: a single model has an "
        f"error of at least {100 * found.rms / span:.2g} % of the range. Fit each one separately (only=), or all of them with hystfit batch"
    )
    return dataclasses.replace(warn(Code.RECORDS_DIFFER, text), option=option_of(first, records))


def option_of(name: str, records: Iterable[Record]) -> tuple[str, str] | None:
    """The option of reading that leaves one of several records of a file; None for records of several files."""
    of_one_file = len({record.source for record in records}) == 1
    return ("only", name.partition("=")[2] or name) if of_one_file else None


def none_describes(records: Sequence[Record]) -> bool:
    """Whether equal inputs alone let any one model err more on all samples than a usable fit may: no choice of a model changes that."""
    found, (span, samples) = records_apart(records), _range_and_samples(records)
    return found is not None and 100 * found.rms * np.sqrt(found.samples / samples) > USABLE * span


def _range_and_samples(records: Sequence[Record]) -> tuple[float, int]:
    """Range of the outputs that count, and their number."""
    every = np.concatenate([record.y[record.used] for record in records])
    return float(np.ptp(every)), every.size


def _largest_loop(record: Record) -> _Loop | None:
    """That of a record without missing outputs; None where no loop over most of its range is closed."""
    u, y = record.u, record.y
    if not record.used.all() or not np.ptp(u) > 0:
        return None
    loops = closed_loops(u, SAME_LEVEL * float(np.ptp(u)))
    largest = max((loop.stroke for loop in loops), default=0.0)
    if largest < 0.5 * np.ptp(u):
        return None
    loop = [loop for loop in loops if loop.stroke >= (1 - SAME_LEVEL) * largest][-1]
    part = slice(loop.start, loop.stop + 1)
    low, high = float(u[part].min()), float(u[part].max())
    centers, rising, falling = loop_branches(u[part], y[part])
    at = low + (high - low) * _GRID
    outputs = np.concatenate([np.interp(at, centers, branch) for branch in (rising, falling)])
    place, upward = (u[part] - low) / (high - low), np.gradient(u[part]) > 0
    counts = np.concatenate([np.histogram(place[way], _EDGES)[0] for way in (upward, ~upward)])
    outputs -= np.average(outputs, weights=counts) if counts.any() else outputs.mean()
    duration = None if record.t is None else float(record.t[loop.stop] - record.t[loop.start])
    return _Loop(record.name, low, high, duration, part.stop - part.start, outputs, counts)
