"""Effective draws per second against emcee with a numba likelihood, in one process: `python benchmarks/sampling.py [--quick]`.

Six-parameter Bouc-Wen (c, mu, tau, rho, offset and the noise's standard deviation), independent Gaussian noise, one discretization,
one posterior: the densities of both programs are compared before anything is timed. The samplers alternate in short turns, so that
other programs affect all equally; rates are effective draws per step over all rounds, divided by the median time of a step.
Compilation, the fit and burn-in are excluded for all; the time of the NUTS warm-up is reported separately. One estimator counts
effective draws (Geyer's sequence, as ArviZ `ess(method="mean")`), for the parameter with the fewest.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable
from typing import Any

import emcee
import jax
import jax.numpy as jnp
import numba
import numpy as np
import scipy.signal
from rows import Row

import hystfit as hf
from hystfit.params.coordinates import BOTH
from hystfit.sampling.bend import BEND, Bend
from hystfit.sampling.diagnostics import effective_size
from hystfit.sampling.ensemble import start, walk
from hystfit.sampling.nuts import Nuts
from hystfit.sampling.setup import Setup, prepare
from hystfit.sampling.target import Target
from hystfit.uncertainty.profiles import profile

PROFILES_S = 3.0  # most that all profiles of a fit of 10 000 samples may take


def record(samples: int, slow: bool = False) -> hf.Record:
    """Cycles of 400 samples, of growing and falling amplitude, with minor loops, and noise of 1 % of the input's half range.

    With `slow`, noise with a correlation time of 30 samples is added, as in the default likelihood.
    """
    t = np.arange(samples) / 400.0
    u = (0.3 + 0.7 * np.sin(np.pi * t / t[-1]) ** 2) * np.sin(2 * np.pi * t) + 0.15 * np.sin(2 * np.pi * 3.3 * t)
    truth = hf.BoucWen(c=1.0, mu=0.45, tau=1.5, rho=0.5, offset=0.1)
    y = np.asarray(hf.simulate(truth, u)[0])
    rng = np.random.default_rng(0)
    y = y + 0.01 * rng.normal(size=samples)
    if slow:
        y += scipy.signal.lfilter(
            [0.01 * np.sqrt(1 - np.exp(-2 / 30))], [1, -np.exp(-1 / 30)], rng.normal(size=samples)
        )
    return hf.Record(u=u, y=y, t=t)


@numba.njit(fastmath=True, inline="always")
def peer_parameters(z, scales):
    """c, mu, tau, rho and the offset of coordinates z, and the log slope of the two with two bounds (`hystfit.sampling.bend`)."""
    a, far = (z / 4 + 0.5) / BEND, 1 / BEND
    part = BEND * (np.log1p(np.exp(a)) - np.log1p(np.exp(a - far)))
    slopes = 1 / (1 + np.exp(-a)) - 1 / (1 + np.exp(far - a))
    values = scales[0] * np.exp(z[0]), part[1], scales[2] * np.exp(z[2]), 2.0 * part[3] - 1.0, scales[4] * z[4]
    return values, np.log(slopes[1]) + np.log(slopes[3])


@numba.njit(fastmath=True, inline="always")
def peer_step(h, dv, m, up, down):
    """h after a step of the input, by the library's semi-implicit step."""
    s = -1.0 if dv < 0 else 1.0
    x, g, highest = abs(dv), s * h, m / up
    below = min(-g / m, x) if g < 0 else 0.0
    half = 0.5 * (up * x + (down - up) * below)
    new = ((1 - half) * g + m * x) / (1 + half)
    return s * min(max(new, min(g, highest)), max(g, highest))


