"""Faults and noise of many outputs over one input, row by row: which need no closer look.

The limits are stricter than those of a single record (`faults`, `steady_cycle`): a row that passes here has no finding there.
Each function takes the module of its arrays, NumPy or jax.numpy.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from hystfit.quality.faults import MAD_TO_RMS

_FEWEST = 64  # samples
_ON_CURVE = 2**12  # samples on which a curve is fitted: its error is known to a percent
_LIMIT = 3  # samples at the largest or smallest output: a saturated sensor shows four
_SPARSE = 0.9  # noise by differences of order 6 over that of order 3, below which it still contains the signal
_ROUNDED = 0.06  # of the least step between neighbors: noise below it may be rounding
_SPIKE, _OF_RANGE = 9.0, 0.028  # times the noise, and of the range, that an outlier stands out from both neighbors


def row_noise(y: Float[Any, "N T"], xp: Any = np) -> Float[Any, " N"]:
    """RMS of white noise in each row, from differences of order 2 to 6; NaN where it is uncertain or a rounding error."""
    difference = xp.diff(y, axis=1)
    steps = xp.abs(difference)
    least_step = xp.min(xp.where(steps > 0, steps, xp.inf), axis=1)
    sizes = []
    for order in range(2, 7):
        difference = xp.diff(difference, axis=1)
        middle, size = difference.shape[1] // 2, xp.abs(difference)
        # On a GPU a sort takes less time than a selection.
        median = (np.partition(size, middle, axis=1) if xp is np else xp.sort(size, axis=1))[:, middle]
        sizes.append(MAD_TO_RMS * median / math.sqrt(math.comb(2 * order, order)))
    least = xp.min(xp.stack(sizes), axis=0)
    floor = xp.maximum(_ROUNDED * least_step, 1e-15 * xp.abs(y).max(axis=1))
    return xp.where((least > floor) & (sizes[-1] >= _SPARSE * sizes[1]), least, xp.nan)


def sound_rows(y: Float[Any, "N T"], noise: Float[Any, " N"], xp: Any = np) -> Any:
    """Which rows have known noise and no sample that may be clipped or an outlier, shape (N,), bool."""
    if y.shape[1] < _FEWEST:
        return xp.zeros(len(y), bool)
    low, high = y.min(axis=1, keepdims=True), y.max(axis=1, keepdims=True)
    stays = xp.maximum((y == low).sum(axis=1), (y == high).sum(axis=1)) > _LIMIT
    steps = xp.diff(y, axis=1)
    before, after = steps[:, :-1], steps[:, 1:]
    apart = xp.where(before * after < 0, xp.minimum(xp.abs(before), xp.abs(after)), 0.0).max(axis=1)
    spiky = apart > xp.maximum(_SPIKE * xp.nan_to_num(noise), _OF_RANGE * (high - low)[:, 0])
    return xp.isfinite(noise) & ~stays & ~spiky


def polynomials(u: Float[np.ndarray, " T"], degree: int) -> Float[np.ndarray, "m k"]:
    """Orthonormal polynomials over the input for `curve_errors`, on at most 4096 samples at even distances."""
    u = u[:: _stride(u.size)]
    low, high = u.min(), u.max()
    return np.linalg.qr(np.polynomial.legendre.legvander((2 * u - low - high) / (high - low), degree))[0]


def curve_errors(basis: Float[Any, "m k"], y: Float[Any, "N T"], xp: Any = np) -> Float[Any, " N"]:
    """RMS error of the best of these polynomials over the input, for each row."""
    y = y[:, :: _stride(y.shape[1])]
    rest = y - (y @ basis) @ basis.T
    return xp.sqrt(xp.mean(rest**2, axis=1))


def _stride(samples: int) -> int:
    return -(-samples // _ON_CURVE)
