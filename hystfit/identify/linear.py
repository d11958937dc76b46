"""What recursive least squares and gradient correction share: Duhem regressors, their checks, the first output."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError, ParameterError
from hystfit.identify.base import AbstractIdentifier, Sample
from hystfit.identify.regressors import DuhemRegressor, Rows
from hystfit.models.base import AbstractHysteresis, simulate
from hystfit.models.duhem import Duhem
from hystfit.models.starting import first_output

STARTS = ("zero", "model", "data")
_RANK = 1e-9  # of the largest singular value of the columns at unit length


class Equation(NamedTuple):
    """One row of the regression as it arrives.

    Attributes:
        phi: regressors, shape (p,), zero where the row is not usable.
        target: response, zero where the row is not usable.
        usable: the input moved, and the output was measured at both ends of the step.
        last: (u, y) of this sample, for the next row.
    """

    phi: Float[Array, " p"]
    target: Float[Array, ""]
    usable: Bool[Array, ""]
    last: Float[Array, "2"]


class LinearIdentifier(AbstractIdentifier):
    """An identifier whose one-step equation is linear: target = phi . theta + error."""

    regressor: eqx.AbstractVar[DuhemRegressor]
    theta0: eqx.AbstractVar[Float[Array, " p"]]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the Duhem model's free parameters."""
        return self.regressor.names

    def equation(self, last: Float[Array, "2"], sample: Sample) -> Equation:
        """The row that leads from the last sample to this one."""
        u0, y0 = last[0], last[1]
        usable = ~sample.first & jnp.isfinite(y0) & jnp.isfinite(sample.y) & (sample.u != u0)
        clean = lambda value: jnp.where(usable, value, 0.0)  # a NaN must not reach the product with zero
        phi, target = self.regressor.row(clean(u0), clean(sample.u), clean(y0), clean(sample.y))
        return Equation(clean(phi), clean(target), usable, jnp.stack([sample.u, sample.y]))

    def physical(self, theta: np.ndarray) -> np.ndarray:
        """alpha, f and g of the model."""
        return self.regressor.physical(theta)

    def model(self, theta: np.ndarray, record: Record) -> Duhem | None:
        """The model whose first output fits the record best; None where the rate is not positive."""
        model = self.regressor.model(theta, first_output(record))
        return None if model is None else with_first_output(model, record)

    def one_step(self, theta: np.ndarray, data: Dataset) -> np.ndarray:
        """Equation errors of fixed parameters over all usable rows [y]."""
        rows = rows_of(self.regressor, data)
        return (rows.target - rows.phi @ np.asarray(theta)) * float(self.regressor.target_unit)

    def excitation(self, rows: Rows) -> tuple[str, list[str]]:
        """Whether the rows determine all parameters."""
        rank, size = rank_of(rows.phi), self.regressor.p
        if rank == size:
            return "ok", []
        return "undetermined", [
            f"the regressors have rank {rank} of {size}: this input does not determine all parameters (one that never "
            "turns back cannot tell f from g); add reversals of several amplitudes, or lower the orders of f and g"
        ]

    def validity(self, history: np.ndarray) -> tuple[str, list[str]]:
        """Whether the final theta is finite and its rate positive."""
        theta = history[-1]
        if not np.isfinite(theta).all():
            at = int(np.argmax(~np.isfinite(history).all(axis=1)))
            return "diverged", [f"the parameters ceased to be finite at sample {at}"]
        rate = theta[self.regressor.m] / float(self.regressor.half)
        if not np.isfinite(self.regressor.physical(theta)).all():
            return "failed", [
                f"the identified rate alpha = {rate:.4g} is not positive: that is no hysteresis; a delay between input and "
                "output, noise larger than the increments, or too short a record does this"
            ]
        return "ok", []


def starting_theta(
    regressor: DuhemRegressor, model: AbstractHysteresis, records: Sequence[Record], start: str
) -> Array:
    """theta at zero, at a model's values, or at those that `Duhem.start` reads off the records.

    Raises:
        ParameterError: an unknown start.
    """
    if start not in STARTS:
        raise ParameterError(f"start must be one of {', '.join(STARTS)}, got {start!r}")
    if start == "zero":
        return jnp.zeros(regressor.p)
    return jnp.asarray(regressor.theta(model if start == "model" else model.start(records)))


def rows_of(regressor: DuhemRegressor, data: Dataset) -> Rows:
    """Rows of all records one after another."""
    parts = [regressor.rows(record) for record in data]
    offsets = np.cumsum([0, *(len(record) for record in data)])[:-1]
    parts = [part._replace(at=part.at + offset) for part, offset in zip(parts, offsets, strict=True)]
    return Rows(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def check_enough(regressor: DuhemRegressor, data: Dataset) -> Rows:
    """The rows of a data set.

    Raises:
        DataError: fewer usable rows than parameters.
    """
    rows = rows_of(regressor, data)
    if rows.target.size < regressor.p:
        raise DataError(
            f"{rows.target.size} usable steps cannot determine {regressor.p} parameters: give more samples (those at which "
            "the input stands still or the output is missing do not count), or lower the orders of f and g"
        )
    return rows


def rank_of(phi: np.ndarray) -> int:
    """Numerical rank of columns of any scale."""
    size = np.linalg.norm(phi, axis=0)
    values = np.linalg.svd(phi / np.where(size > 0, size, 1.0), compute_uv=False)
    return int(np.sum(values > _RANK * values[0]))


def with_first_output(model: Duhem, record: Record) -> Duhem:
    """The same model with the first output that fits a record best; the free run is linear in it."""
    put = lambda value: eqx.tree_at(lambda m: m.w0, model, jnp.asarray(value, dtype=jnp.result_type(float)))
    base = float(model.w0)
    low, high = (np.asarray(simulate(put(base + shift), record.u)[0])[record.used] for shift in (0.0, 1.0))
    decay, left = high - low, record.y[record.used] - low
    if not (np.isfinite(decay).all() and np.isfinite(left).all()):
        return model
    weight = np.asarray(record.weight)[record.used]
    norm = float(np.sum(weight * decay**2))
    return put(base + float(np.sum(weight * decay * left)) / norm) if norm > 0 else model
