"""Branches of one loop in files of their own, which go on from each other, as one record."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystfit.data.record import Record
from hystfit.outcome import Code
from hystfit.reading.names.branch_words import FALLING, RISING, words_of
from hystfit.reading.table.signal_evidence import meet


def go_on(records: Sequence[Record]) -> bool:
    """Whether each record runs one way, from where the one before ends, and some run back."""
    first = records[0]
    if len(records) < 2 or any(
        (r.u_name, r.u_unit, r.y_unit) != (first.u_name, first.u_unit, first.y_unit) for r in records
    ):
        return False
    ways = {float(np.sign(r.u[-1] - r.u[0])) for r in records}
    monotonic = all((np.diff(r.u) * np.sign(r.u[-1] - r.u[0]) >= 0).all() for r in records)
    if ways != {-1.0, 1.0} or not monotonic:
        return False
    return meet([record.u for record in records]) and meet([record.y for record in records])


def turned(records: Sequence[Record]) -> Sequence[Record]:
    """Two branches without time that run the same way, as sorted ones do: one of them back, where their names tell which one."""
    if len(records) != 2 or any(record.t is not None for record in records):
        return records
    words = [words_of(record.name) for record in records]
    rising, falling = ([bool(one & of) for one in words] for of in (RISING, FALLING))
    ways = [record.u[-1] > record.u[0] for record in records]
    if ways[0] != ways[1] or rising == falling or not (sum(rising) == sum(falling) == 1):
        return records
    back = (falling if ways[0] else rising).index(True)
    return [record.take(slice(None, None, -1)) if k == back else record for k, record in enumerate(records)]


def joined(records: Sequence[Record], *, counted: bool) -> Record:
    """The records one after the other, each from the time at which the one before ends.

    Args:
        counted: the input is counted from the start of each.
    """
    first = records[0]
    u, y, t, weight = [], [], [], []
    passed = clock = 0.0
    for record in (one.in_units(first.u_unit, first.y_unit) for one in records):
        u.append(record.u - record.u[0] + passed if counted else record.u)
        y.append(record.y)
        weight.append(record.weight)
        passed = u[-1][-1]
        if record.t is not None:
            t.append(record.t - record.t[0] + clock)
            clock = t[-1][-1] + float(np.median(np.diff(record.t)))
    join = lambda parts: np.concatenate(parts) if len(parts) == len(records) else None
    names = [record.name for record in records]
    shown = f"{', '.join(names[:-1])} and {names[-1]}"
    text = f"{shown} are parts of one loop: read as one record, each from where the one before ends"
    return first.replace(
        u=join(u),
        y=join(y),
        t=join(t),
        weight=join(weight),
        name="+".join(names),
        sha256="+".join(str(one.sha256) for one in records),
        source="+".join(one.source for one in records),
    ).noted(Code.CURVES, text)
