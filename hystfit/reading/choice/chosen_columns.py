"""Which column is time, input and output: by name, by number from 0, or guessed from names, units and order."""

from __future__ import annotations

import dataclasses
import itertools
import re
import shlex
import unicodedata
from collections.abc import Mapping, Sequence

import numpy as np

from hystfit.data.circulation import OPEN, circulation
from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading.arrangements.specimens import names_objects
from hystfit.reading.choice.pair_score import TIE, Reading, readings
from hystfit.reading.choice.quantities_by_others import tell_by_others
from hystfit.reading.choice.time_column import guess_time, is_clock
from hystfit.reading.limits import OF_RECORD, RARE
from hystfit.reading.names.branch_words import words_of
from hystfit.reading.names.column_names import column_role
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Table
from hystfit.reading.table.signal_evidence import computed, explained, overtones, proportional, rounded, same_loop

_MANY_SIGNALS = (
    30  # columns without names above which they are likely samples of loops: instruments have fewer channels
)
_LEAST, _MOST = frozenset({"min", "minimum"}), frozenset({"max", "maximum"})
_MOST_RESULTS = 200  # rows of a table of results, beyond which a name for each is rather a stamp or an identity


@dataclasses.dataclass(frozen=True)
class Choice:
    """Positions of the time (None: no time), input and output columns, a note for every guess, and whether the user wants no time."""

    time: int | None
    input: int
    output: int
    notes: tuple[Note, ...]
    untimed: bool = False


def _composed(name: str) -> str:
    """A name in one of the forms that look alike: letters with their accents composed, one micro sign."""
    return unicodedata.normalize("NFC", name).replace("\u00b5", "\u03bc").strip()


