"""The problem that every estimator solves: a parameter space, a batch of data, and how misfit is counted."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import require_x64
from hystfit.data.batch import Batch
from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError, ModelError
from hystfit.models.base import AbstractHysteresis, run
from hystfit.models.starting import input_range, output_range
from hystfit.params.coordinates import Coordinates
from hystfit.params.space import ParameterSpace
from hystfit.params.units import Scales

Loss = Literal["linear", "huber", "soft-l1", "cauchy"]
_BROKEN = 1e3  # residual, in units of the output's half range, that stands for a simulation that is not finite


class Objective(eqx.Module):
    """The traced half of a `Problem`: arrays and structure, which compiled code takes as an argument.

    Attributes:
        coordinates: maps from z to the model.
        batch: the data.
        size: half range of the output, by which residuals are divided.
        loss: how large residuals count; "linear" is plain least squares.
        bend: residual, in the same units, beyond which a robust loss counts less.
    """

    coordinates: Coordinates
    batch: Batch
    size: Float[Array, ""]
    bend: Float[Array, ""]
    loss: Loss = eqx.field(static=True, default="linear")

    def predict_physical(self, x: Float[Array, " p"]) -> Float[Array, "R T"]:
        """Free run of every record at physical parameters x."""

        def one(record: Any) -> Array:
            return run(self.coordinates.assemble(x, record), self.batch.u[record], self.batch.dt[record])[0]

        if self.batch.u.shape[0] == 1:
            return one(0)[None]
        return jax.lax.map(one, jnp.arange(self.batch.u.shape[0]))

    def predict(self, z: Float[Array, " p"]) -> Float[Array, "R T"]:
        """Free run of every record at unconstrained parameters z."""
        return self.predict_physical(self.coordinates.physical(z))

    def misfit(self, x: Float[Array, " p"]) -> Float[Array, " n"]:
        """Residuals at physical x, weighted, in units of the output's half range, 0 where a sample does not count: shape (R * T,).

        Bent by the robust loss, so that half their sum of squares is the cost.
        """
        raw = (self.predict_physical(x) - self.batch.y) / self.size
        raw = jnp.where(jnp.isfinite(raw), raw, _BROKEN)
        return _bend((jnp.sqrt(self.batch.weight) * raw).reshape(-1), self.bend, self.loss)

    def residuals(self, z: Float[Array, " p"]) -> Float[Array, " n"]:
        """`misfit` at unconstrained z."""
        return self.misfit(self.coordinates.physical(z))


def _bend(r: Array, bend: Array, loss: Loss) -> Array:
    """sign(r) sqrt(rho(r^2)) for the loss rho: any least-squares solver then minimizes the robust cost."""
    if loss == "linear":
        return r
    square = (r / bend) ** 2
    if loss == "soft-l1":
        rho_over = 2.0 / (1.0 + jnp.sqrt(1.0 + square))
    elif loss == "cauchy":
        rho_over = jnp.where(square > 1e-12, jnp.log1p(square) / jnp.where(square > 1e-12, square, 1.0), 1.0)
    else:
        rho_over = jnp.where(
            square > 1.0, (2.0 * jnp.sqrt(jnp.maximum(square, 1.0)) - 1.0) / jnp.maximum(square, 1.0), 1.0
        )
    return r * jnp.sqrt(rho_over)


class Problem:
    """A model, data, and which parameters are free: what estimators take.

    Attributes:
        model: the model whose values fixed parameters keep.
        data: the records.
        space: the free parameters by name.
        objective: the traced half.
    """

    def __init__(
        self,
        model: AbstractHysteresis,
        data: Record | Dataset | Sequence[Record],
        *,
        fix: Sequence[str] | Mapping[str, Any] = (),
        free: Sequence[str] = (),
        loss: Loss = "linear",
    ):
        """Check that data and model fit each other, and collect the parameters.

        Raises:
            PrecisionError: double precision is off.
            DataError: nothing to fit, a constant input or output, fewer samples than parameters.
            ModelError: not a model, a model that needs time with data that have none.
            ParameterError: see `ParameterSpace.of`.
        """
        require_x64()
        if not isinstance(model, AbstractHysteresis):
            raise ModelError(f"expected a hystfit model, got {type(model).__name__}")
        self.data = Dataset.of(data)
        check_fittable(model, self.data)
        self.model = model
        self.scales = scales_of(self.data)
        names = [record.name for record in self.data]
        self.space = ParameterSpace.of(model, fix=fix, free=free, scales=self.scales, records=names)
        batch = Batch.of(self.data)
        # The weights of a Preisach model are many and smooth: their number says little about what data determine.
        if batch.count < len(self.space) and model.estimator != "preisach":
            raise DataError(
                f"{batch.count} samples cannot determine {len(self.space)} parameters; give more data or fix some with fix="
            )
        bend = jnp.asarray(0.02)  # a robust loss bends at 1 % of the range
        self.objective = Objective(self.space.coordinates, batch, jnp.asarray(self.scales.y), bend, loss)

    def reweighted(self, weights: Sequence[np.ndarray]) -> Problem:
        """The same problem with other weights, one array (T,) for each record; shapes stay, so that nothing compiles anew."""
        changed = [record.replace(weight=weight) for record, weight in zip(self.data, weights, strict=True)]
        other = copy.copy(self)
        other.data = Dataset(tuple(changed))
        other.objective = eqx.tree_at(lambda o: o.batch, self.objective, Batch.of(other.data))
        return other

    def predict_at(self, x: Any) -> list[np.ndarray]:
        """Free-run output of every record at physical x, shapes (T_r,)."""
        if self.model.short_cut:
            models = [self.space.coordinates.assemble(jnp.asarray(x), k) for k in range(len(self.data))]
            return [model.free_run(r.u, r.dt) for model, r in zip(models, self.data, strict=True)]
        rows = np.asarray(_predict_physical(self.objective, jnp.asarray(x)))
        return [row[: len(record)] for row, record in zip(rows, self.data, strict=True)]

    def residuals(self, z: Any) -> np.ndarray:
        """Weighted residuals in units of the output's half range at z, shape (R * T,)."""
        return np.asarray(_residuals(self.objective, jnp.asarray(z)))


@eqx.filter_jit
def _predict_physical(objective: Objective, x: Array) -> Array:
    return objective.predict_physical(x)


@eqx.filter_jit
def _residuals(objective: Objective, z: Array) -> Array:
    return objective.residuals(z)


def scales_of(data: Dataset) -> Scales:
    """Natural sizes and units of a data set: half ranges of input and output, a hundred sampling intervals."""
    records = list(data)
    steps = np.concatenate([record.dt[1:] for record in records])
    typical = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.01
    units = data.units
    return Scales(
        input_range(records).half, output_range(records).half, 100 * typical, units["u"], units["y"], units["t"]
    )


def check_fittable(model: AbstractHysteresis, data: Dataset) -> None:
    """Refuse data on which no fit can mean anything.

    Raises:
        DataError: no samples count, a constant input or output.
        ModelError: the model depends on time and a record has none.
    """
    for record in data:
        if not record.used.any():
            raise DataError(f"record {record.name!r}: no sample counts in the window")
        if np.ptp(record.u) == 0:
            raise DataError(f"record {record.name!r}: the input is constant ({record.u[0]:g}); there is no loop to fit")
        if record.t is None and not model.rate_independent:
            raise ModelError(
                f"{type(model).__name__} depends on time and record {record.name!r} has no time column: name it with time=, "
                "or choose a rate-independent model"
            )
    if all(np.ptp(record.y[record.used]) == 0 for record in data):
        raise DataError("the output is constant: there is nothing to fit")
