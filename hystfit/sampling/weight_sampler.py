"""Gibbs sampling of linear weights by hundreds with the strength of their penalty and the noise; resumes after interruption, bit for bit.

Few other parameters, such as a time constant, move with the weights in the linearized model; the exact density accepts the sweep or not.

Each sweep draws the weights by exact Hamiltonian motion within their bounds (`hystfit.sampling.truncated_normal`), the noise by its shares
(`hystfit.sampling.noise_grid`) with its variance in closed form, and the strength of the penalty as a precision whose inverse square root
is half-Cauchy (Wand et al. 2011, Bayesian Analysis 6): the penalty is the prior that the weights are smooth.
"""

from __future__ import annotations

import dataclasses
import functools
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.errors import ParameterError
from hystfit.inference.correlated_priors import CorrelatedPriors
from hystfit.inference.fittable import check_smooth
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.ornstein_uhlenbeck import OrnsteinUhlenbeck
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.priors import AbstractPrior
from hystfit.inference.residuals import analyze, diagnose
from hystfit.outcome import Code, Note
from hystfit.outcome.note import has, warn
from hystfit.params.host_arrays import compiled, to_device
from hystfit.results.result import FitResult
from hystfit.runs.chunks import Chunks
from hystfit.runs.threads import Workers
from hystfit.sampling.base import AbstractChains, Progress, Raw
from hystfit.sampling.noise_grid import NoiseGrid
from hystfit.sampling.setup import Prepared
from hystfit.sampling.truncated_normal import draw_opposite, opposite
from hystfit.sampling.weight_equations import Exact, WeightEquations, parameters_of, weight_equations, weight_priors

_CHUNK = 25  # sweeps in one compiled call, and between two writes to disk
_POINTS = 12  # among which the weights move: 1200 sweeps of 464 weights give 400 effective draws of the strength, 200 with one point
_PILOTS = 3  # chains of the linearized density, each about the mean of the one before
_PILOT = 2 * _CHUNK  # sweeps of a pilot that count, and as many before them
_WIDER = 2.0  # variance of one parameter that is not a weight, over that of the linearized density: 250 effective draws where 1 had 41
_OTHERS = 15  # draws of the strength in a sweep; their cost is small beside that of the weights
_LEAST = 1e-16  # variance of noise, over the squared range of the output, below which squares of residuals are rounding errors


@dataclasses.dataclass(frozen=True)
class Weights(AbstractChains):
    """Settings of the sampler of weights, beside those of `AbstractChains`: `warmup` are sweeps before the draws."""

    name: ClassVar[str] = "weights"
    draws: int = 400
    extend: int = 8
    warmup: int = 50

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_counts({"warmup": 1})

    def prepare(
        self, result: FitResult, noise: str | type[AbstractNoise], priors: Mapping[str, AbstractPrior] | None
    ) -> WeightSetup:
        check_smooth(result.problem.space, "sampling")
        return WeightSetup.of(result, noise, priors)

    def run(self, setup: WeightSetup, seed: int, folder: Path | None, report: Progress) -> Raw:
        """Draw, chains in parallel on the processor's cores, or continue from the chunks in a folder."""
        key = jax.random.key(seed)
        report("compilation and warm-up", 0.0)
        equations = _centered(setup, jax.random.fold_in(key, self.chains), folder)
        chains = [
            _Chain(equations, jax.random.fold_in(key, k), Chunks(folder, f"weights-{k}")) for k in range(self.chains)
        ]

        def draw(draws: int) -> dict[str, np.ndarray]:
            parts = self._draw(chains, draws, report)
            return {name: np.stack([part[name] for part in parts]) for name in parts[0]}

        def judged(joined: dict[str, np.ndarray]) -> np.ndarray:
            strength = [np.log(joined["strength"])[..., None]] if float(setup.equations.penalized) else []
            return np.concatenate([setup.parameters(joined), *strength], axis=-1)

        joined, good = self.until_converged(draw, judged)
        smoothness = joined["strength"] / float(setup.equations.count)
        stats = {"smoothness": smoothness, "log_penalty": joined["log_penalty"], "acceptance": joined["accepted"]}
        return Raw(setup.parameters(joined), joined["log_density"], stats, complete=good)

    def _draw(self, chains: list[_Chain], draws: int, report: Progress) -> list[dict[str, np.ndarray]]:
        """The draws of every chain after the warm-up."""
        done, lock, total = [0], threading.Lock(), len(chains) * (self.warmup + draws)
        workers = Workers()

        def collect(count: int) -> None:
            workers.check()
            with lock:
                done[0] += count
                report(f"{done[0]} of {total} sweeps", min(done[0] / total, 1.0))

        tasks = [functools.partial(chain.sweeps, self.warmup + draws, collect) for chain in chains]
        return [{name: rows[self.warmup :] for name, rows in part.items()} for part in workers.run(tasks)]


