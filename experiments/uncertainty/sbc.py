"""Simulation-based calibration: rank statistics of the truth among posterior draws."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from common import Results, table
from pairs import pairs

from hystfit.uncertainty.calibration import Calibration, calibrate

REPLICATES = 200
FALSE_ALARM = 0.05  # for the whole table: with correct setups, one table in twenty contains a study that fails
Study = tuple[str, str, str, int]  # pair, noise, method, seed


def every_study() -> list[Study]:
    """Each pair under the default noise by least squares, and some with independent noise and by the samplers."""
    names = [pair.name for pair in pairs()]
    studies = [(name, "ou", "laplace", 1) for name in names]
    studies += [(name, "iid", "laplace", 1) for name in ("Bouc-Wen", "Preisach, Gaussian density")]
    studies += [(name, "ou", "nuts", 1) for name in ("Duhem", "Bouc-Wen + creep", "Prandtl-Ishlinskii, 4 plays")]
    return [*studies, ("Bouc-Wen", "ou", "emcee", 1)]


def study(name: str, noise: str, method: str, seed: int, replicates: int, folder: Path | None) -> Calibration:
    """One study; with a folder it resumes from the chunks there."""
    pair = next(pair for pair in pairs() if pair.name == name)
    place = None if folder is None else folder / f"{name} {noise} {method} {seed}".replace(" ", "-").replace(",", "")
    return calibrate(
        pair.model, pair.record, noise=noise, method=method, replicates=replicates, seed=seed, folder=place
    )


def run(results: Results, folder: Path | None) -> str:
    """Every study in full, one in the quick form; a table of them."""
    chosen = every_study()
    if results.quick:
        chosen = [("Bouc-Wen", "ou", "laplace", 1)]
    rows, smallest, failed = [], [], 0
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    for name, noise, method, seed in chosen:
        made = study(name, noise, method, seed, 100 if results.quick else REPLICATES, folder)
        p, covered = made.p_values(), made.coverage()
        smallest.append(float(p.min()) * p.size)
        failed += not made.passes(FALSE_ALARM / len(chosen))
        low, high = made.coverage_band(0.95)
        outside = int(np.sum((covered < low) | (covered > high)))
        worst = made.names[int(np.argmin(p))]
        rows.append(
            [name, noise, method, seed, len(made.ranks), len(made.failures), f"{p.min():.2g} ({worst})", covered.mean(),
             covered.min(), covered.max(), f"{outside} of {p.size}"]
        )  # fmt: skip
    results.add("SBC: studies made", len(chosen))
    results.add("SBC: studies that fail at the stated rate", failed)
    results.add("SBC: studies that fail at 1 % each", float(np.sum(np.array(smallest) < 0.01)))
    results.add("SBC: lowest coverage of 95 % intervals, mean of a study", min(row[7] for row in rows))
    results.add("SBC: highest coverage of 95 % intervals, mean of a study", max(row[7] for row in rows))
    head = ["model", "noise", "method", "seed", "replicates", "failed", "smallest p", "95 % covered, mean", "least", "most",
            "outside its 99 % band"]  # fmt: skip
    return table(head, rows)
