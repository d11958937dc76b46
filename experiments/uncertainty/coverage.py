"""Width and coverage of every kind of error bar of hystfit, on loops with known truth."""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from common import Results, table
from noises import CYCLES, KINDS, NAMES, SAMPLES, TRUTH, VALUES, WHITE, record
from scipy.stats import norm

import hystfit as hf
from hystfit.identify import Ukf
from hystfit.outcome import Code
from hystfit.outcome.note import has
from hystfit.uncertainty.robust_errors import covariance

FITS = ("iid", "default", "ar1", "ou", "discrepancy")
OTHERS = ("sandwich", "bootstrap", "profile", "UKF covariance")
SAMPLERS = ("nuts", "emcee")
SAMPLED = ("white", "AR(1)", "repeating + white")
REPLICATES, RIGHT, SOME = 100, 60, 25
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


def by_fit(result: hf.FitResult) -> Row:
    """Errors of `fit`, and whether a note warns of recurring model error."""
    return _row(*_numbers(result), warned=has(result.notes, Code.REPEATING_RESIDUALS))


@functools.lru_cache(maxsize=1)
def plain(kind: str, seed: int) -> hf.FitResult:
    """The default fit, shared by several methods."""
    return hf.fit(TRUTH, record(kind, seed), start="model", starts=1)


