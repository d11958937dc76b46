"""Which path of a record is a loop, and which way it runs."""

from __future__ import annotations

import numpy as np

OPEN = 0.02  # area over that of the box around it, from which a loop has a direction
FEWEST = 8  # samples of a loop or of a period
SLACK = 0.01  # of a range, which noise and rounding may make up
PART = 0.5  # of the input's range, which the part of a record that returns covers, and each curve of a family
GAP = 0.03  # of the input's range: between the ends of a period, and between its turning points and the range

# Size of the correlation of output and input from which the output follows the input, or falls as it rises.
FOLLOWS = 0.5
_ENDS = 0.2  # of the input's range at each end, over which a line beneath a loop is seen: a loop that saturates is straight there

_FLAT = 1e-3  # area of such a part, below which it is no loop: the straight lines between samples of a curve enclose as much
# Part of its area by which a loop changes where every second sample is left out, up to which its samples show it however narrow it is: the
# straight lines between the samples of a curve enclose four times as much then.
RESOLVED = 0.25


def circulation(u: np.ndarray, y: np.ndarray, *, mirrored: bool = True) -> float:
    """Area inside the path of a record over that of the box around it: positive where it runs counter-clockwise, as an output that lags.

    Where the output falls as the input rises (`trend`), the path is mirrored first, unless `mirrored` is False. Several cycles count
    several times; what a record does before or after it returns to its input does not count where it has a loop, nor do samples that
    are NaN.
    """
    both = np.isfinite(u) & np.isfinite(y)
    u, y = u[both], y[both]
    if u.size < FEWEST or not (np.ptp(u) > 0 and np.ptp(y) > 0):
        return 0.0
    part, whole = _returning(u), _area(u, y, mirrored)
    if np.ptp(u[part]) < PART * np.ptp(u) or not np.ptp(y[part]) > 0:
        return whole
    returned = _area(u[part], y[part], mirrored)
    return returned if abs(returned) >= _FLAT or _is_resolved(u[part], y[part], returned, mirrored) else whole


def _is_resolved(u: np.ndarray, y: np.ndarray, area: float, mirrored: bool) -> bool:
    """Whether a path encloses nearly the same where every second sample is left out."""
    return abs(_area(u[::2], y[::2], mirrored) - area) < RESOLVED * abs(area)


def trend(u: np.ndarray, y: np.ndarray) -> float:
    """Correlation of output and input, (T,) without gaps: negative where the output falls as the input rises; 0 where one is constant.

    A loop that rises on a line that falls more, as of a magnetic film on its diamagnetic substrate, counts without the line. It runs
    counter-clockwise as it was measured; so does a force of the other sign, which does not rise without a line.
    """
    if u.size < 2 or not (np.ptp(u) > 0 and np.ptp(y) > 0):
        return 0.0
    return _trend(_scaled(u), _scaled(y))


def _scaled(values: np.ndarray) -> np.ndarray:
    """Values without their mean, over their range; memory of one more column, which counts in long records."""
    scaled = values - values.mean()
    scaled /= np.ptp(values)
    return scaled


def _trend(u: np.ndarray, y: np.ndarray) -> float:
    """`trend` of scaled values."""
    size = _correlation(u, y)
    if size >= 0 or _turning(u, y) < _FLAT:
        return size
    rest = y - _line_at_ends(u, y) * u
    return without if np.ptp(rest) > 0 and (without := _correlation(u, rest)) > FOLLOWS else size


def _correlation(u: np.ndarray, y: np.ndarray) -> float:
    """Correlation of two columns without means."""
    return float(u @ y / np.sqrt((u @ u) * (y @ y)))


def _line_at_ends(u: np.ndarray, y: np.ndarray) -> float:
    """Slope of a line that falls beneath a loop: that of the flatter end, towards which the input runs; 0 where one does not fall."""
    low, high, way = float(u.min()), float(u.max()), np.gradient(u)
    reach = _ENDS * (high - low)
    ends = (u > high - reach) & (way > 0), (u < low + reach) & (way < 0)
    if any(np.unique(u[end]).size < 2 for end in ends):
        return 0.0
    return min(0.0, max(float(np.polyfit(u[end], y[end], 1)[0]) for end in ends))


def _turning(u: np.ndarray, y: np.ndarray) -> float:
    """Area inside a path, scaled to the box around it: positive where it runs counter-clockwise as it was measured."""
    return 0.5 * float(u[:-1] @ y[1:] - u[1:] @ y[:-1] + u[-1] * y[0] - u[0] * y[-1])


def _area(u: np.ndarray, y: np.ndarray, mirrored: bool) -> float:
    u, y = _scaled(u), _scaled(y)
    return _turning(u, y) * (float(np.sign(_trend(u, y))) if mirrored else 1.0)


def _returning(u: np.ndarray) -> slice:
    """The longest part of a path at one end of a record that ends at the input where it begins.

    The line from the end of an initial curve and a loop back to its begin would enclose more than the loop does.
    """

    def passes(level: float) -> np.ndarray:
        near = np.abs(u - level) <= SLACK * np.ptp(u)
        near[1:] |= (u[:-1] - level) * (u[1:] - level) < 0
        return np.flatnonzero(near)

    first, last = passes(u[-1])[0], passes(u[0])[-1]
    return slice(first, None) if u.size - first > last + 1 else slice(0, last + 1)


# Part of its size from which an output is the rate of its input: memristors have 0.01, wide loops 0.25.
OF_RATE = 0.6


def of_rate(u: np.ndarray, y: np.ndarray) -> float:
    """By how much of its size an output has the sign of the rate of its input, -1 to 1; 0 of an input at rest.

    It is near 1 for the current that charges a device and for the voltage that a flux induces, -1 where the sensor has the other sign, and
    near 0 where the output follows the input itself. Outputs count by their size, as noise about zero has any sign.
    """
    both = np.isfinite(u) & np.isfinite(y)
    if both.sum() < FEWEST:
        return 0.0
    with np.errstate(all="ignore"):  # of numbers near the largest
        size = float(np.abs(y[both]).sum())
        return float(np.sign(np.gradient(u[both])) @ y[both]) / size if 0 < size < np.inf else 0.0
