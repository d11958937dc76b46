"""Quantities of magnetic data sheets, read off a measured loop or demagnetization curve without a model (IEC 60404).

A branch that rises is mirrored, so that every definition is that of a branch falling from positive saturation. A loop has both branches:
values are their means, and half their difference is given beside the standard error.
"""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Callable, Iterator

import numpy as np

from hystfit.params.units import MU0
from hystfit.quality.faults import CLEAR
from hystfit.quality.loops import SAME_LEVEL
from hystfit.results.measured.loop_branches import NOT_FOUND, Branch, Found, closes, crossing, loss, turns_of
from hystfit.results.measured.magnetic_loop import MagneticLoop
from hystfit.results.measured.measured_value import LoopValue

_HARD = 1e3  # [A/m] coercivity from which a material counts as magnetically hard (IEC 60404-1); soft ones have no energy product
_KNEE = 0.9  # of Jr, at the knee field Hk
_SATURATED = 0.5  # of the remanence, below which no magnet is in its largest field: the parts of a superconducting loop have 0 to 0.3
_RAYLEIGH = 0.3  # of the coercivity, up to which the first curve follows the Rayleigh law
REMANENT_PART = 0.05  # of the largest polarization: remanence from which a curve in one direction is no first curve
_NEIGHBORS = 7  # samples of a local quadratic of a switching field distribution, at least
_LOCAL = 0.01  # of the samples of a branch, that such a quadratic takes at least


@dataclasses.dataclass(frozen=True)
class _Row:
    """A quantity of one falling branch.

    `kind` is "field", "induction", "energy product" or "" for a ratio, and tells its unit; `of_branch` gives value and standard error from
    the branch and the noise; only hard materials have a `hard` one, and an `absolute` one needs the polarization in T.
    """

    name: str
    label: str
    kind: str
    of_branch: Callable[[Branch, float], Found]
    hard: bool = False
    absolute: bool = True


def _opposing(level: np.ndarray, field: np.ndarray, noise: float) -> Found:
    """Opposing field where a level passes zero, and its error: that of one sample, as the noise is correlated, or between the samples."""
    at, error = crossing(level, field, noise)
    if not np.isfinite(at):
        last = int(np.argmin(field))  # a curve that was taken or listed up to its zero has no sample beyond
        ends = field[last] < 0 and 0 <= level[last] <= SAME_LEVEL * float(np.abs(level).max())
        return (-float(field[last]), np.nan) if ends else NOT_FOUND
    near = np.argsort(np.abs(field - at), kind="stable")[:_NEIGHBORS]
    slope = np.polyfit(field[near] - at, level[near], 1)[0] if np.ptp(field[near]) > 0 else 0.0
    return -at, float(np.fmax(error, noise / abs(float(slope)) if slope else np.nan))


def _coercivity(b: Branch, noise: float) -> Found:
    return _opposing(b.y, b.u, noise)


def _remanence(b: Branch, noise: float) -> Found:
    return crossing(b.u, b.y, of_values=noise)


def _squareness_field(b: Branch, noise: float) -> Found:
    return _opposing(b.y - _KNEE * _remanence(b, noise)[0], b.u, noise)


def _knee_ratio(b: Branch, noise: float) -> Found:
    (knee, of_knee), (width, of_width) = _squareness_field(b, noise), _coercivity(b, noise)
    if not width > 0:
        return NOT_FOUND
    return knee / width, abs(knee / width) * float(np.hypot(of_knee / knee, of_width / width))


def energy_product(b: Branch, noise: float) -> Found:
    """(BH)max [J/m^3] of a falling branch in A/m and T: top of a parabola through the largest product in the second quadrant."""
    order = np.argsort(-b.u, kind="stable")
    field, flux = -b.u[order], b.y[order] + MU0 * b.u[order]
    inside = (field >= 0) & (flux >= 0)
    if inside.sum() < 3:
        return NOT_FOUND
    field, product = field[inside], (field * flux)[inside]
    k = int(np.clip(np.argmax(product), 1, product.size - 2))
    three, best = slice(k - 1, k + 2), float(product[k])
    if np.unique(field[three]).size == 3:
        p2, p1, p0 = np.polyfit(field[three] - field[k], product[three], 2)
        best = float(p0 - p1**2 / (4 * p2)) if p2 < 0 and abs(p1 / (2 * p2)) <= np.ptp(field[three]) else best
    return best, noise * float(field[k])


def switching_distribution(b: Branch, noise: float) -> Found:
    """Full width at half maximum of dJ/dH over HcJ; its error is its change where every second sample is left out.

    The local quadratics of the derivative widen a peak that is no wider than they are.
    """
    coercive = _coercivity(b, noise)[0]
    every, second = (_width_of_switching(Branch(b.u[::k], b.y[::k]), noise) for k in (1, 2))
    if not (coercive > 0 and np.isfinite(every)):
        return NOT_FOUND
    return every / coercive, abs(second - every) / coercive