@numba.njit(fastmath=True)
def peer_density(q, center, factor, u, y, scales, wide):
    """Log posterior of one walker up to a constant: the library's parametrization, priors and semi-implicit step in a plain loop."""
    z = center + factor @ q
    (c, mu, tau, rho, offset), slope = peer_parameters(z, scales)
    sigma = scales[5] * np.exp(z[5])
    m, up, down = mu * c, tau * (1 + rho), tau * (1 - rho)
    h, total, before = 0.0, 0.0, u[0]
    for k in range(u.size):
        h = peer_step(h, u[k] - before, m, up, down)
        before = u[k]
        total += (offset + c * u[k] - h - y[k]) ** 2
    prior = -0.5 * (z[0] ** 2 + z[2] ** 2 + z[5] ** 2) / 9.0 - 0.5 * (offset / wide) ** 2
    return prior + slope - 0.5 * total / sigma**2 - u.size * np.log(sigma)


def bent_of(target: Target) -> tuple[Bend, Callable[[jax.Array], jax.Array]]:
    """The coordinates of `hystfit.sampling.bend` for all parameters with two bounds, and the map to them from those of a target."""
    kinds = (*target.density.objective.coordinates.kinds, *target.density.noise.kinds)
    bend = Bend(jnp.equal(jnp.asarray(kinds), BOTH), target.bend.width)
    return bend, lambda v: bend.bent(target.z_and_slope(target.bend.unbent(v))[0])


def plain(target: Target) -> Target:
    """The same density over these coordinates alone, whitened at the center alike."""
    bend, of_v = bent_of(target)
    factor = jax.jacfwd(of_v)(target.center) @ target.factor
    center = of_v(target.center)
    return dataclasses.replace(target, bend=bend, noise=None, slopes=None, center=center, factor=factor)


def peer(setup: Setup) -> Callable[[np.ndarray], float]:
    """The peer's log posterior of whitened coordinates, checked against the library's."""
    target, data = plain(setup.target), setup.problem.data[0]
    scales = np.concatenate([np.asarray(c.scale) for c in (target.density.objective.coordinates, target.density.noise)])
    arrays = tuple(np.asarray(v) for v in (target.center, target.factor, data.u, data.y, scales))
    wide = float(target.density.priors[4].sd)
    return compared(target, lambda q: peer_density(q, *arrays, wide))


def compared(target: Target, density: Callable[[np.ndarray], float]) -> Callable[[np.ndarray], float]:
    """The peer's density, if it differs from the library's by a constant."""
    rows = np.random.default_rng(0).normal(size=(5, target.center.shape[0]))
    ours = np.asarray(jax.vmap(target)(jnp.asarray(rows)))
    theirs = np.array([density(q) for q in rows])
    np.testing.assert_allclose(ours - ours[0], theirs - theirs[0], rtol=1e-7, atol=1e-6)
    return density


class Runner:
    """A sampler that goes on in slices: keeps its draws (slices of shape (steps, chains, d)) and the times of its slices."""

    def __init__(self, advance: Callable[[], np.ndarray], burn: int):
        self.advance, self.draws, self.wall, self.busy = advance, [], [], []
        for _ in range(burn):
            advance()

    def turn(self) -> None:
        wall, busy = time.perf_counter(), time.process_time()
        self.draws.append(self.advance())
        self.wall.append(time.perf_counter() - wall)
        self.busy.append(time.process_time() - busy)

    def row(self) -> dict[str, float]:
        chains = np.swapaxes(np.concatenate(self.draws), 0, 1)
        size = min(effective_size(chains[:, :, k]) for k in range(chains.shape[2]))
        each = size / len(self.draws)
        return {
            "ess": float(size),
            "ess_per_s": each / statistics.median(self.wall),
            "ess_per_processor_s": each / statistics.median(self.busy),
            "us_per_draw": 1e6 * statistics.median(self.wall) / (chains.shape[0] * len(self.draws[0])),
        }


def ensemble(sampler: Any, begin: Any, steps: int) -> Callable[[], np.ndarray]:
    """Slices of an emcee run."""
    state = [begin]

    def advance() -> np.ndarray:
        sampler.reset()
        state[0] = sampler.run_mcmc(state[0], steps, skip_initial_state_check=True)
        return sampler.get_chain()

    return advance


