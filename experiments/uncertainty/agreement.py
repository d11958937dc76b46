"""Least squares and the samplers on a well-determined problem; the samplers on curved posteriors, compared with a grid and a long run."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from common import Results, table
from noises import NAMES, TRUTH, excitation

import hystfit as hf
from hystfit import priors
from hystfit.sampling.setup import prepare


def _measured(amplitude: float, sigma: float, samples: int, seed: int) -> hf.Record:
    u = amplitude * (excitation(samples) if amplitude == 1 else np.sin(2 * np.pi * 8 * np.arange(samples) / samples))
    y = np.asarray(hf.simulate(TRUTH, u)[0])
    return hf.Record(u=u, y=y + sigma * np.random.default_rng(seed).normal(size=samples))


def _settings(results: Results, long: int) -> dict[str, dict[str, int]]:
    if results.quick:
        return {"independence": {"chains": 4, "draws": 500}, "emcee": {"walkers": 64, "draws": 600}}
    chains = {"chains": 4, "draws": long}
    return {"independence": chains, "nuts": chains | {"warmup": 200}, "emcee": {"walkers": 64, "draws": 4 * long}}


def well_determined(results: Results) -> str:
    """Standard deviations of the posterior over the standard errors of least squares."""
    fit = hf.fit(TRUTH, _measured(1.0, 0.003, 1600, 1), start="model", starts=1, noise="iid")
    rows, largest = [], 0.0
    for sampler, settings in _settings(results, 1500).items():
        made = hf.sample(fit, sampler, noise="iid", seed=2, **settings)
        ratios = [made[name].std() / (fit[name].stderr or np.nan) for name in NAMES]
        away = [abs(made[name].mean() - fit[name].value) / (fit[name].stderr or np.nan) for name in NAMES]
        rows.append([sampler, *ratios, max(away), float(np.min(made.convergence.bulk)), made.status])
        largest = max(largest, float(np.max(np.abs(np.array(ratios) - 1))))
    results.add(f"well determined: widths apart by{', quick' if results.quick else ''}", largest)
    head = [
        "sampler",
        *(f"sd of {n} / standard error" for n in NAMES),
        "largest shift of a mean, sd",
        "least ESS",
        "status",
    ]
    return table(head, rows)


def _grid(target: object, at: list[int], axes: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Means and standard deviations of two coordinates z from a grid over them, the others at the center."""
    mesh = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    full = np.tile(np.asarray(target.center), (len(mesh), 1))  # type: ignore[attr-defined]
    full[:, at] = mesh
    density = eqx.filter_jit(lambda t, rows: jax.lax.map(t.density.log_density, rows, batch_size=128))
    logs = np.asarray(density(target, jnp.asarray(full)))
    weight = np.exp(logs - logs.max())
    mean = weight @ mesh / weight.sum()
    return mean, np.sqrt(weight @ (mesh - mean) ** 2 / weight.sum())


def _bent(fix: dict[str, float], seed: int) -> hf.FitResult:
    """One small amplitude with large noise: tau and mu compensate for each other."""
    return hf.fit(TRUTH, _measured(0.15, 0.02, 400, seed), start="model", starts=1, noise="iid", fix=fix)


def _in_z(draws: hf.Posterior, names: tuple[str, ...]) -> np.ndarray:
    """logit of mu and log of the others."""
    maps = {"mu": lambda x: np.log(x / (1 - x)), "rho": lambda x: np.log((1 + x) / (1 - x))}
    return np.stack([maps.get(name, np.log)(draws[name].ravel()) for name in names], -1)


def banana_on_a_grid(results: Results) -> str:
    """Only mu and tau free: samplers compared with the grid, in standard deviations of the grid."""
    fit = _bent({"c": 1.0, "rho": 0.5, "offset": 0.0}, 3)
    own = {"tau": priors.LogNormal(2.0, 1.0), "noise_white": priors.LogNormal(0.02, 1e-4)}
    setup = prepare(fit, noise="iid", priors=own)
    scale = float(np.asarray(setup.problem.space.coordinates.scale)[setup.names.index("tau")])
    at = [setup.names.index(name) for name in ("mu", "tau")]
    count = 81 if results.quick else 201
    axes = [np.linspace(-5, 5, count), np.log(np.geomspace(0.01, 100.0, count) / scale)]
    mean, sd = _grid(setup.target, at, axes)
    mean[1] += np.log(scale)
    rows, worst = [["grid", *mean, *sd, None, ""]], 0.0
    for sampler, settings in _settings(results, 2000).items():
        made = hf.sample(fit, sampler, noise="iid", priors=own, seed=4, **settings)
        z = _in_z(made, ("mu", "tau"))
        found, spread = z.mean(axis=0), z.std(axis=0)
        worst = max(worst, float(np.max(np.abs(found - mean) / sd)), float(np.max(np.abs(spread / sd - 1))))
        rows.append([sampler, *found, *spread, float(np.min(made.convergence.bulk)), made.status])
    results.add(f"banana, grid: means and widths apart by, in sd{', quick' if results.quick else ''}", worst)
    head = ["", "mean logit mu", "mean log tau", "sd logit mu", "sd log tau", "least ESS", "status"]
    return table(head, rows)


def banana_in_full(results: Results) -> str:
    """All parameters free: short runs compared with 24 000 draws; small steps (target acceptance 0.9) follow the curvature."""
    fit = _bent({}, 5)
    names = ("c", "mu", "tau", "rho")
    own = {"c": priors.LogNormal(1.0, 0.3), "tau": priors.LogNormal(2.0, 1.0)}
    draw = lambda sampler, seed, **settings: hf.sample(fit, sampler, noise="iid", priors=own, seed=seed, **settings)
    long = draw("nuts", 9, chains=4, draws=6000, warmup=400, target_accept=0.9)
    reference = _in_z(long, names)
    mean, sd = reference.mean(axis=0), reference.std(axis=0)
    rows = [["reference", *mean, *sd, float(np.min(long.convergence.bulk)), long.status]]
    worst = 0.0
    short = {
        "independence": {"chains": 4, "draws": 2500},
        "nuts": {"chains": 4, "draws": 2500, "warmup": 400, "target_accept": 0.9},
        "emcee": {"walkers": 64, "draws": 8000},
    }
    for sampler, settings in short.items():
        made = draw(sampler, 10, **settings)
        z = _in_z(made, names)
        found, spread = z.mean(axis=0), z.std(axis=0)
        worst = max(worst, float(np.max(np.abs(found - mean) / sd)), float(np.max(np.abs(spread / sd - 1))))
        rows.append([sampler, *found, *spread, float(np.min(made.convergence.bulk)), made.status])
    results.add("banana, reference run: means and widths apart by, in sd", worst)
    head = ["", *(f"mean z of {n}" for n in names), *(f"sd of {n}" for n in names), "least ESS", "status"]
    return table(head, rows)
