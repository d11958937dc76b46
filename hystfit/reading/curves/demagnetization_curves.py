"""Demagnetization curves of magnets whose field is written without its sign, as in catalogs."""

from __future__ import annotations

import numpy as np

from hystfit.reading.choice.chosen_columns import Choice
from hystfit.reading.limits import FEWEST, MAJORITY, NEAR
from hystfit.reading.names.column_names import column_quantity
from hystfit.reading.table.raw_table import Table

_MAGNETIC = ("induction", "magnetization", "moment")
# Least part of the range of the output that is its remanence: the induction of a magnet of 1.2 T in its opposed field of 3 T has 0.3.
_REMANENT = 0.2


def lacks_sign(table: Table, choice: Choice, u: np.ndarray, y: np.ndarray) -> bool:
    """Whether a curve falls from a remanence as its field grows from zero, which no material does: the field is opposed to it.

    A diamagnet and a superconductor begin without a remanence.

    Args:
        table, choice: of the columns.
        u, y: input and output of the curve.
    """
    kinds = [column_quantity(table.names[k], table.units[k]) for k in (choice.input, choice.output)]
    known = np.isfinite(u) & np.isfinite(y)
    if kinds[0] != "field" or kinds[1] not in _MAGNETIC or known.sum() < FEWEST:
        return False
    u, y = u[known], y[known]
    steps, span = np.diff(u), float(np.ptp(u))
    one_way = bool((steps >= 0).all() or (steps <= 0).all())
    if not one_way or span <= 0 or not 0 <= u.min() <= NEAR * span:
        return False
    remanence, last = (float(y[place]) for place in (np.argmin(u), np.argmax(u)))
    if remanence < _REMANENT * np.ptp(y):
        return False
    return last < MAJORITY * remanence and remanence >= (1 - NEAR) * float(np.abs(y[y > 0]).max(initial=0.0))
