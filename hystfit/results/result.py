"""The result of a fit: a value with a status, errors, notes on what the data determine, and its problem."""

from __future__ import annotations

import dataclasses
import functools
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import ModelError, ParameterError, optional
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Code, Note, Status, WithStatus
from hystfit.outcome.note import has
from hystfit.quality.baselines import Baselines
from hystfit.registry import attribute, near
from hystfit.results.accuracy import Metrics
from hystfit.results.estimates import NoiseEstimate, ParameterEstimate, edges_of
from hystfit.results.fitted_model import FittedModel
from hystfit.results.measured.loop_values import LoopValues, quantities
from hystfit.results.measured.quantities import QuantityEstimate


@dataclasses.dataclass(frozen=True)
class FitResult(FittedModel, WithStatus):
    """A fitted model, its errors, and the problem that it solved.

    Attributes:
        problem: model, records, free parameters and loss, for further computations.
        x: estimate of the free parameters, physical units, shape (p,).
        status: only `Status.OK` is usable without reservation.
        notes: what is not determined, which bounds were reached, what was chosen.
        parameters: free and fixed ones.
        covariance: of the free parameters, shape (p, p), NaN where it is undefined; `free_names` is their order.
        joint: the same including undetermined parameters, for quantities that combine them; NaN for parameters without influence. None for
            sequential methods.
        train: metrics on the fitted samples; `test`: on test records, or None.
        sigma: standard deviation of the residuals [y].
        correlation_time: integrated autocorrelation time of the residuals, samples.
        error_ratio: ratio of the reported standard errors to those for i.i.d. residuals.
        rank, condition: of the relative Jacobian; None if it was not computed.
        method: the estimator's name; `starts` and `in_best_basin`, how many starts and how many of them agree.
        compile_s, run_s: seconds that the fit spent compiling and running; None where it was not measured.
        noise: noise model of the standard errors.
        baselines: errors of simple descriptions (line, curve, ten plays); `test_baselines` on the test records, None without any.
        left_out: cross-validation error [y]; None where it is unknown.
        provenance: versions, seed, data checksums, date; never read back.
    """

    problem: Problem
    x: np.ndarray
    status: Status
    notes: tuple[Note, ...]
    parameters: tuple[ParameterEstimate, ...]
    covariance: np.ndarray
    train: Metrics
    test: Metrics | None
    sigma: float
    correlation_time: float
    error_ratio: float
    rank: int | None
    condition: float | None
    method: str
    starts: int
    in_best_basin: int
    compile_s: float | None
    run_s: float | None
    noise: NoiseEstimate
    baselines: Baselines
    provenance: dict[str, Any]
    test_baselines: Baselines | None = None
    left_out: float | None = None
    joint: np.ndarray | None = None

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of `x`."""
        return self.problem.space.names

    @property
    def advice(self) -> str:
        """What to do about the status, in one sentence."""
        if self.status is Status.NO_LOOP and any(self.measured.rows.values()):
            return "there is no loop to fit: use the quantities that are read off the curve, and no model"
        return super().advice

    @property
    def device(self) -> AbstractHysteresis:
        """The fitted model, as that of one device.

        Raises:
            ModelError: its parameters depend on covariates, which have not been chosen by `at`.
        """
        if not self.problem.settled:
            names = ", ".join(f"{name}=..." for name in self.model.covariates)
            raise ModelError(
                f"the parameters depend on {' and '.join(self.model.covariates)}: choose values, result.at({names})"
            )
        return self.model

    @functools.cached_property
    def derived(self) -> tuple[ParameterEstimate, ...]:
        """Quantities that follow from the parameters (stiffnesses of the oscillator), with standard errors to first order."""
        return _view("quantity_estimates:derived_estimates")(self)

    @functools.cached_property
    def quantities(self) -> tuple[QuantityEstimate, ...]:
        """Engineering quantities (coercivity, remanence, loss per cycle, hysteresis in percent, ...), with standard errors.

        The units of the records and the model decide which are computed: see `hystfit.results.measured.quantities`. None without a loop.
        """
        if self.status is Status.NO_LOOP:
            return ()
        return _view("quantity_estimates:quantity_estimates")(self)

    @functools.cached_property
    def measured(self) -> LoopValues:
        """Quantities read off the measured loops of every record, without the model."""
        return quantities(self.data)

    @functools.cached_property
    def answer(self) -> tuple[tuple[str, str], ...]:
        """Names and values at the top of the report, the most important first."""
        return _view("report.answer:numbers_of")(self)

    @property
    def verb(self) -> str:
        """Which advice on the status applies: that for sequential identification, or for a fit."""
        return "identify" if has(self.notes, Code.SEQUENTIAL) else "fit"

    def __getitem__(self, name: str) -> ParameterEstimate:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        names = [p.name for p in self.parameters]
        raise KeyError(f"no parameter {name!r}{near(name, names)}; there are {names}")

    @property
    def values(self) -> dict[str, float]:
        """Values of all parameters by name, free and fixed, in physical units (`units` has those of the data)."""
        return {parameter.name: parameter.value for parameter in self.parameters}

    @property
    def units(self) -> dict[str, str]:
        """Units of the input u, the output y and the time t; predictions are in that of y."""
        return self.data.units

    @functools.cached_property
    def residuals(self) -> np.ndarray:
        """Measured minus simulated output [y], shape (T,), NaN where a sample does not count; several records one after another."""
        rows = [np.where(record.used, record.y - self.predict(record), np.nan) for record in self.data]
        return np.concatenate(rows)

    def confidence_intervals(self, level: float = 0.95) -> dict[str, tuple[float, float] | None]:
        """Lower and upper limit of every free parameter from its standard error; None where it has no standard error.

        The estimate is assumed to be normally distributed. `hystfit.profile` gives limits without this assumption.

        Args:
            level: probability with which such an interval covers the parameter.

        Raises:
            ParameterError: the level is not between 0 and 1.
        """
        reach = statistics.NormalDist().inv_cdf(edges_of(level)[-1])
        free = [p for p in self.parameters if not p.fixed]
        return {
            p.name: None if p.stderr is None else (p.value - reach * p.stderr, p.value + reach * p.stderr) for p in free
        }

    def to_dataframe(self) -> Any:
        """The parameters as a pandas data frame with one row for each, indexed by name; unknown values are missing.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        pandas = optional("pandas", "frames", "to_dataframe")
        rows = [{"name": p.name, **p.to_dict(), "doc": p.doc} for p in self.parameters]
        numbers = dict.fromkeys(("value", "stderr", "lower", "upper"), float)
        return pandas.DataFrame(rows).set_index("name").astype(numbers)

    def to_xarray(self) -> Any:
        """Parameters, covariance and predictions as an xarray data set; see `hystfit.results.exchange`.

        Raises:
            MissingExtraError: xarray is not installed.
        """
        return _view("exchange:to_xarray")(self)

    def save_mat(self, path: str | Path) -> Path:
        """Write parameters, errors and predictions as a MATLAB file; see `hystfit.results.exchange`.

        Raises:
            HystfitError: the file cannot be written.
        """
        return _view("exchange:write_mat")(self, path)

    def with_notes(self, *notes: Note, first: bool = False) -> FitResult:
        """The same result with further notes, at the end or first."""
        return dataclasses.replace(self, notes=(*notes, *self.notes) if first else (*self.notes, *notes))

    def at(self, **covariates: float) -> FitResult:
        """The same fit where its covariates have other values: invert it, export it, predict with it.

        Args:
            **covariates: all of them by name, `result.at(T_degC=30)`.

        Raises:
            DataError: a covariate without a value.
            ParameterError: the fit has no such covariate.
        """
        known = self.model.covariates
        if unknown := sorted(set(covariates) - set(known)):
            raise ParameterError(f"the fit has no covariate {unknown[0]!r}; it has: {', '.join(known) or 'none'}")
        stated = {name: repr(float(value)) for name, value in covariates.items()}
        one = self.data[0].replace(metadata=stated, name="at", source="")
        return dataclasses.replace(self, problem=self.problem.at(self.model.of_record(one)))

    @property
    def settled(self) -> FitResult:
        """The same fit at the covariates of the first record, where none have been chosen by `at`."""
        return self if self.problem.settled else dataclasses.replace(self, problem=self.problem.at(self.model))

    def to_dict(self) -> dict[str, Any]:
        """The contents of `result.json`; unknown values are null, and so is the covariance of more than 200 parameters.

        `save` stores that covariance in records.npz: as text, it takes a hundred megabytes for two thousand parameters.
        """
        return _view("saving.stored_fit:content_of")(self)

    def save(self, folder: str | Path, *, report: bool = True) -> Path:
        """Write result.json, model.json, the records (records.npz), the report and its pictures into a folder; all or none.

        manifest.json has the SHA-256 of the files from which `load_fit` makes the same result.

        Args:
            folder: made if it is not there; its parent must be.
            report: draw the pictures and write the HTML page too.

        Raises:
            HystfitError: the folder cannot be made or written.
        """
        return _view("saved:save_fit")(self, folder, report=report)

    def report(self) -> str:
        """The report as text."""
        return _view("report:text_report")(self)

    def __str__(self) -> str:
        return self.report()

    def __repr__(self) -> str:
        headline = _view("report:headline")(self)
        return f"<FitResult: {headline}; print it for the report>"

    def _repr_html_(self) -> str:
        return _view("report:notebook_view")(self)

    def plot(
        self,
        kind: str = "loop",
        ax: Any = None,
        *,
        data: Record | Dataset | Sequence[Record] | None = None,
        refit_offset: bool = False,
    ) -> Any:
        """A picture of the fit, of the fitted records or of others; returns the axes.

        Args:
            kind: one of `hystfit.plots.KINDS`.
            ax: axes to draw on; new ones by default.
            data: other records than those fitted.
            refit_offset: as in `predict`.
        """
        return _view("plots:fit")(self, kind, ax=ax, data=data, refit_offset=refit_offset)


def _view(name: str) -> Any:
    """A function in another module of this room, imported when it is called, because that module imports this one."""
    return attribute(f"hystfit.results.{name}")
