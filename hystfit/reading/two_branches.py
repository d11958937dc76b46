"""Tables of a loop in which each row has one input and two outputs: on the rising and on the falling branch."""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.column_names import column_quantity
from hystfit.reading.raw_table import Table

_RISING = "up rising rise ascending asc increasing inc loading load forward fwd heating upward upscale charging"
_FALLING = "down falling fall descending desc decreasing dec unloading unload backward bwd cooling downward downscale discharging reverse"
_ROWS = 4


def unfolded(table: Table) -> tuple[Table, int, int] | None:
    """The loop of such a table (the rising branch, then the falling one in the opposite order), its input and output; None for others."""
    branches = _branches(table)
    if branches is None or table.rows < _ROWS:
        return None
    drive, rising, falling = branches
    order = np.argsort(table.columns[drive], kind="stable")
    both = table.take(np.concatenate([order, order[::-1]]))
    columns = [*both.columns]
    columns[rising] = np.concatenate([table.columns[rising][order], table.columns[falling][order[::-1]]])
    columns[falling] = np.full(both.rows, np.nan)
    names = ", ".join(repr(table.names[k]) for k in (rising, falling))
    text = f"the rising and the falling branch are in two columns, {names}: they are joined to one loop over {table.names[drive]!r}"
    return (
        dataclasses.replace(both, columns=tuple(columns), notes=(*table.notes, Note(Code.CURVES, text))),
        drive,
        rising,
    )


def _branches(table: Table) -> tuple[int, int, int] | None:
    """Positions of the input, the rising and the falling output, in a table with no other column of numbers but the number of the row."""
    if not table.named or table.stamps:
        return None
    of = lambda words: [k for k, name in enumerate(table.names) if set(words.split()) & _words(name)]
    rising, falling = of(_RISING), of(_FALLING)
    if len(rising) != 1 or len(falling) != 1 or rising == falling:
        return None
    rest = lambda name: _words(name) - set(f"{_RISING} {_FALLING}".split())
    others = [
        k
        for k in range(len(table.names))
        if k not in (*rising, *falling, *table.labels)
        and not table.constant(k)
        and column_quantity(table.names[k], table.units[k]) not in ("index", "time")
    ]
    if rest(table.names[rising[0]]) != rest(table.names[falling[0]]) or len(others) != 1:
        return None
    steps = np.diff(table.columns[others[0]])
    runs_once = bool((steps > 0).all() or (steps < 0).all())
    return (others[0], rising[0], falling[0]) if runs_once else None


def _words(name: str) -> set[str]:
    return set(re.findall(r"[a-z]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower()))
