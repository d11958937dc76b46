"""Linear recursions and plays on the host, over columns of samples."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy.linalg.lapack import dtbtrs


def lagged(columns: np.ndarray, time: float) -> np.ndarray:
    """Columns behind a first-order lag of this time constant [samples], from rest."""
    keep = float(np.exp(-1 / time))
    return columns[0] + recursion((1.0, -keep), (1 - keep) * (columns - columns[0]))


def recursion(taps: Sequence[float | np.ndarray], columns: np.ndarray) -> np.ndarray:
    """Columns y with taps[0] y[k] + taps[1] y[k - 1] + ... = columns[k], from rest: a banded triangular system.

    A tap that varies has a value for each sample y that it multiplies. As by `scipy.signal.lfilter`, whose import takes as long as a fit.
    """
    band = np.empty((len(taps), len(columns)), order="F")
    for diagonal, tap in zip(band, taps, strict=True):
        diagonal[:] = tap
    return dtbtrs(band, columns, uplo="L")[0]


_BLOCK = 32  # rows that one matrix product takes: 2 ms for 400 rows of 500 columns, which the recursion takes 16 ms for


def relaxed_columns(columns: np.ndarray, passed: np.ndarray) -> np.ndarray:
    """Columns z of tau dz/dt = x - z for columns x of steps, shape (T, K), from rest; `passed` are the time steps over tau, shape (T,)."""
    out = np.empty_like(columns)
    last = columns[0]
    for begin in range(0, len(columns), _BLOCK):
        rows = slice(begin, begin + _BLOCK)
        age = np.cumsum(passed[rows])
        kept = np.tril(np.exp(np.minimum(age - age[:, None], 0.0))) * -np.expm1(-passed[rows])
        out[rows] = kept @ columns[rows] + np.exp(-age)[:, None] * last
        last = out[rows][-1]
    return out


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
    p, radii = np.empty((radii.size, u.size)) if out is None else out.T, radii[:, None]
    p[:, 0] = u[0] if first is None else first
    rising = np.diff(u) > 0
    ends = np.concatenate([[0], np.flatnonzero(rising[1:] != rising[:-1]) + 1, [u.size - 1]])
    for start, stop in itertools.pairwise(ends.tolist()):
        way, at, run = u[start + 1 : stop + 1], p[:, start, None], p[:, start + 1 : stop + 1]
        if stop > start and rising[start]:
            np.maximum(np.subtract(way, radii, out=run), at, out=run)
        else:
            np.minimum(np.add(way, radii, out=run), at, out=run)
    return p.T
