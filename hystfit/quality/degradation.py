"""What is left of stiffness and strength in later cycles: damage shows in branches, whatever the shape of the loop."""

from __future__ import annotations

import itertools

import numpy as np

from hystfit.quality.loops import APART, SAME_LEVEL, SEVERAL

LIKE_DURATION = 2.0  # factor between the durations of branches up to which their stiffness is compared
SMALL = 0.1  # of the largest stroke: shorter branches, and branches whose middles are further apart, are not compared
# Factor between the stiffness of a branch and that of the next one, by the median, above which something else than the stroke makes it.
_SCATTER = 1.25
_PROTOCOL = 0.1  # least part of the branches that are as long as all before in a test of growing strokes: in white noise 0.01 to 0.06
_LATE = 4  # late branches, whose median shows damage


def stiffness_left(
    u: np.ndarray, y: np.ndarray, t: np.ndarray | None, cycles: np.ndarray, noise: float = 0.0
) -> float | None:
    """Secant stiffness of late branches over that of the first branch of the same stroke.

    Every branch between two turning points has a stroke |du| and a secant stiffness |dy / du|. Branches longer than all
    before define the initial stiffness as a function of the stroke; later branches about the same middle are compared
    with it (a loop elsewhere in the range may be softer without damage). Shorter branches than all of those have nothing to be
    compared with: any hysteresis is softer at small strokes; nor have branches of another duration, as a lag reduces the stiffness of
    fast ones. Without damage the ratio is near 1 or above; where it scatters from branch to branch, as under white noise, it shows nothing.

    Args:
        u: input, shape (T,).
        y: output, shape (T,).
        t: time, shape (T,); None where there is none, so that samples are counted.
        cycles: see `loops.cycles`, shape (C, 3).
        noise: change of the input that noise may make.

    Returns:
        The median of the last four ratios; None with fewer.
    """
    turns = np.unique(cycles)
    turns = turns[np.isfinite(y[turns])]
    stroke, change = np.abs(np.diff(u[turns])), np.abs(np.diff(_reached(u, y, turns, noise)))
    middle = 0.5 * (u[turns][1:] + u[turns][:-1])
    farthest = np.maximum.accumulate(stroke)
    first = (stroke > 0) & np.concatenate([[True], stroke[1:] > (1 + SAME_LEVEL) * farthest[:-1]])
    if not first.any():
        return None
    known = stroke[first]
    repeated = ~first & (stroke > SMALL * farthest[-1]) & (stroke > (1 - SAME_LEVEL) * known.min())
    repeated &= np.abs(middle - np.interp(stroke, known, middle[first])) < SMALL * farthest[-1]
    lasted = np.diff(turns if t is None else t[turns])
    with np.errstate(divide="ignore", invalid="ignore"):
        slower = lasted / np.interp(stroke, known, lasted[first])
    repeated &= (slower > 1 / LIKE_DURATION) & (slower < LIKE_DURATION)
    before = np.interp(stroke[repeated], known, change[first] / known)
    if not (before > 0).all():
        return None
    left = change[repeated] / stroke[repeated] / before
    with np.errstate(divide="ignore", invalid="ignore"):
        scatter = np.abs(np.diff(np.log(left)))
    return None if scatter.size and np.median(scatter) > np.log(_SCATTER) else _of_the_last(left)


def _of_the_last(left: np.ndarray) -> float | None:
    """What is left by the median of the last four branches, or of the last tenth of many; None with fewer.

    Damage does not heal: of each branch counts the most that it or a later one has, which is whole again where the current of a damper
    was low for a while.
    """
    still = np.maximum.accumulate(left[::-1])[::-1]
    return float(np.median(still[-max(_LATE, left.size // 10) :])) if left.size >= _LATE else None


def _reached(u: np.ndarray, y: np.ndarray, turns: np.ndarray, noise: float) -> np.ndarray:
    """The outputs that the branches reach at their turning points, shape (turns,).

    Friction changes its sign within a sample, so that a sample taken just after the turning point has the output of the next branch: the
    largest output, in the direction of a branch, of its last samples is that which it reached.
    """
    known = np.isfinite(y)
    reached = y[turns].copy()
    if known.sum() < 2:
        return reached
    every = slice(None) if known.all() else known
    follows = (u[every] - u[every].mean()) @ y[every]
    for k, (a, b) in enumerate(itertools.pairwise([0, *turns])):
        apart = np.flatnonzero(np.abs(u[a : b + 1] - u[b]) > noise)
        # Two samples before a turning point: it may lie between samples, and the output may lead by one.
        near = y[max(a + 1, min(b - 2, a + int(apart[-1]) + 1 if apart.size else a)) : b + 1]
        near = near[np.isfinite(near)]
        if near.size:
            reached[k] = near.max() if follows * (u[b] - u[a]) > 0 else near.min()
    return reached


def _measured_branches(u: np.ndarray, y: np.ndarray, cycles: np.ndarray) -> tuple[list[tuple[int, int]], np.ndarray]:
    """First and last sample of the branches without missing outputs, and their strokes."""
    branches = [(a, b) for a, b in itertools.pairwise(np.unique(cycles)) if np.isfinite(y[a : b + 1]).all()]
    return branches, np.array([abs(u[b] - u[a]) for a, b in branches])


def strength_left(u: np.ndarray, y: np.ndarray, cycles: np.ndarray) -> float | None:
    """Range of the output over branches longer than all before, or over any after them, over its largest range on a shorter branch before.

    Hysteresis without damage covers on a longer branch what it covered on a shorter one (softening included: the peak lies inside
    the branch). Arguments as in `stiffness_left`.

    Returns:
        The median of the last four ratios; None with fewer.
    """
    branches, stroke = _measured_branches(u, y, cycles)
    reached = np.array([np.ptp(y[a : b + 1]) for a, b in branches])
    before, still = np.maximum.accumulate(reached)[:-1], np.maximum.accumulate(reached[::-1])[::-1]
    longer = (stroke[1:] > (1 + SAME_LEVEL) * np.maximum.accumulate(stroke)[:-1]) & (before > 0)
    left = still[1:][longer] / before[longer]
    return float(np.median(left[-_LATE:])) if left.size >= _LATE else None


def unloading_left(u: np.ndarray, y: np.ndarray, cycles: np.ndarray, noise: float = 0.0) -> float | None:
    """Slope just after reversals of late branches over that of the first ones, of branches as long as all before.

    Hysteresis without damage unloads with the stiffness that it had at first, however long the branches have become. Arguments as in
    `stiffness_left`.

    Returns:
        The median of the last four slopes over that of the first two; None with fewer than five such branches.
    """
    (branches, stroke), turns = _measured_branches(u, y, cycles), np.unique(cycles)
    if stroke.size <= _LATE:
        return None
    growing = (stroke > SMALL * stroke.max()) & (stroke > (1 - APART) * np.maximum.accumulate(stroke))
    if growing.mean() < _PROTOCOL:
        return None
    reach = stroke[growing].min() / 4
    reached = dict(zip(turns, _reached(u, y, turns, noise), strict=True))
    slopes = []
    for a, b in itertools.compress(branches, growing):
        near = slice(a, a + int(np.argmax(np.abs(u[a : b + 1] - u[a]) > reach)) + 1)
        if near.stop - a < SEVERAL + 1:
            return None
        end = slice(near.stop - max(1, (near.stop - a) // 4), near.stop)
        slopes.append(float((y[end].mean() - reached[a]) / (u[end].mean() - u[a])))
    first = float(np.median(slopes[:2]))
    return float(np.median(slopes[-_LATE:])) / first if len(slopes) > _LATE and first > 0 else None
