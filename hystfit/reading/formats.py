"""Files that are not text: numpy, MATLAB, Excel and HDF5; the last two need the extra "files"."""

from __future__ import annotations

import datetime
import hashlib
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.errors import DataError, MissingExtraError
from hystfit.outcome import Code, Note
from hystfit.reading import cells
from hystfit.reading.header import split_unit
from hystfit.reading.raw_table import Table, plain_table
from hystfit.reading.text import layout_of, load, tabulate


def read_binary(path: str | Path, *, sheet: str | int | None = None) -> Table:
    """All columns of a .npz, .npy, .mat, .xlsx or .h5 file.

    Raises:
        DataError: the kind is unknown, or the file is damaged or holds no columns.
        MissingExtraError: the library for it is not installed.
    """
    suffix = Path(path).suffix.lower()
    reader = READERS.get(suffix)
    if reader is None:
        known = ".csv .dat .txt .tsv " + " ".join(sorted(READERS))
        if Path(path).is_dir():
            load(path)
        raise DataError(
            f"{path}: files of kind {suffix!r} are not supported; hystfit reads {known}. If it is text use "
            "read_csv, else export it as CSV"
        )
    raw = load(path)
    if suffix in (".xlsx", ".xlsm"):
        return _workbook(raw, str(path), sheet)
    if sheet is not None:
        raise DataError(f"{path} has no sheets; leave out sheet=")
    try:
        arrays = reader(raw)
    except (DataError, MissingExtraError):
        raise
    except Exception as error:  # each library raises its own kinds on damaged files
        raise DataError(f"{path} cannot be read as {suffix}: {error}; it is damaged or of another kind") from error
    return _from_arrays(arrays, str(path), hashlib.sha256(raw).hexdigest())


def _import(package: str, purpose: str) -> Any:
    import importlib

    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise MissingExtraError(package, "files", purpose) from error


def _numpy(raw: bytes) -> dict[str, np.ndarray]:
    """NumPy arrays: each array of a .npz is a column, a matrix gives several, a structured array its fields."""
    found = np.load(io.BytesIO(raw), allow_pickle=False)
    if isinstance(found, np.ndarray):
        return {"": found} if found.dtype.names is None else {name: found[name] for name in found.dtype.names}
    return {name: found[name] for name in found.files}


def _matlab(raw: bytes) -> dict[str, np.ndarray]:
    """MATLAB variables, also within structures; version 7.3 files need the extra "files"."""
    from scipy.io import loadmat

    if raw[:128].startswith(b"MATLAB 7.3") or raw[:4] == b"\x89HDF" or raw[512:516] == b"\x89HDF":
        return {name: array.T for name, array in _hdf5(raw).items()}  # MATLAB stores columns first
    found = loadmat(io.BytesIO(raw), simplify_cells=True)
    return _flatten({name: value for name, value in found.items() if not name.startswith("__")})


def _hdf5(raw: bytes) -> dict[str, np.ndarray]:
    """HDF5 data sets in all groups, and the fields of compound ones; needs the extra "files"."""
    h5py = _import("h5py", "reading HDF5 (and MATLAB 7.3) files")
    arrays: dict[str, np.ndarray] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith("#refs#"):
            values = item[()]
            if isinstance(values, np.ndarray) and values.dtype.names is not None:
                arrays.update({f"{name}/{field}": values[field] for field in values.dtype.names})
            elif isinstance(values, np.ndarray):
                arrays[name] = np.array([v.decode() for v in values.ravel()]) if values.dtype.kind in "SO" else values

    with h5py.File(io.BytesIO(raw), "r") as file:
        file.visititems(visit)
    return arrays


def _flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            arrays.update(_flatten(value, f"{prefix}{name}."))
        elif isinstance(value, np.ndarray):
            arrays[f"{prefix}{name}"] = value
    return arrays


