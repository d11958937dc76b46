"""A fit as result.json, and a fit from its files: every value is read with its type, and the files must belong together."""

from __future__ import annotations

import functools
from typing import Any, get_type_hints

import equinox as eqx
import jax
import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.errors import DataError, HystfitError
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.problem import LOSSES, Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.models.storage import files_named, from_json
from hystfit.outcome import Note, Status
from hystfit.outcome.table import ROUNDING
from hystfit.quality.baselines import Baselines
from hystfit.results.accuracy import Metrics, verdict_dict
from hystfit.results.estimates import NoiseEstimate, ParameterEstimate
from hystfit.results.result import FitResult
from hystfit.results.saving.stored_values import Stored, is_number
from hystfit.results.saving.user_code import allow, noise_file

SCHEMA = "hystfit.fit/3"
COVARIANCE_AS_TEXT = 200  # parameters up to which result.json has the covariance
# Sections of result.json: the field of the result by the name of each member.
_SECTIONS = {
    "residuals": {
        "sigma": "sigma",
        "correlation_time_samples": "correlation_time",
        "error_ratio_to_iid": "error_ratio",
    },
    "identifiability": {"rank": "rank", "condition": "condition"},
    "method": {"name": "method", "starts": "starts", "in_best_basin": "in_best_basin"},
    "timing": {"compile_s": "compile_s", "run_s": "run_s"},
}


def content_of(result: FitResult) -> dict[str, Any]:
    """The contents of `result.json`, see `FitResult.to_dict`."""
    covariance = None
    if len(result.covariance) <= COVARIANCE_AS_TEXT:  # null for what is not finite, which JSON cannot represent
        covariance = np.where(np.isfinite(result.covariance), result.covariance, np.array(None)).tolist()
    sections = {
        name: {key: getattr(result, field) for key, field in members.items()} for name, members in _SECTIONS.items()
    }
    sections["identifiability"]["free"] = len(result.free_names)
    return {
        "schema": SCHEMA,
        "model": result.name,
        "status": str(result.status),
        "advice": result.advice,
        "notes": [note.to_dict() for note in result.notes],
        "parameters": {p.name: p.to_dict() for p in result.parameters},
        "derived": {p.name: {"value": p.value, "stderr": p.stderr, "unit": p.unit} for p in result.derived},
        "quantities": {q.name: q.to_dict() for q in result.quantities},
        "measured": result.measured.to_dict(),
        "free_names": list(result.free_names),
        "covariance": covariance,
        "metrics": {"train": result.train.to_dict(), "test": result.test.to_dict() if result.test else None},
        "verdict": {
            "train": verdict_dict(result.train, result.baselines),
            "test": verdict_dict(result.test, result.test_baselines),
            "left_out": result.left_out,
        },
        **sections,
        "problem": {
            "loss": result.problem.objective.loss,
            "fixed": [p.name for p in result.parameters if p.fixed],
            "tied": result.problem.space.expressions,
            "noise": {"name": result.noise.name, "parameters": result.noise.parameters},
        },
        "provenance": result.provenance,
    }


def result_of(
    stored: Stored, described: Stored, data: Dataset, covariance: tuple[np.ndarray, np.ndarray] | None, *, trust: bool
) -> FitResult:
    """The result that its files describe, with every value of its type and all of them consistent.

    Args:
        covariance: kept beside them, of the parameters that have errors and of all, each (p, p), the first read from result.json where that
            has it; None of sequential methods.
    """
    if (schema := stored.get("schema", str)) != SCHEMA:
        raise DataError(f"{stored.place}: schema {schema!r}, expected {SCHEMA!r}")
    block, names = stored.part("problem"), stored.texts("free_names")
    noise = _noise_of(block.part("noise"))
    if covariance is not None and len(covariance[0]) != len(names):
        raise DataError(f"{stored.place}: the covariance in records.npz is that of another fit; fit again")
    models, notes = _models_of(described, noise, trust)
    problem = _problem_of(block, names, models[0], data)
    space = problem.space
    if len(models) not in (1, len(data)):
        raise DataError(f"{described.place}: {len(models)} models for {len(data)} records")
    large = len(space) > COVARIANCE_AS_TEXT
    x = space.vector(models if len(models) > 1 else models[0])
    docs = {name: info.doc for name, _, info in space.fixed()}
    docs |= {tie.name: info.doc for tie, _, info, _ in space.tied(x)}
    docs |= {name: info.doc for name, info in zip(space.names, space.infos, strict=True)}
    parameters = tuple(_parameter(name, part, docs.get(name, "")) for name, part in stored.part("parameters").parts())
    values = dict(zip(space.names, x, strict=True)) | {name: value for name, value, _ in space.fixed()}
    values |= {tie.name: value for tie, value, *_ in space.tied(x)}
    _refuse_mixture(stored, parameters, values)
    metrics, verdict, kinds = stored.part("metrics"), stored.part("verdict"), get_type_hints(FitResult)
    fields = {
        field: stored.part(name).get(key, kinds[field])
        for name, members in _SECTIONS.items()
        for key, field in members.items()
    }
    train, baselines = _metrics(metrics.optional_part("train")), _baselines(verdict, "train")
    if train is None or baselines is None:
        raise DataError(
            f"{stored.place}: the metrics of the fitted samples are missing; restore the file, or fit again"
        )
    if noise.refines:
        _build(f"{stored.place}: noise", lambda: NOISES.find(noise.name)(**noise.parameters))
    return FitResult(
        problem=problem,
        x=x,
        status=stored.member("status", Status),
        notes=(*stored.notes("notes"), *notes),
        parameters=parameters,
        covariance=_covariance(stored, len(space)) if covariance is None or not large else covariance[0],
        joint=None if covariance is None else covariance[1],
        train=train,
        test=_metrics(metrics.optional_part("test")),
        **fields,
        noise=noise,
        baselines=baselines,
        test_baselines=_baselines(verdict, "test"),
        left_out=verdict.get("left_out", float | None),
        provenance=_provenance(stored.part("provenance")),
    )


