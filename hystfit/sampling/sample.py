"""`sample`: from a fit to posterior draws with a status from their convergence."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import require_seed, verb
from hystfit.errors import ParameterError
from hystfit.inference.correlated_priors import CorrelatedPriors, Dependence
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.priors import LITTLE, SEEN, AbstractPrior, HalfNormal, LogNormal, Normal
from hystfit.inference.residuals import analyze, diagnose
from hystfit.models.storage import to_json
from hystfit.outcome import Code, Note, Severity, Status
from hystfit.outcome.note import has, warn
from hystfit.outcome.wrapping import listed
from hystfit.results.estimates import differences
from hystfit.results.provenance import provenance
from hystfit.results.result import FitResult
from hystfit.results.saving.folders import alone
from hystfit.runs.chunks import claim
from hystfit.sampling.base import AbstractSampler, Progress
from hystfit.sampling.diagnostics import Convergence
from hystfit.sampling.noise_grid import NoiseGrid
from hystfit.sampling.posterior import Posterior
from hystfit.sampling.registry import SAMPLERS
from hystfit.sampling.setup import MOST, Prepared
from hystfit.sampling.weight_equations import are_free_or_positive

_SLOW = 0.15  # fraction of the record over which noise is correlated, above which it is an error of the model


@verb
def sample(
    result: FitResult,
    sampler: str | type[AbstractSampler] | AbstractSampler = "auto",
    *,
    noise: str | type[AbstractNoise] = "auto",
    priors: Mapping[str, AbstractPrior] | None = None,
    seed: int = 0,
    folder: str | Path | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Posterior:
    """Draw from the posterior of a fitted model and its noise.

    Args:
        result: a fit; sampling starts at its posterior mode, whitened by the curvature there.
        sampler: "auto" ("weights" if most parameters are weights of cells or plays, otherwise "independence"),
            "independence" (independence chains where a mixture of t distributions covers the posterior, else NUTS), "nuts" (blackjax),
            "weights" for hundreds of linear weights, "emcee" for up to ten parameters, "nested" (blackjax) where the
            posterior may have several modes or the evidence is wanted (it starts from the priors and takes minutes),
            my_sampler.py:MySampler, or a sampler.
        noise: the noise model; "auto" takes slow and independent noise ("ou") unless the residuals need another, and adds a note.
        priors: your own, such as {"tau": hystfit.priors.LogNormal(1.0, 0.5)}, or `CorrelatedPriors`; weak defaults for the
            others.
        seed: random seed of the draws.
        folder: stores the run in progress; the same call with the same folder resumes after an interruption.
        progress: called repeatedly with a line of text and the fraction that is done.
        **settings: settings of the sampler (`Independence`, `Nuts`, `Ensemble`, `Nested`, `Weights`): draws, chains, warmup, walkers, ...

    Returns:
        Draws with a status; check `usable` and `notes` before using them.

    Raises:
        HystfitError: settings, priors or a folder that cannot be used; an optional package that is missing.
    """
    seed = require_seed(seed)
    if isinstance(sampler, str) and sampler == "auto":
        sampler = suited_sampler(result, noise, priors)
        if sampler == "independence" and not set(settings) <= set(_settings_of(SAMPLERS.find(sampler))):
            sampler = "nuts"  # a setting of NUTS is given
    chosen = _make(sampler, settings)
    with contextlib.nullcontext() if folder is None else alone(folder):
        setup = chosen.prepare(result, noise, priors)
        started = time.perf_counter()
        place = None if folder is None else _claim(Path(folder), setup, result, chosen, seed)
        raw = chosen.run(setup, seed, place, progress or (lambda text, fraction: None))
    seconds = time.perf_counter() - started
    draws = setup.physical(raw.z)
    convergence = Convergence.of(_pooled(draws) if chosen.many_short_chains else draws)
    problems = convergence.problems(setup.names)
    drift = drift_notes(setup, draws, longest=max(int(record.used.sum()) for record in result.data))
    converged = not problems and raw.complete and bool(np.isfinite(draws).all())
    diverging = bool(np.any(raw.stats.get("diverging", False)))
    incomplete = has((*drift, *setup.notes), Code.INCOMPLETE)
    status = _status(result, converged=converged, diverging=diverging, incomplete=incomplete)
    return Posterior(
        result=result,
        sampler=raw.sampler or chosen.name,
        noise=setup.noise,
        names=setup.names,
        units=setup.problem.units,
        draws=draws,
        log_density=raw.log_density,
        stats=raw.stats | {"log_prior": _log_prior(setup, draws) + raw.stats.get("log_penalty", 0.0)},
        convergence=convergence,
        status=status,
        notes=(
            *notes_of_fit(result),
            *drift,
            *setup.notes,
            *raw.notes,
            *problems,
            *prior_dominated_notes(setup, draws),
            *_agreement_notes(result, setup, draws),
        ),
        priors={name: str(prior) for name, prior in setup.priors.items()},
        seconds=seconds,
        seed=seed,
        provenance=provenance(result.data, seed, fit={"date": result.provenance.get("date")}),
        evidence=raw.evidence,
        prior_quartiles={name: prior.quantiles([0.25, 0.75]).tolist() for name, prior in setup.priors.items()},
    )


def _status(result: FitResult, *, converged: bool, diverging: bool, incomplete: bool) -> Status:
    """The first obstacle to using the draws; `incomplete` where the residuals show what the model lacks."""
    if not converged:
        return Status.NOT_CONVERGED
    if diverging:
        return Status.DIVERGING
    if result.status in (Status.POOR, Status.NO_LOOP):
        return Status.POOR_FIT
    return Status.INCOMPLETE if incomplete or result.status is Status.ROUGH else Status.OK


def suited_sampler(
    result: FitResult, noise: str | type[AbstractNoise] = "auto", priors: Mapping[str, AbstractPrior] | None = None
) -> str:
    """The sampler that suits a fit: "weights" if most parameters are weights and it supports their noise and priors (as in `sample`).

    If the residuals need a noise model that "weights" lacks, "independence" is chosen for up to `MOST` parameters.
    """
    problem, space = result.problem, result.problem.space
    if not space.mostly_linear or not space.weights.any() or not are_free_or_positive(space):
        return "independence"
    linear = {name.partition("@")[0] for name, weight in zip(space.names, space.linear, strict=True) if weight}
    given = [prior for name, prior in (priors or {}).items() if name.partition("@")[0] in linear]
    if isinstance(priors, CorrelatedPriors) or not all(isinstance(prior, Normal | HalfNormal) for prior in given):
        return "independence"
    if problem.model.estimator is None and noise == "auto" and len(space) <= MOST:
        noise = diagnose(analyze(problem.with_loss("linear"), result.x)).recommended
    return "weights" if noise == "auto" or NOISES.label(noise) in NoiseGrid.models else "independence"


def _make(sampler: str | type[AbstractSampler] | AbstractSampler, settings: dict[str, Any]) -> AbstractSampler:
    if isinstance(sampler, AbstractSampler):
        return dataclasses.replace(sampler, **settings)
    kind: Any = SAMPLERS.find(sampler)
    known = _settings_of(kind)
    if unknown := [name for name in settings if name not in known]:
        raise ParameterError(f"settings of {sampler} are {', '.join(known)}; got {', '.join(unknown)}")
    return kind(**settings)


def _settings_of(kind: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(kind)]


def _pooled(draws: np.ndarray) -> np.ndarray:
    """Walkers in four groups, end to end: one walker alone is far too short a chain for R-hat."""
    walkers, n, d = draws.shape
    groups = draws[: 4 * (walkers // 4)].reshape(4, walkers // 4, n, d)
    return groups.reshape(4, -1, d)


def _log_prior(setup: Prepared, draws: Float[np.ndarray, "chains draws d"]) -> Float[np.ndarray, "chains draws"]:
    at = [setup.names.index(name) for name in setup.priors]
    rows = jnp.asarray(draws[:, :, at].reshape(-1, len(at)))
    return np.asarray(_log_densities(tuple(setup.priors.values()), setup.dependence, rows)).reshape(draws.shape[:2])


@eqx.filter_jit
def _log_densities(priors: tuple[AbstractPrior, ...], dependence: Dependence | None, rows: Array) -> Array:
    def one(x: Array) -> Array:
        total = sum((prior.log_density(x[k]) for k, prior in enumerate(priors)), jnp.zeros(()))
        return total if dependence is None else total + dependence.log_density(priors, x)

    return jax.vmap(one)(rows)


def prior_dominated_notes(setup: Prepared, draws: Float[np.ndarray, "chains draws d"]) -> list[Note]:
    """Notes on parameters whose posterior is hardly narrower than the prior, or lies in the far tail of it."""
    key, notes = jax.random.key(0), []
    wide: dict[str, list[tuple[str, float]]] = {}
    for name, prior in setup.priors.items():
        k = setup.names.index(name)
        expected = np.asarray(prior.sample(jax.random.fold_in(key, k), (SEEN,)))
        middle = np.median(draws[:, :, k])
        if _in_tail(prior, middle, expected):
            text = f"the posterior of {name} lies in the far tail of its prior ({prior}): the prior is inconsistent with the data"
            notes.append(warn(Code.PRIOR, text))
            continue
        ratio = _spread(prior, draws[:, :, k]) / _spread(prior, expected)
        if ratio > LITTLE:
            wide.setdefault(str(prior), []).append((name, 100 * ratio))
    return [*notes, *(warn(Code.PRIOR, _as_wide_words(prior, rows)) for prior, rows in wide.items())]


def _in_tail(prior: AbstractPrior, middle: float, expected: Float[np.ndarray, " n"]) -> bool:
    """Whether a value lies beyond all draws of a prior, on a side to which its density falls (a weight near zero is not unusual)."""
    beyond = not np.any(expected < middle) or not np.any(expected > middle)
    if not beyond or prior.has_score:
        return beyond
    densities = np.asarray(jax.vmap(prior.log_density)(jnp.append(expected, middle)))
    return bool(densities[-1] < densities[:-1].min())


def _as_wide_words(prior: str, rows: Sequence[tuple[str, float]]) -> str:
    """Text of a note on parameters whose posteriors are nearly as wide as their common prior; `rows` have names and widths in percent."""
    names, ratios = zip(*rows, strict=True)
    if len(rows) == 1:
        return (
            f"the data hardly determine {names[0]}: its posterior is {ratios[0]:.0f} % as wide as its prior ({prior})"
        )
    return (
        f"the data hardly determine {listed(names)}: their posteriors are {min(ratios):.0f} to {max(ratios):.0f} % as wide as their prior "
        f"({prior})"
    )


def _spread(prior: AbstractPrior, x: np.ndarray) -> float:
    """Distance between the quartiles, of the logarithm for a log-normal prior."""
    if isinstance(prior, LogNormal):
        x = np.log(np.maximum(prior.side * (x - float(prior.edge)), 1e-300))
    return float(np.subtract(*np.quantile(x, [0.75, 0.25])))


def drift_notes(setup: Prepared, draws: Float[np.ndarray, "chains draws d"], longest: int) -> list[Note]:
    """A note if slow noise is correlated over a large fraction of the record: the data drift or creep, and the model does not."""
    middle = dict(zip(setup.names, np.median(draws.reshape(-1, draws.shape[-1]), axis=0), strict=True))
    time = middle.get("noise_time", 0.0)
    if time <= _SLOW * longest or middle["noise_slow"] <= middle.get("noise_white", 0.0):
        return []
    missing, remedy = "drift or creep", "add creep (+log-creep), or remove the drift"
    if setup.problem.model.creeps:
        missing, remedy = "drift", "remove it"
    text = (
        f"the slow noise is correlated over {time:.0f} of {longest} samples and larger than the white noise: this is {missing} that the "
        f"model does not include. The bias of the parameters exceeds their intervals; {remedy}"
    )
    return [warn(Code.INCOMPLETE, text)]


def _agreement_notes(result: FitResult, setup: Prepared, draws: Float[np.ndarray, "chains draws d"]) -> list[Note]:
    """A note where the draws are wider or narrower than the standard errors of the fit."""
    wide = draws.reshape(-1, draws.shape[-1]).std(axis=0)
    errors = {name: float(sd) for name, sd in zip(setup.names, wide, strict=True) if np.isfinite(sd)}
    if result.noise.refines and result.noise.name == setup.noise:
        reason = "the posterior includes the priors and the uncertainty of the noise, and need not be symmetric"
    elif result.noise.name == "iid":
        reason = f"the fit assumes independent residuals, the posterior noise {setup.noise}"
    else:
        reason = (
            f"the posterior weights the samples by its noise model, least squares weights them equally; a fit with noise={setup.noise!r} "
            "has the estimate of the posterior"
        )
    return differences(result.parameters, errors, "the posterior", reason)


def notes_of_fit(result: FitResult) -> list[Note]:
    """A note if the fit is not usable, and the notes of its model on coarse steps, which make the posterior rough."""
    advice = [note for note in result.notes if note.code is Code.MODEL_ADVICE]
    if result.usable:
        return advice
    text = f"the fit behind these draws is not usable ({result.status}): {result.advice}"
    return [Note(Code.FIT_STATUS, text, Severity.ERROR), *advice]


def _claim(folder: Path, setup: Prepared, result: FitResult, chosen: AbstractSampler, seed: int) -> Path:
    """The folder of a run; a run for more draws is the same run."""
    described = {
        "data": [record.digest() for record in result.data],
        "model": [to_json(model) for model in result.models],
        "free": list(setup.names),
        "noise": setup.noise,
        "priors": {name: prior.exact() for name, prior in setup.priors.items()},
        "dependence": None if setup.dependence is None else np.asarray(setup.dependence.excess).tolist(),
        "sampler": chosen.name,
        "seed": seed,
        "settings": {k: v for k, v in dataclasses.asdict(chosen).items() if k != "draws"},
    }
    return claim(folder, "run.json", described)
