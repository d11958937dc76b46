"""What fitted records cover: where a model fitted to them extrapolates, and whether they determine minor loops."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from hystfit.data.circulation import SLACK
from hystfit.data.record import Record
from hystfit.outcome.note import Code, Note, warn
from hystfit.quality.loops import APART, distinct, strokes


@dataclasses.dataclass(frozen=True)
class Coverage:
    """Extent of the input of some records, and the strokes between its reversals.

    Attributes:
        low, high: extent of the input [unit of u].
        strokes: different strokes, largest first [unit of u].
        switched: whether the input takes no other values than `low` and `high`.
    """

    low: float
    high: float
    strokes: tuple[float, ...]
    switched: bool = False

    @classmethod
    def of(cls, records: Iterable[Record]) -> Coverage:
        """Coverage of records up to their last sample that counts, at least one record; strokes below 5 % of the range are omitted."""
        inputs = [record.u[: record.last + 1] for record in records]
        low, high = min(float(u.min()) for u in inputs), max(float(u.max()) for u in inputs)
        least = APART * (high - low)
        found = np.concatenate([strokes(u, least) for u in inputs])
        return cls(low, high, distinct(found[found > least], least), is_switched(inputs))


def is_switched(inputs: Sequence[np.ndarray]) -> bool:
    """Whether inputs, each of shape (T,), take no other values than the lowest and the highest of all: there is no loop between them."""
    low, high = min(float(u.min()) for u in inputs), max(float(u.max()) for u in inputs)
    return all(((u == low) | (u == high)).all() for u in inputs)


def coverage_notes(fitted: Iterable[Record], others: Iterable[Record] = ()) -> tuple[Note, ...]:
    """What a model fitted to records cannot be relied on for.

    Args:
        others: records that it is to predict; none where they are unknown.

    Returns:
        `Code.MINOR_LOOPS` where the fitted records have one amplitude only (and the others, where given, have smaller ones),
        `Code.EXTRAPOLATION` where the input of the others leaves the fitted range.
    """
    fitted, others = ([record for record in records if record.used.any()] for records in (fitted, others))
    if not fitted:
        return ()
    known, unit = Coverage.of(fitted), fitted[0].u_unit
    size = lambda value: f"{value:.4g} {unit}".rstrip()
    asked = Coverage.of(others) if others else None
    notes = []
    if len(known.strokes) == 1 and (asked is None or min(asked.strokes, default=0.0) < (1 - APART) * known.strokes[0]):
        if known.switched:
            text = (
                "the input is switched between two values: these data show the time response of the output, but no loop between the "
                "values; measure ramps of the input. If the input is controlled by the output, as the heater of a thermostat is, "
                "exchange the columns (input=, output=)"
            )
            return (warn(Code.MINOR_LOOPS, text),)
        smaller = "" if asked is None or not asked.strokes else f" down to {size(asked.strokes[-1])}"
        notes.append(
            warn(
                Code.MINOR_LOOPS,
                f"only one amplitude ({size(known.strokes[0])} peak to peak): these data do not determine loops of smaller "
                f"amplitude{smaller}; measure nested loops or a decaying input",
            )
        )
    if asked is not None:
        beyond = max(known.low - asked.low, asked.high - known.high)
        if beyond > SLACK * (known.high - known.low):
            notes.append(
                warn(
                    Code.EXTRAPOLATION,
                    f"the input leaves the fitted range ({known.low:.4g} to {size(known.high)}) by {size(beyond)}: the prediction there is "
                    "extrapolation",
                )
            )
    return tuple(notes)
