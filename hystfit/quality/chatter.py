"""Chatter: noise that reverses the input, and the smoothing that removes it."""

from __future__ import annotations

import numpy as np

from hystfit.data.preparation import smooth

MOST = 5.0  # percent of the steps that may go backward
_LENGTHS = (5, 7, 9, 11, 15, 21, 31, 41, 61, 81, 101)


def chatter(u: np.ndarray, branches: np.ndarray) -> float:
    """Share of the samples at which the input steps back against its branch [%].

    Args:
        u: input, shape (T,).
        branches: first and last sample of each monotonic branch, shape (K, 2).
    """
    backward = sum(
        int((np.sign(u[b] - u[a]) * np.diff(u[a : b + 1]) < 0).sum()) for a, b in branches if b > a and u[b] != u[a]
    )
    return 100 * backward / max(u.size - 1, 1)


def smoothing_length(u: np.ndarray, branches: np.ndarray) -> int | None:
    """Shortest smoothing filter that leaves acceptable chatter [samples]; None where there is no chatter, or no filter removes it.

    A filter may be as long as a quarter of the median branch, so that it does not round the reversals off.

    Args:
        u: input, shape (T,).
        branches: as for `chatter`.
    """
    if chatter(u, branches) <= MOST:
        return None
    longest = min(u.size, float(np.median(np.diff(branches))) / 4)
    fitting = (length for length in _LENGTHS if length <= longest)
    return next((length for length in fitting if chatter(smooth(u, length), branches) <= MOST), None)