def chain(setup: Setup, slices: int) -> tuple[Callable[[], np.ndarray], float]:
    """Slices of a NUTS chain, and the seconds of a second warm-up (the first compiles)."""
    settings, key = Nuts(chains=1), jax.random.key(0)
    settings.warm(setup.target, key)
    begin = time.perf_counter()
    warm = settings.warm(setup.target, key)
    seconds = time.perf_counter() - begin
    state, count = [jnp.asarray(warm["q"])], iter(range(10**6))

    def advance() -> np.ndarray:
        chunks = []
        for _ in range(slices):
            found = settings.chunk(setup.target, warm, state[0], jax.random.fold_in(key, next(count)))
            state[0] = jnp.asarray(found["q"][-1])
            chunks.append(found["q"])
        return np.concatenate(chunks)[:, None]

    return advance, seconds


def rates(samples: int, rounds: int) -> dict[str, dict[str, float]]:
    """All samplers on one record."""
    fits = [hf.fit("bouc-wen", record(samples, slow), noise="iid", starts=1) for slow in (False, True)]
    white, default = prepare(fits[0], noise="iid"), prepare(fits[1], noise="ou")
    density, d = peer(white), white.target.center.shape[0]
    steps = 100 if samples < 5000 else 40
    moves = [(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)]
    rng = np.random.default_rng(1)
    spread = lambda count: emcee.State(rng.normal(size=(count, d)), random_state=np.random.RandomState(1).get_state())
    runners = {
        "emcee, numba, 64 walkers": Runner(ensemble(emcee.EnsembleSampler(64, d, density), spread(64), steps), 4),
        "emcee, numba, 64, our moves": Runner(
            ensemble(emcee.EnsembleSampler(64, d, density, moves=moves), spread(64), steps), 4
        ),
    }
    for label, setup in (("iid", white), ("ou", default)):
        begin = start(setup.target, 128, 1)
        runners[f"hystfit emcee, {label}, 128"] = Runner(ensemble(walk(setup.target, 128), begin, steps), 4)
        advance, seconds = chain(setup, 8 if samples < 5000 else 2)
        runners[f"hystfit nuts, {label}"] = runner = Runner(advance, 1)
        runner.warmup_s = seconds
    for _ in range(rounds):
        for runner in runners.values():
            runner.turn()
    rows = {name: runner.row() for name, runner in runners.items()}
    for name, runner in runners.items():
        if hasattr(runner, "warmup_s"):
            rows[name]["warmup_s"] = runner.warmup_s
    return rows


def profiles(samples: int, repeats: int) -> dict[str, float]:
    """Seconds of all profiles of a fit of six parameters of the model (the initial state is the sixth)."""
    fit = hf.fit("bouc-wen", record(samples), free=["h0"], noise="iid", starts=1)
    times = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        found = profile(fit)
        times.append(time.perf_counter() - begin)
    return {"parameters": len(found.profiles), "first_s": times[0], "profiles_s": statistics.median(times[1:])}


def measure(quick: bool) -> list[Row]:
    """Rows of the suite: seconds of one effective draw. Profiles have no peer and a limit of their own."""
    rows = []
    for samples in (500,) if quick else (2_000, 10_000):
        found = rates(samples, 2 if quick else 25)
        base = 1 / found["emcee, numba, 64 walkers"]["ess_per_s"]
        for name in ("hystfit emcee, iid, 128", "hystfit nuts, iid"):
            rows.append(Row(f"{name}, {samples} samples / emcee + numba", 1 / found[name]["ess_per_s"], base))
    taken = profiles(500 if quick else 10_000, 1 if quick else 5)["profiles_s"]
    if not quick and taken > PROFILES_S:
        raise SystemExit(f"all profiles of a fit take {taken:.1f} s; the limit is {PROFILES_S} s")
    return rows


if __name__ == "__main__":
    from run import alone

    alone("sampling")
