"""Slow and independent noise of one evenly sampled record in cosine coordinates, where its covariance is diagonal but for two samples.

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

_EVEN = 1e-9  # largest relative difference between steps that are even
_BLOCK = 2**14  # frequencies summed at once
_NUMBERS = 2**22  # largest number of products of rows that are kept


@dataclasses.dataclass(frozen=True)
class EvenRows:
    """Columns of one evenly sampled record with one weight, by frequency.

    Attributes:
        rows: their cosine transforms, shape (k, n).
        ends: those of its first and last sample, shape (2, n).
        curvature: eigenvalues of the second difference, shape (n,).
        gap: step, in typical sampling intervals.
        weight: of every sample.
    """

    rows: Float[np.ndarray, "k n"]
    ends: Float[np.ndarray, "2 n"]
    curvature: Float[np.ndarray, " n"]
    gap: float
    weight: float

    @classmethod
    def of(cls, columns: Sequence[np.ndarray], gap: Float[np.ndarray, " n"], weight: np.ndarray) -> EvenRows | None:
        """The transforms; None where several records, uneven steps or weights have no such form.

        The columns have shapes (n, k_i), side by side; `gap` is the time since the sample before, infinite at the first one of a
        record.
        """
        steps, n = gap[1:], gap.size
        if n < 3 or np.ptp(weight) > 0 or not steps.max() - steps.min() <= _EVEN * steps.min():
            return None
        angle = np.pi * np.arange(n) / n
        first = np.sqrt(np.where(angle > 0, 2.0, 1.0) / n) * np.cos(angle / 2)
        last = np.where(np.arange(n) % 2, -first, first)
        transformed = np.empty((sum(part.shape[1] for part in columns), n))  # no second copy of long columns
        for row, column in zip(transformed, (column for part in columns for column in part.T), strict=True):
            row[:] = scipy.fft.dct(column, norm="ortho")
        return cls(
            transformed, np.stack([first, last]), 4 * np.sin(angle / 2) ** 2, float(steps.mean()), float(weight[0])
        )

    def at(
        self, ratio: Float[np.ndarray, " m"], time: Float[np.ndarray, " m"]
    ) -> tuple[Float[np.ndarray, "m k k"], Float[np.ndarray, " m"]]:
        """X' M^-1 X and log det M of the columns X, for M = correlation of the slow part + ratio, at m points.

        Args:
            ratio: of white to slow variance.
            time: correlation time of the slow part, typical sampling intervals.
        """
        decay, fresh = np.exp(-self.gap / time), -np.expm1(-2 * self.gap / time)
        low, white = np.expm1(-self.gap / time) ** 2, fresh * self.weight / ratio
        corner, k = decay * -np.expm1(-self.gap / time), len(self.rows)
        pairs = np.triu_indices(k)
        square, edges = np.zeros((len(ratio), pairs[0].size)), np.zeros((len(ratio), 2 * k + 3))
        for begin in range(0, self.curvature.size, _BLOCK):
            block = slice(begin, begin + _BLOCK)
            slow = low[:, None] + decay[:, None] * self.curvature[block]
            part = 1 / (slow + white[:, None])
            with_ends = self._with_ends[:, block]
            edges += part @ with_ends.T
            part *= slow / ratio[:, None]
            if self._products is not None:
                square += part @ self._products[:, block].T
                continue
            rows = self.rows[:, block]
            for total, one in zip(square, part, strict=True):
                total += ((rows * one) @ rows.T)[pairs]
        beside, ends = edges[:, : 2 * k].reshape(-1, k, 2), edges[:, 2 * k :][:, [[0, 1], [1, 2]]]
        inner = np.eye(2) + corner[:, None, None] * ends
        gram = np.empty((len(ratio), k, k))
        gram[:, pairs[0], pairs[1]] = gram[:, pairs[1], pairs[0]] = square
        correction = beside @ np.linalg.solve(inner, beside.swapaxes(1, 2))
        gram += (corner * white / ratio)[:, None, None] * correction
        # The product of the eigenvalues low + white + decay * curvature, by Chebyshev polynomials.
        n, angle = self.curvature.size, 2 * np.arcsinh(0.5 * np.sqrt((low + white) / decay))
        product = np.log(low + white) + (n - 1) * (np.log(decay) + angle)
        product += np.log(-np.expm1(-2 * n * angle)) - np.log(-np.expm1(-2 * angle))
        return gram, n * np.log(ratio) - np.log(fresh) + product + np.linalg.slogdet(inner)[1]

    @functools.cached_property
    def _products(self) -> np.ndarray | None:
        """Products of two rows, shape (k (k + 1) / 2, n), with which many points are one product; None where they would be large."""
        left, right = np.triu_indices(len(self.rows))
        return self.rows[left] * self.rows[right] if left.size * self.curvature.size <= _NUMBERS else None

    @functools.cached_property
    def _with_ends(self) -> np.ndarray:
        """Products of a row and an end, and of two ends, shape (2 k + 3, n)."""
        first, last = self.ends
        with_ends = (self.rows[:, None] * self.ends).reshape(-1, self.curvature.size)
        return np.concatenate([with_ends, [first**2, first * last, last**2]])
