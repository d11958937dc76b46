"""Whole numbers for the inputs of a grid of relays, and the states that an input visits."""

from __future__ import annotations

import numpy as np

from hystfit.models.preisach.plane import AbstractPlane
from hystfit.models.preisach.staircase import Staircase, compile_input


class Code:
    """Whole numbers that tell apart, for a grid of relays, the inputs that matter: 2 k between marks k - 1 and k, 2 k + 1 on mark k.

    The marks are the levels and, for a demagnetized start, their mirror images, so that comparing a code with a mirrored code is exact.
    """

    def __init__(self, levels: np.ndarray, center: float | None):
        self.levels = levels
        self.marks = levels
        if center is not None:
            images = 2 * center - levels
            gap = np.abs(images[:, None] - levels).min(axis=1)
            # Rounding must not part a level from its image: codes would not be symmetric.
            self.marks = np.sort(np.append(levels, images[gap > 1e-12 * (np.ptp(levels) + abs(center))]))
        self.top = 2 * self.marks.size

    def of(self, u: np.ndarray) -> np.ndarray:
        """Codes of inputs."""
        below = np.searchsorted(self.marks, u, side="left")
        on = self.marks[np.minimum(below, self.marks.size - 1)] == u
        return 2 * below + on

    def passed(self) -> tuple[np.ndarray, np.ndarray]:
        """For every code, the number of levels <= and < its inputs."""
        code = np.arange(self.top + 1)
        reached = np.append(np.searchsorted(self.levels, self.marks, side="right"), self.levels.size)
        before = np.append(np.searchsorted(self.levels, self.marks, side="left"), self.levels.size)
        # An odd code lies on its mark; an even one lies below the mark and above the one before it.
        at_most = np.where(code % 2 == 1, reached[code // 2], before[code // 2])
        return at_most, before[code // 2]


def staircase_of(model: AbstractPlane, u: np.ndarray) -> tuple[Code | None, Staircase]:
    """The states that an input visits: of the input itself for cells, of its codes for relays."""
    center = float(model.center)
    if model.elements == "cells":
        return None, compile_input(u, model.initial, center)
    code = Code(np.asarray(model.levels), center if model.initial == "demagnetized" else None)
    return code, compile_input(code.of(u), model.initial, 0.5 * code.top)


def rises_first(model: AbstractPlane, code: Code, first: np.ndarray) -> np.ndarray:
    """Whether a first excursion, given by its code, switches relays up."""
    if model.initial == "demagnetized":
        return 2 * first >= code.top
    return np.full(first.shape, model.initial == "negative")


def ties(model: AbstractPlane, code: Code, stairs: Staircase) -> np.ndarray:
    """States in which the input fell just onto a level, and the number of that level, shape (2, ties)."""
    at_most, below = code.passed()
    value, parent = stairs.state_value, stairs.state_parent
    falls = value < np.where(parent < 0, 0, stairs.node_value[parent])
    falls[parent < 0] = ~rises_first(model, code, value[parent < 0])
    at = np.flatnonzero(falls & (at_most[value] > below[value]))
    return np.stack([at, below[value[at]]])
