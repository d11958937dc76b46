"""Fits and records on disk."""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.config import require_x64
from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError
from hystfit.inference.problem import Problem
from hystfit.models.storage import from_json, to_json
from hystfit.outcome import Note, Status
from hystfit.quality.baselines import Baselines
from hystfit.results.folders import dump_json, writing
from hystfit.results.metrics import Metrics
from hystfit.results.report import write_into
from hystfit.results.result import SCHEMA, FitResult, NoiseEstimate, ParameterEstimate


def save_fit(result: FitResult, folder: str | Path, *, report: bool = True) -> Path:
    """See `FitResult.save`."""
    target = Path(folder)
    with writing(target) as scratch:
        write_fit(result, scratch)
        if report:
            write_into(result, scratch)
    return target


def write_fit(result: FitResult, folder: Path) -> None:
    """Write result.json, model.json, records.npz, and covariance.npy where it is large, of a fit into an existing folder."""
    dump_json(folder / "result.json", result.to_dict())
    if result.has_large_covariance:
        np.save(folder / "covariance.npy", result.covariance)
    dump_json(folder / "model.json", {"models": [to_json(model) for model in result.models]})
    save_records(folder / "records.npz", result.data)


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
        DataError: the folder holds no fit, one of another schema, or one that is damaged.
    """
    require_x64()
    folder = Path(folder)
    try:
        stored = json.loads((folder / "result.json").read_text(encoding="utf-8"))
        described = json.loads((folder / "model.json").read_text(encoding="utf-8"))
    except OSError as error:
        reason = f"{Path(error.filename or folder).name}: {error.strerror}"
        raise DataError(f"{str(folder)!r} holds no fit as hystfit fit --out writes it ({reason})") from error
    except ValueError as error:
        raise DataError(f"the fit in {str(folder)!r} is damaged ({error}): fit again") from error
    schema = stored.get("schema") if isinstance(stored, dict) else None
    if schema != SCHEMA:
        older = " (written by an earlier version of hystfit: fit again)" if schema == "hystfit.fit/1" else ""
        raise DataError(f"{folder / 'result.json'}: schema {schema!r}, expected {SCHEMA!r}{older}")
    try:
        if stored["covariance"] is None:
            stored["covariance"] = np.load(folder / "covariance.npy", allow_pickle=False)
        return _result_of(stored, described, load_records(folder / "records.npz"))
    except DataError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, OSError) as error:
        raise DataError(f"the fit in {str(folder)!r} is damaged ({error}): fit again") from error


def _result_of(stored: dict[str, Any], described: dict[str, Any], data: Dataset) -> FitResult:
    models = [from_json(model) for model in described["models"]]
    block = stored["problem"]
    free = list(dict.fromkeys(name.partition("@")[0] for name in stored["free_names"]))
    problem = Problem(models[0], data, fix=block["fixed"], free=free, loss=block["loss"])
    if problem.space.names != tuple(stored["free_names"]):
        raise ValueError(f"its free parameters {stored['free_names']} are not those of its model {problem.space.names}")
    docs = {name: info.doc for name, _, info in problem.space.fixed()}
    docs |= {name: info.doc for name, info in zip(problem.space.names, problem.space.infos, strict=True)}
    metrics = {k: Metrics(**v) if v else None for k, v in stored["metrics"].items()}
    p = len(problem.space)
    return FitResult(
        problem=problem,
        x=problem.space.vector(models if len(models) > 1 else models[0]),
        status=Status(stored["status"]),
        notes=tuple(Note.of(note) for note in stored["notes"]),
        parameters=tuple(ParameterEstimate(name=k, **v, doc=docs.get(k, "")) for k, v in stored["parameters"].items()),
        covariance=np.array(stored["covariance"], dtype=float).reshape(p, p),
        train=metrics["train"],  # type: ignore[arg-type]
        test=metrics["test"],
        sigma=stored["residuals"]["sigma"],
        correlation_time=stored["residuals"]["correlation_time_samples"],
        error_ratio=stored["residuals"]["error_ratio_to_iid"],
        rank=stored["identifiability"]["rank"],
        condition=stored["identifiability"]["condition"],
        method=stored["method"]["name"],
        starts=stored["method"]["starts"],
        in_best_basin=stored["method"]["in_best_basin"],
        compile_s=stored["timing"]["compile_s"],
        run_s=stored["timing"]["run_s"],
        noise=NoiseEstimate(block["noise"]["name"], block["noise"]["parameters"]),
        baselines=_baselines(stored["verdict"]["train"]),  # type: ignore[arg-type]
        test_baselines=_baselines(stored["verdict"]["test"]),
        left_out=stored["verdict"]["left_out"],
        provenance=stored["provenance"],
    )


def _baselines(verdict: dict[str, Any] | None) -> Baselines | None:
    return Baselines(**verdict["baselines"]) if verdict else None
