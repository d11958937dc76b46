"""Populations: simulated steel coupons whose true parameters are known, and the coverage of intervals for mean and scatter.

    python experiments/populations/run.py [--quick] [--out FOLDER]

Coupons: 18 simulated tests with noise of NHERI-SimCenter quoFEM, drawn from one population; mean, standard deviations and correlations are
compared with those of the true parameters. Coverage: 200 populations of 18 and of 100 devices whose parameters are known to 0.2, 0.7 or
2 times the scatter, a third each; the full form of the second stage on normal errors. Weights: simulation-based calibration of the sampler
of linear weights on 12 and 56 Preisach cells, 200 data sets each; bands over loops that were left out, of three soft materials
and of simulated devices; errors of coercivity, remanence and loss of simulated devices against their truth.
The quick form takes 20 populations of 18, 40 data sets of 12 cells and no measured data. Writes results.json and, in the full form,
RESULTS.md here. Exit status: see experiments/common.py.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from common import Results, arguments, table
from left_out_loops import left_out_loops
from repeated_fits import repeated_fits
from simulated_loops import simulated_loops
from weights import calibration

import hystfit as hf
from hystfit.population.hierarchy import draw_hierarchy

COUPONS, TRUE = 18, ("fy", "E", "b", "cR1", "cR2", "a1", "a3")
SIZES, POPULATIONS, QUICK = (18, 100), 200, 20
SD = np.array([0.1, 0.05, 0.2, 0.3, 0.1])  # of the logarithms
CORRELATIONS = {(0, 1): 0.6, (1, 2): -0.5, (3, 4): 0.3}
CELLS, QUICK_CELLS = ((12, 6), (56, 14)), 40  # number of weights, levels along an axis; data sets of the quick form
ERRORS = (0.2, 0.7, 2.0)  # of the fits, in standard deviations of the population
HEAD_COUPONS = ["parameter", "true mean", "mean", "true sd", "sd of these", "sd of the population", "sd of fits"]
HEAD_CELLS = [
    "cells",
    "data sets",
    "intervals of 90 % cover, %",
    "smallest p-value of uniform ranks, times their number",
]
HEAD_COVERAGE = [
    "devices", "means, %", "standard deviations, %", "correlations, %", "median sd over truth", "sd of fits over truth",
]  # fmt: skip


def coupons(results: Results) -> list:
    """The scatter of the coupons beside that of their true parameters."""
    folder = Path(os.environ.get("HYSTFIT_DATA", "data")) / "steel_quofem"
    files = [folder / f"experiment_{k}.csv" for k in range(COUPONS)]
    if results.quick:
        return []
    if not all(file.exists() for file in files):
        results.skipped["coupons"] = f"no folder {folder}"
        print(f"  skipped: coupons: {results.skipped['coupons']}", flush=True)
        return []
    text = [(folder / f"experiment_{k}_parinfo.txt").read_text().splitlines()[1:] for k in range(COUPONS)]
    numbers = [" ".join(lines).split("]")[0].strip(" [").split() for lines in text]
    truth = np.array([[float(word) for word in row[: len(TRUE)]] for row in numbers])  # the header names other columns
    fit = hf.fit_population("steel-02", [str(file) for file in files], fix={"offset": 0.0})
    assert fit.names == TRUE
    rows = fit.table()
    means, here = np.array([row["mean"] for row in rows]), np.array([row["sd_here"] for row in rows])
    true_sd = truth.std(axis=0, ddof=1)
    results.add("coupons: largest error of a mean, %", float(np.max(np.abs(means / truth.mean(axis=0) - 1)) * 100))
    results.add("coupons: largest error of a standard deviation, %", float(np.max(np.abs(here / true_sd - 1)) * 100))
    correlation = np.median(fit.correlations_here, axis=0)
    true_correlation = np.corrcoef(fit.common.z_of(truth).T)
    results.add("coupons: largest error of a correlation", float(np.max(np.abs(correlation - true_correlation))))
    low, high = np.quantile(fit.sds, [0.05, 0.95], axis=0)
    results.add("coupons: standard deviations in their intervals", float(np.mean((low < true_sd) & (true_sd < high))))
    return [
        [name, truth[:, k].mean(), means[k], true_sd[k], here[k], row["sd"], row["sd_of_fits"]]
        for k, (name, row) in enumerate(zip(TRUE, rows, strict=True))
    ]


def coverage(results: Results, size: int, populations: int) -> list:
    """Coverage of intervals of 90 % over populations whose devices are known to various precision."""
    correlation = np.eye(SD.size)
    for (a, b), value in CORRELATIONS.items():
        correlation[a, b] = correlation[b, a] = value
    covariance = SD[:, None] * correlation * SD
    rng = np.random.default_rng(size)
    inside = {"means": [], "sds": [], "correlations": []}
    ratios, naive = [], []
    upper = np.triu_indices(SD.size, 1)
    for number in range(populations):
        z = rng.multivariate_normal(np.zeros(SD.size), covariance, size=size)
        errors = rng.choice(ERRORS, size=z.shape) * SD
        fits = z + errors * rng.normal(size=z.shape)
        precisions = np.stack([np.diag(row**-2.0) for row in errors])
        drawn = draw_hierarchy(fits, precisions, np.ones((size, 1)), chains=1, draws=500, seed=number)
        sds = np.sqrt(np.einsum("dii->di", drawn.covariance[0]))
        pairs = (drawn.covariance[0] / (sds[:, :, None] * sds[:, None, :]))[:, upper[0], upper[1]]
        for what, draws, true in (
            ("means", drawn.effects[0, :, 0], np.zeros(SD.size)),
            ("sds", sds, SD),
            ("correlations", pairs, correlation[upper]),
        ):
            low, high = np.quantile(draws, [0.05, 0.95], axis=0)
            inside[what].append((low < true) & (true < high))
        ratios.append(np.median(sds, axis=0) / SD)
        naive.append(fits.std(axis=0, ddof=1) / SD)
    shares = {what: 100 * float(np.mean(hits)) for what, hits in inside.items()}
    results.add(f"{size} devices: intervals of means cover, %", shares["means"])
    results.add(f"{size} devices: intervals of standard deviations cover, %", shares["sds"])
    results.add(f"{size} devices: intervals of correlations cover, %", shares["correlations"])
    results.add(f"{size} devices: median standard deviation over truth", float(np.mean(ratios)))
    results.add(f"{size} devices: scatter of the fits over truth", float(np.mean(naive)))
    return [size, *shares.values(), float(np.mean(ratios)), float(np.mean(naive))]


def weights(results: Results, cells: int, levels: int, simulations: int) -> list:
    """Calibration of the sampler of weights."""
    found = calibration(levels, simulations)
    results.add(f"{cells} cells: intervals of 90 % of weights cover, %", found["coverage"])
    results.add(f"{cells} cells: smallest p-value of uniform ranks, times their number", found["p"])
    return [cells, simulations, found["coverage"], found["p"]]


def main() -> None:
    """Run and compare."""
    hf.enable_x64()
    options = arguments(__doc__ or "")
    here = Path(__file__).resolve().parent
    results = Results(here, options.quick, options.out)
    sizes, populations = (SIZES[:1], QUICK) if options.quick else (SIZES, POPULATIONS)
    cells, simulations = (CELLS[:1], QUICK_CELLS) if options.quick else (CELLS, POPULATIONS)
    ranked = [weights(results, *size, simulations) for size in cells]
    covered = [coverage(results, size, populations) for size in sizes]
    tables = {
        "Simulated coupons with their true parameters, by `hystfit population` (`sd of these` is compared with `true sd`)": table(
            HEAD_COUPONS, coupons(results)
        ),
        f"Coverage of 90 % intervals over {populations} populations with normal errors of the fits": table(
            HEAD_COVERAGE, covered
        ),
        "Simulation-based calibration of Preisach weights, `hystfit sample --sampler weights`": table(
            HEAD_CELLS, ranked
        ),
    }
    if not results.quick:
        tables["Held-out samples of measured loops in 90 % bands"] = left_out_loops(results)
        tables["Held-out samples of simulated loops in 90 % bands"] = simulated_loops(results)
        tables["Coercivity, remanence and loss of simulated devices"] = repeated_fits(results)
    results.publish("Populations", "experiments/populations/run.py", tables)
    results.finish()


if __name__ == "__main__":
    main()
