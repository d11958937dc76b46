"""Fits on disk: folders written, checked and opened."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np

from hystfit.config import verb
from hystfit.errors import DataError, HystfitError
from hystfit.models.storage import to_json
from hystfit.outcome import Code
from hystfit.outcome.note import warn
from hystfit.results.folders import dump_json, writing
from hystfit.results.manifest import MANIFEST, is_sealed, read_files, seal
from hystfit.results.report import Wording, write_into
from hystfit.results.result import FitResult
from hystfit.results.stored_fit import SCHEMA, result_of
from hystfit.results.stored_records import covariance_in, load_records, save_records
from hystfit.results.stored_values import parse
from hystfit.results.user_code import checksums

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
    """Refuse a folder whose result must not be replaced, before anything is computed.

    Args:
        own: schema of what is to be written, without its number, where it may replace an older one.
    """
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
