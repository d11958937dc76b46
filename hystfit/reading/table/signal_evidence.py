"""What the numbers of one column, or of two, show: range, noise, harmonics, and whether one explains the other."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from hystfit.reading.limits import JUMP, NEAR

# Part of the variance that a straight line leaves, below which two columns are proportional: the narrowest loops, those of piezo actuators,
# leave 0.001 to 0.02 to their hysteresis.
_PROPORTIONAL = 2e-4
# The same of a column that was computed from the other one: numbers of five digits are rounded by 1e-10 of the variance, and sensors of 16
# bits leave more.
_COMPUTED = 1e-9
# Part of the range of which digits written for two columns may be, where they differ by such digits alone: the hysteresis of a piezo
# actuator moves its loop by 0.02 of the range and more.
_DIGITS = 5e-3
_WHOLE = 1.1  # by how much the straight line through rounded numbers may be off, in half a digit of each column
_SMALL = 0.01  # range of a column over its size, below which it is held at a value far from zero
_AT_END = 0.02  # of the range of an input, within which it is at one of its ends
_SWING = 0.02  # of the range of an input, below which it swings as noise does
# Third differences of numbers that are cut off are at most that many units of their last digit, or steps of their converter; two numbers
# are the same that differ by less than that part of the range, and steps by that part of the smallest.
_CUT_OFF, _SAME, _SAME_DIGIT = 4.0, 1e-12, 1e-3
_SAME_STEP = 1e-4  # part of a step by which the next one is the same: along a sine of 1000 samples a cycle it changes by up to 0.006
# Part of the steps of a column that are one step up or down where it was set, the least part in each direction, and the most part after
# which the direction changes: a measurement of few digits stays for some rows, or moves to and fro.
_EQUAL, _EACH_WAY, _TURNS = 0.9, 0.2, 0.2
_AT_JUMPS = 0.95  # of all changes of the steps, in the largest tenth of them: of a sine that part is 0.16
_LEVELS = 5  # distinct values of a column that is held at each of them: pulses of a current have two or three
_STEPS_APART = 2.0  # of the largest steps of a signal, by which a part of it may begin after the end of the one before
_USUAL = 1.5  # step of a clock over its median step, up to which it goes on
# By how much the squares of the differences of neighbors are larger across the branches of a loop than along them: noise alone has up to
# 2.0 in 1800 draws of 40 to 60 samples, and a loop with noise of 0.15 of its range 2.6 to 3.4.
_LOOPED = 2.5
_MOST_SAMPLES, _FEWEST = 4000, 40  # samples that are looked at, and below which nothing is said of a relation
_FEWEST_COMPUTED = 8  # samples below which a straight line is no evidence that one column was computed from the other


def extent(values: np.ndarray) -> float:
    """The range of a column."""
    finite = values[np.isfinite(values)]
    return float(np.ptp(finite)) if finite.size else 0.0


def sample(values: np.ndarray) -> np.ndarray:
    """Every nth sample of a long column."""
    return values[:: max(1, values.size // _MOST_SAMPLES)]


def _known(*columns: np.ndarray) -> list[np.ndarray]:
    """Columns of equal length in the rows in which all of them have numbers."""
    rows = np.isfinite(columns).all(axis=0)
    return [column[rows] for column in columns]


def is_held(values: np.ndarray) -> bool:
    """Whether a column stays near one value far from zero."""
    finite = values[np.isfinite(values)]
    return finite.size > 0 and float(np.ptp(finite)) < _SMALL * float(np.abs(finite).min())


def is_near_median(values: np.ndarray) -> np.ndarray:
    """The rows in which a column stays near one value far from zero, shape (rows,)."""
    median = float(np.nanmedian(values)) if np.isfinite(values).any() else np.nan
    return np.abs(values - median) < _SMALL * abs(median)


def states_strokes(numbers: np.ndarray, u: np.ndarray) -> bool:
    """Whether a column states the amplitude or the stroke of the input in each of its blocks, at one scale, and is no input of its own."""
    begins = np.flatnonzero(np.diff(numbers)) + 1
    stated, blocks = np.abs(numbers[np.append(0, begins)]), np.split(u, begins)
    if not begins.size or not np.isfinite(u).all() or not (stated > 0).all():
        return False
    sizes = np.array([(np.abs(block).max(), np.ptp(block)) for block in blocks]) / stated[:, None]
    return bool((np.ptp(sizes, axis=0) <= NEAR * sizes.min(axis=0)).any())


def moves_at_rest(u: np.ndarray, y: np.ndarray) -> bool:
    """Whether an output moves over most of its range while its input stays at its least or largest value, as under a heater that is off."""
    u, y = sample(u), sample(y)
    if not (np.isfinite(u).all() and np.isfinite(y).all() and np.ptp(u) > 0):
        return False
    place = (u - u.min()) / np.ptp(u)
    side = (place > 1 - _AT_END).astype(int) - (place < _AT_END)
    runs = np.split(np.arange(u.size), np.flatnonzero(np.diff(side)) + 1)
    return any(side[run[0]] and np.ptp(y[run]) > 0.5 * np.ptp(y) for run in runs)


def explained(u: np.ndarray, y: np.ndarray, part: np.ndarray) -> float:
    """Part of the variance of an output that its input explains: that which samples of neighboring inputs have in common.

    Samples of a rising and of a falling input are compared apart (von Neumann's ratio of each, in the order of the input).

    Args:
        part: number of the record that a sample is in, shape (rows,); samples of different records are compared apart too.
    """
    u, y, part = (sample(values) for values in (u, y, part))
    known = np.isfinite(u), np.isfinite(y)
    both = known[0] & known[1]
    if both.sum() < _FEWEST <= min(map(np.sum, known)):  # channels that were measured in turn
        return 0.0
    u, y, part = u[both], y[both], part[both]
    if u.size < _FEWEST or np.ptp(u) == 0 or np.ptp(y) == 0:
        return 1.0
    if _crossings(y) > 2 * swings(u) + 1:  # twice for a butterfly, and once for the end of a record
        return 0.0
    y = (y - y.mean()) / np.ptp(y)
    return float(np.clip(1.0 - 0.5 * _between_neighbors(y, u, np.gradient(u) > 0, part) / np.sum(y**2), 0.0, 1.0))


def has_loop(u: np.ndarray, y: np.ndarray, part: np.ndarray) -> bool:
    """Whether samples of neighboring inputs differ more where those of rising and falling inputs are compared with each other.

    Args:
        part: as for `explained`.
    """
    u, y, part = _known(*map(sample, (u, y, part)))
    if u.size < _FEWEST or np.ptp(u) == 0 or np.ptp(y) == 0:
        return False
    apart = _between_neighbors(y, u, np.gradient(u) > 0, part)
    return _between_neighbors(y, u, np.zeros(u.size), part) > _LOOPED * apart


def _between_neighbors(y: np.ndarray, u: np.ndarray, way: np.ndarray, part: np.ndarray) -> float:
    """Sum of the squares of the differences of neighbors in the order of the input, those of each way and record for themselves."""
    return float(np.sum(np.diff(y[np.lexsort((u, way, part))]) ** 2))


def _crossings(values: np.ndarray) -> int:
    """How often a column passes from the lower quarter of its range to the upper one or back."""
    place = (values - values.min()) / np.ptp(values)
    ends = place[(place < 0.25) | (place > 0.75)] > 0.5
    return int(np.count_nonzero(ends[1:] != ends[:-1]))


def swings(values: np.ndarray) -> int:
    """How often a column moves by more than a small part of its range in the one direction and then in the other.

    Where amplitudes grow, an output that saturates passes from end to end of its range in every cycle, and an input in the last ones.
    """
    place = (values - values.min()) / np.ptp(values)
    count, way, extreme = 0, 0, float(place[0])
    for value in place.tolist():
        if way * (value - extreme) < 0 or not way:
            if abs(value - extreme) > _SWING:
                count, way, extreme = count + 1, 1 if value > extreme else -1, value
        else:
            extreme = value
    return count


def proportional(u: np.ndarray, y: np.ndarray) -> bool:
    """Whether a straight line leaves nearly nothing of an output."""
    return _beside_a_line(u, y, _FEWEST) < _PROPORTIONAL


def computed(u: np.ndarray, y: np.ndarray) -> bool:
    """Whether one column is the other one in another unit or scale, but for the digits that were written."""
    return _beside_a_line(u, y, _FEWEST_COMPUTED) < _COMPUTED


def rounded(u: np.ndarray, y: np.ndarray) -> bool:
    """Whether no number is farther from a straight line than half a digit of either column: the volts of a sensor beside its mm."""
    u, y = _known(u, y)
    if u.size < _FEWEST or np.ptp(u) == 0 or not _beside_a_line(u, y, _FEWEST) < _PROPORTIONAL:
        return False
    slope, offset = np.polyfit(u, y, 1)
    half_digits = 0.5 * (abs(slope) * _digit(u) + _digit(y))
    return float(np.abs(y - slope * u - offset).max()) <= min(_WHOLE * half_digits, _DIGITS * float(np.ptp(y)))


def _digit(values: np.ndarray) -> float:
    """The smallest step between two values of a column without missing numbers."""
    steps = np.diff(np.unique(values))
    return float(steps[steps > _SAME * np.ptp(values)].min(initial=np.inf))


def same_loop(u: np.ndarray, one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two outputs over one input differ by their scale and a multiple of the input, as J and B = J + mu0 H do."""
    u, one, other = _known(u, one, other)
    if u.size < _FEWEST_COMPUTED or np.ptp(u) == 0:
        return False
    bent = [y - np.polyval(np.polyfit(u, y, 1), u) for y in (one, other)]
    return all(np.ptp(y) > 0 for y in bent) and _beside_a_line(*bent, _FEWEST_COMPUTED) < _PROPORTIONAL


def _beside_a_line(u: np.ndarray, y: np.ndarray, fewest: int) -> float:
    """Part of the variance that a straight line leaves; 1 of fewer samples, and of a constant column."""
    u, y = _known(sample(u), sample(y))
    if u.size < fewest or np.ptp(u) == 0 or np.ptp(y) == 0:
        return 1.0
    u, y = (u - u.mean()) / np.ptp(u), (y - y.mean()) / np.ptp(y)
    return float(1.0 - (u @ y) ** 2 / ((u @ u) * (y @ y)))


def repeats(u: np.ndarray, y: np.ndarray) -> bool:
    """Whether an output has the numbers of the input, but for nearly nothing of its variance."""
    u, y = _known(sample(u), sample(y))
    return u.size >= _FEWEST and float(np.mean((u - y) ** 2)) < _PROPORTIONAL * float(np.var(y))


def roughness(values: np.ndarray) -> float:
    """Median third difference over the range: the noise of a column that is sampled often.

    0 where it is no more than decimals cut off, or steps of a converter, of which most steps are a whole number.
    """
    values = values[np.isfinite(values)]
    if values.size <= 3 or not np.ptp(values) > 0:
        return 0.0
    third = float(np.median(np.abs(np.diff(values, 3))))
    digits = np.diff(np.unique(values)) / (least := _digit(values))
    whole = float(np.median(np.abs(digits - np.round(digits)))) < _SAME_DIGIT
    return 0.0 if whole and third <= _CUT_OFF * least * (1 + _SAME_DIGIT) else third / float(np.ptp(values))


def resolution(values: np.ndarray) -> float:
    """The smallest step between two values over the range: noise below it is not seen."""
    values = values[np.isfinite(values)]
    return _digit(values) / float(np.ptp(values)) if values.size and np.ptp(values) > 0 else np.inf


def smoothness(values: np.ndarray) -> float:
    """Correlation of neighboring samples: 0 of white noise, near 1 of a column that is sampled often; 1 of few samples."""
    values = values[np.isfinite(values)]
    if values.size < _FEWEST or np.ptp(values) == 0:
        return 1.0
    values = (values - values.mean()) / np.ptp(values)
    return float(values[1:] @ values[:-1] / (values @ values))


def overtones(values: np.ndarray) -> float:
    """Power of a column apart from its strongest frequency, as a part of the whole: small for a sine, 0.014 for a triangle."""
    values = values[np.isfinite(values)]
    power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(values.size))[1:]) ** 2
    peak, total = int(np.argmax(power)), float(power.sum())
    return 1.0 - float(power[max(peak - 3, 0) : peak + 4].sum()) / total if total > 0 else 1.0


