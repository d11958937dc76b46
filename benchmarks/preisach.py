"""Speed of the Preisach model by distinct states beside the relay scan: `python benchmarks/preisach.py [--quick]`."""

from __future__ import annotations

import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np
from rows import Row
from scipy.optimize import nnls

import hystfit as hf
from hystfit.models.preisach.design_matrix import features
from hystfit.models.preisach.model import Preisach
from hystfit.models.shared.nonnegative import solve_nonnegative


def signal(samples: int, noise: float) -> np.ndarray:
    t = np.linspace(0, 20, samples)
    return np.sin(2 * np.pi * t) * np.exp(-0.05 * t) + noise * np.random.default_rng(0).normal(size=samples)


def relays(n: int, elements: str = "relays") -> Preisach:
    count = n + (elements == "cells")
    w = np.random.default_rng(1).uniform(0, 1, n * (n + 1) // 2)
    return Preisach(w=w, levels=np.linspace(-1.05, 1.05, count), initial="negative", elements=elements)


def median_time(call, repeats: int) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def forward(n: int, samples: int, noise: float, repeats: int) -> dict[str, float]:
    model, u = relays(n), signal(samples, noise)
    np.testing.assert_allclose(model.free_run(u), hf.simulate(model, u)[0], atol=1e-9)
    return {
        "scan_ms": 1e3 * median_time(lambda: hf.simulate(model, jnp.asarray(u))[0], max(5, repeats // 4)),
        "run_ms": 1e3 * median_time(lambda: model.free_run(u), repeats),
    }


def fit(n: int, samples: int, repeats: int) -> dict[str, float]:
    model = relays(n)
    u = signal(samples, 0.0)
    A, index = features(model, u)
    y = (A @ np.asarray(model.w))[index] + np.random.default_rng(2).normal(0, 0.05, samples)
    dense = A[index]

    def by_states() -> np.ndarray:
        A, index = features(model, u)
        count = np.bincount(index)
        mean = np.bincount(index, y) / count
        root = np.sqrt(count)
        return nnls(A * root[:, None], mean * root, maxiter=100 * A.shape[1])[0]

    def by_pivoting() -> np.ndarray:
        A, index = features(model, u)
        gram = A.T @ (A * np.bincount(index)[:, None])
        gram[np.diag_indices(len(gram))] += 1e-10 * np.trace(gram) / len(gram)
        return solve_nonnegative(gram, A.T @ np.bincount(index, y), np.ones(len(gram), dtype=bool))[0]

    cost = lambda w: float(np.sum((dense @ w - y) ** 2))
    ours, theirs, pivot = by_states(), nnls(dense, y, maxiter=100 * dense.shape[1])[0], by_pivoting()
    slow = median_time(lambda: nnls(dense, y, maxiter=100 * dense.shape[1])[0], max(5, repeats // 4))
    fast = median_time(by_states, repeats)
    return {
        "dense_ms": 1e3 * slow,
        "states_ms": 1e3 * fast,
        "pivoting_ms": 1e3 * median_time(by_pivoting, repeats),
        "nnls": slow / fast,
        "objective_ratio": cost(ours) / cost(theirs),
        "pivoting_objective_ratio": cost(pivot) / cost(theirs),
    }


def measure(quick: bool) -> list[Row]:
    """Rows of the suite."""
    samples, repeats, n = (2_000, 1, 10) if quick else (100_000, 11, 100)
    rows, count = [], n * (n + 1) // 2
    for noise, words in ((0.0, "clean"), (0.01, "noisy")):
        found = forward(n, samples, noise, repeats)
        rows.append(
            _row(f"Preisach, {count} relays, {words}, by states / relay scan", found["run_ms"], found["scan_ms"])
        )
    found = fit(5 if quick else 20, samples // 10, repeats)
    rows.append(_row("Preisach, weights >= 0 / scipy nnls on all samples", found["states_ms"], found["dense_ms"]))
    return rows


def _row(name: str, ours_ms: float, peer_ms: float) -> Row:
    return Row(name, 1e-3 * ours_ms, 1e-3 * peer_ms)


if __name__ == "__main__":
    from run import alone

    alone("preisach")
