"""What a fitted model says of records: its predictions, their errors, and what they assume."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError, ModelError
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis, Use
from hystfit.models.registry import model_name
from hystfit.models.varying import beyond_range
from hystfit.outcome import Code, Note, Severity
from hystfit.outcome.note import warn
from hystfit.params.units import conversion
from hystfit.reading.in_memory import excitation_of, records_of
from hystfit.results.accuracy import Metrics


class FittedModel:
    """A model at the estimate `x` of the parameters of a problem, over the records fitted and others."""

    problem: Problem
    x: np.ndarray

    @property
    def data(self) -> Dataset:
        """The records fitted."""
        return self.problem.data

    @functools.cached_property
    def models(self) -> tuple[AbstractHysteresis, ...]:
        """The fitted model of each record; they share all but per-record parameters."""
        return tuple(self.problem.space.assembled(self.x, k) for k in range(len(self.data)))

    @functools.cached_property
    def model(self) -> AbstractHysteresis:
        """The fitted model, of the type that went in; with several records, that of the first."""
        return self.problem.space.assembled(self.x)

    @property
    def name(self) -> str:
        """The model's readable name."""
        return model_name(self.model)

    @functools.cached_property
    def _simulated(self) -> list[np.ndarray]:
        """Output of the model on every record fitted, by the program that the fit has compiled."""
        return self.problem.predict(self.x)

    def is_fitted(self, record: Record) -> bool:
        """Whether a record is one of those fitted, by its name."""
        return record.name in [fitted.name for fitted in self.data]

    def record_number(self, record: Record) -> int:
        """Whose per-record parameters predict a record: its own where it was fitted, else those of the first record."""
        return [fitted.name for fitted in self.data].index(record.name) if self.is_fitted(record) else 0

    def in_fitted_units(self, record: Record) -> Record:
        """The record in the units of the fitted records, with a note on each unit that was converted or assumed.

        Raises:
            DataError: a unit of another quantity.
        """
        units = self.data.units
        for role, symbol in (("input", "u"), ("output", "y")):
            unit = getattr(record, f"{symbol}_unit")
            if unit and not units[symbol]:
                text = f"the {role} of the fit has no unit, and that of the record is {unit}: its numbers are used unchanged"
                record = record.noted(Code.UNITS, text, Severity.WARNING)
        return record.in_units(**units)

    def to_unit_of(self, record: Record, y: np.ndarray) -> np.ndarray:
        """Outputs of any shape, converted from the unit of the fit to that of a record; unchanged where a unit is unknown."""
        factor = conversion(self.data.units["y"], record.y_unit) if record.y_unit else None
        return y if factor in (None, 1.0) else factor * y

    def predict(self, data: Any, t: Any = None, *, u: Any = None, refit_offset: bool = False) -> np.ndarray:
        """Simulated output over an input, shape (T,), with the parameters of the record where it was fitted.

        `predict(record)`, `predict(frame)` and `predict(u, t)` are the same for a record, a data frame and arrays. Another record than
        those fitted is predicted with the per-record parameters of the first.

        The prediction is in the unit of the record's output, or in that of the fit where the record has none.

        Args:
            data: any record, a data frame with the input, or the input, shape (T,).
            t: time of each sample, shape (T,), or a column of the data frame; where the model depends on time.
            u: column of the input in a data frame; by default that of the fitted record.
            refit_offset: shift the output so that its mean over the samples that count is right (another record's sensor zero).
        """
        given = excitation_of(data, t, u=u, like=self.data[0])
        record = self.in_fitted_units(given)
        if record.t is None and not self.model.rate_independent:
            raise ModelError(f"{self.name} depends on time: give t, the time of each sample")
        fitted = next((k for k, own in enumerate(self.data) if own is record), None)
        if fitted is not None:
            y = self._simulated[fitted]
        else:
            model = self._model_of(record)
            driven = self.problem.prepared(record)
            # Equinox makes a module for a bound method, which takes longer than a short run.
            y = type(model).free_run(model, driven.u, None if driven.t is None else driven.dt)[-len(record) :]
        if refit_offset:
            if not record.used.any():
                raise DataError(f"record {record.name!r}: no usable output, so that its offset cannot be refitted")
            y = y + float(np.mean((record.y - y)[record.used]))
        return self.to_unit_of(given, y)

    def _model_of(self, record: Record) -> AbstractHysteresis:
        """The model that predicts a record which was not fitted: at its covariates, unless they have been chosen (`at`)."""
        model = self.models[self.record_number(record)]
        return model if self.problem.settled else model.of_record(record)

    def metrics(self, data: Any, *, refit_offset: bool = False) -> Metrics:
        """Metrics of the prediction on the samples that count, in the units of the fit: of records or a data frame."""
        records = [self.in_fitted_units(self.problem.prepared(record)) for record in records_of(data)]
        predicted = [self.predict(record, refit_offset=refit_offset)[record.used] for record in records]
        return Metrics.of([record.y[record.used] for record in records], predicted)

    def assumption(self, record: Record, *, refit_offset: bool = False) -> Note | None:
        """What the prediction of a record, perhaps with `refit_offset`, assumes for parameters of each record; None for nothing."""
        if self.is_fitted(record):
            return None
        first = self.data[0].name
        marked = zip(self.problem.space.names, self.problem.space.infos, self.problem.space.units, self.x, strict=True)
        names = [
            f"{name.partition('@')[0]} = {value:.4g} {unit}".rstrip()
            for name, info, unit, value in marked
            if info.per_record and name.partition("@")[2] in ("", first) and not (refit_offset and info.linear)
        ]
        if not names:
            return None
        text = f"{record.name!r} was not fitted: its prediction uses {', '.join(names)} of {first!r}"
        if record.used.any() and not refit_offset:
            text += "; refit_offset= fits an offset to its output"
        return Note(Code.RECORD_PARAMETERS, text)

    def obstacle(self, use: Use) -> str | None:
        """The reason why the fitted model cannot be inverted or exported to C; None where it can, or where none is known.

        An inverse needs an output that rises, or falls, with the input on every branch within the fitted range.
        """
        text = self.model.obstacle(use)
        if text is not None or use == "export":
            return text
        resonance = self.model.output_resonance()
        inverted = self.model if resonance is None else resonance.model
        slopes = inverted and inverted.slope_range(*self.input_range, self.data.sampling_interval)
        if not slopes or not slopes.mixed:
            return None
        low, high = self.input_range
        u, y = self.data.units["u"], self.data.units["y"]
        unit = f" {y}/{u}" if u and y else ""
        return (
            f"the output does not rise with the input everywhere: over one sample it changes by {slopes.least:.3g} to "
            f"{slopes.most:.3g}{unit} for inputs from {low:.4g} to {high:.4g} {u}".rstrip()
        )

    @property
    def input_range(self) -> tuple[float, float]:
        """Lowest and highest input from the first to the last sample fitted."""
        return min(float(r.reached.min()) for r in self.data), max(float(r.reached.max()) for r in self.data)

    def extrapolation(self, record: Record) -> Note | None:
        """A warning where a record leaves the fitted range of inputs; None where it does not."""
        record = self.in_fitted_units(record)
        low, high = self.input_range
        far = beyond_range(record.u, low, high) & record.used
        beyond = [] if self.problem.settled else self._model_of(record).outside()
        if beyond:
            return warn(Code.EXTRAPOLATION, f"{record.name!r}: {', '.join(beyond)}: the prediction is an extrapolation")
        if not far.any():
            return None
        span = f"{low:.4g} to {high:.4g} {record.u_unit}".rstrip()
        text = (
            f"{far.sum()} of {record.used.sum()} samples of {record.name!r} lie outside the fitted inputs ({span}): the prediction "
            "there is an extrapolation"
        )
        return warn(Code.EXTRAPOLATION, text)
