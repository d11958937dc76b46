"""Quantities of ferroelectric loops beside those of all: imprint, polarizations at the ends and tips, recoverable energy, leakage."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hystfit.data.record import Record
from hystfit.params.units import is_energy, loop_energy, size_in
from hystfit.quality.faults import CLEAR
from hystfit.quality.loops import SAME_LEVEL
from hystfit.results.measured.loop_branches import GAP, Branch, center_at
from hystfit.results.measured.loop_origin import is_unipolar
from hystfit.results.measured.measured_value import LoopValue

_TIP = 0.05  # of the range of the input, over which the currents before and after a tip are taken
_FEWEST = 3  # samples on each side of a tip


def offset_of(rows: list[LoopValue], label: str) -> Iterator[LoopValue]:
    """Half the sum of the coercivities of both branches: imprint, exchange bias, or an offset of the instrument."""
    at = {row.name: row for row in rows}
    sides = at.get("coercive_input_rising"), at.get("coercive_input_falling")
    if sides[0] is not None and sides[1] is not None:
        errors = [side.stderr for side in sides if side is not None]
        error = None if None in errors else 0.5 * float(np.hypot(*errors))  # type: ignore[arg-type]
        yield LoopValue("offset_input", label, 0.5 * (sides[0].value + sides[1].value), error, sides[0].unit)


def polarization_values(
    record: Record, rows: list[LoopValue], noise: float, branches: Sequence[Branch]
) -> Iterator[LoopValue]:
    """The rows besides those of every loop, of a charge or polarization over a voltage or an electric field."""
    yield from (offset := [*offset_of(rows, "offset (half sum of Vc+ and Vc-)")])
    yield from _about_middle(record, offset, noise, branches)
    u, y = record.u[record.used], record.y[record.used]
    tips = {"rising": float(y[u.argmax()]), "falling": float(y[u.argmin()])}
    for side, which in (("rising", "largest"), ("falling", "lowest")):
        label = f"polarization at the {which} voltage"
        yield LoopValue(f"polarization_tip_{side}", label, tips[side], noise, record.y_unit)
    if abs(u[-1] - u[0]) <= GAP * np.ptp(u) and abs(u[-1]) <= GAP * np.ptp(u):
        first, last = float(y[0]), float(y[-1])
        switched = max((tip - first for tip in tips.values()), key=abs)
        yield LoopValue("remanence_start", "polarization at the start of the loop", first, noise, record.y_unit)
        label = "switched polarization, from the start to the farther tip"
        yield LoopValue("switched_polarization", label, switched, noise * float(np.sqrt(2)), record.y_unit)
        yield LoopValue("remanence_end", "polarization at the end of the loop", last, noise, record.y_unit)
    yield from _recovered(record, rows, noise)
    yield from _leakage(record)


def _about_middle(
    record: Record, offset: list[LoopValue], noise: float, branches: Sequence[Branch]
) -> Iterator[LoopValue]:
    """The offset of a loop about the middle of its polarization, as another zero of the charge amplifier hides an imprint."""
    y = np.concatenate([b.y for b in branches])
    middle = 0.5 * float(y.max() + y.min())
    value, error = center_at(middle, branches, noise)
    if offset and abs(value - offset[0].value) > CLEAR * np.hypot(error, offset[0].stderr or 0.0):
        label = f"offset about the middle of the polarization ({middle:.4g} {record.y_unit}".rstrip() + ")"
        yield LoopValue("offset_about_middle", label, value, error, record.u_unit)


def _recovered(record: Record, rows: list[LoopValue], noise: float) -> Iterator[LoopValue]:
    """Energy that a capacitor returns on the way from the largest input to zero, and of a unipolar cycle its part of the energy put in."""
    u, y = record.u[record.used], record.y[record.used]
    tip, (unit, factor) = int(u.argmax()), loop_energy(record.u_unit, record.y_unit)
    last = tip + int(np.argmax(u[tip:] <= max(0.0, u[tip:].min())))
    if u[last] > SAME_LEVEL * u[tip] or not is_energy(unit) or last - tip < _FEWEST:
        return
    part = slice(tip, last + 1)
    size = -factor * float(np.trapezoid(u[part], y[part]))
    # The tip lies anywhere between the samples beside the largest one.
    beside = 0.5 * float(np.ptp(y[max(tip - 1, 0) : tip + 2])) / np.sqrt(12)
    error = factor * float(np.hypot(noise * np.sqrt(np.sum(np.diff(u[part]) ** 2)), u[tip] * beside))
    if size <= 0:  # what still switches behind the tip exceeds it
        return
    yield LoopValue("recoverable_energy", "recoverable energy, from the largest voltage to zero", size, error, unit)
    lost = next((row.value for row in rows if row.name == "loop_area"), None)
    if lost is not None and is_unipolar(u):
        label = "efficiency (recoverable energy over that put in)"
        yield LoopValue("efficiency_percent", label, 100 * size / (size + lost), None, "%")


def _leakage(record: Record) -> Iterator[LoopValue]:
    """Current that does not change its sign with the direction of the input: mean of those before and after a tip.

    Capacitance and ferroelectric polarization reverse their current with dV/dt where nothing switches, and conduction does not. Domains
    that still switch behind the tip add to it, so that it is an upper bound.
    """
    if record.t is None:
        return
    u, y, t = record.u[record.used], record.y[record.used], record.t[record.used]
    found, errors = [], []
    for sign in (1.0, -1.0):
        tip = int(np.argmax(sign * u))
        near = sign * (u[tip] - u) <= _TIP * np.ptp(u)
        before, after = tip, tip
        while before > 0 and near[before - 1]:
            before -= 1
        while after < u.size - 1 and near[after + 1]:
            after += 1
        if min(tip - before, after - tip) < _FEWEST or t[before] == t[tip] or t[tip] == t[after]:
            return
        lines = [np.polyfit(t[a : b + 1], y[a : b + 1], 1, cov=True) for a, b in ((before, tip), (tip, after))]
        found.append(sign * 0.5 * sum(theta[0] for theta, _ in lines))
        errors.append(0.5 * float(np.sqrt(sum(covariance[0, 0] for _, covariance in lines))))
    per_time = f"{record.y_unit}/{record.t_unit}" if record.y_unit and record.t_unit else ""
    unit, factor = size_in(per_time, "A/m2", "A") or (per_time, 1.0)
    value, error = factor * float(np.mean(found)), factor * 0.5 * float(np.hypot(*errors))
    spread = factor * 0.5 * abs(found[0] - found[1])
    yield LoopValue("leakage", "leakage at the tips (upper bound)", value, error, unit, 2, spread=spread)
