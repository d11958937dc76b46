"""Width and coverage of every kind of error bar that hystfit gives, on loops whose truth is known."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from common import Results, table
from noises import CYCLES, KINDS, NAMES, SAMPLES, TRUTH, VALUES, WHITE, record
from scipy.stats import norm

import hystfit as hf
from hystfit.identify import Ukf
from hystfit.uncertainty.covariances import covariance

FITS = ("iid", "default", "ar1", "ou", "discrepancy")
OTHERS = ("sandwich", "bootstrap", "profile", "UKF covariance")
SAMPLERS = ("nuts", "emcee")
SAMPLED = ("white", "AR(1)", "repeating + white")
REPLICATES, SAMPLED_REPLICATES = 100, 12
Row = dict[
    str, Any
]  # estimates and standard errors of the four parameters, whether 95 % intervals cover, whether it warned


def _row(value: np.ndarray, sd: np.ndarray, inside: np.ndarray | None = None, warned: bool = False) -> Row:
    if inside is None:
        inside = np.abs(value - VALUES) < norm.ppf(0.975) * sd
    return {"value": value.tolist(), "sd": sd.tolist(), "inside": inside.astype(int).tolist(), "warned": int(warned)}


def _numbers(result: hf.FitResult) -> tuple[np.ndarray, np.ndarray]:
    value = np.array([result[name].value for name in NAMES])
    errors = [result[name].stderr for name in NAMES]
    return value, np.array([np.nan if e is None else e for e in errors])


def by_fit(measured: hf.Record, noise: str) -> Row:
    """Errors of `fit`; it warns where its notes say that model error repeats."""
    given = {} if noise == "default" else {"noise": noise}
    result = hf.fit(TRUTH, measured, start="model", starts=1, **given)
    return _row(*_numbers(result), warned=any("repeats" in note for note in result.notes))


def by_covariance(measured: hf.Record, kind: str) -> Row:
    """Errors of least squares by the sandwich or the block bootstrap."""
    result = hf.fit(TRUTH, measured, start="model", starts=1)
    found = covariance(result, kind, block=SAMPLES // CYCLES)
    return _row(_numbers(result)[0], np.array([found.stderr[found.names.index(name)] for name in NAMES]))


def by_profile(measured: hf.Record) -> Row:
    """Limits of the default profile."""
    result = hf.fit(TRUTH, measured, start="model", starts=1)
    found = hf.profile(result, NAMES)
    lower = np.array([-np.inf if found[n].lower is None else found[n].lower for n in NAMES])
    upper = np.array([np.inf if found[n].upper is None else found[n].upper for n in NAMES])
    sd = (upper - lower) / (2 * norm.ppf(0.975))
    return _row(_numbers(result)[0], sd, (lower < VALUES) & (VALUES < upper))


def by_filter(measured: hf.Record) -> Row:
    """The belief of an unscented Kalman filter that starts near the truth and is told the sensor's noise."""
    ukf = Ukf.of(TRUTH, measured, start="model", prior=0.05, noise=WHITE)
    found = ukf.fit(measured)
    p = len(ukf.free)
    z = jnp.asarray(found.theta)[-p:]
    belief = np.sqrt(np.diag(np.asarray(ukf.covariance(found.state))))[-p:]
    at = [ukf.free.index(name) for name in NAMES]
    sd = np.asarray(ukf.coordinates.slope(z)) * belief
    return _row(np.asarray(ukf.coordinates.physical(z))[at], sd[at])


def by_sampler(measured: hf.Record, sampler: str) -> Row:
    """Central intervals of a posterior; the noise model is the one that `sample` chooses."""
    result = hf.fit(TRUTH, measured, start="model", starts=1)
    settings = {"chains": 2, "draws": 400, "warmup": 100} if sampler == "nuts" else {"walkers": 32, "draws": 600}
    made = hf.sample(result, sampler, seed=0, **settings)
    draws = np.stack([made[name].ravel() for name in NAMES])
    low, high = np.quantile(draws, [0.025, 0.975], axis=1)
    inside = (low < VALUES) & (VALUES < high)
    return _row(draws.mean(axis=1), draws.std(axis=1), inside, warned=made.noise == "discrepancy")


