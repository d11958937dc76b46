"""The curves in a file: by a column, by blank lines or repeated headers, or each after a calibration point."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.reading.calibration_points import CURVE_NAMES, calibrated_curves
from hystfit.reading.columns import Choice
from hystfit.reading.header import split_unit
from hystfit.reading.raw_table import Table

_MOST_CURVES = 10_000


def text_of(value: object) -> str:
    """A value as it is compared with others: numbers without trailing zeros, text without blanks around it."""
    try:
        return f"{float(value):.12g}"  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return str(value).strip()


def labels_of(table: Table, position: int) -> np.ndarray:
    """The values of a column as text, "" where missing, shape (rows,)."""
    if position in table.labels:
        return np.array([text_of(value) for value in table.labels[position]])
    values, back = np.unique(table.columns[position], return_inverse=True)
    return np.array(["" if np.isnan(value) else f"{value:.12g}" for value in values])[back]


def shown(values: Sequence[str] | np.ndarray) -> str:
    """The first of some values, and how many there are."""
    distinct = list(dict.fromkeys(str(value) for value in values))
    return ", ".join(distinct[:12]) + (f", ... ({len(distinct)} in all)" if len(distinct) > 12 else "")


def split_curves(
    table: Table, choice: Choice, divider: int | None, notes: list[Note]
) -> tuple[list[tuple[str, np.ndarray]], bool]:
    """Label and rows of every curve, and whether the file holds several.

    Args:
        divider: position of the column whose values separate curves; None where none was chosen.
    """
    if divider is not None:
        return _of_several_rows(_by_column(table, divider, notes), table, choice, notes), True
    if table.calibration is not None:
        return calibrated_curves(table, choice, table.calibration, notes), True
    number = _numbers_of_curves(table, choice, notes)
    if number[-1] == 0:
        _suggest(table, choice, notes)
        return [("", np.arange(table.rows))], False
    if number[-1] > _MOST_CURVES:
        raise DataError(
            f"{table.source}: blank lines or repeated headers separate {number[-1] + 1} curves, and {_MOST_CURVES} are the "
            "most; remove them, or write fewer curves in a file"
        )
    bounds = np.append(np.flatnonzero(np.diff(number, prepend=-1)), table.rows)
    pieces = [np.arange(a, b) for a, b in itertools.pairwise(bounds)]
    single = sum(piece.size == 1 for piece in pieces)
    pieces = [piece for piece in pieces if piece.size > 1]
    if single:
        notes.append(Note(Code.CURVES, f"{single} blocks of a single row are not part of the curves"))
    if not pieces:
        raise DataError(f"{table.source}: every block between blank lines has a single row; remove the blank lines")
    if len(pieces) == 1:
        return [("", pieces[0])], False
    notes.append(Note(Code.CURVES, f"{len(pieces)} curves, separated by blank lines or repeated headers"))
    return [(f"curve={k}", piece) for k, piece in enumerate(pieces)], True


def _by_column(table: Table, divider: int, notes: list[Note]) -> list[tuple[str, np.ndarray]]:
    """Label and rows of each value of a column."""
    labels = labels_of(table, divider)
    if blank := int((labels == "").sum()):
        notes.append(Note(Code.LEFT_OUT, f"left out: {blank} rows without a value of {table.names[divider]!r}"))
    order = [value for value in dict.fromkeys(labels.tolist()) if value]
    if len(order) > 1000 and len(order) > table.rows / 2:
        raise DataError(
            f"{table.source}: by={table.names[divider]!r} has {len(order)} values in {table.rows} rows; it does not separate curves"
        )
    title = split_unit(table.names[divider])[0]
    return [(f"{title}={value}", np.flatnonzero(labels == value)) for value in order]


def _numbers_of_curves(table: Table, choice: Choice, notes: list[Note]) -> np.ndarray:
    """Number of the curve that each row is in, by blank lines and repeated headers, shape (rows,)."""
    begins = np.append(False, np.diff(table.section) > 0)
    if choice.time is not None:  # a header repeated while time continues is a page break
        clock = table.columns[choice.time]
        page_breaks = begins & np.append(False, clock[1:] > clock[:-1])
        if page_breaks.any():
            text = f"{page_breaks.sum()} repeated header rows do not begin a curve: time continues there"
            notes.append(Note(Code.CURVES, text))
        begins &= ~page_breaks
    begins[1:] |= np.diff(table.curve) > 0
    return np.cumsum(begins)


def _of_several_rows(
    groups: list[tuple[str, np.ndarray]], table: Table, choice: Choice, notes: list[Note]
) -> list[tuple[str, np.ndarray]]:
    """Curves of at least two rows; the others are named in the notes."""
    short = [(label, rows) for label, rows in groups if rows.size < 2]
    if short:
        u, y = (table.columns[position] for position in (choice.input, choice.output))
        listed = ", ".join(f"{label} ({u[rows[0]]:g}, {y[rows[0]]:g})" for label, rows in short[:5])
        more = f" and {len(short) - 5} more" if len(short) > 5 else ""
        notes.append(Note(Code.LEFT_OUT, f"left out: curves of a single row, {listed}{more}"))
    kept = [(label, rows) for label, rows in groups if rows.size > 1]
    if not kept:
        raise DataError(f"{table.source}: every curve that by= makes has a single row; choose another column")
    return kept


def _suggest(table: Table, choice: Choice, notes: list[Note]) -> None:
    for position, name in enumerate(table.names):
        if position in (choice.time, choice.input, choice.output) or name.lower() not in CURVE_NAMES:
            continue
        count = len(set(labels_of(table, position).tolist()))
        if 1 < count <= table.rows / 2:
            text = f"column {name!r} has {count} values: by={name!r} reads each as a record"
            notes.append(Note(Code.CURVES, text, option=("by", name)))


def select_curves(groups: list[tuple[str, Any]], only: object, source: str) -> list[tuple[str, Any]]:
    """The (label, curve) pairs that `only` selects, by value ("3,4") or position from 0 ("1::4").

    Args:
        groups: label ("loop=3") and curve of each.
    """
    values = [label.partition("=")[2] or label for label, _ in groups]
    if isinstance(only, str) and (found := re.fullmatch(r"\s*(-?\d*):(-?\d*)(?::(-?\d*))?\s*", only)):
        limits = [int(part) if part else None for part in found.groups()]
        if limits[2] == 0:
            raise DataError(f"only={only!r}: the step of a slice must not be 0")
        chosen = groups[slice(*limits)]
        if not chosen:
            raise DataError(f"{source}: only={only!r} chooses none of {len(groups)} curves (positions from 0)")
        return chosen
    parts = only.split(",") if isinstance(only, str) else only if isinstance(only, Sequence) else [only]
    wanted = list(dict.fromkeys(text_of(part) for part in parts))
    unknown = [value for value in wanted if value not in values]
    if unknown or not wanted:
        raise DataError(
            f"{source}: there is no curve {', '.join(unknown) or 'in an empty only='}; there are {shown(values)}"
        )
    return [groups[values.index(value)] for value in wanted]
