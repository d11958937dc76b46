"""Replicates of a calibration: parameters from the prior, data from them, a posterior, the rank of the truth in it; kept in chunks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import enable_x64
from hystfit.data.dataset import Dataset
from hystfit.inference.newton import maximize
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.priors import AbstractPrior, priors_around
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.models.storage import to_json
from hystfit.params.space import ParameterSpace
from hystfit.runs.chunks import claim, keep, load
from hystfit.runs.pool import computed
from hystfit.sampling.ensemble import start, walk
from hystfit.sampling.nuts import Tuning, advance
from hystfit.sampling.target import Target

Method = Literal["laplace", "nuts", "emcee"]
CHUNK = 10  # replicates in one compiled call and one file
RANKS = 79  # posterior draws among which the truth is ranked: eighty places, of which intervals of 90 and 95 % hold whole numbers
REASONS = {1: "the mode was not found", 2: "the posterior is not finite", 3: "its chunk broke"}
_THIN, _WARM, _DEPTH = 3, 60, 6  # of NUTS: transitions between two draws, for adaptation, and doublings at most
_AWAY = 3.0  # standard deviations of the places where its walkers begin: they must find the posterior by themselves


@dataclasses.dataclass(frozen=True)
class Study:
    """What is calibrated, ready to be sent to another process: `truth` is the noise that simulates, all else as for `calibrate`."""

    model: AbstractHysteresis
    data: Dataset
    truth: AbstractNoise
    assumed: str
    method: Method
    spread: float
    priors: Mapping[str, AbstractPrior]
    fix: tuple[str, ...]
    free: tuple[str, ...]
    tie: Mapping[str, str]
    seed: int


def typical_noise(name: str, problem: Problem) -> AbstractNoise:
    """A noise model of about 1 % of the output's half range."""
    return NOISES.find(name).of_size(0.01 * problem.scales.y)  # type: ignore[attr-defined]


class Spaces:
    """Parameter spaces, priors and the traced posterior, centered on these, of a study; its data are replaced.

    `shared` of the names of the inference have a true value and a posterior.
    """

    def __init__(self, study: Study):
        problem = Problem(study.model, study.data, fix=study.fix, free=study.free, tie=study.tie)
        same = NOISES.find(study.assumed) is type(study.truth)
        noise = study.truth if same else typical_noise(study.assumed, problem)
        model = problem.space
        assumed, self.truth = (ParameterSpace.of(n, scales=problem.scales) for n in (noise, study.truth))
        around = priors_around(model, model.vector(study.model), study.spread) | dict(study.priors)
        true_priors = priors_around(self.truth, self.truth.vector(study.truth), study.spread)
        # A wrong noise model has no true values: its priors are wide.
        noise_priors = true_priors if same else priors_around(assumed, assumed.vector(noise), 2.0)
        self.names = (*model.names, *assumed.names)
        # Least squares has no posterior of the noise's parameters, and a wrong noise model no true values for them.
        self.shared = np.arange(len(self.names) if same and study.method != "laplace" else len(model))
        problem = problem.with_noise(noise, around | noise_priors).trimmed()
        z = problem.unconstrained(np.concatenate([model.vector(study.model), assumed.vector(noise)]))
        self.target = Target.about(problem.density, jnp.asarray(z))
        take = lambda table, space: tuple(table[name] for name in space.names)
        self.true_priors = take(around, model) + take(true_priors, self.truth)


def run_chunk(study: Study, number: int) -> dict[str, np.ndarray]:
    """One chunk of replicates: ranks and errors, shape (chunk, parameters), and reasons for failure; runs in any process."""
    enable_x64()
    spaces = Spaces(study)
    keys = jax.random.split(jax.random.fold_in(jax.random.key(study.seed), number), CHUNK)
    setting = (spaces.target, spaces.truth.coordinates, spaces.true_priors)
    if study.method == "emcee":
        rows = [_by_emcee(*setting, key) for key in keys]
        ranks, errors, reason = (np.stack([np.asarray(row[k]) for row in rows]) for k in range(3))
    else:
        ranks, errors, reason = (np.asarray(v) for v in _replicates(*setting, keys, study.method))
    bad = ~np.isfinite(errors).all(axis=1) & (reason == 0)
    return {"ranks": ranks, "errors": errors, "reason": np.where(bad, 2, reason)}


def broken_chunk(study: Study) -> dict[str, np.ndarray]:
    """The result of a chunk that ended with an error: every replicate failed."""
    shape = (CHUNK, len(Spaces(study).names))
    return {"ranks": np.zeros(shape, int), "errors": np.full(shape, np.nan), "reason": np.full(CHUNK, 3)}


def _simulated(
    target: Target, truth: Any, priors: tuple[AbstractPrior, ...], key: Array
) -> tuple[Float[Array, " d"], Target]:
    """True parameters of model and noise, and the target with the data that they give."""
    first, second = jax.random.split(key)
    x = jnp.stack([p.sample(k) for p, k in zip(priors, jax.random.split(first, len(priors)), strict=True)])
    density = target.density
    noise = truth.assemble(x[density.p :])
    y = density.objective.predict(x[: density.p]) + noise.draw(density.setting, second)
    y = jnp.where(density.setting.weight > 0, y, 0.0)
    return x, eqx.tree_at(lambda t: t.density.objective.batch.y, target, y)


