"""Simulation-based calibration (Talts et al. 2018): whether the error bars of a setup have the coverage that they claim.

Parameters are drawn from the prior, data are simulated with a noise model, the posterior is computed, and the rank of the true value
among its draws is recorded. If the setup is calibrated, the ranks are uniform. With an assumed noise model other than the true one,
the same study measures misspecification.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from scipy.stats import binom

from hystfit.config import require_seed, verb
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import ParameterError
from hystfit.inference.fittable import check_smooth
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.priors import AbstractPrior, choose_priors
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import make_model, model_name
from hystfit.outcome import Column, Status, Table, WithStatus
from hystfit.results.saving.folders import alone
from hystfit.sampling.ensemble import MOST
from hystfit.uncertainty.replicates import CHUNK, RANKS, REASONS, Spaces, Study, collect, typical_noise

_FEWEST = 20  # replicates below which no conclusion is possible
_IDEAL = 40_000  # simulated sets of uniform ranks, with which those of a study are compared


@dataclasses.dataclass(frozen=True)
class Calibration(WithStatus):
    """Ranks of the truth among posterior draws.

    Attributes:
        names: of the parameters ranked.
        ranks: shape (replicates, parameters), 0 to `of`; failed replicates left out.
        of: number of posterior draws.
        errors: posterior mean minus truth, in posterior standard deviations, same shape.
        failures: (replicate, reason) of failed replicates.
        method, truth, assumed: see `Study`.
        model: name.
        broken: the error of each chunk that ended with one.
    """

    names: tuple[str, ...]
    ranks: np.ndarray
    of: int
    errors: np.ndarray
    failures: tuple[tuple[int, str], ...]
    method: str
    truth: str
    assumed: str
    model: str
    broken: tuple[str, ...] = ()
    verb: ClassVar[str] = "calibrate"

    def p_values(self) -> np.ndarray:
        """Uniformity of the ranks by the largest distance of their ECDF from the straight line; small means miscalibrated."""
        ideal = _ideal_distances(len(self.ranks), self.of)
        distances = _distance(self.ranks.T, self.of)
        return (1 + np.sum(ideal >= distances[:, None] - 1e-12, axis=1)) / (ideal.size + 1)

    def coverage(self, level: float = 0.95) -> np.ndarray:
        """Part of the replicates whose central interval of this level contains the true value, by parameter."""
        place = (self.ranks + 0.5) / (self.of + 1)
        return np.mean(np.abs(place - 0.5) < 0.5 * level, axis=0)

    def coverage_band(self, level: float = 0.95, confidence: float = 0.99) -> tuple[float, float]:
        """Limits within which the coverage of correct error bars lies with probability `confidence`."""
        n = len(self.ranks)
        exact = np.sum(np.abs((np.arange(self.of + 1) + 0.5) / (self.of + 1) - 0.5) < 0.5 * level) / (self.of + 1)
        low, high = binom.ppf([0.5 - confidence / 2, 0.5 + confidence / 2], n, exact) / n
        return float(low), float(high)

    def passes(self, false_alarm: float = 0.01) -> bool:
        """Whether the ranks are uniform at this false-alarm rate for the whole study, with at most 5 % failed replicates."""
        enough = len(self.failures) <= 0.05 * (len(self.ranks) + len(self.failures))
        return bool(enough and len(self.ranks) > 0 and self.p_values().min() * len(self.names) > false_alarm)

    @property
    def status(self) -> Status:
        """`Status.OK`, MISCALIBRATED, TOO_FEW (replicates for a conclusion) or FAILED (all of them)."""
        if not len(self.ranks):
            return Status.FAILED
        if not self.passes():
            return Status.MISCALIBRATED
        return Status.OK if len(self.ranks) >= _FEWEST else Status.TOO_FEW

    def table(self) -> Table:
        """p-value and coverage of the 95 % intervals of each parameter."""
        known = len(self.ranks) > 0
        p = self.p_values().tolist() if known else [None] * len(self.names)
        covered = self.coverage().tolist() if known else [None] * len(self.names)
        columns = [
            Column("parameter", key="name"),
            Column("p", form=".4f"),
            Column("coverage", key="coverage95", form=".1%"),
        ]
        return Table(columns, list(zip(self.names, p, covered, strict=True)))

    def explanations(self) -> list[str]:
        """What the columns of the table mean."""
        low, high = self.coverage_band()
        return [
            f"coverage: share of the 95 % intervals that contain the true value; with {len(self.ranks)} replicates, "
            f"{100 * low:.1f} % to {100 * high:.1f} % is consistent with 95 %",
            "p: probability of ranks of the true values at least as uneven as these if the errors are calibrated",
        ]

    def __str__(self) -> str:
        lines = [
            f"{self.model}, data simulated with noise {self.truth}, inference by {self.method} with noise {self.assumed}: "
            f"{len(self.ranks)} replicates, {len(self.failures)} failed: {self.status}"
        ]
        if len(self.ranks):
            lines += [*self.explanations(), *self.table().lines()]
        lines += [f"replicate {k} failed: {why}" for k, why in self.failures[:10]]
        if not self.usable:
            lines.append(self.advice)
        return "\n".join(lines + list(self.broken))

    __repr__ = __str__

    def to_dict(self) -> dict[str, Any]:
        rows = {row.pop("name"): row for row in self.table().to_list()}
        fields = {k: getattr(self, k) for k in ("model", "truth", "assumed", "method", "of")}
        return {
            "schema": "hystfit.calibrate/1",
            **fields,
            "status": str(self.status),
            "advice": self.advice,
            "replicates": len(self.ranks),
            "failures": [list(f) for f in self.failures],
            "broken": list(self.broken),
            "parameters": rows,
        }

    def plot(self) -> Any:
        """Rank histograms above, coverage curves with their band below; returns the matplotlib figure."""
        import matplotlib.pyplot as plt

        count = len(self.names)
        figure, axes = plt.subplots(2, count, figsize=(2.2 * count, 4.2), layout="constrained", squeeze=False)
        levels = np.linspace(0.05, 0.98, 40)
        bands = np.array([self.coverage_band(level) for level in levels])
        for k, name in enumerate(self.names):
            axes[0, k].hist(self.ranks[:, k], bins=16, range=(0, self.of + 1), color="#0072b2")
            axes[0, k].axhline(len(self.ranks) / 16, color="#a6a6a6", lw=0.8)
            axes[0, k].set_title(name, fontsize=9)
            axes[0, k].set_xlabel("rank of the truth")
            axes[1, k].fill_between(levels, *bands.T, color="#bbbbbb", lw=0)
            axes[1, k].plot(levels, [self.coverage(level)[k] for level in levels], color="#d55e00")
            axes[1, k].set_xlabel("level of the interval")
        axes[0, 0].set_ylabel("replicates\n(line: expected)", fontsize=8)
        axes[1, 0].set_ylabel("coverage\n(gray: 99 % range of calibrated intervals)", fontsize=8)
        return figure


def _distance(ranks: np.ndarray, of: int) -> np.ndarray:
    """Largest distance of the ECDF of each row of ranks (m, n) from that of uniform ones, shape (m,)."""
    m, n = ranks.shape
    counts = np.bincount((ranks + (of + 1) * np.arange(m)[:, None]).ravel(), minlength=m * (of + 1)).reshape(m, of + 1)
    below = np.cumsum(counts, axis=1)[:, :-1] / n
    return np.abs(below - np.arange(1, of + 1) / (of + 1)).max(axis=1)


@functools.lru_cache(maxsize=16)
def _ideal_distances(n: int, of: int) -> np.ndarray:
    """The same of sets of n uniform ranks, by simulation."""
    rng = np.random.default_rng(0)
    parts = [_distance(rng.integers(0, of + 1, (_IDEAL // 10, n)), of) for _ in range(10)]
    return np.concatenate(parts)


@verb
def calibrate(
    model: AbstractHysteresis | str,
    data: Record | Dataset | Sequence[Record],
    *,
    noise: AbstractNoise | str = "ou",
    assumed: str | None = None,
    method: Literal["laplace", "nuts", "emcee"] = "laplace",
    replicates: int = 200,
    spread: float = 0.2,
    priors: Mapping[str, AbstractPrior] | None = None,
    fix: Sequence[str] | Mapping[str, float] = (),
    free: Sequence[str] = (),
    tie: Mapping[str, str] | None = None,
    seed: int = 0,
    folder: str | Path | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> Calibration:
    """Calibrate a setup by simulation.

    Args:
        model: its present values center the priors; a name starts from the data.
        data: provide inputs and times; their outputs only scale the noise and start a model given by name.
        noise: the true noise, a model with values or a name (then of 1 % of the output's range).
        assumed: noise model of the inference; the true one by default.
        method: "laplace" (least squares), "nuts", or "emcee" (up to ten parameters).
        replicates: how many; at least 200 for a conclusion.
        spread: relative width of the priors about the model's values.
        priors: the user's own, by name.
        fix: parameters that are not fitted.
        tie: parameters that follow from others, as in `hystfit.fit`.
        free: parameters to fit that the model fixes by default.
        seed: of everything.
        folder: keeps finished chunks; the same call resumes from them.
        workers: processes on this machine.
        scheduler: address of a Dask scheduler to use instead.
        progress: called with a line after each chunk.

    Raises:
        ParameterError: settings that cannot be used.
        MissingExtraError: dask.distributed is not installed.
        DataError: the folder holds another study.
    """
    require_seed(seed)
    if method not in ("laplace", "nuts", "emcee"):
        raise ParameterError(f"method must be laplace, nuts or emcee, got {method!r}")
    if replicates < 1 or workers < 1 or not spread > 0:
        raise ParameterError("replicates and workers must be at least 1 and spread positive")
    records = Dataset.of(data)
    if isinstance(model, str):
        model = make_model(model).start(list(records))
    problem = Problem(model, records, fix=fix, free=free, tie=tie)
    check_smooth(problem.space, "a calibration")
    fixed_model, held = problem.space.template, tuple(name for name, _, _ in problem.space.fixed())
    truth = typical_noise(noise, problem) if isinstance(noise, str) else noise
    assumed = assumed or NOISES.label(truth)
    NOISES.find(assumed)
    choose_priors(problem.space, priors, problem.space.vector(fixed_model))  # refuses unusable priors before any work
    study = Study(
        fixed_model,
        records,
        truth,
        assumed,
        method,
        spread,
        dict(priors or {}),
        held,
        tuple(free),
        dict(tie or {}),
        seed,
    )
    if method == "emcee" and len(problem.space) > MOST:
        raise ParameterError(
            f"emcee is for up to {MOST} parameters, the model has {len(problem.space)}: use nuts or laplace"
        )
    with contextlib.nullcontext() if folder is None else alone(folder):
        chunks, broken = collect(study, -(-replicates // CHUNK), folder, workers, scheduler, progress)
    joined = {k: np.concatenate([chunk[k] for chunk in chunks])[:replicates] for k in ("ranks", "errors", "reason")}
    good = joined["reason"] == 0
    failures = tuple((int(k), REASONS[int(joined["reason"][k])]) for k in np.flatnonzero(~good))
    spaces = Spaces(study)
    names = tuple(spaces.names[k] for k in spaces.shared)
    ranks, errors = (joined[k][good][:, spaces.shared] for k in ("ranks", "errors"))
    return Calibration(
        names, ranks, RANKS, errors, failures, method, truth.name, study.assumed, model_name(fixed_model), tuple(broken)
    )
