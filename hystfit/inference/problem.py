"""The problem that every estimator and sampler solves: free parameters, records, loss, noise model and priors."""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, get_args

import jax
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import require_x64
from hystfit.data.batch import Batch
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError, ModelError
from hystfit.inference.blocks import chosen
from hystfit.inference.correlated_priors import Dependence
from hystfit.inference.density import Density
from hystfit.inference.fittable import check_fittable
from hystfit.inference.linearization import Linearization
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.setting import Setting
from hystfit.inference.objective import BROKEN, Loss, Objective, linearized, misfit_of, misfit_slope, predicted
from hystfit.inference.priors import AbstractPrior, choose_priors
from hystfit.inference.stretches import in_stretches, linearization_by_stretches, linearized_by_stretches
from hystfit.inference.weights import responses
from hystfit.inference.whitened import Whitened
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.design import COLUMNS
from hystfit.models.shared.starting import scales_of
from hystfit.params.host_arrays import NUMBERS, compiled, to_device
from hystfit.params.space import ParameterSpace
from hystfit.quality.held_out import HeldOut, held_out, inner_loops

LOSSES: tuple[str, ...] = get_args(Loss)
Side = Literal["lower", "upper"]


class Problem:
    """Free parameters, records, a loss, and for likelihoods a noise model and priors.

    Vectors x are physical, z unconstrained. In likelihoods and priors they hold the parameters of the model, then those of the noise.

    Attributes:
        model: the model, which gives the values of fixed parameters.
        data: the records.
        space: its free parameters by name.
        scales: natural sizes and units of the data.
        objective: the part for compiled code: arrays and structure without names.
        noise: a noise model with values, or None where there is no likelihood.
        noise_space: its parameters.
        priors: of the parameters of model and noise.
        dependence: of the priors on each other; None where they are independent.
        settled: False if the parameters depend on covariates whose values have not been chosen.
        equations: equations of the weights (`hystfit.inference.weights.Split`), which the choice of their number passes on to the fit. The
            fit removes them again, because they may take hundreds of MB; otherwise None.
    """

    equations: Any = None

    def __init__(
        self,
        model: AbstractHysteresis,
        data: Record | Dataset | Sequence[Record],
        *,
        fix: Sequence[str] | Mapping[str, Any] = (),
        free: Sequence[str] = (),
        tie: Mapping[str, str] | None = None,
        loss: Loss = "linear",
        spacing: int = 1,
    ):
        """Check that data and model fit each other, and collect the parameters.

        Args:
            model: gives the values of fixed parameters.
            data: one record or several.
            fix: names of parameters to fix, or names with values.
            free: names of parameters to fit that the model fixes by default.
            tie: parameters that follow from others, such as {"k2": "2*k1"}.
            loss: loss function of the residuals.
            spacing: samples over which errors are correlated, see `held_out`.

        Raises:
            PrecisionError: double precision is off.
            DataError: nothing to fit, a constant input or output, fewer samples than parameters.
            ModelError: not a model, a model that needs time with data that have none.
            ParameterError: see `ParameterSpace.of`.
        """
        require_x64()
        if not isinstance(model, AbstractHysteresis):
            raise ModelError(f"expected a hystfit model, got {type(model).__name__}")
        given = Dataset.of(data)
        self.data = given.map(model.prepared)
        check_fittable(model, self.data)
        self.model = model
        self.scales = scales_of(self.data)
        records = [record.name for record in self.data]
        trees = [model.of_record(record) for record in self.data]
        self.space = ParameterSpace.of(
            model, fix=fix, free=free, tie=tie, scales=self.scales, records=records, trees=trees
        )
        pairs = zip(given, self.data, strict=True)
        self.data = Dataset(tuple(self._without_added_start(record, ready) for record, ready in pairs), given.name)
        self._spacing = spacing
        self._lengths = tuple(map(len, given))
        batch = Batch.of(self.data)
        # Smooth weights may outnumber the samples, because their penalty adds information.
        if batch.count < len(self.space) and model.estimator != "preisach":
            raise DataError(
                f"{batch.count} samples cannot determine {len(self.space)} parameters; give more data or fix some with fix="
            )
        bend = to_device(0.02)  # in half ranges: robust losses reduce the influence of residuals above 1 % of the range
        self.objective = Objective(self.space.coordinates, batch, to_device(self.scales.y), bend, loss)
        self.settled = not model.covariates
        self.noise: AbstractNoise | None = None
        self.noise_space: ParameterSpace | None = None
        self.priors: tuple[AbstractPrior, ...] = ()
        self.dependence: Dependence | None = None
        self._predicted: tuple[bytes, list[np.ndarray]] | None = None

    def prepared(self, record: Record) -> Record:
        """The record as prepared by the model, but without the steady period before it if the initial state is free."""
        return self._without_added_start(record, self.model.prepared(record))

    def _without_added_start(self, record: Record, ready: Record) -> Record:
        """`prepared`, from a record and its version prepared by the model."""
        count = len(record)
        if len(ready) == count or not any(info.per_record and info.fixed for info in self.space.infos):
            return ready
        t = None if ready.t is None else ready.t[-count:]
        return record.replace(u=ready.u[-count:], y=ready.y[-count:], t=t, weight=ready.weight[-count:])

    # -- variants ------------------------------------------------------------------------------------------------------

    def _changed(self, **changes: Any) -> Problem:
        other = copy.copy(self)
        for cached in ("host_setting", "setting", "density", *(["held_out"] if "data" in changes else [])):
            other.__dict__.pop(cached, None)
        other._predicted = other.equations = None
        for name, value in changes.items():
            setattr(other, name, value)
        return other

    def reweighted(self, weights: Sequence[np.ndarray]) -> Problem:
        """The same problem with other weights, one array (T,) for each record; shapes stay, so nothing is compiled again."""
        records = [record.replace(weight=weight) for record, weight in zip(self.data, weights, strict=True)]
        data = Dataset(tuple(records))
        return self._changed(data=data, objective=dataclasses.replace(self.objective, batch=Batch.of(data)))

    def at(self, model: AbstractHysteresis) -> Problem:
        """The same problem with the covariates of a model for every record: for predictions, not for fits."""
        space = copy.copy(self.space)
        space.coordinates = space.coordinates.at(model)
        objective = dataclasses.replace(self.objective, coordinates=space.coordinates)
        return self._changed(space=space, objective=objective, settled=True)

    @functools.cached_property
    def held_out(self) -> HeldOut:
        """Groups of samples that are held out in turn to judge or to regularize a fit: those that suit the measured records."""
        return held_out(self._measured, self._spacing).after(map(len, self.data))

    def by_inner_loops(self) -> Problem | None:
        """The same problem with `inner_loops` held out; None where there are none."""
        groups = inner_loops(self._measured)
        return None if groups is None else self._changed(held_out=groups.after(map(len, self.data)))

    @property
    def _measured(self) -> list[Record]:
        """The records without the samples that the model added before them."""
        return [
            record.segment(len(record) - n, len(record)) for record, n in zip(self.data, self._lengths, strict=True)
        ]

    def with_loss(self, loss: Loss) -> Problem:
        """The same problem with another loss."""
        if loss == self.objective.loss:
            return self
        return self._changed(objective=dataclasses.replace(self.objective, loss=loss))

    def trimmed(self) -> Problem:
        """The same problem without common padding. The new shape is compiled again, which pays for long runs."""
        used = np.asarray(self.objective.batch.weight) > 0
        end = int(np.max(np.flatnonzero(used.any(axis=0)))) + 1
        batch = jax.tree_util.tree_map(lambda v: v[:, :end], self.objective.batch)
        return self._changed(objective=dataclasses.replace(self.objective, batch=batch))

    def with_noise(
        self, noise: AbstractNoise, priors: Mapping[str, AbstractPrior] | None = None, x: np.ndarray | None = None
    ) -> Problem:
        """The same problem with a likelihood.

        Args:
            noise: a noise model with values.
            priors: priors by name, for parameters of model or noise, or `CorrelatedPriors`; weak defaults for the others.
            x: physical parameters of model and noise about which default priors are centered, shape (d,).

        Raises:
            ParameterError: a prior that cannot be used, see `choose_priors`.
        """
        space = ParameterSpace.of(noise, scales=self.scales)
        chosen = dict(priors or {})
        of_noise = {name: chosen.pop(name) for name in list(chosen) if name in space.names}
        of_model = choose_priors(self.space, chosen, None if x is None else x[: len(self.space)], space.names)
        both = of_model + choose_priors(space, of_noise, None if x is None else x[len(self.space) :])
        dependence = Dependence.of(priors, self.space.names + space.names)
        return self._changed(noise=noise, noise_space=space, priors=both, dependence=dependence)

    # -- names ---------------------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters of model and noise."""
        return self.space.names + (self.noise_space.names if self.noise_space else ())

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters in `names`."""
        return self.space.units + (self.noise_space.units if self.noise_space else ())

    @property
    def free_and_fixed(self) -> dict[str, Any]:
        """Names of free and fixed parameters, each once for all records, and ties, as the arguments `free`, `fix` and `tie`."""
        free = list(dict.fromkeys(name.partition("@")[0] for name in self.space.names))
        return {"free": free, "fix": [name for name, _, _ in self.space.fixed()], "tie": self.space.expressions}

    @property
    def used(self) -> np.ndarray:
        """Which samples of the batch count, shape (R, T), bool."""
        return np.asarray(self.objective.batch.weight) > 0

    @property
    def idle(self) -> np.ndarray:
        """Which parameters belong to a record of which no sample counts, shape (p,), bool."""
        empty = ~self.used.any(axis=1)
        return np.array([record is not None and empty[record] for *_, record in self.space.sources], dtype=bool)

    def at_bound(self, x: np.ndarray, tolerance: float = 1e-4) -> list[Side | None]:
        """Which bound each parameter has reached, if any.

        Args:
            x: physical parameters of the model, shape (p,).
            tolerance: see `ParameterSpace.reached`.
        """
        low, high = self.space.reached(x, tolerance)
        return ["lower" if a else "upper" if b else None for a, b in zip(low, high, strict=True)]

    def on_bound(self, x: np.ndarray) -> np.ndarray:
        """Which parameters have reached a bound, shape (p,), bool."""
        return np.logical_or(*self.space.reached(x))

    # -- least squares -------------------------------------------------------------------------------------------------

    def predict(self, x: Any) -> list[np.ndarray]:
        """Free-run output of every record at physical x, shapes (T_r,), not writable: those of the last x are kept for the next call."""
        key = np.asarray(x, float).tobytes()
        if self._predicted is None or self._predicted[0] != key:
            rows = self._simulated(x)
            for row in rows:
                row.flags.writeable = False
            self._predicted = key, rows
        return self._predicted[1]

    def _simulated(self, x: Any) -> list[np.ndarray]:
        if self.model.has_fast_run:
            models = self.space.of_records(x, len(self.data), np.asarray)
            return [np.asarray(model.free_run(r.u, r.dt)) for model, r in zip(models, self.data, strict=True)]
        rows = predicted(self.objective, x, np.array([len(record) for record in self.data]))
        return [row[: len(record)] for row, record in zip(rows, self.data, strict=True)]

    def residuals(self, x: Any) -> Float[np.ndarray, "R T"]:
        """Prediction less measurement at physical x, output units, 0 where a sample does not count."""
        batch = self.objective.batch
        y, weight = np.asarray(batch.y), np.asarray(batch.weight)
        residual = np.zeros(y.shape)
        for row, measured, output in zip(residual, y, self.predict(x), strict=True):
            end = min(output.size, row.size)  # a trimmed batch may be shorter than its records
            row[:end] = output[:end] - measured[:end]
        return np.where(weight > 0, np.where(np.isfinite(residual), residual, BROKEN * self.scales.y), 0.0)

    def linearize(self, x: Any) -> tuple[Float[np.ndarray, "R T"], Float[np.ndarray, "R T p"]]:
        """`residuals` and their derivatives with respect to physical x, by one compiled program for all uses.

        Models with an exact design matrix use it: hundreds of weights have their derivatives from distinct states.
        """
        if not self._has_design:
            run = linearized_by_stretches if in_stretches(self.objective) else linearized
            return run(self.objective, np.asarray(x, float))
        jacobian = np.zeros((*self.used.shape, len(self.space)))
        for number, part, rows in responses(self.space, list(self.data), self.predict, np.asarray(x)):
            jacobian[number, part] = rows
        jacobian *= self.used[..., None]
        return self.residuals(x), jacobian

    @property
    def _has_design(self) -> bool:
        """Whether derivatives come from design matrices: those of many weights, beside few other parameters."""
        if not self.space.mostly_linear or not self.model.has_fast_run:
            return False
        linear = int(np.count_nonzero(self.space.linear))
        return self.model.estimator is not None or self.objective.batch.count * linear <= COLUMNS

    @property
    def closed_form(self) -> bool:
        """Whether the output is linear in all free parameters, and their columns come from design matrices."""
        return self._has_design and bool(self.space.linear.all())

    def misfit(self, x: Any) -> Float[np.ndarray, " n"]:
        """What least squares minimizes at physical x: weighted residuals in half output ranges, bent by the loss."""
        return misfit_of(self.objective, self.residuals(x))

    def linearize_misfit(self, x: Any) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n p"]]:
        """`misfit` and its derivatives with respect to physical x."""
        return misfit_of(self.objective, *self.linearize(x))

    def linearization(self, x: Any, gram: Float[np.ndarray, "p1 p1"] | None = None) -> Linearization:
        """`misfit` and its derivatives with respect to physical x.

        Those of long records, and those of many weights by design matrices, are never in memory all at once. `gram` is their normal
        matrix, where it is known.
        """
        if not self._has_design and in_stretches(self.objective):
            return linearization_by_stretches(self.objective, np.asarray(x, float))
        if not self._has_design:
            misfit, jacobian = self.linearize_misfit(x)
            return Linearization.of(misfit, jacobian, self.used.reshape(-1))
        misfit, slope = misfit_slope(self.objective, self.residuals(x))
        used, slope = self.used, slope.reshape(self.used.shape)

        def blocks() -> Iterator[np.ndarray]:
            for number, part, rows in responses(self.space, list(self.data), self.predict, np.asarray(x)):
                on = used[number, part]
                yield chosen(rows, on) * slope[number, part][on, None]

        if gram is None and used.size * len(self.space) <= NUMBERS:
            few = list(blocks())
            return Linearization(misfit, used.reshape(-1), len(self.space), lambda: iter(few))
        return Linearization(misfit, used.reshape(-1), len(self.space), blocks, gram=gram)

    def error_where_held_out(self, misfit: Float[np.ndarray, " n"]) -> float:
        """Rms residual [y] on the samples that are held out in turn, which alone enter the cross-validation error."""
        held, weight = np.zeros(self.used.shape, dtype=bool), np.asarray(self.objective.batch.weight)
        for row, fold in zip(held, self.held_out.folds, strict=True):
            row[: fold.size] = fold >= 0
        squares = np.sum(misfit[held.reshape(-1)] ** 2)
        return float(self.scales.y * np.sqrt(squares / weight[held].sum()))

    # -- likelihoods ---------------------------------------------------------------------------------------------------

    @functools.cached_property
    def host_setting(self) -> Setting:
        """`setting` with arrays of NumPy."""
        inputs = [record.u for record in self.data]
        limits = float(min(u.min() for u in inputs)), float(max(u.max() for u in inputs))
        return Setting.on_host(self.objective.batch, limits)

    @functools.cached_property
    def setting(self) -> Setting:
        """The data as noise models need them; places in the input are relative to the range of all samples."""
        return self.host_setting.on_device()

    @functools.cached_property
    def density(self) -> Density:
        """The traced log density over the unconstrained parameters of model and noise.

        Raises:
            ModelError: the problem has no noise model.
        """
        if self.noise_space is None:
            raise ModelError("a likelihood needs a noise model: use Problem.with_noise")
        return Density(self.objective, self.noise_space.coordinates, self.setting, self.priors, self.dependence)

    def whitened(self, noise: AbstractNoise | None = None) -> Whitened:
        """Least squares in the coordinates in which a Gaussian noise model (the problem's own by default) is white."""
        return Whitened(self.objective, noise or self.noise, self.setting)  # type: ignore[arg-type]

    def unconstrained(self, x: np.ndarray) -> np.ndarray:
        """z from physical parameters of model and noise, shape (d,)."""
        p = len(self.space)
        rest = [self.noise_space.unconstrained(x[p:])] if self.noise_space else []
        return np.concatenate([self.space.unconstrained(x[:p]), *rest])

    def log_likelihood(self, z: Any) -> float:
        """Log density of the data at unconstrained z."""
        return float(_run(self.density, "log_likelihood", to_device(z)))

    def log_prior(self, z: Any) -> float:
        """Log prior density over z."""
        return float(_run(self.density, "log_prior", to_device(z)))


@compiled
def _run(traced: Any, method: str, argument: Array) -> Any:
    """A method of an objective or density, compiled once for each method and shape."""
    return getattr(traced, method)(argument)
