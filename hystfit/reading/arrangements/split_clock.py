"""Times that several columns hold: seconds and nanoseconds, as ROS and EPICS write them, or year, month, day, hour, minute and second."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Table

_SECONDS = frozenset({"sec", "secs", "seconds"})
_PARTS = {  # of a second, by the names of the columns that count them
    **dict.fromkeys(("nanosec", "nanosecs", "nsec", "nsecs", "nanos", "nanoseconds"), 1e-9),
    **dict.fromkeys(("usec", "usecs", "microseconds", "micros"), 1e-6),
}
_CALENDAR = (
    ("year", "yyyy", "yr"), ("month", "mon", "mm"), ("day", "dd"),
    ("hour", "hours", "hr", "hh"), ("minute", "minutes", "min", "mi"), ("second", "seconds", "sec", "secs", "ss"),
)  # fmt: skip
_OF_DATE, _FEWEST = 3, 5  # parts of a date, and parts from which columns are those of a time
_STARTS = (1, 1, 1, 0, 0, 0)  # the least of each part
_ENDS = (9999, 12, 31, 24, 59, 61)


def with_joined_clock(table: Table) -> Table | None:
    """The table with the joined time, in seconds from the first row, in place of each column of its parts; None for other tables."""
    numbers = {k: table.names[k] for k in table.positions if k not in table.labels and k not in table.stamps}
    joined = {k: seconds for parts, seconds in _clocks(table, numbers) for k in parts} if table.named else {}
    if not joined:
        return None
    put = lambda values, of: tuple(of(k) if k in joined else one for k, one in enumerate(values))
    names = ", ".join(repr(table.names[k]) for k in joined)
    return dataclasses.replace(
        table,
        columns=put(table.columns, lambda k: joined[k]),
        units=put(table.units, lambda _: "s"),
        stamps=table.stamps | joined.keys(),
    ).noted(Note(Code.FILE_FORMAT, f"the time is in several columns, {names}: joined, in seconds from the first row"))


def _clocks(table: Table, numbers: dict[int, str]) -> Iterator[tuple[list[int], np.ndarray]]:
    """The positions of the parts of a time, and the time [s]."""
    words = {k: re.split(r"[._/ ]", split_unit(name)[0].strip().lower()) for k, name in numbers.items()}
    for k, (*group, last) in words.items():
        if last in _SECONDS:
            fine = next((j for j, (*other, end) in words.items() if other == group and end in _PARTS), None)
            if fine is not None and _is_count(table.columns[k]) and _is_count(table.columns[fine]):
                whole = table.columns[k] - table.columns[k][0]
                part = _PARTS[words[fine][-1]] * (table.columns[fine] - table.columns[fine][0])
                yield [k, fine], whole + part
                return
    places = [next((k for k, word in words.items() if word in ([one] for one in names)), None) for names in _CALENDAR]
    found = [k for k in places if k is not None]
    if len(found) >= _FEWEST and None not in places[: _OF_DATE + 2]:
        seconds = _of_calendar([np.zeros(table.rows) if k is None else table.columns[k] for k in places])
        if seconds is not None:
            yield found, seconds


def _of_calendar(parts: list[np.ndarray]) -> np.ndarray | None:
    """Years, months, days, hours, minutes and seconds as seconds from the first row; None where they are none."""
    inside = all(np.all((v >= low) & (v <= high)) for v, low, high in zip(parts, _STARTS, _ENDS, strict=True))
    if not inside or not all(map(_is_count, parts[:-1])):
        return None
    years, months, days = (part.astype(int) for part in parts[:_OF_DATE])
    dates = (years - 1970).astype("datetime64[Y]").astype("datetime64[M]") + (months - 1)
    passed = (dates.astype("datetime64[D]") + (days - 1) - dates[0].astype("datetime64[D]")).astype(float)
    seconds = 86400 * passed + 3600 * parts[3] + 60 * parts[4] + parts[5]
    return seconds - seconds[0]


def _is_count(values: np.ndarray) -> bool:
    """Whether a column holds whole numbers alone."""
    return bool(np.isfinite(values).all() and (values == np.round(values)).all() and values.min() >= 0)
