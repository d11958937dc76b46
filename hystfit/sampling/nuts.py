"""The no-U-turn sampler (Hoffman and Gelman 2014) of blackjax in whitened coordinates; resumes after interruption, bit for bit."""

from __future__ import annotations

import dataclasses
import functools
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.errors import ParameterError, optional
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.priors import AbstractPrior
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.params.host_arrays import compiled, to_device
from hystfit.results.result import FitResult
from hystfit.runs.chunks import Chunks, stored
from hystfit.runs.threads import Workers, usable_cores
from hystfit.sampling.base import AbstractChains, Progress, Raw
from hystfit.sampling.bend import Shear
from hystfit.sampling.diagnostics import effective_size
from hystfit.sampling.setup import Setup, given_others, prepare
from hystfit.sampling.target import Target

CHUNK = 50  # draws in one compiled call, and between two writes to disk
_GAIN = 5.0  # of the step size's logarithm in the error of the acceptance


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


@compiled
def advance_chunk(
    target: Target, q: Array, tuning: Tuning, key: Array, adapting: Array, goal: Array, depth: int
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """One chunk: (positions and statistics of each draw, fields of `Tuning`); `adapting` is an array, so that one program does both."""
    out, tuning = advance(target, q, tuning, key, adapting, goal, depth, CHUNK)
    return out, tuple(tuning)


def advance(
    target: Target, q: Array, tuning: Tuning, key: Array, adapting: Array, goal: Array, depth: int, steps: int
) -> tuple[tuple[Array, ...], Tuning]:
    """`steps` transitions, for use inside traced code: positions, and whether they diverged, acceptances and gradients of each.

    Where `adapting`, one flag or one per transition, the step size is the trial value of dual averaging for the acceptance `goal`,
    otherwise its average; trajectories double at most `depth` times.
    """
    nuts = optional("blackjax", "bayes", "sampling by NUTS").nuts
    kernel, mass = nuts.build_kernel(), jnp.ones_like(q)

    def once(carry: tuple[Any, Tuning], at: tuple[Array, Array]) -> tuple[Any, tuple[Array, ...]]:
        (state, tuning), (key, adapts) = carry, at
        size = jnp.exp(jnp.where(adapts, tuning.size, tuning.average))
        state, info = kernel(key, state, target, size, mass, max_num_doublings=depth)
        later = tuning.after(info.acceptance_rate, goal)
        tuning = jax.tree_util.tree_map(lambda a, b: jnp.where(adapts, a, b), later, tuning)
        out = (info.is_divergent, info.acceptance_rate, info.num_integration_steps)
        return (state, tuning), (state.position, *out)

    ahead = (jax.random.split(key, steps), jnp.broadcast_to(adapting, (steps,)))
    (_, tuning), out = jax.lax.scan(once, (nuts.init(q, target), tuning), ahead)
    return out, tuning


_AGAIN = 3  # further adaptations at most where transitions of a warm-up diverge, and further runs where those of the draws do
# Gradients of a trajectory on average beyond which the coordinates of `LinearPart` pay: those of the piezo record of
# experiments/uncertainty took 2 times as long for four linear parameters, and 11 of them sufficed for a trajectory instead of 50 to 160.
_LONG = 32
_EACH = 8  # the same for each linear parameter, which needs a simulation of its own
_PRIOR_DRAWS = 10.0  # draws for which the curvature counts in the covariance of the warm-up


@dataclasses.dataclass(frozen=True)
class Nuts(AbstractChains):
    """Settings of NUTS, beside those of `AbstractChains`.

    Attributes:
        warmup: steps of adaptation: of the step size, of the covariance, of the step size again.
        target_accept: acceptance for which the step size is tuned at first. 0.65 is best for Gaussian posteriors (Beskos et al. 2013),
            but transitions diverge in curved ones; 0.9 costs about as many gradients per effective draw. Where transitions still
            diverge, the chains are drawn again for an acceptance half as far from 1, up to three times.
        max_depth: doublings of a trajectory at most.
    """

    name: ClassVar[str] = "nuts"
    warmup: int = 300
    target_accept: float = 0.9
    max_depth: int = 8

    def __post_init__(self) -> None:
        optional("blackjax", "bayes", "sampling by NUTS")  # named before minutes of compilation where it is missing
        super().__post_init__()
        self.check_counts({"warmup": 50, "max_depth": 1})
        if not 0 < self.target_accept < 1:
            raise ParameterError(f"target_accept must lie between 0 and 1, got {self.target_accept!r}")

    def prepare(
        self, result: FitResult, noise: str | type[AbstractNoise], priors: Mapping[str, AbstractPrior] | None
    ) -> Setup:
        """See the base class; where trajectories are long, linear parameters have the coordinates of `LinearPart`."""
        return self.straightened(prepare(result, noise=noise, priors=priors))

    def straightened(self, setup: Setup) -> Setup:
        """A posterior in the coordinates of `LinearPart` where they pay."""
        key = jax.random.key(0)
        current = setup.target.sheared(setup.target.factor)
        trial = advance_chunk(
            current, _start(setup.target, key), Tuning.about(0.5), key, jnp.asarray(True), jnp.asarray(self.target_accept),
            self.max_depth,
        )  # fmt: skip
        length = float(np.mean(trial[0][-1]))
        if length <= _LONG:
            return setup
        other = given_others(setup, key)
        linear = other.target.linear
        return other if linear is not None and length > _EACH * len(linear.places) else setup

    def run(self, setup: Setup, seed: int, folder: Path | None, report: Progress) -> Raw:
        """Draw, chains in parallel on the processor's cores, or continue from the chunks in a folder.

        Where transitions diverge, the chains adapt further for a higher acceptance, and all draws are made anew.
        """
        key, goal, notes = jax.random.key(seed), self.target_accept, ()
        chains = [
            _Chain(self, setup.target, goal, jax.random.fold_in(key, number), Chunks(folder, f"nuts-{number}"))
            for number in range(self.chains)
        ]
        report("compilation and warm-up", 0.0)
        for last in [False] * _AGAIN + [True]:
            draw = lambda draws, chains=chains, last=last: self._draw(chains, draws, report, to_the_end=last)
            joined, _ = self.until_converged(draw, lambda joined: setup.physical(joined["z"]))
            if joined is not None:
                break
            chains = [chain.again() for chain in chains]
            text = f"transitions diverged for an acceptance of {goal:.3g}: the draws are those for {_closer(goal):.3g}"
            goal, notes = _closer(goal), (Note(Code.DIVERGENCES, text),)
            report(f"transitions diverged: drawing again for an acceptance of {goal:.3g}", 0.0)
        assert joined is not None  # the last attempt is drawn to the end
        z, count = joined.pop("z"), int(joined["diverging"].sum())
        if count:
            which = "1 divergent transition" if count == 1 else f"{count} divergent transitions"
            text = f"{which} for an acceptance of {goal:.3g}: parts of the posterior may be missing"
            notes = (warn(Code.DIVERGENCES, text),)
        return Raw(z, setup.log_density(z), joined, notes)

    def _draw(
        self, chains: list[_Chain], draws: int, report: Progress, *, to_the_end: bool
    ) -> dict[str, np.ndarray] | None:
        """All chains, joined; None, once a transition diverges, unless they are wanted to the end."""
        drawn: list[list[np.ndarray]] = [[] for _ in chains]
        reporting, diverged, total = threading.Lock(), threading.Event(), self.chains * draws
        workers = Workers(min(self.chains, usable_cores()))

        def collect(number: int, chunk: dict[str, np.ndarray]) -> bool:
            workers.check()
            with reporting:
                drawn[number].append(chunk["q"])
                if chunk["diverging"].any() and not to_the_end:
                    diverged.set()
                count = sum(len(part) for parts in drawn for part in parts)
                so_far = sum(_least(np.concatenate(parts)) for parts in drawn if parts)
                report(f"{count} of {total} draws, about {so_far:.0f} effective so far", count / total)
            return diverged.is_set()

        _ = chains[0].warm  # compiles what all chains run
        each = [functools.partial(chain.draw, draws, functools.partial(collect, k)) for k, chain in enumerate(chains)]
        parts = workers.run(each)
        return None if diverged.is_set() else {k: np.stack([part[k] for part in parts]) for k in parts[0]}

    def warm(
        self, target: Target, key: Array, goal: float | None = None, before: dict[str, np.ndarray] | None = None
    ) -> dict[str, np.ndarray]:
        """Step size, covariance, step size again: a quarter, a half and a quarter of the warm-up, in whole chunks.

        The target is in the coordinates of the fit. Where transitions still diverge at the end, covariance and step size are adapted again
        for a higher acceptance. A warm-up that continues `before`, the end of another, leaves out the first quarter.
        """
        adaptation = _Adaptation(self, key, self.target_accept if goal is None else goal)
        if before is None:
            current = target.sheared(target.factor)
            q, size, *_ = adaptation.steps(current, _start(target, key), 0.5, 1)
        else:
            current = adapted(target, before)
            q, size = jnp.asarray(before["q"]), float(before["size"])
        positions = adaptation.steps(current, q, size, 2)[2]
        return adaptation.whiten(target, current, positions)

    def chunk(self, target: Target, warm: dict[str, np.ndarray], q: Array, key: Array) -> dict[str, np.ndarray]:
        """Draws from a position q on with an adapted chain: positions (50, d), and statistics (50,)."""
        fixed = (jnp.asarray(False), jnp.asarray(self.target_accept), self.max_depth)
        out, _ = advance_chunk(adapted(target, warm), q, Tuning.about(float(warm["size"])), key, *fixed)
        return dict(zip(("q", "diverging", "acceptance", "steps"), map(np.asarray, out), strict=True))


@dataclasses.dataclass(frozen=True)
class _Chain:
    """One chain of a run, which continues from the chunks that are known.

    `goal` is the acceptance for which the step size is tuned, and `before` the end of the warm-up of the chain before it, whose transitions
    diverged.
    """

    nuts: Nuts
    target: Target
    goal: float
    key: Array
    chunks: Chunks
    before: dict[str, np.ndarray] | None = None

    @functools.cached_property
    def warm(self) -> dict[str, np.ndarray]:
        """Position, coordinates and step size after the warm-up."""
        key = jax.random.fold_in(self.key, 10**6)
        make = lambda: self.nuts.warm(self.target, key, self.goal, self.before)
        return stored(self.chunks.folder, f"{self.chunks.label}-warm.npz", make)

    def again(self) -> _Chain:
        """A chain that continues from the warm-up of this one, for a higher acceptance."""
        key, chunks = jax.random.fold_in(self.key, 10**7), Chunks(self.chunks.folder, f"{self.chunks.label}-again")
        return dataclasses.replace(self, goal=_closer(self.goal), key=key, chunks=chunks, before=self.warm)

    def draw(self, draws: int, collect: Callable[[dict[str, np.ndarray]], bool]) -> dict[str, np.ndarray]:
        """All draws after the warm-up; `collect` is given each chunk, and ends the chain where it returns true."""
        for k, first in enumerate(range(0, draws, CHUNK)):
            chunk = self.chunks.part(k, self._chunk)
            if collect({name: rows[: draws - first] for name, rows in chunk.items()}):
                break
        return self.chunks.joined([name for name in self.chunks.parts[0] if name != "q"], draws)

    def _chunk(self, k: int) -> dict[str, np.ndarray]:
        """Chunk number k, after those before it."""
        q = self.chunks.parts[-1]["q"][-1] if k else self.warm["q"]
        rows = self.nuts.chunk(self.target, self.warm, jnp.asarray(q), jax.random.fold_in(self.key, k))
        return rows | {"z": np.asarray(adapted(self.target, self.warm).unwhitened(rows["q"]))}


class _Adaptation:
    """Adaptation of one chain: its key, and the acceptance that it aims at, which rises where transitions diverge."""

    def __init__(self, nuts: Nuts, key: Array, goal: float):
        self.nuts, self.key, self.goal, self.count = nuts, key, goal, 0

    def steps(self, target: Target, q: Array, size: float, quarters: int) -> tuple[Array, float, np.ndarray, bool]:
        """Adapt the step size: (position, step size, positions on the way, whether the last transitions diverged)."""
        tuning, positions, diverging = Tuning.about(size), [], np.zeros(0)
        for _ in range(quarters * -(-self.nuts.warmup // (4 * CHUNK))):
            key, fixed = jax.random.fold_in(self.key, self.count), (jnp.asarray(self.goal), self.nuts.max_depth)
            out, later = advance_chunk(target, q, tuning, key, jnp.asarray(True), *fixed)
            tuning = Tuning(*later)
            q, diverging, self.count = out[0][-1], np.asarray(out[1]), self.count + 1
            positions.append(np.asarray(out[0]))
        return q, float(jnp.exp(tuning.average)), np.concatenate(positions), bool(diverging.any())

    def whiten(self, plain: Target, target: Target, positions: np.ndarray) -> dict[str, np.ndarray]:
        """Covariance from positions in the coordinates of a target, and the step size; `plain` is the target before any whitening."""
        for _ in range(1 + _AGAIN):
            v = target.v_of(positions[len(positions) // 10 :], np)
            for _ in range(3):  # the covariance depends on the shear, and the shear on the covariance
                target = plain.sheared(np.asarray(target.factor) @ _spread(target.q_of(v, np)))
            q, size, positions, diverges = self.steps(target, to_device(target.q_of(v[-1], np)), 0.7, 1)
            if not diverges:
                break
            self.goal = _closer(self.goal)
        warm = {"center": target.center, "factor": target.factor} | vars(target.shear) | {"q": q, "size": size}
        return {name: np.asarray(value) for name, value in warm.items()}


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
    sizes = effective_size(draws.T[:, None])
    return float(np.nanmin(sizes)) if np.isfinite(sizes).any() else 0.0


def _start(target: Target, key: Array) -> Array:
    """A start about the mode whose density is finite."""
    for shrink in (1.0, 0.3, 0.1, 0.0):
        q = shrink * jax.random.normal(key, target.center.shape)
        if np.isfinite(float(_value(target, q))):
            return q
    return jnp.zeros_like(target.center)


@compiled
def _value(target: Target, q: Array) -> Array:
    return target(q)


def _closer(goal: float) -> float:
    """An acceptance half as far from 1."""
    return 0.5 * (1 + goal)
