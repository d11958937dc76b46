"""Small-scale faults of one column: noise, resolution, spikes, clipping and holds."""

from __future__ import annotations

import math

import numpy as np

MAD_TO_RMS = 1.4826  # of a normal distribution


def noise_rms(values: np.ndarray) -> tuple[float | None, bool]:
    """RMS of white noise on a smooth signal, from its differences of order 2 to 6.

    Differences of a high order suppress slow signals, and the median of their magnitude is robust to reversals and spikes. The
    smallest estimate of all orders is used, as remainders of the signal can only increase it.

    Args:
        values: shape (T,); non-finite values are omitted.

    Returns:
        RMS in the unit of the values (None with fewer than 16 samples), and whether it is only an upper bound: the samples are
        so sparse that the differences still contain the signal.
    """
    values = np.asarray(values, dtype=float)
    values = values[np.isfinite(values)]
    if values.size < 16:
        return None, False
    sizes = []
    for order in range(2, 7):
        size = np.abs(np.diff(values, order)) / math.sqrt(math.comb(2 * order, order))
        sizes.append(MAD_TO_RMS * float(np.median(size)))
    floor = float(np.finfo(float).eps * np.max(np.abs(values)))
    least = min(sizes)
    if least <= floor:  # most samples repeat their neighbors: a rounded signal, or one with jumps
        step, moves = resolution(values) or 0.0, np.concatenate([[False], np.diff(values) != 0, [False]])
        isolated = moves[1:-1] & ~moves[:-2] & ~moves[2:]
        rounded = isolated.sum() > 0.5 * moves.sum() and step < 0.02 * np.ptp(values)
        return (step / math.sqrt(12) if rounded and moves.mean() < 0.75 else least), False
    return least, sizes[-1] < 0.8 * sizes[1]


def resolution(values: np.ndarray) -> float | None:
    """Smallest difference of two distinct values [unit of the values]; None where all are equal."""
    finite = np.unique(np.asarray(values, dtype=float)[np.isfinite(values)])
    if finite.size < 2:
        return None
    steps = np.diff(finite)
    steps = steps[steps > 1e-12 * max(abs(finite[0]), abs(finite[-1]))]
    return float(steps.min()) if steps.size else None


def runs(mask: np.ndarray) -> np.ndarray:
    """First sample and end (exclusive) of every run of True, shape (K, 2)."""
    edges = np.diff(np.concatenate([[0], np.asarray(mask, dtype=int), [0]]))
    return np.stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)], axis=1)


def holds(u: np.ndarray, tolerance: float, least: int = 5) -> np.ndarray:
    """Holds of the input: first sample and end (exclusive), shape (K, 2).

    Args:
        u: input, shape (T,).
        tolerance: largest step within a hold [unit of u].
        least: number of samples that make a hold.
    """
    still = np.abs(np.diff(np.asarray(u, dtype=float))) <= tolerance
    spans = runs(still)
    spans[:, 1] += 1
    return spans[(spans[:, 1] - spans[:, 0]) >= least]


def clipped_samples(u: np.ndarray, y: np.ndarray) -> int:
    """Number of samples at which the output stays at its largest or smallest value while the input moves.

    Counted are runs of four samples or more that repeat this value exactly while u moves by more than 2 % of its range; slow or
    rounded signals, which repeat values elsewhere too, are not counted.
    """
    y = np.asarray(y, dtype=float)
    span = np.ptp(u)
    if span == 0 or not np.isfinite(y).any():
        return 0
    same = np.concatenate([[False], y[1:] == y[:-1]])
    inner = same & (y < np.nanmax(y)) & (y > np.nanmin(y))
    usual = max([stop - start for start, stop in runs(inner)], default=0)
    count = 0
    for end in (np.nanmax(y), np.nanmin(y)):
        for start, stop in runs(y == end):
            if stop - start >= max(4, 2 * (usual + 1)) and np.ptp(u[start:stop]) > 0.02 * span:
                count += int(stop - start)
    return count


def spikes(y: np.ndarray, noise: float | None, ignore: np.ndarray | None = None) -> np.ndarray:
    """Sample numbers of isolated outliers: beyond both neighbors on one side by more than 10 times the noise and 3 % of the range.

    Args:
        y: output, shape (T,).
        noise: its rms [unit of y]; None for 0.
        ignore: sample numbers next to which nothing counts (turning points of a sparse record).
    """
    y = np.asarray(y, dtype=float)
    if y.size < 5:
        return np.empty(0, dtype=int)
    before, after = y[1:-1] - y[:-2], y[1:-1] - y[2:]
    limit = max(10 * (noise or 0.0), 0.03 * float(np.nanmax(y) - np.nanmin(y)))
    with np.errstate(invalid="ignore"):
        out = (np.sign(before) == np.sign(after)) & (np.minimum(np.abs(before), np.abs(after)) > limit)
    outliers = np.flatnonzero(out) + 1
    if ignore is not None and ignore.size and outliers.size:
        outliers = outliers[np.min(np.abs(outliers[:, None] - ignore[None, :]), axis=1) > 1]
    return outliers
