"""A model in a comparison, with what is known of it so far."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

from hystfit.fitting.comparison.compared_models import MARGIN, Row
from hystfit.fitting.comparison.sizes import SizeSearch
from hystfit.fitting.fit_model import Solved
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Note
from hystfit.results.result import FitResult


class First(NamedTuple):
    """The first fit of a model: its rms error [y], on held-out data where it has elements to choose, and its number of parameters.

    `model` has the best of these elements; `lowered` is the least part of the error that a fit may leave of it; `handicap` the
    factor by which its error counts for more, if its fit converges.
    """

    error: float
    parameters: int
    model: AbstractHysteresis | None = None
    lowered: float = 1 / MARGIN
    handicap: float = 1.0

    @property
    def ranked(self) -> float:
        """The error by which it ranks."""
        return self.error * self.handicap

    def left_by(self, error: float) -> float:
        """Part of its error that a fit with an error [y] leaves."""
        return error / self.error if error < self.error else 1.0


@dataclasses.dataclass
class Candidate:
    """A model in a comparison, with the results so far.

    It has a row once it is validated, stopped, or has failed. `solved` is the fit without standard errors, `result` its verdict, `choices`
    are notes on its choices, `started` models with starting values from the records, the best first, where they are those of its fit too,
    `screened` its fit to some of the records, and `seconds` the time of its fits and validation.
    """

    name: str
    row: Row | None = None
    solved: Solved | None = None
    sizes: SizeSearch | None = None
    choices: tuple[Note, ...] = ()
    result: FitResult | None = None
    first: First | None = None
    failure: Exception | None = None
    started: tuple[AbstractHysteresis, ...] = ()
    screened: FitResult | None = None
    seconds: float = 0.0


def leader(waiting: Sequence[Candidate], equal: float = 1.0) -> Candidate | None:
    """The next to validate, as it may stop others: the smallest within the ratio `equal` of the least first error; None without one."""
    firsts = [(one, one.first) for one in waiting if one.first is not None]
    most = equal * min((first.ranked for _, first in firsts), default=0.0)
    alike = [(one, first) for one, first in firsts if first.ranked <= most]
    return min(alike, key=lambda pair: (pair[1].parameters, pair[1].ranked), default=(None,))[0]
