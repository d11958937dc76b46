"""Self-similar stops without their terms for slip: what pinched loops are told apart by."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from hystfit.data.record import Record
from hystfit.fitting.ridge import LinearSystem, linear_positions
from hystfit.inference.problem import Problem
from hystfit.models.self_similar import POWERS

_BENT = [power for power in POWERS if power > 1]


def without_slip(problem: Problem) -> LinearSystem:
    """The linear system of self-similar stops whose branches at one peak can only soften.

    A pinched branch is soft near zero input and stiffens towards the last peak: the device slips until the gap of the last peak is
    closed. Stops do so by negative weights, and self-similar stops by powers of u over its peak too. Here the weights of the stops are
    >= 0, and the powers above one are of u itself: a spring that hardens makes no slip that grows with the peak.

    Args:
        problem: of `SelfSimilarStops` alone.
    """
    system = LinearSystem.of(problem, problem.space.vector(problem.model))
    names = [problem.space.names[k] for k in linear_positions(problem)]
    stops, powers = problem.model.w.shape[-1], len(POWERS)
    bent = {f"c[{peak},{k}]" for peak in range(problem.model.peaks.size) for k in range(1, powers)}
    bent |= {f"fading[{stops + k}]" for k in range(1, powers)}
    kept = np.array([name not in bent for name in names])
    softening = np.array([name.startswith("w[") for name in names])
    spring = _spring(list(problem.data))
    added = np.ones(spring.shape[1], dtype=bool)
    return dataclasses.replace(
        system,
        columns=np.hstack([system.columns[:, kept], spring]),
        free=np.append((system.free & ~softening)[kept], added),
        ridged=np.append(system.ridged[kept], added),
    )


def _spring(records: Sequence[Record]) -> np.ndarray:
    """Odd powers of the input over its largest value, weighted, on the samples that count, shape (n, powers)."""
    largest = max(float(np.max(np.abs(record.u))) for record in records)
    places = ((record.u[record.used] / largest, record.weight[record.used]) for record in records)
    return np.concatenate([np.sqrt(weight)[:, None] * v[:, None] ** np.array(_BENT) for v, weight in places])
