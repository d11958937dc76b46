"""Bands of 90 % of Preisach weights over simulated loops that were not fitted, see run.py.

Each device has loops of three to five amplitudes, spread at random over a decade. One of them, not the largest, is left out and predicted
from the others. The truth is in the model (weights drawn from its prior on the same levels), or it is not: a smooth density on a grid four
times as fine, a Bouc-Wen and a Jiles-Atherton model, both at random.
"""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from common import Results, table

import hystfit as hf
from hystfit.inference.problem import Problem
from hystfit.inference.weights import smoothness_penalty
from hystfit.models import JilesAtherton, Preisach
from hystfit.sampling.truncated_normal import draw_truncated

DEVICES, BAND, COUNT = 16, 0.9, 400
STEPS = 128  # samples of a cycle
NOISE = 1e-3  # standard deviation of white and of slow noise, over the largest output
FORM, OWN = "preisach:n=16:spacing=steep", "preisach:n=12:spacing=uniform"
HEAD = ["truth", "model", "devices", "samples of the loop in its band, %"]
Response = Callable[[np.ndarray], np.ndarray]


def prior_weights(rng: np.random.Generator) -> Response:
    """Weights from the prior of the smooth model on uniform levels."""
    span = hf.Record(u=np.cos(np.linspace(0, 7, 200)), y=np.cos(np.linspace(0, 7, 200)))
    problem = Problem(Preisach.of(12, spacing="uniform", reversible=False).start([span]), span)
    rough = smoothness_penalty(problem.space, [span], problem.space.vector(problem.model))
    at = np.flatnonzero(np.diag(rough))
    w, keys = jnp.ones(at.size), jax.random.split(jax.random.key(int(rng.integers(2**31))), 40)
    move = lambda w, key: (
        draw_truncated(key, w, jnp.zeros(at.size), jnp.asarray(rough[np.ix_(at, at)]), jnp.full(at.size, True), 3)[-1],
        None,
    )
    w = jax.lax.scan(move, w, keys)[0]
    model = eqx.tree_at(lambda m: m.w, problem.model, w / w.sum())
    return lambda u: np.asarray(model.free_run(u))


def fine_density(rng: np.random.Generator) -> Response:
    """A log-normal density of coercivities, normal in the interaction field, on a fine grid."""
    span = hf.Record(u=np.cos(np.linspace(0, 7, 200)), y=np.cos(np.linspace(0, 7, 200)))
    model = Preisach.of(60, spacing="uniform", symmetric=False).start([span])
    centers = 0.5 * (model.levels[1:] + model.levels[:-1])
    i, j = np.tril_indices(60)
    half, middle = 0.5 * (centers[i] - centers[j]), 0.5 * (centers[i] + centers[j])
    coercivity, spread, field = rng.uniform(0.05, 0.4), rng.uniform(0.3, 1.0), rng.uniform(0.05, 0.3)
    w = np.exp(-0.5 * (np.log(np.maximum(half, 1e-3) / coercivity) / spread) ** 2 - 0.5 * (middle / field) ** 2)
    model = eqx.tree_at(lambda m: m.w, model, jnp.asarray(w / w.sum()))
    return lambda u: np.asarray(model.free_run(u))


def bouc_wen(rng: np.random.Generator) -> Response:
    """A Bouc-Wen model."""
    model = hf.BoucWen(c=1.0, mu=rng.uniform(0.1, 0.8), tau=rng.uniform(1, 8), rho=rng.uniform(0, 0.8))
    return lambda u: np.asarray(hf.simulate(model, u)[0])


def jiles_atherton(rng: np.random.Generator) -> Response:
    """A Jiles-Atherton model."""
    law = {"a": rng.uniform(0.08, 0.3), "coupling": rng.uniform(0, 0.8), "k": rng.uniform(0.05, 0.3)}
    model = JilesAtherton(Ms=1.0, c=rng.uniform(0.05, 0.4), **law)
    return lambda u: np.asarray(hf.simulate(model, u)[0])


TRUTHS = {"in the model": (prior_weights, OWN), "a finer density": (fine_density, FORM), "Bouc-Wen": (bouc_wen, FORM),
          "Jiles-Atherton": (jiles_atherton, FORM)}  # fmt: skip


def simulated_loops(results: Results) -> str:
    """A table of the truths."""
    rows = []
    for name, (truth, form) in TRUTHS.items():
        inside = 100 * float(np.mean([_covered(truth, form, seed) for seed in range(DEVICES)]))
        results.add(f"simulated loops, {name}: bands of 90 % cover, %", inside)
        rows.append([name, form, DEVICES, inside])
    return table(HEAD, rows)


def _covered(truth: Callable[[np.random.Generator], Response], form: str, seed: int) -> float:
    """Part of the samples of a loop inside its band."""
    rng = np.random.default_rng(seed)
    response, number = truth(rng), int(rng.integers(3, 6))
    amplitudes = np.append(np.sort(np.exp(rng.uniform(np.log(0.08), np.log(0.9), number - 1))), 1.0)
    cycles, loops = np.cos(np.linspace(0, 4 * np.pi, 2 * STEPS + 1)), []
    size = float(np.ptp(response(cycles)))
    for amplitude in amplitudes:
        slow = np.zeros(STEPS + 1)
        for k in range(1, STEPS + 1):
            slow[k] = 0.9 * slow[k - 1] + np.sqrt(1 - 0.9**2) * rng.normal()
        y = response(amplitude * cycles)[STEPS:] + NOISE * size * (slow + rng.normal(size=STEPS + 1))
        loops.append(hf.Record(u=amplitude * cycles[STEPS:], y=y, name=f"{amplitude:.3f}"))
    left = loops.pop(int(rng.integers(number - 1)))
    posterior = hf.sample(hf.fit(form, loops), "weights", chains=2, draws=200, extend=1)
    low, _, high = posterior.bands(left, BAND, COUNT)
    return float(np.mean((left.y >= low) & (left.y <= high)))
