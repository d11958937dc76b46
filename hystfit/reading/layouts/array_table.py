"""Named arrays, as numpy, MATLAB, HDF5, Parquet and JSON files hold them, as the columns of a table."""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from hystfit.errors import DataError, MissingExtraError
from hystfit.outcome import Code, Note
from hystfit.reading.files.file_bytes import FileBytes
from hystfit.reading.files.text_file import Opening
from hystfit.reading.frames import seconds_passed
from hystfit.reading.limits import FEWEST, MOST_COLUMNS
from hystfit.reading.names.column_names import column_quantity
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Part, Table, below_each_other, plain_table
from hystfit.reading.text import cells
from hystfit.reading.text.stated_interval import interval_of

_PATH = re.compile(
    r"(?P<group>[^\[]+)[./](?P<name>[^./\[]+(?:\s*\[.*\])?)"
)  # of an array in groups: run1/H [A/m], test.S1.disp


def read_arrays(arrays_of: Callable[[bytes], Mapping[str, np.ndarray]], file: FileBytes, opening: Opening) -> Table:
    """The columns of a file that holds named arrays.

    Args:
        arrays_of: the arrays in the bytes of a file.
    """
    with errors_of(file, opening):
        arrays = arrays_of(file.raw)
    return table_of_arrays(arrays, file.source, file.sha256, file.notes)


@contextlib.contextmanager
def errors_of(file: FileBytes, opening: Opening) -> Iterator[None]:
    """The errors of the libraries that unpack a file as errors that name it."""
    if opening.sheet is not None:
        raise DataError(f"{file.source} has no sheets; leave out sheet=")
    try:
        yield
    except MissingExtraError:
        raise
    except DataError as error:
        raise DataError(f"{file.source}: {error}") from error
    except Exception as error:  # each library raises its own kinds on damaged files
        kind = file.suffix or "a file of arrays"
        raise DataError(f"{file.source} cannot be read as {kind}: {error}; it is damaged or of another kind") from error


def table_of_arrays(
    arrays: Mapping[str, np.ndarray], source: str, sha256: str | None, notes: Sequence[Note] = ()
) -> Table:
    """Columns of equal length; a matrix gives one column for each of its shorter side, called name[0], name[1], ...

    Groups with loops of the same names (run1/H, run1/B, run2/H, run2/B) are a record each.
    """
    if (records := _of_groups(arrays, source, sha256, notes)) is not None:
        return records
    arrays = _signals_in_rows(arrays) or arrays
    columns: dict[str, np.ndarray] = {}
    odd, stamps = [], set()
    title, named = _column_titles(arrays)
    for name, array in arrays.items():
        if name == title:
            continue
        array = np.squeeze(array)
        if array.ndim == 1 and array.size > 1 and (clock := _clock(array)) is not None:
            array = clock
            stamps.add(name or "column 0")
        if array.dtype.kind not in "fiubUS" or array.ndim not in (1, 2) or array.size < 2:
            odd.append(name)
        elif array.ndim == 1:
            columns[name or "column 0"] = array
        else:
            tall = array if array.shape[0] >= array.shape[1] else array.T
            own = [f"{name}[{k}]" if name else f"column {k}" for k in range(tall.shape[1])]
            columns.update(zip(named or own, tall.T, strict=True))
    if not columns:
        raise DataError(
            f"{source} holds no columns of numbers (found {', '.join(map(repr, odd)) or 'nothing'}); save arrays in it"
        )
    sizes: dict[int, int] = {}
    for array in columns.values():
        sizes[array.size] = sizes.get(array.size, 0) + (array.dtype.kind in "fiub")
    pairs = [size for size, count in sizes.items() if count > 1]
    rows = max(pairs or sizes, key=lambda size: size)
    names = [name for name, array in columns.items() if array.size == rows]
    if len(names) > MOST_COLUMNS:
        raise DataError(
            f"{source}: {len(names)} columns of {rows} rows; {MOST_COLUMNS} columns are the most: save fewer"
        )
    notes = [*notes, Note(Code.FILE_FORMAT, f"{len(names)} columns of {rows} rows")]
    clocks = [name for name in names if name in stamps]
    notes += [Note(Code.FILE_FORMAT, f"{name!r}: dates converted to seconds from the first one") for name in clocks]
    if rest := [name for name, array in columns.items() if name not in names and array.dtype.kind in "fiub"]:
        shown = ", ".join(rest[:8])
        notes.append(Note(Code.LEFT_OUT, f"left out: {len(rest)} columns of another length than {rows}: {shown}"))
    if odd:
        shown = ", ".join(odd[:8])
        notes.append(Note(Code.LEFT_OUT, f"left out: {len(odd)} variables that are not columns: {shown}"))
    scalars = {name: array.item() for name, array in arrays.items() if array.size == 1 and array.dtype.kind in "fiu"}
    units = ["s" if name in stamps else split_unit(name, names)[1] for name in names]
    table = plain_table(names, [columns[name] for name in names], source, sha256, tuple(notes), units)
    positions = frozenset(k for k, name in enumerate(names) if name in stamps)
    return dataclasses.replace(table, named="" not in arrays, stamps=positions, interval=interval_of(scalars))


