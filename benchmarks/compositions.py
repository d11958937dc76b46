"""Speed of one scan per part of a composition against one scan over all parts."""

import time

import jax
import jax.numpy as jnp
import numpy as np

import hystfit as hf
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import make_model

SAMPLES, REPEATS = 4000, 9
MODELS = ("lag+bouc-wen", "bouc-wen+log-creep", "lag+prandtl-ishlinskii+creep", "lag+bouc-wen-asymmetric+log-creep")


def together(model: AbstractHysteresis, u: jax.Array, dt: jax.Array) -> jax.Array:
    """One scan over all parts."""
    return AbstractHysteresis.sweep(model, model.init(u[0]), u[0], u, dt)[1]


def apart(model: AbstractHysteresis, u: jax.Array, dt: jax.Array) -> jax.Array:
    """One scan per part, as in `simulate`."""
    return model.sweep(model.init(u[0]), u[0], u, dt)[1]


def milliseconds(run, x: jax.Array) -> float:
    jax.block_until_ready(run(x))
    times = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        jax.block_until_ready(run(x))
        times.append(time.perf_counter() - started)
    return 1e3 * min(times)


def main() -> None:
    hf.enable_x64()
    t = 0.01 * np.arange(SAMPLES)
    u = 20 + 20 * np.exp(-t / 60) * np.sin(2 * np.pi * t / 10)
    record = hf.Record(t=t, u=u, y=u + np.random.default_rng(0).normal(size=SAMPLES))
    print(f"{SAMPLES} samples\n{'model':<36} {'p':>3} {'run ms':>8} {'gain':>6} {'Jacobian ms':>12} {'gain':>6}")
    for name in MODELS:
        problem = Problem(make_model(name).start([record]), record)
        coordinates, x = problem.objective.coordinates, jnp.asarray(problem.space.vector([problem.model]))
        u, dt = problem.objective.batch.u[0], problem.objective.batch.dt[0]
        cost = []
        for way in (together, apart):
            predict = lambda x, way=way, u=u, dt=dt, c=coordinates: way(c.assemble(x, 0), u, dt)
            cost.append([milliseconds(jax.jit(f), x) for f in (predict, jax.jacfwd(predict))])
        (run_together, slope_together), (run, slope) = cost
        print(
            f"{name:<36} {len(x):>3} {run:>8.3f} {run_together / run:>6.1f} {slope:>12.3f} {slope_together / slope:>6.1f}"
        )


if __name__ == "__main__":
    main()
