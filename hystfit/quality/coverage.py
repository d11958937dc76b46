"""Whether the amplitudes of fitted records determine minor loops."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from hystfit.data.record import Record
from hystfit.outcome.note import Code, Note, warn
from hystfit.quality.loops import APART, distinct, strokes


def covered_strokes(records: Iterable[Record]) -> tuple[float, ...]:
    """Different strokes between the reversals of records up to their last sample that counts, largest first [unit of u].

    Those below 5 % of the range of all are left out.
    """
    inputs = [record.u[: record.last + 1] for record in records]
    least = APART * float(np.ptp(np.concatenate(inputs)))
    found = np.concatenate([strokes(u, least) for u in inputs])
    return distinct(found[found > least], least)


def is_switched(inputs: Sequence[np.ndarray]) -> bool:
    """Whether inputs, each of shape (T,), take no other values than the lowest and the highest of all: there is no loop between them."""
    low, high = min(float(u.min()) for u in inputs), max(float(u.max()) for u in inputs)
    return all(((u == low) | (u == high)).all() for u in inputs)


def coverage_notes(fitted: Iterable[Record]) -> tuple[Note, ...]:
    """`Code.MINOR_LOOPS` where fitted records have one amplitude only, so that a model cannot be relied on for smaller loops."""
    fitted = [record for record in fitted if record.used.any()]
    known = covered_strokes(fitted) if fitted else ()
    if len(known) != 1:
        return ()
    size = f"{known[0]:.4g} {fitted[0].u_unit}".rstrip()
    text = (
        f"only one amplitude ({size} peak to peak): these data do not determine loops of smaller amplitude; measure nested loops or a "
        "decaying input"
    )
    if is_switched([record.u[: record.last + 1] for record in fitted]):
        text = (
            "the input is switched between two values: these data show the time response of the output, but no loop between the "
            "values; measure ramps of the input. If the input is controlled by the output, as the heater of a thermostat is, "
            "exchange the columns (input=, output=)"
        )
    return (warn(Code.MINOR_LOOPS, text),)
