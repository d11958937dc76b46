"""`identify`: from data and the name of an identifier to an identification, and its form as a fit."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from hystfit.config import verb
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import ModelError, ParameterError
from hystfit.identify.registry import IDENTIFIERS
from hystfit.inference.autocorrelation import autocorrelation_time
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.models.duhem import Duhem
from hystfit.models.shared.simulation import simulate
from hystfit.outcome import Code, Note, Status, WithStatus
from hystfit.outcome.note import warn
from hystfit.params.space import ParameterSpace
from hystfit.quality.baselines import Baselines
from hystfit.results.accuracy import Metrics, accuracy_note, exceeded_limits
from hystfit.results.estimates import NoiseEstimate, ParameterEstimate, parameter_estimates
from hystfit.results.provenance import Stopwatch, provenance
from hystfit.results.result import FitResult


@dataclasses.dataclass(frozen=True)
class Identification(WithStatus):
    """The result of `AbstractIdentifier.fit`.

    Attributes:
        method: name of the identifier.
        data: the records, R of them.
        models: identified model for each record; empty where the parameters are not a valid model.
        space: the identified parameters by name; None without a valid model.
        x: their values, shape (len(space),); empty without a valid model.
        names: of the columns of `history`.
        history: physical parameters after every sample of all records and passes, shape (T, p).
        theta_history: parameter vector of the identifier after every sample, shape (T, p).
        errors: one-step prediction error before each sample was used [y], shape (T,); NaN where it was not used.
        equation_error: RMS one-step error of the final parameters [y]; None where it is unknown or not finite.
        free_run: error of the final models driven by the input only; None where there is none.
        counts: numbers of samples: "total", "used", "missing" (no output), "still" (the input did not move), and
            "first" (of a record or pass).
        status: `advice` is the remedy.
        notes: findings with their remedies.
        state: final state of the identifier, from which `update` can continue.
    """

    method: str
    data: Dataset
    models: tuple[AbstractHysteresis, ...]
    space: ParameterSpace | None
    x: np.ndarray
    names: tuple[str, ...]
    history: np.ndarray
    theta_history: np.ndarray
    errors: np.ndarray
    equation_error: float | None
    free_run: Metrics | None
    counts: dict[str, int]
    status: Status
    notes: tuple[Note, ...]
    state: Any
    verb: ClassVar[str] = "identify"

    def __repr__(self) -> str:
        values = ", ".join(f"{p.name} {p.value:.5g} {p.unit}".rstrip() for p in self.parameters)
        error = (
            "no simulation"
            if self.free_run is None
            else f"simulation error {self.free_run.nrmse_percent:.3g} % of range"
        )
        return f"<Identification by {self.method}, {self.status}: {values}; {error}>"

    @property
    def model(self) -> AbstractHysteresis | None:
        """Identified model for the first record; None where the parameters are not a valid model."""
        return self.models[0] if self.models else None

    @property
    def theta(self) -> np.ndarray:
        """Final parameter vector of the identifier, shape (p,)."""
        return self.theta_history[-1]

    @property
    def parameters(self) -> tuple[ParameterEstimate, ...]:
        """Free and fixed parameters, without standard errors: one-step residuals are correlated.

        Without a valid model, the identified values that are finite.
        """
        if self.space is None:
            return tuple(
                ParameterEstimate(name, float(value), None, "", None, None, False, None, None)
                for name, value in zip(self.names, self.history[-1], strict=True)
                if np.isfinite(value)
            )
        return parameter_estimates(self.space, self.x)

    def predict(self) -> list[np.ndarray]:
        """Output of the final models driven by the input only, one array (T_r,) a record; empty without a valid model."""
        return free_runs(self.models, self.data)


def free_runs(models: tuple[AbstractHysteresis, ...], data: Dataset) -> list[np.ndarray]:
    """Output of each record's model driven by the input only, one array (T_r,) a record; empty without models."""
    pairs = zip(models, data, strict=True) if models else ()
    return [np.asarray(simulate(model, r.u, None if r.t is None else r.dt)[0]) for model, r in pairs]


