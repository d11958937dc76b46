"""The filter on a measured piezo stack: minor loops of 27 s identified, hysteresis then creep, and the rest predicted in free run."""

from __future__ import annotations

from typing import Any

import numpy as np
from common import Results, table, times

from hystfit import Lag, LogCreep, Record, Series, simulate
from hystfit.fitting.fit import fit
from hystfit.identify import Phase, Ukf, identify_in_stages, identify_online
from hystfit.models import AsymmetricBoucWen

TRAINED = 27.0  # s of 71: loops that shrink to rest and grow again
NOISE = 0.5  # um, white: the errors of the model, 1 % of the range, many times the sensor's 0.07 um
CREEP = {"hold": "none", "noise": NOISE, "walk": 1e-4}


def _held_out(model: Any, record: Record) -> tuple[float, float]:
    """RMS and largest error in percent of the range after the trained part, the model driven by the input from the first sample on."""
    late = times(record) > TRAINED
    error = (np.asarray(simulate(model, record.u, record.dt)[0]) - record.y)[late]
    span = np.ptp(record.y[late])
    return float(100 * np.sqrt(np.mean(error**2)) / span), float(100 * np.abs(error).max() / span)


def measured(results: Results) -> str:
    """The table; empty without the data, and in the quick form."""
    if (loaded := results.load("measured", "piezo_dbo/test")) is None:
        return ""
    (record,) = loaded
    train = record.segment(0, int(np.searchsorted(times(record), TRAINED)))
    core = Series(Lag(), AsymmetricBoucWen()).start([train])
    hysteresis, (first,) = identify_in_stages(core, [Phase(train, settings={"noise": NOISE})])
    whole = Series(*hysteresis.parts, LogCreep(gamma=(0.005,)))
    both, (second, third) = identify_in_stages(
        whole,
        [
            Phase(train, ("gamma", "offset"), CREEP),
            Phase(train, settings={"prior": 0.05, "hold": "none", "noise": NOISE}),
        ],
    )
    fitted = fit(both, train, start="model", starts=1)
    online = identify_online(Ukf.of(core, train, start="model", noise=NOISE), train, block=400)
    for result in (first, second, third, online):
        assert result.free_run is not None
    rows = []
    for name, model, inside in (
        ("filter, hysteresis", hysteresis, first.free_run),
        ("filter, then creep", second.model, second.free_run),
        ("filter, then both", both, third.free_run),
        ("least squares", fitted.model, fitted.train),
    ):
        assert inside is not None  # a run that ended has one
        rows.append([name, inside.nrmse_percent, *_held_out(model, record)])
        results.add(f"measured piezo: {name}, held out RMS %", rows[-1][2])
    assert online.free_run is not None
    stopped = online.counts["total"] / len(train) * TRAINED
    rows.append(
        [
            f"filter, hysteresis, on-line for {stopped:.3g} s ({online.status.value})",
            online.free_run.nrmse_percent,
            *_held_out(online.model, record),
        ]
    )
    creep = float(both.parts[-1].gamma[0]), float(fitted.model.parts[-1].gamma[0])
    text = f"\nCreep per decade: {100 * creep[0]:.2g} % by the filter, {100 * creep[1]:.2g} % by least squares.\n"
    return table(["method", "in sample RMS %", "held out RMS %", "largest %"], rows) + text
