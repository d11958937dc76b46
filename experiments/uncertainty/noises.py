"""Simulated loops with known truth and white, slow or recurring error."""

from __future__ import annotations

import dataclasses

import numpy as np

import hystfit as hf

TRUTH = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
NAMES = ("c", "mu", "tau", "rho")
VALUES = np.array([1.0, 0.5, 2.0, 0.5])
SAMPLES, CYCLES = 1600, 8
WHITE, LOOP = 0.01, 0.02  # standard deviations; the output's range is 1.4
LENGTH = 0.25  # length scale of the recurring error, in parts of the input range


@dataclasses.dataclass(frozen=True)
class Kind:
    """Standard deviations of the white, autoregressive and recurring parts of an error, and the coefficient of the autoregression."""

    white: float = 0.0
    slow: float = 0.0
    loop: float = 0.0
    rho: float = 0.99


# Correlation over 100 samples (a cycle has 200) or over 10.
KINDS = {
    "white": Kind(WHITE),
    "AR(1)": Kind(0.0, 0.01),
    "AR(1), short": Kind(0.0, 0.01, rho=0.9),
    "AR(1) + white": Kind(WHITE, 0.01),
    "AR(1), short + white": Kind(WHITE, 0.01, rho=0.9),
    "repeating + white": Kind(WHITE, loop=LOOP),
    "repeating + AR(1) + white": Kind(WHITE, 0.01, LOOP),
    "repeating + AR(1), short + white": Kind(WHITE, 0.01, LOOP, rho=0.9),
    "AR(1), strong + white": Kind(WHITE, 0.02),
}


def excitation(samples: int = SAMPLES, cycles: float = CYCLES) -> np.ndarray:
    """Amplitude-modulated cycles, 0.4 to 1 and back."""
    phase = np.arange(samples) / samples
    return np.sin(2 * np.pi * cycles * phase) * (0.7 - 0.3 * np.cos(2 * np.pi * phase))


def autoregression(rng: np.random.Generator, samples: int, rho: float) -> np.ndarray:
    """Stationary AR(1) noise of variance one."""
    e = rng.normal(size=samples)
    e[1:] *= np.sqrt(1 - rho**2)
    for k in range(1, samples):
        e[k] += rho * e[k - 1]
    return e


def repeating(rng: np.random.Generator, u: np.ndarray) -> np.ndarray:
    """A smooth random curve over the input on each branch, the same in every loop, of variance one."""
    place = (u - u.min()) / np.ptp(u)
    grid = np.linspace(0, 1, 60)
    cover = np.exp(-0.5 * ((grid[:, None] - grid) / LENGTH) ** 2) + 1e-9 * np.eye(grid.size)
    curves = np.linalg.cholesky(cover) @ rng.normal(size=(grid.size, 2))
    up, down = (np.interp(place, grid, curve) for curve in curves.T)
    return np.where(np.gradient(u) >= 0, up, down)


def record(kind: str, seed: int, samples: int = SAMPLES) -> hf.Record:
    """One simulated measurement."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    u = excitation(samples)
    y = np.asarray(hf.simulate(TRUTH, u)[0])
    own = KINDS[kind]
    y = y + own.white * rng.normal(size=samples)
    y = y + own.slow * autoregression(rng, samples, own.rho)
    y = y + own.loop * repeating(rng, u)
    return hf.Record(u=u, y=y, name=kind)
