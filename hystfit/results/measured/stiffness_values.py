"""Stiffness and damping of a loop of a force against a displacement."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hystfit.data.record import Record
from hystfit.params.units import conversion, stiffness_unit
from hystfit.quality.loops import SAME_LEVEL
from hystfit.results.measured.loop_branches import Branch, Found, Pair, between_passages, combined, loss
from hystfit.results.measured.measured_value import LoopValue
from hystfit.results.measured.steady_branches import at_pace, usual_duration
from hystfit.results.measured.steady_loops import CRITICAL


def stiffness_values(
    branches: list[Branch], cycles: Sequence[Pair], sigma: float, record: Record
) -> Iterator[LoopValue]:
    """Secant stiffness between the ends of the loop, and the damping ratio, or above the critical damping the coefficient, of a damper."""
    width = max(b.u.max() for b in branches) - min(b.u.min() for b in branches)
    longest = max(float(np.ptp(b.u)) for b in branches)  # that of a shorter branch is larger
    of = [b for b in branches if np.ptp(b.u) >= (1 - SAME_LEVEL) * longest]
    stiffness, error, count = combined([_secant(b, sigma) for b in of])
    unit, factor = stiffness_unit(record.y_unit, record.u_unit)
    yield LoopValue("secant_stiffness", "secant stiffness", factor * stiffness, factor * error, unit, count)
    if not cycles:
        return
    size, uncertain, count = loss(cycles, sigma)
    ratio = 100 * 2 * size / (np.pi * stiffness * width**2) if stiffness > 0 else np.inf
    if ratio <= CRITICAL:
        damping = ratio * float(np.hypot(uncertain / size, error / stiffness)) if size > 0 else None
        yield LoopValue("equivalent_damping_percent", "equivalent damping", ratio, damping, "%", count)
    elif (found := _duration(record, cycles)) is not None and (second := conversion(record.t_unit, "s")):
        duration, of_duration = second * found[0], second * found[1]
        per_loss = 2 * duration / (np.pi * width) ** 2  # 1 / (pi omega amplitude^2)
        label = f"equivalent viscous damping coefficient, at {1 / duration:.3g} Hz"
        of_time = f"{record.y_unit} s/{record.u_unit}" if record.y_unit and record.u_unit else ""
        error = per_loss * float(np.hypot(uncertain, size * of_duration / duration))
        yield LoopValue("damping_coefficient", label, per_loss * size, error, of_time, count)


def _secant(b: Branch, sigma: float) -> Found:
    """Stiffness between the ends of a branch, and its error: each end lies anywhere within a step between samples."""
    steps = b.y[1] - b.y[0], b.y[-1] - b.y[-2]
    error = np.hypot(np.sqrt(2) * sigma, np.hypot(*steps) / np.sqrt(12))
    return abs(b.y[-1] - b.y[0]) / float(np.ptp(b.u)), float(error) / float(np.ptp(b.u))


def _duration(record: Record, cycles: Sequence[Pair]) -> Found | None:
    """Duration of a cycle and its error; None without time.

    From one passage of the middle to the next, which noise and a hold at an end move least; else between the turning points.
    """
    if record.t is None:
        return None
    u, y, t = record.u[record.used], record.y[record.used], record.t[record.used]
    passages = between_passages(u, y, t)
    lasts = np.array([one.duration + other.duration for one, other in passages or cycles])
    lasts = lasts[at_pace(lasts, usual_duration(lasts.tolist()))]
    between = 0.0 if passages else float(np.median(np.diff(t))) / np.sqrt(6)  # of samples, at both ends
    scatter = float(np.std(lasts, ddof=1)) if lasts.size > 1 else 0.0
    return float(np.mean(lasts)), max(between, scatter) / np.sqrt(lasts.size)
