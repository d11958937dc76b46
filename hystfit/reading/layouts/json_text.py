"""JSON: arrays of numbers by name, lists of records, lists of rows, tables of columns and data; also one record in a line."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.params.units import quantity
from hystfit.reading.files.file_bytes import FileBytes
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.layouts.array_table import table_of_arrays
from hystfit.reading.limits import DEEPEST, FEWEST, LONGEST
from hystfit.reading.names.branch_words import words_of
from hystfit.reading.names.column_names import column_quantity
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Part, Table, below_each_other
from hystfit.reading.table.signal_evidence import meet
from hystfit.reading.text.header import MOST_METADATA
from hystfit.reading.text.stated_interval import interval_of
from hystfit.reading.text.stated_results import result_of
from hystfit.reading.text.stated_units import unit_key

_LABELS, _UNITS = ("label", "name", "title"), ("unit", "units")  # keys of a mapping that describes a column
_FEWEST = 2  # numbers of an array that is a column
_OF_VALUES = frozenset(
    {"data", "values", "samples", "value"}
)  # names of the numbers of a column that has a name of its own
_STEPS = frozenset("cycle cycles step steps segment segments branch branches half halves".split())


def read_json(text: TextFile) -> Table | None:
    """JSON: arrays by name (nested names joined by dots), records, rows, columns and data; scalars beside them are metadata."""
    start = text.content.lstrip()[:1]
    if not start or start not in "[{":
        return None
    try:
        content, cut = _parsed(text.content)
    except (ValueError, RecursionError) as error:
        if start == "[" and not isinstance(error, RecursionError):
            return None  # text that begins with a section such as [Header]
        raise DataError(f"{text.source} begins as JSON and is not: {error}; write it again") from error
    table = table_of_tree(content, text, Note(Code.FILE_FORMAT, "JSON"))
    return table.noted(warn(Code.LEFT_OUT, "left out: the last line, which ends within its JSON")) if cut else table


def table_of_tree(content: Any, file: TextFile | FileBytes, note: Note) -> Table:
    """The records in lists and mappings within each other, as JSON has them and the structures of MATLAB.

    Raises:
        DataError: there are no arrays of numbers.
    """
    parts = _as_channels(_parts(_columnar(content)))
    if not parts:
        raise DataError(f"{file.source} holds no arrays of numbers; write each column as a list under its name")
    units = {*_unit_texts(content)}
    tables = [_table(file, _with_units(arrays, units), note) for arrays, _, _ in parts]
    described = [_part(name, scalars) for _, name, scalars in parts]
    if len(parts) > 1 and len({*(part.name for part in described), ""}) <= len(parts):
        names = [f"record={k}" for k in range(len(parts))]
        for key in reversed([*parts[0][2]]):  # the first setting that tells them apart, as in "specimen": "W1"
            told = [scalars.get(key) for _, _, scalars in parts]
            names = told if len({*told}) == len(told) and all(isinstance(one, str) for one in told) else names
        described = [dataclasses.replace(part, name=name) for part, name in zip(described, names, strict=True)]
    intervals = {interval_of({**_scalars(content), **scalars}) for *_, scalars in parts}
    return dataclasses.replace(
        tables[0] if len(tables) == 1 else below_each_other(tables, described),
        metadata=described[0].metadata if len(parts) == 1 else {},
        parts=tuple(described),
        interval=intervals.pop() if len(intervals) == 1 else None,
    )


def _scalars(content: Any) -> dict[str, Any]:
    """The scalars beside the records of a file, which are those of all of them."""
    return (
        {key: item for key, item in content.items() if not isinstance(item, list | Mapping)}
        if isinstance(content, Mapping)
        else {}
    )


def _parsed(content: str) -> tuple[Any, bool]:
    """The value of a JSON text, the list of the values of its lines where each is one; and whether the last line is cut off.

    A program that is stopped leaves its last line unfinished.
    """
    try:
        return json.loads(content), False
    except ValueError:
        lines = [line for line in content.splitlines() if line.strip()]
        if len(lines) < 2:
            raise
        values = [json.loads(line) for line in lines[:-1]]
        try:
            return [*values, json.loads(lines[-1])], False
        except ValueError:
            if len(values) < FEWEST:
                raise
            return values, True


def _columnar(value: Any, depth: int = 0) -> Any:
    """The value with records and rows turned into named columns, at every level."""
    if depth > DEEPEST:
        raise DataError(f"the JSON is nested more than {DEEPEST} times; write each column as a list under its name")
    if isinstance(value, Mapping):
        if rows := _rows_of_columns(value):
            return dict(zip(map(_title, value["columns"]), map(list, zip(*rows, strict=True)), strict=True))
        if len(value) >= _FEWEST and all(key.isdigit() for key in value):  # rows by their number, as pandas writes them
            return _columnar(list(value.values()), depth + 1)
        return {key: _columnar(item, depth + 1) for key, item in value.items()}
    if isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
        flat = [_flat(row) for row in value]
        if any(isinstance(item, list | Mapping) for row in flat for item in row.values()):
            return [_columnar(row, depth + 1) for row in value]
        value = flat
        names = dict.fromkeys(name for row in value for name in row)
        return {name: [row.get(name) for row in value] for name in names}
    if isinstance(value, list) and value and all(isinstance(item, list) for item in value):
        widths = {len(item) for item in value}
        if len(widths) == 1 and not any(isinstance(cell, list | Mapping) for row in value for cell in row):
            return _of_rows(value)
    return value


def _rows_of_columns(value: Mapping[str, Any]) -> list[list[Any]]:
    """The rows beside a list "columns" of their names, whatever they are called ("data", "values"); none without such a list."""
    columns = value.get("columns")
    if not isinstance(columns, list):
        return []
    fits = lambda row: isinstance(row, list) and len(row) == len(columns)
    lists = [item for key, item in value.items() if key != "columns" and isinstance(item, list) and item]
    found = [item for item in lists if all(map(fits, item))]
    return found[0] if len(found) == 1 else []


def _title(column: Any) -> str:
    """The name of a column with its unit, where a mapping describes it."""
    described = column if isinstance(column, Mapping) else {"name": column}
    label, unit = (next((described[key] for key in keys if described.get(key)), "") for keys in (_LABELS, _UNITS))
    return f"{label} [{unit}]" if unit else str(label)


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """A record with the scalars of a record within it in its place, as those of the only gas in each point of an isotherm."""
    flat: dict[str, Any] = {}
    for key, item in row.items():
        inner = item[0] if isinstance(item, list) and len(item) == 1 else item
        flat |= (
            {name: one for name, one in inner.items() if name not in row} if isinstance(inner, Mapping) else {key: item}
        )
    return flat


def _of_rows(rows: list[list[Any]]) -> dict[str, list[Any]]:
    """Columns of a list of rows, or of a list of columns, by the first row where that holds names."""
    named = all(isinstance(cell, str) for cell in rows[0]) and len(rows) > 1
    names, rows = (rows[0], rows[1:]) if named else ([f"column {k}" for k in range(len(rows[0]))], rows)
    if not named and len(rows) < len(rows[0]):  # each list is a column
        return {f"column {k}": row for k, row in enumerate(rows)}
    return dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))


_Record = tuple[dict[str, np.ndarray], str, dict[str, Any]]  # arrays, name and scalars


def _parts(value: Any) -> list[_Record]:
    """Arrays, name and scalars of each record; one record unless items of a list, or of a mapping, have arrays of the same names."""
    items = [("", item) for item in value] if isinstance(value, list) else []
    listed, lists = [], {}
    if isinstance(value, Mapping):
        items = [(key, item) for key, item in value.items() if isinstance(item, Mapping)]
        holds_records = lambda one: isinstance(one, list) and any(isinstance(row, Mapping) for row in one)
        lists = {key: one for key, one in value.items() if holds_records(one)}
        listed = [("", row) for rows in lists.values() for row in rows] if len(lists) == 1 else []
    leaves, fewest = _records(items), 2
    if not leaves:
        leaves, fewest = _records(listed), 1  # a list of one record is a record
    if len(leaves) >= fewest and len({tuple(sorted(arrays)) for _, arrays, _ in leaves}) == 1:
        return _joined([(arrays, name, scalars) for name, arrays, scalars in leaves], " ".join(map(str, lists)))
    arrays, scalars = _leaves(value if isinstance(value, Mapping) else dict(enumerate(value)) if value else {})
    return [(arrays, "", scalars)] if arrays else []


def _joined(parts: list[_Record], title: str) -> list[_Record]:
    """The cycles or steps of one experiment as one record, where each goes on from where the one before ended; others as they are.

    Args:
        title: name of the list that holds them.
    """
    told = all(_STEPS & words_of(" ".join([title, name, *map(str, scalars)])) for _, name, scalars in parts)
    columns = {name: [arrays[name] for arrays, _, _ in parts] for name in parts[0][0]}
    numbers = [column for column in columns.values() if column[0].dtype.kind == "f"]
    if len(parts) < 2 or not told or not all(map(meet, numbers)):
        return parts
    return [({name: np.concatenate(column) for name, column in columns.items()}, "", {})]


def _as_channels(parts: list[_Record]) -> list[_Record]:
    """Parts with one time and one signal each, such as the process variables of an archive, as one record; others as they are."""
    arrays = [arrays for arrays, _, _ in parts]
    names = [[name for name in one if column_quantity(name) != "time"] for one in arrays]
    clocks = [
        {name: one[name] for name in one if name not in signals} for one, signals in zip(arrays, names, strict=True)
    ]
    shared = all(
        all(np.array_equal(clock[name], clocks[0].get(name)) for name in clock) and len(clock) == len(clocks[0])
        for clock in clocks
    )
    if len(parts) < 2 or not all(clocks) or not shared or any(len(signals) != 1 for signals in names):
        return parts
    signals = {name: one[signal] for (_, name, _), one, (signal,) in zip(parts, arrays, names, strict=True)}
    return [(clocks[0] | signals, "", {})] if len(signals) == len(parts) else parts


def _records(items: Iterable[tuple[str, Any]]) -> list[tuple[str, dict[str, np.ndarray], dict[str, Any]]]:
    """Name, arrays and scalars of the items that have at least two arrays."""
    leaves = [(name, *_leaves(item)) for name, item in items if isinstance(item, Mapping)]
    return [one for one in leaves if len(one[1]) > 1]


def _leaves(tree: Mapping[Any, Any], prefix: str = "") -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and scalars by their names, joined by dots."""
    arrays: dict[str, np.ndarray] = {}
    scalars: dict[str, Any] = {}
    for key, item in tree.items():
        name = f"{prefix}{key}"
        item = item[0] if _is_only_mapping(item) else item
        if isinstance(item, Mapping) and (column := _column(name, item)) is not None:
            arrays |= column
        elif isinstance(item, Mapping):
            below = _leaves(item, f"{name}.")
            arrays |= below[0]
            scalars |= below[1]
        elif isinstance(item, list) and item and all(isinstance(one, Mapping) for one in item):
            for one in item:
                arrays |= _column("", one) or {}
        elif isinstance(item, list):
            if (array := _array(item)) is not None:
                arrays[name] = array
        elif item is not None:
            scalars[name] = item
    return arrays, scalars


