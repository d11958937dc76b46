"""Slow and independent noise of evenly sampled records in cosine coordinates, where its covariance is diagonal but for two samples.

The inverse correlation matrix of an Ornstein-Uhlenbeck process at even steps is tridiagonal with constant entries, apart from its two
corners. Without the corners the discrete cosine transform diagonalizes it; they are a correction of rank two (Woodbury). A likelihood
at other parameters then needs a few sums over frequencies in place of a tridiagonal factorization.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import scipy  # loads its subpackages when they are first used
from jaxtyping import Float

from hystfit.outcome.table import ROUNDING
from hystfit.params.host_arrays import NUMBERS

_BLOCK = 2**14  # frequencies summed at once
# The same of fits whose noise is sought side by side: memory of this size is used again. Four times as much is mapped anew in each step:
# six threads with 84 fits of 2000 samples each spent 3.2 s in the system, and 0.3 s with this.
BESIDE = 2**20


@dataclasses.dataclass(frozen=True)
class EvenRows:
    """Columns of one evenly sampled record with one weight, by frequency; or those of several records with the same samples."""

    rows: Float[np.ndarray, "*N k n"]  # their cosine transforms, shape (..., k, n)
    ends: Float[np.ndarray, "2 n"]  # those of its first and last sample, shape (2, n)
    curvature: Float[np.ndarray, " n"]  # eigenvalues of the second difference, shape (n,)
    gap: float  # step, in typical sampling intervals
    weight: float  # of every sample

    @classmethod
    def of(cls, columns: Sequence[np.ndarray], gap: Float[np.ndarray, " n"], weight: np.ndarray) -> EvenRows | None:
        """The transforms; None where several records, uneven steps or weights have no such form.

        The columns have shapes (..., n, k_i), side by side; `gap` is the time since the sample before, infinite at the first one of a
        record.
        """
        steps, n = gap[1:], gap.size
        if n < 3 or np.ptp(weight) > 0 or not steps.max() - steps.min() <= ROUNDING * steps.min():
            return None
        angle = np.pi * np.arange(n) / n
        first = np.sqrt(np.where(angle > 0, 2.0, 1.0) / n) * np.cos(angle / 2)
        last = np.where(np.arange(n) % 2, -first, first)
        places = [(part, k) for part in columns for k in range(part.shape[-1])]
        transformed = np.empty((*columns[0].shape[:-2], len(places), n))  # no second copy of long columns
        for number, (part, k) in enumerate(places):
            transformed[..., number, :] = scipy.fft.dct(part[..., k], norm="ortho")
        return cls(
            transformed, np.stack([first, last]), 4 * np.sin(angle / 2) ** 2, float(steps.mean()), float(weight[0])
        )

    def at(
        self, ratio: Float[np.ndarray, "*N m"], time: Float[np.ndarray, "*N m"]
    ) -> tuple[Float[np.ndarray, "*N m k k"], Float[np.ndarray, "*N m"]]:
        """X' M^-1 X and log det M of the columns X at m points, M = correlation of the slow part + ratio of white to slow variance."""
        decay, fresh = np.exp(-self.gap / time), -np.expm1(-2 * self.gap / time)
        low, white = np.expm1(-self.gap / time) ** 2, fresh * self.weight / ratio
        corner, k = decay * -np.expm1(-self.gap / time), self.rows.shape[-2]
        left, right = np.triu_indices(k)
        square, edges = np.zeros((*ratio.shape, left.size)), np.zeros((*ratio.shape, 2 * k + 3))
        for begin in range(0, self.curvature.size, _BLOCK):
            block = slice(begin, begin + _BLOCK)
            slow = low[..., None] + decay[..., None] * self.curvature[block]
            part = 1 / (slow + white[..., None])
            edges += part @ self._with_ends[..., block].swapaxes(-1, -2)
            part *= slow / ratio[..., None]
            if self._products is not None:
                square += part @ self._products[..., block].swapaxes(-1, -2)
                continue
            rows = self.rows[..., block]
            for number in range(ratio.shape[-1]):
                whole = (rows * part[..., number, None, :]) @ rows.swapaxes(-1, -2)
                square[..., number, :] += whole[..., left, right]
        beside, ends = edges[..., : 2 * k].reshape(*ratio.shape, k, 2), edges[..., 2 * k :][..., [[0, 1], [1, 2]]]
        inner = np.eye(2) + corner[..., None, None] * ends
        gram = np.empty((*ratio.shape, k, k))
        gram[..., left, right] = gram[..., right, left] = square
        correction = beside @ np.linalg.solve(inner, beside.swapaxes(-1, -2))
        gram += (corner * white / ratio)[..., None, None] * correction
        # The product of the eigenvalues low + white + decay * curvature, by Chebyshev polynomials.
        n, angle = self.curvature.size, 2 * np.arcsinh(0.5 * np.sqrt((low + white) / decay))
        product = np.log(low + white) + (n - 1) * (np.log(decay) + angle)
        product += np.log(-np.expm1(-2 * n * angle)) - np.log(-np.expm1(-2 * angle))
        return gram, n * np.log(ratio) - np.log(fresh) + product + np.linalg.slogdet(inner)[1]

    @functools.cached_property
    def _products(self) -> np.ndarray | None:
        """Products of two rows, shape (..., k (k + 1) / 2, n), with which many points are one product; None where they would be large."""
        left, right = np.triu_indices(self.rows.shape[-2])
        if left.size * self.rows[..., 0, :].size > NUMBERS:
            return None
        return self.rows[..., left, :] * self.rows[..., right, :]

    @functools.cached_property
    def _with_ends(self) -> np.ndarray:
        """Products of a row and an end, and of two ends, shape (..., 2 k + 3, n)."""
        first, last = self.ends
        *lead, k, n = self.rows.shape
        both = np.broadcast_to(np.stack([first**2, first * last, last**2]), (*lead, 3, n))
        return np.concatenate([(self.rows[..., None, :] * self.ends).reshape(*lead, 2 * k, n), both], axis=-2)
