"""Small-scale faults of one column: noise, resolution, spikes, clipping, holds, and noise that reverses an input."""

from __future__ import annotations

import collections
import math

import numpy as np

from hystfit.data.preparation import smooth
from hystfit.data.two_levels import has_two_levels
from hystfit.quality.loops import SAME_LEVEL

FEWEST_SAMPLES = 16  # below which no noise is known and no loop is described
MAD_TO_RMS = 1.4826  # of a normal distribution
# Standard errors beyond which a measured difference is no chance: of the many that a report looks at, one in a million exceeds it.
CLEAR = 5.0
# Probability of a pattern by chance, below which it is one. First points of the 152 reversal curves of HCHB (MicroMag) that had not settled
# reach 2e-5, second points 0.13, and those of simulated curves stay above 0.4.
SIGNIFICANCE = 1e-3
_PRINTED = 0.05  # of the step between levels, up to which rounded values differ from their level by the digits printed
_DIGITS = 9  # of a printed number, at most
_WHOLE = 1e-6  # from a whole number, up to which a quotient is one but for the arithmetic
_ROUNDING = 0.5, 1.2  # noise over the error of rounding, between which it is that error alone
# Times the largest step within so many samples, that an outlier stands out.
_FAR, _STEPS = 4.0, 6
_JUMP = 2.0  # the same of an input that jumps there, which the output follows
_MOST_CLIPPED = 0.4  # part of the samples above which the limit is that of the device
_BRIDGED, _SHORTEST_HOLD = 3, 10  # samples
# Samples before a limit, and their least slope relative to the usual one, where a sensor is clipped.
_ARRIVING, _STEEP = 6, 0.3


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
    values = _finite(values)
    if values.size < FEWEST_SAMPLES:
        return None, False
    sizes, differences = [], np.diff(values)
    for order in range(2, 7):
        differences = np.diff(differences)
        size = float(np.median(np.abs(differences), overwrite_input=True))
        sizes.append(MAD_TO_RMS * size / math.sqrt(math.comb(2 * order, order)))
    step, least = resolution(values) or 0.0, min(sizes)
    precision = float(np.finfo(float).eps * np.max(np.abs(values)))
    floor = max(precision, _PRINTED * step)
    if least <= floor:  # most samples repeat their neighbors: a rounded signal, or one with jumps
        moves = np.concatenate([[False], np.diff(values) != 0, [False]])
        isolated = moves[1:-1] & ~moves[:-2] & ~moves[2:]
        rounded = sizes[-1] > floor or (isolated.sum() > 0.5 * moves.sum() and moves.mean() < 0.75)
        if rounded and step < SAME_LEVEL * np.ptp(values):  # else the levels are those of a signal with steps
            return step / math.sqrt(12), False
        return (least if least > precision else 0.0), False  # below: that of the arithmetic
    return least, sizes[-1] < 0.8 * sizes[1]


def rounding_rms(values: np.ndarray) -> float:
    """RMS error by the rounding of a column whose noise is that alone [unit of the values]; 0 elsewhere.

    Args:
        values: shape (T,); non-finite values are omitted.
    """
    noise, is_bound = noise_rms(values)
    step = resolution(values) or 0.0
    error = step / math.sqrt(12)
    if noise is None or is_bound or step >= SAME_LEVEL * np.ptp(values[np.isfinite(values)]):
        return 0.0
    return error if _ROUNDING[0] * error <= noise <= _ROUNDING[1] * error else 0.0


def printed_step(values: np.ndarray) -> float:
    """The power of ten of which all values are multiples, as of text with few decimals [unit of the values]; 0 of computed values."""
    finite = _finite(values)
    size = float(np.abs(finite).max(initial=0.0))
    first = math.ceil(math.log10(size)) if size > 0 else 0
    steps = (10.0**power for power in range(first, first - _DIGITS, -1))
    whole = lambda step: bool(np.all(np.abs(finite / step - np.round(finite / step)) < _WHOLE))
    return next((step for step in steps if size > 0 and whole(step)), 0.0)


def resolution(values: np.ndarray) -> float | None:
    """Smallest difference of two distinct values [unit of the values]; None where all are equal."""
    finite = np.sort(_finite(values))
    if finite.size < 2:
        return None
    steps = np.diff(finite)
    distinct = steps > 1e-12 * max(abs(finite[0]), abs(finite[-1]))
    return float(np.min(steps, where=distinct, initial=np.inf)) if distinct.any() else None


def _finite(values: np.ndarray) -> np.ndarray:
    """The finite values; not a copy where all are."""
    values = np.asarray(values, dtype=float)
    finite = np.isfinite(values)
    return values if finite.all() else values[finite]


def runs(mask: np.ndarray) -> np.ndarray:
    """First sample and end (exclusive) of every run of True, shape (K, 2)."""
    edges = np.diff(np.concatenate([[False], np.asarray(mask, dtype=bool), [False]]))
    return np.flatnonzero(edges).reshape(-1, 2)