def row_of(kind: str, method: str, seed: int) -> Row:
    """One replicate."""
    measured = record(kind, seed)
    ways: dict[str, Callable[[], Row]] = dict.fromkeys(FITS, lambda: by_fit(measured, method))
    ways |= dict.fromkeys(("sandwich", "bootstrap"), lambda: by_covariance(measured, method))
    ways |= {"profile": lambda: by_profile(measured), "UKF covariance": lambda: by_filter(measured)}
    ways |= dict.fromkeys(SAMPLERS, lambda: by_sampler(measured, method))
    return ways[method]()


class Store:
    """Replicates as lines of a file, so that a run goes on where it was stopped."""

    def __init__(self, file: Path | None):
        self.file = file
        self.rows: dict[str, Row] = {}
        if file is not None and file.exists():
            lines = file.read_text(encoding="utf-8").splitlines()
            for line in lines:
                try:
                    entry = json.loads(line)
                except ValueError:
                    continue  # half a line, of a run that was killed
                self.rows[entry["key"]] = entry["row"]

    def get(self, kind: str, method: str, seed: int) -> Row:
        """A stored replicate, or a new one."""
        key = f"{kind}/{method}/{seed}"
        if key not in self.rows:
            self.rows[key] = row_of(kind, method, seed)
            if self.file is not None:
                with self.file.open("a", encoding="utf-8") as handle:
                    handle.write(json.dumps({"key": key, "row": self.rows[key]}) + "\n")
        return self.rows[key]


def summary(rows: Sequence[Row]) -> tuple[float, float, float, float]:
    """(mean coverage, least by parameter, median standard error over the estimates' own spread, part that warned)."""
    value, sd, inside = (np.array([row[k] for row in rows], float) for k in ("value", "sd", "inside"))
    inside = np.where(
        np.isfinite(sd), inside, np.nan
    )  # no finite error bar is no interval: it neither covers nor misses
    covered = np.nanmean(inside, axis=0)
    width = np.nanmedian(sd, axis=0) / np.std(value, axis=0)
    return (
        float(covered.mean()),
        float(covered.min()),
        float(np.mean(width)),
        float(np.mean([r["warned"] for r in rows])),
    )


def run(results: Results, file: Path | None) -> dict[str, str]:
    """The tables of coverage and of width."""
    store, quick = Store(file), results.quick
    kinds = ("AR(1) + white", "repeating + white") if quick else tuple(KINDS)
    methods = ("iid", "default", "ou") if quick else (*FITS, *OTHERS)
    cover: list[list[object]] = []
    width: list[list[object]] = []
    for kind in kinds:
        found = {}
        for method in (*methods, *(("discrepancy",) if quick and "repeating" in kind else ())):
            count = 12 if quick else REPLICATES
            found[method] = summary([store.get(kind, method, seed) for seed in range(count)])
            results.add(f"coverage: {kind}, {method}", found[method][0])
        results.add(f"warned of repeating error: {kind}, default", found["default"][3])
        cover.append([kind, *(f"{100 * found[m][0]:.0f} ({100 * found[m][1]:.0f})" for m in methods)])
        width.append([kind, *(round(found[m][2], 2) for m in methods)])
    tables = {"coverage": table(["error", *methods], cover), "width": table(["error", *methods], width)}
    if not quick:
        tables["samplers"] = samplers(results, store)
    return tables


def samplers(results: Results, store: Store) -> str:
    """NUTS and emcee beside least squares on the first replicates."""
    lines: list[list[object]] = []
    for kind in SAMPLED:
        for method in (*SAMPLERS, "ou", "discrepancy", "default"):
            covered, _, width, _ = summary([store.get(kind, method, seed) for seed in range(SAMPLED_REPLICATES)])
            lines.append([kind, method, 100 * covered, width])
            if method in SAMPLERS:
                results.add(f"coverage: {kind}, {method}", covered)
    return table(["error", "method", "95 % covered, %", "standard error / spread of the estimates"], lines)
