"""Speed of one scan per part of a composition against one scan over all parts."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rows import Row, beside
from timing import alternate

import hystfit as hf
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import make_model

MODELS = ("lag+bouc-wen", "bouc-wen+log-creep", "lag+prandtl-ishlinskii+creep", "lag+bouc-wen-asymmetric+log-creep")


def together(model: AbstractHysteresis, u: jax.Array, dt: jax.Array) -> jax.Array:
    """One scan over all parts."""
    return AbstractHysteresis.sweep(model, model.init(u[0]), u[0], u, dt)[1]


def apart(model: AbstractHysteresis, u: jax.Array, dt: jax.Array) -> jax.Array:
    """One scan per part, as in `simulate`."""
    return model.sweep(model.init(u[0]), u[0], u, dt)[1]


def measure(quick: bool) -> list[Row]:
    """Rows of the suite: output, and output with its Jacobian, one scan per part as "hystfit"."""
    samples, repeats = (200, 1) if quick else (4_000, 15)
    t = 0.01 * np.arange(samples)
    u = 20 + 20 * np.exp(-t / 60) * np.sin(2 * np.pi * t / 10)
    record = hf.Record(t=t, u=u, y=u + np.random.default_rng(0).normal(size=samples))
    rows = []
    for name in MODELS[:1] if quick else MODELS:
        problem = Problem(make_model(name).start([record]), record)
        x = jnp.asarray(problem.space.vector([problem.model]))
        for kind, change in (("output", lambda f: f), ("Jacobian", jax.jacfwd)):
            calls = {words: partial(_compiled(way, change, problem), x) for words, way in WAYS.items()}
            rows += beside(alternate(calls, repeats), f"{name}, {kind}")
    return rows


WAYS = {"hystfit": apart, "one scan over all parts": together}


def _compiled(way: Callable[..., jax.Array], change: Callable[..., Any], problem: Problem) -> Callable[..., Any]:
    objective = problem.objective
    u, dt = objective.batch.u[0], objective.batch.dt[0]
    return jax.jit(change(lambda x: way(objective.coordinates.assemble(x, 0), u, dt)))


if __name__ == "__main__":
    from run import alone

    alone("compositions")
