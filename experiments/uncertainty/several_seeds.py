"""The default sampler from several seeds on seven records: four measured, a bundled one, and two whose posteriors are hard.

Thin: so little saturation that data determine c (1 - mu) and mu c tau, and their parts only through the priors. Small: one small amplitude
under slow and white noise, which does not determine tau and rho. The measured ones are a steel coupon and the sets of `bands`. Of these
the piezo stack's 14 parameters lie on a narrow curved ridge, which linear parameters given the others straighten.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from bands import CASES, chains_of
from common import Results, table

import hystfit as hf
from hystfit.outcome import Status
from hystfit.sampling.diagnostics import GOOD_ESS, GOOD_RHAT

SEEDS = 10  # one takes a second on the records of `short` and 40 to 110 s of processor time on those of `long`
UNUSABLE = (Status.NOT_CONVERGED, Status.DIVERGING)
Fit = Callable[[], hf.FitResult]


def bundled() -> hf.FitResult:
    """Two seconds of the simulated stage."""
    return hf.fit("bouc-wen", hf.datasets.load("stage-sine").window(0.0, 2.0))


def coupon(record: hf.Record) -> hf.FitResult:
    """A steel coupon under cyclic strain, with the model of its kind."""
    return hf.fit("steel-02", record)


def thin() -> hf.FitResult:
    """A loop with little saturation."""
    u = np.linspace(0.3, 1, 400) * np.sin(np.linspace(0, 8 * np.pi, 400))
    return _simulated(hf.BoucWen(c=50.0, mu=0.3, tau=0.01, rho=0.2), u, white=0.01, slow=0.0)


def small() -> hf.FitResult:
    """A loop of one amplitude, a tenth of that which would determine all parameters."""
    return _simulated(
        hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5), 0.1 * np.sin(np.linspace(0, 16 * np.pi, 800)), 5e-4, 5e-4
    )


def _simulated(model: hf.BoucWen, u: np.ndarray, white: float, slow: float) -> hf.FitResult:
    rng, drift = np.random.default_rng(0), np.zeros(u.size)
    for k in range(1, u.size):  # correlated over 20 samples
        drift[k] = 0.95 * drift[k - 1] + np.sqrt(1 - 0.95**2) * rng.normal()
    y = np.asarray(hf.simulate(model, u)[0]) + slow * drift + white * rng.normal(size=u.size)
    return hf.fit("bouc-wen", hf.Record(t=0.01 * np.arange(u.size), u=u, y=y))


def short(results: Results) -> dict[str, str]:
    """A table of the records that take seconds."""
    fits: dict[str, Fit] = {"bundled": bundled, "thin": thin, "small": small}
    loaded = results.load("coupon:", "steel_resspylab/example_1")
    if loaded is not None:
        fits["coupon"] = lambda: coupon(next(iter(hf.Dataset.of(loaded[0]))))
    return {
        f"Short records: the default sampler from {SEEDS} seeds, least and largest values over them": _table(
            results, fits
        )
    }


def long(results: Results) -> dict[str, str]:
    """A table of the sets of `bands` whose data are found."""
    fits: dict[str, Fit] = {}
    for case in CASES:
        loaded = results.load(f"{case.name}:", case.source)
        if loaded is not None:
            fitted = case.split(loaded[0])[0]
            fits[case.name] = lambda case=case, fitted=fitted: hf.fit(case.model, fitted, fix=case.fix, free=case.free)
    return {
        f"Measured sets: the default sampler from {SEEDS} seeds, least and largest values over them": _table(
            results, fits
        )
    }


def _table(results: Results, fits: dict[str, Fit]) -> str:
    """A row for each record; every run is kept, and a later one goes on after it."""
    rows = []
    for name, fit in fits.items():
        file, made = results.out / f"seeds-{name}.jsonl", None
        done = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []
        for seed in range(len(done), SEEDS):
            made = fit() if made is None else made
            done.append(_one(made, seed, chains_of(results, name, "auto") if seed == 0 else None))
            with file.open("a", encoding="utf-8") as handle:
                handle.write(json.dumps(done[-1]) + "\n")
        results.add(f"{name}: seeds of {SEEDS} with usable chains", sum(row["usable"] for row in done))
        column = lambda key, done=done: [row[key] for row in done]
        statuses = ", ".join(f"{column('status').count(status)} {status}" for status in sorted(set(column("status"))))
        drawn = ", ".join(sorted(set(column("sampler"))))
        worst = [min(column("ess")), max(column("rhat")), sum(column("divergent")), max(column("draws"))]
        rows.append([name, done[0]["noise"], drawn, statuses, *worst, np.median(column("seconds"))])
    head = ["record", "noise model", "sampler", "status", "least ESS", "largest R-hat", "divergent", "most draws",
            "median processor time, s"]  # fmt: skip
    return table(head, rows)


def _one(fit: hf.FitResult, seed: int, folder: Path | None) -> dict[str, object]:
    """One run, whose chains are stored in a folder; processor time includes compilation."""
    begin = time.process_time()
    made = hf.sample(fit, seed=seed, folder=folder)
    ess, rhat = float(np.min([made.convergence.bulk, made.convergence.tail])), float(np.max(made.convergence.rhat))
    divergent = int(made.stats["diverging"].sum())
    usable = made.status not in UNUSABLE and ess >= GOOD_ESS and rhat <= GOOD_RHAT and divergent == 0
    return {"status": str(made.status), "ess": ess, "rhat": rhat, "divergent": divergent, "usable": usable, "noise": made.noise,
            "sampler": made.sampler, "draws": made.draws.shape[0] * made.draws.shape[1],
            "seconds": time.process_time() - begin}  # fmt: skip
