"""Outputs of switches: values near one of two levels, with the noise of what is switched."""

from __future__ import annotations

import numpy as np

_FEWEST = 16  # values below which nothing is said
_NEAR = 0.05  # part of the range within which a value is near a level
_LEAST = 0.05  # part of the values that each level has at least


def has_two_levels(values: np.ndarray, elsewhere: float = 0.0) -> bool:
    """Whether finite values are near one of two levels, but for the part `elsewhere`, as those of a switch that takes time."""
    known = values[np.isfinite(values)]
    if known.size < _FEWEST or not np.ptp(known) > 0:
        return False
    place = (known - known.min()) / np.ptp(known)
    ends = float(np.mean(place <= _NEAR)), float(np.mean(place >= 1 - _NEAR))
    return min(ends) > _LEAST and round((1 - sum(ends)) * known.size) <= elsewhere * known.size
