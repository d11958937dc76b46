"""Columns that an instrument adjusted beside the raw ones: one of each pair is kept, so that no loop stands there twice."""

from __future__ import annotations

import dataclasses
import functools
import re

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Table

_ADJUSTED = re.compile(r"\b(?:adjusted|adj|corrected|corr)\b\.?", re.IGNORECASE)
_RAW = re.compile(r"\b(?:raw|uncorrected|unadjusted)\b", re.IGNORECASE)


def with_adjusted(table: Table, *, adjusted: bool) -> Table:
    """The table with the raw or with the adjusted column of each pair ("Moment" and "Adjusted Moment").

    Raises:
        DataError: adjusted columns are wanted, and there are none.
    """
    bases = [_base(name) for name in table.names]
    marked = [bool(_ADJUSTED.search(name.replace("_", " "))) for name in table.names]
    raw = {base: k for k, base in enumerate(bases) if not marked[k]}
    pairs = [(raw[base], k) for k, base in enumerate(bases) if marked[k] and base in raw]
    if not pairs:
        if adjusted:
            raise DataError(
                f"{table.source} has no adjusted columns beside the raw ones: leave out --adjusted (adjusted=). The columns are "
                f"{table.describe()}"
            )
        return table
    if adjusted and table.pair is not None:
        table = dataclasses.replace(table, pair=tuple(dict(pairs).get(k, k) for k in table.pair))
    dropped = {pair[0 if adjusted else 1] for pair in pairs}
    used = "adjusted" if adjusted else "raw"
    names = ", ".join(repr(table.names[k]) for k in sorted(dropped))
    other = "leave out --adjusted for them" if adjusted else "--adjusted (adjusted=True) reads them"
    note = Note(Code.LEFT_OUT, f"the {used} columns are read; not used: {names} ({other})")
    return table.select([k for k in table.positions if k not in dropped]).noted(note)


@functools.lru_cache(maxsize=4096)
def _base(name: str) -> str:
    """Name of a column without its unit and the words for raw and adjusted."""
    plain = split_unit(name)[0].replace("_", " ")
    return " ".join(_RAW.sub(" ", _ADJUSTED.sub(" ", plain)).split()).strip(" ()[]").lower()
