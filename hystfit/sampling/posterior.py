"""`Posterior`: draws with their diagnostics, tables, plots, bands and derived quantities."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from hystfit.data.record import Record
from hystfit.errors import ParameterError
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Column, Note, Status, Table, WithStatus, fragment
from hystfit.outcome.table import or_none
from hystfit.registry import attribute
from hystfit.results.estimates import edges_of, grouped
from hystfit.results.exchange import arviz_data
from hystfit.results.measured.quantities import QUANTITIES
from hystfit.results.result import FitResult
from hystfit.sampling.base import Evidence
from hystfit.sampling.diagnostics import Convergence

SCHEMA = "hystfit.sample/4"
CHECKS = "sd: standard deviation. R-hat: 1 where the chains agree. bulk, tail: effective numbers of draws."


def _quantiles(values: np.ndarray) -> dict[str, Any]:
    """Median and 95 % interval."""
    levels = {"lower": 0.025, "median": 0.5, "upper": 0.975}
    return dict(zip(levels, map(or_none, np.quantile(values, list(levels.values()))), strict=True))


def _summarized(name: str, rows: Sequence[dict[str, Any]]) -> list[Any]:
    """Cells of the summary of one parameter, or of an array: ranges, the lowest and highest limits, the worst diagnostics."""
    values = {key: [row[key] for row in rows if row[key] is not None] for key in rows[0] if key not in ("name", "unit")}
    worst = lambda key, choose: choose(values[key], default=None)
    if len(rows) == 1:
        moments = [rows[0]["mean"], rows[0]["sd"]]
    else:
        name = f"{name}[{len(rows)}]"
        moments = [f"{min(values[key]):.3g} to {max(values[key]):.3g}" for key in ("mean", "sd")]
    limits = [worst("lower", min), worst("upper", max), rows[0]["unit"]]
    return [name, *moments, *limits, worst("rhat", max), worst("bulk", min), worst("tail", min)]


def _view(name: str) -> Any:
    """A function of a posterior that its methods call; bound late, because those modules import this one."""
    return attribute(f"hystfit.sampling.{name}")


@dataclasses.dataclass(frozen=True)
class Posterior(WithStatus):
    """Draws of the parameters of model and noise.

    Attributes:
        result: the fit from which sampling started.
        sampler, noise: names.
        names, units: of the parameters, the model's first.
        draws: physical, shape (chains, draws, d); for the ensemble every walker is a chain.
        log_density: log posterior in unconstrained coordinates, shape (chains, draws).
        stats: per draw, such as "diverging" and "acceptance", shape (chains, draws).
        convergence: R-hat and effective sizes.
        status: only `Status.OK` is usable; `Status.POOR_FIT` means draws of a model that does not describe the data,
            `Status.INCOMPLETE` that the residuals show an error of the model.
        notes: choices and problems.
        priors: in words, by parameter.
        seconds: wall time of sampling.
        seed: of the draws.
        provenance: of the draws: date, versions, seed, data, and under "fit" the date of the fit.
        evidence: log evidence of model, noise and priors together, of nested sampling; None from other samplers.
        prior_quartiles: lower and upper quartile of each prior, by parameter.
    """

    result: FitResult
    sampler: str
    noise: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    draws: np.ndarray
    log_density: np.ndarray
    stats: dict[str, np.ndarray]
    convergence: Convergence
    status: Status
    notes: tuple[Note, ...]
    priors: dict[str, str]
    seconds: float
    seed: int
    provenance: dict[str, Any]
    evidence: Evidence | None = None
    prior_quartiles: dict[str, list[float]] = dataclasses.field(default_factory=dict)
    verb: ClassVar[str] = "sample"

    def __getitem__(self, name: str) -> np.ndarray:
        """Draws of one parameter, shape (chains, draws)."""
        if name not in self.names:
            raise ParameterError(f"no parameter {name!r}; there are {', '.join(self.names)}")
        return self.draws[:, :, self.names.index(name)]

    def table(self) -> list[dict[str, Any]]:
        """One row per parameter: mean, sd, 95 % interval, R-hat, effective sizes; unknown numbers are None."""
        rows = []
        for k, (name, unit) in enumerate(zip(self.names, self.units, strict=True)):
            flat = self.draws[:, :, k].ravel()
            moments = {"mean": or_none(flat.mean()), "sd": or_none(flat.std(ddof=1))}
            checks = {check: or_none(getattr(self.convergence, check)[k]) for check in ("rhat", "bulk", "tail")}
            rows.append({"name": name, "unit": unit} | moments | _quantiles(flat) | checks)
        return rows

    def summary(self) -> Table:
        """`table` as readable text; an array of more than 12 weights has one row, with its smallest and largest values."""
        numbers = [Column("mean"), Column("sd", form=".3g"), Column("2.5 %"), Column("97.5 %")]
        checks = [Column("R-hat", form=".3f"), Column("bulk", form=".0f"), Column("tail", form=".0f")]
        columns = [Column("parameter"), *numbers, Column("unit", left=True), *checks]
        families = grouped(self.table(), lambda row: row["name"])
        return Table(columns, [_summarized(name, rows) for name, rows in families])

    def derived_table(self) -> Table:
        """Derived quantities as readable text."""
        numbers = [Column(head) for head in ("median", "2.5 %", "97.5 %")]
        columns = [Column("quantity"), *numbers, Column("unit", left=True)]
        keys = ("median", "lower", "upper", "unit")
        return Table(
            columns,
            [
                [QUANTITIES[row["name"]].label_on(self.result.data), *(row[k] for k in keys)]
                for row in self.derived_rows
            ],
        )

    def _headline(self) -> str:
        chains, draws, _ = self.draws.shape
        return (
            f"{self.result.name}, noise {self.noise}, {self.sampler}: {chains} chains of {draws} draws: {self.status}"
        )

    def _evidence_words(self) -> str:
        """The evidence in one line; "" where there is none."""
        if self.evidence is None:
            return ""
        log_z, error = self.evidence.log_z, self.evidence.error
        return f"log evidence: {log_z:.2f} +- {error:.2f} (nats; comparable for the same data only)"

    def _prior_lines(self) -> list[str]:
        """One line for each prior; neighbors in an array with the same one share it."""
        array_and_prior = lambda name: (name.partition("[")[0], self.priors[name])
        runs = [(text, list(names)) for (_, text), names in itertools.groupby(self.priors, array_and_prior)]
        label = lambda names: names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"
        return [f"prior of {label(names)}: {text}" for text, names in runs]

    def __str__(self) -> str:
        lines = [self._headline(), *self.summary().lines(), CHECKS]
        if evidence := self._evidence_words():
            lines.append(evidence)
        lines += self.derived_table().lines()
        lines += [f"note: {note}" for note in self.notes]
        lines += self._prior_lines()
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        priors = Table(["parameter", Column("prior", left=True)], list(self.priors.items()))
        parts = (self.summary(), CHECKS, self._evidence_words(), self.derived_table(), self.notes, priors)
        return fragment(self._headline(), parts)

    def to_dict(self) -> dict[str, Any]:
        """The contents of `result.json`."""
        diverging = self.stats.get("diverging")
        return {
            "schema": SCHEMA,
            "model": self.result.name,
            "status": str(self.status),
            "advice": self.advice,
            "notes": [note.to_dict() for note in self.notes],
            "sampler": self.sampler,
            "noise": self.noise,
            "chains": self.draws.shape[0],
            "draws": self.draws.shape[1],
            "divergences": None if diverging is None else int(diverging.sum()),
            "acceptance": float(np.nanmean(self.stats["acceptance"])) if "acceptance" in self.stats else None,
            "evidence": None if self.evidence is None else self.evidence._asdict(),
            "parameters": {row.pop("name"): row for row in self.table()},
            "derived": {row["name"]: {k: v for k, v in row.items() if k != "name"} for row in self.derived_rows},
            "priors": self.priors,
            "timing": {"sampling_s": self.seconds},
            "provenance": self.provenance,
        }

    def chosen(self, count: int, seed: int = 0) -> np.ndarray:
        """Numbers of `count` draws that are chosen at random among those of all chains, end to end, shape (count,)."""
        total = self.draws.shape[0] * self.draws.shape[1]
        return np.random.default_rng(seed).choice(total, min(count, total), replace=False)

    def thinned(self, count: int, seed: int = 0) -> np.ndarray:
        """`count` draws of the model's parameters, chosen at random, shape (count, p)."""
        return self.draws.reshape(-1, len(self.names))[self.chosen(count, seed), : len(self.result.free_names)]

    def models(self, count: int, seed: int = 0) -> Iterator[AbstractHysteresis]:
        """The models of `thinned` draws, with the parameters of the first record: simulate or invert each."""
        coordinates = self.result.problem.space.coordinates
        for row in self.thinned(count, seed):
            yield coordinates.assemble(jnp.asarray(row), 0)

    def at(self, **covariates: float) -> Posterior:
        """The same draws where the covariates of the fit have other values, see `FitResult.at`."""
        return dataclasses.replace(self, result=self.result.at(**covariates))

    # -- prediction ----------------------------------------------------------------------------------------------------

    def predict(self, record: Record, count: int = 200, seed: int = 0) -> np.ndarray:
        """Outputs of `count` draws over a record's input, shape (count, T): parameters vary, no noise is added.

        Args:
            record: provides the input.
            count: number of draws, chosen at random.
            seed: of the choice.
        """
        own = self.result.in_fitted_units(record)
        return self.result.to_unit_of(
            record, _view("predictive:simulate_draws")(self.result, own, self.thinned(count, seed), seed)
        )

    def bands(
        self, record: Record, level: float = 0.9, count: int = 200, seed: int = 0, kind: str = "predictive"
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(lower, median, upper) of the output over a record's input, each (T,).

        Args:
            record: provides the input.
            level: of the pointwise band.
            count: draws used.
            seed: of their choice and of the noise.
            kind: "credible" (of the model's curve) or "predictive" (of a measurement: `hystfit.sampling.predictive` says what
                that includes, and what not).

        Raises:
            ParameterError: another kind, or a level outside (0, 1).
        """
        if kind not in ("credible", "predictive"):
            raise ParameterError(f"kind must be credible or predictive, got {kind!r}")
        draw, edges = (
            _view("predictive:predictive_draws") if kind == "predictive" else Posterior.predict,
            edges_of(level),
        )
        lower, median, upper = np.quantile(draw(self, record, count, seed), edges, axis=0)
        return lower, median, upper

    def derived(self, quantities: Sequence[str] | None = None, count: int = 200) -> dict[str, np.ndarray]:
        """Posterior draws of derived quantities, each (count,): see `hystfit.results.measured.quantities.QUANTITIES`."""
        return _view("derived:derive")(self, quantities, count)

    @functools.cached_property
    def beyond(self) -> Any:
        """Error at amplitudes that were not fitted, a `hystfit.sampling.amplitude_error.AmplitudeError`; None where it is not known."""
        return _view("amplitude_error:AmplitudeError").of(self)

    @functools.cached_property
    def sensitivity(self) -> Any:
        """Sensitivity of the posterior to prior, data and single records, with checks by replicated data, a `sensitivity.Sensitivity`."""
        return _view("sensitivity:sensitivity")(self)

    @functools.cached_property
    def derived_rows(self) -> list[dict[str, Any]]:
        """One row per derived quantity, of 200 draws: median, 95 % interval, unit, and what it is; unknown numbers are None."""
        rows = []
        for name, values in self.derived().items():
            quantity = QUANTITIES[name]
            unit = quantity.units(self.result.data)
            rows.append({"name": name, "unit": unit} | _quantiles(values) | {"about": quantity.doc})
        return rows

    def plot(self, kind: str = "corner", **options: Any) -> Any:
        """A picture: "corner", "trace", "rank" or "bands"; returns the matplotlib figure."""
        return _view("posterior_plots:draw")(self, kind, **options)

    # -- files ---------------------------------------------------------------------------------------------------------

    def dataset(self) -> Any:
        """Draws as an xarray Dataset with dimensions chain and draw, as ArviZ has them; w[0], w[1], ... are one array w."""
        return _view("files:dataset")(self)

    def to_arviz(self) -> Any:
        """As ArviZ' container: `InferenceData` before version 1, a DataTree from then on; w[0], w[1], ... are one array w."""
        stats = {"lp": self.log_density, **self.stats}
        posterior = {name: self.draws[:, :, one.at] for name, one in _view("files:variables")(self.names).items()}
        dims, coords = _view("files:dimensions")(self)
        return arviz_data({"posterior": posterior, "sample_stats": stats}, dims=dims, coords=coords)

    def save(self, folder: str | Path) -> Path:
        """Write posterior.nc (groups posterior and sample_stats), result.json, and the fit in fit/.

        Raises:
            MissingExtraError: xarray or h5netcdf is not installed.
            HystfitError: the folder cannot be written.
        """
        return _view("files:save")(self, folder)
