"""Of the oscillator: starting values, by a linear fit to the transfer function and grids over the loop; its force between samples."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy  # loads its subpackages when they are first used
from jaxtyping import Array, Float

from hystfit.data.batch import Batch
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.shapes import Signal
from hystfit.models.shared.simulation import run
from hystfit.models.shared.starting import output_range
from hystfit.params.host_arrays import compiled
from hystfit.quality.resonance import EXCITED

# Values of a, r_load and r_unl. A spring that saturates has a basin of its own, which no start with a milder spring reaches: the best
# start of either grid is fitted, whatever their costs before the fit.
_MILD = tuple(itertools.product((0.2, 0.5, 0.8), (-0.6, 0.0, 0.6), (0.0, 0.6, 1.5)))
_SATURATING = tuple(itertools.product((0.2, 0.4, 0.6), (1.5, 3.0), (0.0, 0.6, 1.5)))
_MILD_STARTS, _SATURATING_STARTS = 2, 1
_VARIED = ("m", "c", "K", "a", "r_load", "r_unl", "Z")  # parameters that take starting values, beside the offset
# Stiffness at small amplitude over that of the linear fit, which a saturating spring lowers.
_SOFTENED = 1.8


def oscillator_starts(model: Any, records: Sequence[Record]) -> tuple[Any, ...]:
    """The oscillator with the best starting values that were found, the best first.

    The model keeps its exponent.
    """
    mass, damping, stiffness = _linear(records)
    force = 0.5 * stiffness * output_range(records).half
    points = [(mass, damping, stiffness, *shape, force) for shape in _MILD]
    points += [(mass, damping, _SOFTENED * stiffness, *shape, np.sqrt(_SOFTENED) * force) for shape in _SATURATING]
    batch = Batch.of(Dataset(tuple(record.take(slice(0, 2**15)) for record in records)))
    model = dataclasses.replace(model, offset=0.0)
    costs, offsets = (np.asarray(v) for v in _costs(model, jnp.asarray(points), batch))
    order = np.argsort(np.where(np.isfinite(costs), costs, np.inf), kind="stable")
    mild = order < len(_MILD)
    best = [*order[mild][:_MILD_STARTS], *order[~mild][:_SATURATING_STARTS]]
    return tuple(
        dataclasses.replace(model, **dict(zip(_VARIED, points[k], strict=True)), offset=np.nan_to_num(offsets[k]))
        for k in sorted(best, key=costs.__getitem__)
    )


@compiled
def _costs(model: AbstractHysteresis, table: Array, batch: Batch) -> tuple[Array, Array]:
    """Sum of squared residuals about the mean of each record, and that mean of the first record, for each row of the table."""

    def one(row: Array) -> tuple[Array, Array]:
        def of(record: tuple[Array, ...]) -> tuple[Array, Array]:
            u, y, dt, weight = record
            rest = y - run(dataclasses.replace(model, **dict(zip(_VARIED, row, strict=True))), u, dt)[0]
            mean = jnp.sum(weight * rest) / jnp.maximum(jnp.sum(weight), 1e-300)
            return jnp.sum(weight * (rest - mean) ** 2), mean

        squares, means = jax.lax.map(of, (batch.u, batch.y, batch.dt, batch.weight))
        return jnp.sum(squares), means[0]

    return jax.lax.map(one, table)


def _linear(records: Sequence[Record]) -> tuple[float, float, float]:
    """Mass, damping and stiffness of U = (K - m w^2 + i w c) Y by non-negative least squares on the excited lines."""
    rows, right, highest, lowest = [], [], 0.0, np.inf
    for record in records:
        w, U, Y = _spectra(record)
        columns = np.stack([-(w**2) * Y, 1j * w * Y, Y], axis=1)
        rows += [columns.real, columns.imag]
        right += [U.real, U.imag]
        highest, lowest = max(highest, w.max()), min(lowest, w.min())
    A, b = np.concatenate(rows), np.concatenate(right)
    size = np.linalg.norm(A, axis=0)
    size[size == 0] = 1.0
    m, c, K = scipy.optimize.nnls(A / size, b)[0] / size
    # What the data leave at zero: a resonance outside the excited band, and little damping.
    m, K = (m or K / (3 * highest) ** 2), (K or m * (lowest / 3) ** 2)
    if not m > 0:
        K = 1.0
        m = K / highest**2
    return float(m), float(max(c, 1e-3 * np.sqrt(m * K))), float(K)


def _spectra(record: Record) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angular frequencies [1/s] of the excited lines, and the spectra of input and output there, under a Hann window."""
    t = np.arange(len(record), dtype=float) if record.t is None else record.t
    even = np.linspace(t[0], t[-1], len(record))
    window = np.hanning(len(record))
    used = record.used
    u, y = np.interp(even, t, record.u), np.interp(even, t[used], record.y[used])
    spectrum = lambda values: np.fft.rfft((values - values.mean()) * window)
    U, Y = spectrum(u), spectrum(y)
    power = np.abs(U) ** 2
    power[0] = 0.0
    kept = power >= EXCITED * power.max()
    kept[0] = False
    w = 2 * np.pi * np.fft.rfftfreq(len(record), (even[-1] - even[0]) / (len(record) - 1) or 1.0)
    return w[kept], U[kept], Y[kept]


REACH = 24  # samples on each side of an interval that its values depend on
_BETA = 8.0  # shape of the Kaiser window
_BLOCK = 16  # intervals in one row of the product below; three blocks hold the 48 samples around an interval


@functools.cache
def _weights(parts: int) -> np.ndarray:
    """Shape (parts - 1, 2 REACH): weights of the samples around an interval at 1 / parts, 2 / parts, ... of it; their sum is one."""
    distance = np.arange(1, parts)[:, None] / parts - np.arange(1 - REACH, REACH + 1)
    window = np.i0(_BETA * np.sqrt(1 - (distance / REACH) ** 2)) / np.i0(_BETA)
    weights = np.sinc(distance) * window
    return weights / weights.sum(axis=1, keepdims=True)


@functools.cache
def _block_weights(parts: int) -> np.ndarray:
    """Shape (4 _BLOCK, _BLOCK (parts - 1)): the same for all intervals of a block at once."""
    weights = _weights(parts)
    matrix = np.zeros((4 * _BLOCK, _BLOCK, parts - 1))
    for k in range(_BLOCK):
        matrix[k : k + 2 * REACH, k] = weights.T
    return matrix.reshape(4 * _BLOCK, -1)


def upsample(x: Signal, parts: int) -> Float[Array, "T-1 {parts}+1"]:
    """Values at 0, 1 / parts, ..., 1 of each interval between samples; beyond its ends the signal is constant."""
    count = x.shape[0] - 1
    rows = -(-count // _BLOCK) + 3  # a row of the product reads four blocks of samples
    padded = jnp.pad(x, (REACH - 1, rows * _BLOCK - x.shape[0] - REACH + 1), mode="edge").reshape(rows, _BLOCK)
    four = jnp.concatenate([padded[k : rows - 3 + k] for k in range(4)], axis=1)
    inner = (four @ jnp.asarray(_block_weights(parts), x.dtype)).reshape(-1, parts - 1)[:count]
    return jnp.concatenate([x[:-1, None], inner, x[1:, None]], axis=1)
