"""What a model reports beside its parameters: quantities that follow from them, and weights of its plays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array


class Derived(NamedTuple):
    """A quantity that follows from the parameters of a model: name, unit expression in u, y and s, meaning, function of the model."""

    name: str
    unit: str
    doc: str
    value: Callable[[Any], Array]


class PlayWeights(NamedTuple):
    """Weights [y] of the plays or stops of one envelope by their half width [u], rising, and the names of these parameters."""

    label: str
    threshold: np.ndarray
    weight: np.ndarray
    names: tuple[str, ...]