_RESTS = 0.1  # of the steps of a column that is set step by step, at most: those at its turns


def set_again(values: np.ndarray) -> float:
    """Part of the samples whose very value a column takes while it rises and while it falls, as one that was set does.

    0 where many steps are zero: few digits of a measured column have the same values in both directions too.
    """
    finite = values[np.isfinite(values)]
    if finite.size < 2 or np.mean(np.diff(finite) == 0) > _RESTS:
        return 0.0
    rises = np.gradient(finite) > 0
    return float(np.isin(finite, np.intersect1d(finite[rises], finite[~rises])).mean())


def meet(parts: Sequence[np.ndarray]) -> bool:
    """Whether each part of a signal begins where the one before ends, but for a small part of its range or two of its largest steps."""
    largest = max(float(np.nanmax(np.abs(np.diff(part)), initial=0.0)) for part in parts)
    near = max(NEAR * extent(np.concatenate(parts)), _STEPS_APART * largest)
    return all(abs(after[0] - before[-1]) <= near for before, after in itertools.pairwise(parts))


def jumps(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Whether steps after these rows are large beside the three before and the three after them, shape of `at`, bool."""
    steps = np.abs(np.diff(values))
    padded = np.pad(np.nan_to_num(steps), 3)
    around = np.max([padded[at + 3 + k] for k in (-3, -2, -1, 1, 2, 3)], axis=0)
    return (steps[at] > JUMP * around) & (steps[at] > NEAR * extent(values))


def clock_goes_on(clock: np.ndarray, starts: np.ndarray, most: float = _USUAL) -> bool:
    """Whether the time before each of these rows goes on by so many median steps at most: the blocks are segments of one test."""
    steps = np.diff(clock)
    return bool((steps > 0).all() and (steps[starts - 1] <= most * np.median(steps)).all())


def is_even(clock: np.ndarray) -> bool:
    """Whether most steps of a clock are usual ones: those of a test with holds, and not of a log of changes."""
    steps = np.diff(clock[np.isfinite(clock)])
    return steps.size == 0 or float(np.mean(steps <= _USUAL * np.median(steps))) > _EQUAL


def rises_evenly(values: np.ndarray) -> bool:
    """Whether a column always rises, by usual steps."""
    return bool((np.diff(values) > 0).all()) and is_even(values)


def by_equal_steps(values: np.ndarray) -> bool:
    """Whether a column goes up and down by equal steps or is held equally long at every level, as one that was set: no measurement does."""
    finite = values[np.isfinite(values)]
    ends = np.flatnonzero(np.diff(finite))
    held = np.diff(ends)
    if ends.size > _FEWEST_COMPUTED and (dwell := int(np.median(held))) > 1:
        ways = np.diff(finite)[ends] > 0
        levels = np.unique(finite).size >= _LEVELS
        return levels and float(np.mean(held == dwell)) > _EQUAL and _EACH_WAY < float(np.mean(ways)) < 1 - _EACH_WAY
    steps = np.diff(finite)
    if steps.size < _FEWEST_COMPUTED or not (step := float(np.median(np.abs(steps)))) > 0:
        return False
    sizes = np.abs(steps)
    change = np.abs(np.diff(sizes))
    equal = float(np.mean(np.abs(sizes - step) < _SAME_DIGIT * step))
    as_before = float(np.mean(change < _SAME_STEP * step))
    # Those of each amplitude may have a size of their own, which changes at few places and not along every branch.
    jumps = np.sort(change)[int(_EQUAL * change.size) :].sum() > _AT_JUMPS * change.sum()
    equal = max(equal, as_before * jumps)
    each_way = min(np.mean(steps > 0), np.mean(steps < 0))
    moving = np.mean(sizes > _SAME_DIGIT * step)  # the force of a slider goes by even steps too, and then stays
    turns = np.mean(np.diff(np.sign(steps)) != 0)
    return bool(min(equal, moving) > _EQUAL and each_way > _EACH_WAY and turns < _TURNS)
