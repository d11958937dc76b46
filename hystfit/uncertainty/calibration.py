"""Simulation-based calibration (Talts et al. 2018) and coverage of one's own set-up: do the error bars hold what they promise?

Parameters are drawn from the prior, data simulated with a noise model, the posterior found, and the rank of the truth
among its draws noted. If all is right the ranks are uniform. With another noise model assumed than the true one, the same
study measures misspecification.
"""

from __future__ import annotations

import concurrent.futures
import dataclasses
import json
import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.stats import binom

from hystfit.config import enable_x64, require_x64
from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError, MissingExtraError, ParameterError
from hystfit.fitting.newton import maximize
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import make_model, model_name
from hystfit.noise import AbstractNoise, Setting, make_noise
from hystfit.params import ParameterSpace
from hystfit.priors import AbstractPrior, priors_around
from hystfit.problem import Problem
from hystfit.sampling.posterior import Target, trimmed

SCHEMA = "hystfit.calibrate/1"
_CHUNK = 10  # replicates in one compiled call and one file
RANKS = 79  # posterior draws among which the truth is ranked: eighty places, of which intervals of 90 and 95 % hold whole numbers
_THIN = {"nuts": 5, "emcee": 40}
_WARM = 100


@dataclasses.dataclass(frozen=True)
class Study:
    """What is calibrated, ready to be sent to another process.

    Attributes:
        model: whose present values center the priors.
        data: records that give inputs, times and weights; their outputs are replaced.
        truth: the noise that simulates, with values.
        assumed: name of the noise model of the inference.
        method: "laplace" (curvature at the mode: least squares), "nuts" or "emcee".
        spread: relative width of the priors.
        priors: the user's own, by name.
        fix: parameters held.
        seed: of everything.
    """

    model: AbstractHysteresis
    data: Dataset
    truth: AbstractNoise
    assumed: str
    method: Literal["laplace", "nuts", "emcee"]
    spread: float
    priors: Mapping[str, AbstractPrior]
    fix: tuple[str, ...]
    seed: int


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Ranks of the truth among posterior draws.

    Attributes:
        names: of the parameters ranked.
        ranks: shape (replicates, parameters), 0 to `of`; failed replicates left out.
        of: number of posterior draws.
        errors: posterior mean less truth, in posterior standard deviations, same shape.
        failures: (replicate, reason) of those that failed.
        method, truth, assumed: see `Study`.
        model: name.
    """

    names: tuple[str, ...]
    ranks: np.ndarray
    of: int
    errors: np.ndarray
    failures: tuple[tuple[int, str], ...]
    method: str
    truth: str
    assumed: str
    model: str

    def p_values(self) -> np.ndarray:
        """Uniformity of the ranks by the largest distance of their ECDF from the straight line; small means miscalibrated."""
        n = len(self.ranks)
        distance = lambda ranks: np.abs(_ecdf(ranks, self.of) - np.arange(1, self.of + 1) / (self.of + 1)).max(axis=-1)
        rng = np.random.default_rng(0)
        ideal = distance(rng.integers(0, self.of + 1, (4000, n)))
        return np.array([(1 + np.sum(ideal >= distance(row[None])[0])) / 4001 for row in self.ranks.T])

    def coverage(self, level: float = 0.95) -> np.ndarray:
        """Part of the replicates whose central interval of this level holds the truth, by parameter."""
        place = (self.ranks + 0.5) / (self.of + 1)
        return np.mean(np.abs(place - 0.5) < 0.5 * level, axis=0)

    def coverage_band(self, level: float = 0.95, confidence: float = 0.99) -> tuple[float, float]:
        """Between which a right coverage lies by chance."""
        n = len(self.ranks)
        exact = np.sum(np.abs((np.arange(self.of + 1) + 0.5) / (self.of + 1) - 0.5) < 0.5 * level) / (self.of + 1)
        low, high = binom.ppf([0.5 - confidence / 2, 0.5 + confidence / 2], n, exact) / n
        return float(low), float(high)

    def passes(self, false_alarm: float = 0.01) -> bool:
        """No parameter's ranks are less uniform than chance allows at this rate for the whole study; failures stay below 5 %."""
        enough = len(self.failures) <= 0.05 * (len(self.ranks) + len(self.failures))
        return bool(enough and len(self.ranks) > 0 and self.p_values().min() * len(self.names) > false_alarm)

    @property
    def status(self) -> str:
        """ "ok" or "miscalibrated"."""
        return "ok" if self.passes() else "miscalibrated"

    def __str__(self) -> str:
        low, high = self.coverage_band()
        lines = [
            f"{self.model}, noise {self.truth}, assumed {self.assumed}, {self.method}: {len(self.ranks)} replicates, "
            f"{len(self.failures)} failed: {self.status}",
            f"95 % intervals should cover {low:.1%} to {high:.1%}",
            f"{'':12} {'p':>8} {'covered':>8}",
        ]
        rows = zip(self.names, self.p_values(), self.coverage(), strict=True)
        lines += [f"{name:12} {p:8.4f} {c:8.1%}" for name, p, c in rows]
        return "\n".join(lines + [f"replicate {k} failed: {why}" for k, why in self.failures[:10]])

    def to_dict(self) -> dict[str, Any]:
        """The contents of `result.json`."""
        p = self.p_values() if len(self.ranks) else [None] * len(self.names)
        c = self.coverage() if len(self.ranks) else [None] * len(self.names)
        rows = {
            n: {"p": None if a is None else float(a), "coverage95": None if b is None else float(b)}
            for n, a, b in zip(self.names, p, c, strict=True)
        }
        own = {k: getattr(self, k) for k in ("model", "status", "truth", "assumed", "method", "of")}
        return {
            "schema": SCHEMA,
            **own,
            "replicates": len(self.ranks),
            "failures": [list(f) for f in self.failures],
            "parameters": rows,
        }

    def plot(self) -> Any:
        """Rank histograms above, coverage curves with their band below; returns the matplotlib figure."""
        import matplotlib.pyplot as plt

        count = len(self.names)
        figure, axes = plt.subplots(2, count, figsize=(2.2 * count, 4.2), layout="constrained", squeeze=False)
        levels = np.linspace(0.05, 0.98, 40)
        bands = np.array([self.coverage_band(level) for level in levels])
        for k, name in enumerate(self.names):
            axes[0, k].hist(self.ranks[:, k], bins=16, range=(0, self.of + 1), color="#0072b2")
            axes[0, k].set_title(name, fontsize=9)
            axes[1, k].fill_between(levels, *bands.T, color="#bbbbbb", lw=0)
            axes[1, k].plot(levels, [self.coverage(level)[k] for level in levels], color="#d55e00")
            axes[1, k].set_xlabel("nominal")
        axes[1, 0].set_ylabel("covered")
        return figure


