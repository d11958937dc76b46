"""What the Preisach model presumes of a device, measured on its records: wiping-out, congruency, and errors at higher-order reversals."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from hystfit.data.circulation import SLACK
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.models.preisach.model import Preisach
from hystfit.models.preisach.staircase import compile_input
from hystfit.quality.loops import clear_reversals

# Extrema of the test signals of Song et al. 2005 (their Figs. 7 to 15), in volts; the last is one of our choice.
WIPING_OUT = ((0.0, 150.0, 100.0, 180.0, 120.0), (0.0, 180.0, 120.0))
CONGRUENCY = (0.0, 120.0, 80.0, 120.0, 80.0, 180.0, 80.0, 120.0, 80.0, 120.0, 80.0)
HIGHER_ORDER = (0.0, 180.0, 60.0, 150.0, 90.0, 120.0, 0.0)


def through(extrema: Sequence[float | int], points: int = 100) -> np.ndarray:
    """Straight runs from extremum to extremum, this many samples each, shape (runs * points + 1,)."""
    if len(extrema) < 2 or points < 1:
        raise DataError(f"a signal needs two extrema and one sample per run, got {len(extrema)} and {points}")
    runs = [np.linspace(a, b, points + 1)[1:] for a, b in itertools.pairwise(extrema)]
    return np.concatenate([[extrema[0]], *runs])


@dataclasses.dataclass(frozen=True)
class Closures:
    """How well loops close: the output when the input comes back to an extremum, minus the output at the extremum."""

    at: np.ndarray  # inputs at which loops closed, shape (K,)
    width: np.ndarray  # how far each loop went, in units of the input, shape (K,)
    gap: np.ndarray  # differences of the outputs there, shape (K,)
    span: float  # the output's range
    # root mean square and largest gap, in percent of the output's range; None without any closure
    percent: tuple[float, float] | None


def wiping_out(record: Record) -> Closures:
    """Return-point memory: every time the input passes an earlier dominant extremum, the output should pass its value there.

    Args:
        record: measured; reversals smaller than `SAME_LEVEL` do not count.
    """
    u, y = record.u, record.y
    corners = _corners(u)
    at, width, gap = [], [], []
    stack: list[int] = []
    for before, now in itertools.pairwise(corners):
        stack.append(int(before))
        sign = 1.0 if u[now] > u[before] else -1.0
        # stack[-1] is the start of this run, stack[-2] the extremum that closes the loop when it is passed.
        while len(stack) > 2 and sign * (u[now] - u[stack[-2]]) >= 0:
            where = stack[-2]
            run = np.arange(before, now + 1)
            back = float(_crossing(u[run], y[run], float(u[where]), sign))
            if np.isfinite(back) and np.isfinite(y[where]):
                at.append(float(u[where]))
                width.append(abs(float(u[stack[-1]] - u[where])))
                gap.append(back - float(y[where]))
            del stack[-2:]
    gaps = np.array(gap)
    span = float(np.nanmax(y) - np.nanmin(y)) or 1.0
    percent = (
        (100 * float(np.sqrt(np.mean(gaps**2))) / span, 100 * float(np.abs(gaps).max()) / span) if gaps.size else None
    )
    return Closures(np.array(at), np.array(width), gaps, span, percent)


def _crossing(u: np.ndarray, y: np.ndarray, level: float, sign: float) -> float:
    """Output where a run first reaches a level."""
    k = int(np.argmax(sign * (u - level) >= 0))
    if k == 0 or u[k] == u[k - 1]:
        return float(y[k])
    part = (level - u[k - 1]) / (u[k] - u[k - 1])
    return float(y[k - 1] + part * (y[k] - y[k - 1]))


def _corners(u: np.ndarray) -> np.ndarray:
    """First sample, reversals larger than the noise, last sample."""
    return np.unique(np.concatenate([[0], clear_reversals(u), [u.size - 1]]))


@dataclasses.dataclass(frozen=True)
class Congruency:
    """Minor loops between the same two inputs after different histories, which a Preisach model makes congruent."""

    low: float  # low, high: the two inputs
    high: float
    branches: int  # how many branches were compared
    # largest difference of branches shifted onto each other, in percent of the output's travel along them
    percent_of_loop: float
    percent_of_range: float  # the same in percent of the record's range


def congruency(record: Record) -> list[Congruency]:
    """Compare all branches that run between the same two inputs in the same direction, and wipe out nothing on their way.

    Args:
        record: measured; reversals smaller than `SAME_LEVEL` do not count.

    Returns:
        One comparison per pair of inputs and direction that occurs more than once, widest first. Branches that follow
        the same history twice agree for any memory: their differences are repeatability.
    """
    u, y = record.u, record.y
    span, reach = float(np.nanmax(y) - np.nanmin(y)) or 1.0, SLACK * float(np.ptp(u))
    corners = _corners(u)
    groups: dict[int, list[np.ndarray]] = {}
    ends: dict[int, tuple[float, float]] = {}
    part = np.linspace(0.0, 1.0, 101)
    for a, b in _undisturbed(u, corners, reach):
        near = lambda end, a=a, b=b: max(abs(u[a] - end[0]), abs(u[b] - end[1])) <= reach
        key = next((k for k, end in ends.items() if near(end)), None)
        if key is None:
            key = len(ends)
            ends[key] = (float(u[a]), float(u[b]))
        ua, ub = ends[key]
        run_u, run_y = u[a : b + 1], y[a : b + 1]
        order = np.argsort(run_u, kind="stable")
        groups.setdefault(key, []).append(np.interp(ua + part * (ub - ua), run_u[order], run_y[order]))
    out = []
    for key, curves in groups.items():
        if len(curves) > 1:
            shifted = np.array(curves) - np.mean(curves, axis=1, keepdims=True)
            worst = float(np.ptp(shifted, axis=0).max())
            travel = float(np.ptp(shifted[0])) or 1.0
            low, high = sorted(ends[key])
            out.append(Congruency(low, high, len(curves), 100 * worst / travel, 100 * worst / span))
    return sorted(out, key=lambda c: c.low - c.high)


def error_by_order(model: Preisach, record: Record, noise: float = 0.0) -> dict[int, tuple[int, float, float]]:
    """Error of a model split by how many reversals the state remembers: 1 on a first-order curve, 2 on a second-order one, ...

    Args:
        model: any with cells or relays.
        record: measured.
        noise: see `orders`.

    Returns:
        For each order (number of samples, root mean square error, largest error), the errors in percent of the record's range.
    """
    error = model.free_run(record.u) - record.y
    order = orders(model, record, noise)
    span = float(np.ptp(record.y[record.used])) or 1.0
    out = {}
    for k in np.unique(order[record.used]):
        mine = error[record.used & (order == k)]
        out[int(k)] = (mine.size, 100 * float(np.sqrt(np.mean(mine**2))) / span, 100 * float(np.abs(mine).max()) / span)
    return out


def _undisturbed(u: np.ndarray, corners: np.ndarray, slack: float) -> list[tuple[int, int]]:
    """Runs from corner to corner that pass no earlier extremum before their end: their start alone decides their shape."""
    out, stack = [], []
    for a, b in itertools.pairwise(corners.tolist()):
        stack.append(a)
        sign = 1.0 if u[b] > u[a] else -1.0
        disturbed = False
        while len(stack) > 1 and sign * (u[b] - u[stack[-2]]) >= 0:
            disturbed |= bool(sign * (u[b] - u[stack[-2]]) > slack)
            del stack[-2:]
        if not disturbed:
            out.append((a, b))
    return out


def orders(model: Preisach, record: Record, noise: float = 0.0) -> np.ndarray:
    """How many reversals the state remembers at every sample, for the model's initial state, shape (T,).

    Inputs closer than the part `noise` of the input's range count as equal.
    """
    center, step = float(model.center), noise * float(np.ptp(record.u))
    stairs = compile_input(np.round((record.u - center) / step) if step > 0 else record.u - center, model.initial)
    depth = np.zeros(stairs.node_parent.size + 1, dtype=int)
    for number, layer in enumerate(stairs.layers(), start=1):
        depth[layer] = number
    return depth[stairs.state_parent][stairs.index]
