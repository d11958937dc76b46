"""What a record leaves open for any model fitted to it: notes for the verdict of a fit."""

from __future__ import annotations

from collections.abc import Sequence

from hystfit.outcome.note import Code, Note, warn
from hystfit.quality.summary import RecordQuality, distinct

_PART = 0.7  # of the largest stroke, below which another stroke shows minor loops


def scope_notes(records: Sequence[RecordQuality]) -> list[Note]:
    """Where a prediction from these records is an extrapolation: minor loops, where only one amplitude was measured.

    Args:
        records: measurements of all records fitted.
    """
    span = max(r.u.high for r in records) - min(r.u.low for r in records)
    if span <= 0 or sum(r.motion.reversals for r in records) == 0:
        return []
    strokes = distinct(stroke * r.u.range / span for r in records for stroke in r.motion.strokes)
    if not strokes or min(strokes) < _PART * max(strokes):
        return []
    text = (
        "the data hold loops of one amplitude only: minor loops and other amplitudes are not tested, and predictions of them are an "
        "extrapolation"
    )
    return [warn(Code.MINOR_LOOPS, text)]