def by_covariance(result: hf.FitResult, kind: str) -> Row:
    """Errors of least squares by the sandwich or the block bootstrap."""
    found = covariance(result, kind, block=SAMPLES // CYCLES)
    return _row(_numbers(result)[0], np.array([found.stderr[found.names.index(name)] for name in NAMES]))


def by_profile(result: hf.FitResult) -> Row:
    """Limits of the default profile."""
    found = hf.profile(result, NAMES)
    lower = np.array([-np.inf if found[n].lower is None else found[n].lower for n in NAMES])
    upper = np.array([np.inf if found[n].upper is None else found[n].upper for n in NAMES])
    sd = (upper - lower) / (2 * norm.ppf(0.975))
    return _row(_numbers(result)[0], sd, (lower < VALUES) & (VALUES < upper))


def by_filter(measured: hf.Record) -> Row:
    """Covariance of an unscented Kalman filter with good starting values and the true sensor noise."""
    ukf = Ukf.of(TRUTH, measured, start="model", prior=0.05, noise=WHITE)
    found = ukf.fit(measured)
    p = len(ukf.free)
    z = jnp.asarray(found.theta)[-p:]
    spread = np.sqrt(np.diag(np.asarray(ukf.covariance(found.state))))[-p:]
    at = [ukf.free.index(name) for name in NAMES]
    sd = np.asarray(ukf.coordinates.slope(z)) * spread
    return _row(np.asarray(ukf.coordinates.physical(z))[at], sd[at])


def by_sampler(result: hf.FitResult, sampler: str) -> Row:
    """Central intervals of a posterior; the noise model is the one that `sample` chooses."""
    settings = {"chains": 2, "draws": 400, "warmup": 100} if sampler == "nuts" else {"walkers": 32, "draws": 600}
    made = hf.sample(result, sampler, seed=0, **settings)
    draws = np.stack([made[name].ravel() for name in NAMES])
    low, high = np.quantile(draws, [0.025, 0.975], axis=1)
    inside = (low < VALUES) & (VALUES < high)
    return _row(draws.mean(axis=1), draws.std(axis=1), inside, warned=made.noise == "discrepancy")


def row_of(kind: str, method: str, seed: int) -> Row:
    """One replicate."""
    if method == "default":
        return by_fit(plain(kind, seed))
    if method in FITS:
        return by_fit(hf.fit(TRUTH, record(kind, seed), start="model", starts=1, noise=method))
    if method in SAMPLERS:
        return by_sampler(plain(kind, seed), method)
    if method == "UKF covariance":
        return by_filter(record(kind, seed))
    return by_profile(plain(kind, seed)) if method == "profile" else by_covariance(plain(kind, seed), method)


class Store:
    """Replicates as lines of a file, from which an interrupted run resumes."""

    def __init__(self, file: Path | None):
        self.file = file
        self.rows: dict[str, Row] = {}
        if file is not None and file.exists():
            lines = file.read_text(encoding="utf-8").splitlines()
            for line in lines:
                try:
                    entry = json.loads(line)
                except ValueError:
                    continue  # incomplete line of an interrupted run
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


class Summary(NamedTuple):
    """Statistics over replicates of one method.

    Attributes:
        covered, least: mean and least coverage over the parameters.
        width: median standard error over the standard deviation of the estimates.
        warned, none: fraction of replicates with a warning, and of parameters without an error bar.
    """

    covered: float
    least: float
    width: float
    warned: float
    none: float


def summary(rows: Sequence[Row]) -> Summary:
    """Summary over replicates; a parameter without a finite error bar counts neither as covered nor as missed."""
    value, sd, inside = (np.array([row[k] for row in rows], float) for k in ("value", "sd", "inside"))
    covered = np.nanmean(np.where(np.isfinite(sd), inside, np.nan), axis=0)
    width = np.nanmedian(sd, axis=0) / np.std(value, axis=0)
    warned = float(np.mean([row["warned"] for row in rows]))
    numbers = (covered.mean(), covered.min(), width.mean(), warned, np.mean(~np.isfinite(sd)))
    return Summary(*(float(v) for v in numbers))


def methods_of(kind: str, quick: bool) -> tuple[str, ...]:
    """Methods that are run on a kind of error."""
    if quick:
        return ("iid", "default", "ou", *(("discrepancy",) if "repeating" in kind else ()))
    if kind in ("white", "AR(1)", "AR(1) + white", "repeating + white"):
        return (*FITS, *OTHERS)
    return ("default", "ou", *(("discrepancy",) if "repeating" in kind else ()))


def replicates_of(kind: str, method: str, quick: bool) -> int:
    """Number of replicates: most for the default, and for its likelihood where that is the true one."""
    if quick:
        return 12
    if method == "default" or (method == "ou" and "repeating" not in kind and "strong" not in kind):
        return REPLICATES
    return RIGHT if method == "discrepancy" and "repeating" in kind else SOME


def run(results: Results, file: Path | None) -> dict[str, str]:
    """The tables of coverage and of width."""
    store, quick = Store(file), results.quick
    kinds = ("AR(1) + white", "repeating + white") if quick else tuple(KINDS)
    every = methods_of(kinds[0], False)
    head = [m for m in every if any(m in methods_of(kind, quick) for kind in kinds)]
    cover: list[list[object]] = []
    width: list[list[object]] = []
    none: list[list[object]] = []
    for kind in kinds:
        found: dict[str, Summary] = {}
        methods = methods_of(kind, quick)
        rows: dict[str, list[Row]] = {method: [] for method in methods}
        for seed in range(REPLICATES):  # seed by seed: several methods share a fit
            for method in methods:
                if seed < replicates_of(kind, method, quick):
                    rows[method].append(store.get(kind, method, seed))
        for method in methods:
            found[method] = summary(rows[method])
            results.add(f"coverage: {kind}, {method}", found[method].covered)
        results.add(f"width over spread: {kind}, default", found["default"].width)
        results.add(f"warned of repeating error: {kind}, default", found["default"].warned)
        cell = lambda text, found=found: [text(found[m]) if m in found else None for m in head]
        cover.append([kind, *cell(lambda s: f"{100 * s.covered:.1f} ({100 * s.least:.0f})")])
        width.append([kind, *cell(lambda s: f"{s.width:.2f}")])
        none.append([kind, *cell(lambda s: f"{100 * s.none:.0f}"), f"{100 * found['default'].warned:.0f}"])
    tables = {"coverage": table(["error", *head], cover), "width": table(["error", *head], width)}
    tables["none"] = table(["error", *head, "default warned of repeating error"], none)
    if not quick:
        tables["samplers"] = samplers(results, store)
    return tables


def samplers(results: Results, store: Store) -> str:
    """NUTS and emcee beside least squares on the same replicates."""
    lines: list[list[object]] = []
    for kind in SAMPLED:
        for method in (*SAMPLERS, "ou", "discrepancy", "default"):
            found = summary([store.get(kind, method, seed) for seed in range(SOME)])
            lines.append([kind, method, 100 * found.covered, found.width])
            if method in SAMPLERS:
                results.add(f"coverage: {kind}, {method}", found.covered)
    return table(["error", "method", "95 % covered, %", "standard error / spread of the estimates"], lines)
