"""Loops that are judged together beside `hystfit.fit` of each: random devices of five models, with white and slow noise.

    python -m tests.hard.maps            # 1000 loops, some minutes
    python -m tests.hard.maps --quick    # 60

Estimates must agree to 1e-5 of their standard errors, errors to 1e-3, and status and notes exactly. Exit status 1 otherwise.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from scipy.signal import lfilter

import hystfit as hf
from hystfit.batch.row import Row, row_of
from hystfit.models.base import AbstractHysteresis
from hystfit.params.space import ParameterSpace

SAMPLES = 800
MODELS: dict[str, AbstractHysteresis] = {
    "bouc-wen": hf.BoucWen(mu=0.45, tau=0.6, rho=0.4),
    "bouc-wen-asymmetric": hf.AsymmetricBoucWen(mu=0.45, tau=0.6, rho=0.4, skew=0.1),
    "bouc-wen-force": hf.BoucWenForce(),
    "duhem": hf.Duhem(alpha=1.0, f=[0.1, 1.0, 0.05], g=[0.5, 0.05], w0=0.0),
    "bouc-wen+lag": hf.Series(hf.Lag(tau=0.05), hf.BoucWen(mu=0.45, tau=0.6, rho=0.4)),
}
SAME, ERRORS = 1e-5, 1e-3


def devices(model: AbstractHysteresis, u: np.ndarray, t: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Outputs of devices about a model; a fifth of them with slow noise."""
    rng, space = np.random.default_rng(seed), ParameterSpace.of(model)
    z, rows = space.unconstrained(space.vector(model)), []
    while len(rows) < count:
        one = space.tree(z + 0.2 * rng.normal(size=z.size))
        y = np.asarray(hf.simulate(one, u, np.diff(t, prepend=t[0]))[0])
        white = rng.normal(size=u.size)
        slow = 0.3 * lfilter([1], [1, -0.95], rng.normal(size=u.size)) if len(rows) % 5 == 4 else 0.0
        if np.isfinite(y).all() and np.ptp(y) > 0:
            rows.append(y + rng.uniform(0.001, 0.01) * np.ptp(y) * (white + slow))
    return np.array(rows)


def differences(found: hf.LoopMap, k: int, wanted: Row) -> tuple[float, float, bool]:
    """Of estimates, in standard errors; of errors, relative; whether status and notes are the same."""
    apart, errors = 0.0, 0.0
    for name, value in wanted.values.items():
        error, mine = wanted.stderr[name], found.stderr[name][k]
        if error is None or not np.isfinite(mine):
            errors = max(errors, np.inf if (error is None) != (not np.isfinite(mine)) else 0.0)
            continue
        apart = max(apart, abs(found[name][k] - value) / error)
        errors = max(errors, abs(mine / error - 1))
    same = found.statuses[k] == str(wanted.status) and found.codes[k] == " ".join(wanted.codes)
    return apart, errors, bool(same)


def main(loops: int) -> int:
    """Print the table; 1 where something differs."""
    hf.enable_x64()
    t = np.arange(SAMPLES) / 200
    u = 2 * np.sin(2 * np.pi * 2 * t) * (0.3 + 0.7 * t / t[-1])
    begun, wrong = time.perf_counter(), 0
    print("model                 loops  together  ok      estimates [errors]   errors      status and notes differ")
    for number, (name, model) in enumerate(MODELS.items()):
        y = devices(model, u, t, loops // len(MODELS), number)
        found = hf.fit_map(name, u, y, t, workers=1)
        rows = []
        for k in np.flatnonzero(~found.alone):
            record = hf.Record(u=u, y=y[k], t=t)
            rows.append(differences(found, int(k), row_of("", "", record, hf.fit(name, record))))
        apart, errors, same = zip(*rows, strict=True) if rows else ((0.0,), (0.0,), (True,))
        differ = sum(not one for one in same)
        wrong += differ + sum(value > SAME for value in apart) + sum(value > ERRORS for value in errors)
        print(
            f"{name:<20} {len(y):>6} {len(rows):>9} {int(found.ok.sum()):>5} {max(apart):>18.1e} {max(errors):>14.1e} {differ:>12}",
            flush=True,
        )
    print(f"{wrong} differences, {time.perf_counter() - begun:.0f} s")
    return int(wrong > 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    sys.exit(main(60 if parser.parse_args().quick else 1000))
