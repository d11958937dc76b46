"""The file records.npz of a saved result: its records with their labels, and the covariance of a fit."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.data.stated import Stated
from hystfit.errors import DataError, HystfitError
from hystfit.results.stored_values import Stored, parse

_ARRAYS = ("u", "y", "t", "weight")


def save_records(path: Path, data: Dataset, extra: Mapping[str, np.ndarray] | None = None) -> None:
    """Records with their labels in one .npz file."""
    arrays: dict[str, np.ndarray] = dict(extra or {})
    labels = []
    for k, record in enumerate(data):
        for field in _ARRAYS:
            if getattr(record, field) is not None:
                arrays[f"{field}{k}"] = getattr(record, field)
        labels.append(_labels(record))
    arrays["labels"] = np.array(json.dumps({"name": data.name, "records": labels}))
    # As `np.savez_compressed`, in a quarter of the time: numbers with all their digits, as those of a covariance, hardly get smaller.
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name, array in arrays.items():
            with file.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, np.asarray(array), allow_pickle=False)


def load_records(file: Path | io.BytesIO, place: str = "") -> Dataset:
    """The records that `save_records` wrote.

    Args:
        place: of the file, for messages; default: the path.
    """
    place = place or str(file)
    with _damage_refused(place), np.load(file, allow_pickle=False) as stored:
        described = parse(str(stored["labels"]), f"{place}: labels")
        records = []
        for k, labels in enumerate(described.listed("records")):
            arrays = {name: stored[f"{name}{k}"] for name in _ARRAYS if f"{name}{k}" in stored}
            if wrong := [name for name, array in arrays.items() if array.dtype.kind not in "fiu"]:
                raise ValueError(f"{wrong[0]}{k} holds no real numbers")
            records.append(Record(**arrays, **_labels_of(Stored(labels, f"{place}: record {k}"))))
        return Dataset(tuple(records), name=described.get("name", str))


@contextlib.contextmanager
def _damage_refused(place: str) -> Iterator[None]:
    """Errors of a damaged .npz file in words: it is a zip archive, and its reader meets one with errors of many kinds."""
    try:
        yield
    except HystfitError:
        raise
    except (OSError, KeyError, ValueError, TypeError, EOFError, MemoryError, OverflowError, NotImplementedError,
            RuntimeError, SyntaxError, AttributeError, zipfile.BadZipFile, zlib.error) as error:  # fmt: skip
        raise DataError(f"{place} does not hold records as hystfit saves them: {error}") from error


def covariance_in(content: bytes, place: str) -> tuple[np.ndarray, np.ndarray] | None:
    """The covariance that is kept beside the records, as its upper triangle, of the parameters that have errors and of all."""
    with _damage_refused(place), np.load(io.BytesIO(content), allow_pickle=False) as stored:
        if "joint" not in stored:
            return None
        upper, known = np.asarray(stored["joint"], dtype=float), np.asarray(stored["known"])
    p = known.size
    if known.shape != (p,) or known.dtype != bool or upper.shape != (p * (p + 1) // 2,):
        raise DataError("records.npz: the covariance is not a triangle of numbers; restore the file, or fit again")
    full = np.empty((p, p))
    full[np.triu_indices(p)] = upper
    full = np.where(np.tri(p, k=-1, dtype=bool), full.T, full)
    return np.where(np.outer(known, known), full, np.nan), full


def _labels(record: Record) -> dict[str, Any]:
    """All fields of a record but the arrays, for JSON."""
    fields = {
        field.name: getattr(record, field.name) for field in dataclasses.fields(record) if field.name not in _ARRAYS
    }
    plain = {"reading": dict(record.reading), "metadata": dict(record.metadata)}
    plain["stated"] = [dataclasses.asdict(one) for one in record.stated]
    return fields | plain | {"notes": [note.to_dict() for note in record.notes]}


def _labels_of(stored: Stored) -> dict[str, Any]:
    """Arguments of a record from its stored labels."""
    texts = ("u_unit", "y_unit", "t_unit", "u_name", "y_name", "name", "source")
    labels: dict[str, Any] = {name: stored.get(name, str) for name in texts}
    labels |= {"sha256": stored.get("sha256", str | None), "sigma": stored.get("sigma", float | None)}
    labels |= {"reading": stored.mapping("reading", str), "metadata": stored.mapping("metadata", str)}
    parts = (Stored(part, f"{stored.place}: stated") for part in stored.listed("stated"))
    return labels | {"notes": stored.notes("notes"), "stated": tuple(part.read(Stated) for part in parts)}
