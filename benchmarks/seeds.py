"""The default sampler under the default noise from ten seeds, beside emcee with a numba likelihood of the same posterior.

`python benchmarks/seeds.py`: 2000 samples with slow and independent noise, 2 chains of 1000 draws a seed. Printed are effective draws of
the worst coordinate per second of processor time, without burn-in of the ensemble and the fit of the proposals, and the
probability of a tail beside a long run of the ensemble.
"""

from __future__ import annotations

import dataclasses
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import emcee
import jax
import jax.numpy as jnp
import numba
import numpy as np
from sampling import Runner, compared, ensemble, peer_parameters, peer_step, plain, record

import hystfit as hf
from hystfit.sampling.diagnostics import effective_size
from hystfit.sampling.independence import Independence
from hystfit.sampling.setup import Setup, prepare

WALKERS, SEEDS, TAIL = 64, 10, 0.9  # the tail is rho > 0.9
BEGIN = 100  # draws of each chain that are not counted


@numba.njit(fastmath=True)
def peer_density(q, center, factor, u, y, scales, wide, median, spread):
    """Log posterior of one walker up to a constant; slow noise by a Kalman filter."""
    z = center + factor @ q
    (c, mu, tau, rho, offset), slope = peer_parameters(z, scales)
    white, slow, time = scales[5] * np.exp(z[5]), scales[6] * np.exp(z[6]), 1.0 + scales[7] * np.exp(z[7])
    decay = np.exp(-1.0 / time)
    fresh = slow**2 * (1 - decay**2)
    m, up, down = mu * c, tau * (1 + rho), tau * (1 - rho)
    h, total, before = 0.0, 0.0, u[0]
    mean, variance = 0.0, slow**2
    for k in range(u.size):
        h = peer_step(h, u[k] - before, m, up, down)
        before = u[k]
        if k > 0:
            mean, variance = decay * mean, decay**2 * variance + fresh
        whole = variance + white**2
        e = y[k] - (offset + c * u[k] - h) - mean
        total += e * e / whole + np.log(whole)
        mean, variance = mean + variance / whole * e, variance * white**2 / whole
    prior = -0.5 * (z[0] ** 2 + z[2] ** 2 + z[5] ** 2 + z[6] ** 2) / 9.0 - 0.5 * (offset / wide) ** 2
    prior -= 0.5 * ((np.log(time - 1.0) - np.log(median)) / spread) ** 2
    return prior + slope - 0.5 * total


def peer(setup: Setup) -> Callable[[np.ndarray], float]:
    """The peer's log posterior of whitened coordinates, checked against the library's."""
    target, data = plain(setup.target), setup.problem.data[0]
    scales = np.concatenate([np.asarray(c.scale) for c in (target.density.objective.coordinates, target.density.noise)])
    arrays = tuple(np.asarray(v) for v in (target.center, target.factor, data.u, data.y, scales))
    priors = target.density.priors
    widths = float(priors[4].sd), float(priors[7].median), float(priors[7].spread)
    return compared(target, lambda q: peer_density(q, *arrays, *widths))


def of_rho(setup: Setup, q: np.ndarray) -> np.ndarray:
    """1 where rho lies in the tail, shape (chains, draws), from draws of shape (chains, draws, d)."""
    z = np.asarray(plain(setup.target).unwhitened(jnp.asarray(q)))[..., 3]
    return (2 / (1 + np.exp(-z)) - 1 > TAIL).astype(float)


def walkers(density: Callable[[np.ndarray], float], d: int, moves: Any = None) -> Runner:
    """A run of emcee in turns of 200 steps, after 2000 steps."""
    begin = emcee.State(
        np.random.default_rng(1).normal(size=(WALKERS, d)), random_state=np.random.RandomState(1).get_state()
    )
    runner = Runner(ensemble(emcee.EnsembleSampler(WALKERS, d, density, moves=moves), begin, 200), 10)
    for _ in range(40):
        runner.turn()
    return runner


def chains(setup: Setup, seed: int, settings: Independence) -> tuple[np.ndarray, float, float]:
    """Draws in the coordinates of the peer, shape (chains, draws, d), seconds of processor time that they took, and those before them.

    The first `BEGIN` draws of each chain and the fit of the proposals count as the time before.
    """
    report, times = lambda text, fraction: None, [time.process_time()]
    with tempfile.TemporaryDirectory() as folder:
        for draws in (BEGIN, settings.draws):
            raw = dataclasses.replace(settings, draws=draws).run(setup, seed, Path(folder), report)
            times.append(time.process_time())
    target, z = plain(setup.target), raw.z[:, BEGIN:]
    v = jax.vmap(target.bend.bent)(jnp.asarray(z.reshape(-1, z.shape[-1])))
    before, busy = np.diff(times).tolist()
    return target.q_of(np.asarray(v).reshape(z.shape), np), busy, before


def main() -> None:
    hf.enable_x64()
    setup = prepare(hf.fit("bouc-wen", record(2000, slow=True), noise="iid", starts=1), noise="ou")
    d = setup.target.center.shape[0]
    density = peer(setup)
    base = walkers(density, d).row()["ess_per_processor_s"]
    # The default moves reach the tail too seldom for a reference; these mix several times faster.
    runner = walkers(density, d, [(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)])
    tail = of_rho(setup, np.swapaxes(np.concatenate(runner.draws), 0, 1))
    error = np.sqrt(tail.mean() * (1 - tail.mean()) / effective_size(tail))
    print(f"emcee + numba: {base:.0f} effective draws a second, P(rho > {TAIL}) = {tail.mean():.4f} +- {error:.4f}")
    settings, ratios, tails = Independence(chains=2, draws=1000), [], []
    chains(setup, SEEDS, settings)  # compiles
    for seed in range(SEEDS):
        q, busy, before = chains(setup, seed, settings)
        size = min(effective_size(q[:, :, k]) for k in range(d))
        ratios.append(size / busy / base)
        tails.append(float(of_rho(setup, q).mean()))
        print(
            f"seed {seed}: {size:.0f} effective draws, {ratios[-1]:.2f} times as many a second after {before:.2f} s, P = {tails[-1]:.4f}",
            flush=True,
        )
    print(
        f"median {statistics.median(ratios):.2f}, worst {min(ratios):.2f}, P = {np.mean(tails):.4f} +- {np.std(tails) / 3:.4f}"
    )


if __name__ == "__main__":
    main()
