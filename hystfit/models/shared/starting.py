"""What the models' starting values share: ranges, thinned records, and linear least squares on the host."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.batch import in_room
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record, median_interval
from hystfit.models.shared.simulation import run
from hystfit.params.host_arrays import compiled
from hystfit.params.units import Scales
from hystfit.quality.loops import clear_reversals

SAMPLES = 2**13  # of each record from which starting values are read, at most
LEAST = 1e-3  # of the range of the output: the smallest scale that a start gives a model whose scale is positive
LARGE, TYPICAL = 0.99, 0.9  # quantiles of the speeds of the input that count as the largest and as a typical one


class Range(NamedTuple):
    """Middle and half width of a signal; the half width is never zero."""

    center: float
    half: float

    @classmethod
    def of(cls, signals: Iterable[np.ndarray]) -> Range:
        """Of signals that are not all empty."""
        values = [signal for signal in signals if signal.size]
        low, high = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
        return cls(0.5 * (low + high), 0.5 * (high - low) or 1.0)

    @property
    def low(self) -> float:
        """The lowest value."""
        return self.center - self.half

    @property
    def high(self) -> float:
        """The highest value."""
        return self.center + self.half

    @property
    def width(self) -> float:
        """Distance from the lowest to the highest value."""
        return 2 * self.half


def input_range(records: Iterable[Record]) -> Range:
    """Range of the input over all records, the part before a fitting window too (it drives the model)."""
    return Range.of(r.u for r in records)


def fitted_input_range(records: Iterable[Record]) -> Range:
    """Range of the input from the first to the last sample that counts."""
    return Range.of(r.reached for r in records)


def output_range(records: Iterable[Record]) -> Range:
    """Range of the output over the samples that count."""
    return Range.of(r.y[r.used] for r in records)


def sampling_interval(records: Iterable[Record], without: float = 0.005) -> float:
    """Median of the positive time steps of records [s]."""
    return median_interval(np.concatenate([record.dt[1:] for record in records])) or without


def speeds(record: Record) -> np.ndarray:
    """Speeds of the input between the samples among which time passes [u/s], without sign."""
    passes = record.dt[1:] > 0
    return np.abs(np.diff(record.u))[passes] / record.dt[1:][passes]


def speed(records: Iterable[Record], quantile: float) -> float:
    """A quantile of the speeds of the input of records [u/s]; 1 where the input does not move in time."""
    every = np.concatenate([speeds(record) for record in records])
    return float(np.quantile(every, quantile)) or 1.0 if every.size else 1.0


def scales_of(data: Dataset) -> Scales:
    """Natural sizes and units of a data set: half ranges of input and output, a hundred sampling intervals."""
    records = list(data)
    typical = data.sampling_interval or 0.01
    units = data.units
    return Scales(
        input_range(records).half, output_range(records).half, 100 * typical, units["u"], units["y"], units["t"]
    )


def thinned(records: Sequence[Record], count: int = 500) -> list[Record]:
    """Records of about `count` samples, every k-th one and the points where the input turns: enough for starting values."""
    short = []
    for record in records:
        kept = np.arange(0, len(record), max(1, len(record) // count))
        kept = np.unique(np.concatenate([kept, clear_reversals(record.u)[:count], [len(record) - 1]]))
        short.append(record.take(kept) if record.used[kept].sum() > 20 else record)
    return short


def used_samples(records: Sequence[Record]) -> tuple[np.ndarray, np.ndarray]:
    """Input and output of all samples that count, record after record, shapes (n,)."""
    return np.concatenate([r.u[r.used] for r in records]), np.concatenate([r.y[r.used] for r in records])


def first_output(record: Record) -> float:
    """The first output that counts."""
    return float(record.y[record.first])


def fit_linear(columns: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, float]:
    """Least squares on columns of any scale: (coefficients, sum of squared residuals)."""
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    solution = np.linalg.lstsq(columns / size, y, rcond=1e-10)[0] / size
    return solution, float(np.sum((y - columns @ solution) ** 2))


def offset_columns(records: Sequence[Record]) -> np.ndarray:
    """A column of ones for each record on its samples that count: offsets of their own, shape (n, R)."""
    return np.repeat(np.eye(len(records)), [int(record.used.sum()) for record in records], axis=0)


@compiled
def simulated_grid(
    plain: Any, fields: tuple[str, ...], grid: tuple[Float[Array, "n ..."], ...], u: Float[Array, " T"], count: Any
) -> Float[Array, "n T"]:
    """Outputs of a model that needs no time, with its fields of these names at the values of each point of a grid."""
    model = lambda row: dataclasses.replace(plain, **dict(zip(fields, row, strict=True)))
    return jax.vmap(lambda row: run(model(row), u, jnp.zeros_like(u), count=count)[0])(grid)


class BestOfGrid(NamedTuple):
    """Number of a point of a grid, the coefficients of its output and of the fixed columns, and the squared error."""

    which: int
    coefficients: np.ndarray
    error: float

    def scale(self, y: np.ndarray) -> float:
        """The coefficient of the model's own output, or `LEAST` of the range of the outputs where it is below that [y]."""
        return max(float(self.coefficients[0]), LEAST * float(np.ptp(y)))


def grid_columns(plain: Any, grid: Mapping[str, np.ndarray], records: Sequence[Record]) -> np.ndarray:
    """`simulated_grid` over the samples that count, record after record, (n, K), at values of fields by their names, (K, ...)."""
    # Records of any length share one program where later samples change no output.
    inputs = [(in_room(r.u, hold=True), np.int64(len(r))) if plain.causal else (r.u, None) for r in records]
    runs = [np.asarray(simulated_grid(plain, tuple(grid), tuple(grid.values()), *one)) for one in inputs]
    return np.concatenate([run[:, : len(r)][:, r.used].T for run, r in zip(runs, records, strict=True)])


def best_of_grid(columns: np.ndarray, fixed: np.ndarray, y: np.ndarray) -> BestOfGrid:
    """The column that fits outputs y best beside the fixed columns, by linear least squares."""
    k = best_column(fixed, columns, y)
    return BestOfGrid(k, *fit_linear(np.column_stack([columns[:, k], fixed]), y))


def best_column(fixed: np.ndarray, candidates: np.ndarray, y: np.ndarray) -> int:
    """Which candidate column, (n, k), in addition to the fixed ones, (n, q), leaves the smallest sum of squared residuals."""
    Q = np.linalg.qr(fixed / np.maximum(np.linalg.norm(fixed, axis=0), 1e-300))[0]
    rest, others = y - Q @ (Q.T @ y), candidates - Q @ (Q.T @ candidates)
    size = np.sum(others**2, axis=0)
    new = size > 1e-20 * np.sum(candidates**2, axis=0)  # a column that the fixed ones span adds nothing
    return int(np.argmax(np.where(new, (rest @ others) ** 2 / np.where(new, size, 1.0), 0.0)))
