"""Simulated hysteresis for the generated files: plain NumPy, of no code that they test.

Plays (Prandtl-Ishlinskii) give loops that lag; plays through tanh saturate, as polarization and magnetization do; stops give friction.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .drawing import Draw


def triangle(n: int, cycles: float, start: float = 0.0) -> np.ndarray:
    """A triangular wave of amplitude 1, shape (n,); it rises from 0 at start 0 and falls from 1 at start 0.25."""
    phase = start + np.arange(n) * cycles / max(n - 1, 1)
    return 4 * np.abs((phase - 0.25) % 1 - 0.5) - 1


def sine(n: int, cycles: float, start: float = 0.0) -> np.ndarray:
    """A sine of amplitude 1, shape (n,)."""
    return np.sin(2 * np.pi * (start + np.arange(n) * cycles / max(n - 1, 1)))


def wave(draw: Draw, n: int, cycles: float, start: float = 0.0) -> np.ndarray:
    """A triangle or a sine."""
    return draw.pick(triangle, sine)(n, cycles, start)


def major_loop(n: int) -> np.ndarray:
    """A triangle of amplitude 1 from the positive end down and up again, shape (n,)."""
    return triangle(n, 1, start=0.25)


def growing(n: int, cycles: int, least: float = 0.2) -> np.ndarray:
    """A triangle whose amplitude grows from cycle to cycle to 1, shape (n,)."""
    number = np.minimum(np.arange(n) * cycles // n, cycles - 1)
    return triangle(n, cycles) * (least + (1 - least) * number / max(cycles - 1, 1))


def plays(u: np.ndarray, thresholds: np.ndarray, weights: np.ndarray, begin: float = 0.0) -> np.ndarray:
    """Weighted sum of play operators, shape of u.

    Args:
        thresholds, weights: of the plays, shape (P,).
        begin: 1 or -1 starts from positive or negative saturation, 0 from rest.
    """
    state = np.full(thresholds.shape, begin * 2.0 * thresholds.max()) if begin else np.zeros_like(thresholds)
    total = np.empty_like(u)
    for k, value in enumerate(u):
        state = np.minimum(np.maximum(state, value - thresholds), value + thresholds)
        total[k] = weights @ state
    return total


def lagging(draw: Draw, u: np.ndarray, width: float = 0.3) -> np.ndarray:
    """Output that lags an input of amplitude 1, about 1 large: piezo stroke, elastic bodies with friction inside."""
    thresholds = np.linspace(0, 0.8, 9)
    weights = np.r_[1.0, width * draw.rng.dirichlet(np.ones(8)) * 2]
    return plays(u, thresholds, weights / weights.sum())


def magnet(draw: Draw, coercive: float | None = None) -> Callable[..., np.ndarray]:
    """A function from an input of amplitude 1 (and `begin`, see `plays`) to a magnetization or polarization about 1 large."""
    coercive = draw.rng.uniform(0.1, 0.4) if coercive is None else coercive
    thresholds, soft, slope = (
        coercive * np.linspace(0.4, 1.6, 7),
        draw.rng.uniform(0.15, 0.4),
        draw.rng.uniform(0.0, 0.1),
    )
    share = np.full(7, 1 / 7)
    return lambda u, begin=0.0: np.tanh(plays(u, thresholds, share, begin) / soft) + slope * u


def saturating(draw: Draw, u: np.ndarray, *, begin: float = 0.0, coercive: float | None = None) -> np.ndarray:
    """Saturating output of an input of amplitude 1, about 1 large."""
    return magnet(draw, coercive)(u, begin)


def rubbing(draw: Draw, x: np.ndarray, friction: float = 0.6) -> np.ndarray:
    """Restoring force of a displacement of amplitude 1, about 1 large: a spring with friction, clockwise."""
    limits = np.linspace(0.05, 0.5, 6)
    weights = draw.rng.dirichlet(np.ones(6))
    force = x - plays(x, limits, weights)
    stick = force / np.abs(force).max()
    return (1 - friction) * x + friction * stick


def pinched(draw: Draw, x: np.ndarray) -> np.ndarray:
    """Pinched and degrading restoring force, about 1 large: nailed and bolted joints, walls."""
    force = rubbing(draw, x, 0.8)
    used = np.maximum.accumulate(np.abs(x))
    return force * (0.25 + 0.75 * np.abs(x) / np.maximum(used, 0.05)) * (1 - 0.2 * used)


def damping(x: np.ndarray, velocity: np.ndarray, draw: Draw) -> np.ndarray:
    """Force of a damper about 1 large, of a displacement and a velocity of amplitude 1."""
    knee = draw.rng.uniform(0.05, 0.3)
    return 0.75 * np.tanh(velocity / knee) + 0.2 * velocity + draw.rng.uniform(0.02, 0.15) * x
