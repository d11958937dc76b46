"""Ends of a loop where the output stays level within its noise: a saturated sensor or amplifier, or a dead zone of the device."""

from __future__ import annotations

import numpy as np

from hystfit.quality.faults import CLEAR, FEWEST_SAMPLES, MAD_TO_RMS, runs
from hystfit.quality.loops import SAME_LEVEL

_LEVEL = 1.5  # times the noise: the median deviation over a level end; slopes across the width of the noise have 2 to 3
# Part of the output's range below the level over which it arrives, and the least slope of the last quarter of it over that of the rest:
# a corner has 1, tanh 0.2, and approaches to saturation less.
_ARRIVAL, _CORNER = 0.2, 0.5
# Times the width of the noise that the last quarter has at least: under more noise, Preisach models of steps have corners too.
_SEEN = 3.0


def flat_ends(u: np.ndarray, y: np.ndarray, noise: float | None) -> np.ndarray:
    """Whether the output is level within its noise while the input goes on, turns and comes back, between two corners, shape (T,).

    Devices approach saturation slowly, backlash is level after a reversal alone, a plastic hinge before it, and a switch arrives at once.

    Args:
        u: input, shape (T,).
        y: output, shape (T,).
        noise: rms noise of the output; None where it is not known, and then no end is found.
    """
    found = np.zeros(y.size, dtype=bool)
    span = float(np.nanmax(y) - np.nanmin(y)) if np.isfinite(y).any() else 0.0
    if noise is None or not 0 < _SEEN * CLEAR * noise < 0.25 * _ARRIVAL * span or not np.ptp(u) > 0:
        return found
    width = CLEAR * noise
    for sign, near_end in ((1.0, y > np.nanmax(y) - 2 * width), (-1.0, y < np.nanmin(y) + 2 * width)):
        level = float(np.median(y[near_end]))
        for start, stop in runs((y >= level - width) & (y <= level + width)):
            if stop - start >= FEWEST_SAMPLES and _is_end(u, y, (start, stop), level, sign, noise):
                found[start:stop] = True
    return found


def _is_end(u: np.ndarray, y: np.ndarray, part: tuple[int, int], level: float, sign: float, noise: float) -> bool:
    """Whether the samples of a part, in which the output is near a level, are a level end between two corners.

    Args:
        sign: 1 at the upper level, -1 at the lower one.
    """
    start, stop = part
    spread = MAD_TO_RMS * float(np.median(np.abs(y[start:stop] - np.median(y[start:stop]))))
    if start == 0 or stop == y.size or spread > _LEVEL * noise:
        return False
    drive = u[start:stop]
    turn = int(np.argmax(np.abs(drive - 0.5 * (drive[0] + drive[-1]))))
    onward = min(abs(drive[turn] - drive[0]), abs(drive[turn] - drive[-1]))
    gap = _ARRIVAL * float(np.nanmax(y) - np.nanmin(y))
    sides = (slice(start - 1, None, -1), slice(stop, None))
    return bool(onward > SAME_LEVEL * np.ptp(u)) and all(_has_corner(u[k], sign * (level - y[k]), gap) for k in sides)


def _has_corner(u: np.ndarray, below: np.ndarray, gap: float) -> bool:
    """Whether the output leaves its level by a corner.

    Args:
        u, below: input, and distance of the output from its level, of the samples from there on.
        gap: how far it is followed.
    """
    if not (below >= gap).any():
        return False
    end = int(np.argmax(below >= gap))
    near = int(np.argmax(below >= 0.25 * gap))
    if min(near, end - near) < 2:
        return False
    slope = lambda first, last: (below[last] - below[first]) / max(abs(u[last] - u[first]), np.finfo(float).tiny)
    return bool(slope(0, near) > _CORNER * slope(near, end))
