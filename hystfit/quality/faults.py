"""Small-scale faults of one column: noise, resolution, spikes, clipping and holds."""

from __future__ import annotations

import math

import numpy as np

MAD_TO_RMS = 1.4826  # of a normal distribution


def noise_rms(values: np.ndarray) -> tuple[float | None, bool]:
    """RMS of white noise on a smooth signal, from its differences of order 2 to 6.

    Differences of a high order wipe out what is slow; the median of their size is not moved by reversals or spikes.
    The least of the orders is taken, as what is left of the signal only adds.

    Args:
        values: shape (T,); non-finite values are passed over.

    Returns:
        (rms in the unit of the values or None with fewer than 16 samples, True where it is an upper bound only:
        samples so sparse that the signal itself has not died out in the differences).
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
    if least <= floor:  # most samples repeat their neighbors: a rounded signal, or one that moves in jumps
        step, moves = resolution(values) or 0.0, np.concatenate([[False], np.diff(values) != 0, [False]])
        alone = moves[1:-1] & ~moves[:-2] & ~moves[2:]
        rounded = alone.sum() > 0.5 * moves.sum() and step < 0.02 * np.ptp(values)
        return (step / math.sqrt(12) if rounded and moves.mean() < 0.75 else least), False
    return least, sizes[-1] < 0.8 * sizes[1]


def resolution(values: np.ndarray) -> float | None:
    """Smallest step between two different values [unit of the values]; None where all are the same."""
    finite = np.unique(np.asarray(values, dtype=float)[np.isfinite(values)])
    if finite.size < 2:
        return None
    steps = np.diff(finite)
    steps = steps[steps > 1e-12 * max(abs(finite[0]), abs(finite[-1]))]
    return float(steps.min()) if steps.size else None


def runs(mask: np.ndarray) -> np.ndarray:
    """First and one-past-last sample of every stretch of True, shape (K, 2)."""
    edges = np.diff(np.concatenate([[0], np.asarray(mask, dtype=int), [0]]))
    return np.stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)], axis=1)


def holds(u: np.ndarray, tolerance: float, least: int = 5) -> np.ndarray:
    """Stretches in which the input rests: first and one-past-last sample, shape (K, 2).

    A rest is `least` samples or more whose steps are all at most `tolerance` [unit of u].
    """
    still = np.abs(np.diff(np.asarray(u, dtype=float))) <= tolerance
    spans = runs(still)
    spans[:, 1] += 1
    return spans[(spans[:, 1] - spans[:, 0]) >= least]


def clipped_samples(u: np.ndarray, y: np.ndarray) -> int:
    """Number of samples at which the output stands at its very end while the input moves on.

    Counted are runs of four samples or more that repeat the largest or the smallest y exactly while u moves by more
    than 2 % of its range (a slow or rounded signal repeats too, but elsewhere as well: such runs are not counted).
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
    """Samples that stick out of both neighbors to the same side by far more than noise and 3 % of the range.

    Args:
        y: output, shape (T,).
        noise: its rms [unit of y]; None counts as 0.
        ignore: sample numbers near which nothing counts (turning points of a sparse record).
    """
    y = np.asarray(y, dtype=float)
    if y.size < 5:
        return np.empty(0, dtype=int)
    before, after = y[1:-1] - y[:-2], y[1:-1] - y[2:]
    limit = max(10 * (noise or 0.0), 0.03 * float(np.nanmax(y) - np.nanmin(y)))
    with np.errstate(invalid="ignore"):
        out = (np.sign(before) == np.sign(after)) & (np.minimum(np.abs(before), np.abs(after)) > limit)
    found = np.flatnonzero(out) + 1
    if ignore is not None and ignore.size and found.size:
        found = found[np.min(np.abs(found[:, None] - ignore[None, :]), axis=1) > 1]
    return found
