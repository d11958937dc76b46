"""Sequential identifiers: `init`, `update` sample by sample, and `fit` as one scan of `update`."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import ParameterError
from hystfit.identify.identification import Identification, free_runs, run_metrics
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.shapes import Scalar
from hystfit.models.shared.starting import scales_of
from hystfit.outcome import Code, Note, Severity, Status
from hystfit.outcome.note import warn
from hystfit.params.space import ParameterSpace
from hystfit.results.accuracy import POOR, Metrics


class Sample(NamedTuple):
    """One measured sample, or an array of them along the first axis.

    Attributes:
        u: input.
        y: output; NaN where it was not measured or does not count.
        dt: time since the previous sample; 0 where there is no time.
        first: whether a record (or a pass over it) begins here, so that no step leads to this sample.
    """

    u: Float[Array, "..."]
    y: Float[Array, "..."]
    dt: Float[Array, "..."]
    first: Bool[Array, "..."]

    @classmethod
    def of(cls, u: Any, y: Any, dt: Any = 0.0, first: Any = False) -> Sample:
        """From plain numbers, or arrays of one shape."""
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
    """Diagnostics of one update.

    Attributes:
        theta: parameter vector of the identifier after the sample, shape (p,).
        error: one-step prediction error before the sample was used [y]; NaN where it was not used.
        used: whether the sample changed the parameters.
        variance: of the error, as the identifier predicts it [y^2]; None where it predicts none.
    """

    theta: Float[Array, " p"]
    error: Scalar
    used: Bool[Array, ""]
    variance: Scalar | None = None


class Run(NamedTuple):
    """A finished run over records, as `AbstractIdentifier.judge` gets it.

    Attributes:
        data: the records.
        state: final state of the identifier.
        history: parameter vector after every sample, shape (T, p).
        free_run: error of the final models driven by the input only; None without valid models, or where it is not finite.
    """

    data: Dataset
    state: Any
    history: np.ndarray
    free_run: Metrics | None


class Judgment(NamedTuple):
    """Assessment of a run.

    Attributes:
        status: `OK`, or the first problem found.
        notes: findings with their remedies.
        equation_error: RMS one-step error of the final parameters [y]; None where it is unknown.
    """

    status: Status
    notes: Sequence[Note] = ()
    equation_error: float | None = None


class AbstractIdentifier(eqx.Module):
    """A sequential identifier; its scales and settings are its fields.

    `init` and `update` are pure, so that they serve on-line use (jit `update` once) and `fit` alike. The state is a NamedTuple
    of few arrays: many small leaves in a scan carry are slow. An identifier in a file of its own is used by its name,
    `method="my_file.py:MyIdentifier"`.

    Attributes:
        method: name in results.
        solved: free parameters of the model that `model` determines for each record in addition to `names`.
    """

    method: eqx.AbstractClassVar[str]
    solved: eqx.AbstractClassVar[tuple[str, ...]]

    @classmethod
    @abc.abstractmethod
    def of(
        cls, model: AbstractHysteresis, data: Record | Dataset | Sequence[Record], **settings: Any
    ) -> AbstractIdentifier:
        """An identifier scaled to records.

        Args:
            model: structure and, where the identifier needs them, starting values.
            data: the records on which it will run.
            **settings: by keyword, each with a default.
        """

    @property
    @abc.abstractmethod
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in `physical`, as `ParameterSpace` has them."""

    @abc.abstractmethod
    def init(self) -> Any:
        """State before the first sample."""

    @abc.abstractmethod
    def update(self, state: Any, sample: Sample) -> tuple[Any, Info]:
        """One sample: new state and diagnostics."""

    @abc.abstractmethod
    def physical(self, theta: np.ndarray) -> np.ndarray:
        """Physical parameters, in the order of `names`, from theta: shape (..., p) to (..., p)."""

    @abc.abstractmethod
    def model(self, theta: np.ndarray, record: Record) -> AbstractHysteresis | None:
        """The identified model for one record; None where theta, finite, is not a valid model."""

    @abc.abstractmethod
    def judge(self, run: Run) -> Judgment:
        """Assessment of a finished run; the simulation error is judged after it."""

    def fit(self, data: Record | Dataset | Sequence[Record], *, passes: int = 1) -> Identification:
        """Run through records (`passes` times) in one scan.

        Raises:
            ParameterError: fewer than one pass.
            DataError: no records.
        """
        if passes < 1:
            raise ParameterError(f"at least one pass is needed, got {passes}")
        data = Dataset.of(data)
        stream = Sample.stream(list(data), passes)
        return self.conclude(data, stream, *run_stream(self, self.init(), stream))

    def conclude(self, data: Dataset, stream: Sample, state: Any, info: Info) -> Identification:
        """The identification from a finished run over a stream, with the state after it and what each update told."""
        history, errors = np.asarray(info.theta), np.asarray(info.error)
        models = self._models(history[-1], data)
        space = free_only(models[0], (*self.names, *self.solved), data) if models else None
        runs = free_runs(models, data)
        finite = bool(runs) and all(np.isfinite(run).all() for run in runs)
        metrics = run_metrics(runs, data) if finite else None
        status, notes, equation_error = self.judge(Run(data, state, history, metrics))
        notes = list(notes)
        problem = _simulation_problem(metrics, simulated=bool(runs))
        if problem is not None:
            status = Status.POOR if status is Status.OK else status
            notes.append(problem)
        return Identification(
            method=self.method,
            data=data,
            models=models,
            space=space,
            x=np.zeros(0) if space is None else space.vector(list(models)),
            names=self.names,
            history=self.physical(history),
            theta_history=history,
            errors=errors,
            equation_error=equation_error if equation_error is not None and np.isfinite(equation_error) else None,
            free_run=metrics,
            counts=_counts(stream, np.asarray(info.used)),
            status=status,
            notes=tuple(notes),
            state=state,
        )

    def _models(self, theta: np.ndarray, data: Dataset) -> tuple[AbstractHysteresis, ...]:
        """One model for each record; empty where theta is not a valid model."""
        if not np.isfinite(theta).all():
            return ()
        models = [self.model(theta, record) for record in data]
        valid = [model for model in models if model is not None]
        return tuple(valid) if len(valid) == len(models) else ()


