"""Which column is time, input and output: by name, by number from 0, or guessed from names, units and order."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

import numpy as np

from hystfit.data.preparation import CoarseClock
from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.reading.header import split_unit
from hystfit.reading.raw_table import Table

_WORDS: dict[str, str] = {}
for _kind, _list in {
    "time": "t time times sec secs second seconds zeit temps timestamp datetime date elapsed tout clock tiempo x_value",
    "input": "input in command cmd excitation reference ref setpoint drive stimulus u eingang",
    "output": "output out response y reading ausgang",
    "voltage": "voltage volt volts vin spannung potential vdrive vcmd tension_v",
    "field": "h hfield field feld applied_field",
    "current": "current strom amps amperes",
    "pressure": "pressure druck",
    "strain": "strain eps epsilon dehnung e etrue engstrain",
    "displacement": "x d disp displ displacement position pos stroke deflection drift weg dist distance "
    "elongation extension travel angle theta rotation rot lvdt",
    "velocity": "vel velocity speed geschwindigkeit xdot v_rel rate acceleration accel acc",
    "magnetization": "b m j magnetization magnetisation induction flux moment polarization pol p charge q mag",
    "force": "f force load kraft shear forc torque fx fy fz base_shear lateral_load",
    "stress": "stress sigma sig s",
    "temperature": "temperature temp temperatur kelvin celsius",
    "index": "index idx no nr number sample point pt loop curve cycle segment kind step branch run id n k",
}.items():
    for _word in _list.split():
        _WORDS[_word] = _kind
_UPPER = {
    "V": "voltage",
    "U": "voltage",
    "H": "field",
    "I": "current",
    "E": "field",
    "D": "magnetization",
    "T": "temperature",
}
_UNITS = {
    "time": r"[nuµμm]?s|sec|seconds?|min|hr|h",
    "voltage": r"[muµkM]?V|volts?",
    "field": r"[mk]?Oe|[mkM]?A/m|[kM]?V/c?m",
    "current": r"[pnuµμmk]?A",
    "pressure": r"bar|mbar|psi",
    "displacement": r"[nuµμmc]?m|in|inch|ft|m?rad|deg|°",
    "force": r"[muµkM]?N|kips?|lbs?|lbf|kgf|[k]?Nm",
    "stress": r"[kMG]?Pa|ksi",
    "velocity": r"(?:[nuµμmc]?m|in|inch|m?rad|deg)/s.*",
    "magnetization": r"m?T|k?G|m?emu(?:/.*)?|A\W?m\^?2(?:/.*)?|[pnuµμm]?C(?:/.*)?",
    "strain": r"[muµ]?strain|mm/mm",
    "temperature": r"°?C|degC|K",
}
_AS_INPUT = ("input", "voltage", "field", "current", "pressure", "strain", "displacement", "temperature", "")
_AS_OUTPUT = ("output", "magnetization", "force", "stress", "displacement", "strain", "", "current", "temperature")
_AS_OUTPUT_OF_DRIVE = ("output", "magnetization", "displacement", "strain", "force", "stress", "", "current")
_LAST = ("velocity", "index", "time")


@dataclasses.dataclass(frozen=True)
class Choice:
    """Positions of the time (None: no time), input and output columns, and a note for every guess."""

    time: int | None
    input: int
    output: int
    notes: tuple[Note, ...]


def by_unit_of(unit: str) -> str:
    """Physical quantity of a column with this unit, "" if unknown."""
    return next((kind for kind, pattern in _UNITS.items() if unit and re.fullmatch(pattern, unit)), "")


def quantity(name: str, unit: str = "") -> str:
    """Physical quantity of a column ("time", "voltage", "displacement", ..., "" if unknown), by its name and then by its unit."""
    base, unit_of_name = split_unit(name)
    unit = unit or unit_of_name
    base, of_matrix = re.subn(r"\[\d+\]$", "", base.strip())
    if of_matrix and "_" in base:
        return by_unit_of(unit)  # a column of a matrix x_F: the name is not that of the column
    by_unit = by_unit_of(unit)
    if base in _UPPER and not by_unit:
        return _UPPER[base]
    tokens = base.lower().split("_")
    camel = re.findall(r"[A-Z]?[a-z]{2,}|[A-Z]{2,}(?![a-z])", base)
    words = [base.lower(), *(token.strip() for token in tokens), *(part.lower() for part in camel)]
    kinds = [_WORDS[word] for word in words if word in _WORDS]
    if any(word.startswith("displac") for word in words):
        kinds.append("displacement")
    if symbol := re.match(r"([HBMJ])(?:meas|field|exp|data)", base):
        kinds.append("field" if symbol[1] == "H" else "magnetization")
    if "temperature" in kinds:
        return "temperature"  # the unit C alone would be a charge
    for strong in ("index", "time", "input", "output"):
        if strong in kinds and not (strong == "index" and (by_unit or len(kinds) > 1)):
            return strong if not (strong == "time" and by_unit not in ("", "time")) else by_unit
    return by_unit or (kinds[-1] if kinds else "velocity" if base == "v" else "")


def find(table: Table, key: str | int, role: str) -> int:
    """Position of a column by name (with or without its unit, upper or lower case) or by number from 0.

    Args:
        table: the columns.
        key: name or number.
        role: of the column, for messages.

    Raises:
        DataError: there is no such column, or more than one.
    """
    count = len(table.names)
    if isinstance(key, int | np.integer) and not isinstance(key, bool):
        if -count <= key < count:
            return int(key) % count
        raise DataError(f"{table.source}: {role} column {key} does not exist; there are {count}: {table.describe()}")
    if not isinstance(key, str):
        raise DataError(f"{role} must be a column name or number, got {key!r}")
    wanted = key.strip()
    bases = [split_unit(name, table.names)[0] for name in table.names]
    lower = wanted.lower()
    spellings = (table.names, wanted), (bases, wanted), ([n.lower() for n in table.names], lower)
    for names, spelled in (*spellings, ([b.lower() for b in bases], lower)):
        hits = [k for k, name in enumerate(names) if name == spelled]
        if len(hits) > 1:
            raise DataError(
                f"{table.source}: {len(hits)} columns are called {key!r} (numbers {', '.join(map(str, hits))}); give {role} by number"
            )
        if hits:
            return hits[0]
    if re.fullmatch(r"\d+", wanted):
        return find(table, int(wanted), role)
    raise DataError(f"{table.source}: there is no column {key!r} for {role}; the columns are {table.describe()}")


def _numeric(table: Table, position: int, role: str) -> int:
    if position in table.labels:
        value = table.labels[position][0]
        raise DataError(
            f"{table.source}: column {table.names[position]!r} for {role} is text ({value!r}); the columns are {table.describe()}"
        )
    if not np.isfinite(table.columns[position]).any():
        raise DataError(f"{table.source}: column {table.names[position]!r} for {role} is empty; choose another")
    return position


def choose(
    table: Table,
    time: str | int | bool | None = None,
    input: str | int | None = None,
    output: str | int | None = None,
    taken: Sequence[int] = (),
) -> Choice:
    """Time, input and output column of a table.

    Args:
        table: the columns.
        time, input, output: names or numbers from 0; None guesses; `time=False` (or "none") reads without time.
        taken: positions of columns with another role (the column that separates curves).

    Raises:
        DataError: a column does not exist or is not numeric, or no guess is possible.
    """
    notes: list[Note] = []
    given = {
        role: _numeric(table, find(table, key, role), role)
        for role, key in (("input", input), ("output", output))
        if key is not None
    }
    if len(set(given.values())) < len(given):
        raise DataError(f"{table.source}: input and output are the same column, {table.names[given['input']]!r}")
    used = {*taken, *given.values()}
    free = [k for k in range(len(table.names)) if k not in table.labels and k not in used and not table.constant(k)]
    kinds = {k: quantity(table.names[k], table.units[k]) if table.named else "" for k in range(len(table.names))}
    no_time = time is False or (isinstance(time, str) and time.lower() == "none" and "none" not in table.names)
    if no_time:
        clock = None
    elif time is not None and not isinstance(time, bool):
        clock = _numeric(table, find(table, time, "time"), "time")
    else:
        clock = _guess_time(table, free, kinds, len(given), notes)
    if clock is not None and clock in given.values():
        raise DataError(f"{table.source}: column {table.names[clock]!r} cannot be time and input or output at once")
    free = [k for k in free if k != clock]
    if not {"input", "output"} <= given.keys():
        _guess_pair(table, free, kinds, given, clock, notes)
    for k, label in table.labels.items():
        if k not in taken and (label != label[0]).any():
            notes.append(Note(Code.LEFT_OUT, f"text column {table.names[k]!r} (such as {str(label[0])!r}) is not used"))
    return Choice(clock, given["input"], given["output"], tuple(notes))


def _counts(table: Table, position: int) -> bool:
    """Whether a column is a row number: whole numbers that go up by one from 0 or 1."""
    values = table.columns[position]
    return values[0] in (0.0, 1.0) and bool((np.diff(values) == 1.0).all())


def _guess_time(table: Table, free: list[int], kinds: dict[int, str], given: int, notes: list[Note]) -> int | None:
    named = [k for k in free if k in table.stamps] or [k for k in free if kinds[k] == "time"]
    if named:
        notes.append(Note(Code.COLUMN_CHOICE, f"time: column {named[0]}, {table.names[named[0]]!r}"))
        return named[0]
    if len(free) + given < 3:
        return None
    for k in free[:2]:
        if table.named and table.names[k] != f"column {k}":
            return None
        steps = np.diff(table.columns[k])
        if not (steps > 0).all() and ((steps < 0).any() or CoarseClock.of(table.columns[k]) is None):
            return None
        if not _counts(table, k):
            notes.append(
                Note(
                    Code.COLUMN_CHOICE,
                    f"time: column {k}, because it {'always increases' if (steps > 0).all() else 'never decreases'}",
                )
            )
            return k
        notes.append(
            Note(
                Code.LEFT_OUT,
                f"column {k} numbers the rows and is not used; if it is the time, choose --time {k} (time={k})",
            )
        )
        kinds[k] = "index"
    return None


def _guess_pair(
    table: Table, free: list[int], kinds: dict[int, str], given: dict[str, int], clock: int | None, notes: list[Note]
) -> None:
    """Fill `given` with the input and output not named."""
    if len(free) + len(given) < 2:
        beside = " beside the time" if clock is not None else ""
        raise DataError(
            f"{table.source}: a loop needs an input and an output, found {len(free) + len(given)} column(s) of "
            f"changing numbers{beside}. "
            f"The columns are {table.describe()}; name them with input= and output=, or check delimiter= and decimal="
        )
    if any(kinds[k] == "displacement" for k in free):  # v beside x is a velocity
        kinds.update({k: "velocity" for k in free if table.names[k] == "v" and kinds[k] == ""})

    def rank(k: int, order: tuple[str, ...]) -> tuple[int, int]:
        last = kinds[k] in _LAST or _same_as(table, k, clock)
        return (len(order) + 1 + last if kinds[k] not in order or last else order.index(kinds[k])), k

    if "input" not in given:
        candidates = [k for k in free if k not in given.values()]
        drive = sorted(candidates, key=lambda k: rank(k, _AS_INPUT))
        if "output" not in given and len(drive) > 1 and kinds[drive[0]] == "":
            drive = [k for k in drive if kinds[k] not in ("output", "force", "stress")] or drive
        given["input"] = drive[0]
        notes.append(_choice_note(table, "input", drive[0], kinds))
    if "output" not in given:
        order = (
            _AS_OUTPUT_OF_DRIVE
            if kinds[given["input"]] in ("input", "voltage", "field", "current", "pressure")
            else _AS_OUTPUT
        )
        candidates = [k for k in free if k != given["input"]]
        given["output"] = min(candidates, key=lambda k: rank(k, order))
        notes.append(_choice_note(table, "output", given["output"], kinds))
    pair = [re.fullmatch(r"(.*)\[\d+\]", table.names[given[role]]) for role in ("input", "output")]
    if pair[0] and pair[1] and pair[0][1] == pair[1][1] and kinds[given["input"]] == kinds[given["output"]] != "":
        raise DataError(
            f"{table.source}: every column is {pair[0][1]!r} ({kinds[given['input']]}), so input and output cannot be "
            f"guessed; give input= and output=. The columns are {table.describe()}"
        )
    others = [k for k in free if k not in given.values()]
    if others:
        shown = ", ".join(repr(table.names[k]) for k in others[:8])
        unsure = (
            "" if table.named else "; the columns have no names: set --input and --output (input=, output=) to be sure"
        )
        notes.append(Note(Code.LEFT_OUT, f"columns not used: {shown}{unsure}"))


def _same_as(table: Table, position: int, clock: int | None) -> bool:
    return clock is not None and np.array_equal(table.columns[position], table.columns[clock], equal_nan=True)


def _choice_note(table: Table, role: str, position: int, kinds: dict[int, str]) -> Note:
    reason = f"by its name or unit ({kinds[position]})" if kinds[position] else "by its position"
    return Note(Code.COLUMN_CHOICE, f"{role}: column {position}, {table.names[position]!r}, chosen {reason}")
