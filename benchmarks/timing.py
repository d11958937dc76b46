"""Times of several calls in one process: they alternate, so that other programs on the machine affect all equally."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any

import jax


def alternate(
    calls: Mapping[str, Callable[[], Any]],
    repeats: int,
    shortest: float = 0.01,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Median seconds of each call over rounds in which all take their turn, after one call each that compiles.

    Args:
        calls: by name; arrays of JAX that they return are waited for.
        repeats: number of rounds.
        shortest: time that one turn takes at least [s]: fast calls run several times a turn.
        clock: of the seconds; `time.process_time` counts all cores.
    """
    counts: dict[str, int] = {}
    for name, call in calls.items():
        jax.block_until_ready(call())
        begin = time.perf_counter()
        jax.block_until_ready(call())
        counts[name] = max(1, round(shortest / max(time.perf_counter() - begin, 1e-7)))
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            begin = clock()
            for _ in range(counts[name]):
                jax.block_until_ready(call())
            times[name].append((clock() - begin) / counts[name])
    return {name: statistics.median(values) for name, values in times.items()}
