"""Positions of play operators on the host."""

from __future__ import annotations

import itertools

import numpy as np


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
