"""Slow and independent noise of evenly sampled records in cosine coordinates, where its covariance is diagonal but for two samples.

The inverse correlation matrix of an Ornstein-Uhlenbeck process at even steps is tridiagonal with constant entries, apart from its two
corners. Without the corners the discrete cosine transform diagonalizes it; they are a correction of rank two (Woodbury). A likelihood
is then a sum over frequencies of products of columns times a smooth function of the frequency, whose parameters alone change. The
function is interpolated between a few nodes, so that each product is summed up once, whatever the number of likelihoods.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy  # loads its subpackages when they are first used
from jaxtyping import Float

from hystfit.outcome.table import ROUNDING

_BLOCK = 2**14  # frequencies summed at once
# Nodes in each interval of frequencies, and its greatest over its least one. 1 / (a + frequency^2), a > 0, has poles at a distance of pi
# in the logarithm of its square: the error of this interpolation is below 2e-11 of the function, by the ellipse through them.
_NODES, _WIDTH = 16, 4
# Numbers in the columns of fits whose noise is sought side by side: memory of this size is used again. Four times as much is mapped anew
# in each step: six threads with 84 fits of 2000 samples each spent 3.2 s in the system, and 0.3 s with this.
BESIDE = 2**20


@dataclasses.dataclass(frozen=True)
class EvenRows:
    """Columns of evenly sampled records of one length, step and weight, summed up at nodes of the frequency; perhaps of N fits."""

    products: Float[np.ndarray, "*N J k2"]  # of two columns, k2 = k (k + 1) / 2
    # of a column with the first and with the last sample of each of R records, ke = 2 k
    ends: Float[np.ndarray, "*N R J ke"]
    corners: Float[np.ndarray, "J 3"]  # of these two samples with each other
    curvature: Float[np.ndarray, " J"]  # eigenvalues of the second difference
    samples: int  # of a record
    gap: float  # step, in typical sampling intervals
    weight: float  # of every sample

    @classmethod
    def of(
        cls, columns: Sequence[np.ndarray], gap: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"]
    ) -> list[EvenRows] | None:
        """Those of all records, by length, step and weight; None where the steps or weights within one differ.

        The columns have shapes (..., n, k_i), side by side; `gap` is the time since the sample before, infinite at the first one of a
        record.
        """
        starts = np.append(np.flatnonzero(np.isinf(gap)), gap.size)
        alike: dict[tuple[int, float, float], list[slice]] = {}
        for part in map(slice, starts[:-1].tolist(), starts[1:].tolist()):
            steps, weights = gap[part][1:], weight[part]
            if steps.size < 2 or np.ptp(weights) > 0 or not np.ptp(steps) <= ROUNDING * steps.min():
                return None
            step = float(np.float32(steps.mean()))
            alike.setdefault((weights.size, step, float(weights[0])), []).append(part)
        return [cls._summed(columns, parts, gap, weight) for parts in alike.values()]

    @classmethod
    def _summed(
        cls, columns: Sequence[np.ndarray], parts: list[slice], gap: np.ndarray, weight: np.ndarray
    ) -> EvenRows:
        n, nodes = parts[0].stop - parts[0].start, _nodes(parts[0].stop - parts[0].start)
        transform = lambda group, part: scipy.fft.dct(group[..., part, :].swapaxes(-1, -2), norm="ortho")
        rows = np.stack(
            [np.concatenate([transform(group, part) for group in columns], axis=-2) for part in parts], axis=-2
        )
        beside = np.concatenate([nodes.sums(rows * end) for end in nodes.ends], axis=-3)
        first, last = nodes.ends
        corners = nodes.sums(np.stack([first**2, first * last, last**2])).T
        step = float(gap[parts[0]][1:].mean())
        products = nodes.products(rows)
        return cls(
            products, np.moveaxis(beside, -3, -1), corners, nodes.curvature, n, step, float(weight[parts[0].start])
        )

    def at(
        self, ratio: Float[np.ndarray, "*N m"], time: Float[np.ndarray, "*N m"], fits: np.ndarray | None = None
    ) -> tuple[Float[np.ndarray, "*N m k k"], Float[np.ndarray, "*N m"]]:
        """X' M^-1 X and log det M of the columns X at m points, M = correlation of the slow part + ratio of white to slow variance.

        With `fits` of some of the fits alone, by their numbers.
        """
        products, ends = (self.products, self.ends) if fits is None else (self.products[fits], self.ends[fits])
        decay, fresh = np.exp(-self.gap / time), -np.expm1(-2 * self.gap / time)
        low, white = np.expm1(-self.gap / time) ** 2, fresh * self.weight / ratio
        corner, (records, _, k) = decay * -np.expm1(-self.gap / time), ends.shape[-3:]
        slow = low[..., None] + decay[..., None] * self.curvature
        part = 1 / (slow + white[..., None])
        inner = np.eye(2) + corner[..., None, None] * (part @ self.corners)[..., [[0, 1], [1, 2]]]
        beside = (part[..., None, :, :] @ ends).reshape(*part.shape[:-2], records, -1, 2, k // 2)
        solved = np.linalg.solve(inner[..., None, :, :, :], beside)
        beside, solved = (np.concatenate(list(np.moveaxis(one, -4, 0)), axis=-2) for one in (beside, solved))
        correction = solved.swapaxes(-1, -2) @ beside
        gram = (corner * white / ratio)[..., None, None] * correction
        left, right = np.triu_indices(k // 2)
        square = (part * (slow / ratio[..., None])) @ products
        gram[..., left, right] += square
        gram[..., right, left] = gram[..., left, right]
        # The product of the eigenvalues low + white + decay * curvature, by Chebyshev polynomials.
        n, angle = self.samples, 2 * np.arcsinh(0.5 * np.sqrt((low + white) / decay))
        product = np.log(low + white) + (n - 1) * (np.log(decay) + angle)
        product += np.log(-np.expm1(-2 * n * angle)) - np.log(-np.expm1(-2 * angle))
        log_det = n * np.log(ratio) - np.log(fresh) + product + np.linalg.slogdet(inner)[1]
        return gram, records * log_det


@dataclasses.dataclass(frozen=True)
class _Nodes:
    """Nodes at which a smooth function of the frequency represents it at all n frequencies of a record."""

    curvature: Float[np.ndarray, " J"]  # there: eigenvalue of the second difference
    ends: Float[np.ndarray, "2 n"]  # cosine transforms of the first and the last sample
    # frequencies of an interval, its nodes, and their shares in the value at each of these frequencies, shape (frequencies, nodes)
    intervals: list[tuple[slice, slice, np.ndarray]]

    def sums(self, rows: Float[np.ndarray, "*N n"]) -> Float[np.ndarray, "*N J"]:
        """Shares of the nodes in each row."""
        return np.concatenate([rows[..., part] @ shares for part, _, shares in self.intervals], axis=-1)

    def products(self, rows: Float[np.ndarray, "*N k R n"]) -> Float[np.ndarray, "*N J k2"]:
        """Shares of the nodes in the products of two rows, summed over the records."""
        *lead, k, records, _ = rows.shape
        left, right = np.triu_indices(k)
        out = np.zeros((*lead, self.curvature.size, left.size))
        for part, nodes, shares in self.intervals:
            inside, tiled = rows[..., part].reshape(*lead, k, -1), np.tile(shares, (records, 1))
            for begin in range(0, len(tiled), _BLOCK):
                block = inside[..., begin : begin + _BLOCK]
                for node, share in zip(range(nodes.start, nodes.stop), tiled[begin : begin + _BLOCK].T, strict=True):
                    out[..., node, :] += ((block * share) @ block.swapaxes(-1, -2))[..., left, right]
        return out


def _nodes(n: int) -> _Nodes:
    """Nodes for records of n samples: every frequency of intervals that hold few of them, interpolation in the others."""
    angle = np.pi * np.arange(n) / n
    first = np.sqrt(np.where(angle > 0, 2.0, 1.0) / n) * np.cos(angle / 2)
    curvature, begin, count = 4 * np.sin(angle / 2) ** 2, 0, 0
    at, intervals = [], []
    while begin < n:
        part = slice(begin, min(max(begin * _WIDTH, begin + 1), n))
        own = curvature[part]
        if own.size <= _NODES:
            places, shares = own, np.eye(own.size)
        else:
            places, shares = _interpolated(np.log(own))
        at.append(places)
        intervals.append((part, slice(count, count + places.size), shares))
        begin, count = part.stop, count + places.size
    return _Nodes(np.concatenate(at), np.stack([first, np.where(np.arange(n) % 2, -first, first)]), intervals)


def _interpolated(log: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " J"], Float[np.ndarray, "n J"]]:
    """Chebyshev nodes between the first and the last of the rising logarithms, and their shares at each of these."""
    low, high = log[[0, -1]]
    nodes, series = np.polynomial.chebyshev.chebpts1(_NODES), np.polynomial.chebyshev.chebvander
    shares = np.linalg.solve(series(nodes, _NODES - 1).T, series(2 * (log - low) / (high - low) - 1, _NODES - 1).T).T
    return np.exp(low + 0.5 * (nodes + 1) * (high - low)), shares
