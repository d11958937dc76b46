"""Drift of a repeated loop: change of its mean from cycle to cycle, linear or logarithmic in time."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.outcome.table import ROUNDED
from hystfit.quality.faults import CLEAR, SIGNIFICANCE
from hystfit.quality.loops import SAME_LEVEL


@dataclasses.dataclass(frozen=True)
class Drift:
    """Drift of the mean output of similar cycles.

    Attributes:
        cycles: number of cycles compared: those between the turning levels that occur most often.
        per_cycle: slope of the straight line through the cycle means [unit of y per cycle].
        r2_linear: share of the variance of the means that this line explains.
        per_decade: slope against log10 of the time since the record began [unit of y per decade]; None without time.
        r2_log: share of the variance that it explains.
        law: "linear", "logarithmic" or "none" (neither explains half of the variance, or chance may explain it, or the drift is
            within the noise or rounding errors).
        skipped: cycles omitted at the start, as a transient, in both fits.
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


def like_cycles(u: np.ndarray, cycles: np.ndarray, y: np.ndarray | None = None) -> np.ndarray:
    """The cycles between the pair of turning levels that occurs most often.

    Args:
        u: input, shape (T,).
        cycles: see `loops.cycles`, shape (C, 3).
        y: output, shape (T,); cycles with missing values are omitted.

    Returns:
        Rows of `cycles`, shape (K, 3); among equally frequent pairs, those of the largest stroke.
    """
    if len(cycles) == 0:
        return cycles
    ends, span = np.sort(u[cycles[:, :2]], axis=1), np.ptp(u)
    near = np.max(np.abs(ends[:, None] - ends[None]), axis=2) <= SAME_LEVEL * span
    score = near.sum(axis=1) + 0.5 * (ends[:, 1] - ends[:, 0]) / span
    like = cycles[near[int(np.argmax(score))]]
    if y is None:
        return like
    return like[np.array([np.isfinite(y[start : stop + 1]).all() for start, _, stop in like], dtype=bool)]


def drift(u: np.ndarray, y: np.ndarray, t: np.ndarray | None, cycles: np.ndarray, noise: float = 0.0) -> Drift | None:
    """Drift of the cycle mean.

    Args:
        u: input, shape (T,).
        y: output, shape (T,); cycles with missing values are omitted.
        t: time, shape (T,), or None.
        cycles: see `loops.cycles`, shape (C, 3).
        noise: rms of white noise in the output [unit of y]; a drift that it explains has no law.

    Returns:
        None with fewer than four similar cycles.
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
    samples = float(np.median(cycles[:, 2] - cycles[:, 0]))
    least = max(ROUNDED * float(np.nanmax(y) - np.nanmin(y)), CLEAR * noise / np.sqrt(samples))
    best, minus_skip, linear, log = max(fits)
    skip = -minus_skip
    law, total = "none", 0.0
    if best >= 0.5 and _probability(best, len(means) - skip) < SIGNIFICANCE:
        law, total = "linear", linear[0] * (number[-1] - skip)
        if log is not None and moment is not None and log[1] > linear[1]:
            law, total = "logarithmic", log[0] * np.log10(moment[-1] / moment[skip])
        if abs(total) < least:
            law, total = "none", 0.0
    slope, r2 = log or (None, None)
    return Drift(len(means), *linear, slope, r2, law, skip, float(total))


def cycle_means(
    u: np.ndarray, y: np.ndarray, t: np.ndarray | None, cycles: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """Mean output of similar cycles, and the middle of each in time; arguments as in `drift`.

    Returns:
        Means [unit of y] and times since the record began [unit of t], shapes (K,); the times are None where there are
        none or they do not increase.
    """
    like = [(int(start), int(stop)) for start, _, stop in like_cycles(u, cycles, y)]
    means = np.array([_mean(y, t, start, stop) for start, stop in like])
    moment = None if t is None or not like else np.array([0.5 * (t[a] + t[c]) - t[0] for a, c in like])
    if moment is not None and not (moment[0] > 0 and (np.diff(moment) > 0).all()):
        moment = None
    return means, moment


def _mean(y: np.ndarray, t: np.ndarray | None, start: int, stop: int) -> float:
    """Mean over one cycle, weighted by time where there is time."""
    if t is None or t[stop] == t[start]:
        return float(np.mean(y[start:stop]))
    part = slice(start, stop + 1)
    return float(np.trapezoid(y[part], t[part]) / (t[stop] - t[start]))


def _probability(explained: float, count: int) -> float:
    """Probability that a line explains this share of the variance of a number of independent values by chance."""
    from scipy.special import betainc

    return float(betainc(0.5 * (count - 2), 0.5, max(1 - explained, 0.0)))


def _line(x: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Slope of the straight line through the values, and the share of their variance that it explains."""
    slope, offset = np.polyfit(x, values, 1)
    total = np.sum((values - values.mean()) ** 2)
    return float(slope), float(1 - np.sum((values - slope * x - offset) ** 2) / total) if total > 0 else 0.0
