"""Nested slice sampling of blackjax from the priors: posteriors of several modes, and the evidence of a model.

Skilling (2006), Bayesian Analysis 1, 833; batches of deletions after Fowlie, Handley and Su (2021), MNRAS 503, 1199.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.special import logsumexp

from hystfit.errors import DataError, ParameterError, optional
from hystfit.inference.density import Density
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.runs.chunks import stored
from hystfit.sampling.base import AbstractSampler, Evidence, Progress, Raw
from hystfit.sampling.setup import Setup

_CHUNK = 10  # deletions of a batch in one compiled call, and between two writes to disk
_PATHS = 200  # simulated shrinkages of the prior volume, for the error of the evidence
_DEEPEST = 500.0  # nats of compression at which a run ends without convergence


@dataclasses.dataclass(frozen=True)
class Nested(AbstractSampler):
    """Settings of nested sampling.

    Attributes:
        live: number of live points; the error of the log evidence falls with their square root.
        moves: slice moves for every new point; None takes eight times the number of parameters. With too few the evidence is too low
            where there are several modes.
        rest: fraction of the evidence in the live points at which a run ends.
        draws: equally weighted draws kept of each run, at most the effective number of its weights.
        chains: independent runs, compared with each other as chains are.
    """

    name: ClassVar[str] = "nested"
    compares: ClassVar[bool] = True
    live: int = 400
    moves: int | None = None
    rest: float = 0.01
    draws: int = 2000
    chains: int = 2

    def __post_init__(self) -> None:
        _blackjax()
        self.check_counts({"live": 50, "draws": 50, "chains": 1} | ({} if self.moves is None else {"moves": 1}))
        if not 0 < self.rest < 1:
            raise ParameterError(f"rest must lie between 0 and 1, got {self.rest!r}")

    def run(self, setup: Setup, seed: int, folder: Path | None, report: Progress) -> Raw:
        """Draw, or continue from the chunks in a folder."""
        if setup.dependence is not None:
            raise ParameterError("sampler='nested' takes independent priors: use sampler='nuts'")
        runs = [self._once(setup, seed, number, folder, report) for number in range(self.chains)]
        keep = min(self.draws, *(int(run.effective_count) for run in runs))
        rng = np.random.default_rng(seed)
        rows = [_equal(run.weights, keep, rng) for run in runs]
        z = np.stack([run.z[at] for run, at in zip(runs, rows, strict=True)])
        density = np.stack([run.log_density[at] for run, at in zip(runs, rows, strict=True)])
        values = np.array([run.log_z for run in runs])
        errors = np.array([run.error for run in runs])
        apart = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
        error = max(float(np.sqrt(np.sum(errors**2))), apart * np.sqrt(len(values))) / len(values)
        batches = sum(run.steps for run in runs)
        notes = [Note(Code.CHAINS, f"nested sampling: {batches} batches of {self.live // 10} points")]
        agree, ended = True, all(run.ended for run in runs)
        if apart > 3 * float(np.sqrt(np.mean(errors**2))):
            agree = False
            text = f"the evidences of the runs differ by {np.ptp(values):.2g}, more than their errors: use more live points (--live)"
            notes.append(warn(Code.CHAINS, text))
        if not ended:
            notes.append(warn(Code.CHAINS, "the likelihood keeps rising without limit: give the noise a proper prior"))
        evidence = Evidence(float(np.mean(values)), error, float(np.mean([run.information for run in runs])))
        return Raw(z, density, {}, tuple(notes), agree and ended, evidence)

    def _once(self, setup: Setup, seed: int, number: int, folder: Path | None, report: Progress) -> _Run:
        density, d = setup.target.density, setup.target.center.shape[0]
        key = jax.random.fold_in(jax.random.key(seed), number)
        settings = (self.moves or 8 * d, self.live // 10)
        first = stored(folder, f"nested-{number}-live.npz", lambda: _from_priors(setup, key, self.live))
        state, part = _begin(density, jnp.asarray(first["z"]), *settings), float(first["part"])
        dead, ended, k = [], False, 0
        leaves, form = jax.tree_util.tree_flatten(state)
        while not ended and float(state.integrator.logX) > -_DEEPEST:
            advance = lambda k=k, state=state: _pack(
                *_advance(density, state, jax.random.fold_in(key, k + 1), *settings)
            )
            chunk = stored(folder, f"nested-{number}-{k:05d}.npz", advance)
            dead.append({name: chunk[name] for name in ("z", "prior", "likelihood", "birth")})
            state = jax.tree_util.tree_unflatten(form, [jnp.asarray(chunk[f"state{n}"]) for n in range(len(leaves))])
            k += 1
            totals = state.integrator
            inside, outside = float(totals.logZ_live), float(totals.logZ)
            left = inside - float(np.logaddexp(outside, inside))
            ended = bool(left < np.log(self.rest))
            deep = -float(state.integrator.logX)
            report(
                f"run {number + 1} of {self.chains}, compressed by {deep:.1f} nats, {100 * np.exp(left):.2g} % of the evidence left",
                (number + (1.0 if ended else deep / (deep + 5 - left))) / self.chains,
            )
        return _Run.of(state, dead, part, seed + number, k * _CHUNK, ended)


class _Run(NamedTuple):
    """One finished run: all points with their weights (sum 1), the evidence, and whether it ended."""

    z: np.ndarray
    log_density: np.ndarray
    weights: np.ndarray
    log_z: float
    error: float
    information: float
    steps: int
    ended: bool

    @property
    def effective_count(self) -> float:
        """Effective number of draws of the weights (Kish)."""
        return float(1 / np.sum(self.weights**2))

    @classmethod
    def of(cls, state: Any, dead: list[dict[str, np.ndarray]], part: float, seed: int, steps: int, ended: bool) -> _Run:
        """From the dead points, the live ones and the part of the prior from which the first were drawn."""
        live = {k: np.asarray(v) for k, v in _points(state.particles).items()}
        every = {k: np.concatenate([*(one[k] for one in dead), live[k]]) for k in live}
        paths = _log_weights(every, seed)
        log_z = np.asarray(logsumexp(paths, axis=0)) + np.log(part)
        mean = np.asarray(logsumexp(paths, axis=1))
        weights = np.exp(mean - np.asarray(logsumexp(mean)))
        gain = np.where(weights > 0, weights * every["likelihood"], 0.0)
        value = float(log_z.mean())
        total = every["prior"] + every["likelihood"]
        information = float(np.sum(gain)) - value
        return cls(every["z"], total, weights, value, float(log_z.std()), information, steps, ended)


def _log_weights(every: dict[str, np.ndarray], seed: int) -> np.ndarray:
    """Log weights of all points in `_PATHS` simulated shrinkages of the prior volume, shape (points, paths)."""
    from blackjax.ns.base import NSInfo, StateWithLogLikelihood
    from blackjax.ns.utils import log_weights

    arrays = (jnp.asarray(every[k]) for k in ("z", "prior", "likelihood", "birth"))
    return np.asarray(log_weights(jax.random.key(seed), NSInfo(StateWithLogLikelihood(*arrays), ()), _PATHS))  # type: ignore[arg-type]


def _equal(weights: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Indices of `count` equally weighted points (systematic resampling), in random order."""
    edges = np.cumsum(weights)
    at = np.searchsorted(edges / edges[-1], (rng.uniform() + np.arange(count)) / count)
    return rng.permutation(np.minimum(at, len(weights) - 1))


