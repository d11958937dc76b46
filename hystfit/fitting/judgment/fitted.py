"""What a verdict on a fit is based on: the problem, where the fit ended, its residuals, and what is measured on its records."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.fitting.solvers.estimate import Estimate
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.quality.baselines import Baselines
from hystfit.quality.record_quality import RecordQuality
from hystfit.quality.summary import may_change, summarize
from hystfit.results.accuracy import Metrics


@dataclasses.dataclass(frozen=True)
class Fitted:
    """The data on which a verdict is based.

    `train` is the error of the fit, and `rows` are the residuals of each record, samples that count only [y]; `usual` is the method that
    the model takes by default. A `thorough` verdict searches the records for damage and drift, which takes longer than many a fit.
    """

    problem: Problem
    model: AbstractHysteresis
    estimate: Estimate
    train: Metrics
    rows: Sequence[np.ndarray]
    baselines: Baselines
    method: str
    usual: str
    thorough: bool = True

    @property
    def data(self) -> Dataset:
        """The records."""
        return self.problem.data

    @property
    def percent(self) -> float:
        """RMS error in percent of the output's range."""
        return np.inf if self.train.nrmse_percent is None else self.train.nrmse_percent

    @functools.cached_property
    def qualities(self) -> tuple[RecordQuality, ...]:
        """What is measured on each record; it takes longer than many a fit."""
        return tuple(summarize(record) for record in self.parts)

    @functools.cached_property
    def may_change(self) -> bool:
        """Whether some output may drift or some device degrade, so that `qualities` are worth their time."""
        return self.thorough and any(may_change(record) for record in self.parts)

    @functools.cached_property
    def parts(self) -> tuple[Record, ...]:
        """Each record from its first to its last sample that counts: the verdict does not depend on what lies outside a window.

        A record of which a single sample counts, such as the first of many reversal curves, has none.
        """
        counted = [(record, np.flatnonzero(record.used)) for record in self.data]
        return tuple(
            record if at[-1] - at[0] + 1 == len(record) else record.segment(int(at[0]), int(at[-1]) + 1)
            for record, at in counted
            if at.size > 1
        )
