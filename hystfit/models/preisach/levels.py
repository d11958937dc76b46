"""Where to put the thresholds of a Preisach model: by the inputs that were measured, or where the output changes most."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from hystfit.data.record import Record
from hystfit.errors import DataError, ModelError
from hystfit.quality.reversal_curves import ReversalFamily

Spacing = Literal["quantile", "square", "uniform", "steep", "reversal-curves", "given"]


def choose_levels(
    inputs: Sequence[np.ndarray],
    levels: np.ndarray,
    center: float | None,
    *,
    spacing: Spacing,
    symmetric: bool,
    margin: bool,
) -> tuple[np.ndarray, float]:
    """Levels over the range of measured inputs, as many as are given, strictly rising, and the center.

    A spacing of "quantile" gives equal shares of the samples, "square" distances from the center that grow as squares, "uniform" equal
    ones, and "given" the present levels. With `symmetric`, they are even about the center (None: the middle of the range), by quantiles of
    the distance from it. With a margin, the outermost levels are half a spacing inside the range (relays), not on its edge (cells).
    """
    u = np.concatenate(list(inputs))
    low, high = float(u.min()), float(u.max())
    if low == high:
        raise DataError(f"the input is constant ({low:g}): it gives no range for thresholds")
    center = 0.5 * (low + high) if center is None else center
    if spacing == "given":
        return levels, center
    n = levels.size
    share = (np.arange(n) + 0.5) / n if margin else np.linspace(0, 1, n)
    if symmetric:
        half = max(high - center, center - low)
        upper = np.abs(2 * share[n // 2 :] - 1)
        distance = np.abs(u - center)
        even = {"uniform": half * upper, "square": half * upper**2}
        spread = even[spacing] if spacing in even else np.quantile(np.append(distance, [0.0, half]), upper)
        right = _rising(spread, half, anchored=n % 2 == 1)
        left = -right[::-1]
        return center + np.concatenate([left[: n // 2], right]), center
    if spacing == "square":
        side = 2 * share - 1
        values = center + np.where(side < 0, center - low, high - center) * side * np.abs(side)
    else:
        values = low + (high - low) * share if spacing == "uniform" else np.quantile(u, share)
    return _rising(values, high - low), center


def steep_levels(records: Sequence[Record], n: int, center: float | None, *, relays: bool) -> tuple[np.ndarray, float]:
    """Levels over the range of measured inputs, denser where the rising or the falling branches are steep, and the center.

    Args:
        center: about which the levels are symmetric; None spreads them over the range, whose middle is the center.
        relays: n levels in the middle of intervals; else n + 1 edges of cells.
    """
    low, high = min(float(r.u.min()) for r in records), max(float(r.u.max()) for r in records)
    if low == high:
        raise DataError(f"the input is constant ({low:g}): it gives no range for thresholds")
    axis = np.linspace(low, high, 401)
    branches = [part for sign in (1, -1) if (part := _slopes(records, axis, sign))[0].size]
    branches = branches or [(np.zeros(0), np.zeros(0))]  # no slope that the samples show: levels at even distances
    if center is not None:
        half = max(high - center, center - low)
        low, high = center - half, center + half
        branches = [(np.append(u, 2 * center - u), np.append(slope, slope)) for u, slope in branches]
    edges = sharp_levels([(np.append(u, [low, high]), np.append(s, [0.0, 0.0])) for u, s in branches], n, power=0.75)
    if center is not None:
        edges = 0.5 * (edges + 2 * center - edges[::-1])
    return 0.5 * (edges[1:] + edges[:-1]) if relays else edges, 0.5 * (low + high)


def _slopes(records: Sequence[Record], axis: np.ndarray, sign: int) -> tuple[np.ndarray, np.ndarray]:
    """Middles of the bins that rising (sign 1) or falling branches cross, and the mean slope dy/du in each."""
    run, rise = np.zeros((2, axis.size - 1))
    for record in records:
        kept = np.flatnonzero(np.isfinite(record.y))
        u, y = record.u[kept], record.y[kept]
        moves = sign * np.diff(u) > 0
        middle = 0.5 * (u[1:] + u[:-1])[moves]
        run += np.histogram(middle, axis, weights=np.diff(u)[moves])[0]
        rise += np.histogram(middle, axis, weights=np.diff(y)[moves])[0]
    crossed = run != 0
    return 0.5 * (axis[1:] + axis[:-1])[crossed], rise[crossed] / run[crossed]


def levels_of_family(family: ReversalFamily, n: int, *, relays: bool) -> np.ndarray:
    """Levels for reversal curves, denser where the output is steep on them or on the branch that their reversal points are samples of.

    Args:
        relays: n levels in the middle of intervals with equal shares of the output; else n + 1 edges of cells.
    """
    # No curve shows the branch on which the field left saturation.
    start = np.array([(r.u[0], r.y[0]) for r in family.curves])
    left = 0.5 * (start[1:, 0] + start[:-1, 0]), _quotient(np.diff(start[:, 1]), np.diff(start[:, 0]))
    back = (
        np.concatenate([r.u for r in family.curves]),
        np.concatenate([_quotient(np.gradient(r.y), np.gradient(r.u)) for r in family.curves]),
    )
    if not relays:
        return sharp_levels([back, left], n)
    edges = sharp_levels([back, left], n, power=1.0, even=0.05)
    return 0.5 * (edges[1:] + edges[:-1])


def _quotient(rise: np.ndarray, run: np.ndarray) -> np.ndarray:
    return rise / np.where(run == 0, np.inf, run)


def sharp_levels(
    branches: Sequence[tuple[np.ndarray, np.ndarray]], n: int, *, power: float = 0.5, even: float = 0.2
) -> np.ndarray:
    """n + 1 levels denser where the output is steep: equal shares of the mean |dy/du|^power on each kind of branch, and an even part.

    With power 1 each interval has the same share of the output, so that point relays make steps of one height; cells follow straight lines
    between levels, and need fewer of them where the output is steep but straight. All kinds of branches, (inputs, slopes), count the same;
    `even` is the size of the even part relative to the mean of the other.
    """
    low, high = min(u.min() for u, _ in branches), max(u.max() for u, _ in branches)
    axis = np.linspace(low, high, 50 * n + 1)
    middle, density = 0.5 * (axis[1:] + axis[:-1]), np.zeros(50 * n)
    for u, slope in branches:
        count, _ = np.histogram(u, axis)
        total, _ = np.histogram(u, axis, weights=np.abs(slope) ** power)
        seen = count > 0
        part = np.interp(middle, middle[seen], total[seen] / count[seen], left=0.0, right=0.0)
        density += part / (part.mean() or 1.0)
    grown = np.append(0.0, np.cumsum(density + even * density.mean() + 1e-12))
    return np.interp(np.linspace(0, grown[-1], n + 1), grown, axis)


def check_levels(levels: np.ndarray, center: float | None, symmetric: bool) -> None:
    """Refuse levels that do not rise, or that are not symmetric where they should be."""
    if not np.isfinite(levels).all() or (np.diff(levels) <= 0).any():
        raise ModelError(f"levels must be finite and rise strictly, got {np.array2string(levels, threshold=8)}")
    if symmetric and center is not None:
        gap = np.abs(levels + levels[::-1] - 2 * center).max()
        if gap > 1e-9 * (np.ptp(levels) + abs(center)):
            raise ModelError(
                f"levels of a symmetric model must be symmetric about its center {center:g}; they miss by {gap:g}"
            )


def _rising(levels: np.ndarray, span: float, anchored: bool = False) -> np.ndarray:
    """The same levels, moved apart where quantiles coincide: by at least a thousandth of an even spacing."""
    if anchored:
        levels = levels - levels[0]
    least = 1e-3 * span / levels.size
    out = np.maximum.accumulate(levels - least * np.arange(levels.size)) + least * np.arange(levels.size)
    # Shifts pile up at the upper end: bring the last level back to where it was.
    return out[0] + (out - out[0]) * ((levels[-1] - levels[0]) / (out[-1] - out[0])) if out.size > 1 else out