def _whitened(target: Target) -> tuple[Target, Array]:
    """The target centered on its mode, in the coordinates of the curvature there, and a reason for failure (0 for none)."""
    mode = maximize(target.log_density, target.center, target.slope, steps=40)
    size, axes = jnp.linalg.eigh(-mode.hessian)
    factor = axes / jnp.sqrt(jnp.maximum(size, 1e-4))
    return target.whitened(mode.z, factor), jnp.where(mode.converged, 0, 1)


def _ranked(x: Array, target: Target, q: Array) -> tuple[Array, Array]:
    """Ranks of the truth among draws, and errors in standard deviations; only the first columns of both mean the same."""
    draws = jax.vmap(target.physical)(q)
    d = min(x.shape[0], draws.shape[1])
    wide = jnp.zeros(draws.shape[1]).at[:d].set(x[:d])
    return jnp.sum(draws < wide, axis=0), (jnp.mean(draws, axis=0) - wide) / jnp.std(draws, axis=0)


@eqx.filter_jit
def _replicates(
    target: Target, truth: Any, priors: tuple[AbstractPrior, ...], keys: Array, method: str
) -> tuple[Array, Array, Array]:
    def one(key: Array) -> tuple[Array, ...]:
        first, second = jax.random.split(key)
        x, whitened = _simulated(target, truth, priors, first)
        whitened, reason = _whitened(whitened)
        normal = method == "laplace"
        q = jax.random.normal(second, (RANKS, whitened.center.shape[0])) if normal else _short_chain(whitened, second)
        return *_ranked(x, whitened, q), reason

    return jax.lax.map(one, keys)


def _short_chain(target: Target, key: Array) -> Float[Array, "draws d"]:
    """Thinned draws of a whitened NUTS chain from a draw of the Gaussian that whitening assumes."""
    first, second = jax.random.split(key)
    q, count = jax.random.normal(first, target.center.shape), _WARM + RANKS * _THIN
    out, _ = advance(target, q, Tuning.about(0.6), second, jnp.arange(count) < _WARM, jnp.asarray(0.8), _DEPTH, count)
    return out[0][_WARM + _THIN - 1 :: _THIN]


@eqx.filter_jit
def _prepared(target: Target, truth: Any, priors: tuple[AbstractPrior, ...], key: Array) -> tuple[Array, Target, Array]:
    x, whitened = _simulated(target, truth, priors, key)
    return x, *_whitened(whitened)


_rank = eqx.filter_jit(_ranked)


def _by_emcee(target: Target, truth: Any, priors: tuple[AbstractPrior, ...], key: Array) -> tuple[Array, Array, Array]:
    """One replicate; a draw is the last place of a walker, so that no draw follows from another."""
    x, whitened, reason = _prepared(target, truth, priors, key)
    d, seed = whitened.center.shape[0], int(jax.random.randint(key, (), 0, 2**31 - 1))
    first_state = start(whitened, RANKS + 1, seed, _AWAY)
    if not np.isfinite(first_state.log_prob).all():
        return jnp.zeros(d, int), jnp.full(d, jnp.nan), reason
    # The last place of each walker after 300 steps is a draw.
    last: Any = walk(whitened, RANKS + 1).run_mcmc(first_state, 300, skip_initial_state_check=True)
    return *_rank(x, whitened, jnp.asarray(last.coords[:RANKS])), reason


Chunk = dict[str, np.ndarray]


def collect(
    study: Study,
    count: int,
    folder: str | Path | None,
    workers: int,
    scheduler: str | None,
    progress: Callable[[str], None] | None,
) -> tuple[list[Chunk], list[str]]:
    """`count` chunks in order, and a sentence on each that broke, which is not kept, so that the same call tries it again."""
    place = None if folder is None else _claim(Path(folder), study)
    done = {} if place is None else {k: chunk for k in range(count) if (chunk := _load(_file(place, k))) is not None}
    missing = [k for k in range(count) if k not in done]
    broken = []
    for number, outcome in computed(partial(run_chunk, study), missing, workers, scheduler):
        k = missing[number]
        if isinstance(outcome, Exception):
            broken.append(f"chunk {k} broke: {type(outcome).__name__}: {outcome}")
            done[k] = broken_chunk(study)
        else:
            done[k] = outcome
            if place is not None:
                keep(_file(place, k), outcome)
        if progress:
            progress(f"{len(done)} of {count} chunks of {CHUNK} replicates")
    return [done[k] for k in sorted(done)], broken


def _file(place: Path, k: int) -> Path:
    return place / f"chunk-{k:05d}.npz"


def _load(file: Path) -> Chunk | None:
    """A stored chunk; None where there is none, or a damaged one."""
    outcome = load(file)
    return outcome if outcome is not None and set(outcome) == {"ranks", "errors", "reason"} else None


def _claim(folder: Path, study: Study) -> Path:
    """The folder of a study, new or of the same one."""
    values = {k: np.asarray(v).tolist() for k, v in vars(study.truth).items() if hasattr(v, "shape")}
    described = {k: getattr(study, k) for k in ("assumed", "method", "spread", "fix", "free", "seed")}
    priors = {k: v.exact() for k, v in study.priors.items()}
    described = {"model": to_json(study.model), "truth": [study.truth.name, values], "priors": priors, **described}
    return claim(folder, "study.json", described | {"inputs": [record.digest() for record in study.data]})
