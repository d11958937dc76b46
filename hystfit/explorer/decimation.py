"""The samples that a canvas of some width can show: few points for long records, and no peak is lost."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int


def chunks(samples: int, columns: int) -> Int[np.ndarray, " chunks"]:
    """First sample of each of at most `columns` pieces of equal length; a short record keeps every sample."""
    return np.arange(0, samples, 1 if samples <= 2 * columns else -(-samples // columns))


def visible(starts: Int[np.ndarray, " chunks"], *signals: Float[np.ndarray, " T"]) -> Int[np.ndarray, " kept"]:
    """Numbers of the samples to draw: first, last, lowest and highest of every signal in each piece.

    A polyline through them covers the same pixels as one through all samples, whichever signal it is drawn over.

    Args:
        *signals: equally long; NaN is not drawn.
    """
    count = signals[0].size
    if starts.size == count:
        return np.arange(count)
    width = int(starts[1])
    kept = [starts, np.minimum(starts + width, count) - 1]
    for signal in signals:
        rows = np.pad(signal, (0, starts.size * width - count), mode="edge").reshape(-1, width)
        kept += [starts + np.where(np.isnan(rows), np.inf, rows * sign).argmin(axis=1) for sign in (1.0, -1.0)]
    return np.unique(np.minimum(np.concatenate(kept), count - 1))
