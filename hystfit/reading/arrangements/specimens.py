"""Tables of several specimens, tests or conditions below each other: a column that is constant over long runs tells records apart."""

from __future__ import annotations

import dataclasses
import functools
import re

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.limits import JUMP, MAJORITY, OF_RECORD
from hystfit.reading.names.branch_words import BRANCHES, words_of
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Table
from hystfit.reading.table.signal_evidence import clock_goes_on, extent, jumps

# Words in the names of columns that tell records apart, the best one first.
_OBJECTS = (
    "specimen sample trial coupon device pixel pix material test experiment table file filename probe".split()
    + "versuch échantillon essai".split()
)
# Words of columns that do so unless the clock goes on from one value to the next, as it does over the cycles of one experiment.
_CYCLES = {"cycle"}  # of which the numbers go on, as those of one experiment, where nothing jumps
_PASSES = "run curve loop cycle series batch group label condition name id".split()
_STEPS = re.compile(r"step|state|status|mode|phase|type|event|comment|note|flag|branch|direction|range", re.IGNORECASE)
_MOST_OF = 0.5  # of the range of the column that drives, which it passes at every temperature or frequency


def divided(table: Table) -> Table | None:
    """Specimens, tests or frequencies below each other, told apart by a column, are a record each; None for other tables."""
    clocks = table.clocks
    signals = [k for k in table.positions if k not in (*clocks, *table.labels) and not table.constant(k)]
    if table.part is not None or len(signals) < 2:  # the values of several sensors below each other are one record
        return None
    if clocks and (turns := _turns(table, clocks[0])) is not None:
        position, count = turns
        order = np.arange(table.rows).reshape(-1, count).T.ravel()
        return _parted(table.take(order), position, np.arange(1, count) * (table.rows // count) - 1)
    best: tuple[tuple[int, int], int, np.ndarray] | None = None
    for position in table.positions:
        labels = _labels(table, position)
        if labels is None:
            continue
        changes = np.flatnonzero(labels[1:] != labels[:-1])
        if not changes.size or len(set(labels.tolist())) != changes.size + 1 or "" in labels:
            continue
        if table.rows < OF_RECORD * (changes.size + 1) or not _tells_records_apart(table, position, changes):
            continue
        key = (changes.size, -_rank(table.names[position]))
        if best is None or key > best[0]:
            best = key, position, changes
    if best is None:
        return None
    return _parted(table, *best[1:])


def _turns(table: Table, clock: int) -> tuple[int, int] | None:
    """Position of a column whose texts or numbers take turns, with the same time in each turn, and their count; None without one.

    The joints of a robot and the channels of a logger have a row each at every time.
    """
    for position in (k for k in table.positions if k != clock):
        labels = table.labels.get(position, table.columns[position])
        count = np.unique(labels).size
        if count < 2 or table.rows % count or table.rows < OF_RECORD * count:
            continue
        turns, times = labels.reshape(-1, count), table.columns[clock].reshape(-1, count)
        if (turns == turns[0]).all() and np.unique(turns[0]).size == count and (times == times[:, :1]).all():
            return (position, count) if (np.diff(times[:, 0]) > 0).all() else None
    return None


def _parted(table: Table, position: int, changes: np.ndarray) -> Table:
    """The table as a record for each value of a column, which changes after these rows."""
    labels = _names_in(table, position)
    names = [str(labels[k]) for k in (0, *(changes + 1))]
    base = table.whole
    text = f"{len(names)} records, told apart by column {table.names[position]!r}: {', '.join(names[:6])}{', ...' * (len(names) > 6)}"
    return dataclasses.replace(
        table,
        part=np.searchsorted(changes, np.arange(table.rows)),
        parts=tuple(dataclasses.replace(base, name=name, stated=()) for name in names),
    ).noted(Note(Code.CURVES, text))


def _labels(table: Table, position: int) -> np.ndarray | None:
    """The text in a column, or the numbers of specimens or its condition as text, shape (rows,); None for other columns."""
    values, name = table.columns[position], table.names[position]
    if position in table.labels:
        return table.labels[position]
    numbered = names_objects(name) and not (values % 1).any()
    if not np.isfinite(values).all() or not (numbered or _is_condition(table, position)):
        return None
    return _names_in(table, position)


def _names_in(table: Table, position: int) -> np.ndarray:
    """The text in a column, or its numbers with its name as text, shape (rows,)."""
    if position in table.labels:
        return table.labels[position]
    title = split_unit(table.names[position])[0]
    distinct, back = np.unique(table.columns[position], return_inverse=True)
    return np.array([f"{title}={value:g}" for value in distinct])[back]


def _is_condition(table: Table, position: int) -> bool:
    return table.quantity(position) in ("frequency", "temperature")


def _swept(table: Table, position: int, changes: np.ndarray) -> bool:
    """Whether another column goes through most of its range between any two changes of a column: that one does not drive."""
    others = (k for k in table.positions if k != position and k not in table.labels and not table.constant(k))
    extents = ((extent(table.columns[k]), np.split(table.columns[k], changes + 1)) for k in others)
    return any(whole > 0 and all(extent(part) > _MOST_OF * whole for part in parts) for whole, parts in extents)


def names_objects(title: str) -> bool:
    """Whether a column has the names of specimens, tests or other objects."""
    return _rank(title) < len(_OBJECTS)


@functools.lru_cache(maxsize=4096)
def _rank(name: str) -> int:
    """Position among the words of columns that tell records apart; past the last for other names."""
    words, titles = words_of(name), [*_OBJECTS, *_PASSES]
    return next((k for k, title in enumerate(titles) if title in words), len(titles))


def _tells_records_apart(table: Table, position: int, changes: np.ndarray) -> bool:
    """Whether the values of a column of text stand for records, and not for the branches or steps of one."""
    name, rank = table.names[position], _rank(table.names[position])
    if rank < len(_OBJECTS):
        return True
    if _is_condition(table, position):
        return _swept(table, position, changes) and not _clock_goes_on(table, changes)
    values = dict.fromkeys(table.labels[position].tolist())
    if any(words_of(value) & BRANCHES for value in values) or _clock_goes_on(table, changes):
        return False
    told = rank < len(_OBJECTS) + len(_PASSES) and not words_of(name) & _CYCLES
    return told or (not _STEPS.search(name) and _jumps(table, changes))


def _clock_goes_on(table: Table, changes: np.ndarray) -> bool:
    """Whether a column of times increases through all records, without pauses between them."""
    return any(clock_goes_on(table.columns[position], changes + 1, JUMP) for position in table.clocks)


def _jumps(table: Table, changes: np.ndarray) -> bool:
    """Whether the numbers of a column make a large step at most of the changes."""
    taken = {*table.labels, *table.clocks}
    others = (k for k in table.positions if k not in taken and table.quantity(k) != "index")
    return any(np.mean(jumps(table.columns[k], changes)) > MAJORITY for k in others)
