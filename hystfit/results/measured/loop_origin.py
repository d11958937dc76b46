"""The input and the output at which the height and the width of a loop are read."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
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
        relative = kind is LoopKind.FERROELECTRIC and middle_of_relative(data[0]) is not None
        return cls(0.0, None if relative else 0.0)


MIDDLE = Origin()


def inside(at: float | None, low: Any, high: Any, reach: float = ENDS) -> Any:
    """Where ranges are read: at a place inside them, and in their middle where it is None, beyond a range or at its ends."""
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return middle if at is None else np.where(np.abs(at - middle) < reach * half, at, middle)


def is_unipolar(u: np.ndarray) -> bool:
    """Whether an input stays on one side of zero, but for a small part of its range."""
    return bool(min(-u.min(), u.max()) < GAP * np.ptp(u))


def middle_of_relative(record: Record) -> float | None:
    """Middle of the range of a charge that is counted from the start of the record [y]; None of others, and of inputs of one sign."""
    u, y = record.u[record.used], record.y[record.used]
    if is_unipolar(u):
        return None
    middle, size = 0.5 * float(y.max() + y.min()), float(np.ptp(y))
    if abs(y[0]) > _START * size or abs(u[0]) > GAP * np.ptp(u) or abs(middle) < _OFF_CENTER * size:
        return None
    return middle
