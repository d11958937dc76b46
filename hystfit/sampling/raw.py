"""What samplers give to `sample`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Evidence(NamedTuple):
    """Log evidence of model, noise and priors together (natural logarithm), its standard error, and the information gained [nats]."""

    log_z: float
    error: float
    information: float


class Raw(NamedTuple):
    """What a sampler returns: z (chains, draws, d), log density and stats (chains, draws), notes, evidence where it is known."""

    z: np.ndarray
    log_density: np.ndarray
    stats: dict[str, np.ndarray]
    notes: tuple[str, ...]
    evidence: Evidence | None = None