def find(table: Table, key: str | int, role: str) -> int:
    """Position of a column by name (with or without its unit, upper or lower case) or by number from 0."""
    count = len(table.names)
    if isinstance(key, int | np.integer) and not isinstance(key, bool):
        if -count <= key < count:
            return int(key) % count
        raise DataError(f"{table.source}: {role} column {key} does not exist; there are {count}: {table.describe()}")
    if not isinstance(key, str):
        raise DataError(f"{role} must be a column name or number, got {key!r}")
    wanted = _composed(key)
    stored = [_composed(name) for name in table.names]
    bases = [split_unit(name, stored)[0] for name in stored]
    for change, names in itertools.product((str, str.lower), (stored, bases)):
        hits = [k for k, name in enumerate(names) if change(name) == change(wanted)]
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
    if position in table.stamps and role != "time":
        raise DataError(
            f"{table.source}: column {table.names[position]!r} for {role} holds time stamps; the columns are {table.describe()}"
        )
    if position in table.labels:
        value = table.labels[position][0]
        raise DataError(
            f"{table.source}: column {table.names[position]!r} for {role} is text ({str(value)!r}); the columns are {table.describe()}"
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
        time, input, output: names or numbers from 0; None guesses; `time=False` (or "none") reads without time.
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
    free = [k for k in table.positions if k not in table.labels and k not in used and not table.constant(k)]
    filled = {k: np.isfinite(table.columns[k]).mean() for k in free}
    free = [k for k in free if filled[k] > RARE * max(filled.values())]
    known = lambda k: table.named or table.units[k]  # columns without names may have units
    kinds = {k: table.quantity(k) if known(k) else "" for k in table.positions}
    if (
        "Y_value" in table.names
    ):  # a digitized plot: X_value is no time, as it is in LabVIEW, and pixels are no quantity
        kinds.update({k: "" for k in free if table.names[k] == "X_value"})
        kinds.update({k: "index" for k in free if "pixel" in table.names[k].lower()})
    no_time = time is False or (isinstance(time, str) and time.lower() == "none" and "none" not in table.names)
    if no_time:
        clock = None
    elif time is not None and not isinstance(time, bool):
        clock = _numeric(table, find(table, time, "time"), "time")
    else:
        clock = guess_time(table, free, kinds, len(given), notes)
    if clock is not None and clock in given.values():
        raise DataError(f"{table.source}: column {table.names[clock]!r} cannot be time and input or output at once")
    free = [k for k in free if k != clock and k not in table.stamps]
    kinds.update({k: "" for k in free if clock is not None and kinds[k] == "time" and not is_clock(table, k)})  # T_in
    numbers = lambda k: table.names[k] == f"column {k}" and table.counts(k)
    if table.named and clock is not None:  # that which a program wrote before the columns that it had names for
        free = [k for k in free if not numbers(k)]
    if not {"input", "output"} <= given.keys():
        _guess_pair(table, free, kinds, given, clock, notes)
    for k, label in table.labels.items():
        changes = label[1:] != label[:-1]
        if table.part is not None:  # a column that tells records apart is used
            changes &= np.diff(table.part) == 0
        if k not in taken and changes.any():
            notes.append(Note(Code.LEFT_OUT, f"text column {table.names[k]!r} (such as {str(label[0])!r}) is not used"))
    notes += [warn(Code.LEFT_OUT, text) for text in _of_results(table).values()]
    return Choice(clock, given["input"], given["output"], tuple(notes), no_time)


def _check_results(table: Table, given: Mapping[str, int]) -> None:
    """Refuse a table with a row for each specimen, as the samples of no loop have names of their own."""
    if text := next((text for title, text in _of_results(table).items() if names_objects(title)), ""):
        i, o = (_as_option(table, given[role]) for role in ("input", "output"))
        raise DataError(
            f"{table.source}: {text}; if the rows are the samples of a loop, --input {i} --output {o} reads them "
            f"(input=, output=). The columns are {table.describe()}"
        )


def _of_results(table: Table) -> dict[str, str]:
    """Remarks on columns of text that name every row, as that of the specimens in a table of results, by their titles."""
    if table.rows > _MOST_RESULTS:
        return {}
    titles = [table.names[k] for k, label in table.labels.items() if len({*map(str, label)}) == table.rows]
    return {title: f"every row has a {title!r} of its own: a table of results has no loop" for title in titles}


def _guess_pair(
    table: Table, free: list[int], kinds: dict[int, str], given: dict[str, int], clock: int | None, notes: list[Note]
) -> None:
    """Fill `given` with the input and output not named."""
    free = _without_extremes(table, free, notes)
    if not given:
        _check_rows_of_samples(table, free)
    if len(free) + len(given) < 2:
        raise _too_few(table, free, given, clock)
    if not table.named:
        free = _without_copies(table, free, given, notes)
    tell_by_others(table, free, kinds, many=len(free) + len(given) > 2)
    for k in free:  # a copy of the time is one more time
        if clock is not None and np.array_equal(table.columns[k], table.columns[clock], equal_nan=True):
            kinds[k] = "time"
    ordered = readings(table, free, kinds, given, named=table.named)
    best = ordered[0]
    alike = _one_quantity(table, free, kinds, best) if not given else set()
    if kinds[best.input] == "index" and not given:  # a number of each result, and no input
        others = [one for one in ordered if "index" not in (kinds[one.input], kinds[one.output])]
        raise _undecided(table, *others[:2]) if len(others) > 1 else _too_few(table, [best.output], given, clock)
    pair = best.input, best.output
    if (
        len(free) == 2 and not given and table.rows >= OF_RECORD
    ):  # beside the numbers of the rows, the other signal is text
        if not table.units[best.output] and table.counts(best.output):
            raise _too_few(table, [best.input], given, clock)
    if clock is not None and not given and "time" in (kinds[k] for k in pair):  # one more time
        raise _too_few(table, [k for k in pair if kinds[k] != "time"], given, clock)
    open_ = len(free) > 2 and not (given or kinds[best.input] or kinds[best.output]) and best.points < 0
    near = [
        reading
        for reading in ordered[1:]
        if best.points - reading.points < TIE
        or {reading.input, reading.output} <= alike
        or (open_ and not (kinds[reading.input] or kinds[reading.output]))
    ]
    if other := next((reading for reading in near if not _same_loop(table, best, reading)), None):
        equal = [best, other, *(one for one in near if one is not other)]
        apart = [one for one in equal if not proportional(table.columns[one.input], table.columns[one.output])]
        raise _undecided(table, *_clearest(table, apart if len(apart) > 1 else equal)[:2])
    nameless = not (table.named or given or (kinds[best.input] and kinds[best.output]))
    told = any(column_role(table.names[k]) for k in pair) or kinds[best.input] != kinds[best.output]
    one_kind = table.named and not (given or told)
    for role, position in (("input", best.input), ("output", best.output)):
        if role not in given:
            given[role] = position
            notes.append(_choice_note(table, role, position, kinds, one_kind=one_kind))
    if nameless or one_kind:  # nothing but signals and the order of the columns tells which drives the other
        i, o = (_key(table, k) for k in pair)
        swapped = f"if column {_as_option(table, best.output)} drives the device, set input='{o}' and output='{i}'"
        notes[-1] = dataclasses.replace(notes[-1], text=f"{notes[-1].text}; {swapped}")
    if nameless:
        driven = table.columns[best.input]
        if _runs_both_ways(driven) and circulation(driven, table.columns[best.output]) < -OPEN:
            text = f"the loop runs clockwise, as that of a force: are the columns exchanged? {swapped}"
            notes.append(warn(Code.COLUMN_CHOICE, text))
    _check_results(table, given)
    _check_matrix(table, kinds, given)
    if others := [k for k in free if k not in given.values()]:
        shown = ", ".join(repr(table.names[k]) for k in others[:8])
        unsure = (
            "" if table.named else "; the columns have no names: set --input and --output (input=, output=) to be sure"
        )
        kind, unit = kinds[best.output], table.units[best.output]
        alike = [k for k in others if table.named and kinds[k] == kind != "" and table.units[k] == unit]
        more = f"; --output {_as_option(table, alike[0])} (output=) reads another {kind}" if alike else ""
        notes.append(Note(Code.LEFT_OUT, f"columns not used: {shown}{more}{unsure}"))


def _runs_both_ways(values: np.ndarray) -> bool:
    """Whether a column rises for more than one row somewhere, and falls so elsewhere: that of times may start again."""
    steps = np.diff(values)
    return all(((way * steps[1:] > 0) & (way * steps[:-1] > 0)).any() for way in (1, -1))


def _one_quantity(table: Table, free: Sequence[int], kinds: Mapping[int, str], best: Reading) -> set[int]:
    """Three or more columns of the quantity of both columns of a reading, such as coordinates of a tip; none where names tell them apart.

    Which of them drives another is open, unless they are the columns of a matrix, which are samples of loops; of voltages and currents the
    waves tell.
    """
    roles = any(column_role(table.names[k]) for k in (best.input, best.output))
    alike = {k for k in free if kinds[k] == kinds[best.input] == kinds[best.output] != ""}
    matrix = table.names[best.input].endswith("]")
    electric = kinds[best.input] in ("voltage", "current")
    return alike if len(alike) > 2 and not (roles or matrix or electric) else set()


def _too_few(table: Table, free: list[int], given: Mapping[str, int], clock: int | None) -> DataError:
    """The error of a table with fewer than two changing columns."""
    beside = " beside the time" if clock is not None else ""
    remedy = "name them with input= and output=, or check delimiter= and decimal="
    if len(free) == 1:
        remedy = f"{remedy}; {half_of_pair(table.source)}" if table.labels else half_of_pair(table.source)
    return DataError(
        f"{table.source}: a loop needs an input and an output, found {len(free) + len(given)} column(s) of changing numbers{beside}. "
        f"The columns are {table.describe()}; {remedy}"
    )


def _check_matrix(table: Table, kinds: Mapping[int, str], given: Mapping[str, int]) -> None:
    """Refuse two columns of one matrix that is all of one quantity."""
    pair = [re.fullmatch(r"(.*)\[\d+\]", table.names[given[role]]) for role in ("input", "output")]
    if pair[0] and pair[1] and pair[0][1] == pair[1][1] and kinds[given["input"]] == kinds[given["output"]] != "":
        raise DataError(
            f"{table.source}: every column is {pair[0][1]!r} ({kinds[given['input']]}), so input and output cannot be "
            f"guessed: name them with input= and output=, or give the file of the other quantity too (u.mat+y.mat). The columns are "
            f"{table.describe()}"
        )


def _check_rows_of_samples(table: Table, free: Sequence[int]) -> None:
    """Refuse a matrix without names whose rows are signals, as their numbers change less from column to column than from row to row."""
    if table.named or len(free) <= _MANY_SIGNALS:
        return
    values = np.column_stack([table.columns[k] for k in free])
    along, across = (float(np.nanmean(np.abs(np.diff(values, axis=axis)))) for axis in (1, 0))
    if along < across:
        raise DataError(
            f"{table.source}: each of the {table.rows} rows holds {len(table.names)} samples of one signal; a loop needs an input and an "
            "output; if they are in a file each, INPUT_FILE+OUTPUT_FILE reads both"
        )


def _same_loop(table: Table, one: Reading, other: Reading) -> bool:
    """Whether two readings differ by the scale of their columns, as those of a moment and of the moment per mass, or by a straight line."""
    columns = table.columns
    if one.input != other.input:
        pairs = ((one.input, other.input), (one.output, other.output))
        return all(a == b or proportional(columns[a], columns[b]) for a, b in pairs)
    outputs = columns[one.output], columns[other.output]
    return proportional(*outputs) or same_loop(columns[one.input], *outputs)


def _clearest(table: Table, equal: Sequence[Reading]) -> list[Reading]:
    """Equally likely readings; of columns without names first a clean wave and the output that it explains, and then the two exchanged."""
    if table.named:
        return [*equal]
    columns = table.columns
    power = lambda one: overtones(columns[one.input]) - explained(columns[one.input], columns[one.output], table.curve)
    first = min(equal, key=power)
    swapped = [one for one in equal if (one.input, one.output) == (first.output, first.input)]
    return [first, *swapped, *(one for one in equal if not _same_loop(table, first, one))]


def _undecided(table: Table, *equal: Reading) -> DataError:
    """The question that remains where two readings are equally likely."""
    shown = []
    for reading in equal:
        i, o = (_as_option(table, k) for k in (reading.input, reading.output))
        shown.append(f"--input {i} --output {o}")
    many = not table.named and len(table.names) > _MANY_SIGNALS
    apart = "; if the outputs are in a file of their own, INPUT_FILE+OUTPUT_FILE reads both" if many else ""
    apart += "".join(f"; {text}" for text in [*_of_results(table).values()][:1])
    return DataError(
        f"{table.source}: nothing in the file tells which columns are the input and the output; choose, such as {shown[0]} or "
        f"{shown[1]} (input=, output=){apart}. The columns are {table.describe()}"
    )


def _key(table: Table, position: int) -> str:
    """A column by its name, where only it has that and it needs no escapes, else by its number."""
    name = table.names[position]
    return name if table.named and name and table.names.count(name) == 1 and "'" not in name else str(position)


def _as_option(table: Table, position: int) -> str:
    """A column as it is named at the shell."""
    return shlex.quote(_key(table, position))


def _without_extremes(table: Table, free: list[int], notes: list[Note]) -> list[int]:
    """The columns without the extremes of the readings that each row sums up, and one alone of their mean and the readings."""
    columns, words = table.columns, {k: words_of(split_unit(table.names[k])[0]) for k in free}
    for low, high in itertools.product(*([k for k in free if words[k] & ends] for ends in (_LEAST, _MOST))):
        if words[low] - _LEAST != words[high] - _MOST:
            continue
        ordered = lambda k, low=low, high=high: np.diff([columns[low], columns[k], columns[high]], axis=0).min() >= 0
        alike = [k for k in free if k not in (low, high) and table.units[k] == table.units[low] == table.units[high]]
        if within := [k for k in alike if ordered(k)]:
            left = {low, high, *within[1:]}
            shown = ", ".join(repr(table.names[k]) for k in sorted(left))
            notes.append(Note(Code.LEFT_OUT, f"{shown}: extremes and means of each row, not used"))
            return [k for k in free if k not in left and not table.counts(k)]  # the readings are numbered
    return free


def _without_copies(table: Table, free: list[int], given: dict[str, int], notes: list[Note]) -> list[int]:
    """The columns that repeat no earlier one, with whichever sign; of two computed from each other, the one of more digits."""
    kept: list[int] = []
    for k in free:
        source = next((j for j in (*given.values(), *kept) if _repeats(table.columns[j], table.columns[k])), None)
        if source is None:
            kept.append(k)
        else:
            notes.append(Note(Code.LEFT_OUT, f"column {k} repeats column {source} and is not used"))
    if len(kept) + len(given) < 2:
        raise DataError(
            f"{table.source}: the columns {', '.join(map(str, free))} are one signal, of equal or opposite sign; a loop needs an input and "
            f"an output; {half_of_pair(table.source)}"
        )
    for k in [*kept]:
        alike = lambda j, k=k: any(same(table.columns[j], table.columns[k]) for same in (computed, rounded))
        earlier = (j for j in (*given.values(), *kept) if j < k and alike(j))
        if len(kept) + len(given) > 2 and (source := next(earlier, None)) is not None:
            levels = [np.unique(table.columns[j]).size for j in (source, k)]
            coarse, fine = (source, k) if source in kept and levels[0] < levels[1] else (k, source)
            kept.remove(coarse)
            notes.append(Note(Code.LEFT_OUT, f"column {coarse} is column {fine} in another unit and is not used"))
    return kept


def half_of_pair(own: str) -> str:
    """The remedy for a file of one signal: it may be half of a pair."""
    return f"if the other one is in a file of its own, INPUT_FILE+{own} or {own}+OUTPUT_FILE reads both"


def _repeats(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether `other` has the very values of `one`, or their opposites, at most samples where that moves."""
    moves = np.diff(one, prepend=one[0]) != 0
    return bool(moves.any() and max(np.mean(one[moves] == sign * other[moves]) for sign in (1, -1)) > 0.5)


def _choice_note(table: Table, role: str, position: int, kinds: dict[int, str], *, one_kind: bool) -> Note:
    meaning = kinds[position] or (column_role(table.names[position]) if table.named else "")
    reason = f"by its name or unit ({meaning})" if meaning else "by its position"
    if one_kind:
        both = f", as both are of one quantity ({meaning})" if meaning else ""
        reason = f"by its signal and position{both}"
    return Note(Code.COLUMN_CHOICE, f"{role}: column {position}, {table.names[position]!r}, chosen {reason}")
