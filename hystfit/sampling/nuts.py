"""The no-U-turn sampler (Hoffman and Gelman 2014) of blackjax in whitened coordinates; resumes after interruption, bit for bit."""

from __future__ import annotations

import dataclasses
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.errors import ParameterError, optional
from hystfit.outcome import Code
from hystfit.outcome.note import warn
from hystfit.params.host_arrays import to_device
from hystfit.runs.chunks import stored
from hystfit.sampling.base import AbstractSampler, Progress, Raw
from hystfit.sampling.diagnostics import effective_size
from hystfit.sampling.setup import Setup
from hystfit.sampling.shear import Shear
from hystfit.sampling.target import Target

_CHUNK = 50  # draws in one compiled call, and between two writes to disk
_AGAIN = 3  # further adaptations at most where transitions diverge, which more than 1 % of the draws would do too
_ROUNDS = 3  # of covariance and shear
_GAIN = 5.0  # of the step size's logarithm in the error of the acceptance
_PRIOR_DRAWS = 10.0  # draws for which the curvature counts in the covariance of the warm-up


@dataclasses.dataclass(frozen=True)
class Nuts(AbstractSampler):
    """Settings of NUTS.

    Attributes:
        chains, draws: number of chains, and of draws in each.
        warmup: steps of adaptation: of the step size, of the covariance, of the step size again.
        target_accept: acceptance for which the step size is tuned; 0.65 is best for Gaussian posteriors (Beskos et al. 2013), and
            most are nearly so once whitened; curved ones need more.
        max_depth: doublings of a trajectory at most.
    """

    name: ClassVar[str] = "nuts"
    chains: int = 4
    draws: int = 1000
    warmup: int = 300
    target_accept: float = 0.65
    max_depth: int = 8

    def __post_init__(self) -> None:
        self.check_counts({"chains": 1, "draws": 4, "warmup": 50, "max_depth": 1})
        if not 0 < self.target_accept < 1:
            raise ParameterError(f"target_accept must lie between 0 and 1, got {self.target_accept!r}")

    def run(self, setup: Setup, seed: int, folder: Path | None, report: Progress) -> Raw:
        """Draw, chains in parallel on the processor's cores, or continue from the chunks in a folder."""
        optional("blackjax", "bayes", "sampling by NUTS")  # named before minutes of compilation where it is missing
        drawn: dict[int, list[np.ndarray]] = {number: [] for number in range(self.chains)}
        reporting, halted = threading.Lock(), threading.Event()

        def collect(number: int, q: np.ndarray) -> bool:
            with reporting:
                drawn[number].append(q)
                count = sum(min(_CHUNK * len(parts), self.draws) for parts in drawn.values())
                so_far = sum(_least(np.concatenate(parts)) for parts in drawn.values() if parts)
                report(
                    f"{count} of {self.chains * self.draws} draws, about {so_far:.0f} effective so far",
                    count / (self.chains * self.draws),
                )
            return halted.is_set()

        key = jax.random.key(seed)
        warm = lambda number: stored(
            folder,
            f"nuts-{number}-warm.npz",
            lambda: self.warm(setup.target, jax.random.fold_in(jax.random.fold_in(key, number), 10**6)),
        )
        report("compilation and warm-up", 0.0)
        first = warm(0)  # compiles what all chains run

        def chain(number: int) -> dict[str, np.ndarray]:
            adapted = first if number == 0 else warm(number)
            return self._chain(setup, adapted, jax.random.fold_in(key, number), number, folder, collect)

        with ThreadPoolExecutor(min(self.chains, os.cpu_count() or 1)) as pool:
            try:
                parts = list(pool.map(chain, range(self.chains)))
            except BaseException:
                halted.set()
                raise
        joined = {k: np.stack([part[k] for part in parts]) for k in parts[0]}
        z, density = joined.pop("z"), joined.pop("log_density")
        count = int(joined["diverging"].sum())
        which = "1 divergent transition" if count == 1 else f"{count} divergent transitions"
        text = (
            f"{which}: parts of the posterior may be missing; use a larger target_accept= (now {self.target_accept:g})"
        )
        return Raw(z, density, joined, (warn(Code.DIVERGENCES, text),) if count else ())

    def _chain(
        self,
        setup: Setup,
        warm: dict[str, np.ndarray],
        key: Array,
        number: int,
        folder: Path | None,
        collect: Callable[[int, np.ndarray], bool],
    ) -> dict[str, np.ndarray]:
        """One chain after its warm-up; it ends early where `collect` returns true."""
        q, chunks = jnp.asarray(warm["q"]), []
        for k in range(-(-self.draws // _CHUNK)):
            advance = lambda k=k, q=q: self.chunk(setup.target, warm, q, jax.random.fold_in(key, k))
            chunk = stored(folder, f"nuts-{number}-{k:05d}.npz", advance)
            chunks.append(chunk)
            q = jnp.asarray(chunk["q"][-1])
            if collect(number, chunk["q"]):
                break
        rows = {name: np.concatenate([c[name] for c in chunks])[: self.draws] for name in chunks[0]}
        rows["z"] = np.asarray(adapted(setup.target, warm).unwhitened(jnp.asarray(rows.pop("q"))))
        return rows

    def warm(self, target: Target, key: Array) -> dict[str, np.ndarray]:
        """Step size, covariance, step size again: a quarter, a half and a quarter of the warm-up, in whole chunks.

        Where transitions still diverge at the end, covariance and step size are adapted again for a higher acceptance.
        """
        quarter, goal = -(-self.warmup // (4 * _CHUNK)), self.target_accept
        count = iter(range(10**6))

        def adapt(target: Target, q: Array, size: float, rounds: int) -> tuple[Array, float, np.ndarray, bool]:
            tuning, positions, diverging = Tuning.about(size), [], np.zeros(0)
            for _ in range(rounds):
                fixed = (jnp.asarray(goal), self.max_depth)
                out, tuning = _advance(target, q, tuning, jax.random.fold_in(key, next(count)), True, *fixed)
                q, diverging = out[0][-1], np.asarray(out[2])
                positions.append(np.asarray(out[0]))
            return q, float(jnp.exp(tuning.average)), np.concatenate(positions), bool(diverging.any())

        plain, target = target, target.sheared(target.factor)
        q, size, _, _ = adapt(target, _start(target, key), 0.5, quarter)
        q, _, positions, _ = adapt(target, q, size, 2 * quarter)
        for _ in range(1 + _AGAIN):
            v = target.v_of(positions[len(positions) // 10 :], np)
            for _ in range(_ROUNDS):  # the covariance depends on the shear, and the shear on the covariance
                target = plain.sheared(np.asarray(target.factor) @ _spread(target.q_of(v, np)))
            q, size, positions, diverges = adapt(target, to_device(target.q_of(v[-1], np)), 0.7, quarter)
            if not diverges:
                break
            goal = 0.5 * (1 + goal)
        coordinates = {"center": target.center, "factor": target.factor} | vars(target.shear)
        return {name: np.asarray(value) for name, value in (coordinates | {"q": q, "size": size}).items()}

    def chunk(self, target: Target, warm: dict[str, np.ndarray], q: Array, key: Array) -> dict[str, np.ndarray]:
        """Draws from a position q on with an adapted chain: positions (50, d), log densities and statistics (50,)."""
        fixed = (jnp.asarray(self.target_accept), self.max_depth)
        out, _ = _advance(adapted(target, warm), q, Tuning.about(float(warm["size"])), key, False, *fixed)
        return {
            k: np.asarray(v) for k, v in zip(("q", "log_density", "diverging", "acceptance", "steps"), out, strict=True)
        }


def adapted(target: Target, warm: dict[str, np.ndarray]) -> Target:
    """The target in the coordinates of a chain after its warm-up."""
    center, factor, order, slopes = (to_device(warm[name]) for name in ("center", "factor", "order", "slopes"))
    return dataclasses.replace(target, center=center, factor=factor, shear=Shear(order, slopes))


def _spread(positions: np.ndarray) -> np.ndarray:
    """Square root of the covariance of positions, shape (n, d), shrunk towards that of the coordinates."""
    n, d = positions.shape
    covariance = np.cov(positions.T).reshape(d, d)
    return np.linalg.cholesky((n * covariance + _PRIOR_DRAWS * np.eye(d)) / (n + _PRIOR_DRAWS))


def _least(draws: np.ndarray) -> float:
    """Effective draws of the worst coordinate of one chain, shape (n, d)."""
    sizes = [effective_size(column[None]) for column in draws.T]
    return float(np.nanmin(sizes)) if np.isfinite(sizes).any() else 0.0


def _start(target: Target, key: Array) -> Array:
    """A start about the mode whose density is finite."""
    for shrink in (1.0, 0.3, 0.1, 0.0):
        q = shrink * jax.random.normal(key, target.center.shape)
        if np.isfinite(float(_value(target, q))):
            return q
    return jnp.zeros_like(target.center)


@eqx.filter_jit
def _value(target: Target, q: Array) -> Array:
    return target(q)


class Tuning(NamedTuple):
    """State of the dual averaging of the step size (Hoffman and Gelman 2014, section 3.2), logarithms.

    The first size is about right in whitened coordinates: trials need not start at ten times it, and their gain is a quarter of the
    usual one. They then scatter by 15 %, not 50 %, about the average, which has the acceptance that the trials have on average.
    """

    size: Array
    average: Array
    error: Array
    middle: Array
    m: Array

    @classmethod
    def about(cls, size: float) -> Tuning:
        """Before the first step."""
        log_size = jnp.log(jnp.asarray(size, float))
        return cls(log_size, log_size, jnp.zeros(()), log_size, jnp.ones(()))

    def after(self, acceptance: Array, goal: Array) -> Tuning:
        """One step later."""
        share = 1 / (self.m + 10.0)
        error = (1 - share) * self.error + share * (goal - acceptance)
        size = jnp.clip(self.middle - jnp.sqrt(self.m) * _GAIN * error, -12.0, 2.0)
        weight = self.m**-0.75
        return Tuning(size, weight * size + (1 - weight) * self.average, error, self.middle, self.m + 1)


@eqx.filter_jit
def _advance(
    target: Target, q: Array, tuning: Tuning, key: Array, adapting: Array | bool, goal: Array, depth: int
) -> tuple[tuple[Array, ...], Tuning]:
    """One chunk, with or without adaptation of the step size: (positions and statistics of each draw, tuning)."""
    return advance(target, q, tuning, key, jnp.asarray(adapting), goal, depth, _CHUNK)


def advance(
    target: Target, q: Array, tuning: Tuning, key: Array, adapting: Array, goal: Array, depth: int, steps: int
) -> tuple[tuple[Array, ...], Tuning]:
    """`steps` transitions, for use inside traced code; `adapting` is one flag or one per transition.

    During adaptation the step size is the trial value of dual averaging, otherwise its average.

    The step size is tuned for the acceptance `goal`; trajectories double at most `depth` times.
    """
    nuts = optional("blackjax", "bayes", "sampling by NUTS").nuts
    kernel, mass = nuts.build_kernel(), jnp.ones_like(q)

    def once(carry: tuple[Any, Tuning], at: tuple[Array, Array]) -> tuple[tuple[Any, Tuning], tuple[Array, ...]]:
        (state, tuning), (key, adapts) = carry, at
        size = jnp.exp(jnp.where(adapts, tuning.size, tuning.average))
        state, info = kernel(key, state, target, size, mass, max_num_doublings=depth)
        later = tuning.after(info.acceptance_rate, goal)
        tuning = jax.tree_util.tree_map(lambda a, b: jnp.where(adapts, a, b), later, tuning)
        out = (state.position, state.logdensity, info.is_divergent, info.acceptance_rate, info.num_integration_steps)
        return (state, tuning), out

    ahead = (jax.random.split(key, steps), jnp.broadcast_to(adapting, (steps,)))
    (_, tuning), out = jax.lax.scan(once, (nuts.init(q, target), tuning), ahead)
    return out, tuning
