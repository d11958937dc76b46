"""What samplers and `sample` give each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from hystfit.errors import ParameterError


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


def check_counts(settings: Any, least: Mapping[str, int]) -> None:
    """Refuse settings of a sampler that are no whole numbers, or below the least that makes sense.

    Raises:
        ParameterError: says which, and what it must be.
    """
    for name, lowest in least.items():
        value = getattr(settings, name)
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < lowest:
            raise ParameterError(f"{name} must be a whole number of at least {lowest}, got {value!r}")