def run_metrics(runs: list[np.ndarray], data: Dataset) -> Metrics:
    """Errors of runs, one array (T_r,) a record, over the samples that count."""
    return Metrics.of([r.y[r.used] for r in data], [run[r.used] for run, r in zip(runs, data, strict=True)])


def as_fit(identification: Identification, seed: int, watch: Stopwatch) -> FitResult:
    """The identification as a fit without standard errors; the `watch` was started with it.

    Raises:
        ModelError: the identified parameters are not a valid model, or its simulation is not finite.
    """
    method, data, space = identification.method, identification.data, identification.space
    advice = identification.advice
    if space is None or identification.free_run is None:
        reasons = "; ".join((advice, *map(str, identification.notes)))
        raise ModelError(f"{method} found no usable model: {reasons}")
    notes = [
        Note(
            Code.SEQUENTIAL,
            "errors and metrics are those of a simulation; a sequential method gives no standard errors",
        ),
        *identification.notes,
    ]
    if any(record.sigma is not None for record in data):
        text = f"{method} counts all samples alike: the standard deviations of the output are not used"
        notes.append(warn(Code.WEIGHTED, text))
    models = list(identification.models)
    free = list(dict.fromkeys(name.partition("@")[0] for name in space.names))
    problem = Problem(models[0], data, fix=[name for name, _, _ in space.fixed()], free=free)
    residuals = [(y - r.y)[r.used] for y, r in zip(identification.predict(), data, strict=True)]
    baselines = Baselines.of(data)
    rough = []
    if identification.usable:
        rough = [warn(Code.ROUGH_FIT, text) for text in exceeded_limits(identification.free_run, residuals, baselines)]
    status = Status.ROUGH if rough else identification.status
    notes += [*rough, accuracy_note(identification.free_run, residuals, baselines, "simulation error")]
    correlation = max(autocorrelation_time(r) for r in residuals)
    compile_s, run_s = watch.read()
    return FitResult(
        problem=problem,
        x=identification.x,
        status=status,
        notes=tuple(notes),
        parameters=identification.parameters,
        covariance=np.full((len(problem.space), len(problem.space)), np.nan),
        train=identification.free_run,
        test=None,
        sigma=identification.free_run.rmse,
        correlation_time=correlation,
        error_ratio=float(np.sqrt(correlation)),
        rank=None,
        condition=None,
        method=method,
        starts=1,
        in_best_basin=1,
        compile_s=compile_s,
        run_s=run_s,
        noise=NoiseEstimate("auto"),
        baselines=baselines,
        provenance=provenance(data, seed, samples=identification.counts),
    )


@verb
def identify(
    data: Record | Dataset | Sequence[Record],
    method: Any = "rls",
    model: Any = None,
    *,
    passes: int = 1,
    **settings: Any,
) -> Identification:
    """Identify a model sample by sample.

    Args:
        data: one record or several, run one after another.
        method: name of an identifier ("rls", "gradient-correction", "ukf"), my_file.py:MyIdentifier, or a class.
        model: gives the orders, the scheme and, with start="model", the starting values; a `Duhem` with f of order 3 and g
            of order 2 by default.
        passes: number of runs over the data.
        **settings: of the identifier, see `Rls.of`, `GradientCorrection.of` and `Ukf.of`.

    Raises:
        HystfitError: an unknown method or setting, a model that the method cannot identify, or unusable data.
    """
    identifier = IDENTIFIERS.find(method)
    known = [name for name in inspect.signature(identifier.of).parameters if name not in ("model", "data")]  # type: ignore[attr-defined]
    unknown = [name for name in settings if name not in known]
    if unknown:
        raise ParameterError(f"method {method!r} has no setting {unknown[0]!r}; it has {', '.join(known) or 'none'}")
    data = Dataset.of(data)
    return identifier.of(Duhem() if model is None else model, data, **settings).fit(data, passes=passes)  # type: ignore[attr-defined]
