"""Curves that a file holds twice, number for number: the second one is no further measurement."""

from __future__ import annotations

from collections.abc import Sequence

from hystfit.data.record import Record
from hystfit.outcome import Code, Severity
from hystfit.outcome.wrapping import listed
from hystfit.reading.limits import OF_RECORD


def without_copies(records: Sequence[Record]) -> tuple[Record, ...]:
    """The records without those that repeat an earlier one in all numbers; a warning of the earlier one names them.

    Copies would halve the variance of estimates, and cross-validation would test a record on itself.
    """
    first: dict[str, Record] = {}
    copies: dict[str, list[str]] = {}
    kept = []
    for record in records:
        key = record.digest()
        if key in first and len(record) >= OF_RECORD:
            copies.setdefault(first[key].name, []).append(record.name)
            continue
        first.setdefault(key, record)
        kept.append(record)
    return tuple(_noted(record, copies.get(record.name, [])) for record in kept)


def _noted(record: Record, copies: Sequence[str]) -> Record:
    """The record with a warning that names its copies."""
    if not copies:
        return record
    verb = "repeats" if len(copies) == 1 else "repeat"
    text = f"left out: {listed(copies)} {verb} {record.name} in all numbers; a copy is not a further measurement"
    return record.noted(Code.LEFT_OUT, text, Severity.WARNING)
