"""Linear recursions and plays on the host, over columns of samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.linalg.lapack import dtbtrs

# Columns from which matrices of blocks take less time than a banded system, which adds one number at a time: of 803 samples of 506 columns
# 0.24 of it with blocks of 16 samples.
_WIDE = 64
_BLOCK = 16


def lagged(columns: np.ndarray, time: float) -> np.ndarray:
    """Columns behind a first-order lag of this time constant [samples], from rest."""
    keep = float(np.exp(-1 / time))
    return columns[0] + recursion((1.0, -keep), (1 - keep) * (columns - columns[0]))


def recursion(taps: Sequence[float | np.ndarray], columns: np.ndarray) -> np.ndarray:
    """Columns y with taps[0] y[k] + taps[1] y[k - 1] + ... = columns[k], from rest: a banded triangular system.

    A tap that varies has a value for each sample y that it multiplies. As by `scipy.signal.lfilter`, whose import takes as long as a fit.
    """
    if len(taps) == 2 and np.ndim(taps[0]) == 0 and columns.shape[1] >= _WIDE:
        return _first_order(-np.resize(taps[1], len(columns)) / taps[0], columns / taps[0])
    band = np.empty((len(taps), len(columns)), order="F")
    for diagonal, tap in zip(band, taps, strict=True):
        diagonal[:] = tap
    return dtbtrs(band, columns, uplo="L")[0]


def _first_order(kept: np.ndarray, columns: Float[np.ndarray, "T p"]) -> Float[np.ndarray, "T p"]:
    """Columns y with y[k + 1] = kept[k] y[k] + columns[k + 1], from rest, by products of matrices for blocks of samples."""
    count, width = columns.shape
    blocks = -(-count // _BLOCK)
    padded = np.zeros((blocks * _BLOCK, width))
    padded[:count] = columns
    factors = np.zeros((blocks, _BLOCK))
    factors.reshape(-1)[1:count] = kept[: count - 1]
    response = np.zeros((blocks, _BLOCK, _BLOCK))  # of each sample of a block to those before it in the block
    for k in range(_BLOCK):
        response[:, k] = factors[:, k, None] * response[:, k - 1]
        response[:, k, k] = 1.0
    out = response @ padded.reshape(blocks, _BLOCK, width)
    passed = np.cumprod(factors, axis=1)  # part of the last sample before a block
    for k in range(1, blocks):
        out[k] += np.multiply.outer(passed[k], out[k - 1, -1])
    return out.reshape(-1, width)[:count]


def play_positions(
    u: np.ndarray, radii: np.ndarray, first: np.ndarray | None = None, out: np.ndarray | None = None
) -> np.ndarray:
    """Positions of plays, run by run of monotonic input, shape (T, K).

    Args:
        u: input, shape (T,).
        radii: half widths of the plays [u], shape (K,).
        first: positions at the first input, shape (K,); None where they rest on it.
        out: where they are written; its transpose is best contiguous, as a run then lies together in memory.
    """
    p = np.empty((radii.size, u.size)) if out is None else out.T
    p[:, 0] = u[0] if first is None else first
    if u.size == 1:
        return p.T
    rising = np.diff(u) > 0
    ends = np.concatenate([[0], np.flatnonzero(rising[1:] != rising[:-1]) + 1, [u.size - 1]])
    # At the ends of the runs one after another, since noise makes thousands of them; between these by the run's begin.
    rises = rising[ends[:-1]]
    reached = u[ends[1:], None] + np.where(rises[:, None], -radii, radii)
    at_ends = np.empty((ends.size, radii.size))
    at_ends[0] = p[:, 0]
    for k, up in enumerate(rises.tolist()):
        (np.maximum if up else np.minimum)(at_ends[k], reached[k], out=at_ends[k + 1])
    rest, radius = p[:, 1:], radii[:, None]
    rest[:] = np.repeat(at_ends[:-1].T, np.diff(ends), axis=1)
    np.minimum(np.maximum(rest, u[1:] - radius, out=rest), u[1:] + radius, out=rest)
    return p.T
