"""Fits on disk: folders written, checked and opened."""

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

from hystfit.config import verb
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record, Stated
from hystfit.errors import DataError, HystfitError
from hystfit.models.storage import to_json
from hystfit.outcome import Code
from hystfit.outcome.note import warn
from hystfit.results.report import Wording, write_into
from hystfit.results.result import FitResult
from hystfit.results.saving.folders import dump_json, writing
from hystfit.results.saving.manifest import MANIFEST, is_sealed, read_files, seal
from hystfit.results.saving.stored_fit import SCHEMA, result_of
from hystfit.results.saving.stored_values import Stored, parse
from hystfit.results.saving.user_code import checksums

_FILES = ("result.json", "model.json", "records.npz")


def save_fit(result: FitResult, folder: str | Path, *, report: bool = True) -> Path:
    """See `FitResult.save`."""
    target = Path(folder)
    check_target(target, "hystfit.fit")
    with writing(target) as scratch:
        write_fit(result, scratch)
        if report:
            write_into(result, scratch, wording=Wording().at(target))
    return target


def write_fit(result: FitResult, folder: Path) -> None:
    """Write result.json, model.json, records.npz and their manifest into an existing folder."""
    code = checksums(result.models, result.noise.name)
    dump_json(folder / "result.json", result.to_dict())
    models = [to_json(model) for model in result.models]
    # Curves that share all values, a hundred of them with thousands of weights each, need one model.
    alike = all(model == models[0] for model in models)
    dump_json(folder / "model.json", {"models": models[:1] if alike else models, "code": code})
    p, extra = len(result.covariance), {}
    if result.joint is not None:
        extra = {"joint": result.joint[np.triu_indices(p)], "known": np.isfinite(np.diag(result.covariance))}
    save_records(folder / "records.npz", result.data, extra)
    seal(folder, _FILES)


def check_target(folder: Path, own: str = "") -> None:
    """Refuse, before any work, a folder whose result must not be replaced; one of the schema `own` (without its number) may be."""
    for name in ("result.json", MANIFEST):
        if (folder / name).is_dir():
            raise HystfitError(f"cannot write {str(folder / name)!r}: a folder has this name; choose another folder")
    file = folder / "result.json"
    if not file.exists():
        return
    kind = _schema_of(file).partition("/")[0]
    if not kind.startswith("hystfit."):
        raise HystfitError(f"{str(file)!r} was not written by hystfit, and would be overwritten: choose another folder")
    if kind != own and kind in ("hystfit.fit", "hystfit.sample"):
        what = "a fit" if kind == "hystfit.fit" else "a posterior"
        raise HystfitError(
            f"{str(folder)!r} holds {what}, whose result.json would be overwritten: choose another folder"
        )


def _schema_of(file: Path) -> str:
    """Schema of a result.json; "" where it has none. One that is damaged, but named by a manifest of hystfit, counts as a result."""
    try:
        stored = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return "hystfit.damaged" if file.with_name(MANIFEST).is_file() else ""
    return str(stored.get("schema", "")) if isinstance(stored, dict) else ""


@verb
def load_fit(folder: str | Path, *, trust: bool = False) -> FitResult:
    """The result that `FitResult.save` or `hystfit fit --out` wrote.

    Opening a fit runs no code but hystfit's own, and the files must be those that were saved.

    Args:
        folder: of the fit.
        trust: run a Python file with the user's own model or noise model, and accept files that were edited after they were saved
            (a note names them).

    Raises:
        DataError: the folder holds no fit, one of another schema, or one that is incomplete, edited or damaged.
        ModelError: a model file that would have to be run without `trust`.
    """
    folder = Path(folder)
    refuse_other_schema(folder, SCHEMA, "no fit as hystfit fit --out writes it", "fit again")
    files = read_files(folder, _FILES, allow_edits=trust)
    place = lambda name: str(folder / name)
    stored = parse(files.contents["result.json"], place("result.json"))
    described = parse(files.contents["model.json"], place("model.json"))
    try:
        data = load_records(io.BytesIO(files.contents["records.npz"]), place("records.npz"))
        covariance = covariance_in(files.contents["records.npz"], place("records.npz"))
        result = result_of(stored, described, data, covariance, trust=trust)
    except HystfitError as error:
        if str(folder) in str(error):
            raise
        raise type(error)(f"the fit in {str(folder)!r}: {error}") from error
    edited = [warn(Code.CHANGED_FILES, f"{name} was edited after hystfit saved it") for name in files.edited]
    known = {note.text for note in result.notes}
    return result.with_notes(*(note for note in edited if note.text not in known))


def refuse_other_schema(folder: Path, expected: str, nothing: str, remedy: str) -> None:
    """Refuse a folder without a result, or with one of another schema."""
    file = folder / "result.json"
    if is_sealed(folder):
        return
    if not file.exists() and not (folder / MANIFEST).exists():
        reason = "no result.json" if folder.is_dir() else "there is no such folder"
        raise DataError(f"{str(folder)!r} holds {nothing} ({reason})")
    schema = _schema_of(file)
    if schema != expected and schema.partition("/")[0] == expected.partition("/")[0]:
        raise DataError(
            f"{str(file)!r} was written by an earlier version of hystfit (schema {schema!r}, now {expected!r}): {remedy}"
        )


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
    """The records that `save_records` wrote; messages name the place, by default the path."""
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
    return fields | {
        "reading": dict(record.reading),
        "metadata": dict(record.metadata),
        "stated": [dataclasses.asdict(one) for one in record.stated],
        "notes": [note.to_dict() for note in record.notes],
    }


def _labels_of(stored: Stored) -> dict[str, Any]:
    """Arguments of a record from its stored labels."""
    texts = ("u_unit", "y_unit", "t_unit", "u_name", "y_name", "name", "source")
    labels: dict[str, Any] = {name: stored.get(name, str) for name in texts}
    labels |= {"sha256": stored.get("sha256", str | None), "sigma": stored.get("sigma", float | None)}
    labels |= {"reading": stored.mapping("reading", str), "metadata": stored.mapping("metadata", str)}
    parts = (Stored(part, f"{stored.place}: stated") for part in stored.listed("stated"))
    return labels | {"notes": stored.notes("notes"), "stated": tuple(part.read(Stated) for part in parts)}
