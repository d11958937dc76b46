"""Linear recursions on the host, over columns of samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg.lapack import dtbtrs


def lagged(columns: np.ndarray, time: float) -> np.ndarray:
    """Columns behind a first-order lag of this time constant [samples], from rest."""
    keep = float(np.exp(-1 / time))
    return columns[0] + recursion((1.0, -keep), (1 - keep) * (columns - columns[0]))


def recursion(taps: Sequence[float | np.ndarray], columns: np.ndarray) -> np.ndarray:
    """Columns y with taps[0] y[k] + taps[1] y[k - 1] + ... = columns[k], from rest: a banded triangular system.

    A tap that varies has a value for each sample y that it multiplies. As by `scipy.signal.lfilter`, whose import takes as long as a fit.
    """
    band = np.empty((len(taps), len(columns)), order="F")
    for diagonal, tap in zip(band, taps, strict=True):
        diagonal[:] = tap
    return dtbtrs(band, columns, uplo="L")[0]