def _from_arrays(arrays: Mapping[str, np.ndarray], source: str, sha256: str) -> Table:
    """Columns of equal length; a matrix gives one column for each of its shorter side, called name[0], name[1], ..."""
    columns: dict[str, np.ndarray] = {}
    odd = []
    for name, array in arrays.items():
        array = np.squeeze(array)
        if array.dtype.kind not in "fiubUS" or array.ndim not in (1, 2) or array.size < 2:
            odd.append(name)
        elif array.ndim == 1:
            columns[name or "column 0"] = array
        else:
            tall = array if array.shape[0] >= array.shape[1] else array.T
            columns.update({f"{name}[{k}]" if name else f"column {k}": tall[:, k] for k in range(tall.shape[1])})
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
    notes = [Note(Code.FILE_FORMAT, f"{len(names)} columns of {rows} rows")]
    if rest := [name for name in columns if name not in names]:
        shown = ", ".join(rest[:8])
        notes.append(Note(Code.LEFT_OUT, f"left out: {len(rest)} columns of another length than {rows}: {shown}"))
    if odd:
        shown = ", ".join(odd[:8])
        notes.append(Note(Code.LEFT_OUT, f"left out: {len(odd)} variables that are not columns: {shown}"))
    units = [split_unit(name, names)[1] for name in names]
    table = plain_table(names, [columns[name] for name in names], source, sha256, tuple(notes), units)
    return table if "" not in arrays else Table(**{**vars(table), "named": False})


def _workbook(raw: bytes, source: str, sheet: str | int | None) -> Table:
    openpyxl = _import("openpyxl", "reading Excel files")
    try:
        book = openpyxl.load_workbook(io.BytesIO(raw), read_only=True, data_only=True)
        sheets = {
            page.title: [[_cell(v) for v in row] for row in page.iter_rows(values_only=True)]
            for page in book.worksheets
        }
    except Exception as error:  # openpyxl raises zipfile, KeyError and its own errors on damaged files
        raise DataError(
            f"{source} cannot be read as an Excel file: {error}; save it again as .xlsx or as CSV"
        ) from error
    titles = list(sheets)
    if isinstance(sheet, str) and sheet not in sheets and sheet.isdigit():
        sheet = int(sheet)
    if isinstance(sheet, int):
        if not 0 <= sheet < len(titles):
            raise DataError(
                f"{source}: there is no sheet {sheet}; there are {len(titles)} (from 0): {', '.join(titles)}"
            )
        sheet = titles[sheet]
    if sheet is not None and sheet not in sheets:
        raise DataError(f"{source}: there is no sheet {sheet!r}; there are {', '.join(titles)}")
    for title in titles if sheet is None else [sheet]:
        rows = sheets[title]
        layout = layout_of(rows[:2000], "\t", ".")
        if layout.rows > 1 and layout.score > 0:
            notes = [Note(Code.FILE_FORMAT, f"sheet {title!r} of {', '.join(map(repr, titles))}")]
            lines = ["\t".join(row) for row in rows]
            return tabulate(rows, lines, layout, source, hashlib.sha256(raw).hexdigest(), notes, settled=True)
    searched = ", ".join(map(repr, titles if sheet is None else [sheet]))
    raise DataError(f"{source}: no rows of numbers in {searched}; name another sheet=")


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat(" ") if isinstance(value, datetime.datetime) else value.isoformat()
    return cells.clean(str(value).replace("\t", " ").replace("\n", " "))


def _excel(raw: bytes) -> dict[str, np.ndarray]:
    """Excel sheets, the first with rows of numbers unless `--sheet` names one; needs the extra "files"."""
    raise NotImplementedError  # a sheet has rows of cells, like text, and is read by `_workbook`


READERS: dict[str, Callable[[bytes], dict[str, np.ndarray]]] = {
    ".npz": _numpy,
    ".npy": _numpy,
    ".mat": _matlab,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".xlsx": _excel,
    ".xlsm": _excel,
}
