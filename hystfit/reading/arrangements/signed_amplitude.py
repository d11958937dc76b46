"""Amplitude and phase of a microscope of piezoresponse: the amplitude with the sign that its phase tells is one more column.

A domain that switches turns the phase by half a turn. The amplitude alone is a butterfly, and the phase alone a step.
"""

from __future__ import annotations

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.limits import ODD
from hystfit.reading.names.column_names import parts_of
from hystfit.reading.table.raw_table import Table

NAME = "Piezoresponse"
_AMPLITUDE = frozenset("amp ampl amplitude mag magnitude".split())
# Length of the mean of the doubled phase as a vector from which on the phase has two values, half a turn apart: those of noise of 19
# degrees about each have 0.8, and a phase that drifts over a turn has 0.
_TWO_VALUES = 0.8


def with_signed_amplitude(table: Table) -> Table | None:
    """The table with the amplitude where the phase is the one of two values, and its opposite where it is the other; None for other tables.

    It is positive where it is so at the larger voltages.
    """
    kinds = [*map(table.quantity, table.positions)]
    if not table.named or "piezoresponse" in kinds:
        return None
    usable = [k for k in table.positions if k not in table.labels and np.isfinite(table.columns[k]).all()]
    sizes = [k for k in usable if parts_of(table.names[k]) & _AMPLITUDE and (table.columns[k] >= 0).all()]
    phases = [k for k in usable if kinds[k] == "phase"]
    bias = next((k for k in usable if kinds[k] == "voltage" and k not in sizes and not table.constant(k)), None)
    if bias is None or len(sizes) != 1 or len(phases) != 1:
        return None
    size, phase = table.columns[sizes[0]], table.columns[phases[0]]
    in_radians = "rad" in table.units[phases[0]] or (not table.units[phases[0]] and np.ptp(phase) < 2 * np.pi)
    turn = 1.0 if in_radians else np.pi / 180
    doubled = np.sum(size * np.exp(2j * turn * phase)) / max(float(np.sum(size)), np.finfo(float).tiny)
    signs = np.where(np.cos(turn * phase - 0.5 * np.angle(doubled)) >= 0, 1.0, -1.0)
    if abs(doubled) < _TWO_VALUES or min(np.mean(signs > 0), np.mean(signs < 0)) < ODD:
        return None
    volts = table.columns[bias]
    signed = size * signs * (1.0 if np.sum(size * signs * (volts - volts.mean())) >= 0 else -1.0)
    text = f"the phase {table.names[phases[0]]!r} turns by half a turn: it tells the sign of {table.names[sizes[0]]!r}, read as {NAME!r}"
    return table.beside(NAME, signed, table.units[sizes[0]]).noted(Note(Code.PREPARED, text))
