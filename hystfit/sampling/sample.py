"""`sample`: from a fit to posterior draws with a verdict on their convergence."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import require_seed, require_x64
from hystfit.errors import ParameterError
from hystfit.inference.priors import AbstractPrior, LogNormal
from hystfit.results.result import FitResult, provenance
from hystfit.sampling.chunks import claim
from hystfit.sampling.diagnostics import Convergence
from hystfit.sampling.ensemble import Ensemble
from hystfit.sampling.nested import Nested
from hystfit.sampling.nuts import Nuts
from hystfit.sampling.posterior import Posterior
from hystfit.sampling.setup import Setup, prepare
from hystfit.sampling.target import Target

_AS_WIDE = 0.5  # width of a posterior over that of its prior above which the data say little

SAMPLERS = {"nuts": Nuts, "emcee": Ensemble, "nested": Nested}


def sample(
    result: FitResult,
    sampler: Literal["nuts", "emcee", "nested"] = "nuts",
    *,
    noise: Literal["auto", "iid", "ou", "ar1", "student-t", "discrepancy"] = "auto",
    priors: Mapping[str, AbstractPrior] | None = None,
    seed: int = 0,
    folder: str | Path | None = None,
    progress: Callable[[str, float], None] | None = None,
    **settings: Any,
) -> Posterior:
    """Draw from the posterior of a fitted model and its noise.

    Args:
        result: a fit; sampling starts at its posterior mode, whitened by the curvature there.
        sampler: "nuts" (blackjax), "emcee" for up to ten parameters, or "nested" (blackjax) where the posterior may have several
            modes or the evidence is wanted: it starts from the priors, and takes minutes.
        noise: the noise model; "auto" takes slow and independent noise ("ou") unless the residuals call for more, and says why.
        priors: the user's own, such as {"tau": hystfit.inference.priors.LogNormal(1.0, 0.5)}; weak defaults for the others.
        seed: of the draws.
        folder: keeps the run while it goes; the same call with the same folder goes on after a kill.
        progress: called from time to time with a line and the part that is done, such as `print`.
        **settings: of the sampler (`Nuts`, `Ensemble`, `Nested`): draws, chains, warmup, walkers, ...

    Returns:
        Draws with a status; look at `usable` and `notes` first.

    Raises:
        HystfitError: settings, priors or a folder that cannot be used; an optional package that is missing.
    """
    require_x64()
    seed = require_seed(seed)
    if sampler not in SAMPLERS:
        raise ParameterError(f"sampler must be one of {', '.join(SAMPLERS)}, got {sampler!r}")
    known = [field.name for field in dataclasses.fields(SAMPLERS[sampler])]
    if unknown := [name for name in settings if name not in known]:
        raise ParameterError(f"settings of {sampler} are {', '.join(known)}; got {', '.join(unknown)}")
    chosen = SAMPLERS[sampler](**settings)
    setup = prepare(result, noise=noise, priors=priors)
    place = None if folder is None else _claim(Path(folder), setup, result, chosen, sampler, seed)
    started = time.perf_counter()
    raw = chosen.run(setup, seed, place, progress or (lambda words, part: None))
    seconds = time.perf_counter() - started
    draws = physical_draws(setup, raw.z)
    convergence = Convergence.of(_independent(draws) if sampler == "emcee" else draws)
    good, why = convergence.verdict(setup.names)
    moved = np.isfinite(draws).all()
    notes = (*_of_the_fit(result), *setup.notes, *raw.notes, *why, *beside_priors(setup, draws))
    unsettled = any("more steps are needed" in note for note in raw.notes)
    status = "ok" if good and moved and not unsettled else "not-converged"
    if status == "ok" and result.status in ("poor", "no-loop"):
        status = "poor-fit"
    return Posterior(
        result=result,
        sampler=sampler,
        noise=setup.noise_name,
        names=setup.names,
        units=setup.units,
        draws=draws,
        log_density=raw.log_density,
        stats=raw.stats,
        convergence=convergence,
        status=status,
        notes=notes,
        priors=setup.describe_priors(),
        seconds=seconds,
        seed=seed,
        provenance=provenance(result.data, seed, fit={"date": result.provenance.get("date")}),
        evidence=raw.evidence,
    )


def _independent(draws: np.ndarray) -> np.ndarray:
    """Walkers in four groups, end to end: one walker alone is far too short a chain for R-hat."""
    walkers, n, d = draws.shape
    groups = draws[: 4 * (walkers // 4)].reshape(4, walkers // 4, n, d)
    return groups.reshape(4, -1, d)


def physical_draws(setup: Setup, z: np.ndarray) -> np.ndarray:
    """x of draws z, shape (chains, draws, d)."""
    flat = jnp.asarray(z.reshape(-1, z.shape[-1]))
    return np.asarray(_physical(setup.target, flat)).reshape(z.shape)


@eqx.filter_jit
def _physical(target: Target, z: Array) -> Array:
    return jax.vmap(target.physical)(z)


def beside_priors(setup: Setup, draws: Float[np.ndarray, "chains draws d"]) -> list[str]:
    """Parameters about which the draws say hardly more than the prior, or that they put where the prior expects nothing."""
    key, notes = jax.random.key(0), []
    for k, (name, prior) in enumerate(zip(setup.names, setup.target.priors, strict=True)):
        expected = np.asarray(prior.sample(jax.random.fold_in(key, k), (2000,)))
        middle = np.median(draws[:, :, k])
        if not np.any(expected < middle) or not np.any(expected > middle):
            notes.append(
                f"{name} lies where its prior ({prior}) expects next to nothing: data and prior contradict each other"
            )
            continue
        ratio = _spread(prior, draws[:, :, k]) / _spread(prior, expected)
        if ratio > _AS_WIDE:
            notes.append(f"{name} is hardly determined: its posterior is {ratio:.0%} as wide as its prior ({prior})")
    return notes


def _spread(prior: AbstractPrior, x: np.ndarray) -> float:
    """Distance between the quartiles, of the logarithm where the prior is one over the logarithm."""
    if isinstance(prior, LogNormal):
        x = np.log(np.maximum(prior.side * (x - float(prior.edge)), 1e-300))
    return float(np.subtract(*np.quantile(x, [0.75, 0.25])))


def _of_the_fit(result: FitResult) -> list[str]:
    """What speaks against drawing from this fit at all."""
    if result.usable:
        return []
    return [f"the fit from which the draws start is not usable ({result.status}): {result.advice}"]


def _claim(
    folder: Path, setup: Setup, result: FitResult, chosen: Nuts | Ensemble | Nested, sampler: str, seed: int
) -> Path:
    """The folder of a run: with more draws it is the same."""
    from hystfit.models.storage import to_json

    described = {
        "data": [record.digest() for record in result.data],
        "model": [to_json(model) for model in result.models],
        "free": list(setup.names),
        "noise": setup.noise_name,
        "priors": {name: prior.exact() for name, prior in zip(setup.names, setup.target.priors, strict=True)},
        "sampler": sampler,
        "seed": seed,
        "settings": {k: v for k, v in dataclasses.asdict(chosen).items() if k != "draws"},
    }
    return claim(folder, "run.json", described)
