"""Envelopes of a Prandtl-Ishlinskii model, and what its linear weights are multiplied by, in NumPy: a search over its terms compiles no
program.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from hystfit.errors import ModelError
from hystfit.quality.host_operators import play_positions

Envelope = Literal["identity", "square", "mirror"]


def envelope(kind: Envelope, x: Any) -> Any:
    """A rising function of x with 0 -> 0 and 1 -> 1, rising outside [0, 1] as well."""
    if kind == "identity":
        return x
    if kind == "square":
        return x * abs(x)
    return 1.0 - (1.0 - x) * abs(1.0 - x)


def envelope_slope(kind: Envelope, x: np.ndarray) -> np.ndarray:
    """Derivative of an envelope."""
    if kind == "identity":
        return np.ones_like(x)
    return 2.0 * np.abs(x if kind == "square" else 1.0 - x)


def play_thresholds(plays: int) -> Float[np.ndarray, " plays"]:
    """Thresholds 0.5 (j / (plays + 1))^2 [input ranges], j from 1: dense where loops are small.

    Raises:
        ModelError: fewer than one play.
    """
    if plays < 1:
        raise ModelError(f"at least one play is needed, got {plays}")
    return 0.5 * (np.arange(1, plays + 1) / (plays + 1)) ** 2


def play_columns(
    e: Float[np.ndarray, " T"], r: Float[np.ndarray, " plays"], rest: float | Float[np.ndarray, " plays"]
) -> Float[np.ndarray, "T plays"]:
    """Plays of half widths r driven by e, first at rest: between two turning points a play is max(e - r, last) or min(e + r, last)."""
    return play_positions(e, r, np.maximum(e[0] - r, np.minimum(e[0] + r, rest)))


def element_columns(
    e: Float[np.ndarray, " T"], r: Float[np.ndarray, " plays"], rest: float, operator: str
) -> Float[np.ndarray, "T plays"]:
    """Plays, or where `operator` is "stop" what they lag behind, see `play_columns`."""
    plays = play_columns(e, r, rest)
    return np.subtract(e[:, None], plays, out=plays) if operator == "stop" else plays


def fading(x: Float[np.ndarray, " T"], before: float, path: float) -> Float[np.ndarray, " T"]:
    """What is left of the hardening weights after the way run by x since it rested at `before`, which fade over `path`."""
    return np.exp(-np.cumsum(np.abs(np.diff(x, prepend=before))) / path)


def rising_columns(n: int, x: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T n"]:
    """`rising_series` of degree n for an increment of 1 in each coefficient alone."""
    within = np.clip(x, 0.0, 1.0)
    basis = [math.comb(n, k) * within**k * (1.0 - within) ** (n - k) for k in range(1, n + 1)]
    columns = np.cumsum(basis[::-1], axis=0)[::-1].T.copy()
    columns[:, -1] += n * np.maximum(x - 1.0, 0.0)
    columns[:, 0] += n * np.minimum(x, 0.0)
    return columns
