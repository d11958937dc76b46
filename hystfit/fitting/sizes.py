"""The number and positions of a model's elements, and its state before the records, chosen by the error on left-out data."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.errors import HystfitError
from hystfit.fitting.smooth_weights import left_out_score
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.models.preisach.smooth import SMOOTHNESS
from hystfit.models.registry import model_name
from hystfit.models.starting import output_range
from hystfit.outcome import Code, Note

_COARSE = SMOOTHNESS[::2]
_GAIN = 0.98  # another size is taken only if it lowers the error on left-out data by at least 2 %


@dataclasses.dataclass(frozen=True)
class Sized:
    """A model of a chosen size.

    Attributes:
        model: with the size that predicts left-out data best, or as it was where there is nothing to choose.
        notes: the choice, if there was one.
    """

    model: AbstractHysteresis
    notes: tuple[Note, ...] = ()


def choose_size(
    model: AbstractHysteresis,
    data: Dataset,
    progress: Callable[[str], object] = lambda _: None,
    first: float | None = None,
) -> Sized:
    """Greedy search: repeat the single change of size that lowers the cross-validation error most.

    The weights are solved for at the starting values of the other parameters. `first` is the `first_error` where it is known.
    """
    found = model.sizes(list(data))
    if not found:
        return Sized(model)
    scores: dict[str, float] = {}

    def score(candidate: AbstractHysteresis) -> float:
        name = model_name(candidate)
        if name not in scores:
            progress(name)
            scores[name] = _left_out(candidate, data)
        return scores[name]

    best = next(iter(found.values()))
    if first is not None:
        scores[model_name(best)] = first
    while True:
        words, other = min(best.sizes(list(data)).items(), key=lambda item: score(item[1]))
        if not score(other) < _GAIN * score(best):
            break
        best = other
    words = next(iter(best.sizes(list(data))))
    error = 100 * score(best) / output_range(data).width
    text = f"{words}: the smallest cross-validation error ({error:.2g} % of the range) of {len(scores)} choices"
    return Sized(best, (Note(Code.CHOICE, text),))


def first_error(model: AbstractHysteresis, data: Dataset) -> float | None:
    """Root mean square error on left-out data of the size where `choose_size` starts, output units; None without a choice of size.

    Infinite for a model that cannot be solved for.
    """
    found = model.sizes(list(data))
    return _left_out(next(iter(found.values())), data) if found else None


def _left_out(model: AbstractHysteresis, data: Dataset) -> float:
    """Root mean square error on left-out data, output units; infinite for a model that cannot be solved for."""
    try:
        problem = Problem(model.start(list(data)), data)
        return left_out_score(problem, problem.space.vector(problem.model), _COARSE)
    except (HystfitError, np.linalg.LinAlgError):
        return float("inf")
