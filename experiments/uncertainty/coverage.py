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
from hystfit.uncertainty.block_covariance import covariance

FITS = ("iid", "default", "ar1", "ou", "discrepancy")
OTHERS = ("sandwich", "bootstrap", "profile", "UKF covariance")
BLOCKS = ("sandwich", "bootstrap")
POSTERIORS = {"AR(1) + white": 100, "repeating + white": 25}  # replicates of the default sampler
SHORT = SAMPLES // 2  # samples of the records that are sampled
REPLICATES, RIGHT, SOME, FEW = 100, 60, 25, 15
# Estimates and standard errors of the four parameters, whether 95 % intervals cover, whether notes warned of recurring model error
# ("warned") or of anything that makes errors unreliable ("alarm").
Row = dict[str, Any]
ALARMS = (Code.REPEATING_RESIDUALS, Code.NOT_DETERMINED, Code.AT_BOUND)


def _row(value: np.ndarray, sd: np.ndarray, inside: np.ndarray | None = None, **warnings: bool) -> Row:
    if inside is None:
        inside = np.abs(value - VALUES) < norm.ppf(0.975) * sd
    row = {"value": value.tolist(), "sd": sd.tolist(), "inside": inside.astype(int).tolist()}
    return row | {name: int(on) for name, on in warnings.items()}


def _numbers(result: hf.FitResult) -> tuple[np.ndarray, np.ndarray]:
    value = np.array([result[name].value for name in NAMES])
    errors = [result[name].stderr for name in NAMES]
    return value, np.array([np.nan if e is None else e for e in errors])


def by_fit(result: hf.FitResult) -> Row:
    """Errors of `fit`, and whether notes warn."""
    alarm = any(has(result.notes, code) for code in ALARMS)
    return _row(*_numbers(result), warned=has(result.notes, Code.REPEATING_RESIDUALS), alarm=alarm)


@functools.lru_cache(maxsize=1)
def plain(kind: str, seed: int, samples: int = SAMPLES) -> hf.FitResult:
    """The default fit, shared by several methods."""
    return hf.fit(TRUTH, record(kind, seed, samples), start="model", starts=1)


def by_covariance(result: hf.FitResult, kind: str) -> Row:
    """Errors of least squares by the sandwich or the block bootstrap, with blocks of one cycle."""
    found = covariance(result, kind, block=SAMPLES // CYCLES)
    at = [found.names.index(name) for name in NAMES]
    value = _numbers(result)[0]
    return _row(value, found.stderr[at], np.abs(value - VALUES) < found.half_width[at])


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


def by_sampler(result: hf.FitResult) -> Row:
    """Central intervals of a posterior; the noise model is the one that `sample` chooses."""
    made = hf.sample(result, seed=0, chains=2, draws=400)
    draws = np.stack([made[name].ravel() for name in NAMES])
    low, high = np.quantile(draws, [0.025, 0.975], axis=1)
    inside = (low < VALUES) & (VALUES < high)
    return _row(draws.mean(axis=1), draws.std(axis=1), inside)


def row_of(kind: str, method: str, seed: int) -> Row:
    """One replicate."""
    if method == "default":
        return by_fit(plain(kind, seed))
    if method in FITS:
        return by_fit(hf.fit(TRUTH, record(kind, seed), start="model", starts=1, noise=method))
    if method == "posterior":
        return by_sampler(plain(kind, seed, SHORT))
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
        warned: fraction of replicates with a warning of recurring error.
        none: fraction of parameters without an error bar.
        unseen: fraction of parameters with an error bar that does not hold the truth, in replicates without any warning.
    """

    covered: float
    least: float
    width: float
    warned: float
    none: float
    unseen: float


def summary(rows: Sequence[Row]) -> Summary:
    """Summary over replicates; a parameter without a finite error bar counts neither as covered nor as missed."""
    value, sd, inside = (np.array([row[k] for row in rows], float) for k in ("value", "sd", "inside"))
    known = np.isfinite(sd)
    covered = np.nanmean(np.where(known, inside, np.nan), axis=0)
    width = np.nanmedian(sd, axis=0) / np.std(value, axis=0)
    warned, alarm = (np.array([row.get(name, 0) for row in rows], bool) for name in ("warned", "alarm"))
    unseen = np.mean(known & (inside == 0) & ~alarm[:, None])
    numbers = (covered.mean(), covered.min(), width.mean(), warned.mean(), np.mean(~known), unseen)
    return Summary(*(float(v) for v in numbers))


def methods_of(kind: str, quick: bool) -> tuple[str, ...]:
    """Methods that are run on a kind of error."""
    if quick:
        return ("iid", "default", "ou", *(("discrepancy",) if "repeating" in kind else ()))
    if kind in ("white", "AR(1)", "AR(1) + white", "repeating + white"):
        return (*FITS, *OTHERS)
    return ("default", "ou", *(("discrepancy",) if "repeating" in kind else ()))


def replicates_of(kind: str, method: str, quick: bool) -> int:
    """Number of replicates: most for the default and the rules that share its fit, and for its likelihood where that is the true one."""
    if quick:
        return 12
    if method in ("default", *BLOCKS) or (method == "ou" and "repeating" not in kind and "strong" not in kind):
        return REPLICATES
    if method == "profile":
        return FEW
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
        default = found["default"]
        results.add(f"width over spread: {kind}, default", default.width)
        results.add(f"warned of repeating error: {kind}, default", default.warned)
        results.add(f"outside without a warning: {kind}, default", default.unseen)
        cell = lambda text, found=found: [text(found[m]) if m in found else None for m in head]
        cover.append([kind, *cell(lambda s: f"{100 * s.covered:.1f} ({100 * s.least:.0f})")])
        width.append([kind, *cell(lambda s: f"{s.width:.2f}")])
        none.append(
            [kind, *cell(lambda s: f"{100 * s.none:.0f}"), f"{100 * default.warned:.0f}", f"{100 * default.unseen:.1f}"]
        )
    tables = {"coverage": table(["error", *head], cover), "width": table(["error", *head], width)}
    more = ["default warned of repeating error", "default outside without a warning"]
    tables["none"] = table(["error", *head, *more], none)
    return tables


def posteriors(results: Results, file: Path) -> str:
    """Central intervals of posteriors on shorter records."""
    store, lines = Store(file), []
    for kind, replicates in POSTERIORS.items():
        found = summary([store.get(kind, "posterior", seed) for seed in range(replicates)])
        lines.append([kind, replicates, 100 * found.covered, 100 * found.least, found.width])
        results.add(f"coverage: {kind}, posterior", found.covered)
    return table(
        ["error", "records", "95 % covered, %", "least of four", "standard deviation / spread of the means"], lines
    )
