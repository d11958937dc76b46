"""Simulation-based calibration (Talts et al. 2018, arXiv 1804.06788) of the sampler of linear weights, see run.py."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import kstest

import hystfit as hf
from hystfit import priors
from hystfit.inference.problem import Problem
from hystfit.models import Preisach
from hystfit.sampling.noise_grid import NoiseGrid
from hystfit.sampling.truncated_normal import draw_truncated
from hystfit.sampling.weight_equations import WeightEquations, weight_equations
from hystfit.sampling.weight_sampler import state_at, sweep

TURNS, STEPS = 20, 12  # of the input, and samples between them
WARMUP, KEPT, THIN = 60, 99, 4  # sweeps, draws that are ranked, sweeps between them
NOISE, SPREAD = 0.02, 0.5  # median and spread of the logarithm of the noise's standard deviation


def calibration(n: int, simulations: int) -> dict[str, float]:
    """Ranks of true weights, noise and smoothness among their draws, where the truths come from the priors.

    Args:
        n: levels along an axis of a Preisach model whose mirror images share a weight.
        simulations: number of data sets.

    Returns:
        Coverage of 90 % intervals over all weights [%], and the smallest p-value of uniform ranks times their number.
    """
    rng = np.random.default_rng(n)
    turns = np.concatenate([[0.0, 1.0, -1.0], rng.uniform(-1, 1, TURNS)])
    u = np.concatenate([np.linspace(a, b, STEPS, endpoint=False) for a, b in itertools.pairwise(turns)])
    model = Preisach.of(n, symmetric=True, reversible=False).start([hf.Record(u=u, y=u)])
    problem = Problem(model, hf.Record(u=u, y=u))
    x = problem.space.vector(problem.model)
    residual, jacobian = problem.linearize(x)
    columns = jnp.asarray(jacobian[0][: u.size])
    rest = jnp.asarray(residual[0][: u.size] + problem.data[0].y) - columns @ x
    prior = {"offset": priors.Normal(0.0, 0.5)}
    equations = weight_equations(problem, x, NoiseGrid.one(), prior, 1.0)
    keys = jax.random.split(jax.random.key(n), simulations)
    ranks = np.array([np.asarray(_ranks(equations, columns, rest, key)) for key in keys])
    share = (ranks + 0.5) / (KEPT + 1)
    p_values = [
        kstest(column + rng.uniform(-0.5, 0.5, simulations) / (KEPT + 1), "uniform").pvalue for column in share.T
    ]
    inside = (share > 0.05) & (share < 0.95)
    return {"coverage": 100 * float(inside[:, :-2].mean()), "p": min(1.0, len(p_values) * min(p_values))}


@jax.jit
def _ranks(equations: WeightEquations, columns: Any, rest: Any, key: Any) -> Any:
    """Ranks of the true weights, the logarithm of the noise and that of the penalty's strength, shape (p + 2,)."""
    keys = jax.random.split(key, 7)
    p, bounded = equations.bounded.size, equations.bounded
    scale = jnp.abs(jnp.tan(jnp.pi * (jax.random.uniform(keys[0]) - 0.5))) / equations.penalized
    precision = equations.roughness / scale**2 + jnp.diag(equations.precision)
    move = lambda w, key: (draw_truncated(key, w, jnp.zeros(p), precision, bounded)[-1], None)
    w = jax.lax.scan(move, jnp.full(p, scale), jax.random.split(keys[1], 100))[0]
    sigma = NOISE * jnp.exp(SPREAD * jax.random.normal(keys[2]))
    y = rest + columns @ w + sigma * jax.random.normal(keys[3], rest.shape)
    r = rest + columns @ equations.estimate - y
    own = dataclasses.replace(equations, squares=(r @ r)[None], slopes=(columns.T @ r)[None])
    start = state_at(jnp.full(p, 1.0 / p), jnp.zeros((), int), r @ r / r.size, equations.penalized**2)
    once = lambda state, key: (new := sweep(own, state, key), new)
    after = jax.lax.scan(once, start, jax.random.split(keys[4], WARMUP))[0]
    draws = jax.lax.scan(once, after, jax.random.split(keys[5], THIN * KEPT))[1]
    found = jnp.column_stack([draws["w"], 0.5 * jnp.log(draws["variance"]), jnp.log(draws["strength"])])[
        THIN - 1 :: THIN
    ]
    truth = jnp.concatenate([w, jnp.array([jnp.log(sigma), -2 * jnp.log(scale)])])
    return jnp.sum(found < truth, axis=0)
