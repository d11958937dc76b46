"""Values of an evenly sampled, band-limited signal between its samples: a sinc under a Kaiser window."""

from __future__ import annotations

import functools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.models.shared.shapes import Signal

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
