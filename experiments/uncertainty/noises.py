"""Simulated loops whose truth is known, with white, slow or repeating error."""

from __future__ import annotations

import numpy as np

import hystfit as hf

TRUTH = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
NAMES = ("c", "mu", "tau", "rho")
VALUES = np.array([1.0, 0.5, 2.0, 0.5])
SAMPLES, CYCLES = 1600, 8
WHITE, SLOW, LOOP = 0.01, 0.02, 0.02  # standard deviations
RHO, LENGTH = 0.99, 0.25  # of the autoregression; of the repeating error, in parts of the input range
KINDS = {
    "white": (True, False, False),
    "AR(1)": (False, True, False),
    "AR(1) + white": (True, True, False),
    "repeating + white": (True, False, True),
    "repeating + AR(1) + white": (True, True, True),
}


def excitation(samples: int = SAMPLES, cycles: float = CYCLES) -> np.ndarray:
    """Amplitude-modulated cycles, 0.4 to 1 and back."""
    phase = np.arange(samples) / samples
    return np.sin(2 * np.pi * cycles * phase) * (0.7 - 0.3 * np.cos(2 * np.pi * phase))


def autoregression(rng: np.random.Generator, samples: int) -> np.ndarray:
    """Stationary AR(1) noise."""
    e = rng.normal(size=samples)
    e[1:] *= np.sqrt(1 - RHO**2)
    for k in range(1, samples):
        e[k] += RHO * e[k - 1]
    return SLOW * e


def repeating(rng: np.random.Generator, u: np.ndarray) -> np.ndarray:
    """A smooth random curve over the input on each branch, the same in every loop."""
    place = (u - u.min()) / np.ptp(u)
    grid = np.linspace(0, 1, 60)
    cover = np.exp(-0.5 * ((grid[:, None] - grid) / LENGTH) ** 2) + 1e-9 * np.eye(grid.size)
    curves = np.linalg.cholesky(cover) @ rng.normal(size=(grid.size, 2))
    up, down = (np.interp(place, grid, curve) for curve in curves.T)
    return LOOP * np.where(np.gradient(u) >= 0, up, down)


def record(kind: str, seed: int, samples: int = SAMPLES) -> hf.Record:
    """One simulated measurement."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    u = excitation(samples)
    y = np.asarray(hf.simulate(TRUTH, u)[0])
    white, slow, loop = KINDS[kind]
    y = y + (WHITE * rng.normal(size=samples) if white else 0.0)
    y = y + (autoregression(rng, samples) if slow else 0.0)
    y = y + (repeating(rng, u) if loop else 0.0)
    return hf.Record(u=u, y=y, name=kind)
