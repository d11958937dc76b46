"""Columns of dates that are numbers: 201911020630 of weather stations, days of a spreadsheet (43771.27) and of MATLAB (737731.27)."""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.reading.table.raw_table import Table

_DIGITS = (8, 10, 12, 14)  # of YYYYMMDD, and of hours, minutes and seconds behind it
_YEARS = 1900, 2100  # in which such a number is read as a date
_DATED = re.compile(r"(?<![a-z])(?:date|datenum|datetime|timestamp)(?![a-z])", re.IGNORECASE)
# Numbers of the days of 1982 to 2064: of a spreadsheet, which counts from 1900, and of MATLAB, which counts from the year 0.
_DAYS = (30_000.0, 60_000.0), (724_000.0, 754_000.0)


def with_compact_stamps(table: Table) -> Table | None:
    """The table with such columns in seconds from the first row; None where there is none."""
    clocks = [k for k in table.positions if table.named and k not in table.labels and k not in table.stamps]
    clocks = [k for k in clocks if not table.units[k] and table.quantity(k) == "time"]
    passed = {k: seconds for k in clocks if (seconds := _seconds(table.names[k], table.columns[k])) is not None}
    if not passed:
        return None
    columns = tuple(passed.get(k, values) for k, values in enumerate(table.columns))
    units = tuple("s" if k in passed else unit for k, unit in enumerate(table.units))
    texts = (f"{table.names[k]!r}: dates written as {table.columns[k][0]:.15g}, converted to seconds" for k in passed)
    notes = [Note(Code.FILE_FORMAT, f"{text} from the first one") for text in texts]
    stamps = table.stamps | passed.keys()
    return dataclasses.replace(table, columns=columns, units=units, stamps=stamps).noted(*notes)


def _seconds(name: str, values: np.ndarray) -> np.ndarray | None:
    """Dates in numbers as seconds from the first, shape (rows,); None where one of them is no date."""
    if not np.isfinite(values).all():
        return None
    if _DATED.search(name) and any(low < values.min() and values.max() < high for low, high in _DAYS):
        return 86400.0 * (values - values[0])
    if (values != np.round(values)).any() or values.min() < 10 ** (_DIGITS[0] - 1):
        return None
    texts = [f"{value:.0f}" for value in values]
    if len({*map(len, texts)}) > 1 or len(texts[0]) not in _DIGITS:
        return None
    # YYYY-MM-DDTHH:MM:SS, of which the parts that are not written are the first ones
    full = [text + "000000"[len(text) - 8 :] for text in texts]
    written = [f"{t[:4]}-{t[4:6]}-{t[6:8]}T{t[8:10]}:{t[10:12]}:{t[12:14]}" for t in full]
    try:
        stamps = np.array(written, dtype="datetime64[s]")
    except ValueError:
        return None
    years = stamps.astype("datetime64[Y]").astype(int) + 1970
    return (stamps - stamps[0]).astype(float) if _YEARS[0] <= years.min() and years.max() < _YEARS[1] else None
