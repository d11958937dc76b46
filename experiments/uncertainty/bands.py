"""Predictive bands of 90 % on samples that were not fitted, of three measured sets: a piezo stack, a damper and a magnetic material.

Beside the coverage stands a proper score, the continuous ranked probability score (CRPS: Gneiting and Raftery 2007), under the noise
model that `hf.sample` chooses and under independent noise.

A coverage counts only where the chains of the default sampler have converged.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
from common import Results, table

import hystfit as hf
from hystfit.data.dataset import Dataset
from hystfit.outcome import Code, Status
from hystfit.outcome.note import has
from hystfit.sampling.predictive import predictive_draws

COUNT = 4000  # predictive draws: from 400, coverages differ by half a percent between seeds
BAND = 0.9


@dataclasses.dataclass(frozen=True)
class Case:
    """A measured set.

    Attributes:
        name: as printed.
        source: of the data, by name.
        model: README.md says how it was chosen.
        fix: parameters held.
        free: initial states that the fit's verdict proposes to free.
        every: one sample in so many is used.
        train, held: windows in seconds; None where whole curves are held out.
        rest: input at which the device rested before the record; None where that is not known.
    """

    name: str
    source: str
    model: str
    fix: dict[str, float]
    free: tuple[str, ...] = ()
    every: int = 1
    train: tuple[float, float] | None = None
    held: tuple[float, float] | None = None
    rest: float | None = None

    def split(self, data: hf.Record | Dataset) -> tuple[list[hf.Record], hf.Record]:
        """(fitted, held out): by windows in time, or the loop of middle amplitude held out."""
        if self.train is None or self.held is None:
            loops = sorted(
                (self._thinned(record) for record in Dataset.of(data)), key=lambda record: float(np.ptp(record.u))
            )
            held = loops.pop(len(loops) // 2)
            return loops, held
        record = self._thinned(next(iter(Dataset.of(data))))
        if self.rest is not None:
            record = record.resting_on(self.rest)
        return [record.window(*self.train)], record.window(*self.held)

    def _thinned(self, record: hf.Record) -> hf.Record:
        t = None if record.t is None else np.asarray(record.t)[:: self.every]
        units = {"u_unit": record.u_unit, "y_unit": record.y_unit, "t_unit": record.t_unit}
        return hf.Record(t=t, u=record.u[:: self.every], y=record.y[:: self.every], name=record.name, **units)


PIEZO, STEEL = "lag+bouc-wen-asymmetric+log-creep", "mag_ja_bh/M130_27s"
CASES = (
    Case(
        "piezo",
        "piezo_dbo/model",
        PIEZO,
        {"rho": 0.5, "n": 1.0},
        every=4,
        train=(5.0, 25.0),
        held=(25.0, 40.0),
        rest=0.0,
    ),
    Case(
        "damper",
        "mr_labcontrol/4.1",
        "bouc-wen-force:substeps=16+viscous",
        {},
        ("w0",),
        every=2,
        train=(0.0, 12.0),
        held=(12.0, 30.0),
    ),
    Case("magnetic", STEEL, "jiles-atherton", {}),
)


def run(results: Results) -> dict[str, str]:
    """A table of the cases whose data are found."""
    rows = []
    for case in CASES:
        loaded = results.load(f"{case.name}:", case.source)
        if loaded is not None:
            rows += [_stored(results, case, loaded[0], noise) for noise in ("auto", "iid")]
    head = ["set", "noise model", "90 % bands cover, %", "mean width, % of range", "CRPS, % of range", "error of the median, % of range",
            "sampler", "draws", "least ESS", "largest R-hat", "divergent, %", "status of the chains"]  # fmt: skip
    return {"Predictive bands of 90 % on measured samples that were not fitted": table(head, rows)}


def chains_of(results: Results, name: str, noise: str) -> Path:
    """The folder in which the chains of a case are stored; those of `several_seeds` from the first seed are the same."""
    return results.out / "bands" / f"{name}-{noise}"


def _stored(results: Results, case: Case, data: hf.Record | Dataset, noise: str) -> list[object]:
    """A row of the table, computed now or by an earlier run; its numbers are added."""
    chains = chains_of(results, case.name, noise)
    file = chains.with_suffix(".json")
    if not file.exists():
        fitted, held = case.split(data)
        fit = hf.fit(case.model, fitted, fix=case.fix, free=case.free)
        made = one(case.name, fit, held, noise, chains)
        scratch = file.with_suffix(".part")
        scratch.write_text(json.dumps(made), encoding="utf-8")
        scratch.replace(file)
    made = json.loads(file.read_text(encoding="utf-8"))
    for name, value in made["numbers"].items():
        results.add(name, value)
    return made["row"]


def crps(draws: np.ndarray, y: np.ndarray) -> float:
    """Mean over samples of E|Y - y| - E|Y - Y'| / 2 for draws of shape (count, T)."""
    count, ordered = len(draws), np.sort(draws, axis=0)
    rank = 2 * np.arange(1, count + 1) - count - 1
    apart = rank @ ordered / (count * (count - 1))  # half the mean distance of two draws
    return float(np.mean(np.mean(np.abs(draws - y), axis=0) - apart))


def one(name: str, fit: hf.FitResult, held: hf.Record, noise: str, run: Path) -> dict[str, object]:
    """A row of the table, and the numbers in it; the chains are stored in the folder `run`."""
    made = hf.sample(fit, noise=noise, seed=0, folder=run)
    draws, y = predictive_draws(made, held, COUNT, 0)[:, held.used], held.y[held.used]
    low, middle, high = np.quantile(draws, [0.5 - BAND / 2, 0.5, 0.5 + BAND / 2], axis=0)
    span, words = float(np.ptp(y)), "default" if noise == "auto" else noise
    inside, score = float(np.mean((y >= low) & (y <= high))), crps(draws, y) / span
    converged = made.status is not Status.NOT_CONVERGED
    numbers = {
        f"{name}: chains have converged, {words}": float(converged),
        f"{name}: 90 % predictive bands cover, {words}": inside if converged else float("nan"),
        f"{name}: CRPS over the range, {words}": score,
    }
    if noise == "auto":
        repeats = has(fit.notes, Code.REPEATING_RESIDUALS)
        numbers[f"{name}: the default fit warns of repeating error"] = float(repeats)
        numbers[f"{name}: the default noise model is that of repeating error"] = float(made.noise == "discrepancy")
    error = float(np.sqrt(np.mean((middle - y) ** 2))) / span
    chosen = f"default ({made.noise})" if noise == "auto" else noise
    chains = made.convergence
    percent = [100 * inside, 100 * float(np.mean(high - low)) / span, 100 * score, 100 * error]
    of_chains = [
        made.sampler,
        made.draws.shape[0] * made.draws.shape[1],
        float(np.min([chains.bulk, chains.tail])),
        float(np.max(chains.rhat)),
        100 * float(np.mean(made.stats["diverging"])),
    ]
    row = [name, chosen, *percent, *of_chains, str(made.status)]
    return {"row": row, "numbers": numbers}