def bridged(y: np.ndarray) -> np.ndarray:
    """Output with gaps of at most three missing samples filled by straight lines, shape (T,)."""
    missing = np.isnan(y)
    filled = np.interp(np.arange(y.size), np.flatnonzero(~missing), y[~missing])
    for start, stop in runs(missing):
        if stop - start > _BRIDGED or start == 0 or stop == y.size:
            filled[start:stop] = np.nan
    return filled


def holds(u: np.ndarray, tolerance: float) -> np.ndarray:
    """Holds of the input: first sample and end (exclusive), shape (K, 2).

    A hold is a longest stretch within the tolerance whose input moves away soon outside it. The input may settle before it; the
    tops of slow waves are not holds, because they grow with the tolerance.

    Args:
        u: input, shape (T,).
        tolerance: largest extent of the input within a hold, its noise included [unit of u].
    """
    u = np.asarray(u, dtype=float)
    values: list[float] = u.tolist()
    found: list[tuple[int, int]] = []
    start = 0
    for first, last in _still(u, tolerance):
        start = now = max(start, first)
        highs: collections.deque[int] = collections.deque()  # samples of the stretch that no later one exceeds
        lows: collections.deque[int] = collections.deque()
        while now < min(last + 1, u.size):
            while highs and values[highs[-1]] <= values[now]:
                highs.pop()
            while lows and values[lows[-1]] >= values[now]:
                lows.pop()
            highs.append(now)
            lows.append(now)
            now += 1
            if values[highs[0]] - values[lows[0]] <= tolerance:
                continue
            if now - 1 - start >= _SHORTEST_HOLD and _is_rest(values, start, now - 1, tolerance):
                stop = _end_of_rest(values, start, now - 1, tolerance)
                found.append((start, stop))
                start = now = stop
                highs.clear()
                lows.clear()
                continue
            while values[highs[0]] - values[lows[0]] > tolerance:
                start = min(highs[0], lows[0]) + 1
                for ends in (highs, lows):
                    while ends[0] < start:
                        ends.popleft()
        if last == u.size and u.size - start >= _SHORTEST_HOLD and _is_rest(values, start, u.size, tolerance):
            found.append((start, u.size))
    return np.array(found, dtype=int).reshape(-1, 2)


def _still(u: np.ndarray, tolerance: float) -> np.ndarray:
    """First sample and end (exclusive) of every part that may have holds, shape (K, 2): each sample is in a short stretch at rest."""
    if u.size < _SHORTEST_HOLD:
        return np.empty((0, 2), dtype=int)
    windows = np.lib.stride_tricks.sliding_window_view(u, _SHORTEST_HOLD)
    within = windows.max(axis=1) - windows.min(axis=1) <= tolerance
    covered = np.zeros(u.size, dtype=bool)
    for k in range(_SHORTEST_HOLD):
        covered[k : k + within.size] |= within
    return runs(covered)


def _end_of_rest(values: list[float], start: int, stop: int, tolerance: float) -> int:
    """The end of a hold that an outlier of the noise, or the end of settling at its start, cut off at `stop`."""
    middle = float(np.median(values[start:stop]))
    while stop < len(values) and abs(values[stop] - middle) <= 0.75 * tolerance:
        stop += 1
    return stop


def _is_rest(values: list[float], start: int, stop: int, tolerance: float) -> bool:
    """Whether a stretch stays much the same where the tolerance is about six times as large.

    The top of a parabola becomes twice as long, a ramp six times.
    """
    middle = 0.5 * (values[start] + values[stop - 1])
    near = lambda k: 0 <= k < len(values) and abs(values[k] - middle) <= 3 * tolerance
    length = stop - start
    both, one = round(0.22 * length), round(0.43 * length)
    return not (near(start - both) and near(stop - 1 + both)) and not (near(start - one) or near(stop - 1 + one))


