"""Noise models by name, and starting values read off residuals."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hystfit.errors import ParameterError
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.independent import StudentT, White
from hystfit.inference.noise.repeating import LoopDiscrepancy
from hystfit.inference.noise.slow import Ar1, OrnsteinUhlenbeck

NOISES: dict[str, type[AbstractNoise]] = {
    kind.name: kind for kind in (White, OrnsteinUhlenbeck, Ar1, StudentT, LoopDiscrepancy)
}


def make_noise(name: str) -> AbstractNoise:
    """A noise model by name, with default values.

    Raises:
        ParameterError: an unknown name; the message lists them.
    """
    if name not in NOISES:
        raise ParameterError(f"noise must be one of {', '.join(NOISES)}, got {name!r}")
    return NOISES[name]()


def starting_noise(name: str, residuals: list[np.ndarray], time: float) -> AbstractNoise:
    """A noise model with starting values read off residuals.

    Args:
        name: see `NOISES`.
        residuals: of each record, the samples that count, output units.
        time: their integrated autocorrelation time in samples.

    Raises:
        ParameterError: an unknown name.
    """
    noise = make_noise(name)
    together = np.concatenate(residuals)
    total = max(float(np.std(together)), 1e-12)
    rough = np.concatenate([np.diff(r) for r in residuals])
    white = float(np.clip(np.std(rough) / np.sqrt(2), 0.05 * total, 0.95 * total)) if rough.size else 0.5 * total
    slow = float(np.sqrt(total**2 - white**2))
    center, spread = np.median(together), np.median(np.abs(together - np.median(together)))
    values: dict[str, float] = {
        "noise_white": white,
        "noise_slow": slow,
        "noise_time": float(np.clip(time / 2, 2.0, together.size / 4)),
        "noise_loop": 0.5 * slow,
        "noise_length": 0.3,
    }
    if name == "iid":
        values["noise_white"] = total
    elif name == "ar1":
        values["noise_slow"] = total
    elif name == "student-t":
        values.update(noise_white=max(float(spread) * 1.2, 1e-3 * total, abs(float(center)) * 1e-9), noise_dof=5.0)
    fields = {k: jnp.asarray(v) for k, v in values.items() if hasattr(noise, k)}
    return eqx.tree_at(lambda n: [getattr(n, k) for k in fields], noise, list(fields.values()))
