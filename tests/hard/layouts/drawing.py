"""Random choices of one file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


class Draw:
    """Random choices of one file, from its seed."""

    def __init__(self, seed: int):
        self.rng = np.random.default_rng([33, seed])

    def pick(self, *choices: Any) -> Any:
        """One of some choices."""
        return choices[int(self.rng.integers(len(choices)))]

    def chance(self, probability: float) -> bool:
        """True with this probability."""
        return bool(self.rng.random() < probability)

    def whole(self, low: int, high: int) -> int:
        """A whole number from low to high, both included."""
        return int(self.rng.integers(low, high + 1))

    def between(self, low: float, high: float) -> float:
        """A number between two, of three digits as people set them."""
        return float(f"{self.rng.uniform(low, high):.3g}")

    def size(self, low: float, high: float) -> float:
        """A positive number between two, evenly in its logarithm, of two digits."""
        return float(f"{np.exp(self.rng.uniform(np.log(low), np.log(high))):.2g}")

    def noise(self, values: np.ndarray, part: float) -> np.ndarray:
        """Values with white noise of that part of their range."""
        return values + self.rng.normal(0, part * np.ptp(values) + 1e-300, values.shape)

    def shuffled(self, items: Sequence[Any]) -> list[Any]:
        """The items in random order."""
        return [items[k] for k in self.rng.permutation(len(items))]