def _is_only_mapping(item: Any) -> bool:
    """Whether a list holds one mapping with lists in it, as the series of a query, and no description of a column."""
    return isinstance(item, list) and len(item) == 1 and isinstance(item[0], Mapping) and _column("", item[0]) is None


def _column(name: str, item: Mapping[str, Any]) -> dict[str, np.ndarray] | None:
    """The column of a mapping that describes one, {"label": "H", "unit": "A/m", "values": [...]}; None for others.

    Args:
        name: used where the mapping has none; "" requires one there.
    """
    lists = {str(key).lower(): value for key, value in item.items() if isinstance(value, list)}
    plain = not lists.keys() - _OF_VALUES  # {"name": "H", "data": [...]} beside {"name": "specimen A", "force": [...]}
    item = {str(key).lower(): value for key, value in item.items()}
    unit = next((item[key] for key in _UNITS if isinstance(item.get(key), str)), None)
    label = next((str(item[key]) for key in _LABELS if key in item), name)
    if (
        len(lists) != 1
        or not (label and (unit or plain or not name))
        or (array := _array(next(iter(lists.values())))) is None
    ):
        return None
    return {f"{label} [{unit}]" if unit else label: array}


def _array(items: list[Any]) -> np.ndarray | None:
    """A column of numbers, NaN where missing, or of text; None for other lists."""
    if len(items) < _FEWEST or any(isinstance(item, list | Mapping) for item in items):
        return None
    try:
        return np.array([np.nan if item is None or item == "" else float(item) for item in items])
    except (ValueError, TypeError):
        return np.array([str(item) for item in items])


