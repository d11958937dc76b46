"""Smooth weights from normal equations: convex, bounded, the smoothness chosen on data left out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from hystfit.models.nonnegative import solve_nonnegative
from hystfit.models.preisach.equations import PreisachSystem

SMOOTHNESS = tuple(10.0**k for k in range(-9, 0))
_MANY = 1200  # parameters from which the choice of smoothness ignores bounds and leaves out two folds only: seconds, not minutes


@dataclasses.dataclass(frozen=True)
class SmoothFit:
    """Solution of a `PreisachSystem`.

    Attributes:
        weights: all p parameters, in output units; held ones as given.
        smoothness: strength of the penalty, relative to the number of samples.
        left_out: root mean square error on blocks left out, in parts of the output's range, for each strength tried.
        rss: sum of squared residuals, output units.
        penalty: what the penalty adds to the normal matrix, diagonal, in units of outputs / parameters, shape (p,).
    """

    weights: np.ndarray
    smoothness: float
    left_out: np.ndarray
    rss: float
    penalty: np.ndarray


def fit_smooth(
    system: PreisachSystem,
    strengths: Sequence[float] = SMOOTHNESS,
    *,
    held: np.ndarray | None = None,
) -> SmoothFit:
    """Solve for the weights, with the smoothness whose error on blocks left out in turn is smallest.

    Args:
        system: the equations.
        strengths: of the penalty to choose among; one value is taken as it is.
        held: values of parameters that are not fitted, NaN for the others, output units, shape (p,).
    """
    p = system.roughness.shape[0]
    held = np.full(p, np.nan) if held is None else held
    grams, free = _reduced(system, held)
    total, n = grams.sum(axis=0), system.counts.sum()
    rough, bounded = system.roughness[np.ix_(free, free)], system.bounded[free]
    trial = bounded if free.size <= _MANY else np.zeros_like(bounded)
    left_out = []
    starts: list[np.ndarray | None] = [None] * len(grams)
    judged = np.flatnonzero(system.judged)[: 2 if free.size > _MANY else None]
    for strength in strengths if len(strengths) > 1 else ():
        error = 0.0
        for k in judged:
            gram, count = grams[k], system.counts[k]
            near = starts[k] if starts[k] is not None else starts[judged[0]]
            v, starts[k] = _solve(total - gram, strength * (n - count) * rough, trial, near)
            r = np.append(-v, 1.0)
            error += max(float(r @ gram @ r), 0.0)
        left_out.append(np.sqrt(error / system.counts[judged].sum()))
        # Stiffer still only bends more: once the error has tripled, the choice is made.
        if left_out[-1] > 3 * min(left_out):
            break
    best = strengths[int(np.argmin(left_out))] if left_out else strengths[0]
    v, _ = _solve(total, best * n * rough, bounded, starts[judged[0]] if free.size <= _MANY else None)
    r = np.append(-v, 1.0)
    rss = max(float(r @ total @ r), 0.0) * system.size**2
    weights = held.copy()
    weights[free] = v * system.size
    return SmoothFit(weights, best, np.array(left_out), rss, best * n * np.diag(system.roughness))


def _reduced(system: PreisachSystem, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrices without the held parameters, whose part moves to the side of the output, and the free ones' positions."""
    free, fixed = np.flatnonzero(np.isnan(held)), np.flatnonzero(~np.isnan(held))
    if not fixed.size:
        return system.grams, free
    T = np.zeros((held.size + 1, free.size + 1))
    T[free, np.arange(free.size)] = 1.0
    T[fixed, -1] = -held[fixed] / system.size
    T[-1, -1] = 1.0
    return np.stack([T.T @ gram @ T for gram in system.grams]), free


def _solve(
    gram: np.ndarray, penalty: np.ndarray, bounded: np.ndarray, start: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    A = gram[:-1, :-1] + penalty
    A[np.diag_indices(len(A))] += 1e-12 * np.trace(A) / len(A)
    return solve_nonnegative(A, gram[:-1, -1], bounded, start)
