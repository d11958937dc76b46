"""Levels at which a column is held in turn: of a quantity that is set, and of one that is measured while it follows."""

from __future__ import annotations

import itertools

import numpy as np

from hystfit.reading.limits import MOST_LABELS

_ROWS_OF_LEVEL = 50  # of a column that is set to levels in turn
_APART = 0.1  # range of such levels, as a fraction of the largest: those of a position that is read back differ by less
# Levels at which a measured column is held: the largest distance of a row from its level as part of the range of all and of the distance of
# two levels, that from levels that are close beside the range of all, and the least distance between these as part of that range; the part
# of the rows at levels (a current that follows its set value within a seventh of the time at a level has 0.87, a sine 0.2), and by how much
# more rows are near one than evenly spread ones would be within a bin.
_WITHIN, _OF_DISTANCE, _AMONG_CLOSE, _FINEST, _HELD_MOST, _CROWDED, _BINS = 0.02, 0.4, 0.1, 5e-3, 0.7, 2, 50
_DECADE = 10  # from the least to the largest of levels that may lie apart by their ratios
_NEAR_ZERO = 5e-3  # of the distance between levels, within which one of them is at zero


def levels_in_turn(values: np.ndarray) -> list[float]:
    """Levels to which a column is set in turn while others are measured; none for a column of another kind."""
    levels = np.unique(values)
    runs = 1 + np.count_nonzero(np.diff(values))
    few = (
        1 < levels.size <= MOST_LABELS and np.isfinite(levels).all() and np.ptp(levels) > _APART * np.abs(levels).max()
    )
    return levels.tolist() if few and runs <= 2 * levels.size and values.size >= _ROWS_OF_LEVEL * runs else []


def held_levels(values: np.ndarray) -> list[tuple[float, int, int]]:
    """Levels at which a measured column is held, one after the other or again: each with the first row of its longest stretch and the next.

    None for a column of another kind. A current that follows its set value is at its levels for most rows.
    """
    levels, at = _levels_and_rows(values)
    runs = _stretches(at)
    longest = lambda k: max((run for run in runs if at[run[0]] == k), key=lambda run: run[1] - run[0])
    return [(float(level), *longest(k)) for k, level in enumerate(levels)]


def held_labels(values: np.ndarray) -> np.ndarray | None:
    """The level at which a measured column is held as text, "" between two, shape (rows,); None for a column of another kind."""
    levels, at = _levels_and_rows(values)
    return np.array([*(f"{level:g}" for level in levels_apart(levels)), ""])[at] if levels.size else None


def _levels_and_rows(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The levels at which a column is held and the one of each row, -1 between two; no levels for a column of another kind.

    Levels over a decade, as temperatures of 2, 5, 20 and 300 K are, lie apart by their ratios.
    """
    if values.size < 2 * _ROWS_OF_LEVEL or not np.isfinite(values).all():
        return np.empty(0), np.full(values.size, -1)
    over_decades = values.min() > 0 and values.max() > _DECADE * values.min()
    for one in (values, _averaged(values)):  # also through noise, as of a load that is controlled
        found = [*([_rows_by_ratio(one)] if over_decades else []), _rows_of_levels(one)]
        levels, at = max(((_medians(values, at), at) for at in found), key=lambda way: way[0].size)
        if levels.size and np.ptp(levels) > _APART * np.abs(levels).max():
            return levels, at
    return np.empty(0), np.full(values.size, -1)


def _averaged(values: np.ndarray) -> np.ndarray:
    """Averages over half as many rows around each as a level lasts at least."""
    half = _ROWS_OF_LEVEL // 4
    sums = np.cumsum(np.pad(values - values[0], (half + 1, half), mode="edge"))
    return values[0] + (sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1)


def _rows_by_ratio(values: np.ndarray) -> np.ndarray:
    """The level of each row where levels lie apart by their ratios; without ends of ramps where no level has holes then."""
    at = _rows_of_levels(np.log(values))
    if at.max() < 1:
        return at
    close = np.where(np.abs(values - _medians(values, at)[at]) <= _WITHIN * values, at, -1)
    same = [at[first] for first, _ in _stretches(at)] == [close[first] for first, _ in _stretches(close)]
    return close if same else at


def _medians(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The level of each group of rows."""
    return np.array([np.median(values[at == k]) for k in range(at.max() + 1)])


def _rows_of_levels(values: np.ndarray, parent: float = 0) -> np.ndarray:
    """The level of each row, counted from the least one, -1 between two; -1 throughout for values that are not held.

    Levels that are close to each other beside the range of all, as 290 and 300 K are beside 2 K, are found among themselves.

    Args:
        parent: range of the values that these are some of.
    """
    span, nothing = np.ptp(values), np.full(values.size, -1)
    if not span > _FINEST * parent:
        return nothing
    ranked, half = np.sort(values), 0.5 * span / _BINS
    near = np.searchsorted(ranked, ranked + half, "right") - np.searchsorted(ranked, ranked - half, "left")
    heavy = ranked[near > max(_CROWDED * values.size / _BINS, _ROWS_OF_LEVEL / 2)]
    groups = np.split(heavy, np.flatnonzero(np.diff(heavy) > span / _BINS) + 1)
    levels = np.array([np.median(group) for group in groups if group.size])
    if not 1 < levels.size <= MOST_LABELS or np.diff(levels).min() <= _FINEST * parent:
        return nothing
    nearest = np.abs(values[:, None] - levels).argmin(axis=1)
    distance = np.diff(levels).min()
    within = _AMONG_CLOSE * distance if parent else min(_WITHIN * span, _OF_DISTANCE * distance)
    at = np.where(np.abs(values - levels[nearest]) <= within, nearest, -1)
    rows = [stop - first for first, stop in _stretches(at)]
    held = np.unique(at[at >= 0]).size == levels.size and np.mean(at >= 0) > _HELD_MOST
    if not held or np.median(rows) < _ROWS_OF_LEVEL:
        return nothing
    return _divided(values, at, parent or span)


def _stretches(at: np.ndarray) -> list[tuple[int, int]]:
    """First row and the next after the last of each stretch at one level."""
    ends = [0, *(np.flatnonzero(np.diff(at)) + 1).tolist(), at.size]
    return [run for run in itertools.pairwise(ends) if at[run[0]] >= 0]


def _divided(values: np.ndarray, at: np.ndarray, span: float) -> np.ndarray:
    """The level of each row where some of the levels are several that are close to each other."""
    found, levels = np.full(values.size, -1), 0
    for k in range(at.max() + 1):
        inside = np.flatnonzero(at == k)
        several = inside.size >= 2 * _ROWS_OF_LEVEL
        within = _rows_of_levels(values[inside], span) if several else np.zeros(inside.size, dtype=int)
        within = within if within.max() > 0 else np.zeros(inside.size, dtype=int)
        found[inside] = np.where(within >= 0, levels + within, -1)
        levels += within.max() + 1
    return found


def levels_apart(levels: np.ndarray) -> list[float]:
    """Levels with the digits that tell them apart: 2 of 1.9996 beside 4.0004, 0 of -0.0005 beside 10, 1.8 beside 300."""
    digits = lambda size: 1 - int(np.floor(np.log10(size)))
    apart = lambda level: np.abs(levels - level)[levels != level].min()
    small = lambda level: _NEAR_ZERO * apart(level) < abs(level) < apart(level)
    return [round(float(one), digits(abs(one) if small(one) else apart(one))) + 0.0 for one in levels]
