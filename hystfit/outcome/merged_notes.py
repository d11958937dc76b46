"""Notes of several records as few: equal ones once, and many that differ in their numbers alone as the first of them."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Mapping, Sequence

from hystfit.outcome.note import Code, Note

_NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_MANY = 3  # notes that differ in their numbers alone, up to which each is given


def merged(by_record: Mapping[str, Iterable[Note]], records: int) -> list[Note]:
    """The notes in the order of their first records; one that does not hold for all of so many `records` names them."""
    names: dict[Note, list[str]] = {}
    for record, notes in by_record.items():
        for note in notes:
            names.setdefault(note, []).append(record)
    found = []
    for notes in _alike(names):
        note, of = notes[0], [name for one in notes for name in names[one]]
        which = of[0] if len(of) == 1 else f"{len(of)} of {records} records"
        if len(notes) > 1:
            which += f", such as {of[0]}"
        text = note.text if len(notes) == 1 and len(of) == records else f"{which}: {note.text}"
        found.append(dataclasses.replace(note, text=text))
    return found


def _alike(notes: Iterable[Note]) -> list[Sequence[Note]]:
    """Notes alone, or together where many differ in their numbers alone, in the order of the first of each."""
    groups: dict[tuple[Code, str], list[Note]] = {}
    for note in notes:
        groups.setdefault((note.code, _NUMBER.sub("#", note.text)), []).append(note)
    return [part for group in groups.values() for part in ([group] if len(group) > _MANY else [[one] for one in group])]
