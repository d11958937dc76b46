"""Drift of a repeated loop: how its mean moves from cycle to cycle, evenly or with the logarithm of time."""

from __future__ import annotations

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class Drift:
    """How the mean output of like cycles moves.

    Attributes:
        cycles: number of cycles compared: those between the turning levels that occur most often.
        per_cycle: slope of the straight line through the cycle means [unit of y per cycle].
        r2_linear: share of the variance of the means that this line explains.
        per_decade: slope against log10 of the time since the record began [unit of y per decade]; None without time.
        r2_log: share of the variance that it explains.
        law: "linear", "logarithmic" or "none" (neither explains half of the variance,
            nine tenths where there are fewer than eight cycles).
        skipped: cycles left out at the start, as a transient, in both fits.
        total: change of the fitted law over the cycles compared [unit of y].
    """

    cycles: int
    per_cycle: float
    r2_linear: float
    per_decade: float | None
    r2_log: float | None
    law: str
    skipped: int
    total: float


def like_cycles(u: np.ndarray, cycles: np.ndarray, tolerance: float = 0.03) -> np.ndarray:
    """The cycles (rows of `loops.cycles`) whose turning levels agree with the most frequent pair, shape (K, 3).

    `tolerance` is a fraction of the input's range; among equally frequent pairs the one of the largest stroke counts.
    """
    if len(cycles) == 0:
        return cycles
    ends, span = np.sort(u[cycles[:, :2]], axis=1), np.ptp(u)
    near = np.max(np.abs(ends[:, None] - ends[None]), axis=2) <= tolerance * span
    stroke = ends[:, 1] - ends[:, 0]
    score = near.sum(axis=1) + 0.5 * stroke / span
    return cycles[near[int(np.argmax(score))]]


def _line(x: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    slope, offset = np.polyfit(x, values, 1)
    left = values - slope * x - offset
    total = np.sum((values - values.mean()) ** 2)
    return float(slope), float(1 - np.sum(left**2) / total) if total > 0 else 0.0


def drift(u: np.ndarray, y: np.ndarray, t: np.ndarray | None, cycles: np.ndarray) -> Drift | None:
    """Drift of the cycle mean; None with fewer than four like cycles of full output.

    Args:
        u: input, shape (T,).
        y: output, shape (T,); it may hold NaN (such cycles are passed over).
        t: time, shape (T,), or None.
        cycles: see `loops.cycles`, shape (C, 3).
    """
    means, moment = cycle_means(u, y, t, cycles)
    if len(means) < 4:
        return None
    if np.ptp(means) == 0:
        return Drift(len(means), 0.0, 0.0, None, None, "none", 0, 0.0)
    number = np.arange(len(means), dtype=float)
    fits = []
    for skip in range(min(4, len(means) - 4) + 1):
        linear = _line(number[skip:], means[skip:])
        log = None if moment is None else _line(np.log10(moment[skip:]), means[skip:])
        fits.append((max(linear[1], log[1] if log else 0.0), -skip, linear, log))
    _, minus_skip, linear, log = max(fits)
    best = max(linear[1], log[1] if log else 0.0)
    law = (
        "none"
        if best < (0.5 if len(means) + minus_skip >= 8 else 0.9)
        else "logarithmic"
        if log and log[1] > linear[1]
        else "linear"
    )
    skip = -minus_skip
    if law == "logarithmic" and log is not None and moment is not None:
        total = log[0] * np.log10(moment[-1] / moment[skip])
    else:
        total = linear[0] * (number[-1] - skip) if law == "linear" else 0.0
    return Drift(
        cycles=len(means),
        per_cycle=linear[0],
        r2_linear=linear[1],
        per_decade=log[0] if log else None,
        r2_log=log[1] if log else None,
        law=law,
        skipped=skip,
        total=float(total),
    )


def cycle_means(
    u: np.ndarray, y: np.ndarray, t: np.ndarray | None, cycles: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """Mean output of like cycles of full output, and the middle of each after the record began, shapes (K,); see `drift`.

    The times are None where there are none or they do not rise.
    """
    like = [(int(a), int(c)) for a, _, c in like_cycles(u, cycles) if np.isfinite(y[a : c + 1]).all()]
    means = np.array([_mean(y, t, a, c) for a, c in like])
    moment = None if t is None or not like else np.array([0.5 * (t[a] + t[c]) - t[0] for a, c in like])
    if moment is not None and not (moment[0] > 0 and (np.diff(moment) > 0).all()):
        moment = None
    return means, moment


def _mean(y: np.ndarray, t: np.ndarray | None, start: int, stop: int) -> float:
    """Mean over one cycle: over time where there is time, over samples where there is none."""
    if t is None or t[stop] == t[start]:
        return float(np.mean(y[start:stop]))
    part = slice(start, stop + 1)
    return float(np.trapezoid(y[part], t[part]) / (t[stop] - t[start]))
