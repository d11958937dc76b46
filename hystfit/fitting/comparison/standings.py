"""The models of a comparison that are done, and what they tell of the others: which can win still, and whether noise is left."""

from __future__ import annotations

import functools

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.fitting.comparison.compared_models import Purpose, Row, handicap
from hystfit.fitting.comparison.sizes import weights_of
from hystfit.fitting.judgment.verdict import are_white, may_be_noise, residuals_are_white, stands_out
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import make_model
from hystfit.models.shared.starting import output_range
from hystfit.outcome import Status
from hystfit.quality.held_out import AT_ONE_PACE, HeldOut, correlation_length, equal_errors, held_out
from hystfit.quality.summary import paces
from hystfit.results.result import FitResult


class Standings:
    """Rows and fits of the models that are done, and which of these are validated.

    Models that do not serve `purpose` stop no others; with `all_validated` every model is, however poor its fit: the user chose them.
    """

    def __init__(self, data: Dataset, purpose: Purpose, *, all_validated: bool):
        self.data, self.purpose, self.all_validated = data, purpose, all_validated
        self.one_pace = paces(data) < 2
        self.rows: list[Row] = []
        self.fits: dict[str, FitResult] = {}
        self._correlated: dict[str, int] = {}  # samples over which the residuals of a fit are correlated

    def add(self, row: Row, fit: FitResult | None = None) -> None:
        """Add a model, with its fit if it was validated."""
        self.rows.append(row)
        if fit is not None:
            self.fits[row.asked] = fit
            self._correlated[row.asked] = correlation_of(fit)

    def clear(self) -> None:
        """Forget all models."""
        self.rows, self.fits, self._correlated = [], {}, {}

    # -- the error to beat --

    @property
    def best(self) -> float | None:
        """The smallest error on held-out data so far, of models that serve the purpose [percent of range]."""
        return min((row.score_percent for row in self._rivals if row.score_percent is not None), default=None)

    @property
    def least(self) -> float | None:
        """The smallest error so far by which a model ranks, of those that serve the purpose [percent of range]."""
        return min((row.ranked_percent for row in self._rivals if row.ranked_percent is not None), default=None)

    @property
    def _rivals(self) -> list[Row]:
        return [row for row in self.rows if self.purpose == "prediction" or row.serves(self.purpose)]

    @property
    def best_row(self) -> Row | None:
        """The row of the fit with the smallest error on held-out data so far, which a `paced` one must have by far."""
        error = lambda row: row.score / (AT_ONE_PACE if row.paced else 1.0)
        return min((row for row in self.rows if row.asked in self.fits), key=error, default=None)

    @property
    def equal(self) -> float:
        """Ratio of errors on held-out samples up to which models are not told apart."""
        samples = sum(int(record.used.sum()) for record in self.data)
        return equal_errors(samples, 1 if (best := self.best_row) is None else self._correlated[best.asked])

    def most(self, status: Status, model: AbstractHysteresis) -> float:
        """The error on held-out data above which a model with this status cannot win [percent of range]."""
        least = None if self.all_validated else self.least
        return float("inf") if least is None else self.equal * least / self.handicap(status, model)

    def handicap(self, status: Status, model: AbstractHysteresis) -> float:
        """Factor by which the error of a model counts for more."""
        return handicap(status, model.has_inverse, self.paced(model))

    def paced(self, model: AbstractHysteresis) -> bool:
        """See `Row.paced`."""
        return self.one_pace and not model.rate_independent

    def may_win(self, name: str) -> bool:
        """Whether a model that leaves nothing but the noise of the output could win."""
        return 100 * self.noise / self.span < self.most(Status.OK, make_model(name))

    @property
    def noise(self) -> float:
        """Rms noise of the output, 0 where it is not known [y]."""
        return max((fit.baselines.noise or 0.0 for fit in self.fits.values()), default=0.0)

    def is_noise(self, error: float) -> bool:
        """Whether an rms error [y] is not told from the noise of the output, below which no model errs."""
        return error <= self.equal * self.noise

    # -- what the best model leaves --

    def is_white(self, *, paced: bool | None = False) -> bool:
        """Whether the best model leaves only noise; `paced` also requires `Row.paced` of it to be this, None does not."""
        best = self.best_row
        return best is not None and best.leaves_noise and paced in (None, best.paced)

    def is_settled(self) -> bool:
        """Whether the best model leaves white residuals as small as the noise of the output."""
        best = self.best_row
        return best is not None and self.is_white() and self.is_noise(best.score / 100 * self.span)

    def shows_no_loop(self, names: tuple[str, ...]) -> bool:
        """Whether the best model leaves white residuals, and no loop worth the parameters of these models."""
        best = self.best_row
        if best is None or not names:
            return False
        return without_loop(self.fits[best.asked], min(weights_of(make_model(name)) for name in names))

    def overfits(self) -> bool:
        """Whether the best model errs more on held-out samples than on those that it was fitted to."""
        best = self.best_row
        fitted = None if best is None else best.in_sample_percent
        return best is not None and fitted is not None and best.score > self.equal * fitted

    # -- the records --

    @functools.cached_property
    def held(self) -> HeldOut:
        """The groups that are held out in turn."""
        return held_out(list(self.data))

    @functools.cached_property
    def all_held(self) -> bool:
        """Whether all samples are held out in turn: only then the error on held-out samples is that of all."""
        return all((fold >= 0)[record.used].all() for fold, record in zip(self.held.folds, self.data, strict=True))

    @functools.cached_property
    def span(self) -> float:
        """Range of the output [y]."""
        return output_range(self.data).width


def correlation_of(fit: FitResult) -> int:
    """Samples over which the residuals of a fit are correlated."""
    return max(map(correlation_length, residuals_of(fit)))


def residuals_of(fit: FitResult) -> list[np.ndarray]:
    """Prediction less measurement at the samples of each record that count [y]."""
    return [row[used] for row, used in zip(fit.problem.residuals(fit.x), fit.problem.used, strict=True)]


def leaves_noise(fit: FitResult, parameters: float) -> bool:
    """Whether the residuals of a fit are white, and its loop stands out of them, worth the parameters that the data determine."""
    return may_be_noise(fit.train.rmse, fit.baselines) and residuals_are_white(
        residuals_of(fit), fit.baselines.curve, parameters
    )


def without_loop(fit: FitResult, parameters: int) -> bool:
    """Whether the residuals of a fit are white, and no loop that takes as many parameters or more stands out of them."""
    rows = residuals_of(fit)
    return (
        may_be_noise(fit.train.rmse, fit.baselines)
        and are_white(rows)
        and not stands_out(rows, fit.baselines.curve, parameters)
    )
