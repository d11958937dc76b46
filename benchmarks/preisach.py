"""Speed of the compiled Preisach forms beside the relay scan: `python benchmarks/preisach.py [--quick]`."""

from __future__ import annotations

import statistics
import time
import tracemalloc

import jax
import jax.numpy as jnp
import numpy as np
from rows import Row
from scipy.optimize import nnls

import hystfit as hf
from hystfit.models.nonnegative import solve_nonnegative
from hystfit.models.preisach.compiled import compile_for, respond
from hystfit.models.preisach.design_matrix import features
from hystfit.models.preisach.model import Preisach

MEMORY_MB = 150  # most that a gradient by 20100 weights may take


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
    model, u = relays(n), jnp.asarray(signal(samples, noise))
    compiled = compile_for(model, np.asarray(u))
    np.testing.assert_allclose(respond(model, compiled), hf.simulate(model, u)[0], atol=1e-9)
    cells = relays(n, "cells")
    cell_input = compile_for(cells, np.asarray(u))
    respond(cells, cell_input)

    def first() -> jax.Array:
        return respond(model, compile_for(model, np.asarray(u)))

    scan = median_time(lambda: hf.simulate(model, u)[0], max(5, repeats // 4))
    return {
        "scan_ms": 1e3 * scan,
        "warm_ms": 1e3 * (warm := median_time(lambda: respond(model, compiled), 4 * repeats)),
        "with_host_ms": 1e3 * (host := median_time(first, repeats)),
        "cells_warm_ms": 1e3 * median_time(lambda: respond(cells, cell_input), repeats),
        "cells_host_ms": 1e3 * median_time(lambda: compile_for(cells, np.asarray(u)).index, repeats),
        "forward": scan / warm,
        "first_call": scan / host,
        "states": int(compiled.parent.size),
    }


def gradient(n: int, samples: int, repeats: int) -> dict[str, float]:
    model, u = relays(n), jnp.asarray(signal(samples, 0.0))
    compiled = compile_for(model, np.asarray(u))
    y = jnp.sin(jnp.arange(samples))

    def with_weights(w):
        return Preisach(w=w, levels=model.levels, initial="negative", elements="relays")

    def loss(run):
        return jax.jit(jax.grad(lambda w, data: jnp.sum((run(with_weights(w), data) - y) ** 2)))

    slow, fast = loss(lambda m, u: hf.simulate(m, u)[0]), loss(respond)
    np.testing.assert_allclose(fast(model.w, compiled), slow(model.w, u), rtol=1e-7)
    scan = median_time(lambda: slow(model.w, u), max(5, repeats // 4))
    look_up = median_time(lambda: fast(model.w, compiled), 4 * repeats)
    return {"scan_ms": 1e3 * scan, "look_up_ms": 1e3 * look_up, "gradient": scan / look_up}


def memory(n: int, samples: int) -> dict[str, float]:
    model, u = relays(n), signal(samples, 0.01)
    tracemalloc.start()
    compiled = compile_for(model, u)
    host = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    grad = jax.jit(jax.grad(lambda m, c: jnp.sum(respond(m, c) ** 2), allow_int=True))
    plan = grad.lower(model, compiled).compile().memory_analysis()
    arrays = sum(leaf.nbytes for leaf in jax.tree.leaves(compiled))
    assert plan is not None
    temporary = plan.temp_size_in_bytes
    return {
        "host_mb": host / 1e6,
        "arrays_mb": arrays / 1e6,
        "xla_mb": temporary / 1e6,
        "memory_mb": (host + arrays + temporary) / 1e6,
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
    """Rows of the suite, the compiled forms as "hystfit"; the memory of a gradient is limited here."""
    samples, repeats, n = (2_000, 1, 10) if quick else (100_000, 11, 100)
    rows, count = [], n * (n + 1) // 2
    for noise, words in ((0.0, "clean"), (0.01, "noisy")):
        found = forward(n, samples, noise, repeats)
        for key, kind in (("warm_ms", "compiled input"), ("with_host_ms", "with compiling the input")):
            rows.append(_row(f"Preisach, {count} relays, {words}, {kind} / relay scan", found[key], found["scan_ms"]))
    found = gradient(n, samples // 10, repeats)
    rows.append(_row(f"Preisach, gradient by {count} weights / relay scan", found["look_up_ms"], found["scan_ms"]))
    found = fit(5 if quick else 20, samples // 10, repeats)
    rows.append(_row("Preisach, weights >= 0 / scipy nnls on all samples", found["states_ms"], found["dense_ms"]))
    used = memory(2 * n, samples)["memory_mb"]
    if not quick and used > MEMORY_MB:
        raise SystemExit(f"the gradient by 20100 weights takes {used:.0f} MB; the limit is {MEMORY_MB} MB")
    return rows


def _row(name: str, ours_ms: float, peer_ms: float) -> Row:
    return Row(name, 1e-3 * ours_ms, 1e-3 * peer_ms)


if __name__ == "__main__":
    from run import alone

    alone("preisach")