def _noise_of(stored: Stored) -> NoiseEstimate:
    name = stored.get("name", str)
    if name not in ("auto", *NOISES) and noise_file(name) is None:
        raise DataError(f"{stored.place}: no noise model {name!r}; restore the file, or fit again")
    return NoiseEstimate(name, stored.mapping("parameters", float))


def _models_of(described: Stored, noise: NoiseEstimate, trust: bool) -> tuple[list[AbstractHysteresis], list[Note]]:
    """The models, and notes on files of the user's that have changed."""
    listed = described.listed("models")
    if not listed:
        raise DataError(f"{described.place} holds no model: restore the file, or fit again")
    code = described.part("code")
    files = files_named(listed) | ({noise_file(noise.name)} - {None})
    allowed, notes = allow(files, {name: code.get(name, str | None) for name in code.content}, trust)  # type: ignore[arg-type]
    models = [_build(described.place, lambda one=one: from_json(one, allowed)) for one in listed]
    for model in models:
        _build(described.place, lambda model=model: _traced(model))
    return models, notes


def _traced(model: AbstractHysteresis) -> None:
    """Trace one step of a model, which fails where its fields do not belong together; JAX keeps the trace for models like it.

    To trace each anew took half of opening a fit (10 of 18 ms, Bouc-Wen, 160 samples).
    """
    number = jax.ShapeDtypeStruct((), float)
    arrays, others = eqx.partition(model, eqx.is_array)
    _first_step.eval_shape(others, arrays, number, number, number)


@functools.partial(jax.jit, static_argnums=0)
def _first_step(others: Any, arrays: Any, u0: Any, u1: Any, dt: Any) -> tuple[Any, Any]:
    model = eqx.combine(arrays, others)
    return model.step(model.init(u0), u0, u1, dt)


def _build(place: str, make: Any) -> Any:
    """What `make` returns; any error, also one of the user's own class, as a DataError."""
    try:
        return make()
    except HystfitError:
        raise
    except Exception as error:
        raise DataError(f"{place} is damaged ({type(error).__name__}: {error}): restore it, or fit again") from error


def _problem_of(block: Stored, names: tuple[str, ...], model: AbstractHysteresis, data: Dataset) -> Problem:
    free = list(dict.fromkeys(name.partition("@")[0] for name in names))
    loss = block.get("loss", str)
    if loss not in LOSSES:
        raise DataError(f"{block.place}: no loss {loss!r}; restore the file, or fit again")
    fixed, ties = block.texts("fixed"), block.mapping("tied", str)
    problem = _build(block.place, lambda: Problem(model, data, fix=fixed, free=free, tie=ties, loss=loss))  # type: ignore[arg-type]
    if problem.space.names != names:
        raise DataError(
            f"{block.place}: the free parameters {list(names)} are not those of the model {problem.space.names}"
        )
    return problem


def _parameter(name: str, stored: Stored, doc: str) -> ParameterEstimate:
    at_bound = stored.get("at_bound", str | None)
    if at_bound not in (None, "lower", "upper"):
        raise DataError(f"{stored.place}: 'at_bound' is {at_bound!r} instead of lower, upper or null")
    return stored.read(ParameterEstimate, name=name, doc=doc)


def _refuse_mixture(stored: Stored, parameters: tuple[ParameterEstimate, ...], values: dict[str, Any]) -> None:
    """Refuse parameters that are not those of the model beside them."""
    if set(values) != {p.name for p in parameters}:
        raise DataError(f"{stored.place}: the parameters are not those of the model; restore the folder, or fit again")
    for p in parameters:
        if not np.isclose(p.value, values[p.name], rtol=ROUNDING, atol=0.0):
            raise DataError(
                f"{stored.place}: {p.name} is {p.value!r}, and {float(values[p.name])!r} in the model: the files belong to different "
                "fits; restore the folder, or fit again"
            )


def _covariance(stored: Stored, p: int) -> np.ndarray:
    rows = stored.listed("covariance")
    fits = lambda row: isinstance(row, list) and len(row) == p and all(v is None or is_number(v) for v in row)
    if len(rows) != p or not all(map(fits, rows)):
        raise DataError(
            f"{stored.place}: 'covariance' is not a table of {p} by {p} numbers; restore the file, or fit again"
        )
    table = np.array(rows, dtype=float).reshape(p, p)
    if (np.diag(table) < 0).any():
        raise DataError(f"{stored.place}: 'covariance' has a negative variance; restore the file, or fit again")
    return table


def _metrics(stored: Stored | None) -> Metrics | None:
    if stored is None:
        return None
    # Null where the simulation is not finite.
    sizes = {name: stored.get(name, float | None) for name in ("rmse", "max_error")}
    return stored.read(Metrics, **{name: np.nan if size is None else size for name, size in sizes.items()})


def _baselines(verdict: Stored, of: str) -> Baselines | None:
    stored = verdict.optional_part(of)
    return None if stored is None else stored.part("baselines").read(Baselines)


def _provenance(stored: Stored) -> dict[str, Any]:
    """Kept for people as it is, once the report's own lines are found to have their types."""
    for key in ("date", "python"):
        stored.get(key, str)
    stored.mapping("versions", str)
    stored.get("seed", int | None)
    for k, record in enumerate(stored.listed("records")):
        part = Stored(record, f"{stored.place}: records {k}")
        for key in ("name", "source", "data_sha256"):
            part.get(key, str)
        part.get("file_sha256", str | None)
    return stored.content
