"""Shape of the loop: width, circulation, closure, asymmetry, pinching, rate dependence."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from hystfit.data.circulation import RESOLVED, SLACK
from hystfit.quality.degradation import LIKE_DURATION, SMALL
from hystfit.quality.drift import like_cycles
from hystfit.quality.faults import CLEAR
from hystfit.quality.loops import APART, SAME_LEVEL, SEVERAL, Loop, closed_loops, loop_area, loop_branches

# Least area of an open loop over that of the box around it, where a straight line is taken from the output (a film on a diamagnetic
# substrate): the narrowest loops of piezo actuators have ten thousandths of the box around all.
NARROWEST = 1e-3
_PINCHED = 0.6  # width in the middle of the input over the largest width, below which a loop is pinched
_CROSSING = 0.3  # net area over that between the branches below which these cross


@dataclasses.dataclass(frozen=True)
class Shape:
    """Shape of the largest loops.

    Attributes:
        area: mean signed area of the largest loops [unit of u times unit of y], positive counter-clockwise.
        fullness_percent: its magnitude over the area of the loop's bounding box.
        width: largest vertical distance between the branches [unit of y].
        width_percent: the same in percent of the output's stroke.
        circulation: "counter-clockwise", "clockwise" or None where the loop is not open.
        closure_percent: output at the end of the last large closed loop minus that at its start, in percent of its
            stroke; None where no large loop closes.
        asymmetry_percent: rms deviation from point symmetry about the loop's middle, in percent of the stroke.
        pinching: width at the middle of the input over the largest width (1: as wide as anywhere), the median over
            the later of the large cycles.
        crossing: the branches cross, and the lobes circulate in opposite directions (a butterfly).
        loops: number of loops averaged.
    """

    area: float
    fullness_percent: float
    width: float
    width_percent: float
    circulation: str | None
    closure_percent: float | None
    asymmetry_percent: float
    pinching: float
    crossing: bool
    loops: int

    @property
    def pinched(self) -> bool:
        """Whether the middle of the loop is clearly narrower than its widest part."""
        return self.pinching < _PINCHED


def loop_shape(u: np.ndarray, y: np.ndarray, loops: list[Loop], cycles: np.ndarray, noise: float = 0.0) -> Shape | None:
    """Shape of the largest loops of a record: of its closed loops, of its widest cycles where none closes.

    Args:
        u: input, shape (T,).
        y: output, shape (T,); loops with missing outputs are omitted.
        loops: see `loops.closed_loops`.
        cycles: see `loops.cycles`.
        noise: rms of white noise in the output [unit of y]; a loop whose area may be noise is not open.

    Returns:
        None where there is no loop of at least three samples on each branch.
    """
    begun = None if len(cycles) else _from_its_end(u, y)
    if begun is not None:
        shape = loop_shape(*begun, closed_loops(begun[0], SAME_LEVEL * float(np.ptp(u))), cycles, noise)
        gap = None if _returns(y) else _closure(u, y, 0, u.size - 1)
        return shape if shape is None or gap is None else dataclasses.replace(shape, closure_percent=gap)
    spans, closed = _spans(u, loops, cycles)
    usable = [span for span in spans if _is_loop(u, y, *span[:2])]
    if not usable:
        return None
    largest = max(stroke for _, _, stroke in usable)
    chosen = [(start, stop) for start, stop, stroke in usable if stroke >= (1 - APART) * largest][-20:]
    typical = np.median([_Measures.of(u[a : b + 1], y[a : b + 1]) for a, b in chosen], axis=0)
    area, stroke, width, asymmetry, _, bent, apart = _Measures(*typical)
    if stroke == 0:
        return None
    fullness = 100 * abs(area) / (stroke * largest)
    chance = noise * np.sqrt(np.mean([np.sum(np.diff(u[a : b + 1]) ** 2) for a, b in chosen]) / len(chosen))
    between = float(np.median([area_between(u[a : b + 1], y[a : b + 1]) for a, b in chosen]))
    crossing = bool(has_lobes(area, between, stroke * largest, noise * largest))
    floor = NARROWEST**2 * stroke
    resolved = abs(area) > floor * largest and noise > 0 and _is_resolved(u, y, chosen, float(area))
    least = floor if resolved else NARROWEST * max(bent, NARROWEST * stroke)
    # By area, and by the samples: with a last point far in saturation the box around the loop is nearly empty.
    by_chance = 2 * noise / np.sqrt(sum(b - a for a, b in chosen))
    is_open = abs(area) > max(CLEAR * chance, least * largest) or apart > max(CLEAR * by_chance, least)
    turning = ("counter-clockwise" if area > 0 else "clockwise") if is_open and not crossing else None
    if turning is None and not crossing and not closed and loops and len(cycles):
        first = max(loops, key=lambda loop: loop.stroke)
        part = slice(first.start, first.stop + 1)
        shape = loop_shape(u[part], y[part], closed_loops(u[part]), cycles[:0], noise)
        if shape is not None and shape.circulation is not None:
            return dataclasses.replace(shape, closure_percent=None)
    return Shape(
        area=float(area),
        fullness_percent=float(fullness),
        width=float(width),
        width_percent=float(100 * width / stroke),
        circulation=turning,
        closure_percent=_closure(u, y, *chosen[-1]) if closed else None,
        asymmetry_percent=float(100 * asymmetry / stroke),
        pinching=_late_pinching(u, y, cycles, usable),
        crossing=crossing,
        loops=len(chosen),
    )


def _is_resolved(u: np.ndarray, y: np.ndarray, chosen: list[tuple[int, int]], area: float) -> bool:
    """Whether loops have nearly the same area where every second sample is left out."""
    halves = [slice(a, b + 1, 2) for a, b in chosen if _is_loop(u[::2], y[::2], (a + 1) // 2, b // 2)]
    rest = float(np.median([_Measures.of(u[half], y[half])[0] for half in halves])) if halves else 0.0
    return abs(rest - area) < RESOLVED * abs(area)


def _spans(u: np.ndarray, loops: list[Loop], cycles: np.ndarray) -> tuple[list[tuple[int, int, float]], bool]:
    """First and last sample and stroke of the closed loops, or of the cycles where no loop covers half the range; and which."""
    every = [(loop.start, loop.stop, loop.stroke) for loop in loops]
    # A loop that begins with the record begins on the curve of first loading, which it does not meet again.
    returning = [span for span in every if span[0] > 0]
    parts = [_both_ways(u, *cycle) for cycle in cycles.tolist()]
    between = [(start, stop, float(np.ptp(u[start : stop + 1]))) for start, stop in parts]
    for spans, closed in ((returning, True), (between, False), (every, True)):
        if max((stroke for _, _, stroke in spans), default=0.0) > 0.5 * np.ptp(u):
            return spans, closed
    return between, False


def _both_ways(u: np.ndarray, start: int, turn: int, stop: int) -> tuple[int, int]:
    """First and last sample of the part of a cycle that has both branches: that of cycles that grow ends at the level it began at."""
    x = u if u[turn] < u[start] else -u
    level = min(x[start], x[stop])
    begun, ended = np.flatnonzero(x[start : turn + 1] >= level), np.flatnonzero(x[turn : stop + 1] >= level)
    return start + int(begun[-1]), turn + int(ended[0])


def _is_loop(u: np.ndarray, y: np.ndarray, start: int, stop: int) -> bool:
    """Whether a stretch has samples enough on both branches, all of them measured."""
    u, y = u[start : stop + 1], y[start : stop + 1]
    return bool(np.isfinite(y).all()) and SEVERAL <= _turn(u) < u.size - SEVERAL


def _late_pinching(u: np.ndarray, y: np.ndarray, cycles: np.ndarray, spans: list[tuple[int, int, float]]) -> float:
    """Median pinching of the later half of the large cycles that return; of the large spans where none does."""
    largest = max(stroke for _, _, stroke in spans)
    returning = [
        (a, c)
        for a, b, c in cycles.tolist()
        if abs(u[b] - u[a]) > 0.5 * largest and abs(u[c] - u[a]) < SMALL * np.ptp(u[a : c + 1]) and _is_loop(u, y, a, c)
    ]
    late = returning[-max(3, len(returning) // 2) :] or [(a, b) for a, b, stroke in spans if stroke >= 0.5 * largest]
    return float(np.median([_Measures.of(u[a : b + 1], y[a : b + 1]).pinching for a, b in late]))


def has_lobes(area: Any, between: Any, box: Any, noise: Any = 0.0) -> Any:
    """Whether branches cross, so that lobes of a loop (a butterfly) run in opposite directions.

    The branches are apart by more than slack, and by more than twice the mean distance of two noisy samples, 2 / sqrt(pi) of their noise.

    Args:
        between: of the branches, whichever is above.
        noise: of the output times the range of the input.
    """
    return (abs(area) < _CROSSING * between) & (between > np.maximum(SLACK * box, 4 / np.sqrt(np.pi) * noise))


def area_between(u: np.ndarray, y: np.ndarray) -> float:
    """Area between the branches of one loop, whichever is above [unit of u times unit of y]."""
    outer = outline(u)
    centers, rising, falling = loop_branches(u[outer], y[outer])
    return float(np.sum(np.abs(rising - falling) * np.gradient(centers)))


def _turn(u: np.ndarray) -> int:
    """The turning point inside one loop that begins at another."""
    return int(np.argmin(u) if u[0] > 0.5 * (u.min() + u.max()) else np.argmax(u))


def _from_its_end(u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """One cycle of the input that begins and ends in its middle, from its lowest input on; None for other records."""
    lowest = int(np.argmin(u))
    if not (SEVERAL <= lowest < u.size - SEVERAL and _returns(u)):
        return None
    turned = lambda values: np.concatenate([values[lowest:], values[: lowest + 1]])
    return turned(u), turned(y)


def _returns(values: np.ndarray) -> bool:
    """Whether a signal ends where it began, or a step and a half before: cycles of a testing machine end before they would begin again."""
    step = 0.75 * (abs(values[1] - values[0]) + abs(values[-1] - values[-2]))
    return bool(abs(values[-1] - values[0]) <= max(SAME_LEVEL * float(np.ptp(values)), step))


class _Measures(NamedTuple):
    """Of one loop.

    Attributes:
        area, stroke, width, asymmetry, pinching: see `Shape`, in the units of u and y.
        bent: stroke of y without a straight line.
        apart: mean distance of the branches.
    """

    area: float
    stroke: float
    width: float
    asymmetry: float
    pinching: float
    bent: float
    apart: float

    @classmethod
    def of(cls, u: np.ndarray, y: np.ndarray) -> _Measures:
        """Those of the loop of an input and an output, each of shape (T,)."""
        outer = outline(u)
        u, y = u[outer], y[outer]
        centers, rising, falling = loop_branches(u, y)
        gap = np.abs(rising - falling)
        mirrored = rising + falling[::-1]
        middle = np.abs(centers - 0.5 * (u.min() + u.max())) <= SAME_LEVEL * np.ptp(u)
        pinching = float(np.mean(gap[middle]) / gap.max()) if middle.any() and gap.max() > 0 else 1.0
        line = np.polyval(np.polyfit(centers, 0.5 * (rising + falling), 1, w=np.sqrt(np.gradient(centers))), u)
        return cls(
            area=loop_area(u, y),
            stroke=float(np.ptp(y)),
            width=float(gap.max()),
            asymmetry=float(0.5 * np.std(mirrored)),
            pinching=pinching,
            bent=float(np.ptp(y - line)),
            apart=abs(float(np.mean(rising - falling))),
        )


def outline(u: np.ndarray) -> np.ndarray:
    """Samples of a loop without the minor loops inside it: those that reach further than all before, shape (K,).

    The loop begins at one end of its range, goes to the other and comes back.
    """
    u = np.asarray(u, dtype=float)
    x = u if u[0] < 0.5 * (u.min() + u.max()) else -u
    turn = int(np.argmax(x))
    best = np.concatenate([np.maximum.accumulate(x[: turn + 1]), np.minimum.accumulate(x[turn:])[1:]])
    return np.flatnonzero(x == best)


def _closure(u: np.ndarray, y: np.ndarray, start: int, stop: int) -> float | None:
    """Output where the input is back minus that at the start, in percent, along the slope of the last 2 % of u.

    None where the output is constant.
    """
    if (largest := np.ptp(y[start : stop + 1])) == 0:
        return None
    near = 0.02 * np.ptp(u[start : stop + 1])
    far = np.flatnonzero(np.abs(u[start:stop] - u[stop]) > near)
    back = start + int(far[-1]) if far.size else stop - 1
    slope = (y[stop] - y[back]) / (u[stop] - u[back]) if u[stop] != u[back] else 0.0
    end = y[stop] + slope * (u[start] - u[stop])
    return float(100 * (end - y[start]) / largest)


def rate_effect(u: np.ndarray, y: np.ndarray, t: np.ndarray | None, cycles: np.ndarray) -> float | None:
    """Change of the loop's area from the slow to the fast ones of similar cycles, as a fraction of the mean area.

    None without time, or where the durations of similar cycles differ by less than a factor of 2: rate dependence is not
    visible at one frequency. Arguments as in `loop_shape`.
    """
    if t is None or np.ptp(u) == 0:
        return None
    like = [(a, c) for a, _, c in like_cycles(u, cycles, y) if t[c] > t[a]]
    if len(like) < 2:
        return None
    durations = np.array([t[c] - t[a] for a, c in like])
    if durations.max() < LIKE_DURATION * durations.min():
        return None
    areas = np.array([loop_area(u[a : c + 1], y[a : c + 1]) for a, c in like])
    is_slow = durations > np.sqrt(durations.min() * durations.max())
    slow, fast = areas[is_slow].mean(), areas[~is_slow].mean()
    return float((abs(fast) - abs(slow)) / np.mean(np.abs(areas))) if np.any(areas) else None