def _ecdf(ranks: np.ndarray, of: int) -> np.ndarray:
    """Part of the ranks at or below 0, 1, ..., of - 1: shape (..., of) of ranks (..., n)."""
    rows = np.atleast_2d(ranks)
    counts = np.stack([np.bincount(row, minlength=of + 1) for row in rows])
    return np.cumsum(counts, axis=1)[:, :-1] / rows.shape[1]


def calibrate(
    model: AbstractHysteresis | str,
    data: Record | Dataset | Sequence[Record],
    *,
    noise: AbstractNoise | str = "ou",
    assumed: str | None = None,
    method: Literal["laplace", "nuts", "emcee"] = "laplace",
    replicates: int = 200,
    spread: float = 0.2,
    priors: Mapping[str, AbstractPrior] | None = None,
    fix: Sequence[str] | Mapping[str, float] = (),
    seed: int = 0,
    folder: str | Path | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> Calibration:
    """Calibrate a set-up by simulation.

    Args:
        model: its present values center the priors; a name starts from the data.
        data: records that give inputs and times; their outputs only scale the noise and start a model given by name.
        noise: the true noise, a model with values or a name (then of 1 % of the output's range).
        assumed: noise model of the inference; the true one by default.
        method: "laplace" (least squares), "nuts", or "emcee" (up to ten parameters).
        replicates: how many; at least 200 for a verdict worth its name.
        spread: relative width of the priors about the model's values.
        priors: the user's own, by name.
        fix: parameters to hold.
        seed: of everything.
        folder: keeps finished chunks; the same call goes on from them.
        workers: processes on this machine.
        scheduler: address of a Dask scheduler to use instead.
        progress: called with a line after each chunk.

    Raises:
        ParameterError: settings that cannot be used.
        MissingExtraError: dask.distributed is not installed.
        DataError: the folder holds another study.
    """
    require_x64()
    if method not in ("laplace", "nuts", "emcee"):
        raise ParameterError(f"method must be laplace, nuts or emcee, got {method!r}")
    if replicates < 1 or workers < 1 or not spread > 0:
        raise ParameterError("replicates and workers must be at least 1 and spread positive")
    records = Dataset.of(data)
    if isinstance(model, str):
        model = make_model(model).start(list(records))
    problem = Problem(model, records, fix=fix)
    fixed_model, names = problem.space.template, tuple(name for name, _, _ in problem.space.fixed())
    truth = _valued(noise, problem) if isinstance(noise, str) else noise
    make_noise(assumed or truth.name)
    study = Study(fixed_model, records, truth, assumed or truth.name, method, spread, dict(priors or {}), names, seed)
    space = _Spaces(study)
    if method == "emcee" and len(problem.space) > 10:
        raise ParameterError(
            f"emcee is for up to 10 parameters, the model has {len(problem.space)}: use nuts or laplace"
        )
    chunks = _collect(study, -(-replicates // _CHUNK), folder, workers, scheduler, progress)
    parts = [chunk for _, chunk in sorted(chunks, key=lambda one: one[0])]
    joined = {k: np.concatenate([part[k] for part in parts])[:replicates] for k in ("ranks", "errors", "reason")}
    good = joined["reason"] == 0
    reasons = {1: "the mode was not found", 2: "the posterior is not finite"}
    failed = tuple((int(k), reasons[int(joined["reason"][k])]) for k in np.flatnonzero(~good))
    shared = space.shared
    return Calibration(
        tuple(space.names[k] for k in shared), joined["ranks"][good][:, shared], RANKS, joined["errors"][good][:, shared],
        failed, method, truth.name, study.assumed, model_name(fixed_model),
    )  # fmt: skip


def _valued(name: str, problem: Problem) -> AbstractNoise:
    """A noise model of about 1 % of the output's half range."""
    noise, size = make_noise(name), 0.01 * problem.scales.y
    values = {
        "noise_white": size,
        "noise_slow": size,
        "noise_time": 20.0,
        "noise_loop": 2 * size,
        "noise_length": 0.3,
        "noise_dof": 5.0,
    }
    own = [k for k in values if hasattr(noise, k)]
    return eqx.tree_at(lambda n: [getattr(n, k) for k in own], noise, [jnp.asarray(values[k]) for k in own])


class _Spaces:
    """Parameter spaces, priors and traced parts of a study."""

    def __init__(self, study: Study):
        self.problem = Problem(study.model, study.data, fix=study.fix)
        scales = self.problem.scales
        self.truth = ParameterSpace.of(study.truth, scales=scales)
        assumed = study.truth if study.assumed == study.truth.name else _valued(study.assumed, self.problem)
        self.assumed = ParameterSpace.of(assumed, scales=scales)
        model = self.problem.space
        around = priors_around(model, model.vector(study.model), study.spread) | dict(study.priors)
        true_priors = priors_around(self.truth, self.truth.vector(study.truth), study.spread)
        same = study.assumed == study.truth.name
        # A noise model that is wrong has no true values: its priors are wide.
        noise_priors = true_priors if same else priors_around(self.assumed, self.assumed.vector(assumed), 2.0)
        self.names = (*model.names, *self.assumed.names)
        # Least squares has no posterior of the noise's parameters, and a wrong noise model no truth for them.
        self.shared = np.arange(len(self.names) if same and study.method != "laplace" else len(model))
        batch = trimmed(self.problem.objective.batch)
        objective = eqx.tree_at(lambda o: o.batch, self.problem.objective, batch)
        take = lambda table, space: tuple(table[name] for name in space.names)
        chosen = take(around, model) + take(noise_priors, self.assumed)
        z = np.concatenate(
            [model.unconstrained(model.vector(study.model)), self.assumed.unconstrained(self.assumed.vector(assumed))]
        )
        self.target = Target(
            objective, self.assumed.coordinates, Setting.of(batch), chosen, jnp.asarray(z), jnp.eye(z.size)
        )
        self.true_priors = take(around, model) + take(true_priors, self.truth)


@eqx.filter_jit
def _simulated(target: Target, truth: Any, priors: tuple[AbstractPrior, ...], key: Array) -> tuple[Array, Array]:
    """(true x of model and true noise, simulated y)."""
    first, second = jax.random.split(key)
    x = jnp.stack([p.sample(k) for p, k in zip(priors, jax.random.split(first, len(priors)), strict=True)])
    noise = truth.assemble(x[target.p :])
    y = target.objective.predict_physical(x[: target.p]) + noise.draw(target.setting, second)
    return x, y


def _whitened(target: Target, y: Array) -> tuple[Target, Array]:
    """The target with these data, centered on its mode, and a reason for failure (0 for none)."""
    own = eqx.tree_at(lambda t: t.objective.batch.y, target, jnp.where(target.setting.weight > 0, y, 0.0))
    mode = maximize(own.log_density, own.center, own.slope, steps=40)
    size, axes = jnp.linalg.eigh(-mode.hessian)
    factor = axes / jnp.sqrt(jnp.maximum(size, 1e-4))
    reason = jnp.where(mode.converged, 0, 1)
    return eqx.tree_at(lambda t: (t.center, t.factor), own, (mode.z, factor)), reason


@eqx.filter_jit
def _replicates(target: Target, truth: Any, priors: tuple[AbstractPrior, ...], keys: Array, method: str) -> Any:
    def one(key: Array) -> tuple[Array, ...]:
        first, second = jax.random.split(key)
        x, y = _simulated(target, truth, priors, first)
        own, reason = _whitened(target, y)
        if method == "laplace":
            q = jax.random.normal(second, (RANKS, own.center.shape[0]))
        else:
            q = _short_chain(own, second)
        draws = jax.vmap(lambda row: own.physical(own.unwhitened(row)))(q)
        return *_ranked(x, draws), reason

    return jax.lax.map(one, keys)


def _ranked(x: Array, draws: Array) -> tuple[Array, Array]:
    """Ranks of the truth among draws, and errors in standard deviations; only the first columns of both mean the same."""
    d = min(x.shape[0], draws.shape[1])
    wide = jnp.zeros(draws.shape[1]).at[:d].set(x[:d])
    return jnp.sum(draws < wide, axis=0), (jnp.mean(draws, axis=0) - wide) / jnp.std(draws, axis=0)


def _short_chain(target: Target, key: Array) -> Array:
    """Thinned draws of a whitened NUTS chain from an overdispersed start."""
    from hystfit.sampling.nuts import Tuning, advance

    first, second, third = jax.random.split(key, 3)
    goal, depth, thin = jnp.asarray(0.8), 6, _THIN["nuts"]
    q = jax.random.normal(first, target.center.shape)
    seen, tuning = advance(target, q, Tuning.about(0.6), second, jnp.asarray(True), goal, depth, _WARM)
    tuning = tuning._replace(size=tuning.average)
    return advance(target, seen[0][-1], tuning, third, jnp.asarray(False), goal, depth, RANKS * thin)[0][0][::thin]


def _by_emcee(spaces: _Spaces, keys: Array) -> dict[str, np.ndarray]:
    import emcee

    from hystfit.sampling.ensemble import _begin, _many

    whiten = eqx.filter_jit(_whitened)
    rows: list[tuple[Any, ...]] = []
    for key in keys:
        x, y = _simulated(spaces.target, spaces.truth.coordinates, spaces.true_priors, key)
        own, reason = whiten(spaces.target, y)
        d = own.center.shape[0]
        walkers, seed = 2 * d + 4, int(jax.random.randint(key, (), 0, 2**31 - 1))
        moves = [(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)]
        density = lambda q, own=own: np.asarray(_many(own, jnp.asarray(q)))
        sampler = emcee.EnsembleSampler(walkers, d, density, vectorize=True, moves=moves)
        thin = _THIN["emcee"]
        sampler.run_mcmc(_begin(own, walkers, d, seed)[3], 10 * thin, skip_initial_state_check=True)
        q = np.asarray(sampler.get_chain(discard=4 * thin, thin=thin)).reshape(-1, d)
        q = q[np.random.default_rng(seed).choice(len(q), RANKS, replace=len(q) < RANKS)]
        draws = jax.vmap(lambda row, own=own: own.physical(own.unwhitened(row)))(jnp.asarray(q))
        rows.append((*_ranked(x, draws), reason))
    return {k: np.stack([np.asarray(row[i]) for row in rows]) for i, k in enumerate(("ranks", "errors", "reason"))}


def run_chunk(study: Study, number: int) -> dict[str, np.ndarray]:
    """One chunk of replicates: ranks and errors, shape (chunk, parameters), and reasons for failure; runs in any process."""
    enable_x64()
    spaces = _Spaces(study)
    keys = jax.random.split(jax.random.fold_in(jax.random.key(study.seed), number), _CHUNK)
    if study.method == "emcee":
        found = _by_emcee(spaces, keys)
    else:
        traced = _replicates(spaces.target, spaces.truth.coordinates, spaces.true_priors, keys, study.method)
        found = {k: np.asarray(v) for k, v in zip(("ranks", "errors", "reason"), traced, strict=True)}
    bad = ~np.isfinite(found["errors"]).all(axis=1) & (found["reason"] == 0)
    return found | {"reason": np.where(bad, 2, found["reason"])}


def _collect(
    study: Study,
    count: int,
    folder: str | Path | None,
    workers: int,
    scheduler: str | None,
    progress: Callable[[str], None] | None,
) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
    """Chunks from the folder, and the others from here, processes or Dask; each is kept as soon as it is done."""
    place = None if folder is None else _claim(Path(folder), study)
    done = {}
    for k in range(count) if place else ():
        file = place / f"chunk-{k:05d}.npz"  # type: ignore[operator]
        if file.exists():
            with np.load(file) as stored:
                done[k] = {name: stored[name] for name in stored.files}
    yield from done.items()
    missing = [k for k in range(count) if k not in done]
    for number, (k, chunk) in enumerate(_computed(study, missing, workers, scheduler), start=1):
        if place is not None:
            scratch = place / f".chunk-{k:05d}.npz"
            with scratch.open("wb") as handle:
                np.savez(handle, **chunk)  # type: ignore[arg-type]
            scratch.replace(place / f"chunk-{k:05d}.npz")
        if progress:
            progress(f"{number + len(done)} of {count} chunks of {_CHUNK} replicates")
        yield k, chunk


def _computed(
    study: Study, numbers: Sequence[int], workers: int, scheduler: str | None
) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
    if scheduler is not None:
        try:
            from distributed import Client, as_completed  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise MissingExtraError("distributed", "batch", "scheduler=") from error
        with Client(scheduler) as client:
            tasks = {client.submit(run_chunk, study, k, pure=False): k for k in numbers}
            for task in as_completed(list(tasks)):
                yield tasks[task], task.result()
    elif workers > 1 and len(numbers) > 1:
        context = multiprocessing.get_context("spawn")  # a process forked after JAX has started can hang
        with concurrent.futures.ProcessPoolExecutor(workers, mp_context=context) as pool:
            tasks = {pool.submit(run_chunk, study, k): k for k in numbers}
            for task in concurrent.futures.as_completed(tasks):
                yield tasks[task], task.result()
    else:
        for k in numbers:
            yield k, run_chunk(study, k)


def _claim(folder: Path, study: Study) -> Path:
    """The folder of a study, new or of the same one."""
    import hashlib

    from hystfit.models.storage import to_json

    values = {k: np.asarray(v).tolist() for k, v in vars(study.truth).items() if hasattr(v, "shape")}
    own = {k: getattr(study, k) for k in ("assumed", "method", "spread", "fix", "seed")}
    priors = {k: str(v) for k, v in study.priors.items()}
    described = {"model": to_json(study.model), "truth": [study.truth.name, values], "priors": priors, **own}
    described["inputs"] = [record.digest() for record in study.data]
    digest = hashlib.sha256(json.dumps(described, sort_keys=True, default=str).encode()).hexdigest()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        label = folder / "study.json"
        if label.exists() and json.loads(label.read_text(encoding="utf-8")).get("digest") != digest:
            raise DataError(f"{os.fspath(folder)!r} holds another study: choose another folder")
        label.write_text(json.dumps({"digest": digest, **described}, indent=1, default=str), encoding="utf-8")
    except OSError as error:
        raise DataError(f"cannot keep the study in {os.fspath(folder)!r}: {error.strerror or error}") from error
    return folder