def _unit_texts(tree: Any) -> Iterator[tuple[str, str]]:
    """Units anywhere in the tree, with the name of their column where the text gives it, else ""."""
    for key, item in tree.items() if isinstance(tree, Mapping) else enumerate(tree) if isinstance(tree, list) else ():
        if isinstance(item, str) and (title := unit_key(str(key))):  # "pressure_unit": "bar", "pressureUnits": "bar"
            yield title, item
        elif str(key).lower() in _UNITS:
            pairs = (
                item.items()
                if isinstance(item, Mapping)
                else [("", one) for one in item]
                if isinstance(item, list)
                else [("", item)]
            )
            yield from ((name, unit) for name, unit in pairs if isinstance(unit, str))
        else:
            yield from _unit_texts(item)


def _with_units(arrays: Mapping[str, np.ndarray], known: Collection[tuple[str, str]]) -> dict[str, np.ndarray]:
    """The arrays with units in their names: those of their name, else the only one of their quantity."""
    found = {}
    for name, array in arrays.items():
        last = name.rpartition(".")[2]
        kind = column_quantity(last)
        units = {unit for title, unit in known if title in (last, last.lower())}
        units = units or {unit for title, unit in known if title in words_of(last)}  # adsorption of total_adsorption
        units = units or {unit for title, unit in known if not title and kind and quantity(unit) == kind}
        found[f"{name} [{units.pop()}]" if len(units) == 1 and not split_unit(last)[1] else name] = array
    return found


def _table(file: TextFile | FileBytes, arrays: Mapping[str, np.ndarray], note: Note) -> Table:
    bare = [name.rpartition(".")[2] for name in arrays]  # of the only rows, whatever they are called
    nameless = all(name.startswith("column ") for name in bare) and len({*bare}) == len(bare)
    if nameless:
        arrays = dict(zip(bare, arrays.values(), strict=True))
    table = table_of_arrays(arrays, file.source, file.sha256, (*file.notes, note))
    return dataclasses.replace(table, named=not nameless)


def _part(name: str, scalars: Mapping[str, Any]) -> Part:
    """Name, properties and stated results of a record, from the scalars beside its arrays."""
    known = {key: str(value) for key, value in scalars.items() if len(str(value)) <= LONGEST}
    stated = [result_of(key.rpartition(".")[2], value) for key, value in known.items()]
    title = next(
        (str(scalars[key]) for key in ("name", "id", "label", "title") if isinstance(scalars.get(key), str)), ""
    )
    return Part(name or title, dict(list(known.items())[:MOST_METADATA]), tuple(one for one in stated if one))