def _from_priors(setup: Setup, key: Array, count: int) -> dict[str, np.ndarray]:
    """z of `count` draws from the priors with a finite likelihood, shape (count, d), and the part of all draws that had one."""
    problem, density = setup.problem, setup.target.density
    batches: list[np.ndarray] = []
    tried = kept = 0
    while kept < count:
        if tried >= 100 * count:
            raise DataError(
                f"only {kept} of {tried} draws from the priors have a finite likelihood: give narrower priors for nested sampling"
            )
        keys = jax.random.split(jax.random.fold_in(key, 10**6 + tried), len(problem.priors))
        x = np.stack([np.asarray(prior.sample(k, (count,))) for prior, k in zip(problem.priors, keys, strict=True)], 1)
        tried += count
        z = [problem.unconstrained(row) for row in x if _within(setup, row)]
        if z:
            good = np.isfinite(np.asarray(_likelihood(density, jnp.asarray(np.stack(z)))))
            batches.append(np.stack(z)[good])
            kept += int(good.sum())
    # The last batch counts whole: its surplus is information about the fraction too.
    return {"z": np.concatenate(batches)[:count], "part": np.asarray(kept / tried)}


def _within(setup: Setup, x: np.ndarray) -> bool:
    density = setup.target.density
    both = (density.objective.coordinates, density.noise)
    lower, upper = (np.concatenate([np.asarray(getattr(c, side)) for c in both]) for side in ("lower", "upper"))
    return bool(np.isfinite(x).all() and (x > lower).all() and (x < upper).all())


@eqx.filter_jit
def _likelihood(density: Density, z: Array) -> Array:
    return jax.lax.map(density.log_likelihood_lean, z, batch_size=50)


def _blackjax() -> Any:
    return optional("blackjax", "bayes", "nested sampling")


def _sampler(density: Density, moves: int, batch: int) -> Any:
    blackjax = _blackjax()

    def likelihood(z: Array) -> Array:
        value = density.log_likelihood_lean(z)
        return jnp.where(jnp.isfinite(value), value, -jnp.inf)

    return blackjax.nss(density.log_prior, likelihood, moves, batch)


@eqx.filter_jit
def _begin(density: Density, z: Array, moves: int, batch: int) -> Any:
    return _sampler(density, moves, batch).init(z)


@eqx.filter_jit
def _advance(density: Density, state: Any, key: Array, moves: int, batch: int) -> tuple[Any, Any]:
    """One chunk: the later state, and the points that died, shape (chunk, batch, ...)."""
    step = _sampler(density, moves, batch).step

    def once(state: Any, key: Array) -> tuple[Any, Any]:
        state, info = step(key, state)
        return state, info.particles

    return jax.lax.scan(once, state, jax.random.split(key, _CHUNK))


def _points(particles: Any) -> dict[str, Array]:
    names = {"z": "position", "prior": "logdensity", "likelihood": "loglikelihood", "birth": "loglikelihood_birth"}
    return {ours: getattr(particles, theirs) for ours, theirs in names.items()}


def _pack(state: Any, died: Any) -> dict[str, np.ndarray]:
    """The state's leaves and the dead points, flat, as arrays for a file."""
    flat = {k: np.asarray(v) for k, v in _points(died).items()}
    flat = {k: v.reshape(-1, *v.shape[2:]) for k, v in flat.items()}
    return flat | {f"state{n}": np.asarray(leaf) for n, leaf in enumerate(jax.tree_util.tree_leaves(state))}
