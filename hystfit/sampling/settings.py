"""What settings of the samplers must be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hystfit.errors import ParameterError


def check_counts(settings: Any, least: Mapping[str, int]) -> None:
    """Refuse settings of a sampler that are no whole numbers, or below the least that makes sense.

    Raises:
        ParameterError: says which, and what it must be.
    """
    for name, lowest in least.items():
        value = getattr(settings, name)
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < lowest:
            raise ParameterError(f"{name} must be a whole number of at least {lowest}, got {value!r}")
