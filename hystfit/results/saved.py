"""Results on disk: folders written whole or not at all, JSON that any reader takes, fits and records read back."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError, HystfitError
from hystfit.models.storage import from_json, to_json
from hystfit.params.space import ParameterSpace
from hystfit.results.metrics import Metrics
from hystfit.results.result import SCHEMA, FitResult, ParameterEstimate


class writing:
    """Context that gives a scratch folder beside the target and moves its files in place when all are written.

    After an error (or an interrupt) nothing is left: no scratch folder, no target that was not there before.

    Raises:
        HystfitError: the target cannot be made or written; the message names the folder and the reason.
    """

    def __init__(self, target: str | Path):
        self.target = Path(target)

    def __enter__(self) -> Path:
        """Make the scratch folder."""
        self.made = not self.target.exists()
        try:
            self.target.mkdir(exist_ok=True)
            self.scratch = Path(tempfile.mkdtemp(prefix=".hystfit-", dir=self.target))
        except OSError as error:
            raise self._refused(error) from error
        return self.scratch

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        """Move the files, or remove them after an error."""
        try:
            if kind is None:
                _move(self.scratch, self.target)
        except OSError as failure:
            raise self._refused(failure) from failure
        finally:
            shutil.rmtree(self.scratch, ignore_errors=True)
            if self.made and kind is not None:
                shutil.rmtree(self.target, ignore_errors=True)
        if isinstance(error, OSError):
            raise self._refused(error) from error

    def _refused(self, error: OSError) -> HystfitError:
        if isinstance(error, FileNotFoundError) and not self.target.parent.is_dir():
            return HystfitError(
                f"cannot write to {str(self.target)!r}: the folder {str(self.target.parent)!r} does not exist; make it first"
            )
        if isinstance(error, FileExistsError):
            return HystfitError(f"cannot write to {str(self.target)!r}: it is a file, and a folder is needed")
        return HystfitError(f"cannot write to {str(self.target)!r}: {error.strerror or error}")


def _move(source: Path, target: Path) -> None:
    """Move the files of a folder into another, and those of its folders into theirs."""
    for entry in sorted(source.iterdir()):
        if entry.is_dir():
            (target / entry.name).mkdir(exist_ok=True)
            _move(entry, target / entry.name)
        else:
            os.replace(entry, target / entry.name)


def check_writable(target: str | Path) -> None:
    """Refuse a folder that could not be written later, before long work begins; what it makes it removes.

    Raises:
        HystfitError: as `writing`.
    """
    attempt = writing(target)
    attempt.__enter__()
    shutil.rmtree(attempt.scratch, ignore_errors=True)
    if attempt.made:
        attempt.target.rmdir()


def write_fit(result: FitResult, folder: Path) -> None:
    """Write result.json, model.json and records.npz of a fit into a folder that is there."""
    dump_json(folder / "result.json", result.to_dict())
    dump_json(folder / "model.json", {"models": [to_json(model) for model in result.models]})
    save_records(folder / "records.npz", result.data)


def dump_json(path: Path, content: dict[str, Any]) -> None:
    """Write JSON that any reader takes: no NaN, no infinity.

    Raises:
        HystfitError: the content is not JSON-able.
    """
    try:
        path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except (TypeError, ValueError) as error:
        raise HystfitError(f"{path.name} would hold a value that JSON has not: {error}") from error


def save_records(path: Path, data: Dataset) -> None:
    """Records with their labels in one .npz file."""
    arrays: dict[str, np.ndarray] = {}
    labels = []
    for k, record in enumerate(data):
        for field in ("u", "y", "t", "weight"):
            if getattr(record, field) is not None:
                arrays[f"{field}{k}"] = getattr(record, field)
        labels.append(record.labels())
    np.savez_compressed(path, labels=np.array(json.dumps({"name": data.name, "records": labels})), **arrays)  # type: ignore[arg-type]


def load_records(path: Path) -> Dataset:
    """The records that `save_records` wrote.

    Raises:
        DataError: not such a file.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            described = json.loads(str(stored["labels"]))
            records = []
            for k, labels in enumerate(described["records"]):
                t = stored[f"t{k}"] if f"t{k}" in stored else None
                records.append(
                    Record(
                        u=stored[f"u{k}"],
                        y=stored[f"y{k}"],
                        t=t,
                        weight=stored[f"weight{k}"],
                        **Record.labels_of(labels),
                    )
                )
    except (OSError, KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise DataError(f"{path} does not hold records as hystfit saves them: {error}") from error
    return Dataset(tuple(records), name=described["name"])


def holds_fit(folder: Path) -> bool:
    """Whether a folder holds what `FitResult.save` wrote."""
    try:
        stored = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(stored, dict) and stored.get("schema") == SCHEMA


def load_fit(folder: str | Path) -> FitResult:
    """The result that `FitResult.save` or `hystfit fit --out` wrote.

    Raises:
        DataError: the folder holds no fit, or one that is damaged.
    """
    folder = Path(folder)
    try:
        stored = json.loads((folder / "result.json").read_text(encoding="utf-8"))
        described = json.loads((folder / "model.json").read_text(encoding="utf-8"))
    except OSError as error:
        reason = f"{Path(error.filename or folder).name}: {error.strerror}"
        raise DataError(f"{str(folder)!r} holds no fit as hystfit fit --out writes it ({reason})") from error
    except ValueError as error:
        raise DataError(f"the fit in {str(folder)!r} is damaged ({error}): fit anew") from error
    found = stored.get("schema") if isinstance(stored, dict) else None
    if found != SCHEMA:
        raise DataError(f"{folder / 'result.json'}: schema {found!r}, expected {SCHEMA!r}")
    try:
        return _result_of(stored, described, load_records(folder / "records.npz"))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"the fit in {str(folder)!r} is damaged ({error}): fit anew") from error


def _result_of(stored: dict[str, Any], described: dict[str, Any], data: Dataset) -> FitResult:
    models = tuple(from_json(model) for model in described["models"])
    metrics = {k: Metrics(**v) if v else None for k, v in stored["metrics"].items()}
    p = len(stored["free_names"])
    space = ParameterSpace.of(models[0], records=[record.name for record in data])
    docs = {name: info.doc for name, _, info in space.fixed()}
    docs |= {name: info.doc for name, info in zip(space.names, space.infos, strict=True)}
    return FitResult(
        model=models[0],
        models=models,
        data=data,
        status=stored["status"],
        notes=tuple(stored["notes"]),
        parameters=tuple(ParameterEstimate(name=k, **v, doc=docs.get(k, "")) for k, v in stored["parameters"].items()),
        free_names=tuple(stored["free_names"]),
        covariance=np.array(stored["covariance"], dtype=float).reshape(p, p),
        train=metrics["train"],  # type: ignore[arg-type]
        test=metrics["test"],
        sigma=stored["residuals"]["sigma"],
        correlation_time=stored["residuals"]["correlation_time_samples"],
        honest_ratio=stored["residuals"]["honest_to_iid_error_ratio"],
        rank=stored["identifiability"]["rank"],
        condition=stored["identifiability"]["condition"],
        method=stored["method"]["name"],
        starts=stored["method"]["starts"],
        in_best_basin=stored["method"]["in_best_basin"],
        compile_s=stored["timing"]["compile_s"],
        run_s=stored["timing"]["run_s"],
        provenance=stored["provenance"],
    )
