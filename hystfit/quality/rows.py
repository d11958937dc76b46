"""Faults and noise of many outputs over one input, row by row: which need no closer look.

The limits are stricter than those of a single record (`faults`, `steady_cycle`): a row that passes here has no finding there.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from hystfit.quality.faults import MAD_TO_RMS

_FEWEST = 64  # samples
_ON_CURVE = 2**12  # samples on which a curve is fitted: its error is known to a percent
_LIMIT = 3  # samples at the largest or smallest output: a saturated sensor shows four
_SPARSE = 0.9  # noise by differences of order 6 over that of order 3, below which it still contains the signal
_ROUNDED = 0.06  # of the least step between neighbors: noise below it may be rounding
_SPIKE, _OF_RANGE = 9.0, 0.028  # times the noise, and of the range, that an outlier stands out from both neighbors


def row_noise(y: Float[np.ndarray, "N T"]) -> Float[np.ndarray, " N"]:
    """RMS of white noise in each row, from differences of order 2 to 6; NaN where it is uncertain or a rounding error."""
    difference = np.diff(y, axis=1)
    steps = np.abs(difference)
    least_step = np.min(np.where(steps > 0, steps, np.inf), axis=1)
    sizes = []
    for order in range(2, 7):
        difference = np.diff(difference, axis=1)
        middle = difference.shape[1] // 2
        median = np.partition(np.abs(difference), middle, axis=1)[:, middle]
        sizes.append(MAD_TO_RMS * median / math.sqrt(math.comb(2 * order, order)))
    least = np.min(sizes, axis=0)
    floor = np.maximum(_ROUNDED * least_step, 1e-15 * np.abs(y).max(axis=1))
    return np.where((least > floor) & (sizes[-1] >= _SPARSE * sizes[1]), least, np.nan)


def sound_rows(y: Float[np.ndarray, "N T"], noise: Float[np.ndarray, " N"]) -> np.ndarray:
    """Which rows have known noise and no sample that may be clipped or an outlier, shape (N,), bool."""
    if y.shape[1] < _FEWEST:
        return np.zeros(len(y), bool)
    low, high = y.min(axis=1, keepdims=True), y.max(axis=1, keepdims=True)
    stays = np.maximum((y == low).sum(axis=1), (y == high).sum(axis=1)) > _LIMIT
    before, after = y[:, 1:-1] - y[:, :-2], y[:, 1:-1] - y[:, 2:]
    apart = np.where(before * after > 0, np.minimum(np.abs(before), np.abs(after)), 0.0).max(axis=1)
    spiky = apart > np.maximum(_SPIKE * np.nan_to_num(noise), _OF_RANGE * (high - low)[:, 0])
    return np.isfinite(noise) & ~stays & ~spiky


def curve_errors(u: Float[np.ndarray, " T"], y: Float[np.ndarray, "N T"], degree: int) -> Float[np.ndarray, " N"]:
    """RMS error of the best polynomial over the input, for each row; on at most 4096 samples at even distances."""
    step = -(-u.size // _ON_CURVE)
    u, y = u[::step], y[:, ::step]
    low, high = u.min(), u.max()
    columns = np.polynomial.legendre.legvander((2 * u - low - high) / (high - low), degree)
    basis = np.linalg.qr(columns)[0]
    rest = y - (y @ basis) @ basis.T
    return np.sqrt(np.mean(rest**2, axis=1))
