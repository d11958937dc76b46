"""Stiffness and damping of a loop of a force against a displacement."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hystfit.data.record import Record
from hystfit.params.units import conversion, stiffness_unit
from hystfit.quality.loops import SAME_LEVEL
from hystfit.results.measured.loop_branches import Branch, Pair, combined, loss
from hystfit.results.measured.measured_value import LoopValue
from hystfit.results.measured.steady_loops import CRITICAL


def stiffness_values(
    branches: list[Branch], cycles: Sequence[Pair], sigma: float, record: Record
) -> Iterator[LoopValue]:
    """Secant stiffness between the ends of the loop, and the damping ratio, or above the critical damping the coefficient, of a damper."""
    width = max(b.u.max() for b in branches) - min(b.u.min() for b in branches)
    each = sigma * float(np.sqrt(2)) / width
    longest = max(float(np.ptp(b.u)) for b in branches)  # that of a shorter branch is larger
    of = [b for b in branches if np.ptp(b.u) >= (1 - SAME_LEVEL) * longest]
    stiffness, error, count = combined([(abs(b.y[-1] - b.y[0]) / float(np.ptp(b.u)), each) for b in of])
    unit, factor = stiffness_unit(record.y_unit, record.u_unit)
    yield LoopValue("secant_stiffness", "secant stiffness", factor * stiffness, factor * error, unit, count)
    if not cycles:
        return
    size, uncertain, count = loss(cycles, sigma)
    ratio = 100 * 2 * size / (np.pi * stiffness * width**2) if stiffness > 0 else np.inf
    if ratio <= CRITICAL:
        damping = ratio * float(np.hypot(uncertain / size, error / stiffness)) if size > 0 else None
        yield LoopValue("equivalent_damping_percent", "equivalent damping", ratio, damping, "%", count)
    elif record.sampling_interval and (second := conversion(record.t_unit, "s")):
        samples = float(np.median([one.u.size + other.u.size - 2 for one, other in cycles]))
        duration = second * record.sampling_interval * samples
        per_loss = 2 * duration / (np.pi * width) ** 2  # 1 / (pi omega amplitude^2)
        label = f"equivalent viscous damping coefficient, at {1 / duration:.3g} Hz"
        of_time = f"{record.y_unit} s/{record.u_unit}" if record.y_unit and record.u_unit else ""
        yield LoopValue("damping_coefficient", label, per_loss * size, per_loss * uncertain, of_time, count)
