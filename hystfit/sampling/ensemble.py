"""The ensemble sampler emcee with differential-evolution moves over a vectorized likelihood; resumes after interruption.

The snooker move is never used: in emcee 3.1.6 it samples a distribution that is too narrow (upstream pull request 531).
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from hystfit.errors import ParameterError
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.params.host_arrays import to_device
from hystfit.runs.chunks import keep, load
from hystfit.sampling.base import AbstractSampler, Progress, Raw
from hystfit.sampling.setup import Setup
from hystfit.sampling.target import Target, log_densities_and_z

MOST = 10  # parameters of a model beyond which ensembles mix too slowly
_LONG = 50.0  # chains are long enough when they hold this many autocorrelation times
_STEADY = 0.05  # and their estimate of it has settled to this, relative
_FINE = 20.0  # samples per autocorrelation time that suffice to estimate it


@dataclasses.dataclass(frozen=True)
class Ensemble(AbstractSampler):
    """Settings of emcee.

    Attributes:
        walkers: even, more than twice the number of parameters.
        draws: steps at most; it stops sooner when the autocorrelation time is known and chains hold 50 of it.
        check: steps between two looks at the autocorrelation time, and writes to disk; a twentieth of the chain once that is longer.
    """

    name: ClassVar[str] = "emcee"
    many_short_chains: ClassVar[bool] = True
    walkers: int = 64
    draws: int = 5000
    check: int = 250

    def __post_init__(self) -> None:
        self.check_counts({"walkers": 2, "draws": 50, "check": 10})
        if self.walkers % 2:
            raise ParameterError(f"walkers must be even, got {self.walkers}")

    def run(self, setup: Setup, seed: int, folder: Path | None, report: Progress) -> Raw:
        """Draw, or continue from the chunks in a folder."""
        target, d = setup.target, setup.target.center.shape[0]
        if self.walkers < 2 * d + 2:
            raise ParameterError(f"{d} parameters need at least {2 * d + 2} walkers, got {self.walkers}")
        model = len(setup.problem.space)
        if model > MOST:
            raise ParameterError(f"emcee is for up to {MOST} parameters, and the model has {model}: use sampler='nuts'")
        sampler, chain = walk(target, self.walkers), np.zeros((0, self.walkers, d))
        parts, tau, settled = list[dict[str, np.ndarray]](), np.inf, False
        while not settled:
            file = None if folder is None else folder / f"emcee-{len(parts):05d}.npz"
            part = None if file is None else load(file)
            if part is None:
                if len(chain) >= self.draws:
                    break
                state = _state(parts[-1]) if parts else start(target, self.walkers, seed)
                part = _advance(sampler, state, min(max(self.check, len(chain) // 20), self.draws - len(chain)))
                if file is not None:
                    keep(file, part)
            parts.append(part)
            chain = np.concatenate([chain, part["chain"]])
            before, tau = tau, longest_time(chain, tau)
            settled = len(chain) > _LONG * tau and abs(before - tau) < _STEADY * tau
            report(
                f"{len(chain)} steps of {self.walkers} walkers, about {len(chain) * self.walkers / tau:.0f} effective draws so far",
                len(chain) / self.draws,
            )
        logs, accepted = np.concatenate([part["logs"] for part in parts]), sum(part["accepted"] for part in parts)
        return self._collect(target, chain, logs, accepted, tau, settled)

    def _collect(
        self, target: Target, chain: np.ndarray, logs: np.ndarray, accepted: np.ndarray, tau: float, settled: bool
    ) -> Raw:
        burn = min(int(np.ceil(5 * tau)) if np.isfinite(tau) else len(chain) // 2, len(chain) // 2)
        q = np.swapaxes(chain[burn:], 0, 1)
        z = np.asarray(target.unwhitened(q))
        rate = np.broadcast_to((accepted / len(chain))[:, None], q.shape[:2])
        notes = [Note(Code.CHAINS, f"emcee: autocorrelation time {tau:.3g} steps; the first {burn} steps are left out")]
        if not settled:
            text = f"the chains hold {len(chain) / tau:.0f} autocorrelation times ({_LONG:.0f} are needed): take more steps"
            notes.append(warn(Code.CHAINS, text))
        return Raw(z, np.swapaxes(logs[burn:], 0, 1), {"acceptance": np.array(rate)}, tuple(notes), complete=settled)


def longest_time(chain: Float[np.ndarray, "steps walkers d"], before: float = np.inf) -> float:
    """Longest integrated autocorrelation time of a chain [steps], given an earlier estimate of it.

    Steps much closer to each other than that add no information and are skipped, so that the estimate costs less than the steps since
    the last one. Infinite while a walker has not moved.
    """
    import emcee

    every = max(1, int(before / _FINE)) if np.isfinite(before) else 1
    with np.errstate(invalid="ignore"):
        time = every * float(np.max(emcee.autocorr.integrated_time(chain[::every], tol=0, quiet=True)))
    return time if np.isfinite(time) else np.inf


def walk(target: Target, walkers: int) -> Any:
    """The emcee sampler over whitened coordinates: differential evolution, and now and then a jump from mode to mode."""
    import emcee

    density = lambda q: np.asarray(log_densities_and_z(target, to_device(q))[0])
    moves = [(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)]
    return emcee.EnsembleSampler(walkers, target.center.shape[0], density, vectorize=True, moves=moves)


def start(target: Target, walkers: int, seed: int, away: float = 1.0) -> Any:
    """emcee's state with walkers about the mode where the density is finite, `away` standard deviations in whitened coordinates."""
    import emcee

    d, rng = target.center.shape[0], np.random.default_rng(seed)
    q = away * rng.normal(size=(walkers, d))
    # In halves, as emcee calls it.
    density = lambda q: np.concatenate([log_densities_and_z(target, to_device(half))[0] for half in np.split(q, 2)])
    logs = density(q)
    for _ in range(60):
        bad = ~np.isfinite(logs)
        if not bad.any():
            break
        q[bad] *= 0.7
        logs = density(q)
    legacy = np.random.RandomState(seed).get_state()
    return emcee.State(q, log_prob=logs, random_state=legacy)


def _advance(sampler: Any, state: Any, count: int) -> dict[str, np.ndarray]:
    """Some more steps: places, log densities, accepted steps of each walker, and the state of the random numbers after them."""
    sampler.reset()
    random_state = sampler.run_mcmc(state, count, skip_initial_state_check=True).random_state
    chain, logs = np.asarray(sampler.get_chain()), np.asarray(sampler.get_log_prob())
    part = {"chain": chain, "logs": logs, "accepted": np.asarray(sampler.backend.accepted)}
    return part | {f"random{k}": np.asarray(value) for k, value in enumerate(random_state)}


def _state(part: dict[str, np.ndarray]) -> Any:
    """emcee's state after the steps of `_advance`."""
    import emcee

    random_state = tuple(part[f"random{k}"][()] for k in range(5))
    return emcee.State(part["chain"][-1], log_prob=part["logs"][-1], random_state=random_state)
