"""Which column is the time: by its name, or because it rises as a clock does."""

from __future__ import annotations

import re

import numpy as np

from hystfit.data.preparation import CoarseClock
from hystfit.outcome import Code, Note
from hystfit.reading.limits import FEWEST
from hystfit.reading.names.column_names import column_quantity, column_role
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text import cells


def guess_time(table: Table, free: list[int], kinds: dict[int, str], given: int, notes: list[Note]) -> int | None:
    """Position of the column of the time among the free ones, with a note why; None where none is.

    Args:
        kinds: the quantity of every column; that of one which numbers the rows becomes "index".
        given: how many columns are chosen already.
    """
    # A duration that goes up and down is no clock, unless its name is that of a time.
    named = [k for k in free if k in table.stamps or (kinds[k] == "time" and is_clock(table, k))]
    named = named or [k for k in free if not kinds[k] and _is_since_1970(table, k)]
    named.sort(key=lambda k: k not in table.stamps)
    if not named and len(free) + given > 2:
        # The abscissa of a report of Abaqus is its X; of an oscilloscope, whose file states the interval, X numbers the samples.
        numbers = lambda k: table.interval is not None and table.counts(k)
        rises = lambda k: bool((np.diff(table.columns[k]) > 0).all()) and not numbers(k)
        named = [k for k in free[:2] if table.names[k] in ("s", "X") and rises(k)]
    if named:
        # The time of a step starts again where the next one begins.
        back = lambda k: int((np.diff(table.columns[k]) < 0).sum())
        clock = min(named, key=lambda k: (0 < back(k) < table.rows - 1, named.index(k)))
        notes.append(Note(Code.COLUMN_CHOICE, f"time: column {clock}, {table.names[clock]!r}"))
        return clock
    if len(free) + given < 3:
        return None
    matrices = {re.sub(r"\[\d+\]$", "", table.names[k]) for k in free}
    named = table.named and not (len(matrices) == 1 and {kinds[k] for k in free} <= {"", "index"})
    known = any(kind not in ("", "index") or column_role(table.names[k]) for k, kind in kinds.items())
    for k in free[:2]:
        steps = np.diff(table.columns[k])
        if named and table.names[k] != f"column {k}":
            even = bool((steps > 0).all()) and np.ptp(steps) <= 0.01 * steps[0]
            if known or not even:  # of names without a known word, one may be that of an evenly sampled time
                return None
        if not (steps > 0).all() and ((steps < 0).any() or CoarseClock.of(table.columns[k]) is None):
            return None
        uneven = not named and np.ptp(steps) > np.median(steps)
        if uneven and all(_runs_one_way(table.columns[other]) for other in free):
            return None  # of several curves over each other, none is that of time
        if not table.counts(k):
            reason = "always increases" if (steps > 0).all() else "never decreases"
            notes.append(Note(Code.COLUMN_CHOICE, f"time: column {k}, because it {reason}"))
            return k
        text = f"column {k} numbers the rows and is not used; if it is the time, choose --time {k} (time={k})"
        notes.append(Note(Code.LEFT_OUT, text))
        kinds[k] = "index"
    return None


def _runs_one_way(values: np.ndarray) -> bool:
    steps = np.diff(values[np.isfinite(values)])
    return steps.size > 0 and bool((steps > 0).all() or (steps < 0).all())


def _is_since_1970(table: Table, k: int) -> bool:
    """Whether a column without a unit always rises among the times of our age since 1970."""
    values = table.columns[k]
    if table.units[k] or not (np.diff(values) > 0).all():
        return False
    return cells.is_since_1970(values[0], values[-1])


def is_clock(table: Table, k: int) -> bool:
    """Whether a column of times never decreases, or always, or has the name of a time and starts again after rows of a table at least.

    Where a block of rows begins it starts again whatever its name.
    """
    ways = np.sign(np.diff(table.columns[k]))
    within = (np.diff(table.curve) == 0) & (np.diff(table.section) == 0)
    ways = np.where(within | ~within.any(), ways, 0.0)
    rises, falls = (ways > 0).sum(), (ways < 0).sum()
    named = column_quantity(split_unit(table.names[k])[0]) == "time"  # the time between rows goes up and down
    return bool((named and rises >= (FEWEST - 1) * (falls - 1)) or not (rises and falls))
