"""Which path of a record is a loop, and which way it runs."""

from __future__ import annotations

import numpy as np

OPEN = 0.02  # area over that of the box around it, from which a loop has a direction
FEWEST = 8  # samples of a loop or of a period
GAP = 0.03  # of the input's range: between the ends of a period, and between its turning points and the range


def circulation(u: np.ndarray, y: np.ndarray) -> float:
    """Area inside the path of a record over that of the box around it: positive where it runs counter-clockwise, as an output that lags.

    Where the output falls as the input rises, the path is mirrored first. Several cycles count several times.

    Args:
        u, y: input and output, shape (T,), NaN where missing.
    """
    both = np.isfinite(u) & np.isfinite(y)
    u, y = u[both], y[both]
    if u.size < FEWEST or not (np.ptp(u) > 0 and np.ptp(y) > 0):
        return 0.0
    u, y = (u - u.mean()) / np.ptp(u), (y - y.mean()) / np.ptp(y)
    area = 0.5 * float(np.sum(u * np.roll(y, -1) - np.roll(u, -1) * y))
    return area * float(np.sign(np.sum(u * y)))
