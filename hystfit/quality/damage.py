"""The parts of a damaged record before the damage, which models without terms for it can describe, and before the failure."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.data.record import Record
from hystfit.quality.loops import SEVERAL, clear_reversals, cycles
from hystfit.quality.record_quality import WHOLE, RecordQuality
from hystfit.quality.summary import losses, without_outliers

FAILED = 0.8  # of the largest force, to which that of later peaks has fallen at failure (ASTM E2126)


def whole_until(record: Record, quality: RecordQuality) -> float | None:
    """End of the longest part from the start, of whole cycles, that shows no loss of stiffness or strength.

    Found by bisection: damage does not heal.

    Returns:
        A time [unit of t], or a number of samples for a record without time; None for an undamaged record, for one that is softer after
        larger strokes (Mullins effect), for damage from the start, and where the clock is unusable, in which a window is given.
    """
    timed = quality.sampling.rate is not None
    if not quality.degrading or quality.softens_with_stroke or timed != (record.t is not None):
        return None
    ends = (cycles(record.u, quality.motion.threshold)[:, -1] + 1).tolist()

    def sound(end: int) -> bool:
        part = dataclasses.replace(quality, **losses(record.segment(0, end)))  # of the same device
        return not part.degrading and (part.stiffness_left is None or part.stiffness_left >= WHOLE)

    low, high = SEVERAL, len(ends)
    if high <= low or not sound(ends[low - 1]):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if sound(ends[middle - 1]) else (low, middle)
    end = ends[low - 1]
    return float(end) if record.t is None else float(record.t[end - 1])


def fails_at(record: Record, quality: RecordQuality) -> float | None:
    """Where a device fails: the last sample at which 80 % of the largest force is reached, though later strokes are as long.

    Returns:
        A time [unit of t], or a number of samples for a record without time; None for a device that loses no strength, and for one that
        was not moved as far again.
    """
    if not quality.weakens or not quality.degrading or quality.softens_with_stroke:
        return None
    used = np.flatnonzero(without_outliers(record).used)
    u, force = np.abs(record.u[used]), np.abs(record.y[used])
    last = int(np.flatnonzero(force >= FAILED * force.max())[-1])
    turns = clear_reversals(record.u[used])
    later = turns[turns > last]  # the rest of the branch on which it fails is no later stroke
    if not later.size or u[later[0] :].max() < u[: last + 1].max():
        return None
    end = int(used[last]) + 1
    return float(end) if record.t is None else float(record.t[end - 1])
