"""Loops whose two branches stand side by side, two outputs over one input or an input and an output of each, or below each other."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import re
from collections.abc import Sequence

import numpy as np

from hystfit.data.circulation import OPEN
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading.choice.chosen_columns import Choice
from hystfit.reading.limits import FEWEST, NEAR
from hystfit.reading.names.branch_words import FALLING, RISING
from hystfit.reading.names.column_names import is_channel
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Part, Table, below_each_other

_NEUTRAL = frozenset({"forward", "fwd"})  # the first branch, whichever way it runs
_BACK = frozenset({"backward", "bwd", "reverse", "retrace"})  # the second one, also beside a column without such a word
# Of a speed: the other branch is that of the other direction, and not the way back.
_SIGNS = frozenset({"positive", "pos"})
_SHORT = {"ch": "charge", "dch": "discharge"}
_NUMBERED = (("1", "2"), ("a", "b"), ("i", "ii"), ("+", "-"))  # branches without a direction; "1" is the first
_SIGNED = re.compile(r"(.*\w)\s*([+-])")  # B+ beside B-
_TOKEN = re.compile(r"[A-Z]+(?![a-zà-ÿ])|[A-Z]?[a-zà-ÿµ]+|\d+|[^\W\d_]+")
_OF_MATRIX = re.compile(r"\[\d+\]$")  # column of a matrix
_UNSPACED = re.compile(
    "|".join(word for word in sorted(RISING | FALLING) if not word.isascii() and ord(word[0]) > 0x3000)
)


@dataclasses.dataclass(frozen=True)
class _Pair:
    """Two columns that differ in the word of a branch: the rest of their name, and their positions, rising or first one first."""

    base: str
    columns: tuple[int, int]
    word: str
    directed: bool = True


def unfolded(table: Table) -> Table | None:
    """Branches side by side (forward and reverse, up and down, 1 and 2) are joined to one loop; None for other tables.

    The branches are named by directions (up, down; forward, reverse; loading, unloading) or numbers (1, 2), in any order and beside other
    columns. Branches that are only numbered have to meet at both ends, as two loops or two sensors do not; so have columns of other names
    where there is nothing else but the input.
    """
    if not table.named:
        return None
    table = _spelled(table)
    pairs = _pairs(table)
    if (loop := _cycles_of_own_inputs(table, pairs) or _joined(table, pairs)) is not None:
        return loop
    alike = _named_alike(table)
    if (loop := _joined(table, alike)) is None:
        return None
    first, second = (table.names[k] for k in alike[-1].columns)
    text = f"{first!r} and {second!r} meet at both ends and are read as the branches of a loop; --input and --output read one of them"
    return loop.noted(warn(Code.CURVES, text))


def _spelled(table: Table) -> Table:
    """The table with the words of the branches of a battery in full, where the names have both "ch" and "dch"."""
    words = [set(_TOKEN.findall(name.lower())) for name in table.names]
    if not all(any(word in of for of in words) for word in _SHORT):
        return table
    full = lambda name: re.sub(r"(?<![^\W_])d?ch(?![^\W_])", lambda word: _SHORT[word[0]], name)
    return dataclasses.replace(table, names=tuple(map(full, table.names)))


def _cycles_of_own_inputs(table: Table, pairs: Sequence[_Pair]) -> Table | None:
    """Loops of numbered cycles whose branches have an input and an output each, a record of each; None for other tables."""
    cycles: dict[str, list[_Pair]] = {}
    for pair in pairs:
        cycles.setdefault(" ".join(re.findall(r"\d+", pair.base)), []).append(pair)
    titles = [{re.sub(r"\d", "", pair.base).strip() for pair in of} for of in cycles.values()]
    if len(cycles) < 2 or "" in cycles or len(titles[0]) != 2 or any(title != titles[0] for title in titles):
        return None
    if not all(len(of) == 2 and all(pair.directed for pair in of) for of in cycles.values()):
        return None
    loops = [loop for of in cycles.values() if (loop := _of_own_inputs(table, of)) is not None]
    if len(loops) < len(cycles):
        return None
    names = tuple(re.sub(r"[ _.#-]*\d+$", "", name) for name in loops[0].names)
    alike = [dataclasses.replace(loop, names=names) for loop in loops]
    parts = [Part(name=f"cycle {cycle}") for cycle in cycles]
    return dataclasses.replace(below_each_other(alike, parts), metadata=table.metadata)


def _joined(table: Table, pairs: Sequence[_Pair]) -> Table | None:
    """The loop of branches in one or two pairs of columns, or of several cycles over one input; None where they are no branches."""
    apart = len({k for pair in pairs for k in pair.columns}) == 2 * len(pairs) > 0
    if not apart or not all(pair.directed for pair in pairs[2:]):
        return None
    cycles = len({re.sub(r"\d", "", pair.base).strip() for pair in pairs}) == 1  # Load 1, Unload 1, Load 2, Unload 2
    ordered = sorted(pairs, key=lambda pair: min(pair.columns))
    if cycles:
        loop = _of_one_input(table, ordered)
    else:
        loop = _of_one_input(table, ordered[:1], ordered[1:]) if all(pair.directed for pair in pairs) else None
    several = len(pairs) == 2 or (len(pairs) > 2 and not cycles and all(pair.directed for pair in pairs))
    return _of_own_inputs(table, pairs) if loop is None and several else loop


def _pairs(table: Table) -> list[_Pair]:
    """Pairs of columns of numbers whose names differ only in the word of a branch."""
    numbers = (k for k in table.positions if k not in table.labels and k not in table.stamps)
    split, found = {k: _branch(table.names[k]) for k in numbers}, []
    for (i, (base, word)), (j, (other, word2)) in itertools.combinations(split.items(), 2):
        if base != other or table.units[i] != table.units[j]:
            continue
        if (word in RISING and word2 in FALLING) or (not word and word2 in _BACK):
            found.append(_Pair(base, (i, j), word))
        elif word in FALLING and word2 in RISING:
            found.append(_Pair(base, (j, i), word2))
        elif is_channel(table.names[i]) or is_channel(table.names[j]):
            continue
        elif (word, word2) in _NUMBERED:
            found.append(_Pair(base, (i, j), word, directed=False))
        elif (word2, word) in _NUMBERED:
            found.append(_Pair(base, (j, i), word2, directed=False))
    return found


def _named_alike(table: Table) -> list[_Pair]:
    """Pairs of columns whose names differ in one word without a number, where each column belongs to a pair or is the only other one."""
    there = [k for k, column in enumerate(table.columns) if k not in table.labels and np.isfinite(column).any()]
    kinds = {k: table.quantity(k) for k in there}
    there = [k for k in there if kinds[k] not in ("time", "index")]
    words = {k: split_unit(table.names[k])[0].split() for k in there}
    found = []
    for i, j in itertools.combinations(there, 2):
        if len(words[i]) == len(words[j]) > 1 and (kinds[i], table.units[i]) == (kinds[j], table.units[j]):
            apart = [(a, b) for a, b in zip(words[i], words[j], strict=True) if a != b]
            if len(apart) == 1 and not re.search(r"\d", "".join(apart[0])):
                base = " ".join(word for word in words[i] if word != apart[0][0])
                found.append(_Pair(base, (i, j), apart[0][0], directed=False))
    used = [k for pair in found for k in pair.columns]
    return found if len({*used}) == len(used) and len(there) - len(used) == 2 - len(found) else []


@functools.lru_cache(maxsize=4096)
def _branch(name: str) -> tuple[str, str]:
    """A name without its unit and the word of a branch, in lower case, and that word; "" without one."""
    name, column = _OF_MATRIX.sub("", name), "".join(_OF_MATRIX.findall(name))
    if column:
        base, word = _branch(name)
        return base + column, word
    spaced = _UNSPACED.sub(r" \g<0> ", split_unit(name)[0])
    if signed := _SIGNED.fullmatch(spaced.strip().replace("−", "-")):
        return signed[1].lower(), signed[2]
    tokens = [token.lower() for token in _TOKEN.findall(spaced)]
    numbers = {word for pair in _NUMBERED for word in pair}
    place = next((k for k, token in enumerate(tokens) if token in RISING | FALLING), None)
    if place is None and len(tokens) > 1 and tokens[-1] in numbers:
        place = len(tokens) - 1
    if place is None:
        return _glued(tokens)
    return " ".join(tokens[:place] + tokens[place + 1 :]), tokens[place]


def _glued(tokens: Sequence[str]) -> tuple[str, str]:
    """The same for a word at the end of another one, as in "Hup" and "Fielddec"."""
    name = " ".join(tokens)
    word = max((word for word in RISING | FALLING if name.endswith(word) and name != word), key=len, default="")
    return name.removesuffix(word).strip(), word


def _of_own_inputs(table: Table, pairs: Sequence[_Pair]) -> Table | None:
    """The loop of branches with an input, an output and maybe more columns each, these in the order of the file."""
    pairs = sorted(pairs, key=lambda pair: min(pair.columns))
    rows = [
        np.flatnonzero(np.all([np.isfinite(table.columns[k]) for k in branch], axis=0))
        for branch in zip(*(pair.columns for pair in pairs), strict=True)
    ]
    if min(map(len, rows)) < FEWEST:
        return None
    values = lambda branch, kept: np.column_stack([table.columns[pair.columns[branch]][kept] for pair in pairs])
    first, second = (values(branch, kept) for branch, kept in enumerate(rows))
    if pairs[0].word not in _NEUTRAL and pairs[0].directed and first[0, 0] > first[-1, 0]:
        first, rows[0] = first[::-1], rows[0][::-1]
    for side, pair in enumerate(pairs):
        # A battery discharges that with which it was charged, and both are counted from zero.
        kind = table.quantity(pair.columns[0])
        ends = [(abs(branch[0, side]), branch[-1, side]) for branch in (first, second)]
        if pair.directed and kind in ("state of charge", "charge") and all(a <= NEAR * b for a, b in ends):
            second[:, side] = first[-1, side] - second[:, side]
    apart = [_apart(first[:, :2], second[:, :2], order) for order in (1, -1)]  # not of a leakage current, say
    if not pairs[0].directed and (min(apart) > 2 * NEAR or not (_is_branch(first[:, 0]) and _is_branch(second[:, 0]))):
        return None
    order = 1 if apart[0] <= apart[1] else -1
    loop = np.concatenate([first, second[::order]])
    return _table(
        table, [pair.columns[0] for pair in pairs], [pair.word for pair in pairs], loop, [rows[0], rows[1][::order]]
    )


def _is_branch(u: np.ndarray) -> bool:
    """Whether an input ends far from where it begins, as that of a whole loop does not."""
    return abs(u[-1] - u[0]) > 0.5 * np.ptp(u)


def _apart(first: np.ndarray, second: np.ndarray, order: int) -> float:
    """Largest distance of the ends of two branches, run one after the other, over the ranges; columns are input and output."""
    second = second[::order]
    ends = np.abs(np.stack([second[0] - first[-1], second[-1] - first[0]]))
    return float((ends / np.maximum(np.ptp(np.concatenate([first, second]), axis=0), np.finfo(float).tiny)).max())


def _of_one_input(table: Table, pairs: Sequence[_Pair], others: Sequence[_Pair] = ()) -> Table | None:
    """The loop of two outputs over one input, which runs once from end to end; several pairs are cycles, in their order.

    Args:
        table: with the input beside the pairs.
        pairs: the branches of one output.
        others: those of further outputs, which become columns of the loop.
    """
    columns = [k for pair in pairs for k in pair.columns]
    taken = {*columns, *(k for pair in others for k in pair.columns)}
    drives = [k for k in table.positions if k not in taken and _runs_once(table, k)]
    if not drives:
        return None
    heated = lambda k: table.quantity(k) == "temperature"  # drifts beside a field or a force
    drive = min(drives, key=lambda k: (heated(k), k))
    u, outputs = table.columns[drive], [table.columns[k] for k in columns]
    if not pairs[0].directed:
        if table.counts(drive):  # two gauges over the numbers of the rows
            return None
        outputs = _numbered_branches(u, *outputs, over=_is_force_loop(table, drive, columns[0]))
        if outputs is None:
            return None
    if len(pairs) == 1 and not others and (sides := _two_directions(table, drive, pairs[0])) is not None:
        return sides
    order = np.argsort(u, kind="stable")
    ways = itertools.cycle([order, order[::-1]])
    rows = [way[np.isfinite(u + y)[way]] for way, y in zip(ways, outputs, strict=False)]
    if min(map(len, rows)) < FEWEST:
        return None
    beside = [[table.columns[k] for k in pair.columns] for pair in others]
    loop = [
        np.concatenate([y[k] for y, k in zip(ways, rows, strict=True)]) for ways in ([u] * len(rows), outputs, *beside)
    ]
    positions, words = (
        [columns[0], *(pair.columns[0] for pair in others)],
        [pairs[0].word, *(pair.word for pair in others)],
    )
    joined = _table(table, [drive, *positions], ["", *words], np.column_stack(loop), rows)
    return joined if others else dataclasses.replace(joined, pair=(0, 1))


def _two_directions(table: Table, drive: int, pair: _Pair) -> Table | None:
    """The curve of an output over a speed in both directions, of which a table states the size; None for other branches."""
    u = table.columns[drive]
    if pair.word not in _SIGNS or table.quantity(drive) != "velocity" or np.nanmin(u) < 0:
        return None
    rows = [np.flatnonzero(np.isfinite(u + table.columns[k])) for k in pair.columns]
    rows = [kept[np.argsort(u[kept], kind="stable")] for kept in rows]
    forth, back = (
        np.column_stack([u[kept], table.columns[k][kept]]) for k, kept in zip(pair.columns, rows, strict=True)
    )
    curve = np.concatenate([(back * [-1.0, 1.0])[::-1], forth])
    joined = _table(table, [drive, pair.columns[0]], ["", pair.word], curve, [rows[1][::-1], rows[0]])
    named = " and ".join(repr(table.names[k]) for k in pair.columns)
    text = f"{named} are of both directions of {table.names[drive]!r}: they are joined to a curve over speeds of both signs"
    notes = (*table.notes, Note(Code.CURVES, text))
    return dataclasses.replace(joined, pair=(0, 1), notes=notes)


def _is_force_loop(table: Table, drive: int, output: int) -> bool:
    """Whether the output resists the input, so that its rising branch lies above the falling one."""
    kinds = [table.quantity(k) for k in (drive, output)]
    return kinds[0] in ("displacement", "strain") and kinds[1] in ("force", "stress")


def _numbered_branches(u: np.ndarray, one: np.ndarray, other: np.ndarray, *, over: bool) -> list[np.ndarray] | None:
    """The rising branch and the falling one; None where the outputs do not meet at both ends, or are the same.

    Args:
        over: whether the rising branch lies above the other.
    """
    both = np.flatnonzero(np.isfinite(u + one + other))
    if both.size < FEWEST:
        return None
    size, gap = np.ptp(np.concatenate([one[both], other[both]])), (one - other)[both]
    if max(abs(gap[0]), abs(gap[-1])) > 2 * NEAR * size or np.abs(gap).max() < OPEN * size:
        return None
    return [one, other] if (gap.mean() > 0) == over else [other, one]


def _runs_once(table: Table, position: int) -> bool:
    """Whether a column may be the input of two branches: it runs from one end to the other once, and is neither time nor number."""
    if position in table.labels or position in table.stamps:
        return False
    if table.quantity(position) in ("index", "time"):
        return False
    steps = np.diff(table.columns[position][np.isfinite(table.columns[position])])
    return steps.size >= FEWEST - 1 and bool((steps > 0).all() or (steps < 0).all())


def _table(
    table: Table, positions: Sequence[int], words: Sequence[str], loop: np.ndarray, rows: Sequence[np.ndarray]
) -> Table:
    """The loop as a table, its columns named as those of the first branch without its word.

    Args:
        loop: input and outputs, shape (samples, columns).
        rows: those of each branch.
    """
    names = [_without(table.names[k], word) for k, word in zip(positions, words, strict=True)]
    many = f"the {len(rows)} branches of {len(rows) // 2} cycles" if len(rows) > 2 else "the two branches of a loop"
    text = f"{many} stand side by side: they are joined to one loop of {' and '.join(map(repr, names))}"
    zeros = np.zeros(len(loop), dtype=int)
    return dataclasses.replace(
        table.select(positions).take(np.concatenate(rows)),
        names=tuple(names),
        units=tuple(table.units[k] or split_unit(name)[1] for k, name in zip(positions, names, strict=True)),
        columns=tuple(loop.T),
        curve=zeros,
        section=zeros,
    ).noted(Note(Code.CURVES, text))


def _without(name: str, word: str) -> str:
    """A name without the word of a branch, where it has one beside others."""
    if not word:
        return name
    whole = next(
        (token.start() for token in _TOKEN.finditer(name) if token[0].lower() == word), 0
    )  # "Lauf" ends with "auf"
    tail = re.sub(rf"[ _.-]?{word}(?![a-z])", "", name[max(whole - 1, 0) :], count=1, flags=re.IGNORECASE)
    rest = (name[: max(whole - 1, 0)] + tail).strip(" _.-")
    return name if not rest or rest.isdigit() or rest.startswith(("(", "[")) else rest


def mirrored(table: Table, choice: Choice, pieces: Sequence[np.ndarray]) -> np.ndarray | None:
    """The rows of a loop of which both branches are listed the same way, the falling one first; None for other curves.

    Each branch is the other one mirrored through the origin, which two curves of one direction are not. The falling branch is the upper
    one, or the lower one of a force, which leads.

    Args:
        pieces: rows of each of two curves.
    """
    u, y = table.columns[choice.input], table.columns[choice.output]
    pieces = [piece if u[piece[-1]] > u[piece[0]] else piece[::-1] for piece in pieces]
    reach = min(min(-float(u[piece[0]]), float(u[piece[-1]])) for piece in pieces)
    if not reach > 0 or not all((np.diff(u[piece]) >= 0).all() for piece in pieces):
        return None
    at = np.linspace(-reach, reach, max(piece.size for piece in pieces))
    first, second = (np.interp(at, u[piece], y[piece]) for piece in pieces)
    apart, widest = np.sqrt(np.mean((first + second[::-1]) ** 2)), np.abs(first - second).max()
    if not (apart < 2 * NEAR * widest and widest > OPEN * np.ptp([first, second])):
        return None
    leads = table.quantity(choice.output) in ("force", "stress")
    falling, rising = pieces if (np.mean(first - second) > 0) != leads else pieces[::-1]
    return np.concatenate([falling[::-1], rising])