def _column_titles(arrays: Mapping[str, np.ndarray]) -> tuple[str | None, list[str]]:
    """The array of texts that names the columns of the only matrix, and its texts; none where there is no such array."""
    widths = [
        min(shape)
        for array in arrays.values()
        if len(shape := np.squeeze(array).shape) == 2 and array.dtype.kind in "fiu"
    ]
    titles = {key: texts for key, array in arrays.items() if len({*(texts := _texts(array))}) == len(texts) > 1}
    if len(titles) != 1 or widths != [len(next(iter(titles.values())))]:
        return None, []
    return next(iter(titles.items()))


def _texts(array: np.ndarray) -> list[str]:
    """The texts of an array or a cell array that has nothing else; [] for others."""
    found = [np.squeeze(cell) for cell in np.ravel(array)] if array.dtype.kind in "OU" else []
    return [str(cell) for cell in found] if all(cell.dtype.kind == "U" and not cell.ndim for cell in found) else []


def _of_groups(
    arrays: Mapping[str, np.ndarray], source: str, sha256: str | None, notes: Sequence[Note]
) -> Table | None:
    """The records of groups that have columns of the same names, of which two may be those of a loop; None where there are none."""
    groups = _groups(arrays)
    first = next(iter(groups.values()), {})
    signals = [name for name in first if column_quantity(name) not in ("", "time", "index")]
    if len(signals) < 2:
        return None
    tables = [table_of_arrays(group, source, sha256, notes) for group in groups.values()]
    if len({tuple(sorted(table.names)) for table in tables}) > 1:
        return None
    paths = [re.split(r"[./]", name) for name in groups]
    shared = set(paths[0]).intersection(*paths)
    parts = [Part(name=" ".join(word for word in path if word not in shared)) for path in paths]
    text = f"{len(groups)} groups of columns of the same names, each a record"
    return below_each_other(tables, parts).noted(Note(Code.CURVES, text))


def _groups(arrays: Mapping[str, np.ndarray]) -> dict[str, dict[str, np.ndarray]]:
    """The columns of each group by their names; none where there is one group, or they differ in their names."""
    groups: dict[str, dict[str, np.ndarray]] = {}
    for match in filter(None, map(_PATH.fullmatch, arrays)):
        if np.squeeze(arrays[match[0]]).ndim == 1:
            groups.setdefault(match["group"], {})[match["name"]] = arrays[match[0]]
    alike = len(groups) > 1 and len({frozenset(group) for group in groups.values()}) == 1
    return groups if alike else {}


def _signals_in_rows(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray] | None:
    """The signals of groups that have a clock and a signal each, as a time, a name and a value for each sample; None for other groups.

    Each signal of a control loop is logged at times of its own, so that their lengths differ.
    """
    groups = _groups(arrays)
    first = next(iter(groups.values()), {})
    sizes = [{array.size for array in group.values()} for group in groups.values()]
    if not groups or any(len(size) > 1 or min(size) < FEWEST for size in sizes) or len(set.union(*sizes)) == 1:
        return None  # signals of equal length are columns
    joined = {name: np.concatenate([np.squeeze(group[name]) for group in groups.values()]) for name in first}
    clocks = {name: _clock(array) for name, array in joined.items()}
    clocks |= {
        name: array for name, array in joined.items() if column_quantity(name) == "time" and clocks[name] is None
    }
    times = [clock for clock in clocks.values() if clock is not None and clock.dtype.kind in "fiu"]
    numbers = [array for name, array in joined.items() if clocks[name] is None and array.dtype.kind in "fiub"]
    signals = [array for array in numbers if np.unique(array[np.isfinite(array)]).size > 1]
    if len(times) != 1 or len(signals) != 1:
        return None
    order = np.argsort(times[0], kind="stable")
    names = np.repeat([*groups], [size.pop() for size in sizes])
    return {"time [s]": times[0][order], "signal": names[order], "value": signals[0][order]}


def _clock(array: np.ndarray) -> np.ndarray | None:
    """Dates, durations, or texts of which each is a time stamp, as seconds from the first one, shape (rows,).

    None for other arrays, and for dates that can be read in two ways.
    """
    if array.dtype.kind in "mM":
        return seconds_passed(array)
    if array.dtype.kind not in "US":
        return None
    texts = [one.decode("utf-8", "replace") if isinstance(one, bytes) else one for one in array.tolist()]
    if not all(cells.is_stamp(cells.clean(text)) for text in texts):
        return None
    try:
        return cells.seconds(texts, "")[0]
    except DataError:  # dates that can be read in two ways
        return None
