"""Reversal curves with calibration points: which rows of a file are calibration points, and which curve follows each."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.choice.chosen_columns import Choice
from hystfit.reading.limits import FEW, FEWEST, JUMP, NEAR
from hystfit.reading.table.raw_table import Table

CURVE_NAMES = (
    *("curve", "loop", "cycle", "segment", "run", "sweep", "forc"),
    *("kurve", "schleife", "zyklus", "lauf", "courbe", "boucle", "curva", "ciclo"),
)
_KIND = re.compile(r"cal(?:ib(?:ration)?)?(?:[ _-]?p(?:oin)?t)?|sat(?:uration)?", re.IGNORECASE)
_FLAG = re.compile(r"(?:is_?)?cal(?:ib(?:ration)?)?", re.IGNORECASE)


def marked_by_kind(table: Table, taken: Sequence[int]) -> tuple[np.ndarray | None, list[int]]:
    """Calibration points by a column of their kind: which rows, shape (rows,), bool, and which columns separate the curves.

    The column holds text such as "cal" and "curve", or 1 at calibration points and 0 elsewhere. The rows are None without it.
    """
    for position, name in enumerate(table.names):
        if position in taken:
            continue
        if position in table.labels:
            labels = table.labels[position].tolist()
            of_kind = {label: bool(_KIND.fullmatch(str(label).strip())) for label in set(labels)}
            marked = np.array([of_kind[label] for label in labels])
        elif _FLAG.fullmatch(name) and set(table.columns[position].tolist()) == {0.0, 1.0}:
            marked = table.columns[position] == 1.0
        else:
            continue
        if _precede_curves(marked):
            numbering = _numbering(table, _starts(table, marked))
            return marked, [position] if numbering is None else [position, numbering]
    return None, []


def marked_by_place(table: Table, choice: Choice) -> np.ndarray | None:
    """Calibration points that are single rows between blank lines, or isolated points at one input before monotonic branches."""
    marked, u = _single_rows(table), table.columns[choice.input]
    if not marked.any() and table.curve[-1] == 0:
        marked = _isolated(u)
    if not _precede_curves(marked) or not np.ptp(u[marked]) <= NEAR * np.ptp(u[np.isfinite(u)]):
        return None
    return marked


def _precede_curves(marked: np.ndarray) -> bool:
    """Whether marked rows are few in a row, begin with the first row, and occur more than once."""
    runs = np.diff(np.flatnonzero(np.diff(marked.astype(int), prepend=0, append=0)))[::2]
    return bool(marked[0] and runs.size > 1 and runs.max() <= FEW)


def _starts(table: Table, marked: np.ndarray) -> np.ndarray:
    """First rows of curves, shape (rows,), bool: at calibration points, and at other blank lines."""
    after = np.append(False, marked[:-1])
    starts = (marked | np.append(False, np.diff(table.curve) > 0)) & ~after
    starts[0] = True
    return starts


def _numbering(table: Table, starts: np.ndarray) -> int | None:
    """Position of a column of numbers that changes where the next curve begins, and nowhere else; None where there is none."""
    for position, name in enumerate(table.names):
        column = table.columns[position]
        if name.lower() in CURVE_NAMES and position not in table.labels and np.isfinite(column).all():
            if np.array_equal(starts[1:], np.diff(column) != 0):
                return position
    return None


def _single_rows(table: Table) -> np.ndarray:
    """Blocks of a single row between blank lines that precede a longer block."""
    edges = np.flatnonzero(np.diff(table.curve, prepend=-1))
    sizes = np.diff(np.append(edges, table.rows))
    marked = np.zeros(table.rows, dtype=bool)
    marked[edges[:-1][(sizes[:-1] == 1) & (sizes[1:] > 1)]] = True
    return marked


def _isolated(u: np.ndarray) -> np.ndarray:
    """Points far from both neighbors, each followed by a branch in one direction; none where the rows are not only that."""
    marked = np.zeros(u.size, dtype=bool)
    if u.size < 3 * FEWEST or not np.isfinite(u).all():
        return marked
    step = np.diff(u)
    usual = np.median(np.abs(step))
    far = (np.abs(step) > JUMP * usual) & (usual > 0)
    back, ahead = np.append(True, far), np.append(far, False)
    turned = np.append(True, step[:-1] * step[1:] < 0)
    marked[:-1] = back[:-1] & ahead[:-1] & turned
    branches = np.split(step, np.flatnonzero(marked)[1:])
    alike = all(np.ptp(np.sign(branch[1:-1])) < 2 for branch in branches if branch.size > 2)
    return marked if marked[0] and marked.sum() >= FEWEST and alike else np.zeros_like(marked)


def calibrated_curves(
    table: Table, choice: Choice, marked: np.ndarray, notes: list[Note]
) -> list[tuple[str, np.ndarray]]:
    """Label and rows of every curve, its calibration points first.

    Args:
        marked: which rows are calibration points, shape (rows,).
    """
    number = np.cumsum(_starts(table, marked)) - 1
    numbering = _numbering(table, _starts(table, marked))
    title, values = ("curve", number) if numbering is None else (table.names[numbering], table.columns[numbering])
    parts = np.split(np.arange(table.rows), np.flatnonzero(np.diff(number)) + 1)
    curves = [rows for rows in parts if not marked[rows].all() and rows.size > 1]
    notes += _summary(table, choice, marked, len(curves))
    if len(curves) < len(parts):
        notes.append(Note(Code.LEFT_OUT, f"left out: {len(parts) - len(curves)} calibration points without a curve"))
    return [(f"{title}={values[rows[0]]:.12g}", rows) for rows in curves]


def _summary(table: Table, choice: Choice, marked: np.ndarray, count: int) -> list[Note]:
    """How many curves there are, and how far their calibration points agree."""
    u, y = (table.columns[position] for position in (choice.input, choice.output))
    u_unit, y_unit = (f" {table.units[position]}".rstrip() for position in (choice.input, choice.output))
    text = f"{count} curves, each after a calibration point at an input of about {np.nanmedian(u[marked]):.5g}{u_unit}"
    notes = [Note(Code.CURVES, f"{text}, which is its first sample and has weight 0")]
    levels, everything = y[marked & np.isfinite(y)], y[np.isfinite(y)]
    if levels.size > 1:
        spread = 100 * np.ptp(levels) / np.ptp(everything)
        text = f"outputs at the calibration points: {levels.min():.5g} to {levels.max():.5g}{y_unit}"
        notes.append(Note(Code.CURVES, f"{text}, a spread of {spread:.2g} % of the range of all outputs"))
    return notes
