"""Simulated devices of known kind and the protocols that they are measured by, in plain NumPy, without the models of the package.

Every device has random parameters, a straight line of either sign beside its hysteresis, and white noise of its own.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence

import numpy as np

import hystfit as hf

Device = Callable[[np.ndarray], np.ndarray]
NOISE = (2e-4, 2e-2)  # rms over the range of the output, log-uniform
LINE = 0.3  # largest share of the straight line in the range of the output
FINE = 4  # steps of a differential equation between two samples


def plays(rng: np.random.Generator) -> Device:
    """Weighted plays, and a cubic."""
    radii, weights = np.append(0.0, np.sort(rng.uniform(0, 0.9, 12))), rng.exponential(1.0, 13)
    cubic = rng.uniform(0, 1.0)

    def run(u: np.ndarray) -> np.ndarray:
        position, y = np.zeros(radii.size), np.empty(u.size)
        for k, value in enumerate(u):
            position = np.clip(position, value - radii, value + radii)
            y[k] = weights @ position
        return y + cubic * weights.sum() * u**3

    return run


def stops(rng: np.random.Generator) -> Device:
    """Weighted stops: a force that saturates after every reversal."""
    limits, weights = rng.uniform(0.05, 0.9, 8), rng.exponential(1.0, 8)

    def run(u: np.ndarray) -> np.ndarray:
        force, before, y = np.zeros(limits.size), 0.0, np.empty(u.size)
        for k, value in enumerate(u):
            force, before = np.clip(force + value - before, -limits, limits), value
            y[k] = weights @ force
        return y

    return run


def relays(rng: np.random.Generator) -> Device:
    """Four thousand relays: coercivities log-normal, interaction fields normal (a Preisach density without congruent plays)."""
    coercivity = rng.uniform(0.15, 0.4) * np.exp(rng.uniform(0.2, 0.5) * rng.normal(size=4000))
    interaction = rng.uniform(0.05, 0.2) * rng.normal(size=4000)
    up, down = interaction + coercivity, interaction - coercivity

    def run(u: np.ndarray) -> np.ndarray:
        state, y = np.where(interaction > 0, -1.0, 1.0), np.empty(u.size)
        for k, value in enumerate(u):
            state = np.where(value >= up, 1.0, np.where(value <= down, -1.0, state))
            y[k] = state.mean()
        return y

    return run


def _in_steps(slope: Callable[[float, float, float], float], stiffness: float = 0.0) -> Device:
    """A device of output stiffness u + x, whose state x, from 0, follows dx/du = slope(u, x, direction) in `FINE` steps a sample."""

    def run(u: np.ndarray) -> np.ndarray:
        x, before, y = 0.0, 0.0, np.empty(u.size)
        for k, value in enumerate(u):
            du = (value - before) / FINE
            for step in range(FINE):
                x += slope(before + (step + 0.5) * du, x, np.sign(du)) * du
            before, y[k] = value, stiffness * value + x
        return y

    return run


def bouc_wen(rng: np.random.Generator) -> Device:
    """dw = rho (1 - (sigma sign(du w) + 1 - sigma) |w|^n) du beside a spring."""
    rho, sigma, n, stiff = rng.uniform(3, 10), rng.uniform(0.5, 1.2), rng.uniform(1, 2.5), rng.uniform(0.1, 1.5)
    return _in_steps(lambda u, w, way: rho * (1 - (sigma * np.sign(way * w) + 1 - sigma) * abs(w) ** n), stiff)


def duhem(rng: np.random.Generator) -> Device:
    """dy = alpha |du| (f(u) - y) + g du (Coleman and Hodgdon 1986)."""
    alpha, bend, slope = rng.uniform(1, 5), rng.uniform(0, 0.5), rng.uniform(0, 0.5)
    return _in_steps(lambda u, y, way: alpha * way * (u + bend * u**3 - y) + slope)


def jiles_atherton(rng: np.random.Generator) -> Device:
    """dM/dH of Jiles and Atherton (1986), without negative susceptibility."""
    a, pinning, c, alpha = rng.uniform(0.1, 0.3), rng.uniform(0.1, 0.4), rng.uniform(0.05, 0.4), rng.uniform(0.0, 0.1)

    def slope(u: float, m: float, way: float) -> float:
        x = (u + alpha * m) / a
        inverse = 1 / x if abs(x) > 1e-3 else 0.0
        anhysteretic = 1 / np.tanh(x) - inverse if inverse else x / 3
        steep = (1 - 1 / np.tanh(x) ** 2 + inverse**2) / a if inverse else 1 / (3 * a)
        miss = anhysteretic - m
        free = miss / (way * pinning - alpha * miss) if miss * way > 0 else 0.0
        return max(((1 - c) * free + c * steep) / (1 - c * alpha * steep), 0.0)

    return _in_steps(slope)


KINDS: dict[str, Callable[[np.random.Generator], Device]] = {
    "plays": plays,
    "stops": stops,
    "relays": relays,
    "Bouc-Wen": bouc_wen,
    "Duhem": duhem,
    "Jiles-Atherton": jiles_atherton,
}


def path(turns: Sequence[float], step: float) -> np.ndarray:
    """A smooth input through turning points, with about `step` from sample to sample where it is fastest."""
    parts = [np.array([turns[0]])]
    for one, other in itertools.pairwise(turns):
        count = max(8, int(np.ceil(np.pi / 2 * abs(other - one) / step)))
        parts.append(one + (other - one) * 0.5 * (1 - np.cos(np.pi * np.arange(1, count + 1) / count)))
    return np.concatenate(parts)


def cycles(levels: Sequence[float], repeats: int = 1) -> list[float]:
    """Turning points of symmetric cycles that start and end at their upper tips."""
    return [tip for a in levels for _ in range(repeats) for tip in (a, -a)]


def _reversal_turns(rng: np.random.Generator) -> list[float]:
    return [1.0, *(turn for back in np.linspace(0.8, -0.9, 8) + 0.02 * rng.normal(size=8) for turn in (back, 1.0))]


# Turning points of the records of each protocol, and whether it tests other amplitudes than its largest.
PROTOCOLS: dict[str, tuple[Callable[[np.random.Generator], list[list[float]]], bool]] = {
    "one loop": (lambda rng: [[*cycles([1.0]), 1.0]], False),
    "repeated loops": (lambda rng: [[*cycles([1.0], 4), 1.0]], False),
    "nested levels": (lambda rng: [[*cycles([1.0, 0.8, 0.6, 0.4, 0.2], 2), 0.2]], True),
    "decaying": (lambda rng: [[*cycles(0.9 ** np.arange(12)), 0.3]], True),
    "reversal curves": (lambda rng: [_reversal_turns(rng)], True),
    "several records": (lambda rng: [[*cycles([a], 2), a] for a in (1.0, 0.75, 0.5, 0.25)], True),
    "transient": (lambda rng: [[1.0, -1.0, *rng.uniform(-1, 1, 24)]], True),
}


@dataclasses.dataclass(frozen=True)
class Case:
    """A measured device, and unseen loops of it without noise.

    Attributes:
        name, kind, protocol: of the device and of its measurement.
        data: measured.
        same, other: a loop of the largest amplitude; loops of smaller ones. Each comes after a loop that sets the state.
        noise: rms over the range of the output.
        tests_amplitudes: whether the measurement holds several amplitudes.
    """

    name: str
    kind: str
    protocol: str
    data: hf.Dataset
    same: hf.Record
    other: hf.Record
    noise: float
    tests_amplitudes: bool


def case(number: int) -> Case:
    """A device and its measurement by the number of its seed."""
    rng = np.random.default_rng([number, 33])
    kind, protocol = list(KINDS)[number % len(KINDS)], list(PROTOCOLS)[number % len(PROTOCOLS)]
    device, step = KINDS[kind](rng), rng.uniform(0.02, 0.05)
    turns, tests = PROTOCOLS[protocol][0](rng), PROTOCOLS[protocol][1]
    size, scale = 10 ** rng.uniform(-2, 3), 10 ** rng.uniform(-2, 3)
    # A loop before the record sets the state, as the history of a device does.
    before = path([0.0, 1.0, -1.0, 1.0], step)
    span, line = np.ptp(device(before)), rng.uniform(-LINE, LINE)
    noise = 10 ** rng.uniform(*np.log10(NOISE))

    def run(turns: Sequence[float], level: float, name: str, weight: int = 0) -> hf.Record:
        # The device has run through a loop of this record's size.
        start = np.array([1.0]) if turns[0] == 1.0 else path([1.0, turns[0], -turns[0], turns[0]], step)
        u = path(turns, step)
        y = device(np.concatenate([before, start, u[1:]]))[-u.size :] + 0.5 * line * span * u
        y = y + level * span * rng.normal(size=u.size)
        counted = np.arange(u.size) >= weight
        return hf.Record(size * u, scale * y, name=name, weight=counted.astype(float))

    records = [run(points, noise, f"record {k + 1}") for k, points in enumerate(turns)]
    settled = path([*cycles([1.0]), 1.0], step).size
    same = run([*cycles([1.0], 2), 1.0], 0.0, "same", settled)
    other = run([*cycles([1.0]), *cycles([0.8, 0.6, 0.4, 0.25]), 0.25], 0.0, "other", settled)
    return Case(f"{number + 1}", kind, protocol, hf.Dataset(tuple(records)), same, other, noise, tests)
