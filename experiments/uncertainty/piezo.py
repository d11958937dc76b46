"""A measured piezo stack: what independent, autoregressive, slow and repeating noise make of errors and of predictions."""

from __future__ import annotations

import numpy as np
from common import Results, table

import hystfit as hf

EVERY = 2  # of 200 samples a second
TRAIN, HELD = (5.0, 15.0), (15.0, 40.0)  # seconds


def records() -> tuple[hf.Record, hf.Record] | None:
    """The cycles fitted and those held back; None where the data cannot be had."""
    try:
        whole = hf.datasets.load("piezo_dbo/model", download=False)
    except hf.HystfitError as error:
        print(f"  measured loops are left out: {error}")
        return None
    t = np.asarray(whole.t)[::EVERY]
    thin = hf.Record(t=t, u=whole.u[::EVERY], y=whole.y[::EVERY], u_unit="V", y_unit="um", t_unit="s", name="piezo_dbo")
    return thin.window(*TRAIN), thin.window(*HELD)


def run(results: Results) -> dict[str, str] | None:
    """Coverage of 90 % bands on the cycles held back, for each noise model."""
    data = records()
    if data is None:
        return None
    train, held = data
    fit = hf.fit(hf.BoucWen(scheme="exact"), train, noise="iid")
    results.add(
        "piezo: correlation time of the residuals, samples", hf.fit(fit.model, train, start="model").correlation_time
    )
    warned = any("repeats" in note for note in fit.notes)
    results.add("piezo: the plain fit warns of repeating error", float(warned))
    rows, plain = [], None
    settings = {"chains": 4, "draws": 500, "warmup": 200}
    for noise in ("iid", "ar1", "ou", "discrepancy"):
        made = hf.sample(fit, "nuts", noise=noise, seed=0, **settings)
        low, middle, high = made.bands(held, 0.9, count=400)
        inside = ((held.y >= low) & (held.y <= high))[held.used]
        curve = made.bands(held, 0.9, count=400, kind="credible")
        hit = ((held.y >= curve[0]) & (held.y <= curve[2]))[held.used]
        sd = np.array([made[name].std() for name in fit.free_names])
        plain = sd if noise == "iid" else plain
        results.add(f"piezo: 90 % predictive bands cover, {noise}", float(inside.mean()))
        error = float(np.sqrt(np.mean((middle - held.y)[held.used] ** 2)) / np.ptp(held.y[held.used]))
        rows.append([noise, 100 * float(inside.mean()), 100 * float(hit.mean()), float(np.mean((high - low)[held.used])),
                     100 * error, *sd, None if plain is None else float(np.mean(sd / plain)), made.status])  # fmt: skip
    head = ["noise model", "90 % predictive bands cover, %", "credible bands cover, %", "mean width, um", "error of the median, %",
            *(f"sd of {n}" for n in fit.free_names), "sd / that of iid", "status"]  # fmt: skip
    chosen = hf.sample(fit, "nuts", noise="auto", chains=1, draws=50, warmup=50)
    results.add("piezo: the noise model chosen is that of repeating error", float(chosen.noise == "discrepancy"))
    return {"bands": table(head, rows), "notes": "\n".join(f"- {note}" for note in fit.notes) + "\n"}
