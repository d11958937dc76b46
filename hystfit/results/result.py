"""What a fit gives back: a value with a status, errors, a verdict on what the data determine, and where it came from."""

from __future__ import annotations

import dataclasses
import datetime
import importlib.metadata
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.free_run import free_run
from hystfit.models.registry import model_name
from hystfit.results.metrics import Metrics

SCHEMA = "hystfit.fit/1"
SEQUENTIAL = ("rls", "gradient-correction", "ukf")  # methods of `identify`, which see each sample once
ADVICE = {
    "ok": "usable",
    "not-converged": "the solver did not converge: more starts, method='trf', or fix what the data do not determine",
    "poor": "the model does not describe this loop: try hystfit compare, or a model with more freedom",
    "no-loop": "the input never turns back, so that there is no loop: measure a cycle, or fit a curve instead",
}


@dataclasses.dataclass(frozen=True)
class ParameterEstimate:
    """One parameter of a fit.

    Attributes:
        name, unit, doc: what it is.
        value: in `unit`.
        stderr: standard error; None where it means nothing (fixed, on a bound, not determined).
        lower, upper: bounds; None where there is none.
        fixed: it was held.
        at_bound: "lower" or "upper" where it ran into a bound.
        identifiable: the data determine it; None where it was fixed.
    """

    name: str
    value: float
    stderr: float | None
    unit: str
    lower: float | None
    upper: float | None
    fixed: bool
    at_bound: str | None
    identifiable: bool | None
    doc: str = ""

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`."""
        return {k: v for k, v in dataclasses.asdict(self).items() if k not in ("name", "doc")}


@dataclasses.dataclass(frozen=True)
class FitResult:
    """A fitted model and what is known of it.

    Attributes:
        model: fitted, of the type that went in; with several records, as the first of them sees it.
        models: one for each record (they share all but per-record parameters).
        data: the records fitted.
        status: "ok", "not-converged", "poor" or "no-loop"; only the first is usable without a second thought.
        notes: the verdict, one sentence each: what is not determined, which bounds were reached, what was chosen.
        parameters: free and fixed ones.
        covariance: of the free parameters, shape (p, p), NaN where it means nothing; `free_names` is their order.
        train: metrics on the fitted samples; `test` on others, None where none were given.
        correlation_time: integrated autocorrelation time of the residuals, in samples.
        honest_ratio: by how much the errors grew for it, beside those for independent residuals.
        rank, condition: of the relative Jacobian; None where there is none.
        method: the estimator's name; `starts` and `in_best_basin`, how many starts and how many of them agree.
        compile_s, run_s: seconds that the fit spent compiling and running; None where it was not measured.
        provenance: versions, seed, data checksums, date.
    """

    model: AbstractHysteresis
    models: tuple[AbstractHysteresis, ...]
    data: Dataset
    status: str
    notes: tuple[Any, ...]
    parameters: tuple[ParameterEstimate, ...]
    free_names: tuple[str, ...]
    covariance: np.ndarray
    train: Metrics
    test: Metrics | None
    sigma: float
    correlation_time: float
    honest_ratio: float
    rank: int | None
    condition: float | None
    method: str
    starts: int
    in_best_basin: int
    compile_s: float | None
    run_s: float | None
    provenance: dict[str, Any]

    @property
    def usable(self) -> bool:
        """Whether the status is "ok"."""
        return self.status == "ok"

    @property
    def advice(self) -> str:
        """What to do about the status, in one sentence."""
        if self.status == "not-converged" and self.method in SEQUENTIAL:
            return "the sequential method did not arrive: see the verdict, or fit by least squares (method='lm')"
        return ADVICE[self.status]

    @property
    def name(self) -> str:
        """The model's readable name."""
        return model_name(self.model)

    def __getitem__(self, name: str) -> ParameterEstimate:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(f"no parameter {name!r}; there are {[p.name for p in self.parameters]}")

    def predict(self, record: Record, *, refit_offset: bool = False) -> np.ndarray:
        """Free run over a record's input, shape (T,): of its own model where it was fitted, else of the first record's.

        Args:
            record: any record with the time that the model needs.
            refit_offset: shift the output so that its mean over the samples that count is right (another record's sensor zero).

        Raises:
            ModelError: the model needs time and the record has none.
            DataError: an offset is asked for and no output counts.
        """
        names = [own.name for own in self.data]
        model = self.models[names.index(record.name)] if record.name in names else self.model
        y = free_run(model, record.u, None if record.t is None else record.dt)
        if refit_offset:
            if not record.used.any():
                raise DataError(f"record {record.name!r}: no output counts, so that its offset cannot be refitted")
            y = y + float(np.mean((record.y - y)[record.used]))
        return y

    def metrics(self, data: Record | Dataset | Sequence[Record], *, refit_offset: bool = False) -> Metrics:
        """Metrics of the prediction on the samples that count."""
        records = list(Dataset.of(data))
        predicted = [self.predict(record, refit_offset=refit_offset)[record.used] for record in records]
        return Metrics.of([record.y[record.used] for record in records], predicted)

    def extrapolates(self, record: Record) -> str | None:
        """A warning where a record leaves the range of inputs fitted; None where it does not."""
        low = min(float(r.u[r.used].min()) for r in self.data)
        high = max(float(r.u[r.used].max()) for r in self.data)
        outside = (record.u < low - 0.005 * (high - low)) | (record.u > high + 0.005 * (high - low))
        outside &= record.used
        if not outside.any():
            return None
        return (
            f"{outside.sum()} of {record.used.sum()} samples of {record.name!r} lie outside the inputs fitted "
            f"({low:.4g} to {high:.4g} {record.u_unit}): the prediction there is an extrapolation"
        )

    def to_dict(self) -> dict[str, Any]:
        """The contents of `result.json` (architecture: schema hystfit.fit/1); unknown values are null."""
        return {
            "schema": SCHEMA,
            "model": self.name,
            "status": self.status,
            "advice": self.advice,
            "notes": [note if isinstance(note, str) else note.to_dict() for note in self.notes],
            "parameters": {p.name: p.to_dict() for p in self.parameters},
            "free_names": list(self.free_names),
            "covariance": [[float(v) if np.isfinite(v) else None for v in row] for row in self.covariance],
            "metrics": {"train": self.train.to_dict(), "test": self.test.to_dict() if self.test else None},
            "residuals": {
                "sigma": self.sigma,
                "correlation_time_samples": self.correlation_time,
                "honest_to_iid_error_ratio": self.honest_ratio,
            },
            "identifiability": {"rank": self.rank, "free": len(self.free_names), "condition": self.condition},
            "method": {"name": self.method, "starts": self.starts, "in_best_basin": self.in_best_basin},
            "timing": {"compile_s": self.compile_s, "run_s": self.run_s},
            "provenance": self.provenance,
        }

    def save(self, folder: str | Path, *, report: bool = True) -> Path:
        """Write result.json, model.json, the records (records.npz), the report and its pictures into a folder; all or none.

        Args:
            folder: made if it is not there; its parent must be.
            report: draw the pictures and write the HTML page too.

        Raises:
            HystfitError: the folder cannot be made or written.
        """
        from hystfit.results.report import write_into
        from hystfit.results.saved import write_fit, writing

        target = Path(folder)
        with writing(target) as scratch:
            write_fit(self, scratch)
            if report:
                write_into(self, scratch)
        return target

    def report(self) -> str:
        """The report as text."""
        from hystfit.results.report import text_report

        return text_report(self)

    def __str__(self) -> str:
        return self.report()

    def __repr__(self) -> str:
        from hystfit.results.report import headline

        return f"<FitResult: {headline(self)}; print it for the report>"

    def plot(
        self,
        kind: str = "loop",
        ax: Any = None,
        *,
        data: Record | Dataset | Sequence[Record] | None = None,
        refit_offset: bool = False,
    ) -> Any:
        """A picture of the fit, of the records fitted or of others; kinds and arguments as in `plots.fit`; returns the axes."""
        from hystfit.results import plots

        return plots.fit(self, kind, ax=ax, data=data, refit_offset=refit_offset)


def provenance(data: Dataset, seed: int | None, **more: Any) -> dict[str, Any]:
    """Versions, seed, checksums of the data, date."""
    packages = ("hystfit", "jax", "equinox", "optimistix", "numpy", "scipy")
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "versions": {name: importlib.metadata.version(name) for name in packages},
        "seed": seed,
        "records": [
            {"name": r.name, "source": r.source, "file_sha256": r.sha256, "data_sha256": r.digest(), "samples": len(r)}
            for r in data
        ],
        **more,
    }
