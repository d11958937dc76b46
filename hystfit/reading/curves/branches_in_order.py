"""Loops whose rows stand in the order of the input, as points of a digitized plot do: the two branches are told apart by their outputs."""

from __future__ import annotations

import numpy as np

from hystfit.outcome import Code
from hystfit.outcome.note import Note, warn
from hystfit.reading.choice.chosen_columns import Choice
from hystfit.reading.choice.quantity_points import LOADS
from hystfit.reading.table.raw_table import Table

_FEWEST, _MOST = 40, 4000  # rows of a loop
# Total variation of the output over that of two branches, from which there are two: 3000 noisy curves of 40 to 400 rows have up to 2.5.
_APART = 4.0
_FEWEST_APART = 8  # rows of the branch that was left where the other one goes on
_CLOSED = 0.3  # of the largest distance of the branches, up to which they meet at both ends


def in_order_of_time(table: Table, choice: Choice, notes: list[Note]) -> Table:
    """The rows of a loop that are in the order of its input, in the order of time: up one branch and down the other."""
    u, y = table.columns[choice.input], table.columns[choice.output]
    steps = np.diff(u)
    in_order = choice.time is None and table.part is None and not table.curve.any()
    if not in_order or not _FEWEST <= u.size <= _MOST or not ((steps >= 0).all() or (steps <= 0).all()):
        return table
    if not (np.isfinite(y).all() and np.ptp(u) > 0 and np.ptp(y) > 0):
        return table
    order = np.argsort(u, kind="stable")
    branches = _two_branches(u[order], y[order] / np.ptp(y))
    if branches is None:
        return table
    low, high = (order[rows] for rows in branches)
    load = table.quantity(choice.output) in LOADS
    up, down = (high, low) if load or np.corrcoef(u, y)[0, 1] < 0 else (low, high)
    text = "the rows are in the order of the input: two branches were told apart by their outputs"
    notes.append(
        warn(Code.CURVES, f"{text}, and the input is taken to rise on the {'upper' if up is high else 'lower'} one")
    )
    return table.take(np.concatenate([up, down[::-1]]))


def _two_branches(u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Rows of the lower and of the upper branch; None for one curve.

    Args:
        u, y: in the order of the input; the output in parts of its range.
    """
    second = _shortest_pair(y)
    short, long = sorted((np.flatnonzero(~second), np.flatnonzero(second)), key=len)
    if len(short) < _FEWEST_APART or _variation(y) < _APART * (_variation(y[short]) + _variation(y[long])):
        return None
    beside = (u[long] >= u[short[0]]) & (u[long] <= u[short[-1]])
    gap = np.interp(u[short], u[long], y[long]) - y[short]
    if max(abs(float(gap[0])), abs(float(gap[-1]))) > _CLOSED * float(np.abs(gap).max()):
        return None
    of_both = long[~beside]  # where the branches are one, as beyond the closing of a loop
    one, other = np.sort([*short, *of_both[::2]]), np.sort([*long[beside], *of_both[1::2]])
    return (one, other) if gap.mean() > 0 else (other, one)


def _variation(y: np.ndarray) -> float:
    return float(np.abs(np.diff(y)).sum())


def _shortest_pair(y: np.ndarray) -> np.ndarray:
    """Which of two curves each value belongs to, so that the sum of their steps is least (dynamic programming).

    Both begin at the first value and end at the last one, where a loop is closed.
    """
    cost = np.zeros(1)  # by the last value of the curve without value k: 0 is the first one, and j + 1 value j
    back = np.zeros(y.size, dtype=int)
    for k in range(1, y.size):
        switched = cost + np.abs(y[k] - np.append(y[0], y[: k - 1]))
        back[k] = int(np.argmin(switched))
        cost = np.append(cost + abs(y[k] - y[k - 1]), switched[back[k]])
    other = int(np.argmin(cost + np.abs(y[-1] - np.append(y[0], y[:-1]))))
    second, of_last = np.zeros(y.size, dtype=bool), False
    for k in range(y.size - 1, 0, -1):
        second[k] = of_last
        if other == k:  # value k - 1 is the last of the other curve
            other, of_last = int(back[k]), not of_last
    second[0] = of_last
    return second
