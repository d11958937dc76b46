"""Branches of a measured loop, between the turning points of its input: area, crossings, and medians over branches."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np

from hystfit.models.shared.slopes import POINTS
from hystfit.quality.faults import CLEAR, noise_rms
from hystfit.quality.held_out import correlation_length
from hystfit.quality.loops import APART, LARGEST, SAME_LEVEL, reversals
from hystfit.quality.shape import area_between, has_lobes

ENDS = 0.95  # of the largest input, from which the output counts as that of the ends
GAP = 0.1  # of a range: between the two ends of a loop that counts as closed
_NEAR = 3.0  # standard deviations of the noise below the largest output, within which samples are those of one level


@dataclasses.dataclass(frozen=True, eq=False)
class Branch:
    """Samples between two turning points of the input, in the order of time."""

    u: np.ndarray
    y: np.ndarray
    duration: float = np.nan  # time from one to the other, in the unit of the record; NaN where it is unknown

    @property
    def rises(self) -> bool:
        """Whether the input ends above where it began."""
        return bool(self.u[-1] > self.u[0])


Pair = tuple[Branch, Branch]
Found = tuple[float, float]  # a value read off a branch and its standard error, NaN where unknown
NOT_FOUND: Found = (np.nan, np.nan)


def large_branches(u: np.ndarray, y: np.ndarray, turns: np.ndarray, t: np.ndarray | None = None) -> list[Branch]:
    """Branches over nearly the whole range; the last and the first piece of a loop that ends where it began are one, where it has no other.

    The first piece of several loops is the curve of first loading.
    """
    edges = [0, *turns.tolist(), u.size - 1]
    lasts = lambda a, b: np.nan if t is None else float(t[b] - t[a])
    parts = [Branch(u[a : b + 1], y[a : b + 1], lasts(a, b)) for a, b in itertools.pairwise(edges)]
    span = float(np.ptp(u))
    large = [part for part in parts if np.ptp(part.u) >= LARGEST * span]
    first, last = parts[0], parts[-1]
    if (
        len(parts) > 2
        and first.rises == last.rises
        and not any(part.rises == first.rises for part in large)
        and abs(u[-1] - u[0]) <= GAP * span
    ):
        joined = Branch(np.append(last.u, first.u), np.append(last.y, first.y), last.duration + first.duration)
        if np.ptp(joined.u) >= LARGEST * span:
            large.append(joined)
    return [*map(_without_inner_loops, large)]


def _without_inner_loops(branch: Branch) -> Branch:
    """The branch without the small loops inside it, from a reversal to where the input passes it again.

    The output goes to and fro on these loops, and crosses levels that the branch itself crosses elsewhere.
    """
    u = branch.u if branch.rises else -branch.u
    kept = np.ones(u.size, dtype=bool)
    turns = reversals(u, SAME_LEVEL * float(np.ptp(u)))
    for top in turns[u[turns] > np.append(u[turns][1:], u[-1])]:
        beyond = np.flatnonzero(u[top:] > u[top])
        kept[top + 1 : top + beyond[0] if beyond.size else u.size] = False
    return Branch(branch.u[kept], branch.y[kept], branch.duration)


def turns_of(u: np.ndarray) -> np.ndarray:
    """Samples at which the branches of a loop end."""
    return reversals(u, APART * float(np.ptp(u)))


def closes(one: Branch, other: Branch, y: np.ndarray) -> bool:
    """Whether the output of two branches ends where it began."""
    return bool(abs(other.y[-1] - one.y[0]) <= GAP * float(np.ptp(y)))


def large_cycles(u: np.ndarray, y: np.ndarray, pairs: Sequence[Pair], t: np.ndarray | None = None) -> list[Pair]:
    """Pairs of branches that close; else the largest cycles from one passage of the middle input to the next in the same direction.

    The latter need no closed loop: in a test of growing amplitudes the energy that such a cycle dissipates is its area.
    """
    closed = [pair for pair in pairs if closes(*pair, y)]
    exact = [(one, other) for one, other in closed if abs(other.u[-1] - one.u[0]) <= SAME_LEVEL * float(np.ptp(u))]
    return exact or between_passages(u, y, t) or closed


def between_passages(u: np.ndarray, y: np.ndarray, t: np.ndarray | None = None) -> list[Pair]:
    """Cycles over the whole range of the input that begin and end at its middle, with the time between its passages."""
    middle, span = 0.5 * float(u.max() + u.min()), float(np.ptp(u))
    t = np.full(u.size, np.nan) if t is None else t
    clear = np.flatnonzero(np.abs(u - middle) > SAME_LEVEL * span)
    side = np.sign(u - middle)
    for end, inner in ((0, clear[0]), (-1, clear[-1])):  # a record that begins or ends in the middle passes it there
        if abs(u[end] - middle) <= SAME_LEVEL * span:
            side[end] = -side[inner]
    found = []
    for way in (1, -1):
        passages = np.flatnonzero((side[:-1] * way < 0) & (side[1:] * way >= 0)) + 1
        for a, b in itertools.pairwise(passages.tolist()):
            if np.ptp(u[a:b]) >= (1 - SAME_LEVEL) * span:
                ends, (start, end) = (
                    [float(np.interp(middle, *_rising(u[k - 1 : k + 1], of[k - 1 : k + 1]))) for k in (a, b)]
                    for of in (y, t)
                )
                inputs, outputs = (
                    np.pad(u[a:b], 1, constant_values=middle),
                    np.concatenate([ends[:1], y[a:b], ends[1:]]),
                )
                half = int(np.argmax(np.abs(inputs - middle)))
                lasts = 0.5 * (end - start)
                one, other = (Branch(inputs[of], outputs[of], lasts) for of in (slice(half), slice(half, None)))
                found.append((one, other))
    return found


def from_ends(one: Branch, other: Branch) -> Pair:
    """The branches between both ends of a cycle that begins and ends in the middle; where it closes, those of a loop."""
    u, y = np.append(one.u, other.u), np.append(one.y, other.y)
    first, last = sorted((int(np.argmin(u)), int(np.argmax(u))))
    joined = Branch(np.append(u[last:], u[1 : first + 1]), np.append(y[last:], y[1 : first + 1]))
    return Branch(u[first : last + 1], y[first : last + 1]), joined


def mean_ends(branches: Sequence[Branch], low: float, high: float, sigma: float) -> tuple[tuple[float, float], float]:
    """Mean outputs over the outer 5 % of a range of the input, at the high and at the low end; error of half their difference or sum.

    Means over the input, and not over the samples, which may lie closer at one place or be more on one branch. The error has that of the
    ends themselves, which lie anywhere within a step between samples.
    """
    margin = 0.5 * (1 - ENDS) * (high - low)
    means, variance = [], 0.0
    for first, last in ((high - margin, high), (low, low + margin)):
        found = [one for b in branches if (one := _over(b, first, last)) is not None]
        means.append(float(np.mean([mean for mean, _, _ in found])) if found else np.nan)
        if found:
            variance += sigma**2 / sum(count for *_, count in found) + np.mean([step for _, step, _ in found]) ** 2 / 12
    return (means[0], means[1]), 0.5 * math.sqrt(variance)


def _over(b: Branch, low: float, high: float) -> tuple[float, float, int] | None:
    """Over a range of the input, as far as a branch goes there: mean output, its mean step and the number of samples; None without any."""
    u, y = _rising(b.u, b.y)
    inside = (u >= low) & (u <= high)
    if not inside.any():
        return None
    ends, count = np.clip([low, high], u[0], u[-1]), int(inside.sum())
    if not ends[1] > ends[0]:
        return float(y[inside].mean()), 0.0, count
    at = np.interp(ends, u, y)
    grid, level = np.r_[ends[0], u[inside], ends[1]], np.r_[at[0], y[inside], at[1]]
    return float(np.trapezoid(level, grid) / (ends[1] - ends[0])), abs(at[1] - at[0]) / count, count


def _rising(u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(u, kind="stable")
    return u[order], y[order]


def area(one: Branch, other: Branch) -> float:
    """Signed area between two branches, positive counter-clockwise."""
    u, y = np.append(one.u, other.u), np.append(one.y, other.y)
    u, y = u - u.mean(), y - y.mean()
    return 0.5 * float(np.sum(u * np.roll(y, -1) - np.roll(u, -1) * y))


def _thinned(branch: Branch) -> Branch:
    """Every second sample of a branch, and its last one."""
    kept = np.unique(np.append(np.arange(0, branch.u.size, 2), branch.u.size - 1))
    return Branch(branch.u[kept], branch.y[kept])


def area_error(pair: Pair, sigma: float, correlated: float = 0.0) -> float:
    """Standard error of the area of a loop by noise sigma that is correlated over a stretch of the input, 0 for white noise."""
    steps = np.abs(np.gradient(np.append(pair[0].u, pair[1].u)))
    together = max(1.0, 2.0 * correlated / max(float(np.median(steps)), 1e-300) - 1.0)  # sum of the autocorrelation
    return sigma * float(np.sqrt(together * np.sum(steps**2)))


def loss(pairs: Sequence[Pair], sigma: float, correlated: float = 0.0) -> tuple[float, float, int]:
    """Median area of closed loops in the order of time, its standard error and their number; the noise as for `area_error`.

    Neighboring loops share a branch: the error is that of every second one, which are independent, by their noise or the scatter of all,
    such as that of cycles which decay. To it comes that of straight lines between the samples: the areas of every second and of every
    fourth sample show how fast it falls with their distance (Richardson and Aitken). Where the input does not come back, it is at least the
    strip that is missing.
    """
    areas = [abs(area(*pair)) for pair in pairs]
    separate = [(size, area_error(pair, sigma, correlated)) for size, pair in zip(areas[::2], pairs[::2], strict=True)]
    value = float(np.median(areas))
    half = [(_thinned(one), _thinned(other)) for one, other in pairs]
    quarter = [(_thinned(one), _thinned(other)) for one, other in half]
    second, fourth = (float(np.median([abs(area(*pair)) for pair in thinned])) for thinned in (half, quarter))
    lost = abs(value - second)
    ratio = abs(second - fourth) / lost - 1 if lost > 0 else 3.0
    strip = float(np.median([_missing(*pair) for pair in pairs]))
    scatter = float(np.std(areas, ddof=1)) / math.sqrt(len(separate)) if len(areas) > 1 else 0.0
    of_each = max(float(np.nan_to_num(combined(separate)[1])), scatter)
    error = math.hypot(of_each, lost / np.clip(ratio, 1.0, 3.0)) + strip
    return value, error if error > 0 else np.nan, len(areas)


def _missing(one: Branch, other: Branch) -> float:
    """Largest area that is missing where the input does not come back to where the loop began, by more than a step between samples."""
    gap, step = abs(other.u[-1] - one.u[0]), float(np.max(np.abs(np.diff(other.u[-3:]))))
    return float(gap * np.ptp(one.y)) if gap > max(SAME_LEVEL * float(np.ptp(one.u)), 1.5 * step) else 0.0


def is_open(pairs: Sequence[Pair], sigma: float) -> bool:
    """Whether areas differ from zero by more than the noise makes them."""
    error = np.nan_to_num(area_error(pairs[0], sigma))
    return bool(abs(np.median([area(*pair) for pair in pairs])) > CLEAR * error / np.sqrt(len(pairs)))


def crosses(pairs: Sequence[Pair], sigma: float) -> bool:
    """Whether the branches cross (a butterfly), so that the areas of the lobes cancel."""
    joined = [(np.append(one.u, other.u), np.append(one.y, other.y)) for one, other in pairs]
    each = [(area(*pair), area_between(u, y), np.ptp(u), np.ptp(y)) for pair, (u, y) in zip(pairs, joined, strict=True)]
    size, between, width, height = np.median(each, axis=0)
    return bool(has_lobes(size, between, width * height, np.nan_to_num(sigma) * width))


def crossing(level: np.ndarray, values: np.ndarray, sigma: float = np.nan, of_values: float = np.nan) -> Found:
    """Value where a level passes zero along a branch, and its standard error; without where it ends on the side where it began.

    `sigma` is the noise of the level, `of_values` that of the values; that of the input is not given, and is measured here.
    """
    passed = np.flatnonzero((level[:-1] < 0) != (level[1:] < 0))
    if passed.size % 2 == 0:
        return NOT_FOUND
    k = int(passed[len(passed) // 2])
    step, run = level[k + 1] - level[k], values[k + 1] - values[k]
    near = np.flatnonzero(np.abs(level) <= CLEAR * sigma)
    runs = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)  # those at other crossings are apart
    near = next((run for run in runs if k in run), near[:0])
    if near.size < 5 or abs(step) > CLEAR * sigma:
        per_level = abs(run / step)
        known = np.isfinite(of_values)
        curved = _beside_chord(level, values, k) if known else _beside_chord(values, level, k) * per_level
        between = max(abs((level[k] / step) * (1 + level[k] / step) * curved), of_jump(level, values, k))
        by_noise = (
            _noise_beside(level, values, k)
            if known
            else float(np.hypot(np.nan_to_num(sigma) * per_level, _noise(values)))
        )
        error = math.hypot(np.nan_to_num(of_values), by_noise, between)
        rounding = np.finfo(float).eps * float(np.abs(values).max())
        return float(values[k] - level[k] * run / step), error if error > rounding else np.nan
    if not np.ptp(values[near]):  # an input that is switched between levels
        return NOT_FOUND
    return _along_line(level[near], values[near], sigma, _noise(values))


def _along_line(level: np.ndarray, values: np.ndarray, sigma: float, of_values: float) -> Found:
    """`crossing` where noise crosses zero several times: by a straight line through the samples about it, over the one with less noise."""
    if of_values * np.std(level) > sigma * np.std(values):
        slope, at = np.polyfit(level, values, 1)
        spread = 1.0 / level.size + level.mean() ** 2 / float(np.sum((level - level.mean()) ** 2))
        return float(at), float(np.hypot(of_values, sigma * slope) * np.sqrt(spread))
    slope, offset = np.polyfit(values, level, 1)
    at = -offset / slope
    spread = 1.0 / level.size + (at - values.mean()) ** 2 / max(float(np.sum((values - values.mean()) ** 2)), 1e-300)
    return float(at), float(np.hypot(sigma / slope, of_values) * np.sqrt(spread))


def _noise(values: np.ndarray) -> float:
    """RMS noise of values along a branch; 0 where these are so sparse that it cannot be told from them."""
    noise, is_bound = noise_rms(values)
    return 0.0 if is_bound else noise or 0.0


def _noise_beside(level: np.ndarray, values: np.ndarray, k: int) -> float:
    """Error of values between the samples k and k + 1 by the noise of the level: times the slope over their neighbors and that noise."""
    noise = _noise(level)
    near = np.abs(level - 0.5 * (level[k] + level[k + 1])) <= CLEAR * noise
    near[max(k - 1, 0) : k + 3] = True
    return noise * abs(float(np.polyfit(level[near], values[near], 1)[0])) if noise else 0.0


def of_jump(level: np.ndarray, values: np.ndarray, k: int) -> float:
    """Standard error of the place of a jump between two samples, of that part of it that the slopes beside it do not have.

    It may lie anywhere between the two: a uniform distribution has 1 / sqrt(12) of its width.
    """
    slope = lambda at: abs(level[at + 1] - level[at]) / (abs(values[at + 1] - values[at]) or np.inf)
    beside = [slope(at) for at in (k - 1, k + 1) if 0 <= at < level.size - 1]
    own = slope(k)
    part = max(0.0, 1.0 - max(beside, default=own) / own) if own > 0 else 0.0
    return part * abs(values[k + 1] - values[k]) / math.sqrt(12)


def _beside_chord(x: np.ndarray, y: np.ndarray, k: int) -> float:
    """Half the squared distance of two neighboring samples times the mean second derivative on both sides of it.

    Times f (1 - f) it is the error of a straight line between the two, at the part f of their distance. One sample that is off makes one
    derivative large, as a bend on one side does; of six samples a branch the smaller of the two is too small by a factor of two.
    """
    triples = [slice(first, first + 3) for first in (k - 1, k) if first >= 0 and first + 3 <= x.size]
    slopes = [np.diff(y[three]) / np.diff(x[three]) for three in triples if np.all(np.diff(x[three]))]
    widths = [abs(x[three][2] - x[three][0]) for three in triples if np.all(np.diff(x[three]))]
    second = [2 * abs(s[1] - s[0]) / width for s, width in zip(slopes, widths, strict=True) if width] or [0.0]
    return 0.5 * float((x[k + 1] - x[k]) ** 2 * np.mean(second))


def combined(found: list[Found]) -> tuple[float, float, int]:
    """Median over branches and its standard error, by the noise of each or their scatter where that is larger; and their number."""
    values, errors = np.array([one for one in found if np.isfinite(one[0])]).reshape(-1, 2).T
    if not values.size:
        return *NOT_FOUND, 0
    stated = np.sqrt(np.mean(errors**2) / values.size)
    scatter = np.std(values, ddof=1) / np.sqrt(values.size) if values.size > 1 else np.nan
    return float(np.median(values)), float(np.fmax(stated, scatter)), values.size


def center_at(level: float, branches: Sequence[Branch], sigma: float) -> Found:
    """Half sum of the inputs at which the rising and the falling branches pass a level, and its error."""
    sides = ([crossing(b.y - level, b.u, sigma) for b in branches if b.rises == rises] for rises in (True, False))
    (one, of_one, _), (other, of_other, _) = map(combined, sides)
    return 0.5 * (one + other), 0.5 * float(np.hypot(of_one, of_other))


def range_error(y: np.ndarray, sigma: float) -> float:
    """Error of the range of an output with white noise: that of two samples, and by how much the largest of many exceeds their mean."""
    many = np.array([np.count_nonzero(~(side < side.max() - _NEAR * sigma)) for side in (y, -y)])
    return sigma * float(np.hypot(np.sqrt(2), np.sqrt(2 * np.log(many)).sum()))


def asymmetry(branches: list[Branch]) -> tuple[float, float]:
    """How far a loop is no reflection of itself in its center: standard deviation of an output, and the stretch of its correlation.

    Shifts of the loop in both directions are left out; zeros without both branches. It contains noise that is correlated over many samples,
    which their differences do not show.
    """
    falling, rising = (next((b for b in branches if b.rises == rises), None) for rises in (False, True))
    if falling is None or rising is None:
        return 0.0, 0.0
    level = 0.5 * (max(falling.y.max(), rising.y.max()) + min(falling.y.min(), rising.y.min()))
    shift = 0.5 * sum(crossing(b.y - level, b.u)[0] for b in (falling, rising))
    if np.isfinite(shift):  # exchange bias may shift a loop by more than its width
        falling, rising = (Branch(b.u - shift, b.y) for b in (falling, rising))
    most = LARGEST * min(float(falling.u.max()), -float(falling.u.min()), float(rising.u.max()), -float(rising.u.min()))
    if not most > 0:
        return 0.0, 0.0
    grid = np.linspace(-most, most, POINTS)
    at = lambda u, y: np.interp(grid, u[np.argsort(u, kind="stable")], y[np.argsort(u, kind="stable")])
    one, other = at(falling.u, falling.y), at(-rising.u, -rising.y)
    columns = np.column_stack([np.ones(POINTS), np.gradient(0.5 * (one + other), grid) * most])
    left = one - other - columns @ np.linalg.lstsq(columns, one - other, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2) / 2)), correlation_length(left) * 2 * most / (POINTS - 1)
