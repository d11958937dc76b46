"""Cost of a call: a short simulation, the prediction of a fit, making a model, beside a numba loop on the same samples."""

from __future__ import annotations

import numpy as np
from loops import loop_of
from rows import Row, beside
from steps import BOUC_WEN, signal
from timing import alternate

import hystfit as hf

SAMPLES = 100


def measure(quick: bool) -> list[Row]:
    """Rows of the suite: NumPy arrays in and out."""
    repeats = 2 if quick else 25
    u, zero = signal(SAMPLES), np.zeros(SAMPLES)
    model = hf.BoucWen(**BOUC_WEN)
    long = signal(2_000)
    y = np.asarray(hf.simulate(model, long)[0]) + np.random.default_rng(0).normal(0, 0.003, long.size)
    fit = hf.fit(hf.BoucWen(), hf.Record(u=long, y=y), starts=1)
    loop = loop_of(model)
    calls = {
        f"simulate {SAMPLES} samples": lambda: np.asarray(hf.simulate(model, u)[0]),
        f"predict {SAMPLES} samples of a fit": lambda: fit.predict(u),
        "make a model": lambda: hf.BoucWen(**BOUC_WEN),
    }
    rows = []
    for name, call in calls.items():
        rows += beside(alternate({"hystfit": call, "numba": lambda: loop(u, zero)}, repeats), name)
    return rows


if __name__ == "__main__":
    from run import alone

    alone("calls")
