"""Numbers that instruments and programs write for a missing or invalid measurement: infinity, 9.91e37, -9999 and others."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading.limits import FEW, JUMP, MAJORITY, ODD
from hystfit.reading.table.raw_table import Table

_TOO_LARGE = 9e36  # 9.9e37 and 9.91e37 of SCPI instruments, 1e99, the largest float and double
_TOO_SMALL = 1e-100  # the third power of which is still a double: no quantity in any unit is as small
_CODES = (-999.0, -999.25, -999.9, -9999.0, -9999.9, -99999.0, 9999.0, 99999.0, 999999.0, -999999.0)
_TIMES, _OTHER_TIMES = 10.0, (5.0, 20.0)  # what a lost mark multiplies a number with, and what it never does
_FAR = 1.0, 0.3  # distance of a positive and of a negative code from the other values, as a multiple of their range


def without_infinite(table: Table) -> tuple[Table, dict[int, tuple[int, int, float]]]:
    """The table with NaN in place of infinite and too large numbers, and for each column with such numbers what was replaced.

    That is the number of infinite values, of too large ones, and the first of these. Numbers whose squares are lost to rounding are zeros.
    """
    columns, replaced = [], {}
    for position, values in enumerate(table.columns):
        with np.errstate(invalid="ignore"):
            beyond = np.abs(values) > _TOO_LARGE
            values = np.where(np.abs(values) < _TOO_SMALL, 0.0, values)
        if beyond.any():
            large = values[beyond & np.isfinite(values)]
            replaced[position] = int(beyond.sum()) - large.size, large.size, float(large[0]) if large.size else np.inf
            values = np.where(beyond, np.nan, values)
        columns.append(values)
    return dataclasses.replace(table, columns=tuple(columns)), replaced


def replaced_notes(replaced: tuple[int, int, float], role: str) -> list[Note]:
    """Notes on what `without_infinite` replaced in a column."""
    infinite, large, first = replaced
    notes = []
    if infinite:
        notes.append(Note(Code.MISSING_VALUES, f"infinite values of the {role} are treated as missing: {infinite}"))
    if large:
        text = f"values of the {role} such as {first:g} are treated as missing: {large}"
        notes.append(warn(Code.MISSING_VALUES, text))
    return notes


def without_codes(values: np.ndarray, role: str) -> tuple[np.ndarray, list[Note]]:
    """A column with NaN in place of codes such as -9999 that lie far from all other values, and a note that counts them.

    Args:
        values: shape (rows,), none infinite.
    """
    coded = np.isin(values, _CODES)
    others = values[~coded & np.isfinite(values)]
    if not coded.any() or others.size < 2 or coded.sum() > MAJORITY * values.size:
        return values, []
    low, high = others.min(), others.max()
    outside = coded & ((values < low) | (values > high))
    if not outside.any():
        return values, []
    far = np.maximum((values - high) / _FAR[0], (low - values) / _FAR[1]) > high - low
    rows = np.arange(values.size)
    between = np.interp(rows, rows[~coded & np.isfinite(values)], others)
    missing = outside & (far | (np.abs(values - between) > JUMP * np.abs(np.diff(others)).max()))
    missing = outside & np.isin(values, values[missing])
    first = f"values of the {role} such as {values[outside][0]:g}"
    if not missing.any():
        text = f"{first} may stand for missing values: {int(outside.sum())}; they are read as measurements"
        return values, [warn(Code.MISSING_VALUES, text)]
    text = f"{first}, far from all others, are treated as missing: {int(missing.sum())}"
    note = warn(Code.MISSING_VALUES, f"{text}; if they are measurements, scale the column")
    return np.where(missing, np.nan, values), [note]


def failed_inputs(u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Rows in which the input alone reads 0: single zeros, farther from the values around them than these from each other, while the
    output goes on between those of its neighbors.

    Args:
        u, y: input and output, shape (rows,).
    """
    zero, others = u == 0.0, u[(u != 0.0) & np.isfinite(u)]
    rows = np.arange(u.size)
    inner = zero[1:-1] & ~zero[:-2] & ~zero[2:]
    if not inner.any() or zero.sum() > max(ODD * u.size, 1) or others.size < 2:
        return rows[:0]
    around = np.interp(rows, rows[(u != 0.0) & np.isfinite(u)], others)
    goes_on = (y[1:-1] - y[:-2]) * (y[2:] - y[1:-1]) > 0
    return rows[1:-1][inner & goes_on & (np.abs(around[1:-1]) > np.abs(np.diff(others)).max())]


def shifted_marks(values: np.ndarray) -> np.ndarray:
    """Rows far from their neighbors with a tenth of a number between these, or ten times one: a zero behind a comma was cut off.

    The neighbors go on from one to the other by usual steps, as few of those in a burst of noise do, and as many of these are a fifth or
    a twentieth of a number between their neighbors by chance.
    """
    if values.size < FEW or not np.isfinite(steps := np.abs(np.diff(values))).any():
        return np.arange(0)
    low, high = np.minimum(values[:-2], values[2:]), np.maximum(values[:-2], values[2:])
    large = JUMP * np.nanmedian(steps)
    with np.errstate(over="ignore"):  # of numbers near the largest
        run_on = ((low > 0) & (high < 2 * low)) | ((high < 0) & (low > 2 * high))  # as no pulse does
        far = run_on & (np.minimum(steps[:-1], steps[1:]) > large) & (high - low <= large)
        between = lambda factor: (low < factor * values[1:-1]) & (factor * values[1:-1] < high)
        shifted, *others = (
            np.flatnonzero(far & (between(times) | between(1.0 / times))) for times in (_TIMES, *_OTHER_TIMES)
        )
    return shifted[:0] if sum(other.size for other in others) >= shifted.size else shifted + 1


def without_end_marks(table: Table) -> Table:
    """The table without rows that are 0 in all its columns of numbers, where one of these otherwise stays far from 0: marks of an end.

    Far is farther than the range of the column, as a saturation pressure or a temperature that is logged beside a loop is. So are the rows
    at the end of a record that fills an array of zeros in part: a column that always rises before them is a time, which never goes back.
    """
    numbers = [k for k in table.positions if k not in table.labels and np.isfinite(table.columns[k]).any()]
    if len(numbers) < 3:
        return table
    columns = np.column_stack([table.columns[k] for k in numbers])
    marks = (columns == 0.0).all(axis=1)
    if not 0 < marks.sum() < MAJORITY * table.rows:
        return table
    low, high = np.nanmin(columns[~marks], axis=0), np.nanmax(columns[~marks], axis=0)
    filled = bool(marks[-marks.sum() :].all()) and (np.diff(columns[~marks], axis=0) > 0).all(axis=0).any()
    if not filled and not (np.maximum(low, -high) > high - low).any():
        return table
    if filled:
        text = (
            f"left out: {int(marks.sum())} rows at the end that are 0 in all columns, the time among them: no samples"
        )
        return table.take(~marks).noted(Note(Code.LEFT_OUT, text))
    text = f"left out: {int(marks.sum())} rows that are 0 in all columns, of which one otherwise stays far from 0: marks of an end"
    return table.take(~marks).noted(Note(Code.LEFT_OUT, text))


def ends_with_zeros(columns: Iterable[np.ndarray]) -> bool:
    """Whether the last row is 0 in all columns, each time over a step twice as large as any other step: an end mark."""
    rows = np.column_stack([*columns])
    steps = np.abs(np.diff(rows, axis=0))
    return len(rows) * ODD > 1 and not rows[-1].any() and bool((steps[-1] > 2 * steps[:-1].max(axis=0)).all())
