"""What a sequential identification gives back: final model, parameter history, one-step and free-run errors, a status."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hystfit.data.record import Dataset
from hystfit.inference.problem import scales_of
from hystfit.models.base import AbstractHysteresis, simulate
from hystfit.params.space import ParameterSpace
from hystfit.results.metrics import Metrics
from hystfit.results.result import ParameterEstimate

if TYPE_CHECKING:
    from hystfit.identify.base import AbstractIdentifier, Info, Sample

ADVICE = {
    "ok": "usable",
    "biased": "noise biases the rate: use output-error least squares (method='lm'), or integrated_regression where it must be linear",
    "undetermined": "the input does not excite all parameters: add reversals of several amplitudes, or lower the orders",
    "not-converged": "not converged: more passes, a better start, or recursive least squares",
    "diverged": "diverged: raise the floor or lower mu (gradient correction), or decimate by input increment",
    "failed": "the identified rate is not positive: decimate by input increment, or use output-error least squares (method='lm')",
    "poor": "the free run does not follow the record: use output-error least squares (method='lm') or another model",
}
_POOR = 10.0  # percent of range above which no free run is called usable


@dataclasses.dataclass(frozen=True)
class Identification:
    """The outcome of `AbstractIdentifier.fit`.

    Attributes:
        model: final model as the first record sees it, None where the parameters are no valid model; `models` one for
            each record.
        data: the records.
        method: "rls", "gradient-correction", ...
        names, units: of the columns of `history`.
        history: physical parameters after every sample, shape (T, p), over all records and passes.
        theta: final parameter vector of the identifier itself, shape (p,); `theta_history` after every sample (T, p).
        errors: one-step prediction error before each sample was used [y], shape (T,), NaN where it was not used.
        equation_error: RMS one-step error of the final parameters [y]; None where it is not finite.
        free_run: error of the simulation that sees the input alone; None without a valid model.
        counts: samples: "total", "used", and skipped because the input stood "still", the output was "missing", or the
            record only began ("first").
        status: key of `ADVICE`; only "ok" is usable without a second thought.
        notes: what was found, one sentence each, with the remedy.
        state: final state of the identifier, to go on from.
    """

    model: AbstractHysteresis | None
    models: tuple[AbstractHysteresis | None, ...]
    data: Dataset
    method: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    history: np.ndarray
    theta: np.ndarray
    theta_history: np.ndarray
    errors: np.ndarray
    equation_error: float | None
    free_run: Metrics | None
    counts: dict[str, int]
    status: str
    notes: tuple[str, ...]
    state: Any

    def __repr__(self) -> str:
        values = ", ".join(f"{p.name} {p.value:.5g} {p.unit}".rstrip() for p in self.parameters)
        free = "no free run" if self.free_run is None else f"free run {self.free_run.nrmse_percent:.3g} % of range"
        return f"<Identification by {self.method}, {self.status}: {values}; {free}>"

    @property
    def usable(self) -> bool:
        """Whether the status is "ok"."""
        return self.status == "ok"

    def __getitem__(self, name: str) -> ParameterEstimate:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(f"no parameter {name!r}; there are {[p.name for p in self.parameters]}")

    @property
    def advice(self) -> str:
        """What to do, in one sentence."""
        return ADVICE[self.status]

    @property
    def parameters(self) -> tuple[ParameterEstimate, ...]:
        """Every parameter of the final model for a report, without standard errors: one-step residuals are correlated.

        Without a valid model, the identified values that are finite.
        """
        if self.model is None:
            rows = zip(self.names, self.history[-1], self.units, strict=True)
            return tuple(
                ParameterEstimate(name, float(value), None, unit, None, None, False, None, None)
                for name, value, unit in rows
                if np.isfinite(value)
            )
        space = ParameterSpace.of(self.model, scales=scales_of(self.data))
        finite = lambda value: float(value) if np.isfinite(value) else None
        rows = []
        for name, value, info in zip(space.names, space.vector(self.model), space.infos, strict=True):
            unit, (lower, upper) = space.scales.label(info.unit), (finite(b) for b in info.bounds)
            rows.append(ParameterEstimate(name, float(value), None, unit, lower, upper, False, None, None, info.doc))
        for name, value, info in space.fixed():
            unit, (lower, upper) = space.scales.label(info.unit), (finite(b) for b in info.bounds)
            rows.append(ParameterEstimate(name, value, None, unit, lower, upper, True, None, None, info.doc))
        return tuple(rows)

    def predict(self) -> list[np.ndarray] | None:
        """Free run over every record, shapes (T_r,); None without a valid model."""
        models = [model for model in self.models if model is not None]
        if len(models) < len(self.models):
            return None
        pairs = zip(models, self.data, strict=True)
        return [np.asarray(simulate(model, r.u, None if r.t is None else r.dt)[0]) for model, r in pairs]

    def to_dict(self) -> dict[str, Any]:
        """What a report and `result.json` need; unknown values are None."""
        return {
            "method": self.method,
            "status": self.status,
            "advice": self.advice,
            "notes": list(self.notes),
            "parameters": {p.name: p.to_dict() for p in self.parameters},
            "metrics": {"train": self.free_run.to_dict() if self.free_run else None, "test": None},
            "equation_error_rms": self.equation_error,
            "samples": dict(self.counts),
        }


def conclude(
    identifier: AbstractIdentifier, data: Dataset, stream: Sample, state: Any, info: Info, notes: Sequence[str] = ()
) -> Identification:
    """Put a finished run into the result that users see."""
    theta_history, errors, used = (np.asarray(v) for v in (info.theta, info.error, info.used))
    theta = theta_history[-1]
    models = tuple(identifier.model(theta, record) for record in data)
    status, found = identifier.judge(data, state, theta_history, errors)
    free_run, poor = _free_run(models, data)
    one_step = identifier.one_step(theta, data)
    rms = np.sqrt(np.mean(one_step**2)) if one_step.size else np.nan
    units = ("",) * len(identifier.names) if models[0] is None else _units(identifier.names, models[0], data)
    return Identification(
        model=models[0],
        models=models,
        data=data,
        method=identifier.method,
        names=identifier.names,
        units=units,
        history=identifier.physical(theta_history),
        theta=theta,
        theta_history=theta_history,
        errors=errors,
        equation_error=float(rms) if np.isfinite(rms) else None,
        free_run=free_run,
        counts=_counts(stream, used),
        status="poor" if status == "ok" and poor else status,
        notes=(*notes, *found, *poor),
        state=state,
    )


def _counts(stream: Sample, used: np.ndarray) -> dict[str, int]:
    u, y, first = (np.asarray(v) for v in (stream.u, stream.y, stream.first))
    missing = np.isnan(y)
    still = ~first & ~missing & (np.diff(u, prepend=u[0]) == 0)
    counts = {"total": u.size, "used": used.sum(), "still": still.sum(), "missing": missing.sum(), "first": first.sum()}
    return {name: int(value) for name, value in counts.items()}


def _free_run(models: Sequence[AbstractHysteresis | None], data: Dataset) -> tuple[Metrics | None, list[str]]:
    """Metrics of the simulation and, where it misses the record, a note."""
    known = [model for model in models if model is not None]
    if len(known) < len(models):
        return None, []
    pairs = zip(known, data, strict=True)
    runs = [np.asarray(simulate(model, r.u, None if r.t is None else r.dt)[0]) for model, r in pairs]
    if not all(np.isfinite(run).all() for run in runs):
        return None, ["the free run is not finite: the identified model is unstable at this sampling"]
    metrics = Metrics.of([r.y[r.used] for r in data], [run[r.used] for run, r in zip(runs, data, strict=True)])
    percent = metrics.nrmse_percent
    if percent is None or percent <= _POOR:
        return metrics, []
    return metrics, [f"the free run is off by {percent:.3g} % of the range (RMS), whatever the one-step error says"]


def _units(names: Sequence[str], model: AbstractHysteresis, data: Dataset) -> tuple[str, ...]:
    space = ParameterSpace.of(model, scales=scales_of(data))
    units = dict(zip(space.names, space.units, strict=True))
    return tuple(units.get(name, "") for name in names)
