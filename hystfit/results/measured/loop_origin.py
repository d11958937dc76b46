"""The input and the output at which the height and the width of a loop are read."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.outcome import Code, Note
from hystfit.reading.names.column_names import column_quantity
from hystfit.results.measured.loop_branches import ENDS, GAP
from hystfit.results.measured.loop_kinds import REMANENT, LoopKind

# Output of the first sample, and half sum of the outermost ones beside it, over the range of the output: a charge that is counted from the
# start of a record has zero and 0.2 to 0.5, as the loop of a poled capacitor begins at one of its remanences.
_START, _OFF_CENTER = 0.02, 0.1
# Largest over smallest resistance, from which it is read on a logarithmic scale: that at the transition of a metal to an insulator changes
# by 1e2 to 1e5, that of a shape memory alloy by a tenth. The water or the gas in pores is read on a linear scale over any range.
_LOGARITHMIC = 100.0


class Origin(NamedTuple):
    """Input and output at which the height and the width of a loop are read; None for the middle of the range.

    Coercivity and remanence are defined at zero output and zero field. Other loops have no zero of their own: that of a displacement or
    a voltage is set by the instrument. The middle of a resistance over decades is that of its logarithm.
    """

    u: float | None = None
    y: float | None = None
    reach: float = ENDS  # of half the range of the output, within which the level `y` counts

    @classmethod
    def of(cls, data: Dataset) -> Origin:
        """That of records, by their kind and the first of them."""
        kind = LoopKind.of(data)
        if kind not in REMANENT:
            outputs = np.concatenate([record.y[record.used] for record in data])
            low, high = float(outputs.min()), float(outputs.max())
            resists = column_quantity(data[0].y_name, data[0].y_unit) == "resistance"
            return cls(None, (low * high) ** 0.5, 1.0) if resists and 0 < _LOGARITHMIC * low <= high else cls()
        return cls(0.0, 0.0 if middle_of_relative(data[0], kind) is None else None)


MIDDLE = Origin()


def inside(at: float | None, low: Any, high: Any, reach: float = ENDS) -> Any:
    """Where ranges are read: at a place inside them, and in their middle where it is None, beyond a range or at its ends."""
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return middle if at is None else np.where(np.abs(at - middle) < reach * half, at, middle)


def is_unipolar(u: np.ndarray) -> bool:
    """Whether an input stays on one side of zero, but for a small part of its range."""
    return bool(min(-u.min(), u.max()) < GAP * np.ptp(u))


def middle_of_relative(record: Record, kind: LoopKind) -> float | None:
    """Middle of the range of an output without a zero of its own [y]; None of others, and of inputs of one sign.

    It is that of a charge that is counted from the start of the record, or of an output of which the loop does not reach zero, as light
    that a magnetization turns is measured over the light itself.
    """
    u, y = record.u[record.used], record.y[record.used]
    if kind not in REMANENT or is_unipolar(u):
        return None
    middle, size = 0.5 * float(y.max() + y.min()), float(np.ptp(y))
    if abs(middle) >= 0.5 * ENDS * size:
        return middle
    from_start = abs(y[0]) <= _START * size and abs(u[0]) <= GAP * np.ptp(u) and abs(middle) >= _OFF_CENTER * size
    return middle if kind is LoopKind.FERROELECTRIC and from_start else None


def centered(record: Record, kind: LoopKind) -> tuple[Record, tuple[Note, ...]]:
    """The loop about the middle of an output that has no zero of its own, and a note that says so."""
    if (middle := middle_of_relative(record, kind)) is None:
        return record, ()
    crosses = record.y[record.used].min() < 0 < record.y[record.used].max()
    what = "is relative to the start of the record" if crosses else "has an offset"
    at = f"{middle:.5g} {record.y_unit}".rstrip()
    text = f"the output {what}: coercivity and remanence are those about the middle of its range ({at})"
    return record.replace(y=record.y - middle), (Note(Code.PREPARED, text),)
