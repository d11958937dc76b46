"""How steeply the output of a fitted model follows its input: an inverse needs an output that rises, or falls, everywhere."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hystfit.params.relative_size import ROUNDED

POINTS, CYCLES = 400, 3  # inputs of a computed loop, and cycles until it repeats itself


class Slopes(NamedTuple):
    """Least and largest change of the output by a step of the input, over that step [y/u], on every branch within a range."""

    least: float
    most: float

    @classmethod
    def of(cls, *values: np.ndarray | float) -> Slopes:
        """The range of all these slopes."""
        each = [np.asarray(value, dtype=float) for value in values]
        return cls(float(min(v.min() for v in each)), float(max(v.max() for v in each)))

    @property
    def mixed(self) -> bool:
        """Whether the output rises on some branches and falls on others."""
        size = ROUNDED * max(abs(self.least), abs(self.most))
        return self.least < -size and self.most > size

    def __add__(self, other: object) -> Slopes:
        """Bounds for a sum of two outputs."""
        if not isinstance(other, Slopes):
            return NotImplemented
        return Slopes(self.least + other.least, self.most + other.most)

    def after(self, other: Slopes) -> Slopes:
        """Bounds for this output where the input is another output."""
        return Slopes.of(*(a * b for a in self for b in other))
