"""The ensemble sampler emcee with differential-evolution moves over a vectorized likelihood; resumes after interruption.

The snooker move is never used: in emcee 3.1.6 it samples a distribution that is too narrow (upstream pull request 531).
"""

from __future__ import annotations

import dataclasses
import io
import os
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from hystfit.errors import DataError, ParameterError, optional
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.params.host_arrays import to_device
from hystfit.sampling.base import AbstractSampler, Progress, Raw
from hystfit.sampling.self_contained import refuse_outside
from hystfit.sampling.setup import Setup
from hystfit.sampling.target import Target, log_densities

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
        """Draw, or continue from the file in a folder.

        Raises:
            ParameterError: too few walkers or too many parameters.
        """
        target, d = setup.target, setup.target.center.shape[0]
        if self.walkers < 2 * d + 2:
            raise ParameterError(f"{d} parameters need at least {2 * d + 2} walkers, got {self.walkers}")
        model = len(setup.problem.space)
        if model > MOST:
            raise ParameterError(f"emcee is for up to {MOST} parameters, and the model has {model}: use sampler='nuts'")
        sampler = walk(target, self.walkers)
        file = None if folder is None else folder / "emcee.h5"
        chain, logs, accepted, state = _resume(file, self.walkers, d) or _begin(target, self.walkers, seed)
        tau, settled = (
            _check_convergence(chain, longest_time(chain[: -len(chain) // 20])) if len(chain) else (np.inf, False)
        )
        while len(chain) < self.draws and not settled:
            count = min(max(self.check, len(chain) // 20), self.draws - len(chain))
            sampler.reset()
            state: Any = sampler.run_mcmc(state, count, skip_initial_state_check=True)
            chain = np.concatenate([chain, np.asarray(sampler.get_chain())])
            logs = np.concatenate([logs, np.asarray(sampler.get_log_prob())])
            accepted = accepted + sampler.backend.accepted
            if file is not None:
                _write(file, chain, logs, accepted, state.random_state)
            tau, settled = _check_convergence(chain, tau)
            report(
                f"{len(chain)} steps of {self.walkers} walkers, about {len(chain) * self.walkers / tau:.0f} effective draws so far",
                len(chain) / self.draws,
            )
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


def _check_convergence(chain: np.ndarray, before: float) -> tuple[float, bool]:
    """The autocorrelation time now, and whether the chain is long enough for it."""
    tau = longest_time(chain, before)
    return tau, bool(len(chain) > _LONG * tau and abs(before - tau) < _STEADY * tau)


def walk(target: Target, walkers: int) -> Any:
    """The emcee sampler over whitened coordinates: differential evolution, and now and then a jump from mode to mode."""
    import emcee

    density = lambda q: np.asarray(log_densities(target, to_device(q)))
    moves = [(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)]
    return emcee.EnsembleSampler(walkers, target.center.shape[0], density, vectorize=True, moves=moves)


def start(target: Target, walkers: int, seed: int, away: float = 1.0) -> Any:
    """emcee's state with walkers about the mode, each where the density is finite.

    `away` is the standard deviation of their places in whitened coordinates.
    """
    import emcee

    d, rng = target.center.shape[0], np.random.default_rng(seed)
    q = away * rng.normal(size=(walkers, d))
    density = lambda q: np.concatenate(
        [log_densities(target, to_device(half)) for half in np.split(q, 2)]
    )  # as emcee calls it
    logs = density(q)
    for _ in range(60):
        bad = ~np.isfinite(logs)
        if not bad.any():
            break
        q[bad] *= 0.7
        logs = density(q)
    legacy = np.random.RandomState(seed).get_state()
    return emcee.State(q, log_prob=logs, random_state=legacy)


def _begin(target: Target, walkers: int, seed: int) -> tuple[Any, ...]:
    """An empty chain and the state to start from."""
    d = target.center.shape[0]
    return np.zeros((0, walkers, d)), np.zeros((0, walkers)), np.zeros(walkers), start(target, walkers, seed)


def _write(file: Path, chain: np.ndarray, logs: np.ndarray, accepted: np.ndarray, random_state: Any) -> None:
    """The whole run in emcee's own HDF5 layout, first beside the old file, then in its place: a kill leaves one or the other."""
    import emcee

    content = io.BytesIO()  # HDF5 itself may crash where a disk is full
    with optional("h5py", "bayes", "a resumable emcee run").File(content, "w") as handle:
        group = handle.create_group("mcmc")
        group.attrs.update(version=emcee.__version__, nwalkers=chain.shape[1], ndim=chain.shape[2], has_blobs=False)
        group.attrs["iteration"] = len(chain)
        for k, part in enumerate(random_state):
            group.attrs[f"random_state_{k}"] = part
        for name, values in (("chain", chain), ("log_prob", logs), ("accepted", accepted)):
            group.create_dataset(name, data=values)
    scratch = file.with_name(f".{file.name}")
    scratch.write_bytes(content.getvalue())
    os.replace(scratch, file)


def _resume(file: Path | None, walkers: int, d: int) -> tuple[Any, ...] | None:
    """What `_write` wrote and the state to go on from; None where there is no file.

    Raises:
        DataError: the file is damaged or of another run.
    """
    import emcee

    if file is None or not file.exists():
        return None
    refuse_outside(file.read_bytes(), str(file))
    try:
        backend = emcee.backends.HDFBackend(str(file), read_only=True)
        chain, logs = np.asarray(backend.get_chain()), np.asarray(backend.get_log_prob())
        accepted, random_state = np.array(backend.accepted), tuple(backend.random_state or ())
    except (OSError, KeyError, AttributeError, ValueError, TypeError, IndexError) as error:
        raise DataError(
            f"{str(file)!r} is not an emcee run that can be resumed (damaged?): remove it to start again"
        ) from error
    if chain.shape[1:] != (walkers, d):
        raise DataError(
            f"{str(file)!r} holds {chain.shape[1:]} walkers and parameters, not {(walkers, d)}: remove it to start again"
        )
    return chain, logs, accepted, emcee.State(chain[-1], log_prob=logs[-1], random_state=random_state)
