"""Time of the unscented filter against filterpy and a numba loop on one problem: n = 8 (two states, six parameters), 1e4 samples.

All filters use the same model, sigma points and covariances, and their estimates are compared before they are timed.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rows import Row, beside
from timing import alternate
from ukf_loop import loop

from hystfit import BoucWen, LinearCreep, Sum
from hystfit.identify import Sample
from hystfit.identify.base import run_stream
from hystfit.identify.ukf import Ukf
from hystfit.stage import Actuator


def problem(samples: int) -> tuple[Any, Any]:
    """A record of hysteresis with one relaxation, and a filter started off the truth."""
    t = np.arange(samples) / 1000.0
    u = 40 + 60 * (0.55 + 0.45 * np.cos(2 * np.pi * t / 6.7)) * np.sin(2 * np.pi * t)
    truth = Sum(BoucWen(c=0.1542, mu=0.45, tau=0.01086, rho=0.88), LinearCreep(a=(0.3,), tau=(1.0,), high=100.0))
    record = Actuator(model=truth).record(t, u, seed=0)
    start = Sum(BoucWen(c=0.17, mu=0.4, tau=0.012, rho=0.8), LinearCreep(a=(0.2,), tau=(1.0,), high=100.0))
    return record, Ukf.of(start, record, start="model", noise=0.005, caution=0.0)


def peer(ukf: Any, record: Any) -> Any:
    """filterpy on the same model in plain Python, returning a function that runs it chunk by chunk.

    filterpy draws new sigma points before the update; ours reads the outputs off the propagated ones. It is given those
    back, so that the answers agree; the work of the drawing stays in its time.
    """
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    c = ukf.coordinates
    lower, upper, scale = (np.asarray(v).tolist() for v in (c.lower, c.upper, c.scale))
    kinds = c.kinds

    def physical(z: list[float]) -> list[float]:
        rows = zip(z, lower, upper, scale, kinds, strict=True)
        make = (
            lambda z, low, high, scale: scale * z,
            lambda z, low, high, scale: low + scale * math.exp(z),
            lambda z, low, high, scale: high - scale * math.exp(z),
            lambda z, low, high, scale: low + (high - low) / (1 + math.exp(-z)),
        )
        return [make[kind](z, low, high, scale) for z, low, high, scale, kind in rows]

    moved: list[np.ndarray] = []
    decay = -math.expm1(-0.001 / 1.0)

    def move(point: np.ndarray, dt: float, u0: float, u1: float) -> np.ndarray:
        h, creep, *z = point.tolist()
        slope, mu, tau, rho, _, _ = physical(z)
        dv = u1 - u0
        s = -1.0 if dv < 0 else 1.0
        q = s * h
        limit = mu * slope
        below = min(-q / limit, abs(dv)) if q < 0 else 0.0
        half = 0.5 * tau * ((1 + rho) * abs(dv) - 2 * rho * below)
        h = s * ((1 - half) * q + limit * abs(dv)) / (1 + half)
        creep += (decay if dt > 0 else 0.0) * (u1 / 100.0 - creep)
        moved.append(np.array([h, creep, *z]))
        return moved[-1]

    def read(point: np.ndarray, u1: float) -> np.ndarray:
        h, creep, *z = point.tolist()
        slope, _, _, _, offset, weight = physical(z)
        return np.array([offset + slope * u1 - h + weight * creep])

    def run(chunk: int) -> Iterator[np.ndarray]:
        state = ukf.restart(ukf.init(), jnp.asarray(record.u[0]))
        n = ukf.scheme.n
        points = MerweScaledSigmaPoints(n, ukf.scheme.alpha, ukf.scheme.beta, ukf.scheme.kappa)
        f = UnscentedKalmanFilter(n, 1, 1.0, read, move, points)
        f.x, f.P = np.asarray(state.mean), np.asarray(state.root @ state.root.T)
        f.R, f.Q = np.array([[float(ukf.noise) ** 2]]), np.diag(np.asarray(ukf.walk) ** 2)
        before = record.u[0]
        rows = zip(record.u.tolist(), record.y.tolist(), record.dt.tolist(), strict=True)
        for count, (u, y, dt) in enumerate(rows, start=1):
            f.predict(dt=dt, u0=before, u1=u)
            f.sigmas_f = np.array(moved[-2 * n - 1 :])
            moved.clear()
            f.update(np.array([y]), u1=u)
            before = u
            if count % chunk == 0:
                yield f.x

    return run


def compare(samples: int = 10_000, chunks: int = 10) -> dict[str, float]:
    """Median times and their ratio: filterpy goes in chunks, and all of our run stands between each two of them."""
    record, ukf = problem(samples)
    stream, state = Sample.stream([record]), ukf.init()
    ours = lambda: jax.block_until_ready(run_stream(ukf, state, stream))
    begin = time.perf_counter()
    answer = ours()[0].mean
    compile_s = time.perf_counter() - begin
    fast: list[float] = []
    slow: list[float] = []
    theirs = peer(ukf, record)(samples // chunks)
    busy: dict[str, list[float]] = {"ours": [], "theirs": []}  # processor time, which other programs disturb less
    for _ in range(chunks):
        begin, work = time.perf_counter(), time.process_time()
        final = next(theirs)
        slow.append(chunks * (time.perf_counter() - begin))
        busy["theirs"].append(chunks * (time.process_time() - work))
        for _ in range(2):
            begin, work = time.perf_counter(), time.process_time()
            ours()
            fast.append(time.perf_counter() - begin)
            busy["ours"].append(time.process_time() - work)
    mean = statistics.median
    return {
        "samples": samples,
        "us_per_sample": 1e6 * mean(fast) / samples,
        "us_per_sample_best": 1e6 * min(fast) / samples,
        "us_per_sample_filterpy": 1e6 * mean(slow) / samples,
        "ratio": mean(slow) / mean(fast),
        "ratio_of_best": min(slow) / min(fast),
        "processor_us_per_sample": 1e6 * mean(busy["ours"]) / samples,
        "processor_us_per_sample_filterpy": 1e6 * mean(busy["theirs"]) / samples,
        "processor_ratio": mean(busy["theirs"]) / mean(busy["ours"]),
        "compile_s": compile_s,
        "largest_difference": float(np.max(np.abs(np.asarray(answer) - final))),
    }


def beside_numba(samples: int, repeats: int) -> list[Row]:
    """The filter beside a numba loop, whose final mean must be the same.

    Raises:
        RuntimeError: it is another one.
    """
    record, ukf = problem(samples)
    stream, state, plain = Sample.stream([record]), ukf.init(), loop(ukf, record)
    ours = lambda: run_stream(ukf, state, stream)
    if not np.allclose(ours()[0].mean, plain(), rtol=0, atol=1e-9):
        raise RuntimeError(f"two filters, two answers: {ours()[0].mean} and {plain()}")
    times = alternate({"hystfit": ours, "numba": plain}, repeats)
    return beside(times, f"unscented filter, n = 8, {samples} samples")


def measure(quick: bool) -> list[Row]:
    """Rows of the suite."""
    samples = 200 if quick else 10_000
    row = compare(samples)
    ours, theirs = (1e-6 * samples * row[name] for name in ("us_per_sample", "us_per_sample_filterpy"))
    name = f"unscented filter, n = 8, {samples} samples / filterpy"
    return [Row(name, ours, theirs), *beside_numba(samples, 3 if quick else 25)]


if __name__ == "__main__":
    from run import alone

    alone("ukf")
