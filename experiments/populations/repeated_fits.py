"""Errors of coercivity, remanence and loss of simulated devices against their truth, see run.py.

The weights of each device are drawn from the prior of the smooth model, and its output has 1 % white noise. Pulls are errors over standard
errors: their root mean square is 1 where the standard errors of the fits are right.
"""

from __future__ import annotations

import numpy as np
from common import Results, table
from simulated_loops import OWN, prior_weights

import hystfit as hf
from hystfit.results.quantity_estimates import measured_quantities
from hystfit.sampling.derived import derive

DEVICES, NOISE = 60, 0.01  # noise over the range of the output
INPUT = np.concatenate([size * np.cos(np.linspace(0, 4 * np.pi, 400)) for size in (1.0, 0.7, 0.4)])
FINE = np.cos(np.linspace(0, 4 * np.pi, 20_001))  # samples would move the remanence by a standard error
QUANTITIES = ("loop_area", "coercive_input", "remanence")
HEAD = ["quantity", "devices", "root mean square pull of the fit", "90 % intervals of the draws cover, %"]


def repeated_fits(results: Results) -> str:
    """A table of the quantities."""
    pulls, hits = {name: [] for name in QUANTITIES}, {name: [] for name in QUANTITIES}
    for number in range(DEVICES):
        rng = np.random.default_rng(number)
        device = prior_weights(rng)
        true = measured_quantities(hf.data.Dataset.of([hf.Record(u=FINE, y=device(FINE))]))
        clean = device(INPUT)
        noise = NOISE * np.ptp(clean) * rng.normal(size=INPUT.size)
        fit = hf.fit(OWN, hf.Record(u=INPUT, y=clean + noise))
        draws = derive(hf.sample(fit, seed=number), QUANTITIES, 1000)
        estimates = {one.name: np.array([one.value, one.stderr], float) for one in fit.quantities}
        for name in QUANTITIES:
            low, high = np.quantile(draws[name], [0.05, 0.95])
            value, stderr = estimates[name]
            pulls[name].append((value - true[name]) / stderr)
            hits[name].append(low < true[name] < high)
    rows = [
        [name, DEVICES, float(np.sqrt(np.mean(np.square(pulls[name])))), 100 * float(np.mean(hits[name]))]
        for name in QUANTITIES
    ]
    results.add("simulated devices: largest root mean square pull of a quantity", max(row[2] for row in rows))
    results.add("simulated devices: smallest root mean square pull of a quantity", min(row[2] for row in rows))
    results.add("simulated devices: intervals of quantities cover, %", float(np.mean([row[3] for row in rows])))
    return table(HEAD, rows)
