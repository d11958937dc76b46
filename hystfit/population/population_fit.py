"""`PopulationFit`: mean device, scatter, correlations, better values of each device, and the next device."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from scipy.stats import f as f_distribution

from hystfit.data.record import Record
from hystfit.inference.correlated_priors import CorrelatedPriors
from hystfit.outcome import Column, Note, Status, Table, WithStatus
from hystfit.outcome.table import or_none
from hystfit.population.devices import Common, Device
from hystfit.population.hierarchy import Hierarchy, correlations_of
from hystfit.population.next_device import NextDevice, away
from hystfit.registry import attribute
from hystfit.results.estimates import INTERVAL, edges_of
from hystfit.results.exchange import arviz_data
from hystfit.sampling.predictive import simulate_rows

SCHEMA = "hystfit.population/3"
_UNUSUAL = 0.05  # probability of so unusual a device among all of the population, below which it is outlying
MEANING = "sd: from device to device in the population; sd here: of these devices; sd of fits: of their fits, which adds fit errors."
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(21)


@dataclasses.dataclass(frozen=True, repr=False)
class PopulationFit(WithStatus):
    """How the parameters of a model scatter between devices.

    Attributes:
        devices: those that take part.
        common: their parameters and coordinates z, in which the population is normal.
        drawn: mean, covariance and devices in z.
        design: covariates of the devices, shape (D, q): a column of ones, then deviations from the means.
        covariates: names and means of the covariates.
        effective: fraction of the draws of each device that counts under its full likelihood, shape (D,).
        sampled: numbers of the devices whose own posterior was sampled, because that fraction is small.
        status: `Status.PARTIAL` where devices were left out.
        notes: which, and why.
        seed, seconds, provenance: of the run.
    """

    devices: tuple[Device, ...]
    common: Common
    drawn: Hierarchy
    design: np.ndarray
    covariates: dict[str, float]
    effective: np.ndarray
    sampled: tuple[int, ...]
    status: Status
    notes: tuple[Note, ...]
    seed: int
    seconds: float
    provenance: dict[str, Any]
    verb: ClassVar[str] = "population"

    # -- numbers -------------------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that scatter."""
        return self.common.names

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        return tuple(self.common.space.units[k] for k in self.common.at)

    @property
    def model(self) -> str:
        """Name of the model."""
        return self.devices[0].result.name

    @functools.cached_property
    def _moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of the devices in physical units, by draw, shape (n, p) each."""
        drawn = self.drawn.joined
        middle, sd = drawn.effects[:, 0], np.sqrt(np.einsum("nii->ni", drawn.covariance))
        x = self.common.x_of(middle[:, None] + sd[:, None] * _NODES[:, None])
        weights = (_WEIGHTS / _WEIGHTS.sum())[:, None]
        mean = np.sum(weights * x, axis=1)
        return mean, np.sqrt(np.sum(weights * (x - mean[:, None]) ** 2, axis=1))

    @property
    def means(self) -> np.ndarray:
        """Draws of the mean over the population of each parameter, physical, shape (n, p)."""
        return self._moments[0]

    @property
    def sds(self) -> np.ndarray:
        """Draws of the standard deviation from device to device, physical, shape (n, p)."""
        return self._moments[1]

    @functools.cached_property
    def sds_here(self) -> np.ndarray:
        """Draws of the standard deviation of these very devices, physical, shape (n, p): the scatter of their true values."""
        return self.common.x_of(self.drawn.joined.z).std(axis=1, ddof=1)

    @functools.cached_property
    def correlations_here(self) -> np.ndarray:
        """Draws of the correlations between the parameters of these very devices, shape (n, p, p)."""
        z = self.drawn.joined.z
        away = z - z.mean(axis=1, keepdims=True)
        return correlations_of(np.einsum("ndi,ndj->nij", away, away))

    @functools.cached_property
    def correlations(self) -> np.ndarray:
        """Draws of the correlations between parameters in z, shape (n, p, p)."""
        return correlations_of(self.drawn.joined.covariance)

    @functools.cached_property
    def fitted(self) -> np.ndarray:
        """Fitted values of each device, physical, shape (D, p)."""
        return np.stack([device.x[self.common.at] for device in self.devices])

    @functools.cached_property
    def shrunken(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of each device's values given all devices, physical, shape (D, p) each."""
        x = self.common.x_of(self.drawn.joined.z)
        return x.mean(axis=0), x.std(axis=0)

    @functools.cached_property
    def unusual(self) -> np.ndarray:
        """Probability of a device as far from the others as each one, shape (D,); NaN where there are too few others.

        By Hotelling's T-squared with the fitted values of the others, to whose scatter the errors of the device itself are added.
        """
        p, count = len(self.names), len(self.devices)
        if count - 1 <= p:
            return np.full(count, np.nan)
        means = np.stack([device.mean for device in self.devices])
        out = np.empty(count)
        for d, device in enumerate(self.devices):
            others = np.delete(means, d, axis=0)
            own = np.linalg.pinv(device.precision, hermitian=True)
            scatter = np.cov(others.T).reshape(p, p) * (1 + 1 / len(others)) + own
            away = means[d] - others.mean(axis=0)
            square = away @ np.linalg.solve(scatter, away)
            n = len(others)
            out[d] = f_distribution.sf(square * (n - p) / (p * (n - 1)), p, n - p)
        return out

    @property
    def outlying(self) -> tuple[str, ...]:
        """Devices that are unlikely to belong to the population, the least likely first."""
        chance = 1 - (1 - np.nan_to_num(self.unusual, nan=1.0)) ** len(self.devices)
        return tuple(self.devices[d].name for d in np.argsort(chance) if chance[d] < _UNUSUAL)

    # -- the next device -----------------------------------------------------------------------------------------------

    def next_devices(self, count: int = 200, seed: int = 0, **covariates: float) -> np.ndarray:
        """Parameters of further devices, physical, shape (count, p): the uncertainty of the population is included.

        Args:
            count: number of devices.
            seed: of the draws.
            **covariates: values by name, by default the means over the devices.

        Raises:
            ParameterError: an unknown covariate.
        """
        return self.common.x_of(self._next_z(count, seed, covariates))

    def _next_z(self, count: int, seed: int, covariates: dict[str, float]) -> np.ndarray:
        row = away(self.covariates, covariates)
        rng, drawn = np.random.default_rng(seed), self.drawn.joined
        at = rng.integers(len(drawn.effects), size=count)
        noise = rng.normal(size=(count, len(self.names)))
        return row @ drawn.effects[at] + np.einsum("nij,nj->ni", np.linalg.cholesky(drawn.covariance[at]), noise)

    def bands(
        self, record: Record, level: float = 0.9, count: int = 200, seed: int = 0, **covariates: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(lower, median, upper) of the output of the next device over a record's input, without noise, each (T,).

        Args:
            record: provides the input.
            level: of the pointwise band.
            count: devices drawn.
            seed: of the draws.
            **covariates: see `next_devices`.

        Raises:
            ParameterError: a level outside (0, 1).
        """
        edges, first = edges_of(level), self.devices[0].result
        own = first.in_fitted_units(record)
        space = self.common.space
        x = np.tile(space.clip(space.vector(first.model)), (count, 1))
        x[:, self.common.at] = self.next_devices(count, seed, **covariates)
        inputs = (jnp.asarray(own.u), jnp.asarray(own.dt), jnp.zeros(count, int))
        runs = np.asarray(simulate_rows(space.coordinates, jnp.asarray(x), *inputs))
        lower, median, upper = np.quantile(first.to_unit_of(record, runs), edges, axis=0)
        return lower, median, upper

    @functools.cached_property
    def next_device(self) -> NextDevice:
        """The distribution of a further device, which follows its covariates."""
        z, effects = self._next_z(4000, self.seed, {}), self.drawn.joined.effects
        at_means = self.common.priors(z.mean(axis=0), z.std(axis=0))
        above = self.common.x_of(z.mean(axis=0) + z.std(axis=0))
        # Scores of priors from an upper edge fall where z rises.
        sign = np.sign([float(prior.score(jnp.asarray(x))) for prior, x in zip(at_means.values(), above, strict=True)])
        scores = effects * sign / z.std(axis=0)
        covariance = np.cov(scores.reshape(len(scores), -1).T).reshape(*effects.shape[1:], *effects.shape[1:])
        correlation = np.corrcoef(z.T).reshape(len(sign), len(sign)) * np.outer(sign, sign)
        correlated = CorrelatedPriors(at_means, correlation)
        return NextDevice(correlated, self.covariates, scores[:, 1:].mean(axis=0), covariance)

    def priors(self, **covariates: float) -> CorrelatedPriors:
        """Priors for the fit of a further device: the distribution of the next one, with correlations; covariates as in `next_devices`."""
        return self.next_device.priors(covariates)

    # -- views ---------------------------------------------------------------------------------------------------------

    def table(self) -> list[dict[str, Any]]:
        """One row per parameter: mean and scatter of the population with intervals of 90 %, that of these devices, and of their fits."""
        naive, here = self.fitted.std(axis=0, ddof=1), np.median(self.sds_here, axis=0)
        rows = []
        for k, (name, unit) in enumerate(zip(self.names, self.units, strict=True)):
            row: dict[str, Any] = {"name": name, "unit": unit}
            for what, draws in (("mean", self.means[:, k]), ("sd", self.sds[:, k])):
                ends = np.quantile(draws, INTERVAL).tolist()
                row |= dict(zip((f"{what}_lower", what, f"{what}_upper"), ends, strict=True))
            rows.append(row | {"sd_here": float(here[k]), "sd_of_fits": float(naive[k])})
        return rows

    def summary(self) -> Table:
        """`table` as readable text."""
        numbers = [Column(head) for head in ("mean", "5 %", "95 %", "sd", "5 % ", "95 % ", "sd here", "sd of fits")]
        columns = [Column("parameter"), *numbers, Column("unit", left=True)]
        keys = "name mean mean_lower mean_upper sd sd_lower sd_upper sd_here sd_of_fits unit".split()
        return Table(columns, [[row[key] for key in keys] for row in self.table()])

    def correlation_table(self) -> Table:
        """Correlations whose interval of 90 % excludes zero, the strongest first."""
        low, middle, high = np.quantile(self.correlations, INTERVAL, axis=0)
        pairs = [(a, b) for a in range(len(self.names)) for b in range(a) if low[a, b] > 0 or high[a, b] < 0]
        pairs.sort(key=lambda pair: -abs(middle[pair]))
        rows = [[self.names[b], self.names[a], middle[a, b], low[a, b], high[a, b]] for a, b in pairs]
        heads = [Column("parameter"), Column("with", left=True)]
        return Table([*heads, *(Column(head, form=".2f") for head in ("correlation", "5 %", "95 %"))], rows)

    def effects(self) -> dict[str, dict[str, dict[str, float]]]:
        """Change of the mean device with each covariate, by covariate and parameter: per unit of it, median and interval of 90 %."""
        drawn, found = self.drawn.joined.effects, {}
        for k, label in enumerate(self.covariates, 1):
            ends = (self.common.x_of(drawn[:, 0] + side * drawn[:, k]) for side in (-0.5, 0.5))
            low, middle, high = np.quantile(np.subtract(*reversed([*ends])), INTERVAL, axis=0)
            rows = zip(self.names, low, middle, high, strict=True)
            found[label] = {n: {"lower": float(a), "median": float(b), "upper": float(c)} for n, a, b, c in rows}
        return found

    def effects_table(self) -> Table:
        """`effects` as readable text; no rows without covariates."""
        heads = [Column("parameter"), Column("per unit of", left=True)]
        heads += [*(Column(head) for head in ("change", "5 %", "95 %")), Column("unit", left=True)]
        units = dict(zip(self.names, self.units, strict=True))
        keys = ("median", "lower", "upper")
        rows = [
            [name, label, *(row[key] for key in keys), units[name]]
            for label, rows in self.effects().items()
            for name, row in rows.items()
        ]
        return Table(heads, rows)

    def headline(self) -> str:
        """Model, devices and status in one line."""
        return f"{self.model}, {len(self.devices)} devices: {self.status}"

    def __str__(self) -> str:
        lines = [self.headline(), *self.summary().lines()]
        lines.append(MEANING)
        if self.covariates:
            lines += self.effects_table().lines()
        if (correlations := self.correlation_table()).rows:
            lines += correlations.lines()
        lines.append(f"outlying devices: {', '.join(self.outlying) or 'none'}")
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])

    __repr__ = __str__

    def device_rows(self) -> list[dict[str, Any]]:
        """One row per device: fitted and better values with standard deviations, effective fraction, chance of one so unusual."""
        mean, sd = self.shrunken
        rows = []
        for d, device in enumerate(self.devices):
            row: dict[str, Any] = {"device": device.name}
            for k, name in enumerate(self.names):
                row |= {f"{name}_fit": self.fitted[d, k], name: mean[d, k], f"{name}_sd": sd[d, k]}
            row |= {"effective": self.effective[d], "unusual": or_none(self.unusual[d])}
            rows.append({key: float(v) if isinstance(v, np.floating) else v for key, v in row.items()})
        return rows

    def to_dict(self) -> dict[str, Any]:
        """The contents of `result.json`."""
        low, middle, high = np.quantile(self.correlations, INTERVAL, axis=0)
        pairs = [(a, b) for a in range(len(self.names)) for b in range(a)]
        return {
            "schema": SCHEMA,
            "model": self.model,
            "status": str(self.status),
            "advice": self.advice,
            "notes": [note.to_dict() for note in self.notes],
            "parameters": {row.pop("name"): row for row in self.table()},
            "correlations": {
                f"{self.names[b]}, {self.names[a]}": {"lower": low[a, b], "median": middle[a, b], "upper": high[a, b]}
                for a, b in pairs
            },
            "covariates": {
                label: {"mean": self.covariates[label], "effects": rows} for label, rows in self.effects().items()
            },
            "next_device": self.next_device.to_dict(),
            "devices": {row.pop("device"): row for row in self.device_rows()},
            "outlying": list(self.outlying),
            "timing": {"run_s": self.seconds},
            "provenance": self.provenance,
        }

    def plot(self, kind: str = "forest") -> Any:
        """A picture: "forest" (devices and population), "correlation", or "shrinkage" (fitted against better values).

        Raises:
            ParameterError: an unknown kind.
        """
        return attribute("hystfit.population.pictures:draw")(self, kind)

    def to_arviz(self) -> Any:
        """As ArviZ' container: `InferenceData` before version 1, a DataTree from then on."""
        drawn = self.drawn
        posterior = {"effects": drawn.effects, "covariance": drawn.covariance, "z": drawn.z}
        sizes = ("covariate", "parameter"), ("parameter", "other"), ("device", "parameter")
        dims = {name: list(own) for name, own in zip(posterior, sizes, strict=True)}
        coords = {"parameter": list(self.names), "other": list(self.names), "device": [d.name for d in self.devices]}
        coords |= {"covariate": ["mean", *self.covariates]}
        return arviz_data({"posterior": posterior}, dims=dims, coords=coords)

    def save(self, folder: str | Path) -> Path:
        """Write result.json and devices.csv into a folder.

        Raises:
            HystfitError: the folder cannot be written.
        """
        return attribute("hystfit.population.population_files:save")(self, folder)
