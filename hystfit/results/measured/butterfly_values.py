"""Quantities of a loop whose branches cross, such as that of a strain over an electric or magnetic field."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hystfit.data.record import Record
from hystfit.results.measured.loop_branches import Branch, combined, range_error
from hystfit.results.measured.measured_value import LoopValue

_EVEN = 0.5  # of the range of the output, by which both ends of a branch lie beyond its turn: those of an even output lie at its other end


def butterfly_values(branches: list[Branch], sigma: float, record: Record) -> Iterator[LoopValue]:
    """Range of the output of branches that cross, and the inputs at which an even output turns: the coercive fields of a strain."""
    y = np.concatenate([b.y for b in branches])
    size = float(np.ptp(y))
    yield LoopValue("stroke", "range of the output", size, range_error(y, sigma), record.y_unit)
    for rises, side in ((True, "rising"), (False, "falling")):
        for sign, word in ((1.0, "smallest"), (-1.0, "largest")):
            found = []
            for b in (b for b in branches if b.rises == rises):
                k = int(np.argmin(sign * b.y))
                if (sign * (b.y[[0, -1]] - b.y[k])).min() >= _EVEN * size:
                    found.append((float(b.u[k]), abs(float(b.u[k + 1] - b.u[k - 1])) / np.sqrt(12)))
            if found:
                value, error, count = combined(found)
                label = f"input at the {word} output, {side} branch"
                yield LoopValue(f"turning_input_{side}", label, value, error, record.u_unit, count)
