"""The thresholds of a relay, by an exact search over the inputs between which its output jumps, and their standard errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtr

from hystfit.data.record import Record

_FIRST = 5  # thresholds of either kind, spread over those of the jumps, of which all pairs are tried first
_PLACES = 16  # thresholds tried at a time where one of them is moved
_ROUNDS = 4  # turns at moving one threshold and the other; the second changes nothing in records without noise
_EQUAL = 1e-9  # of the output's variance: sums of squares that differ by rounding alone
_JUMPS = 200  # jumps whose inputs tell the error of a threshold, at most
_GRID = 30  # scatters, and half the thresholds, that the error of a threshold is summed over


def relay_state(u: Float[np.ndarray, " T"], up: float, down: float) -> Bool[np.ndarray, " T"]:
    """Whether a relay is high at each sample: on whichever threshold it passed last, or before the first on the nearer one."""
    place = np.arange(u.size)
    last = lambda beyond: np.maximum.accumulate(np.where(beyond, place, -1))
    over, under = last(u > up), last((u < down) & ~(u > up))
    return np.where(over == under, u[:1] > 0.5 * (up + down), over > under)


def resting_on_first_state(record: Record) -> Record:
    """The record behind a sample without weight, whose input is the farthest at which the output has the level of its first samples.

    It sets a relay to that level, whether its output rises or falls with the input. Records of one level stay as they are.
    """
    used = record.used
    y = record.y[used]
    if y.size < 2 or not np.ptp(y) > 0:
        return record
    u, high = record.u[used], y > _split(y, np.ones(y.size))
    same = high == high[0]
    if same.all():
        return record
    rises = _rises(u, high, np.flatnonzero(high[1:] != high[:-1]))
    farthest = u[same].max() if rises == high[0] else u[same].min()
    if record.first > 0 and record.u[0] == farthest:  # prepared before
        return record
    t = None if record.t is None else np.append(record.t[0] - record.dt[0], record.t)
    longer = (
        np.append(first, column) for first, column in ((farthest, record.u), (np.nan, record.y), (0.0, record.weight))
    )
    return record.replace(**dict(zip(("u", "y", "weight"), longer, strict=True)), t=t)


def _split(y: np.ndarray, weight: np.ndarray) -> float:
    """The value that divides outputs into two groups with the smallest sum of squares about their means (Otsu 1979)."""
    order = np.argsort(y)
    y, weight = y[order], weight[order]
    center = float(np.average(y, weights=weight))
    below, moment = np.cumsum(weight)[:-1], np.cumsum(weight * (y - center))[:-1]
    between = moment**2 * (1.0 / below + 1.0 / np.maximum(weight.sum() - below, 1e-300))
    k = int(np.argmax(np.where(y[1:] > y[:-1], between, -1.0)))
    return 0.5 * float(y[k] + y[k + 1])


def _rises(u: np.ndarray, high: np.ndarray, changes: np.ndarray) -> bool:
    """Whether an output of two levels rises with the input, so that it is high, and jumps up, at larger inputs.

    Both tell: a comparator jumps both ways at one input, and the inputs of a thermostat have one mean while it heats and while it cools.
    `high` tells whether the output is, shape (n,), and `changes` are numbers of the samples before its jumps.
    """
    middle, up = 0.5 * (u[changes] + u[changes + 1]), high[changes + 1]
    apart = u[high].mean() - u[~high].mean()
    if up.any() and not up.all():
        apart += middle[up].mean() - middle[~up].mean()
    return bool(apart >= 0)


class _Samples(NamedTuple):
    """Records, one after another: input, output about its mean, weight (0 where a sample does not count), and where each record begins."""

    u: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    begin: np.ndarray

    @classmethod
    def of(cls, records: Sequence[Record]) -> tuple[_Samples, float]:
        """The samples of records, and the mean of the output."""
        columns = lambda of: np.concatenate([of(record) for record in records])
        used, lengths = columns(lambda r: r.used), [len(record) for record in records]
        weight = np.where(used, columns(lambda r: r.weight), 0.0)
        y = np.where(used, columns(lambda r: r.y), 0.0)
        mean = float(np.average(y, weights=weight))
        begin = np.repeat(np.cumsum([0, *lengths[:-1]]), lengths)
        return cls(columns(lambda r: r.u), np.where(used, y - mean, 0.0), weight, begin), mean

    def states(self, up: np.ndarray, down: np.ndarray) -> np.ndarray:
        """Whether relays with C pairs of thresholds are high, shape (C, T)."""
        place, none = np.arange(self.u.size), self.begin - 1
        last = lambda beyond: np.maximum.accumulate(np.where(beyond, place, none), axis=1)
        over, under = last(self.u > up[:, None]), last(self.u < down[:, None])
        first = self.u[self.begin] > 0.5 * (up + down)[:, None]
        return np.where(over == under, first, over > under)

    def sums(self, up: np.ndarray, down: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weight of the samples at which relays are high, and the weighted sum of their outputs, shapes (C,)."""
        high = self.states(up, down).astype(float) @ np.column_stack([self.weight, self.weight * self.y])
        return high[:, 0], high[:, 1]

    def explained(self, up: np.ndarray, down: np.ndarray) -> np.ndarray:
        """By how much the means of two levels lower the sum of squares, shape (C,); negative for thresholds in the wrong order."""
        weight, moment = self.sums(up, down)
        total = self.weight.sum()
        either = (weight > 0) & (weight < total)
        safe = np.where(either, weight, 0.5 * total)
        # The outputs are about their mean, so that the sums of both levels are opposite.
        return np.where(up < down, -1.0, np.where(either, moment**2 * (1.0 / safe + 1.0 / (total - safe)), 0.0))

    def jumps(self) -> tuple[np.ndarray, np.ndarray]:
        """Inputs before and after each jump of the output to the high state, and to the low one, shapes (N, 2)."""
        at = np.flatnonzero(self.weight > 0)
        level = self.y[at] > _split(self.y[at], self.weight[at])
        changes = self._changes(at, level)
        if changes.size and not _rises(self.u[at], level, changes):
            level = ~level
        return self._inputs(at, changes, level[changes + 1])

    def jumps_beside(self, up: float, down: float) -> tuple[np.ndarray, np.ndarray]:
        """The same, each where it is most likely about a jump of a relay: from halfway to the one before it to halfway to the next."""
        at, (weight, moment) = np.flatnonzero(self.weight > 0), self.sums(np.array([up]), np.array([down]))
        level = self.states(np.array([up]), np.array([down]))[0][at]
        changes = self._changes(at, level)
        if not changes.size:
            return self._inputs(at, changes, level[changes])
        low, high = -moment / (self.weight.sum() - weight), moment / weight
        # What the outputs up to a sample say for the high level against the low one.
        evidence = np.cumsum(self.weight[at] * ((self.y[at] - low) ** 2 - (self.y[at] - high) ** 2))
        record, own = self.begin[at], self.begin[at[changes]]
        before = np.maximum(np.append(0, changes[:-1]), np.searchsorted(record, own))
        ends = np.searchsorted(record, own, side="right") - 2
        after = np.minimum(np.append(changes[1:], at.size), ends)
        moved = [
            first + int((np.argmin if rises else np.argmax)(evidence[first : last + 1]))
            for first, last, rises in zip(
                (before + changes) // 2, (changes + after) // 2, level[changes + 1], strict=True
            )
        ]
        return self._inputs(at, np.array(moved), level[changes + 1])

    def _changes(self, at: np.ndarray, level: np.ndarray) -> np.ndarray:
        """Numbers of the samples `at` after which the level changes within a record."""
        return np.flatnonzero((level[1:] != level[:-1]) & (self.begin[at[1:]] == self.begin[at[:-1]]))

    def _inputs(self, at: np.ndarray, changes: np.ndarray, rises: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inputs at the samples `at` before and after changes, apart for those that rise and those that fall."""
        before, after = at[changes], at[changes + 1]
        # Between both there may be samples without an output, at one of which the input passed the threshold.
        ends = np.column_stack([before + 1, after + 1]).reshape(-1)
        farthest = lambda u: np.maximum.reduceat(np.append(u, -np.inf), ends)[::2] if ends.size else np.zeros(0)
        rising = np.column_stack([self.u[before], farthest(self.u)])[rises]
        return rising, np.column_stack([self.u[before], -farthest(-self.u)])[~rises]


class Thresholds(NamedTuple):
    """Thresholds and levels of a relay."""

    up: float
    down: float
    low: float
    high: float

    @classmethod
    def of(cls, records: Sequence[Record]) -> Thresholds:
        """Those with the smallest sum of squared residuals; where several have it, the middle of the range that does."""
        samples, mean = _Samples.of(records)
        places, jumps = _Places.of(samples), samples.jumps()
        up, down = places.best_pair(jumps)
        for _ in range(_ROUNDS):
            before = up, down
            up = places.range_of(jumps[0], down=down.middle)
            down = places.range_of(jumps[1], up=up.middle)
            if (up, down) == before:
                break
        above, below = max(up.middle, down.middle), down.middle  # ranges that meet may have middles in the wrong order
        weight, moment = (float(values[0]) for values in samples.sums(np.array([above]), np.array([below])))
        rest = float(samples.weight.sum()) - weight
        low, high = mean - moment / (rest or 1.0), mean + moment / (weight or 1.0)
        return cls(above, below, low, high)

    def errors(self, records: Sequence[Record]) -> tuple[float, float]:
        """Standard errors of `up` and `down`; NaN where the output does not jump that way."""
        samples, _ = _Samples.of(records)
        rising, falling = samples.jumps_beside(self.up, self.down)
        return _error(self.up, rising), _error(self.down, falling)


class _Range(NamedTuple):
    """Inputs between which every threshold gives the same output; infinite beyond the inputs of the records."""

    lower: float
    upper: float

    @property
    def middle(self) -> float:
        """The threshold in the middle; the outermost input where one end is open."""
        ends = [end for end in self if np.isfinite(end)]
        return float(np.mean(ends))


class _Places(NamedTuple):
    """Where thresholds can lie: place p is between inputs p and p + 1 of `edges`, which rise from -inf to inf."""

    samples: _Samples
    edges: np.ndarray

    @classmethod
    def of(cls, samples: _Samples) -> _Places:
        """Between all inputs of the samples."""
        return cls(samples, np.concatenate([[-np.inf], np.unique(samples.u), [np.inf]]))

    def values(self, places: np.ndarray) -> np.ndarray:
        """A threshold at each place."""
        low, high = self.edges[places], self.edges[places + 1]
        return np.where(np.isinf(low), high, np.where(np.isinf(high), low, 0.5 * (low + high)))

    def best_pair(self, jumps: tuple[np.ndarray, np.ndarray]) -> tuple[_Range, _Range]:
        """The best pair of the thresholds in the middle of some jumps; one in the middle of both where all are in the wrong order."""
        shares = np.linspace(0.0, 1.0, _FIRST + 2)[1:-1]
        of = lambda ends: np.unique(np.quantile(ends.mean(axis=1), shares)) if len(ends) else self.edges[[1, -2]]
        up, down = (values.reshape(-1) for values in np.meshgrid(*map(of, jumps)))
        k = int(np.argmax(self.samples.explained(up, down)))
        up, down = (up[k], down[k]) if up[k] >= down[k] else (0.5 * (up[k] + down[k]),) * 2
        return _Range(up, up), _Range(down, down)

    def range_of(self, jumps: np.ndarray, *, up: float | None = None, down: float | None = None) -> _Range:
        """The range of the best values of one threshold beside the other, which is given.

        It is looked for between the outermost of the jumps, inputs before and after each, shape (N, 2), and the other threshold.
        """
        last, other = self.edges.size - 2, down if up is None else up
        reached = [jumps.min(), jumps.max(), other] if len(jumps) else self.edges[[1, -2]]
        ends = np.searchsorted(self.edges, [np.min(reached), np.max(reached)])
        low, high = np.clip([ends[0] - 1, ends[1] + 1], 0, last)
        of = lambda at, given: self.values(at) if given is None else np.full(at.size, given)
        explained = lambda at: self.samples.explained(of(at, up), of(at, down))
        equal = _EQUAL * float(self.samples.weight @ self.samples.y**2)
        first, final = _highest(explained, int(low), int(high), equal)
        found = _Range(float(self.edges[first]), float(self.edges[final + 1]))
        return found if np.isfinite(found).any() else _Range(float(self.edges[1]), float(self.edges[-2]))


def _highest(score: Callable[[np.ndarray], np.ndarray], low: int, high: int, equal: float) -> tuple[int, int]:
    """First and last of the places about the best between `low` and `high` whose scores are equal, by finer and finer steps."""
    between = lambda a, b: np.unique(np.linspace(a, b, _PLACES).astype(int))
    at, scores = np.zeros(0, int), np.zeros(0)
    more = between(low, high)
    while more.size:
        at, scores = np.append(at, more), np.append(scores, score(more))
        order = np.argsort(at)
        at, scores = at[order], scores[order]
        best = scores >= scores.max() - equal
        k = int(np.argmax(scores))
        apart = np.flatnonzero(~best)
        left, right = np.searchsorted(apart, k) - 1, np.searchsorted(apart, k)
        a = apart[left] if left >= 0 else -1
        b = apart[right] if right < apart.size else at.size
        gaps = [(at[j], at[j + 1]) for j in (a, b - 1) if 0 <= j < at.size - 1]
        more = np.setdiff1d(np.concatenate([np.zeros(0, int), *(between(*gap) for gap in gaps)]), at)
    return int(at[a + 1]), int(at[b - 1])


def _error(threshold: float, jumps: np.ndarray) -> float:
    """Standard error of a threshold by the inputs before and after jumps, shape (N, 2); NaN without jumps.

    The inputs at the jumps scatter normally about the threshold, by the noise of the sensor or of the device, and each lies between two
    samples. The scatter is unknown, with a flat prior (Gelman 2006). On 60 simulated thermostats with 4 to 40 jumps, of three sampling
    rates, without scatter and with one of up to a third of the half width, in the device or in the sensor, 96 to 100 % of the thresholds
    were within two standard errors; the scatter of the middles over their root number alone holds 5 to 97 %.
    """
    if not len(jumps):
        return np.nan
    ends = np.sort(jumps[np.linspace(0, len(jumps) - 1, min(len(jumps), _JUMPS)).astype(int)], axis=1)
    share = len(jumps) / len(ends)
    widest = 3 * max(float(np.std(ends.mean(axis=1))), float(np.mean(np.diff(ends, axis=1))))
    if not widest > 0:
        return 0.0
    scatters = np.geomspace(1e-3, 1.0, _GRID) * widest
    low, high = min(ends.min(), threshold), max(ends.max(), threshold)
    for _ in range(2):  # over the whole range, and where the threshold is likely
        at = np.linspace(low, high, 2 * _GRID)
        below, above = ((end[:, None, None] - at[:, None]) / scatters for end in ends.T)
        likelihood = share * np.log(ndtr(above) - ndtr(below) + 1e-300).sum(axis=0)
        density = (np.exp(likelihood - likelihood.max()) * scatters).sum(axis=1)
        density /= density.sum()
        mean = float(density @ at)
        spread = float(np.sqrt(density @ (at - mean) ** 2))
        low, high = max(low, mean - 6 * spread), min(high, mean + 6 * spread)
    return float(np.hypot(spread, mean - threshold))
