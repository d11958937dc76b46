"""What kind of loops records show: models with a term and without it, compared by their errors on held-out samples."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import HystfitError
from hystfit.fitting.comparison.candidates import candidates
from hystfit.fitting.comparison.compared_models import Row
from hystfit.fitting.fit_setup import without_faults
from hystfit.fitting.solvers.ridge import LinearSystem, fit_ridge, linear_positions
from hystfit.fitting.solvers.thinning import thinned
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import SEARCH, make_model
from hystfit.models.self_similar import POWERS, SelfSimilarStops
from hystfit.models.springpot import Springpot
from hystfit.models.viscoelastic import Viscoelastic
from hystfit.quality.baselines import Baselines
from hystfit.quality.check import Trait
from hystfit.quality.held_out import equal_errors
from hystfit.quality.loops import clear_reversals
from hystfit.quality.summary import paces

_OF_TIME = ("viscoelastic", "rate-dependent")
_STATIC = (
    "prandtl-ishlinskii",
    "prandtl-ishlinskii-stop",
    "prandtl-ishlinskii-hardening",
)  # scored beside what the search took


def traits(data: Dataset, rows: Sequence[Row], baselines: Baselines) -> tuple[Trait, ...]:
    """The trait of the best model, if its error is smaller than those of all models without that trait and of a curve.

    The difference must be larger than what as many errors as the records have branches leave open. Traits of time need branches of several
    durations.

    Args:
        rows: of a comparison.
    """
    short = thinned(without_faults(data))
    validated = [row for row in rows if row.score_percent is not None]
    scores: list[_Score] = [
        (row.score * baselines.span / 100, row.name, _kind(make_model(row.name))) for row in validated
    ]
    scores.append((baselines.curve, "a single-valued curve", ""))
    known = {name for row in validated for name in (row.name, row.asked)}
    for name in dict.fromkeys((*_STATIC, *candidates(data).closed)):
        if name != SEARCH and name not in known:
            scores += _scored(name, short)
    branches = sum(clear_reversals(record.u).size + 1 for record in short)
    left_out = {None} if paces(data) > 1 else {None, *_OF_TIME}
    (error, name, kind), (other, rival, _) = _first_two(scores, left_out)
    equal = equal_errors(branches)
    if kind == "" or error * equal >= other:
        return ()
    percent = lambda value: float(100 * value / baselines.span)
    found = [Trait(kind, name, percent(error), rival, percent(other))]
    for term, words, without in _counterparts(name, short) if kind == "degrading" else ():
        if error * equal < without:
            found.append(Trait(term, name, percent(error), f"{name} {words}", percent(without)))
    return tuple(found)


_Score = tuple[float, str, str | None]  # error on held-out samples, name and trait of a model


def _first_two(scores: Sequence[_Score], left_out: set[str | None]) -> tuple[_Score, _Score]:
    """The best model, and the best of those with another trait; those with some traits are left out."""
    scores = [score for score in scores if score[2] not in left_out]
    first = min(scores)
    return first, min((score for score in scores if score[2] != first[2]), default=first)


def _kind(model: AbstractHysteresis) -> str | None:
    """The trait that a model has a term for; "" for static loops without damage, None where creep accounts for its time."""
    parts = getattr(model, "parts", (model,))
    if model.without_creep() is not None:
        return None
    if any(isinstance(part, (Springpot, Viscoelastic)) for part in parts):
        return "viscoelastic"
    return "degrading" if model.degrades else "" if model.rate_independent else "rate-dependent"


def _scored(name: str, short: Dataset) -> list[_Score]:
    """Error, name and trait of a model at its starting values; nothing where it cannot be solved for."""
    try:
        model = make_model(name).start(list(short))
        return [(_error(model, short), name, _kind(model))]
    except (HystfitError, np.linalg.LinAlgError):
        return []


def _counterparts(name: str, short: Dataset) -> Iterator[tuple[str, str, float]]:
    """Traits of self-similar stops, the same model without the term for each, in words, and its error; none of another model."""
    model = make_model(name).start(list(short))
    if isinstance(model, SelfSimilarStops):
        largest = max(float(np.max(np.abs(record.u))) for record in short)
        unscaled = _error(dataclasses.replace(model, floor=largest), short)
        yield "peak-oriented", "over the largest input of the record", unscaled
        yield "pinched", "with branches that only soften", float(fit_ridge(without_slip(Problem(model, short))).score)


def _error(model: AbstractHysteresis, data: Dataset) -> float:
    """Root mean square error on held-out samples, weights solved for [y]."""
    problem = Problem(model, data)
    return float(fit_ridge(LinearSystem.of(problem, problem.space.vector(problem.model))).score)


_BENT = [power for power in POWERS if power > 1]


def without_slip(problem: Problem) -> LinearSystem:
    """The linear system of self-similar stops whose branches at one peak can only soften.

    A pinched branch is soft near zero input and stiffens towards the last peak: the device slips until the gap of the last peak is
    closed. Stops do so by negative weights, and self-similar stops by powers of u over its peak too. Here the weights of the stops are
    >= 0, and the powers above one are of u itself: a spring that hardens makes no slip that grows with the peak.

    Args:
        problem: of `SelfSimilarStops` alone.
    """
    system = LinearSystem.of(problem, problem.space.vector(problem.model))
    names = [problem.space.names[k] for k in linear_positions(problem)]
    stops, powers = problem.model.w.shape[-1], len(POWERS)  # type: ignore[attr-defined]
    bent = {f"c[{peak},{k}]" for peak in range(problem.model.peaks.size) for k in range(1, powers)}  # type: ignore[attr-defined]
    bent |= {f"fading[{stops + k}]" for k in range(1, powers)}
    kept = np.array([name not in bent for name in names])
    softening = np.array([name.startswith("w[") for name in names])
    spring = _spring(list(problem.data))
    added = np.ones(spring.shape[1], dtype=bool)
    return dataclasses.replace(
        system,
        columns=np.hstack([system.columns[:, kept], spring]),
        free=np.append((system.free & ~softening)[kept], added),
        ridged=np.append(system.ridged[kept], added),
    )


def _spring(records: Sequence[Record]) -> np.ndarray:
    """Odd powers of the input over its largest value, weighted, on the samples that count, shape (n, powers)."""
    largest = max(float(np.max(np.abs(record.u))) for record in records)
    places = ((record.u[record.used] / largest, record.weight[record.used]) for record in records)
    return np.concatenate([np.sqrt(weight)[:, None] * v[:, None] ** np.array(_BENT) for v, weight in places])
