"""A model in a comparison, with what is known of it so far."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

from hystfit.fitting.comparison import Row
from hystfit.fitting.fit_model import Solved
from hystfit.fitting.sizes import SizeSearch
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Note
from hystfit.results.result import FitResult

_WAVE = 2  # models that are validated side by side before their errors may stop others


class First(NamedTuple):
    """The first fit of a model: its rms error [y], on held-out data where it has elements to choose, and its number of parameters.

    `model` has the best of these elements.
    """

    error: float
    model: AbstractHysteresis | None = None
    parameters: int | None = None


@dataclasses.dataclass
class Candidate:
    """A model in a comparison, with the results so far.

    Attributes:
        name: of its row.
        row: once it is validated, stopped, or has failed.
        solved: the fit, without standard errors.
        sizes: the search for its size.
        choices: notes on its choices.
        result: its verdict.
        first: the first fit, where there was one.
        failure: why there is no result.
        seconds: time of its fits and validation.
    """

    name: str
    row: Row | None = None
    solved: Solved | None = None
    sizes: SizeSearch | None = None
    choices: tuple[Note, ...] = ()
    result: FitResult | None = None
    first: First | None = None
    failure: Exception | None = None
    seconds: float = 0.0


def contenders(waiting: Sequence[Candidate], equal: float = 1.0) -> list[Candidate]:
    """The models to validate next, because they may stop the others: those with the best first fits, of models with elements first.

    Args:
        waiting: models that are not validated.
        equal: ratio to the smallest error of a first fit up to which that with the fewest parameters goes first.
    """
    firsts = [(one, one.first) for one in waiting if one.first is not None]
    most = equal * min((first.error for _, first in firsts), default=0.0)
    plain = lambda first: (first.error > most, (first.parameters or 0) if first.error <= most else first.error)
    ordered = sorted(firsts, key=lambda pair: (pair[1].model is None, *plain(pair[1])))
    return [one for one, _ in ordered[:_WAVE]]