def clipped_samples(u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Whether the output stays at its largest or smallest value while the input moves on, shape (T,).

    Counted are runs of four samples or more that repeat this value exactly while u moves on in its direction by more than 2 % of its
    range; slow or rounded signals, which repeat values elsewhere too, are not counted, nor is backlash, which begins at a reversal, nor
    the limits of a device that stays at them for much of the record, as a switch does.

    Args:
        u: input, shape (T,).
        y: output, shape (T,).
    """
    found = _at_a_limit(u, y)
    return found if found.mean() < _MOST_CLIPPED else np.zeros_like(found)


def _at_a_limit(u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The same, however many they are."""
    y = np.asarray(y, dtype=float)
    found = np.zeros(y.size, dtype=bool)
    span = np.ptp(u)
    if span == 0 or not np.isfinite(y).any():
        return found
    same = np.concatenate([[False], y[1:] == y[:-1]])
    inner = same & (y < np.nanmax(y)) & (y > np.nanmin(y))
    usual = max([stop - start for start, stop in runs(inner)], default=0)
    for end in (np.nanmax(y), np.nanmin(y)):
        for start, stop in runs(y == end):
            onward = np.sign(u[start] - u[start - 1]) if start else np.sign(u[stop - 1] - u[0])
            if (
                stop - start >= max(4, 2 * (usual + 1))
                and np.max(onward * (u[start:stop] - u[start])) > SAME_LEVEL * span
            ):
                found[start:stop] = True
    return found


def saturated_samples(u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The clipped samples of a sensor at its limit, shape (T,): a device approaches saturation slowly, a sensor at a slope.

    Only noise shows a limit of the sensor: it ends there. Without noise a plateau may be the device (a contact angle, a saturated magnet).

    Args:
        u: input, shape (T,).
        y: output, shape (T,).
    """
    clipped = _at_a_limit(u, y)
    if not clipped.any() or has_two_levels(y):
        return np.zeros_like(clipped)
    noise, is_bound = noise_rms(y[~clipped])
    if noise is None or is_bound or noise <= (resolution(y) or 0.0):
        return np.zeros_like(clipped)
    slope = np.abs(np.diff(y)) / np.maximum(np.abs(np.diff(u)), 1e-3 * np.ptp(u) / u.size)
    usual = float(np.nanmedian(slope[~clipped[1:] & ~clipped[:-1]]))
    for start, stop in runs(clipped):
        arriving = slope[max(start - _ARRIVING, 0) : max(start - 1, 0)]
        if arriving.size and not np.nanmedian(arriving) > _STEEP * usual:
            clipped[start:stop] = False
    return clipped


def spikes(y: np.ndarray, noise: float | None, u: np.ndarray) -> np.ndarray:
    """Sample numbers of isolated outliers: beyond both neighbors on one side by more than 10 times the noise and 3 % of the range.

    An outlier is also far beyond the steps about it, as the peak of a wave of few samples is not, and the input does not jump there.

    Args:
        y: output, shape (T,).
        noise: its rms [unit of y]; None for 0.
        u: input, shape (T,).
    """
    y = np.asarray(y, dtype=float)
    before, after = y[1:-1] - y[:-2], y[1:-1] - y[2:]
    limit = max(10 * (noise or 0.0), 0.03 * float(np.nanmax(y) - np.nanmin(y)))
    with np.errstate(invalid="ignore"):
        least = np.minimum(np.abs(before), np.abs(after))
        out = np.flatnonzero((np.sign(before) == np.sign(after)) & (least > limit)) + 1
    return np.array([k for k in out if _stands_out(y, k, _FAR) and not _stands_out(u, k, _JUMP)], dtype=int)


def _stands_out(values: np.ndarray, k: int, factor: float) -> bool:
    """Whether the smaller step to a neighbor of sample k is larger by a factor than all steps about it."""
    steps = np.abs(np.concatenate([np.diff(values[max(k - _STEPS, 0) : k]), np.diff(values[k + 1 : k + _STEPS + 1])]))
    least = min(abs(values[k] - values[k - 1]), abs(values[k] - values[k + 1]))
    return bool(least > factor * np.nanmax(steps, initial=0.0))


MOST = 5.0  # percent of the steps that may go backward
_LENGTHS = (5, 7, 9, 11, 15, 21, 31, 41, 61, 81, 101)


def chatter(u: np.ndarray, branches: np.ndarray, reach: float = np.inf) -> float:
    """Share of the samples at which noise steps the input back against its branch [%].

    Args:
        u: input, shape (T,).
        branches: first and last sample of each monotonic branch, shape (K, 2).
        reach: longest way back in one go that may be noise, and no small loop of the input [unit of u].
    """
    backward = 0
    for a, b in branches:
        steps = np.sign(u[b] - u[a]) * np.diff(u[a : b + 1])
        back = runs(steps < 0)
        way = np.append(0.0, np.cumsum(steps))
        near = way[back[:, 0]] - way[back[:, 1]] <= reach
        backward += int(np.diff(back)[near].sum())
    return 100 * backward / max(u.size - 1, 1)


def smoothing_length(u: np.ndarray, branches: np.ndarray, reach: float = np.inf) -> int | None:
    """Shortest smoothing filter that leaves acceptable chatter [samples]; None where there is no chatter, or no filter removes it.

    A filter may be as long as a quarter of the median branch, so that it does not round the reversals off.

    Args:
        u: input, shape (T,).
        branches, reach: as for `chatter`.
    """
    if chatter(u, branches, reach) <= MOST:
        return None
    longest = min(u.size, float(np.median(np.diff(branches))) / 4)
    fitting = (length for length in _LENGTHS if length <= longest)
    return next((length for length in fitting if chatter(smooth(u, length), branches, reach) <= MOST), None)
