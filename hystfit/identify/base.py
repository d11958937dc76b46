"""What every sequential identifier is: `init`, `update` sample by sample, and `fit` as one scan of `update`."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hystfit.data.record import Dataset, Record
from hystfit.errors import ParameterError
from hystfit.identify.identification import Identification, conclude
from hystfit.models.base import AbstractHysteresis


class Sample(NamedTuple):
    """One measured sample, or an array of them along the first axis.

    Attributes:
        u: input.
        y: output; NaN where it was not measured or does not count.
        dt: time since the sample before; 0 where there is no time.
        first: whether a record (or a pass over it) begins here, so that no step leads to this sample.
    """

    u: Float[Array, "..."]
    y: Float[Array, "..."]
    dt: Float[Array, "..."]
    first: Bool[Array, "..."]

    @classmethod
    def of(cls, u: Any, y: Any, dt: Any = 0.0, first: Any = False) -> Sample:
        """From plain numbers."""
        dtype = jnp.result_type(float)
        return cls(jnp.asarray(u, dtype), jnp.asarray(y, dtype), jnp.asarray(dt, dtype), jnp.asarray(first, bool))

    @classmethod
    def stream(cls, records: Sequence[Record], passes: int = 1) -> Sample:
        """All samples of records one after another, `passes` times: leaves of shape (T,)."""
        u = np.concatenate([record.u for record in records])
        y = np.concatenate([np.where(record.used, record.y, np.nan) for record in records])
        dt = np.concatenate([record.dt for record in records])
        first = np.concatenate([np.arange(len(record)) == 0 for record in records])
        return cls.of(*(np.tile(column, passes) for column in (u, y, dt, first)))


class Info(NamedTuple):
    """What one update tells.

    Attributes:
        theta: the identifier's own parameter vector after the sample, shape (p,).
        error: one-step prediction error before the sample was used [y]; NaN where it was not used.
        used: whether the sample changed the parameters.
        variance: of the error as the identifier predicts it [y^2]; None where it predicts none.
    """

    theta: Float[Array, " p"]
    error: Float[Array, ""]
    used: Bool[Array, ""]
    variance: Float[Array, ""] | None = None


class AbstractIdentifier(eqx.Module):
    """A sequential identifier; what it identifies, its scales and its settings are its fields.

    `init` and `update` are pure, so that they serve on-line use (jit `update` once) and `fit` alike. The state is a NamedTuple of
    few arrays: many small leaves in a scan carry are slow.
    """

    method: eqx.AbstractClassVar[str]

    @property
    @abc.abstractmethod
    def names(self) -> tuple[str, ...]:
        """Names of the physical parameters."""

    @abc.abstractmethod
    def init(self) -> Any:
        """State before the first sample."""

    @abc.abstractmethod
    def update(self, state: Any, sample: Sample) -> tuple[Any, Info]:
        """Take in one sample: (new state, what it told)."""

    @abc.abstractmethod
    def physical(self, theta: np.ndarray) -> np.ndarray:
        """Physical parameters, in the order of `names`, from theta: shape (..., p) to (..., p)."""

    @abc.abstractmethod
    def model(self, theta: np.ndarray, record: Record) -> AbstractHysteresis | None:
        """The identified model as a record sees it; None where theta is no valid model."""

    @abc.abstractmethod
    def one_step(self, theta: np.ndarray, data: Dataset) -> np.ndarray:
        """One-step prediction errors of fixed parameters over all records [y]."""

    @abc.abstractmethod
    def judge(self, data: Dataset, state: Any, history: np.ndarray, errors: np.ndarray) -> tuple[str, list[str]]:
        """Status ("ok" or what is wrong) and notes with the remedy, from the final state and the history of theta."""

    def fit(self, data: Record | Dataset | Sequence[Record], *, passes: int = 1) -> Identification:
        """Run through records (`passes` times) in one scan.

        Raises:
            ParameterError: no pass is asked for.
            DataError: no records.
        """
        if passes < 1:
            raise ParameterError(f"at least one pass is needed, got {passes}")
        data = Dataset.of(data)
        stream = Sample.stream(list(data), passes)
        state, info = run_stream(self, self.init(), stream)
        return conclude(self, data, stream, state, info)

    def replace(self, **changes: Any) -> Any:
        """Copy with some fields changed."""
        return dataclasses.replace(self, **changes)


@eqx.filter_jit
def run_stream(identifier: AbstractIdentifier, state: Any, stream: Sample) -> tuple[Any, Info]:
    """`update` over samples of shape (T,): the state after them, and `Info` with leaves of shape (T, ...)."""
    return jax.lax.scan(lambda carry, sample: identifier.update(carry, sample), state, stream)