@eqx.filter_jit
def run_stream(identifier: AbstractIdentifier, state: Any, stream: Sample) -> tuple[Any, Info]:
    """`update` over a stream of samples with leaves of shape (T,): the state after them, and `Info` with leaves of shape (T, ...)."""
    return jax.lax.scan(lambda carry, sample: identifier.update(carry, sample), state, stream)


def free_only(model: AbstractHysteresis, names: Sequence[str], data: Dataset) -> ParameterSpace:
    """The space of a model in which just some parameters are free, also those that the model fixes by default.

    A name is that of a leaf ("w"), an element ("w[2]") or a longer path; a record's label ("offset@run1") is ignored.
    """
    names = list(dict.fromkeys(name.partition("@")[0] for name in names))
    every = ParameterSpace.of(model, free=names)
    chosen = {(leaf, position) for leaf, positions in map(every.named.find, names) for position in positions}
    others = [name for name, source in zip(every.names, every.sources, strict=True) if source[:2] not in chosen]
    records = [record.name for record in data]
    return ParameterSpace.of(model, fix=others, free=names, scales=scales_of(data), records=records)


def _counts(stream: Sample, used: np.ndarray) -> dict[str, int]:
    u, y, first = (np.asarray(v) for v in (stream.u, stream.y, stream.first))
    missing = np.isnan(y)
    still = ~first & ~missing & (np.diff(u, prepend=u[0]) == 0)
    counts = {"total": u.size, "used": used.sum(), "still": still.sum(), "missing": missing.sum(), "first": first.sum()}
    return {name: int(value) for name, value in counts.items()}


def _simulation_problem(metrics: Metrics | None, *, simulated: bool) -> Note | None:
    """A note where the simulation is not finite or does not follow the record."""
    if metrics is None:
        text = "the simulation of the identified model is not finite: it is unstable at this sampling rate"
        return Note(Code.DIVERGED, text, Severity.ERROR) if simulated else None
    percent = metrics.nrmse_percent
    if percent is None or percent <= POOR:
        return None
    return warn(
        Code.SIMULATION_ERROR,
        f"the simulation error is {percent:.3g} % of the range (RMS), however small the one-step error",
    )
