"""The part of a damaged record before the damage, which models without terms for damage can describe."""

from __future__ import annotations

from hystfit.data.record import Record
from hystfit.quality.loops import cycles
from hystfit.quality.record_quality import WHOLE, RecordQuality
from hystfit.quality.summary import summarize

_FEWEST = 3  # cycles worth a fit


def whole_until(record: Record, quality: RecordQuality) -> float | None:
    """End of the longest part from the start, of whole cycles, that shows no loss of stiffness or strength.

    Found by bisection: damage does not heal.

    Args:
        record: what was measured.
        quality: of that record.

    Returns:
        A time [unit of t], or a number of samples for a record without time; None for an undamaged record, for one that is softer after
        larger strokes (Mullins effect), for damage from the start, and where the clock is unusable, in which a window is given.
    """
    timed = quality.sampling.rate is not None
    if not quality.degrading or quality.softens_with_stroke or timed != (record.t is not None):
        return None
    ends = (cycles(record.u, quality.motion.threshold)[:, -1] + 1).tolist()
    sound = lambda end: _is_whole(summarize(record.segment(0, end)))
    low, high = _FEWEST, len(ends)
    if high <= low or not sound(ends[low - 1]):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if sound(ends[middle - 1]) else (low, middle)
    end = ends[low - 1]
    return float(end) if record.t is None else float(record.t[end - 1])


def _is_whole(quality: RecordQuality) -> bool:
    return not quality.degrading and (quality.stiffness_left is None or quality.stiffness_left >= WHOLE)