def _centered(setup: WeightSetup, key: Array, folder: Path | None) -> WeightEquations:
    """Equations about the mean of their draws, in which parameters that are not weights vary more.

    The estimate has weights at bounds, whose means lie inside, and derivatives for the other parameters depend on them.
    """
    equations, space = setup.equations, setup.problem.space
    if equations.exact is None:
        return equations
    w = np.empty((0, len(space)))
    for number in range(_PILOTS):
        linear = dataclasses.replace(equations, exact=None)
        pilot = _Chain(linear, jax.random.fold_in(key, number), Chunks(folder, f"pilot-{number}"))
        w = pilot.sweeps(2 * _PILOT, lambda count: None)["w"][_PILOT:]
        x = parameters_of(space, w.mean(axis=0), setup.size)
        equations = weight_equations(setup.problem, x, setup.grid, setup.chosen, setup.size)
    # By so little for each of several that their correlation leaves a positive definite precision.
    less = np.where(space.linear, 0.0, (1 - 1 / _WIDER) / (w.var(axis=0) * np.sum(~space.linear)))
    precision, pull = equations.precision - less, equations.pull - less * w.mean(axis=0)
    return dataclasses.replace(equations, precision=precision, pull=pull, exact=setup.equations.exact)


@dataclasses.dataclass(frozen=True)
class _Chain:
    """One chain, which continues from the chunks that are known."""

    equations: WeightEquations
    key: Array
    chunks: Chunks

    def sweeps(self, count: int, collect: Callable[[int], None]) -> dict[str, np.ndarray]:
        """The first `count` sweeps; `collect` is called after each chunk."""
        for number in range(-(-count // _CHUNK)):
            self.chunks.part(number, self._chunk)
            collect(_CHUNK)
        return self.chunks.joined(self.chunks.parts[0], count)

    def _chunk(self, number: int) -> dict[str, np.ndarray]:
        key = jax.random.fold_in(self.key, number)
        if number:
            state = {name: to_device(rows[-1]) for name, rows in self.chunks.parts[-1].items()}
        else:
            state = _start(self.equations, jax.random.fold_in(self.key, 10**6))
        return {name: np.asarray(rows) for name, rows in _advance(self.equations, state, key).items()}


State = dict[str, Array]


@compiled
def _start(equations: WeightEquations, key: Array) -> State:
    """The estimate inside its bounds, another noise and another strength in each chain."""
    first, second = jax.random.split(key)
    w = equations.inside
    strength = equations.penalized / (w @ equations.roughness @ w + _LEAST) * jnp.exp(jax.random.normal(first))
    number = jax.random.randint(second, (), 0, equations.squares.size)
    variance = equations.squares[number] / equations.count + _LEAST
    return state_at(w, number, variance, strength)


def state_at(w: Array, number: Array, variance: Array, strength: Array) -> State:
    """A state from which sweeps start; for use inside traced code."""
    own = {"w": w, "number": number, "variance": variance, "strength": strength}
    return own | dict.fromkeys(("accepted", "log_density", "log_penalty"), jnp.zeros(()))


@compiled
def _advance(equations: WeightEquations, state: State, key: Array) -> State:
    """A chunk of sweeps: the states after each."""
    once = lambda state, key: (new := sweep(equations, state, key), new)
    return jax.lax.scan(once, state, jax.random.split(key, _CHUNK))[1]


def sweep(equations: WeightEquations, state: State, key: Array) -> State:
    """One sweep: noise, its variance, weights, the variance again, and the strength of the penalty; for use inside traced code.

    Variance, weights and variance leave the density of the equations as it is in either direction of time, so that one comparison with
    the exact density accepts them or not (delayed acceptance: Christen and Fox 2005, J. Comput. Graph. Stat. 14).
    """
    keys = jax.random.split(key, 7)
    number = jax.random.categorical(keys[0], equations.log_shares)
    rough, square = lambda w: w @ equations.roughness @ w, lambda w: equations.square(w, number)
    middle = _variance(equations, square(state["w"]), keys[1])
    slope, precision = equations.conditional(number, middle, state["strength"])
    w = draw_opposite(keys[2], state["w"], slope, precision, equations.bounded, rough, _POINTS)
    known, excess = _log_densities(equations, number, state["w"], state["variance"])
    variance = _variance(equations, square(w), keys[3])
    new_known, new_excess = _log_densities(equations, number, w, variance)
    accepted = jnp.log(jax.random.uniform(keys[4])) < new_excess - excess
    either = lambda new, old: jnp.where(accepted, new, old)
    w, variance = either(w, state["w"]), either(variance, state["variance"])
    half, penalized = 0.5 * rough(w), equations.penalized
    rate = jax.random.exponential(keys[5]) / (state["strength"] + penalized**2)
    others = jax.random.gamma(keys[6], 0.5 * (penalized + 1), (_OTHERS,)) / (rate + half)
    strength = jnp.where(penalized > 0, overrelaxed(state["strength"], others), 1.0)
    penalty = 0.5 * penalized * jnp.log(strength) - strength * half
    return {
        "w": w, "number": number, "variance": variance, "strength": strength, "accepted": accepted.astype(float),
        "log_penalty": penalty, "log_density": either(new_known, known) + penalty,
    }  # fmt: skip


def _log_densities(equations: WeightEquations, number: Array, w: Array, variance: Array) -> tuple[Array, Array]:
    """The exact one without the penalty, and its excess over that of the equations."""
    fit = equations.fit(equations.square(w, number), number, variance)
    excess = equations.excess(w, number, variance, fit)
    return fit + excess + equations.log_prior(w) + equations.log_shares[number], excess


def _variance(equations: WeightEquations, square: Array, key: Array) -> Array:
    """A draw of the noise's variance given the square of the residuals."""
    n = equations.count
    return (0.5 * square + n * _LEAST) / jax.random.gamma(key, 0.5 * n)


def overrelaxed(value: Array, others: Array) -> Array:
    """Ordered overrelaxation (Neal 1998, in Learning in Graphical Models): of a value and further draws of its density, the one as far
    from the other end; for use inside traced code.

    Weights and the strength of their penalty hold each other back; this halves the sweeps that they need.
    """
    values = jnp.append(value, others)
    return values[opposite(values)]


@dataclasses.dataclass(frozen=True)
class WeightSetup(Prepared):
    """The posterior of linear weights, outputs over `size`; the noise model of its problem is for predictions.

    `chosen` are priors of the weights without a penalty, and the user's own.
    """

    chosen: dict[str, AbstractPrior]
    equations: WeightEquations
    grid: NoiseGrid
    size: float

    @classmethod
    def of(
        cls, result: FitResult, noise: str | type[AbstractNoise], priors: Mapping[str, AbstractPrior] | None
    ) -> WeightSetup:
        if not result.problem.space.weights.any():
            raise ParameterError("sampler='weights' needs weights in which the output is linear: use sampler='nuts'")
        if isinstance(priors, CorrelatedPriors):
            raise ParameterError("sampler='weights' takes independent priors: use sampler='nuts'")
        problem = result.problem.with_loss("linear")
        residuals = analyze(problem, result.x)
        diagnosis = diagnose(residuals)
        label = NOISES.label(noise) if noise != "auto" else "ou" if residuals.correlated else "iid"
        if label not in NoiseGrid.models:
            raise ParameterError(
                f"sampler='weights' supports the noise models {' and '.join(NoiseGrid.models)}, got {label}"
            )
        notes = [Note(Code.NOISE_MODEL, f"noise model {label}: {'; '.join(note.text for note in diagnosis.findings)}")]
        if has(diagnosis.findings, Code.REPEATING_RESIDUALS):
            text = "part of the residuals recurs every loop: the model is incomplete, and its weights are biased by more than chance"
            notes.append(warn(Code.INCOMPLETE, text))
        grid = NoiseGrid.one()
        if label == "ou":
            longest = max(row.size for row in residuals.rows)
            of_time = OrnsteinUhlenbeck.default_priors(longest, None)["noise_time"]
            grid = NoiseGrid.about(residuals.slow, residuals.contrasts, of_time)
        chosen, size = weight_priors(problem, result.x, priors), float(problem.scales.y)
        problem = problem.with_noise(NOISES.make(label))
        equations = weight_equations(problem, result.x, grid, chosen, size)
        equations = dataclasses.replace(equations, exact=Exact.of(problem, grid, chosen, size))
        return cls(problem, label, tuple(notes), chosen, equations, grid, size)

    @property
    def priors(self) -> dict[str, AbstractPrior]:
        """Those of single weights."""
        return self.chosen

    def parameters(self, draws: Mapping[str, np.ndarray]) -> np.ndarray:
        """Physical parameters of model and noise from draws of the chains, shape (chains, draws, d)."""
        noise = self.grid.parameters(draws["number"], draws["variance"] * self.size**2)
        return np.concatenate([parameters_of(self.problem.space, draws["w"], self.size), noise], axis=-1)

    def physical(self, z: np.ndarray) -> np.ndarray:
        """The draws are physical."""
        return z