def _width_of_switching(b: Branch, noise: float) -> float:
    """Full width at half maximum of the derivative, by local quadratics; NaN without a peak inside the branch."""
    order = np.argsort(b.u, kind="stable")
    u, y = b.u[order], b.y[order]
    width = 2 * (max(_NEIGHBORS, int(_LOCAL * u.size)) // 2) + 1
    if u.size < 3 * width:
        return np.nan
    at = np.arange(u.size - width + 1)[:, None] + np.arange(width)
    center = u[at].mean(1)
    x = u[at] - center[:, None]
    size = np.maximum(np.abs(x).max(1, keepdims=True), np.finfo(float).tiny)
    columns = np.stack([np.ones_like(x), x / size, (x / size) ** 2], axis=-1)
    of_slope = np.linalg.pinv(columns)[:, 1] / size
    slope, error = np.sum(of_slope * y[at], axis=1), np.nan_to_num(noise) * np.linalg.norm(of_slope, axis=1)
    peak = int(np.argmax(slope - CLEAR * error))  # near the tips of a sine the samples are too close for a slope
    half = 0.5 * slope[peak]
    left = np.flatnonzero(slope[:peak] < half)
    right = peak + np.flatnonzero(slope[peak:] < half)
    if not (half > 0 and left.size and right.size):
        return np.nan
    edge = lambda k: center[k] + (half - slope[k]) / (slope[k + 1] - slope[k]) * (center[k + 1] - center[k])
    return float(edge(right[0] - 1) - edge(left[-1]))


_ROWS = (
    _Row("HcJ", "coercivity HcJ (J = 0)", "field", _coercivity),
    _Row("HcB", "coercivity HcB (B = 0)", "field", lambda b, noise: _opposing(b.y + MU0 * b.u, b.u, noise)),
    _Row("Br", "remanence Br", "induction", _remanence),
    _Row("energy_product", "(BH)max", "energy product", energy_product, hard=True),
    _Row("knee_field", f"knee field Hk (J = {_KNEE} Jr)", "field", _squareness_field, hard=True),
    _Row("knee_ratio", "Hk/HcJ", "", _knee_ratio, hard=True),
    _Row("switching_distribution", "SFD: width of dJ/dH over HcJ", "", switching_distribution, absolute=False),
)
# What a substrate changes, as the output passes zero at other fields.
_OF_ZERO = ("HcJ", "HcB", "switching_distribution")


def magnetic_values(loop: MagneticLoop) -> tuple[LoopValue, ...]:
    """The rows of the data sheet of a loop, or of a curve in one direction; fields in the unit of the file, or kA/m for Oe or G."""
    mirrored = [b.rises for b in loop.branches] or [False]
    falling = [Branch(-b.u, -b.y) if b.rises else b for b in loop.branches]
    if not falling:
        if turns_of(loop.h).size:  # neither a loop nor a demagnetization curve
            return ()
        rest = float(loop.j[np.argmin(np.abs(loop.h))])
        falling = [Branch(np.sign(rest) * loop.h, np.sign(rest) * loop.j)]
        if abs(rest) < REMANENT_PART * np.abs(loop.j).max() or falling[0].u.min() >= -SAME_LEVEL * np.abs(loop.h).max():
            return ()
    field = ("kA/m", 1e3) if re.search("Oe|G", loop.units[0]) else (loop.units[0], loop.per_field)
    units = {"field": field, "induction": ("T", 1.0), "energy product": ("kJ/m3", 1e3), "": ("", 1.0)}
    width = [at for b in falling if np.isfinite(at := _coercivity(b, loop.noise)[0])]
    hard = float(np.median(width) if width else np.abs(loop.h).max()) >= _HARD
    rows, sigma = [], loop.sigma
    middle = _about_middle(falling, mirrored, loop.noise)
    magnet = loop.absolute and not any(_is_superconducting(b) for b in falling)
    sloped = any(one.name == "slope" and one.applied for one in loop.corrections)
    on_substrate = loop.saturation is not None and loop.saturation.on_substrate and not sloped
    for row in _ROWS:
        if (row.hard and not hard) or (row.absolute and not magnet) or (on_substrate and row.name in _OF_ZERO):
            continue
        of = middle if row.name == "switching_distribution" else falling
        found = [(side, row.of_branch(b, sigma)) for side, b in zip(mirrored, of, strict=True)]
        rows.extend(_mean(row.name, row.label, found, units[row.kind]))
    if any(one.name == "volume" for one in loop.corrections):
        rows.extend(_loss(loop))
    rows.extend(_saturation(loop, falling))
    if magnet and not hard:
        rows.extend(_permeabilities(loop, width))
    return tuple(rows)


def _about_middle(falling: list[Branch], mirrored: list[bool], noise: float) -> list[Branch]:
    """Branches about the middle of a loop that is shifted along the field, as by exchange bias; as they are where it has one branch."""
    opposing = lambda side: [
        at for b, m in zip(falling, mirrored, strict=True) if m == side and np.isfinite(at := _coercivity(b, noise)[0])
    ]
    one, other = opposing(False), opposing(True)
    if not one or not other:
        return falling
    shift = 0.5 * float(np.median(one) - np.median(other))  # of a falling branch to negative fields
    return [Branch(b.u + (-shift if side else shift), b.y) for b, side in zip(falling, mirrored, strict=True)]


def _is_superconducting(b: Branch) -> bool:
    """Whether a branch that falls from the largest field has a larger moment without field, which is that of its currents."""
    return float(b.y[np.argmax(b.u)]) < _SATURATED * _remanence(b, np.nan)[0]


def _mean(name: str, label: str, found: list[tuple[bool, Found]], unit: tuple[str, float]) -> Iterator[LoopValue]:
    """Mean over both branches, with half their difference."""
    sides = [[one for which, one in found if which == side and np.isfinite(one[0])] for side in (False, True)]
    sides = [side for side in sides if side]
    if not sides:
        return
    values = [float(np.median([value for value, _ in side])) for side in sides]
    errors = [error for side in sides for _, error in side]
    error = float(np.sqrt(np.mean(np.square(errors)) / len(errors))) / unit[1]
    spread = 0.5 * abs(values[0] - values[1]) / unit[1] if len(values) == 2 else None
    yield LoopValue(name, label, float(np.mean(values)) / unit[1], error, unit[0], len(errors), spread=spread)


def _loss(loop: MagneticLoop) -> Iterator[LoopValue]:
    """Loss per cycle and volume, of loops that were measured as moments."""
    pairs = itertools.pairwise(loop.branches)
    if pairs := [pair for pair in pairs if pair[0].rises != pair[1].rises and closes(*pair, loop.j)]:
        value, error, count = loss(pairs, loop.sigma, loop.correlated)
        yield LoopValue("W", "hysteresis loss per cycle", value, error, "J/m3", count)


def _saturation(loop: MagneticLoop, falling: list[Branch]) -> Iterator[LoopValue]:
    """Js by the law of approach, and the squareness that follows."""
    law = loop.saturation
    if law is None or not law.settled:
        return
    yield LoopValue("Js", "saturation Js (law of approach)", law.value, law.stderr, loop.unit, spread=law.spread)
    remanent = [one for b in falling if np.isfinite((one := _remanence(b, loop.sigma))[0])]
    if remanent:
        values, errors = np.array(remanent).T
        ratio = float(np.mean(values)) / law.value
        scatter = float(np.sqrt(np.mean(np.nan_to_num(errors) ** 2) / errors.size)) / law.value
        error = float(np.hypot(scatter, ratio * law.stderr / law.value))
        spread = abs(ratio) * law.spread / law.value
        yield LoopValue("squareness", "squareness Jr/Js", ratio, error, "", len(remanent), spread=spread)


def _permeabilities(loop: MagneticLoop, width: list[float]) -> Iterator[LoopValue]:
    """Amplitude permeability at the tips; initial and maximum permeability where the record begins demagnetized."""
    flux = loop.j + MU0 * loop.h
    tips = [(b.u[k], b.y[k] + MU0 * b.u[k]) for b in loop.branches for k in (0, -1)]
    if tips and abs(loop.h.max() + loop.h.min()) <= SAME_LEVEL * np.ptp(loop.h):
        values, label = [b / (MU0 * h) for h, b in tips if h != 0], "amplitude permeability at the tip"
        spread = 0.5 * float(np.ptp(values))
        yield LoopValue("mu_a", label, float(np.mean(values)), None, "", len(values), spread=spread)
    if abs(loop.h[0]) > SAME_LEVEL * np.ptp(loop.h) or abs(flux[0]) > SAME_LEVEL * np.ptp(flux) or not width:
        return
    rising = loop.h[-1] if not loop.branches else loop.h[int(np.argmax(np.abs(loop.h)))]
    sign = 1.0 if rising > 0 else -1.0
    last = int(np.argmax(sign * loop.h)) + 1
    h, b = sign * loop.h[:last], sign * flux[:last]
    first = h == np.maximum.accumulate(np.abs(h))  # beyond all fields before, also of a loop of growing amplitude
    h, b, start = h[first], b[first], float(b[0])
    low = (h > 0) & (h <= _RAYLEIGH * float(np.median(width)))
    if low.sum() >= _NEIGHBORS:
        columns = np.column_stack([h[low], h[low] ** 2])
        theta, square = np.linalg.lstsq(columns, b[low], rcond=None)[:2]
        variance = float(square[0]) / (low.sum() - 2) if square.size else 0.0
        error = float(np.sqrt(variance * np.linalg.inv(columns.T @ columns)[0, 0])) / MU0
        yield LoopValue("mu_i", "initial permeability (Rayleigh law)", float(theta[0]) / MU0, error, "", int(low.sum()))
    away = h > 0
    if away.any():
        # Near zero field, the noise and an induction that is left at the start are large beside the induction.
        error = float(np.hypot(np.nan_to_num(loop.sigma), start))
        k = int(np.argmax((b[away] - CLEAR * error) / h[away]))
        largest, error = (float(size / (MU0 * h[away][k])) for size in (b[away][k], error))
        yield LoopValue("mu_max", "maximum permeability, first curve", largest, error or None, "")
