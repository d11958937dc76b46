"""Curves of magnetometers that turn back as loops do, and are none: remanences after fields, and sweeps of the temperature."""

from __future__ import annotations

import re

import numpy as np

from hystfit.data.circulation import PART
from hystfit.data.record import Record
from hystfit.params.units import quantity
from hystfit.quality.loops import APART, LARGEST, branches
from hystfit.quality.summary import summarize

# Names of remanences and of the protocols that measure them; MagIC has the field of a treatment before the measurement.
_REMANENCE = re.compile(r"remanen|(?<![a-z])(?:s?irm|dcd|bcr)(?![a-z])", re.IGNORECASE)
_TREATED = re.compile(r"treat", re.IGNORECASE)
_MOMENTS = ("moment", "magnetization")


def is_remanence(record: Record) -> bool:
    """Whether the output is the moment at zero field after each of the fields, by the names of the columns and of the record."""
    if quantity(record.u_unit) not in ("field", "induction") or quantity(record.y_unit) not in _MOMENTS:
        return False
    return _TREATED.match(record.u_name) is not None or any(
        _REMANENCE.search(one) for one in (record.y_name, record.name)
    )


def is_remanence_curve(record: Record) -> bool:
    """Whether a record is a curve of remanences and no loop of them."""
    ends = record.u[branches(record.u, APART * float(np.ptp(record.u)))]
    large = np.abs(np.diff(ends)) >= LARGEST * np.ptp(record.u)
    return is_remanence(record) and int(large.sum()) < 2


def no_loop_reason(record: Record) -> str | None:
    """Why a record that may turn back holds no loop of its output over its input; None where it may hold one."""
    if is_remanence_curve(record):
        return (
            "the output is a remanence, read at zero field after each field: curves of acquisition (IRM) and back field (DCD) are no loop. "
            "The zero of the back-field curve is the coercivity of remanence (hystfit quantities); a model needs the moment in the field"
        )
    if quantity(record.u_unit) == "temperature" and quantity(record.y_unit) in _MOMENTS:
        measured = summarize(record)
        shape = measured.shape
        apart = shape is not None and abs(shape.closure_percent or 0.0) > PART * shape.width_percent
        if measured.motion.monotonic or apart:
            return (
                "the magnetization was measured in sweeps of the temperature that do not return to where they began, as zero-field-cooled "
                "and field-cooled curves do: they differ in the state before the sweep, and there is no loop. For a loop of the field, "
                "measure it at constant temperature"
            )
    return None
