"""Random devices of every model: each fit must reach the cost of the truth, or say that it is not usable.

    python -m tests.hard.devices [MODEL ...] [--devices 0:1000] [--out FOLDER]

Every seed makes one device: parameters about those of `tests.test_recovery`, a random input and noise of 0.3 % of the output's range.
Parameters are drawn again where the output diverges (a softening oscillator beyond its stable displacement). The outcome of a device is
`right` (usable, with a sum of squared residuals no larger than that of the truth), `refused` (not usable) or `wrong` (usable above the
truth). With --out, devices that were fitted are read from there.
"""

from __future__ import annotations

import argparse
import collections
import sys
from pathlib import Path

import numpy as np

import hystfit as hf
from hystfit.batch.row import Row
from hystfit.params.space import ParameterSpace

from ..test_recovery import CASES, T
from .reading import seeds_of

NOISE = 0.003  # of the output's range
SPREAD = 0.4  # of the parameters, in unconstrained coordinates
SLACK = {"prandtl-ishlinskii": 1.02, "preisach": 1.05}  # of the rms error, part of which a penalty costs


def device(case: str, seed: int) -> tuple[hf.Record, float]:
    """The record of a random device, and the rms of its noise."""
    rng = np.random.default_rng([seed, len(case)])
    truth, u = CASES[case]
    u = u * (0.8 + 0.2 * np.sin(2 * np.pi * rng.uniform(0.2, 0.5) * T + rng.uniform(0, 6)))
    space = ParameterSpace.of(truth)
    center, y = space.unconstrained(space.vector(truth)), np.array([np.nan])
    while not np.isfinite(y).all():
        z = center + rng.uniform(-SPREAD, SPREAD, len(space))
        y = np.asarray(hf.simulate(space.tree(z), u, T[1] - T[0])[0])
    noise = NOISE * np.ptp(y) * rng.normal(size=u.size)
    return hf.Record(u=u, y=y + noise, t=T, name=f"{case} {seed}"), float(np.sqrt(np.mean(noise**2)))


def run(case: str, seeds: range, out: Path | None = None) -> tuple[collections.Counter[str], list[str]]:
    """Counts of the outcomes of some devices, and lines on the wrong ones."""
    devices = [device(case, seed) for seed in seeds]
    folder = None if out is None else out / case.replace(" ", "-")
    start = "model" if case in SLACK else "data"  # thresholds of plays and relays are those of the truth
    fits = hf.fit_many(CASES[case][0], [record for record, _ in devices], folder=folder, start=start)
    counts: collections.Counter[str] = collections.Counter()
    bad = []
    for row, (_, noise) in zip(fits.rows, devices, strict=True):
        outcome = outcome_of(row, noise, SLACK.get(case, 1.0))
        counts[outcome] += 1
        if outcome == "wrong":
            bad.append(f"{row.name}: {row.status.name}, rms error {row.rmse:.4g}, of the truth {noise:.4g}")
    return counts, bad


def outcome_of(row: Row, noise: float, slack: float = 1.0) -> str:
    """`right`, `refused` or `wrong`."""
    if not row.usable or row.rmse is None:
        return "refused"
    return "right" if row.rmse <= slack * noise * (1 + 1e-6) else "wrong"


def main() -> int:
    """Fit the devices of the command line; 1 where a usable fit is above the cost of the truth."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="*", default=list(CASES), help="names of test_recovery.CASES; all by default")
    parser.add_argument("--devices", type=seeds_of, default=range(1000))
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    hf.enable_x64()
    status = 0
    for case in options.models:
        counts, bad = run(case, options.devices, options.out)
        for line in bad[:10]:
            print(line)
        print(f"{case}: " + ", ".join(f"{counts[key]} {key}" for key in sorted(counts)), flush=True)
        status |= bool(bad)
    return status


if __name__ == "__main__":
    sys.exit(main())
