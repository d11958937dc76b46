"""Calibration with the priors that `hf.sample` uses by default: parameters from these, a record, a fit, draws, and the rank of the truth.

These priors span factors of 20 either way, so that many records determine little. Posteriors whose chains have not converged are
counted and left out: whether they have is a property of the data, so that the other ranks stay uniform where all is right.
"""

from __future__ import annotations

import json
from pathlib import Path

import jax
import numpy as np
from common import Results, table
from pairs import pairs

import hystfit as hf
from hystfit.errors import DataError
from hystfit.inference.noise import White
from hystfit.inference.priors import AbstractPrior, default_priors
from hystfit.inference.problem import Problem
from hystfit.outcome import Status
from hystfit.params.space import ParameterSpace
from hystfit.uncertainty.calibration import RANKS, Calibration

REPLICATES = 200
FALSE_ALARM = 0.05


def priors_of(record: hf.Record) -> dict[str, AbstractPrior]:
    """Default priors of Bouc-Wen and of independent noise for the scales of a record."""
    problem = Problem(hf.BoucWen(scheme="exact"), [record])
    return default_priors(problem.space) | default_priors(ParameterSpace.of(White(), scales=problem.scales))


def replicate(record: hf.Record, priors: dict[str, AbstractPrior], seed: int) -> dict[str, object]:
    """Ranks of the truth among draws of one replicate, the sampler of the draws, and whether the chains converged."""
    keys = jax.random.split(jax.random.key(seed), len(priors))
    truth = {name: float(prior.sample(key)) for (name, prior), key in zip(priors.items(), keys, strict=True)}
    rng = np.random.default_rng(seed)
    model = hf.BoucWen(**{name: truth[name] for name in ("c", "mu", "tau", "rho")}, scheme="exact")
    clean = np.asarray(hf.simulate(model, record.u)[0]) + truth["offset"]
    data = hf.Record(u=record.u, y=clean + truth["noise_white"] * rng.normal(size=clean.size))
    fit = hf.fit(hf.BoucWen(scheme="exact"), data, noise="iid")
    try:
        made = hf.sample(fit, noise="iid", priors=priors, seed=seed)
    except DataError:  # the fit is no place to start from
        return {"converged": False, "sampler": ""}
    flat = made.draws.reshape(-1, len(made.names))
    kept = flat[np.linspace(0, len(flat) - 1, RANKS).astype(int)]
    true = np.array([truth[name] for name in made.names])
    errors = (flat.mean(axis=0) - true) / flat.std(axis=0)
    return {"names": made.names, "ranks": np.sum(kept < true, axis=0).tolist(), "errors": errors.tolist(),
            "converged": made.status is not Status.NOT_CONVERGED, "sampler": made.sampler}  # fmt: skip


def run(results: Results, folder: Path) -> str:
    """A row on the default sampler; every replicate is kept in the folder."""
    record = next(pair.record for pair in pairs() if pair.name == "Bouc-Wen")
    priors, file = priors_of(record), folder / "default-priors.jsonl"
    done = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []
    with file.open("a", encoding="utf-8") as handle:
        for seed in range(len(done), REPLICATES):
            done.append(replicate(record, priors, seed))
            handle.write(json.dumps(done[-1]) + "\n")
            handle.flush()
    good = [row for row in done if row["converged"]]
    ranks, errors = (np.array([row[key] for row in good]) for key in ("ranks", "errors"))
    made = Calibration(tuple(good[0]["names"]), ranks, RANKS, errors, (), "default", "iid", "iid", "bouc-wen")
    p, covered, share = made.p_values(), made.coverage(), len(good) / len(done)
    by_nuts = sum(row["sampler"] == "nuts" for row in done)
    results.add("SBC, default priors: smallest p over its limit", float(p.min()) * p.size / FALSE_ALARM)
    results.add("SBC, default priors: share of chains that converged", share)
    worst = f"{p.min():.2g} ({made.names[int(np.argmin(p))]})"
    head = ["replicates", "drawn by NUTS", "converged", "smallest p", "95 % covered, mean", "least"]
    return table(head, [[len(done), by_nuts, share, worst, covered.mean(), covered.min()]])
